//! Programmes of set pressures by their purpose, and those of a file.

use std::path::Path;

use anyhow::{Context as _, Result};

use super::learning;
use super::session::excitation::Pumping;
use super::session::{Drive, Excitation};
use crate::recording::SizeLimit;
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::task::Programme;

/// What the baseline of a rig in order needs, with the share of its time: the gap finder drives nothing beyond it.
const COMMISSION: [(Excitation, f64); 3] = [
    (Excitation::Mixed, 3.0 / 7.0),
    (Excitation::Steps, 2.0 / 7.0),
    (Excitation::Axial, 2.0 / 7.0),
];
/// Usual length of it, min.
pub const COMMISSION_MIN: f64 = 3.5;
/// Largest file of pressures.
const FILE: SizeLimit = SizeLimit::of_kind(16 << 20, "a file of pressures");
/// Columns of such a file.
const COLUMNS: [&str; CHAMBERS + 1] = [
    "t_s", "p1_kpa", "p2_kpa", "p3_kpa", "p4_kpa", "p5_kpa", "p6_kpa",
];

/// Motion for `gap commission`: of everything a little, steps, and strokes along the axis.
pub fn commission(robot: &RobotSpec, minutes: f64, seed: u64) -> Programme {
    let part = |(k, (kind, share)): (usize, &(Excitation, f64))| {
        let seed = seed.wrapping_mul(100).wrapping_add(k as u64);
        Drive::new(*kind, robot, seed, 60.0 * minutes * share)
    };
    let parts: Vec<Drive> = COMMISSION.iter().enumerate().map(part).collect();
    in_a_row("commission", robot, &parts)
}

/// Motion for `learn`: the whole workspace, each minute of another kind.
pub fn learn(robot: &RobotSpec, minutes: f64, seed: u64) -> Programme {
    in_a_row("learn", robot, &learning::excitations(robot, minutes, seed))
}

/// One after the other, with a way back to 0 that the pumps follow.
fn in_a_row(name: &str, robot: &RobotSpec, parts: &[Drive]) -> Programme {
    let rate_pa_s = Pumping::of(robot).ramp_pa_s();
    let mut out = Programme {
        name: name.to_owned(),
        ..Programme::default()
    };
    for part in parts {
        let one = part.programme();
        let (start_s, end_pa) = (out.seconds, one.at(one.seconds));
        let end_s = start_s + one.seconds;
        let most_pa = end_pa.iter().fold(0.0_f64, |most, p| most.max(p.abs()));
        let back_s = end_s + (most_pa / rate_pa_s).max(0.1);
        for (i, knots) in out.knots.iter_mut().enumerate() {
            let within = one.knots[i].iter().filter(|k| k[0] < one.seconds - 1e-6);
            // The first one of a part is at the time of the last one before it, both at 0.
            let from = usize::from(!knots.is_empty());
            knots.extend(within.skip(from).map(|[t_s, pa]| [start_s + t_s, *pa]));
            knots.extend([[end_s, end_pa[i]], [back_s, 0.0]]);
        }
        out.seconds = back_s;
    }
    out
}

/// The programme in a CSV file with the columns `t_s, p1_kpa, .., p6_kpa`: times from 0 on, rising; linear in between.
///
/// # Errors
/// When it cannot be read, a number is missing, times do not rise, or a pressure or its rate is beyond the robot's limits.
pub fn of_file(path: &Path, robot: &RobotSpec) -> Result<Programme> {
    let text = FILE.read_text(path)?;
    let name = path.file_stem().map(|s| s.to_string_lossy().into_owned());
    parse(&text, name.unwrap_or_default(), robot).with_context(|| path.display().to_string())
}

