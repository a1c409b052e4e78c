//! An experiment of the gap finder's own: it drives what separates best, looks, and goes on until something is decided.

use anyhow::Result;
use rand::Rng as _;
use serde::Serialize;

use super::session::{Drive, Excitation};
use crate::gap::{
    self, Belief, CONFIG, Commissioned, Design, Found, FoundEffect, Grid, Healthy, Options,
    Possible, Progress, Table, Verdict,
};
use crate::robot::RobotSpec;
use crate::sim::dataset::sample_rng;
use crate::sim::effects::Trajectory;

/// How long one excitation takes, s.
const SECONDS: [f64; ENDS] = [30.0, 60.0];
const ENDS: usize = 2;
/// Samples of the pressures that the design is computed from, per second.
const RATE_HZ: f64 = 15.0;
/// What a person would drive, one after the other.
const LIST: [Excitation; 8] = [
    Excitation::Mixed,
    Excitation::Loads,
    Excitation::Reversals,
    Excitation::Steps,
    Excitation::Holds,
    Excitation::Single,
    Excitation::Axial,
    Excitation::Sines,
];

/// By what the next excitation is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// By what it is expected to separate.
    #[default]
    Designed,
    /// By chance.
    Random,
    /// Always sines, from slow to fast.
    Chirp,
    /// A fixed list, one minute each.
    List,
}

impl Strategy {
    /// All of them, each with its name.
    pub const ALL: [(Self, &'static str); 4] = [
        (Self::Designed, "designed"),
        (Self::Random, "random"),
        (Self::Chirp, "chirp"),
        (Self::List, "list"),
    ];
}

/// An arm that can be driven: given the round and an excitation, the session that it gave, or why it was not driven to the end.
pub type Arm<'a> = dyn FnMut(usize, &Drive) -> Result<Grid> + 'a;

/// What an experiment is given.
pub struct Experiment<'a> {
    /// The robot.
    pub robot: &'a RobotSpec,
    /// The rig in order.
    pub rig: &'a Commissioned,
    /// Effects that are looked for.
    pub table: Table<'a>,
    /// Declared load, kg.
    pub payload_kg: f64,
    /// Longest time of all excitations together, s.
    pub seconds: f64,
    /// How the next one is chosen.
    pub strategy: Strategy,
    /// Seed of the excitations.
    pub seed: u64,
}

/// One excitation and what was known after it.
#[derive(Clone, Debug, Serialize)]
pub struct Round {
    /// The excitation.
    pub excitation: String,
    /// How long it took, s.
    pub seconds: f64,
    /// Why it was driven.
    pub why: String,
    /// The verdict on all that was measured so far.
    pub verdict: Verdict,
    /// The effects that are named, or of which it is one.
    pub effects: Vec<FoundEffect>,
    /// Share of the effects that would have shown by then at their usual size, 0..1; `None` where nothing was designed.
    pub visible: Option<f64>,
}

/// How an experiment ended.
pub struct Outcome {
    /// Its rounds.
    pub rounds: Vec<Round>,
    /// The finding on all sessions; `None` where no excitation fits into the time.
    pub found: Option<Found>,
    /// Why it ended: one sentence.
    pub ended: &'static str,
}

impl Outcome {
    /// Time of all excitations, s.
    pub fn seconds(&self) -> f64 {
        self.rounds.iter().map(|r| r.seconds).sum()
    }
}

/// What can be driven on a robot, each to its longest time.
fn excitations(robot: &RobotSpec, seed: u64) -> Vec<Drive> {
    let each = LIST.iter().enumerate().map(|(k, e)| {
        let seed = seed.wrapping_mul(100).wrapping_add(k as u64);
        Drive::new(*e, robot, seed, SECONDS[SECONDS.len() - 1])
    });
    each.collect()
}

