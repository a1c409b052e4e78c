//! `figure`: signals of a recording as a figure for print, or as a table.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use serde_json::json;

use super::outputs::Overwrite;
use super::{Report, args, picture};
use springtwin::analysis::history::{Channel, History};
use springtwin::analysis::recorded::origin_name;
use springtwin::charts::{COLUMN_MM, Figure};
use springtwin::gui::panels::plot::{Chosen, Table, column, figure, groups, name};
use springtwin::lab::loading;
use springtwin::recording::write_bytes;
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct FigureArgs {
    /// Recording or session
    #[arg(value_name = "F.rrd|SESSION")]
    file: PathBuf,
    /// Signals by the names of their columns, such as tip_x_mm,vicon_x_mm; without them, those that the file has are listed
    #[arg(long, value_name = "NAME,..", value_delimiter = ',', value_parser = signal, requires = "out")]
    signals: Vec<Channel>,
    /// From this time on, s since the session's start
    #[arg(long, value_name = "S", value_parser = args::not_negative)]
    from: Option<f64>,
    /// Up to this time, s since the session's start
    #[arg(long, value_name = "S", value_parser = args::not_negative)]
    to: Option<f64>,
    /// The figure (.svg, .pdf, .png), or the values as a table (.csv)
    #[arg(long, value_name = "F", value_parser = format, requires = "signals")]
    out: Option<(PathBuf, Format)>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Width on paper, mm: 85 is one column of most journals, 174 are two
    #[arg(long, value_name = "MM", default_value_t = COLUMN_MM[0], value_parser = side_mm)]
    width_mm: f64,
    /// Height on paper, mm; without it as high as its plots need
    #[arg(long, value_name = "MM", value_parser = side_mm)]
    height_mm: Option<f64>,
    /// Pixels per inch of a .png
    #[arg(long, value_name = "N", default_value = "300", value_parser = dpi)]
    dpi: f64,
}

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Svg,
    Pdf,
    Png,
    Csv,
}

/// A path that ends in what it shall be.
fn format(text: &str) -> Result<(PathBuf, Format), String> {
    let path = PathBuf::from(text);
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    let format = match ending.to_lowercase().as_str() {
        "svg" => Format::Svg,
        "pdf" => Format::Pdf,
        "png" => Format::Png,
        "csv" => Format::Csv,
        _ => {
            return Err(format!(
                "'{text}' is no figure: end the name in .svg, .pdf, .png or .csv"
            ));
        }
    };
    Ok((path, format))
}

/// A number from `lo` to `hi`.
fn within(text: &str, [lo, hi]: [f64; 2], what: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v| (lo..=hi).contains(v));
    value.ok_or_else(|| format!("'{text}' is no {what}: give {lo} to {hi}"))
}

fn side_mm(text: &str) -> Result<f64, String> {
    within(text, [20.0, 1000.0], "side of a figure in mm")
}

fn dpi(text: &str) -> Result<f64, String> {
    within(text, [36.0, 1200.0], "number of pixels per inch")
}

/// A signal by the name of its column, or by its name on screen.
fn signal(text: &str) -> Result<Channel, String> {
    let wanted = text.trim().to_lowercase();
    let all = groups().into_iter().flat_map(|g| g.channels);
    let is_it = |c: &Channel| column(*c) == wanted || name(*c).to_lowercase() == wanted;
    { all }.find(is_it).ok_or_else(|| {
        format!("'{text}' is no signal: `springtwin figure FILE` lists those of a recording")
    })
}

/// `figure`.
pub fn run(a: &FigureArgs, robot: &RobotSpec) -> Result<Report> {
    anyhow::ensure!(
        a.from.zip(a.to).is_none_or(|(from, to)| from < to),
        "--from must be before --to"
    );
    if let Some((out, _)) = &a.out {
        a.overwrite.file(out)?;
    }
    let loaded = loading::load_part(robot, &a.file, [a.from, a.to], &mut |_| true)
        .map_err(anyhow::Error::msg)?;
    let origin = origin_name(loaded.trace.simulated);
    let history = History::of(loaded.trace.snapshots.iter());
    let [first, last] = history
        .range_s()
        .ok_or_else(|| anyhow::anyhow!("{} holds nothing in this time", a.file.display()))?;
    let range_s = [a.from.unwrap_or(first), a.to.unwrap_or(last)];
    let Some((out, format)) = &a.out else {
        return Ok(listed(&history, range_s));
    };
    let table = Table::of(&history, 0.0, range_s, &a.signals);
    if let Some(empty) = table.without() {
        anyhow::bail!(
            "{} has no value of {empty} from {:.3} to {:.3} s: leave it out, or choose another time",
            a.file.display(),
            range_s[0],
            range_s[1]
        );
    }
    let figure = figure_of(a, &history, range_s, origin);
    match format {
        Format::Csv => write_bytes(out, table.csv(origin).as_bytes())?,
        Format::Svg => write_bytes(out, figure.svg().as_bytes())?,
        Format::Pdf => write_bytes(out, &figure.pdf())?,
        Format::Png => picture::save_whole(picture::figure(&figure, a.dpi)?, out)?,
    }
    let apart_s = loaded.about.apart_s;
    Ok(written(out, *format, &figure, &table, (origin, apart_s)))
}

