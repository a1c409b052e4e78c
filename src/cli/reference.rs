//! Reference pages made from the program itself: man pages, the guide's page of commands and its page of effects.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{Arg, Args, Command};
use serde_json::json;

use super::outputs::Overwrite;
use super::{Report, silent};
use springtwin::sim::effects::{EFFECTS, Effect, Side, TERMS, Target};

#[derive(Args)]
pub struct ManArgs {
    /// Command whose page to print, such as `gap run`; the program's own without it
    #[arg(value_name = "COMMAND")]
    command: Vec<String>,
    /// Write the pages of all commands into this folder instead
    #[arg(long, value_name = "DIR", conflicts_with_all = ["command", "markdown"])]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Print all commands as one page of Markdown, as the guide has it
    #[arg(long, conflicts_with = "command")]
    markdown: bool,
}

#[derive(Args)]
pub struct CompletionsArgs {
    /// Which shell
    shell: clap_complete::Shell,
}

/// `completions`: of the whole program, whose description is `program`.
pub fn completions(a: &CompletionsArgs, mut program: Command) -> Result<Report> {
    let mut script = Vec::new();
    clap_complete::generate(a.shell, &mut program, "springtwin", &mut script);
    super::stdio::bytes(&script)?;
    Ok(silent())
}

/// The files that `clap_mangen` makes: a page for each command that is shown.
fn pages(program: &Command) -> Vec<String> {
    fn walk(command: &Command, name: &str, pages: &mut Vec<String>) {
        pages.push(format!("{name}.1"));
        for sub in command.get_subcommands().filter(|c| !c.is_hide_set()) {
            walk(sub, &format!("{name}-{}", sub.get_name()), pages);
        }
    }
    let mut pages = Vec::new();
    walk(program, program.get_name(), &mut pages);
    pages
}

/// `man`: of the whole program, whose description is `program`.
pub fn man(a: &ManArgs, program: Command) -> Result<Report> {
    let mut program = program.disable_help_subcommand(true);
    if let Some(dir) = &a.out {
        a.overwrite.files(dir, &pages(&program))?;
        std::fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
        clap_mangen::generate_to(program, dir)
            .with_context(|| format!("cannot write the pages to {}", dir.display()))?;
        return Ok(Report {
            text: format!("pages of all commands in {}", dir.display()),
            json: json!({"out": dir}),
        });
    }
    program.build();
    if a.markdown {
        let text = commands_page(&program);
        return Ok(Report {
            json: json!({"markdown": text}),
            text,
        });
    }
    let mut command = &program;
    for name in &a.command {
        command = command
            .get_subcommands()
            .find(|c| c.get_name() == name)
            .with_context(|| {
                format!(
                    "there is no command '{}': `springtwin --help` lists them",
                    a.command.join(" ")
                )
            })?;
    }
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).render(&mut page)?;
    super::stdio::bytes(&page)?;
    Ok(silent())
}

/// Every command with its arguments, as a page of the guide.
fn commands_page(program: &Command) -> String {
    let mut page = String::from(
        "# Commands\n\n\
         Made by `springtwin man --markdown`; a test keeps it so. Without a command, `springtwin` opens the window on the\n\
         virtual rig. The exit code is 0 only on success, 2 on bad usage and 1 otherwise, with the reason in one sentence.\n\n\
         These go with every command:\n\n",
    );
    for arg in program.get_arguments() {
        page.push_str(&argument(arg));
    }
    page.push_str("- `--help`: what a command takes; `-h` in short\n");
    for command in program.get_subcommands() {
        section(command, &mut page);
    }
    page.pop();
    page
}

/// A command, then those under it.
fn section(command: &Command, page: &mut String) {
    if command.is_hide_set() {
        return;
    }
    let name = command.get_bin_name().unwrap_or_else(|| command.get_name());
    let name = name.trim_start_matches("springtwin ");
    let level = name.split(' ').count() + 1;
    let about = command.get_about().map(ToString::to_string);
    // Writing to a text cannot fail.
    let _ = write!(
        page,
        "\n{} {name}\n\n{}.\n",
        "#".repeat(level),
        about.unwrap_or_default()
    );
    let own: Vec<&Arg> = command
        .get_arguments()
        .filter(|arg| !arg.is_hide_set() && !arg.is_global_set())
        .filter(|arg| !matches!(arg.get_id().as_str(), "help" | "version"))
        .collect();
    if !own.is_empty() {
        page.push('\n');
    }
    for arg in own {
        page.push_str(&argument(arg));
    }
    for below in command.get_subcommands() {
        section(below, page);
    }
}

