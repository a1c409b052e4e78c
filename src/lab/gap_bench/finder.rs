//! Runs the gap finder in a process that is given the sessions of a case and nothing else.

use std::fs::File;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

use super::generator::PROOF;
use super::suite::Planned;
use crate::lab::shards::write;

/// File of the finder's verdict.
pub const VERDICT: &str = "verdict.json";
/// File that identifies the finder of that verdict.
const RUN: &str = "run.json";
/// Its standard error.
const LOG: &str = "finder.log";
/// All that may be in a case's folder.
const ALLOWED: [&str; 8] = [
    "commissioning",
    "suspect",
    PROOF,
    VERDICT,
    "verdict.part",
    RUN,
    "run.part",
    LOG,
];
/// Interval of the checks whether the finder is done.
const LOOK: Duration = Duration::from_millis(20);

/// Starts finders.
pub struct Seeker<'a> {
    /// The program.
    pub program: &'a Path,
    /// Its hash.
    pub hash: String,
    /// Robot file; `None`: the reference robot.
    pub robot_file: Option<&'a Path>,
    /// Longest time, s.
    pub limit_s: f64,
    /// Look for laws.
    pub discover: bool,
    /// Judge without motion capture.
    pub without_cameras: bool,
}

impl Seeker<'_> {
    /// The finder's command line: the sessions of the case, and the effect that it must not use.
    fn command(&self, folder: &Path, without: Option<&str>) -> Command {
        let mut command = Command::new(self.program);
        command.env_clear().current_dir(std::env::temp_dir());
        if let Some(file) = self.robot_file {
            command.arg("--robot").arg(file);
        }
        let what = if self.discover { "discover" } else { "run" };
        command.args(["gap", what, "--json"]);
        command.arg("--baseline").arg(folder.join("commissioning"));
        command.arg("--session").arg(folder.join("suspect"));
        if self.discover {
            command.arg("--prove").arg(folder.join(PROOF));
        }
        if let Some(id) = without {
            command.args(["--without", id]);
        }
        if self.without_cameras {
            command.arg("--without-cameras");
        }
        command
    }

    /// Has the verdict of a case written, unless this very program has written it before. A finder that fails is a verdict
    /// too; it is tried again the next time. `without` names an effect that it must not use; `None`: it may use all.
    ///
    /// # Errors
    /// When the verdict cannot be written, or something lies in the folder that does not belong there.
    pub fn seek(&self, folder: &Path, without: Option<&str>) -> Result<()> {
        only_sessions(folder)?;
        let run = run(&self.hash, without, self.without_cameras);
        if done(folder, &run) {
            return Ok(());
        }
        let verdict = match self.ask(folder, without) {
            Ok(verdict) => verdict,
            Err(e) => json!({"verdict": null, "error": format!("{e:#}")}),
        };
        write(&folder.join(VERDICT), &format!("{verdict:#}"))?;
        write(&folder.join(RUN), &run.to_string())
    }

    fn ask(&self, folder: &Path, without: Option<&str>) -> Result<Value> {
        // To files: a pipe that nobody empties would stop the finder.
        let (said, log) = (folder.join("verdict.part"), folder.join(LOG));
        let child = self
            .command(folder, without)
            .stdin(Stdio::null())
            .stdout(File::create(&said)?)
            .stderr(File::create(&log)?)
            .spawn()
            .with_context(|| format!("cannot start the finder {}", self.program.display()))?;
        let status = wait(child, self.limit_s)?;
        let complaint = std::fs::read_to_string(&log).unwrap_or_default();
        anyhow::ensure!(
            status.success(),
            "the finder ended with {status}: {}",
            complaint.lines().last().unwrap_or_default()
        );
        let text = std::fs::read_to_string(&said)?;
        let value: Value = serde_json::from_str(&text).context("the finder did not print JSON")?;
        anyhow::ensure!(
            value["verdict"].is_string(),
            "the finder's JSON has no verdict"
        );
        Ok(value)
    }
}