/// The figure of the chosen signals, one plot for each unit.
fn figure_of(a: &FigureArgs, history: &History, range_s: [f64; 2], origin: &str) -> Figure {
    let mut chosen = Chosen::default();
    a.signals.iter().for_each(|c| chosen.set(*c, true));
    let whole = figure(history, 0.0, range_s, &chosen.strips(), origin);
    Figure {
        size_mm: [a.width_mm, a.height_mm.unwrap_or(whole.size_mm[1])],
        ..whole
    }
}

/// The signals that have values, by the names of their columns.
fn listed(history: &History, [from_s, to_s]: [f64; 2]) -> Report {
    let has = |c: &Channel| history.values(*c, from_s, to_s).next().is_some();
    let mut lines = vec![format!("Signals from {from_s:.3} to {to_s:.3} s:")];
    let mut all = Vec::new();
    for group in groups() {
        let there = group.channels.into_iter().filter(has).map(column);
        let names: Vec<String> = there.collect();
        if !names.is_empty() {
            lines.push(format!("{}: {}", group.name, names.join(", ")));
        }
        all.extend(names);
    }
    Report {
        text: lines.join("\n"),
        json: json!({"from_s": from_s, "to_s": to_s, "signals": all}),
    }
}

fn written(
    out: &Path,
    format: Format,
    figure: &Figure,
    table: &Table,
    (origin, apart_s): (&str, Option<f64>),
) -> Report {
    let [w, h] = figure.size_mm;
    let what = match format {
        Format::Csv => format!("{} rows", table.rows()),
        Format::Svg | Format::Pdf | Format::Png => format!("{w} x {h} mm"),
    };
    let thinned = apart_s.map_or_else(String::new, |s| {
        format!(", one sample every {s} s: name a shorter part for all of them")
    });
    Report {
        text: format!("{} ({what}, {origin}{thinned})", out.display()),
        json: json!({
            "out": out, "width_mm": w, "height_mm": h, "rows": table.rows(), "origin": origin, "apart_s": apart_s,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(out: &Path, signals: &[&str]) -> FigureArgs {
        let text = out.to_string_lossy();
        FigureArgs {
            file: Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/point-to-point.rrd"),
            signals: signals
                .iter()
                .map(|s| signal(s).expect("a signal"))
                .collect(),
            from: Some(2.0),
            to: Some(4.0),
            out: Some(format(&text).expect("a format")),
            overwrite: Overwrite::default(),
            width_mm: COLUMN_MM[0],
            height_mm: Some(60.0),
            dpi: 144.0,
        }
    }

    #[test]
    fn a_recording_becomes_a_figure_of_every_kind_and_nothing_is_replaced() {
        let name = format!("springtwin-figure-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).expect("a folder");
        let robot = RobotSpec::reference();
        let signals = ["tip_x_mm", "Tip y", "chamber_1_measured_kpa"];
        let made: Vec<Vec<u8>> = ["svg", "pdf", "png", "csv"]
            .map(|ending| {
                let out = folder.join("f").with_extension(ending);
                run(&args(&out, &signals), &robot).expect("a figure");
                std::fs::read(out).expect("is there")
            })
            .into();
        let again = run(&args(&folder.join("f.svg"), &signals), &robot);
        let refused = again.expect_err("it is there").to_string();
        let nothing = run(
            &args(&folder.join("g.svg"), &["spring_1a_trial_residual_mm"]),
            &robot,
        );
        let nothing = nothing.expect_err("no model is tried").to_string();
        std::fs::remove_dir_all(&folder).expect("removed");
        assert!(refused.contains("exists already"), "{refused}");
        assert!(
            nothing.contains("no value of spring_1a_trial_residual_mm"),
            "{nothing}"
        );
        let text = |k: usize| String::from_utf8_lossy(&made[k]).into_owned();
        assert!(text(0).contains("width=\"85mm\" height=\"60mm\""));
        for label in [
            ">Tip x<",
            ">Tip y<",
            ">Chamber 1 measured / kPa<",
            ">simulated data<",
        ] {
            assert!(text(0).contains(label), "{label}");
        }
        assert!(text(1).contains("(Chamber 1 measured / kPa) Tj"));
        let png = image::load_from_memory(&made[2])
            .expect("a picture")
            .into_rgb8();
        assert_eq!(png.dimensions(), (482, 340));
        // Axes and letters are black, the first signal is blue.
        let near = |p: &image::Rgb<u8>, c: [u8; 3]| (0..3).all(|k| p.0[k].abs_diff(c[k]) < 60);
        for colour in [[0, 0, 0], [0, 0x72, 0xb2]] {
            let count = png.pixels().filter(|p| near(p, colour)).count();
            assert!(count > 150, "{colour:?}: {count}");
        }
        let table = text(3);
        let head = "t_s,tip_x_mm,tip_y_mm,chamber_1_measured_kpa,origin\n";
        assert!(table.starts_with(head), "{table}");
        assert!(table.lines().skip(1).all(|l| l.ends_with(",simulated")));
        let first: f64 = table
            .lines()
            .nth(1)
            .and_then(|l| l.split(',').next()?.parse().ok())
            .expect("a time");
        assert!((2.0..2.1).contains(&first), "{first}");
    }

    #[test]
    fn names_formats_and_sizes_that_are_none_are_refused_with_what_to_write() {
        assert_eq!(signal("Translation error"), Ok(Channel::Error(6)));
        assert!(signal("tip_q").is_err_and(|e| e.contains("springtwin figure FILE")));
        assert!(format("a.jpg").is_err_and(|e| e.contains(".svg, .pdf, .png or .csv")));
        assert!(side_mm("3").is_err_and(|e| e.contains("20 to 1000")));
        assert!(dpi("x").is_err());
    }
}