fn possible(library: &[Drive]) -> Vec<Possible> {
    let one = |drive: &Drive| {
        let seconds = drive.programme().seconds;
        let t_s: Vec<f64> = (0..=(seconds * RATE_HZ) as usize)
            .map(|k| k as f64 / RATE_HZ)
            .collect();
        Possible {
            name: drive.programme().name.clone(),
            ends_s: SECONDS.into(),
            pressures: Trajectory {
                chamber_pa: drive.pumped(&t_s),
                t_s,
            },
        }
    };
    library.iter().map(one).collect()
}

impl Experiment<'_> {
    /// Drives `arm` until something is decided or the time is up. `ask` is given every excitation with the reason for it before
    /// anything moves; an error of it ends the experiment.
    ///
    /// # Errors
    /// When the arm does not follow, the sessions cannot be judged, or it is stopped.
    pub fn run(
        &self,
        arm: &mut Arm<'_>,
        ask: &mut dyn FnMut(&str) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Outcome> {
        let library = excitations(self.robot, self.seed);
        let possible = possible(&library);
        let designed = self.strategy == Strategy::Designed;
        let design = designed
            .then(|| {
                let possible = (&possible[..], self.payload_kg);
                Design::new(self.robot, self.table, self.rig, possible, progress)
            })
            .transpose()?;
        let mut rng = sample_rng(self.seed, 0xe8_9e21);
        let left_out = design.as_ref().map_or_else(Vec::new, Design::left_out);
        let mut driven = design.as_ref().map(Design::nothing_driven);
        let mut belief = design.as_ref().map(Design::at_first);
        let mut grids: Vec<Grid> = Vec::new();
        let mut out = Outcome {
            rounds: Vec::new(),
            found: None,
            ended: match left_out.len() == library.len() {
                true => UNCOVERED,
                false => "The time is up.",
            },
        };
        loop {
            let left_s = self.seconds - out.seconds();
            let n = out.rounds.len();
            let (index, why) = match (&design, &belief, &driven) {
                (Some(design), Some(belief), Some(driven)) => {
                    match design.next(belief, driven, left_s) {
                        Some(p) => (p.index, p.why),
                        None => break,
                    }
                }
                _ => {
                    let index = match self.strategy {
                        Strategy::Random => rng.random_range(0..library.len() * ENDS),
                        Strategy::Chirp => library.len() * ENDS - 1,
                        _ => ENDS * (n % LIST.len()) + ENDS - 1,
                    };
                    if SECONDS[index % ENDS] > left_s {
                        break;
                    }
                    (index, String::new())
                }
            };
            let why = match n {
                0 if !left_out.is_empty() => format!("{why}; {}", not_driven(&left_out)),
                _ => why,
            };
            ask(&why)?;
            let drive = library[index / ENDS].until(SECONDS[index % ENDS]);
            grids.push(arm(n, &drive)?);
            let options = Options {
                seed: self.seed,
                from_start: true,
                ..Options::default()
            };
            let healthy = Healthy::Commissioned(self.rig);
            let found = gap::find(self.robot, self.table, healthy, &grids, &options, progress)?;
            if let (Some(design), Some(driven)) = (&design, &mut driven) {
                design.drove(index, driven);
                let left_s = left_s - SECONDS[index % ENDS];
                belief = Some(design.after(&found.finding, driven, left_s));
            }
            let visible = design
                .as_ref()
                .zip(driven.as_ref())
                .map(|(design, driven)| design.visible_share(driven));
            let before = out.rounds.last().map(|r| r.verdict);
            out.rounds.push(Round {
                excitation: drive.programme().name.clone(),
                seconds: drive.programme().seconds,
                why,
                verdict: found.finding.verdict,
                effects: found.finding.effects.clone(),
                visible,
            });
            let settled = belief.as_ref().is_none_or(Belief::is_settled);
            let decided = decided(&found, before, (visible, settled));
            out.found = Some(found);
            if let Some(ended) = decided {
                out.ended = ended;
                break;
            }
        }
        Ok(out)
    }
}

