//! A drive as a table of every tick (CSV) and as pictures (SVG).

use std::fmt::Write as _;
use std::path::Path as FilePath;

use anyhow::{Context as _, Result};

use crate::charts::{Axes, Chart, Line};
use crate::drive::{Driven, Row};
use crate::signal::{CHAMBERS, SPRINGS};
use crate::task::Path;

/// Interval of the ticks that are drawn.
const DRAWN_EVERY: usize = 5;
/// Files that [`write()`] writes; the last one for a path only.
pub const FILES: [&str; 5] = [
    "log.csv",
    "trajectory.svg",
    "pressures.svg",
    "springs.svg",
    "errors.svg",
];

/// Writes [`FILES`] into a folder; `path` is drawn beside the way of the tip, with `None` nothing is.
///
/// # Errors
/// When nothing was driven, or a file cannot be written.
pub fn write(
    out: &FilePath,
    driven: &Driven,
    path: Option<&Path>,
    errors_mm: &[f64],
) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let put = |name: &str, text: String| {
        let path = out.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    let label = if driven.simulated {
        " (simulated rig)"
    } else {
        ""
    };
    let [log, way, set, lengths, along] = FILES;
    put(log, csv(&driven.rows))?;
    put(way, trajectory(&driven.rows, path, label).svg())?;
    put(set, pressures(&driven.rows, label).svg())?;
    put(lengths, springs(&driven.rows, label).svg())?;
    if !errors_mm.is_empty() {
        put(along, errors(errors_mm, label).svg())?;
    }
    Ok(())
}

fn start_s(rows: &[Row]) -> f64 {
    rows.first().map_or(0.0, |r| r.t_s)
}

/// Seen from below: x and y of the true tip, and of the path.
fn trajectory(rows: &[Row], path: Option<&Path>, label: &str) -> Chart {
    let xy = |p: [f64; 3]| (p[0] * 1e3, p[1] * 1e3);
    let mut lines = Vec::new();
    if let Some(path) = path {
        let wanted = path.waypoints_m.iter().chain(path.waypoints_m.first());
        lines.push(Line::new("wanted", 0, wanted.map(|p| xy(*p)).collect()));
        lines[0].dashed = true;
    }
    let on_path = |r: &&Row| path.is_none() || r.waypoint.is_some();
    let tip = rows.iter().filter(on_path).step_by(DRAWN_EVERY);
    let tip = tip.filter_map(|r| Some(xy(r.truth?.translation.vector.into())));
    lines.push(Line::new("true tip", 2, tip.collect()));
    Chart {
        title: format!("Way of the tip{label}"),
        x: "x, mm",
        y: "y, mm",
        lines,
        axes: Axes::Equal,
    }
}

/// Set pressures over time.
fn pressures(rows: &[Row], label: &str) -> Chart {
    let start = start_s(rows);
    let chamber = |i: usize| {
        let points = rows.iter().step_by(DRAWN_EVERY);
        let points = points.filter_map(|r| Some((r.t_s - start, r.set_pa?[i] * 1e-3)));
        Line::new(format!("chamber {}", i + 1), 1 + i, points.collect())
    };
    Chart {
        title: format!("Set pressures{label}"),
        x: "time, s",
        y: "kPa",
        lines: (0..CHAMBERS).map(chamber).collect(),
        axes: Axes::Free,
    }
}

/// The first spring of each pair as measured and as wanted.
fn springs(rows: &[Row], label: &str) -> Chart {
    let start = start_s(rows);
    let mut lines = Vec::new();
    for (k, i) in (0..SPRINGS).step_by(2).enumerate() {
        let drawn = || rows.iter().step_by(DRAWN_EVERY);
        let measured = drawn().map(|r| (r.t_s - start, r.sensors[i] * 1e3));
        lines.push(Line::new(
            format!("spring {}", i + 1),
            1 + k,
            measured.collect(),
        ));
        let wanted = drawn().filter_map(|r| Some((r.t_s - start, r.sensor_ref?[i] * 1e3)));
        let mut wanted = Line::new("", 1 + k, wanted.collect());
        wanted.dashed = true;
        lines.push(wanted);
    }
    Chart {
        title: format!("Springs as measured, and their references (dashed){label}"),
        x: "time, s",
        y: "mm",
        lines,
        axes: Axes::Free,
    }
}

/// True error at each waypoint.
fn errors(errors_mm: &[f64], label: &str) -> Chart {
    let points = errors_mm
        .iter()
        .enumerate()
        .map(|(k, e)| ((k + 1) as f64, *e));
    let zero = vec![(1.0, 0.0), (errors_mm.len() as f64, 0.0)];
    Chart {
        title: format!("True distance of the tip from each waypoint{label}"),
        x: "waypoint",
        y: "mm",
        lines: vec![Line::new("", 0, zero), Line::new("", 2, points.collect())],
        axes: Axes::Free,
    }
}

/// Names of the columns of a tick, with commas between: time, leg and waypoint, true and estimated tip, where it shall be,
/// set and measured pressures, lengths of the springs and their references, time of the controller.
pub fn columns() -> String {
    let mut out = String::from(
        "t_s,leg,waypoint,true_x_mm,true_y_mm,true_z_mm,est_x_mm,est_y_mm,est_z_mm,goal_x_mm,goal_y_mm,goal_z_mm",
    );
    for i in 1..=CHAMBERS {
        let _ = write!(out, ",set_{i}_kpa,chamber_{i}_kpa");
    }
    for i in 1..=SPRINGS {
        let _ = write!(out, ",spring_{i}_mm,spring_ref_{i}_mm");
    }
    out + ",solve_us"
}

fn csv(rows: &[Row]) -> String {
    let start = start_s(rows);
    let mut out = columns() + "\n";
    let number =
        |v: Option<f64>, digits: usize| v.map_or(String::new(), |v| format!("{v:.digits$}"));
    for r in rows {
        let waypoint = r.waypoint.map_or(String::new(), |k| k.to_string());
        let _ = write!(out, "{:.3},{},{waypoint}", r.t_s - start, r.legs_done);
        let truth = r.truth.map(|p| p.translation.vector.into());
        let estimate = r.estimate.map(|p| p.translation.vector.into());
        let wanted = r.via_m.or(r.goal.as_ref().map(|g| g.position_m));
        for point in [truth, estimate, wanted] {
            for k in 0..3 {
                let value = point.map(|p: [f64; 3]| p[k] * 1e3);
                let _ = write!(out, ",{}", number(value, 4));
            }
        }
        for i in 0..CHAMBERS {
            let set = number(r.set_pa.map(|q| q[i] * 1e-3), 4);
            let _ = write!(out, ",{set},{:.4}", r.chamber_pa[i] * 1e-3);
        }
        for i in 0..SPRINGS {
            let wanted = number(r.sensor_ref.map(|s| s[i] * 1e3), 4);
            let _ = write!(out, ",{:.4},{wanted}", r.sensors[i] * 1e3);
        }
        let _ = writeln!(out, ",{}", number(r.solve_s.map(|s| s * 1e6), 1));
    }
    out
}
