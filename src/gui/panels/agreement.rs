//! The light in the top bar: whether twin and arm agree, with how that was in the last minutes.

use egui::{Color32, Rect, Stroke, Ui, pos2};

use super::widgets::number;
use crate::analysis::history::Channel;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;

/// The sparkline shows so much, s.
const SPARK_S: f64 = 300.0;
/// Its width, points.
pub const SPARK: f32 = 48.0;
/// Its scale never ends below this ratio: the limit is seen.
const LEAST: f64 = 1.25;

/// What the light shows.
pub struct Light {
    /// How abnormal it is.
    pub level: Level,
    /// Glyph, word and ratio.
    pub text: String,
    /// What it means, and what a click does.
    pub hover: String,
}

/// The light of the live twin.
pub fn light(live: &View<'_>) -> Light {
    let s = live.snapshot;
    let normal = |text: &str, hover: &str| Light {
        level: Level::Normal,
        text: text.to_owned(),
        hover: hover.to_owned(),
    };
    let Some(d) = &s.disagreement else {
        return match s.is_monitored {
            true => normal(
                "○ settling",
                "A monitor compares twin and arm; its first verdict comes after some seconds of readings.",
            ),
            false => normal(
                "○ no baseline",
                "Nothing compares twin and arm: no healthy session of this rig was kept as its baseline. Click to see how to get one.",
            ),
        };
    };
    let off = d.is_off();
    let ratio = number(d.ratio, 1);
    let hover = format!(
        "How far twin and arm disagree, over the limit: most in {}; in order until {:.0} s ago.{} The line: the last 5 min, limit \
         dashed. Click to find out what is missing.",
        d.channel,
        (s.stamp.seconds() - d.since_s).max(0.0),
        if off { d.looks_like() } else { String::new() }
    );
    Light {
        level: if off { Level::Warning } else { Level::Normal },
        text: match off {
            true => format!("{} disagrees {ratio}", Level::Warning.glyph()),
            false => format!("{} agrees {ratio}", Level::Normal.glyph()),
        },
        hover,
    }
}

/// The ratio over the last minutes: lines of points, both coordinates 0..1 (right, up), and the height of the limit.
pub struct Spark {
    lines: Vec<Vec<[f32; 2]>>,
    limit: f32,
}

/// The sparkline of the live twin; `None` where nothing was judged.
pub fn spark(live: &View<'_>) -> Option<Spark> {
    let from_s = live.now_s - SPARK_S;
    let history = live.history;
    let lines = history.envelope(Channel::Disagreement, from_s, live.now_s, SPARK as usize);
    let points = || lines.iter().flatten();
    let top = points().map(|q| q[1]).reduce(f64::max)?.max(LEAST);
    let unit = |q: &[f64; 2]| [((q[0] - from_s) / SPARK_S) as f32, (q[1] / top) as f32];
    Some(Spark {
        lines: lines
            .iter()
            .map(|line| line.iter().map(unit).collect())
            .collect(),
        limit: (1.0 / top) as f32,
    })
}

impl Spark {
    /// Draws it.
    pub fn paint(&self, ui: &Ui, rect: Rect, color: Color32) {
        let painter = ui.painter();
        let p = Palette::in_ui(ui);
        let at = |[u, v]: [f32; 2]| {
            pos2(
                rect.left() + u * rect.width(),
                rect.bottom() - v * rect.height(),
            )
        };
        let limit = [at([0.0, self.limit]), at([1.0, self.limit])];
        painter.extend(egui::Shape::dashed_line(
            &limit,
            Stroke::new(1.0, p.line),
            3.0,
            2.0,
        ));
        for line in &self.lines {
            let points = line.iter().map(|q| at(*q)).collect();
            painter.line(points, Stroke::new(1.3, color));
        }
    }
}
