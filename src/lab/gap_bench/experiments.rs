//! Rig seconds to the right name: designed experiments beside random ones, chirps and a fixed list (`gap bench --experiment`).
//!
//! Each case hides one effect in a rig of its own. The finder is given what the rig's boards and motion capture deliver, through
//! [`Arm`], and a baseline from healthy sessions of the same rig; it sees neither the effect nor its size.

use anyhow::Result;
use rand::Rng as _;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::cases::{Answer, Case, case_like};
use super::generator::{ATTEMPTS, kind_of};
use super::laws::share;
use super::suite::Planned;
use crate::gap::score::median;
use crate::gap::{Commissioned, Finding, Grid, Unwatched, Verdict};
use crate::lab::experiment::{Experiment, Outcome, Strategy};
use crate::lab::gap_files::session_of;
use crate::lab::session::{Drive, Excitation, SessionPlan, Specimen, session_log};
use crate::rig::hidden::{Kind, kind};
use crate::robot::RobotSpec;
use crate::sim::dataset::sample_rng;
use crate::sim::effects;

/// Longest time of all excitations of an experiment, s.
const LONGEST_S: f64 = 300.0;
/// Length of the healthy sessions besides the mixed one, s.
const MORE_S: f64 = 60.0;
/// Strongest effects that are hidden, times the floor: what is stronger one session names.
pub const STRENGTH_MAX: f64 = 4.0;

/// How one strategy solved a case.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Solved {
    /// What was hidden, times which floor.
    pub hidden: String,
    /// The strength that the rig reached, times the floor.
    pub strength: f64,
    /// The strategy.
    pub strategy: String,
    /// Whether the effect and nothing else was named, on the right channel.
    pub right: bool,
    /// Whether something was named that was not hidden.
    pub wrong: bool,
    /// Time of all excitations, s.
    pub seconds: f64,
    /// Excitations, in order.
    pub driven: Vec<String>,
    /// The verdict at the end; `None` where no excitation fitted into the time.
    pub verdict: Option<Verdict>,
    /// The effects at the end.
    pub found: Vec<String>,
    /// Most that a set pressure was beyond a limit of the robot at the boards, Pa; 0 where it never was.
    pub beyond_pa: f64,
}

/// All strategies on one case.
///
/// # Errors
/// When no rig can hold the effect, or a session cannot be judged.
pub fn solve(planned: &Planned, robot: &RobotSpec, seconds: f64) -> Result<Vec<Solved>> {
    let effects: Vec<&'static Kind> = planned.effects.iter().filter_map(|id| kind(id)).collect();
    let like = SessionPlan {
        seconds,
        ..SessionPlan::default()
    };
    let mut last = None;
    for attempt in 0..ATTEMPTS {
        let seed = sample_rng(planned.seed, attempt).random();
        let about = kind_of(planned.about);
        let solved = case_like(&like, robot, seed, about, &effects, planned.strength)
            .map_err(anyhow::Error::from)
            .and_then(|case| each(&case, robot, seed));
        match solved {
            Ok(solved) => return Ok(solved),
            Err(e) => last = Some(e),
        }
    }
    Err(last.unwrap_or_else(|| anyhow::anyhow!("no rig was tried")))
}

/// The healthy sessions: that of the case, and two in which the arm is moved as in no mixed one.
fn commissioned_in(mixed: &SessionPlan) -> [SessionPlan; 3] {
    let more = |excitation: Excitation, k: u64| SessionPlan {
        name: format!("healthy, {}", excitation.name()),
        seed: mixed.seed.wrapping_add(k),
        seconds: MORE_S,
        excitation,
        ..mixed.clone()
    };
    [
        mixed.clone(),
        more(Excitation::Steps, 1),
        more(Excitation::Axial, 2),
    ]
}

fn each(case: &Case, robot: &RobotSpec, seed: u64) -> Result<Vec<Solved>> {
    let specimen = Specimen::new(robot, case.commissioning.specimen)?;
    let grid =
        |session| -> Result<Grid> { Ok(Grid::new(session_of(session_log(session, robot)))?) };
    let healthy = commissioned_in(&case.commissioning).map(|plan| grid(specimen.session(&plan)?));
    let healthy = healthy.into_iter().collect::<Result<Vec<Grid>>>()?;
    let rig = Commissioned::new(robot, &healthy, &Unwatched)?;
    let table = effects::table();
    let solved = Strategy::ALL.map(|(strategy, name)| {
        let mut beyond_pa = 0.0_f64;
        let mut arm = |round: usize, drive: &Drive| -> Result<Grid> {
            let plan = SessionPlan {
                name: format!("round {}", round + 1),
                seed: sample_rng(seed, 0xe0 + round).random(),
                seconds: drive.programme().seconds,
                ..case.suspect.clone()
            };
            let session = specimen.driven(&plan, drive)?;
            for pa in session.commanded_pa.as_flattened() {
                let limits = &robot.pressure;
                beyond_pa = beyond_pa.max(pa - limits.max_pa).max(limits.min_pa - pa);
            }
            grid(session)
        };
        let experiment = Experiment {
            robot,
            rig: &rig,
            table: &table,
            payload_kg: case.suspect.payload_kg,
            seconds: LONGEST_S,
            strategy,
            seed: 1,
        };
        let out = experiment.run(&mut arm, &mut |_| Ok(()), &Unwatched)?;
        Ok(scored(case, name, &out, beyond_pa.max(0.0)))
    });
    solved.into_iter().collect()
}

