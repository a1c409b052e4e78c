//! Makes cases: two sessions in a folder, the answer key elsewhere.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result};
use nalgebra::{UnitQuaternion, Vector3};
use rand::Rng as _;

use super::cases::{Answer, Case, CaseKind, Value, case_like};
use super::suite::Planned;
use crate::gap::score::{About, Key, KeyEffect, KeyValue};
use crate::lab::session::{Excitation, Session, SessionPlan, Specimen, session_log};
use crate::lab::shards::write;
use crate::recording::write_session;
use crate::rig::hidden::{Growth, Kind, kind};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, SPRINGS};
use crate::sim::dataset::{normal, sample_rng};

/// Rigs that are tried for a case before it is given up.
pub(super) const ATTEMPTS: usize = 5;

/// Options of one case.
#[derive(Clone, Debug)]
pub struct CaseOptions {
    /// Folder for the sessions commissioning/ and suspect/.
    pub out: PathBuf,
    /// File for the answer, outside of that folder.
    pub key: PathBuf,
    /// Seed of everything.
    pub seed: u64,
    /// Kind of case.
    pub about: About,
    /// Strength of every effect, times the noise floor.
    pub strength: f64,
    /// The hidden effects.
    pub effects: Vec<&'static Kind>,
    /// One of these is hidden, too, drawn by the seed; none if empty.
    pub one_of: Vec<&'static Kind>,
    /// Length of the sessions, s.
    pub seconds: f64,
    /// Noise beyond that of the sensors, per cent of what each channel moves by.
    pub noise_percent: f64,
    /// With a third session, proof/, in which the same is hidden under another excitation.
    pub proof: bool,
}

/// Folder of the session that a law is proved on.
pub const PROOF: &str = "proof";

/// Folders of a case's sessions.
pub const SESSIONS: [&str; 2] = ["commissioning", "suspect"];

/// Makes a case: both sessions, and the answer elsewhere.
///
/// # Errors
/// When the key would lie in the folder of the sessions, no rig can hold the effects, or a file cannot be written.
pub fn make_case(o: &CaseOptions, robot: &RobotSpec) -> Result<()> {
    let (key, out) = (std::path::absolute(&o.key)?, std::path::absolute(&o.out)?);
    anyhow::ensure!(
        !key.starts_with(&out),
        "the key {} would lie in the case's folder: name a place outside of it",
        o.key.display()
    );
    let (case, logs) = draw(o, robot)?;
    for (i, (name, mut log)) in SESSIONS.into_iter().chain([PROOF]).zip(logs).enumerate() {
        if o.noise_percent > 0.0 {
            add_noise(
                &mut log,
                o.noise_percent / 100.0,
                &mut sample_rng(o.seed, NOISE_STREAM + i),
            );
        }
        write_session(&out.join(name), &session_log(log, robot))?;
    }
    // Last: where there is a key, there is a whole case.
    write(&key, &serde_json::to_string_pretty(&key_of(&case))?)
}

/// First random stream of the noise that is added.
const NOISE_STREAM: usize = 0x4015;

/// Adds white noise to gauges, springs, IMUs and motion capture: this share of the standard deviation of each channel.
fn add_noise(log: &mut Session, share: f64, rng: &mut impl rand::Rng) {
    for i in 0..CHAMBERS {
        noisy(log.chamber_pa.iter_mut().map(|row| &mut row[i]), share, rng);
    }
    for i in 0..SPRINGS {
        noisy(
            log.sensors.iter_mut().map(|s| &mut s.spring_m[i]),
            share,
            rng,
        );
    }
    for i in 0..IMUS {
        for a in 0..3 {
            noisy(
                log.sensors.iter_mut().map(|s| &mut s.imu_ypr_rad[i][a]),
                share,
                rng,
            );
        }
    }
    for a in 0..3 {
        noisy(
            log.captured
                .iter_mut()
                .flatten()
                .map(|p| &mut p.translation.vector[a]),
            share,
            rng,
        );
    }
    // Turns against the first pose, as vectors, so that no angle wraps.
    let Some(first) = log.captured.iter().flatten().next().map(|p| p.rotation) else {
        return;
    };
    let mut turns: Vec<Vector3<f64>> = log
        .captured
        .iter()
        .flatten()
        .map(|p| (first.inverse() * p.rotation).scaled_axis())
        .collect();
    for a in 0..3 {
        noisy(turns.iter_mut().map(|w| &mut w[a]), share, rng);
    }
    for (pose, turn) in log.captured.iter_mut().flatten().zip(turns) {
        pose.rotation = first * UnitQuaternion::from_scaled_axis(turn);
    }
}

/// Adds white noise to one channel, missing values aside.
fn noisy<'a>(channel: impl Iterator<Item = &'a mut f64>, share: f64, rng: &mut impl rand::Rng) {
    let mut known: Vec<&mut f64> = channel.filter(|x| x.is_finite()).collect();
    let n = known.len().max(1) as f64;
    let mean = known.iter().map(|x| **x).sum::<f64>() / n;
    let sd = (known.iter().map(|x| (**x - mean).powi(2)).sum::<f64>() / n).sqrt();
    for x in &mut known {
        **x += share * sd * normal(rng);
    }
}

