//! Adds an effect to the gap finder's table, hides it in the virtual rig, and finds it: all simulated.
//!
//! An effect is one `static`: what it is called, its equation, where it shows, its numbers with their bounds, the operator that
//! brings it about, and where a search for it starts. Nothing else in the finder is changed.
//!
//! ```sh
//! cargo run --release --example new_effect
//! ```

use std::error::Error;

use springtwin::gap::{Finding, Grid, Healthy, Options, Unwatched, find};
use springtwin::lab::gap_files::session_of;
use springtwin::lab::session::{SessionPlan, session, session_log};
use springtwin::rig::hidden::Hidden;
use springtwin::robot::RobotSpec;
use springtwin::sim::effects::{
    Effect, Law, Operator, Parameter, Reach, Residual, Side, Start, Target, table,
};

static DEAD_BAND: Effect = Effect {
    id: "spring-dead-band",
    name: "Spring dead band",
    doc: "|l − y| ≤ w/2: the reading follows the length once it has taken up the play w of the hook.",
    source: "backlash; M. Nordin, P.-O. Gutman, Automatica 2002",
    side: Side::Sensing,
    target: Target::Spring,
    parameters: &[Parameter::new("play", "m", 0.0, [0.0, 0.02]).of_departure(0.1)],
    residuals: &[Residual::R3, Residual::R5],
    operator: Operator::Sensors(|call, sensors| {
        let half_m = call.values[0] / 2.0;
        let mut read = sensors.first().map_or([0.0; 12], |s| s.spring_m);
        for row in sensors {
            for i in (0..read.len()).filter(|i| call.hits(*i)) {
                read[i] = read[i].clamp(row.spring_m[i] - half_m, row.spring_m[i] + half_m);
                row.spring_m[i] = read[i];
            }
        }
    }),
    behind_gauge: None,
    also_read: None,
    also_moves: None,
    reach: Reach::Single,
    law: Law::Idealisation,
    gradual: false,
    memory: None,
    starts: |_, _| [1e-3, 3e-3].map(|w| Start::new(&[w], &[0])).to_vec(),
};

/// What is found in a session of the rig in which the hook of spring 4 has a play of 4 mm.
///
/// # Errors
/// When the rig cannot be driven, or the session cannot be judged.
pub fn found(table: &[&'static Effect]) -> Result<Finding, Box<dyn Error>> {
    let robot = RobotSpec::reference();
    let made = |seed: u64, hidden: Vec<Hidden>| -> Result<Grid, Box<dyn Error>> {
        let plan = SessionPlan {
            seed,
            seconds: 60.0,
            hidden,
            ..SessionPlan::default()
        };
        let log = session_log(session(&robot, &plan)?, &robot);
        Ok(Grid::new(session_of(log))?)
    };
    let healthy = made(1, Vec::new())?;
    let suspect = made(2, vec![Hidden::new("seat-stick-slip", Some(3), &[4e-3])?])?;
    let options = Options::default();
    let found = find(
        &robot,
        table,
        Healthy::Sessions(&[healthy]),
        &[suspect],
        &options,
        &Unwatched,
    )?;
    Ok(found.finding)
}

/// The table with the new effect.
pub fn extended() -> Vec<&'static Effect> {
    let mut all = table();
    all.push(&DEAD_BAND);
    all
}

/// Prints the verdict without and with the new effect in the table.
///
/// # Errors
/// As [`found`].
pub fn main() -> Result<(), Box<dyn Error>> {
    for (what, table) in [("without", table()), ("with", extended())] {
        let f = found(&table)?;
        println!(
            "{what} the new effect: {:?}, error {:.2} -> {:.2} {} (simulated)",
            f.verdict, f.gap.before, f.gap.after, f.gap.unit
        );
        for e in f.effects {
            println!("  {}, channel {:?}: {:?}", e.id, e.target, e.params);
        }
    }
    Ok(())
}
