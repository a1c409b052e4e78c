//! A drive as a log of every tick (CSV) and as pictures (SVG).

use std::fmt::Write as _;
use std::path::Path as FilePath;

use anyhow::{Context as _, Result};
use plotters::prelude::*;

use springtwin::drive::{Driven, Row};
use springtwin::signal::{CHAMBERS, SPRINGS};
use springtwin::task::Path;

/// One tick in so many is drawn.
const DRAWN_EVERY: usize = 5;
/// Colours that stay apart for colour-blind eyes (Okabe and Ito), the first two for wanted and true.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0x00, 0x00, 0x00),
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0x99, 0x99, 0x33),
];

/// A line with its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    /// Dashes: what is wanted, beside what is.
    pub dashed: bool,
    /// Index into the colours.
    pub colour: usize,
}

/// Lines over one pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    pub title: String,
    pub x: &'static str,
    pub y: &'static str,
    pub lines: Vec<Line>,
    pub aspect: Aspect,
}

/// How the axes are scaled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aspect {
    /// Each on its own.
    Free,
    /// Alike.
    Equal,
}

impl Chart {
    /// As SVG.
    pub fn svg(&self) -> Result<String> {
        let mut out = String::new();
        self.draw(&mut out)
            .map_err(|e| anyhow::anyhow!("cannot draw {}: {e}", self.title))?;
        Ok(out)
    }

    fn draw(&self, out: &mut String) -> std::result::Result<(), Box<dyn std::error::Error>> {
        let all = || self.lines.iter().flat_map(|l| &l.points);
        let span = |of: &dyn Fn(&(f64, f64)) -> f64| {
            let (lo, hi) = all()
                .map(of)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| {
                    (lo.min(v), hi.max(v))
                });
            let pad = (0.05 * (hi - lo)).max(1e-3);
            (lo - pad, hi + pad)
        };
        if all().next().is_none() {
            return Err("there is nothing to draw".into());
        }
        let (mut x, mut y) = (span(&|p| p.0), span(&|p| p.1));
        let size = match self.aspect {
            Aspect::Free => (900, 420),
            Aspect::Equal => {
                // The plot itself is square: both axes get the wider span.
                let half = 0.5 * (x.1 - x.0).max(y.1 - y.0);
                let middle = |s: (f64, f64)| 0.5 * (s.0 + s.1);
                let (mx, my) = (middle(x), middle(y));
                x = (mx - half, mx + half);
                y = (my - half, my + half);
                (640, 650)
            }
        };
        let root = SVGBackend::with_string(out, size).into_drawing_area();
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .caption(&self.title, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        chart
            .configure_mesh()
            .max_light_lines(1)
            .x_desc(self.x)
            .y_desc(self.y)
            .draw()?;
        for line in &self.lines {
            let colour = COLOURS[line.colour % COLOURS.len()];
            let points = line.points.iter().copied();
            let drawn = if line.dashed {
                chart.draw_series(DashedLineSeries::new(points, 6, 4, colour.stroke_width(1)))?
            } else {
                chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?
            };
            if !line.name.is_empty() {
                drawn
                    .label(&line.name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour));
            }
        }
        if self.lines.iter().any(|l| !l.name.is_empty()) {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperRight)
                .background_style(WHITE.mix(0.8))
                .border_style(BLACK.mix(0.3))
                .draw()?;
        }
        root.present()?;
        Ok(())
    }
}

fn line(name: impl Into<String>, colour: usize, points: Vec<(f64, f64)>) -> Line {
    Line {
        name: name.into(),
        points,
        dashed: false,
        colour,
    }
}

/// What [`write`] writes; the last one for a path only.
pub const FILES: [&str; 5] = [
    "log.csv",
    "trajectory.svg",
    "pressures.svg",
    "springs.svg",
    "errors.svg",
];

/// Writes [`FILES`] into a folder.
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
    put(way, trajectory(&driven.rows, path, label).svg()?)?;
    put(set, pressures(&driven.rows, label).svg()?)?;
    put(lengths, springs(&driven.rows, label).svg()?)?;
    if !errors_mm.is_empty() {
        put(along, errors(errors_mm, label).svg()?)?;
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
        lines.push(line("wanted", 0, wanted.map(|p| xy(*p)).collect()));
        lines[0].dashed = true;
    }
    let on_path = |r: &&Row| path.is_none() || r.waypoint.is_some();
    let tip = rows.iter().filter(on_path).step_by(DRAWN_EVERY);
    let tip = tip.filter_map(|r| Some(xy(r.truth?.translation.vector.into())));
    lines.push(line("true tip", 2, tip.collect()));
    Chart {
        title: format!("Way of the tip{label}"),
        x: "x, mm",
        y: "y, mm",
        lines,
        aspect: Aspect::Equal,
    }
}

/// Set pressures over time.
fn pressures(rows: &[Row], label: &str) -> Chart {
    let start = start_s(rows);
    let chamber = |i: usize| {
        let points = rows.iter().step_by(DRAWN_EVERY);
        let points = points.filter_map(|r| Some((r.t_s - start, r.set_pa?[i] * 1e-3)));
        line(format!("chamber {}", i + 1), 1 + i, points.collect())
    };
    Chart {
        title: format!("Set pressures{label}"),
        x: "time, s",
        y: "kPa",
        lines: (0..CHAMBERS).map(chamber).collect(),
        aspect: Aspect::Free,
    }
}

/// The first spring of each pair as measured and as wanted.
fn springs(rows: &[Row], label: &str) -> Chart {
    let start = start_s(rows);
    let mut lines = Vec::new();
    for (k, i) in (0..SPRINGS).step_by(2).enumerate() {
        let drawn = || rows.iter().step_by(DRAWN_EVERY);
        let measured = drawn().map(|r| (r.t_s - start, r.sensors[i] * 1e3));
        lines.push(line(format!("spring {}", i + 1), 1 + k, measured.collect()));
        let wanted = drawn().filter_map(|r| Some((r.t_s - start, r.sensor_ref?[i] * 1e3)));
        let mut wanted = line("", 1 + k, wanted.collect());
        wanted.dashed = true;
        lines.push(wanted);
    }
    Chart {
        title: format!("Springs as measured, and their references (dashed){label}"),
        x: "time, s",
        y: "mm",
        lines,
        aspect: Aspect::Free,
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
        lines: vec![line("", 0, zero), line("", 2, points.collect())],
        aspect: Aspect::Free,
    }
}

/// Every tick: time, true and estimated tip, where it shall be, pressures, signals and references.
fn csv(rows: &[Row]) -> String {
    let start = start_s(rows);
    let mut out = String::from(
        "t_s,leg,waypoint,true_x_mm,true_y_mm,true_z_mm,est_x_mm,est_y_mm,est_z_mm,goal_x_mm,goal_y_mm,goal_z_mm",
    );
    for i in 1..=CHAMBERS {
        let _ = write!(out, ",set_{i}_kpa,chamber_{i}_kpa");
    }
    for i in 1..=SPRINGS {
        let _ = write!(out, ",spring_{i}_mm,spring_ref_{i}_mm");
    }
    out.push_str(",solve_us\n");
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
