//! Hours of sound motion: nothing stops or holds the arm without a cause.

use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use springtwin::drive::model;
use springtwin::lab::units::Lab;
use springtwin::rig::{Object, RigOptions, Surroundings, Unit};
use springtwin::robot::RobotSpec;
use springtwin::signal::{Goal, Mode};
use springtwin::task::{Follow, Item, PATH_WAYPOINTS, Plan, circle, figure_eight};
use springtwin::twin::Command;

use crate::faults::bench::{Bench, case_in_lab};

/// Loads of the gripper, kg.
const LOADS_KG: [f64; 4] = [0.0, 0.1, 0.25, 0.5];
/// Motion capture of a unit's calibration, s.
const LAB_S: f64 = 600.0;
/// A motion that has not ended after this time is followed by the next, s.
const GIVE_UP_S: f64 = 90.0;

/// A motion like those of an operator's day.
fn motion(rng: &mut Pcg64Mcg, payload_kg: f64, object: &mut bool) -> Command {
    let follow = |path, rng: &mut Pcg64Mcg| Follow {
        path,
        speed_m_s: rng.random_range(1e-3..5e-3),
        laps: 1,
    };
    match rng.random_range(0..10) {
        0 => {
            let centre = [0.0, 0.0, -rng.random_range(0.30..0.32)];
            let path = circle(centre, rng.random_range(0.02..0.05), PATH_WAYPOINTS);
            Plan::follow(follow(path, rng)).map_or(Command::Hold, Command::Start)
        }
        1 => {
            let path = figure_eight([0.0, 0.0, -0.31], 0.05, PATH_WAYPOINTS);
            Plan::follow(follow(path, rng)).map_or(Command::Hold, Command::Start)
        }
        2 if payload_kg == 0.0 && *object => {
            *object = false;
            let item = Item {
                name: "item".to_owned(),
                grasp_m: [-0.06, 0.02, -0.32],
                mass_kg: 0.1,
            };
            Command::Start(Plan::pick_and_place(&[item], [0.06, 0.0, -0.30], 0.03))
        }
        3 => Command::Hold,
        _ => {
            let (radius_m, turn) = (
                rng.random_range(0.0..0.08),
                rng.random_range(0.0..std::f64::consts::TAU),
            );
            let z_m = -rng.random_range(0.28..0.33);
            let [x, y] = [radius_m * turn.cos(), radius_m * turn.sin()];
            Command::Goto(Goal::position([x, y, z_m]))
        }
    }
}

/// Moves for so long; what stopped or held the arm that nobody asked for, and the number of motions that began.
fn day(unit: u64, lab: Option<&Lab>, payload_kg: f64, hours: f64) -> (Vec<String>, u32) {
    let mut rng = Pcg64Mcg::seed_from_u64(unit * 1000 + (payload_kg * 1e3) as u64);
    let options = RigOptions {
        unit: Unit(unit),
        seed: unit,
        surroundings: Surroundings {
            payload_kg,
            ..Surroundings::default()
        },
        objects: vec![Object {
            grasp_m: [-0.06, 0.02, -0.32],
            mass_kg: 0.1,
            held: false,
        }],
        ..RigOptions::default()
    };
    let (mut found, mut motions, mut object) = (Vec::new(), 0, true);
    case_in_lab(&options, lab, |b| {
        b.forget_moments();
        b.tell(Command::DeclarePayload(payload_kg));
        b.tell(Command::Arm);
        b.run(0.1);
        let end_s = b.t_s() + hours * 3600.0;
        while b.t_s() < end_s {
            let asked = motion(&mut rng, payload_kg, &mut object);
            let from_s = b.t_s();
            b.tell(asked.clone());
            b.run(1.0);
            motions += u32::from(b.now.mode == Mode::Moving);
            let limit_s = b.t_s()
                + GIVE_UP_S
                    * if matches!(asked, Command::Start(_)) {
                        3.0
                    } else {
                        1.0
                    };
            while b.now.mode == Mode::Moving && b.t_s() < limit_s {
                b.run(0.2);
            }
            b.run(rng.random_range(0.2..8.0));
            let said = |b: &Bench| {
                let new = b.events.iter().filter(|(t_s, _)| *t_s >= from_s);
                let held = new.filter(|(_, text)| text.contains("olding"));
                held.map(|(t_s, text)| format!("{t_s:.1} s: {text} {asked:?}"))
                    .collect::<Vec<_>>()
            };
            found.extend(said(b));
            if let Mode::Safe(reason) = b.now.mode.clone() {
                found.push(format!("{:.1} s: SAFE ({reason}) {asked:?}", b.t_s()));
                b.reset();
                b.tell(Command::Arm);
                b.run(0.1);
            }
            b.events.clear();
            b.stamps.clear();
        }
    });
    (found, motions)
}

/// Hours on each of these units under each load.
fn days(units: std::ops::RangeInclusive<u64>, hours_each: f64) {
    let (mut all, mut motions, mut days) = (Vec::new(), 0, 0);
    let base = model::model(None).expect("the shipped networks");
    for unit in units {
        // The shipped calibration and networks are those of unit 1.
        let lab = (unit > 1).then(|| {
            Lab::new(&RobotSpec::reference(), Unit(unit), LAB_S, &base).expect("is calibrated")
        });
        let found: Vec<_> = std::thread::scope(|scope| {
            let lab = lab.as_ref();
            let each = LOADS_KG.map(|kg| {
                let thread = std::thread::Builder::new().name(format!("{kg} kg"));
                let day = move || day(unit, lab, kg, hours_each);
                thread.spawn_scoped(scope, day).expect("a thread")
            });
            each.map(|day| day.join().expect("ends")).into()
        });
        for ((found, n), kg) in found.into_iter().zip(LOADS_KG) {
            println!("unit {unit}, {kg} kg: {n} motions, {found:#?}");
            assert!(f64::from(n) > 20.0 * hours_each, "it hardly moved: {n}");
            motions += n;
            days += 1;
            all.extend(found);
        }
    }
    println!(
        "{:.1} h of motion: {motions} motions, {} SAFE or HOLD without a cause",
        hours_each * f64::from(days),
        all.len()
    );
    assert!(all.is_empty(), "{all:#?}");
}

/// For a little while, in every run of the tests.
#[test]
fn nothing_stops_a_sound_arm() {
    days(1..=1, 1.0 / 30.0);
}

/// A day: `cargo test --release --test it -- --ignored nuisance --nocapture`.
#[test]
#[ignore = "24 simulated hours"]
fn nothing_stops_a_sound_arm_for_a_day() {
    days(1..=5, 24.0 / 20.0);
}