/// Why an experiment without any excitation ends.
const UNCOVERED: &str = "The baseline's sessions move the arm like none of the excitations: commission the rig with sessions of mixed, \
                         steps and axial motion.";

/// What is never proposed, and why.
fn not_driven(left_out: &[String]) -> String {
    format!(
        "not driven, because no session of the baseline moves the arm like that: {}",
        left_out.join(", ")
    )
}

/// Why nothing more has to be driven; none while something is open. `settled`: nothing that could be driven would set what is
/// named further apart from what could take its place.
fn decided(
    found: &Found,
    before: Option<Verdict>,
    (visible, settled): (Option<f64>, bool),
) -> Option<&'static str> {
    let finding = &found.finding;
    match finding.verdict {
        Verdict::Named if settled && finding.sure_and_open().1.is_empty() => {
            Some("The effect is named.")
        }
        Verdict::NothingMissing
            if visible.is_some_and(|share| share >= CONFIG.experiment_visible) =>
        {
            Some("Nothing is missing.")
        }
        Verdict::Unknown if before == Some(Verdict::Unknown) => {
            Some("Something is missing that no effect of the table explains.")
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::Unwatched;
    use crate::lab::gap_files::session_of;
    use crate::lab::session::{SessionPlan, Specimen, session_log};
    use crate::rig::hidden::Hidden;
    use crate::sim::effects;

    /// An experiment on unit 7 of the virtual rig with this hidden in it; few effects are looked for, which keeps it short.
    fn ends(hidden: &[Hidden]) -> (Outcome, Vec<String>) {
        let robot = RobotSpec::reference();
        let specimen = Specimen::new(&robot, 7).expect("a rig");
        let grid = |plan: &SessionPlan, drive: Option<&Drive>| -> Result<Grid> {
            let session = match drive {
                Some(drive) => specimen.driven(plan, drive)?,
                None => specimen.session(plan)?,
            };
            Ok(Grid::new(session_of(session_log(session, &robot)))?)
        };
        let healthy = grid(&SessionPlan::default(), None).expect("a session");
        let rig = Commissioned::new(&robot, &[healthy], &Unwatched).expect("a baseline");
        let table: Vec<_> = ["payload", "base-tilt", "creep"]
            .iter()
            .filter_map(|id| effects::effect(id))
            .collect();
        let experiment = Experiment {
            robot: &robot,
            rig: &rig,
            table: &table,
            payload_kg: 0.0,
            seconds: 300.0,
            strategy: Strategy::Designed,
            seed: 1,
        };
        let mut arm = |round: usize, drive: &Drive| {
            let plan = SessionPlan {
                seed: 50 + round as u64,
                seconds: drive.programme().seconds,
                hidden: hidden.to_vec(),
                ..SessionPlan::default()
            };
            grid(&plan, Some(drive))
        };
        let mut asked = Vec::new();
        let mut ask = |why: &str| {
            asked.push(why.to_owned());
            Ok(())
        };
        let out = experiment.run(&mut arm, &mut ask, &Unwatched);
        (out.expect("an experiment"), asked)
    }

    #[test]
    fn a_hidden_load_is_named_and_a_rig_in_order_has_nothing_missing() {
        let (out, asked) = ends(&["payload=0.3".parse().expect("an effect")]);
        let found = out.found.as_ref().expect("a finding");
        assert_eq!(out.ended, "The effect is named.");
        assert_eq!(found.finding.effects[0].id, "payload");
        assert_eq!(asked.len(), out.rounds.len());
        assert!(asked[0].contains("would show"), "{asked:?}");

        let (out, _) = ends(&[]);
        assert_eq!(out.ended, "Nothing is missing.");
        let visible = out.rounds.last().and_then(|r| r.visible);
        assert!(visible.is_some_and(|share| share >= CONFIG.experiment_visible));
        assert!(out.seconds() <= 300.0);
    }
}