/// The case and its sessions; rigs that cannot hold the hidden effects are passed over.
fn draw(o: &CaseOptions, robot: &RobotSpec) -> Result<(Case, Vec<Session>)> {
    let plan = SessionPlan {
        seconds: o.seconds,
        ..SessionPlan::default()
    };
    let mut effects = o.effects.clone();
    if !o.one_of.is_empty() {
        let drawn = sample_rng(o.seed, ATTEMPTS).random_range(0..o.one_of.len());
        effects.push(o.one_of[drawn]);
    }
    let mut last = None;
    for attempt in 0..ATTEMPTS {
        let seed = sample_rng(o.seed, attempt).random();
        let made = case_like(&plan, robot, seed, kind_of(o.about), &effects, o.strength).and_then(
            |case| {
                let specimen = Specimen::new(robot, case.commissioning.specimen)?;
                let mut logs = vec![
                    specimen.session(&case.commissioning)?,
                    specimen.session(&case.suspect)?,
                ];
                if o.proof {
                    logs.push(specimen.session(&SessionPlan {
                        name: PROOF.to_owned(),
                        seed: case.suspect.seed.wrapping_add(1),
                        excitation: Excitation::Sines,
                        ..case.suspect.clone()
                    })?);
                }
                Ok((case, logs))
            },
        );
        match made {
            Ok(made) => return Ok(made),
            Err(e) => last = Some(e),
        }
    }
    match last {
        Some(e) => Err(e.into()),
        None => anyhow::bail!("no rig was tried"),
    }
}

pub(super) fn kind_of(about: About) -> CaseKind {
    match about {
        About::Single => CaseKind::Single,
        About::Null => CaseKind::Null,
        About::Alien => CaseKind::Unmodelled,
        About::Pair => CaseKind::Pair,
        About::Begun => CaseKind::Begun,
    }
}

fn key_of(case: &Case) -> Key {
    Key {
        kind: match case.truth.kind {
            CaseKind::Single => About::Single,
            CaseKind::Null => About::Null,
            CaseKind::Unmodelled => About::Alien,
            CaseKind::Pair => About::Pair,
            CaseKind::Begun => About::Begun,
        },
        strength: case.truth.strength,
        effects: case.truth.effects.iter().map(key_effect).collect(),
        onset_s: case.truth.onset_s,
    }
}

fn key_effect(answer: &Answer) -> KeyEffect {
    let magnitudes = kind(answer.id).map_or(&[][..], |k| k.magnitudes);
    let value = |(name, v): (&&'static str, &Value)| {
        let linear = magnitudes
            .iter()
            .find(|m| m.name == *name && m.growth == Growth::Linear);
        let value = KeyValue {
            value: v.value,
            unit: v.unit.to_owned(),
            none: linear.map(|m| m.none),
        };
        ((*name).to_owned(), value)
    };
    KeyEffect {
        id: answer.id.to_owned(),
        target: answer.target,
        params: answer.params.iter().map(value).collect(),
        // JSON has no infinity: what the rig could not carry out is as strong as can be.
        reached: answer.reached.map(|r| r.min(1e3)),
        capped: answer.capped,
    }
}

/// Starts generators.
pub struct Maker<'a> {
    /// This program.
    pub program: &'a Path,
    /// Robot file; `None`: the reference robot.
    pub robot_file: Option<&'a Path>,
    /// Length of the sessions, s.
    pub seconds: f64,
    /// Noise beyond that of the sensors, per cent of what each channel moves by.
    pub noise_percent: f64,
    /// With a session to prove a law on.
    pub proof: bool,
}

impl Maker<'_> {
    /// The process that makes a case; the hidden effects are further arguments.
    pub fn command(
        &self,
        about: About,
        seed: u64,
        strength: f64,
        folder: &Path,
        key: &Path,
    ) -> Command {
        let about = match about {
            About::Single => "single",
            About::Null => "null",
            About::Alien => "alien",
            About::Pair => "pair",
            About::Begun => "begun",
        };
        let mut command = Command::new(self.program);
        if let Some(file) = self.robot_file {
            command.arg("--robot").arg(file);
        }
        // What a case that was stopped has left is made again.
        command.args(["rig", "case", "--overwrite", "--kind", about]);
        command.arg("--out").arg(folder).arg("--key").arg(key);
        command.args(["--seed", &seed.to_string()]);
        command.args(["--strength", &strength.to_string()]);
        command.args(["--seconds", &self.seconds.to_string()]);
        command.args(["--extra-noise", &self.noise_percent.to_string()]);
        if self.proof {
            command.arg("--proof");
        }
        command
    }

    /// Has a case made, unless it is there.
    pub(super) fn make(&self, planned: &Planned, folder: &Path, key: &Path) -> Result<()> {
        if key.exists() && folder.join("suspect").join("session.toml").exists() {
            return Ok(());
        }
        let mut command = self.command(planned.about, planned.seed, planned.strength, folder, key);
        for id in &planned.effects {
            command.args(["--effect", id]);
        }
        let out = command
            .stdin(Stdio::null())
            .output()
            .context("cannot start the generator")?;
        let said = String::from_utf8_lossy(&out.stderr);
        anyhow::ensure!(out.status.success(), "{}", said.trim());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_a_share_of_what_a_channel_moves_by() {
        let clean: Vec<f64> = (0..5000).map(|k| f64::from(k % 100)).collect();
        let mut noisier = clean.clone();
        noisier[7] = f64::NAN;
        noisy(noisier.iter_mut(), 0.05, &mut sample_rng(1, 0));
        assert!(noisier[7].is_nan());
        let added = clean.iter().zip(&noisier).map(|(a, b)| (b - a).powi(2));
        let sd = (added.filter(|x| x.is_finite()).sum::<f64>() / 4999.0).sqrt();
        let expected = 0.05 * (9999.0_f64 / 12.0).sqrt();
        assert!((sd / expected - 1.0).abs() < 0.05, "{sd} for {expected}");
    }
}