fn parse(text: &str, name: String, robot: &RobotSpec) -> Result<Programme> {
    let mut lines = text.lines().enumerate();
    let header = lines.next().map_or("", |(_, line)| line);
    anyhow::ensure!(
        header.split(',').map(str::trim).eq(COLUMNS),
        "its first line has to be {}",
        COLUMNS.join(",")
    );
    let mut out = Programme {
        name,
        ..Programme::default()
    };
    let limits = &robot.pressure;
    let mut before: Option<[f64; CHAMBERS + 1]> = None;
    for (k, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let number = k + 1;
        let row = line.split(',').map(|field| field.trim().parse::<f64>());
        let row: Vec<f64> = row
            .collect::<Result<_, _>>()
            .ok()
            .filter(|row: &Vec<f64>| row.iter().all(|x| x.is_finite()))
            .with_context(|| format!("line {number}: a field is no number"))?;
        let row: [f64; CHAMBERS + 1] = row.try_into().map_err(|row: Vec<f64>| {
            anyhow::anyhow!("line {number}: {} fields in place of 7", row.len())
        })?;
        let (t_s, from_s) = (row[0], before.map_or(0.0, |b| b[0]));
        if before.is_none() && t_s > 0.0 {
            out.knots
                .iter_mut()
                .for_each(|knots| knots.push([0.0, 0.0]));
        }
        anyhow::ensure!(
            t_s >= 0.0 && before.is_none_or(|b| t_s > b[0]),
            "line {number}: times have to begin at 0 or later and to rise, but {t_s} s follows {from_s} s"
        );
        for i in 0..CHAMBERS {
            let pa = 1e3 * row[i + 1];
            anyhow::ensure!(
                (limits.min_pa..=limits.max_pa).contains(&pa),
                "line {number}: {} kPa in chamber {} is beyond the robot's {} to {} kPa",
                row[i + 1],
                i + 1,
                limits.min_pa * 1e-3,
                limits.max_pa * 1e-3
            );
            // From 0 at the beginning.
            let from_pa = before.map_or(0.0, |b| 1e3 * b[i + 1]);
            let rate_pa_s = (pa - from_pa).abs() / (t_s - from_s);
            anyhow::ensure!(
                pa == from_pa || rate_pa_s <= limits.rate_pa_s * 1.001,
                "line {number}: chamber {} would change by {:.1} kPa/s, the robot's fastest is {}",
                i + 1,
                rate_pa_s * 1e-3,
                limits.rate_pa_s * 1e-3
            );
            out.knots[i].push([t_s, pa]);
        }
        out.seconds = t_s;
        before = Some(row);
    }
    anyhow::ensure!(out.seconds > 0.0, "it has no row after 0 s");
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_follow_each_other_from_rest_to_rest_within_the_limits() {
        let robot = RobotSpec::reference();
        for programme in [commission(&robot, 3.5, 1), learn(&robot, 4.0, 1)] {
            assert_eq!(programme.beyond(&robot.pressure), None);
            assert_eq!(programme.at(programme.seconds), [0.0; CHAMBERS]);
            for knots in &programme.knots {
                assert!(knots.windows(2).all(|k| k[0][0] < k[1][0]), "times rise");
            }
            let minutes = programme.seconds / 60.0;
            println!("{}: {minutes:.2} min", programme.name);
            assert!((3.5..5.0).contains(&minutes), "{minutes}");
        }
    }

    #[test]
    fn a_file_is_driven_as_it_stands_or_refused_with_its_line() {
        let robot = RobotSpec::reference();
        let head = COLUMNS.join(",");
        let read = |rows: &str| parse(&format!("{head}\n{rows}"), "mine".to_owned(), &robot);
        let good = read("0,0,0,0,0,0,0\n2, 10,0,0,0,0,-10\n\n4,10,0,0,0,0,0\n").expect("reads");
        assert_eq!(good.at(1.0), [5e3, 0.0, 0.0, 0.0, 0.0, -5e3]);
        assert_eq!(good.seconds, 4.0);
        let later = read("4,20,0,0,0,0,0\n").expect("reads");
        assert_eq!(later.at(2.0)[0], 10e3, "from 0 at the beginning");
        for (rows, words) in [
            ("", "no row"),
            ("0,0,0\n", "line 2: 3 fields"),
            ("0,0,x,0,0,0,0\n", "line 2: a field"),
            ("1,0,0,0,0,0,0\n1,0,0,0,0,0,0\n", "line 3: times"),
            ("9,0,50,0,0,0,0\n", "line 2: 50 kPa in chamber 2"),
            ("1,30,0,0,0,0,0\n", "line 2: chamber 1 would change by 30.0"),
        ] {
            let e = read(rows).expect_err(rows).to_string();
            assert!(e.contains(words), "{e}");
        }
        let other = parse("time,p1\n", String::new(), &robot).expect_err("a header");
        assert!(other.to_string().contains("t_s,p1_kpa"), "{other}");
    }
}
