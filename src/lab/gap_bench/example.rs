//! An example for the gap finder: a pair of sessions, one with a hidden effect.

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context as _, Result};

use super::generator::Maker;
use crate::gap::score::About;
use crate::robot::RobotSpec;

/// Length of the sessions of the example, s.
const EXAMPLE_S: f64 = 45.0;
/// Strength of the hidden effect, times the noise floor.
const EXAMPLE_STRENGTH: f64 = 8.0;
/// Effects that may be hidden in the example.
const EXAMPLE_EFFECTS: [&str; 6] = [
    "payload",
    "spring-calibration",
    "imu-misalignment",
    "base-tilt",
    "pressure-lag",
    "chamber-stiffness",
];
/// Interval of the checks whether the generator is done.
const LOOK: Duration = Duration::from_millis(50);

/// Places of an example.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Example {
    /// Session of the healthy rig.
    pub healthy: PathBuf,
    /// Session with the effect.
    pub suspect: PathBuf,
    /// File with the answer.
    pub answer: PathBuf,
}

/// Has another process of this program make an example in the folder `data`. The answer goes to a folder of its own, and this
/// process does not look into it. An example that is there is taken over. `stage` receives the name of the work. The robot is
/// that of `robot_file`; `None`: the reference robot.
///
/// # Errors
/// When the process cannot be started or fails, or `cancelled` returns true.
pub fn example(
    data: &Path,
    robot: &RobotSpec,
    robot_file: Option<&Path>,
    seed: u64,
    stage: &dyn Fn(&str),
    cancelled: &dyn Fn() -> bool,
) -> Result<Example> {
    // Another robot or another version of this program makes other sessions.
    let name = format!(
        "{}-{}-{seed}",
        &robot.hash[..robot.hash.len().min(8)],
        env!("CARGO_PKG_VERSION")
    );
    let folder = data.join("gap-examples").join(&name);
    let answers = data.join("gap-answers");
    let pair = Example {
        healthy: folder.join("commissioning"),
        suspect: folder.join("suspect"),
        answer: answers.join(format!("{name}.json")),
    };
    // Where there is an answer, there is a whole pair.
    if pair.answer.is_file() && pair.suspect.join("session.toml").is_file() {
        return Ok(pair);
    }
    std::fs::create_dir_all(&answers)
        .with_context(|| format!("cannot create the folder {}", answers.display()))?;
    stage("Simulating two sessions, one with a hidden effect");
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let mut child = example_command(&program, robot_file, &folder, &pair.answer, seed)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start the virtual rig")?;
    let errors = listen(&mut child)?;
    loop {
        if let Some(status) = child.try_wait()? {
            let errors = errors.join().unwrap_or_default();
            return match (status.success(), errors.trim()) {
                (true, _) => Ok(pair),
                (false, "") => Err(anyhow::anyhow!(
                    "the virtual rig ended with {status}: see springtwin rig case --help"
                )),
                (false, text) => Err(anyhow::anyhow!("the virtual rig: {text}")),
            };
        }
        if cancelled() {
            child.kill()?;
            child.wait()?;
            anyhow::bail!("stopped on request");
        }
        std::thread::sleep(LOOK);
    }
}

/// Longest part of a process's standard error that is kept, bytes.
const WORDS_MAX: u64 = 4096;

/// Reads the standard error of a process to its end.
fn listen(child: &mut Child) -> Result<std::thread::JoinHandle<String>> {
    let stderr = child
        .stderr
        .take()
        .context("the virtual rig has no standard error")?;
    std::thread::Builder::new()
        .name("example errors".to_owned())
        .spawn(move || {
            let mut said = Vec::new();
            let mut stderr = stderr;
            let read = std::io::Read::by_ref(&mut stderr)
                .take(WORDS_MAX)
                .read_to_end(&mut said);
            // The rest must flow, or the process would wait for ever.
            if read.is_ok() {
                let _ = std::io::copy(&mut stderr, &mut std::io::sink());
            }
            String::from_utf8_lossy(&said).into_owned()
        })
        .context("cannot start a thread for the virtual rig")
}

/// The process that makes an example, on the robot of `robot_file` (`None`: the reference robot).
pub fn example_command(
    program: &Path,
    robot_file: Option<&Path>,
    folder: &Path,
    answer: &Path,
    seed: u64,
) -> Command {
    let maker = Maker {
        program,
        robot_file,
        proof: false,
        seconds: EXAMPLE_S,
        noise_percent: 0.0,
    };
    let mut command = maker.command(About::Single, seed, EXAMPLE_STRENGTH, folder, answer);
    // A closed window leaves no generator behind.
    command.arg("--with-parent");
    for id in EXAMPLE_EFFECTS {
        command.args(["--one-of", id]);
    }
    command
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn what_the_generator_complains_of_is_heard() {
        let mut child = Command::new("sh")
            .args([
                "-c",
                "echo 'the disk is full' >&2; yes | head -c 300000 >&2; exit 3",
            ])
            .stderr(Stdio::piped())
            .spawn()
            .expect("a shell");
        let words = listen(&mut child).expect("listens");
        assert!(!child.wait().expect("ends").success());
        let said = words.join().expect("heard");
        assert!(said.starts_with("the disk is full") && said.len() as u64 == WORDS_MAX);
    }
}