fn scored(case: &Case, strategy: &'static str, out: &Outcome, beyond_pa: f64) -> Solved {
    let finding = out.found.as_ref().map(|f| &f.finding);
    let is_right = |f: &Finding, answer: &Answer| {
        let one = f.effects.len() == 1 && f.verdict == Verdict::Named;
        one && f.effects[0].id == answer.id && f.effects[0].target == answer.target
    };
    let right = match (finding, &case.truth.effects[..]) {
        (Some(f), [answer]) => is_right(f, answer),
        (Some(f), []) => f.verdict == Verdict::NothingMissing,
        _ => false,
    };
    let label =
        |id: &str, target: Option<usize>| target.map_or(id.to_owned(), |t| format!("{id} {t}"));
    let hidden = case.truth.effects.iter().map(|e| label(e.id, e.target));
    Solved {
        hidden: hidden.collect::<Vec<_>>().join(", "),
        strength: case.truth.effects.iter().filter_map(|e| e.reached).sum(),
        strategy: strategy.to_owned(),
        right,
        wrong: !right && finding.is_some_and(|f| f.verdict == Verdict::Named),
        seconds: out.seconds(),
        driven: out
            .rounds
            .iter()
            .map(|r| format!("{} {:.0} s", r.excitation, r.seconds))
            .collect(),
        verdict: finding.map(|f| f.verdict),
        found: finding.map_or_else(Vec::new, |f| {
            f.effects.iter().map(|e| label(&e.id, e.target)).collect()
        }),
        beyond_pa,
    }
}

/// The report as Markdown and JSON.
pub fn report(all: &[Solved], head: &str) -> (String, Value) {
    let mut text = format!(
        "# Experiments of the gap finder\n\nAll figures are from simulated sessions of the virtual rig; nothing here was measured on an arm. {head}\n\n\
         Each case hides one effect, at most {STRENGTH_MAX:.0} times the noise floor in a mixed session of 90 s, or none. The baseline is 90 s of mixed motion and {MORE_S:.0} s each of steps and of motion along the axis. Every strategy has the same \
         excitations of 30 and 60 s to choose from, the same finder and {LONGEST_S:.0} s at most. *designed* drives what separates best and may end with \
         *nothing missing* or *unknown*; the others go on until something is named. Where the right effect was not named, the longest time counts. \
         Brackets: Wilson's 95 % intervals.\n\n\
         | strategy | named right | named wrong | rig seconds to the right name, median | nothing hidden: nothing named | beyond a limit, Pa |\n\
         |---|---|---|---|---|---|\n"
    );
    let mut json = json!({"cases": all});
    for (_, name) in Strategy::ALL {
        let own: Vec<&Solved> = all.iter().filter(|s| s.strategy == name).collect();
        let (nulls, hidden): (Vec<&Solved>, Vec<&Solved>) =
            own.iter().partition(|s| s.hidden.is_empty());
        let right = hidden.iter().filter(|s| s.right).count();
        let wrong = hidden.iter().filter(|s| s.wrong).count();
        let quiet = nulls.iter().filter(|s| !s.wrong).count();
        let mut times: Vec<f64> = hidden
            .iter()
            .map(|s| if s.right { s.seconds } else { LONGEST_S })
            .collect();
        times.sort_by(f64::total_cmp);
        let middle = median(&times);
        let beyond = own.iter().map(|s| s.beyond_pa).fold(0.0, f64::max);
        text += &format!(
            "| {name} | {} | {} | {} | {} | {beyond:.0} |\n",
            share(right, hidden.len()),
            share(wrong, hidden.len()),
            middle.map_or("-".to_owned(), |m| format!("{m:.0}")),
            share(quiet, nulls.len()),
        );
        json[name] = json!({
            "right": right, "wrong": wrong, "of": hidden.len(), "median_s": middle,
            "quiet": quiet, "nulls": nulls.len(), "beyond_pa": beyond,
        });
    }
    text += "\n| hidden | times the floor | strategy | verdict | found | s | driven |\n|---|---|---|---|---|---|---|\n";
    for s in all {
        let verdict = s.verdict.map_or(Value::Null, |v| json!(v));
        text += &format!(
            "| {} | {:.1} | {} | {} | {} | {:.0} | {} |\n",
            if s.hidden.is_empty() {
                "nothing"
            } else {
                &s.hidden
            },
            s.strength,
            s.strategy,
            verdict.as_str().unwrap_or("-"),
            s.found.join(", "),
            s.seconds,
            s.driven.join(", ")
        );
    }
    (text, json)
}