/// One line for an argument.
fn argument(arg: &Arg) -> String {
    let values = arg.get_value_names().unwrap_or_default();
    let takes_values = arg.get_action().takes_values();
    let values = if takes_values {
        values.iter().map(|v| format!("<{v}>")).collect::<Vec<_>>()
    } else {
        Vec::new()
    }
    .join(" ");
    let shape = match arg.get_long() {
        Some(long) if values.is_empty() => format!("--{long}"),
        Some(long) => format!("--{long} {values}"),
        None => values,
    };
    if matches!(arg.get_id().as_str(), "help" | "version") {
        return String::new();
    }
    let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
    // A sign that a value starts with is a tag to Markdown.
    let mut line = format!("- `{shape}`: {}", help.replace('<', "\\<"));
    let choices: Vec<String> = match takes_values {
        true => arg.get_possible_values(),
        false => Vec::new(),
    }
    .iter()
    .map(|v| format!("`{}`", v.get_name()))
    .collect();
    let defaults: Vec<_> = arg
        .get_default_values()
        .iter()
        .filter(|_| takes_values)
        .map(|v| format!("`{}`", v.to_string_lossy()))
        .collect();
    if !choices.is_empty() {
        line += &format!("; one of {}", choices.join(", "));
    }
    if !defaults.is_empty() {
        line += &format!("; {} without it", defaults.join(" "));
    }
    if arg.is_required_set() {
        line += "; needed";
    }
    line + "\n"
}

/// The table of effects with equations, sources, units and bounds, as a page of the guide.
pub fn effects_page() -> String {
    let mut page = String::from(
        "# Effects\n\n\
         The effects that [the gap finder](finding-a-gap.md) can name, from its one table. Made by `springtwin gap effects --markdown`;\n\
         a test keeps it so. With every parameter at its value *without* the effect, the effect changes nothing; a parameter\n\
         that only shapes it has a usual value there. The comparisons r1 to r5 are described in\n\
         [What it compares](finding-a-gap.md#what-it-compares).\n",
    );
    for (side, title) in [
        (
            Side::Actuation,
            "Actuation: between the commanded pressure and the chamber",
        ),
        (Side::Mechanics, "Mechanics: in the arm"),
        (Side::Sensing, "Sensing: in springs and IMUs"),
        (
            Side::FrameAndTime,
            "Frame and time: in the motion capture's frame and clock",
        ),
    ] {
        let _ = write!(page, "\n## {title}\n");
        for e in EFFECTS.iter().filter(|e| e.side == side) {
            page.push_str(&effect(e));
        }
    }
    page.push_str(&terms());
    page
}

/// The library of terms as a table.
fn terms() -> String {
    let mut out = String::from(
        "\n## Terms of laws\n\n\
         What [a law](finding-a-gap.md#8-where-no-effect-explains-it) is made of. All coefficients are SI.\n\n\
         | id | term | changes | depends on | coefficients and shapes |\n|---|---|---|---|---|\n",
    );
    let plain = |value: serde_json::Value| value.as_str().unwrap_or_default().replace('-', " ");
    for t in TERMS {
        let inputs: Vec<String> = t
            .inputs
            .iter()
            .map(|i| plain(serde_json::json!(i)))
            .collect();
        let numbers = t.effect.parameters.iter().map(|p| match p.unit {
            "" => p.name.to_owned(),
            unit => format!("{} ({unit})", p.name),
        });
        let numbers: Vec<String> = numbers.collect();
        let _ = writeln!(
            out,
            "| `{}` | {} | {} | {} | {} |",
            t.effect.id,
            t.effect.doc.replace('_', "\\_").replace('|', "\\|"),
            plain(serde_json::json!(t.site)),
            inputs.join(", "),
            numbers.join(", ")
        );
    }
    out.pop();
    out
}

fn effect(e: &Effect) -> String {
    let sits_on = match e.target {
        Target::Chamber => "a chamber",
        Target::Spring => "a spring",
        Target::Imu => "an IMU",
        Target::Segment => "a segment",
        Target::None => "the whole",
    };
    let shows: Vec<String> = e
        .residuals
        .iter()
        .map(|r| format!("{r:?}").to_lowercase())
        .collect();
    let mut out = format!(
        "\n### {}: `{}`\n\n{} Source: {}. Sits on {sits_on}; shows in {}.\n\n\
         | parameter | unit | without the effect | least | most |\n|---|---|---|---|---|\n",
        e.name,
        e.id,
        e.doc.replace('_', "\\_"),
        e.source,
        shows.join(", ")
    );
    for p in e.parameters {
        let unit = if p.unit.is_empty() { "ratio" } else { p.unit };
        let [least, most] = p.bounds;
        let _ = writeln!(
            out,
            "| {} | {unit} | {} | {least} | {most} |",
            p.name, p.nominal
        );
    }
    out
}