/// Waits for a process and ends it when it takes longer than `limit_s`.
fn wait(mut child: Child, limit_s: f64) -> Result<ExitStatus> {
    // Looks are counted: no clock is needed for a limit of minutes.
    let looks = (limit_s / LOOK.as_secs_f64()).ceil() as u64;
    for _ in 0..looks {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        std::thread::sleep(LOOK);
    }
    child.kill()?;
    child.wait()?;
    anyhow::bail!("the finder took more than {limit_s} s")
}

/// Everything that a verdict depends on besides the sessions.
fn run(finder: &str, without: Option<&str>, without_cameras: bool) -> Value {
    json!({"finder": finder, "without": without, "cameras": !without_cameras})
}

/// Whether a case has a verdict of the finder with this hash; that it failed is one, too.
pub fn is_by(folder: &Path, finder: &str, planned: &Planned, without_cameras: bool) -> bool {
    let text = std::fs::read_to_string(folder.join(RUN)).ok();
    let made: Option<Value> = text.and_then(|t| serde_json::from_str(&t).ok());
    made == Some(run(finder, planned.without, without_cameras)) && folder.join(VERDICT).exists()
}

/// Whether this run is on disk, and did not fail.
fn done(folder: &Path, run: &Value) -> bool {
    let read = |name: &str| -> Option<Value> {
        serde_json::from_str(&std::fs::read_to_string(folder.join(name)).ok()?).ok()
    };
    read(RUN).as_ref() == Some(run) && read(VERDICT).is_some_and(|v| v["verdict"].is_string())
}

/// Refuses a folder in which the finder could come across more than the sessions.
fn only_sessions(folder: &Path) -> Result<()> {
    let entries = std::fs::read_dir(folder)
        .with_context(|| format!("cannot read the case {}", folder.display()))?;
    for entry in entries {
        let name = entry?.file_name();
        anyhow::ensure!(
            ALLOWED.iter().any(|a| name == *a),
            "'{}' does not belong into the case {}: the finder must see the sessions alone",
            name.to_string_lossy(),
            folder.display()
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_finder_is_told_the_sessions_and_nothing_else() {
        let seeker = Seeker {
            program: Path::new("/bin/finder"),
            hash: "h".to_owned(),
            robot_file: None,
            limit_s: 1.0,
            discover: false,
            without_cameras: false,
        };
        let list = |seeker: &Seeker<'_>, without| -> Vec<String> {
            let command = seeker.command(Path::new("/b/cases/c1"), without);
            assert_eq!(command.get_envs().count(), 0);
            assert_ne!(command.get_current_dir(), None);
            let args = command.get_args();
            args.map(|a| a.to_string_lossy().into_owned()).collect()
        };
        let sessions = [
            "gap",
            "run",
            "--json",
            "--baseline",
            "/b/cases/c1/commissioning",
            "--session",
            "/b/cases/c1/suspect",
        ];
        assert_eq!(list(&seeker, None), sessions);
        assert_eq!(list(&seeker, Some("leak"))[7..], ["--without", "leak"]);
        let blind = Seeker {
            without_cameras: true,
            ..seeker
        };
        assert_eq!(list(&blind, None)[7..], ["--without-cameras"]);
    }

    #[test]
    fn a_folder_with_more_than_the_sessions_is_refused() {
        let dir = std::env::temp_dir().join(format!("springtwin-blind-{}", std::process::id()));
        std::fs::create_dir_all(dir.join("suspect")).expect("folder");
        assert!(only_sessions(&dir).is_ok());
        std::fs::write(dir.join("key.json"), "{}").expect("writes");
        let refused = only_sessions(&dir).expect_err("a key");
        assert!(refused.to_string().contains("'key.json' does not belong"));
        std::fs::remove_dir_all(&dir).expect("cleans up");
    }
}
