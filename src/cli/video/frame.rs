//! The frames of a film: the arm as the window draws it, beside it what time it is and what the chambers have, below it signals
//! over time with a cursor.

use anyhow::Result;
use egui::{Align2, Color32, FontFamily, FontId, Painter, Pos2, Rect, Stroke, Ui, UiBuilder};
use egui::{pos2, vec2};
use image::RgbaImage;

use super::{Look, Signals};
use springtwin::analysis::history::{Channel, History};
use springtwin::analysis::recorded::origin_name;
use springtwin::charts::svg::{fixed, ticks};
use springtwin::gui::offscreen::Offscreen;
use springtwin::gui::panels::view3d::{Edited, View3d, scene_view};
use springtwin::gui::scene::{self, Scene};
use springtwin::gui::theme::{self, Palette};
use springtwin::gui::view::View;
use springtwin::robot::RobotSpec;
use springtwin::signal::{CHAMBERS, SPRINGS, Snapshot, Trace, spring_name};

/// Height of a frame, points: letters grow with the film.
pub const HIGH: f32 = 720.0;
/// Height of the signals below the arm, points.
const STRIP: f32 = 176.0;
/// Around what stands on the picture, points.
const MARGIN: f32 = 24.0;
/// The arm fills more of the picture than its whole reach would, as a share of the camera's distance.
const NEARER: f32 = 0.86;
/// The arm hangs so much lower in the picture, m: there is nothing to see below the floor.
const LOWER_M: f32 = 0.025;

/// A line of the strip.
struct Curve {
    name: String,
    colour: Color32,
    dashed: bool,
    channel: Channel,
    /// Its pieces: time, s, and value.
    pieces: Vec<Vec<[f64; 2]>>,
}

/// Signals over time.
struct Strip {
    title: &'static str,
    unit: &'static str,
    y: [f64; 2],
    curves: Vec<Curve>,
}

/// Draws frames.
pub struct Frames<'a> {
    robot: &'a RobotSpec,
    trace: &'a Trace,
    history: &'a History,
    range_s: [f64; 2],
    look: Look,
    view3d: View3d,
    strip: Strip,
    has_truth: bool,
}

impl<'a> Frames<'a> {
    /// Prepares the frames of a recording.
    ///
    /// # Errors
    /// The signals that were asked for have no value.
    pub fn new(
        offscreen: &mut Offscreen,
        robot: &'a RobotSpec,
        trace: &'a Trace,
        history: &'a History,
        range_s: [f64; 2],
        look: Look,
    ) -> Result<Self> {
        theme::install(&offscreen.context);
        offscreen.context.set_theme(look.theme);
        let mut scene = Scene::new(offscreen.render_state(), robot);
        scene.camera.distance_m *= NEARER;
        scene.camera.target_m.z += LOWER_M;
        let mut view3d = View3d::default();
        (view3d.scene, view3d.captured) = (Some(scene), true);
        let has = |channel| {
            history
                .values(channel, range_s[0], range_s[1])
                .next()
                .is_some()
        };
        let signals = match look.strip {
            Some(signals) => signals,
            None if has(Channel::Error(6)) => Signals::Error,
            None if has(Channel::Spring(0)) => Signals::Springs,
            None if has(Channel::ChamberMeasured(0)) => Signals::Pressures,
            None => Signals::Tip,
        };
        let strip = Strip::of(signals, history, range_s, look);
        anyhow::ensure!(
            !strip.curves.is_empty(),
            "{} has no {}: choose another --strip",
            trace.name,
            strip.title
        );
        Ok(Self {
            robot,
            trace,
            history,
            range_s,
            look,
            view3d,
            strip,
            has_truth: has(Channel::Truth(0)),
        })
    }

    /// The frame of a time, s since the session's start.
    ///
    /// # Errors
    /// The graphics device fails.
    pub fn frame(&mut self, offscreen: &mut Offscreen, at_s: f64) -> Result<RgbaImage> {
        Ok(offscreen.render(|ui| self.draw(ui, at_s))?)
    }

    /// The newest snapshot at a time.
    fn snapshot(&self, at_s: f64) -> &'a Snapshot {
        let all = &self.trace.snapshots;
        let after = all.partition_point(|s| s.stamp.seconds() <= at_s + 1e-9);
        &all[after.saturating_sub(1)]
    }

    fn draw(&mut self, ui: &mut Ui, at_s: f64) {
        let whole = ui.ctx().content_rect();
        let edge = whole.bottom() - STRIP;
        let upper = Rect::from_min_max(whole.min, pos2(whole.right(), edge));
        let lower = Rect::from_min_max(pos2(whole.left(), edge), whole.max);
        let snapshot = self.snapshot(at_s);
        let view = View {
            snapshot,
            history: self.history,
            near: None,
            now_s: at_s,
            replay: Some(&self.trace.name),
            spec: self.robot,
            simulated: self.trace.simulated,
        };
        let view3d = &mut self.view3d;
        ui.scope_builder(UiBuilder::new().max_rect(upper), |ui| {
            scene_view(view3d, ui, &view, &Edited::default());
        });
        let painter = ui.painter().with_clip_rect(whole);
        self.words(&painter, upper, snapshot, at_s);
        self.pressures(&painter, upper, snapshot);
        let palette = Palette::of(self.look.theme);
        painter.rect_filled(lower, 0.0, palette.panel);
        painter.hline(lower.x_range(), edge, Stroke::new(1.0, palette.line));
        self.strip
            .paint(&painter, lower, (self.range_s, at_s), self.history, palette);
    }

    /// Name, origin and time, and what the marks in the picture are: on the left.
    fn words(&self, painter: &Painter, upper: Rect, snapshot: &Snapshot, at_s: f64) {
        let palette = Palette::of(self.look.theme);
        let mut at = upper.left_top() + vec2(MARGIN, MARGIN - 4.0);
        let put = |at: &mut Pos2, text: &str, size: f32, colour: Color32, family: FontFamily| {
            let font = FontId::new(size, family);
            let rect = painter.text(*at, Align2::LEFT_TOP, text, font, colour);
            at.y = rect.bottom() + 4.0;
        };
        let words = FontFamily::Proportional;
        put(&mut at, &self.trace.name, 22.0, palette.text, words.clone());
        if self.trace.simulated != Some(false) {
            at.y += 2.0;
            let text = origin_name(self.trace.simulated).to_uppercase();
            let font = FontId::new(13.0, words.clone());
            let galley = painter.layout_no_wrap(text, font, palette.text);
            let plate = Rect::from_min_size(at, galley.size() + vec2(16.0, 6.0));
            painter.rect_filled(plate, 4.0, palette.warning_fill);
            painter.galley(at + vec2(8.0, 3.0), galley, palette.text);
            at.y = plate.bottom() + 6.0;
        }
        let time = format!("{at_s:.2} s");
        put(&mut at, &time, 30.0, palette.text, FontFamily::Monospace);
        if self.look.speed != 1.0 {
            let text = format!("speed {}×", fixed_short(self.look.speed));
            put(&mut at, &text, 14.0, palette.weak, words.clone());
        }
        if snapshot.payload_kg > 0.0 {
            let text = format!("payload {:.0} g", snapshot.payload_kg * 1e3);
            put(&mut at, &text, 14.0, palette.weak, words.clone());
        }
        at.y += 8.0;
        let of = scene::colours::Palette::of(match self.look.theme {
            egui::Theme::Dark => scene::Theme::Dark,
            egui::Theme::Light => scene::Theme::Light,
        });
        let mut legend = |colour: scene::colours::Rgb, is_filled: bool, text: &str| {
            let colour = scene::overlay::colour(colour);
            let centre = at + vec2(6.0, 9.0);
            match is_filled {
                true => painter.circle_filled(centre, 5.0, colour),
                false => painter.circle_stroke(centre, 5.0, Stroke::new(2.4, colour)),
            };
            let font = FontId::new(14.0, FontFamily::Proportional);
            let place = at + vec2(20.0, 0.0);
            let rect = painter.text(place, Align2::LEFT_TOP, text, font, palette.text);
            at.y = rect.bottom() + 4.0;
        };
        if snapshot.estimate.is_some() {
            legend(of.predicted, true, "tip by springs and IMUs");
        }
        if self.has_truth {
            legend(of.truth, false, "tip by motion capture");
        }
        if snapshot.goal.is_some() {
            legend(of.goal, false, "goal");
        }
    }

    /// What the chambers have: on the right, below the colours of the springs.
    fn pressures(&self, painter: &Painter, upper: Rect, snapshot: &Snapshot) {
        const ROW: f32 = 19.0;
        const WIDE: f32 = 190.0;
        let Some(sensors) = &snapshot.sensors else {
            return;
        };
        let palette = Palette::of(self.look.theme);
        let font = FontId::new(13.0, FontFamily::Proportional);
        let corner = upper.right_top() + vec2(-22.0 - WIDE, 52.0);
        painter.text(
            corner,
            Align2::LEFT_TOP,
            "chamber pressures / kPa",
            font.clone(),
            palette.weak,
        );
        let limits = &self.robot.pressure;
        let most_pa = limits.max_pa.max(-limits.min_pa).max(1.0);
        for i in 0..CHAMBERS {
            let y = corner.y + ROW * (i as f32 + 1.6);
            let name = format!("{}", i + 1);
            let at = pos2(corner.x, y);
            painter.text(at, Align2::LEFT_CENTER, name, font.clone(), palette.weak);
            let bar = Rect::from_center_size(pos2(corner.x + 79.0, y), vec2(124.0, 10.0));
            painter.rect_filled(bar, 2.0, palette.line.gamma_multiply(0.6));
            let kpa = sensors.chamber_pa[i] * 1e-3;
            let share = (sensors.chamber_pa[i] / most_pa).clamp(-1.0, 1.0) as f32;
            if sensors.health.chambers[i].usable() && kpa.is_finite() {
                let end = bar.center().x + 0.5 * bar.width() * share;
                let middle = bar.center().x;
                let fill = Rect::from_x_y_ranges(middle.min(end)..=middle.max(end), bar.y_range());
                painter.rect_filled(fill, 1.0, palette.signal(Channel::ChamberMeasured(i)));
                let text = fixed(kpa, 1);
                let at = pos2(corner.x + WIDE, y);
                painter.text(at, Align2::RIGHT_CENTER, text, font.clone(), palette.text);
            }
            let zero = Stroke::new(1.0, palette.weak);
            painter.vline(bar.center().x, bar.y_range().expand(1.5), zero);
        }
    }
}

/// A number without needless decimals.
fn fixed_short(x: f64) -> String {
    let text = format!("{x:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

impl Strip {
    fn of(signals: Signals, history: &History, [from_s, to_s]: [f64; 2], look: Look) -> Self {
        let palette = Palette::of(look.theme);
        let curve = |channel, name: String, dashed| Curve {
            name,
            colour: palette.signal(channel),
            dashed,
            channel,
            pieces: history.envelope(channel, from_s, to_s, look.size[0] as usize),
        };
        let plain = |channel, name: &str| curve(channel, name.to_owned(), false);
        let (title, unit, all): (_, _, Vec<Curve>) = match signals {
            Signals::Error => (
                "tip error: distance from motion capture",
                "mm",
                vec![plain(Channel::Error(6), "")],
            ),
            Signals::Springs => {
                let of = |i: usize| {
                    let name = spring_name(i).to_string();
                    curve(Channel::Spring(i), name, !i.is_multiple_of(2))
                };
                ("spring lengths", "mm", (0..SPRINGS).map(of).collect())
            }
            Signals::Pressures => {
                let measured = (0..CHAMBERS).map(|i| {
                    let name = format!("{}", i + 1);
                    curve(Channel::ChamberMeasured(i), name, false)
                });
                let set = (0..CHAMBERS).map(|i| curve(Channel::ChamberSet(i), String::new(), true));
                let title = "chamber pressures, dashed as set";
                (title, "kPa", measured.chain(set).collect())
            }
            Signals::Tip => {
                let names = ["x", "y", "z"].into_iter().enumerate();
                let tip = names.map(|(i, name)| plain(Channel::Tip(i), name));
                ("position of the tip", "mm", tip.collect())
            }
        };
        let curves: Vec<Curve> = all.into_iter().filter(|c| !c.pieces.is_empty()).collect();
        let values = curves.iter().flat_map(|c| c.pieces.iter().flatten());
        let [lo, hi] = values.fold([f64::MAX, f64::MIN], |[lo, hi], p| {
            [lo.min(p[1]), hi.max(p[1])]
        });
        let lo = if signals == Signals::Error { 0.0 } else { lo };
        let pad = (0.08 * (hi - lo)).max(0.05);
        Self {
            title,
            unit,
            y: [
                if signals == Signals::Error {
                    0.0
                } else {
                    lo - pad
                },
                hi + pad,
            ],
            curves,
        }
    }

    fn paint(
        &self,
        painter: &Painter,
        lower: Rect,
        ([from_s, to_s], at_s): ([f64; 2], f64),
        history: &History,
        palette: &Palette,
    ) {
        let small = FontId::new(13.0, FontFamily::Proportional);
        let rect = Rect::from_min_max(
            lower.min + vec2(MARGIN + 44.0, 34.0),
            lower.max - vec2(MARGIN + 76.0, 34.0),
        );
        let span_s = (to_s - from_s).max(1e-3);
        let [lo, hi] = self.y;
        let x = |t: f64| rect.left() + rect.width() * ((t - from_s) / span_s) as f32;
        let y = |v: f64| rect.bottom() - rect.height() * ((v - lo) / (hi - lo)) as f32;
        self.head(painter, lower, rect, &small, palette);
        let grid = Stroke::new(1.0, palette.line.gamma_multiply(0.55));
        for (v, text) in numbers(lo, hi, 4) {
            painter.hline(rect.x_range(), y(v), grid);
            let at = pos2(rect.left() - 8.0, y(v));
            painter.text(at, Align2::RIGHT_CENTER, text, small.clone(), palette.weak);
        }
        for (t, text) in numbers(from_s, from_s + span_s, (rect.width() / 110.0) as usize) {
            painter.vline(x(t), rect.y_range(), grid);
            let at = pos2(x(t), rect.bottom() + 6.0);
            painter.text(at, Align2::CENTER_TOP, text, small.clone(), palette.weak);
        }
        let at = rect.right_bottom() + vec2(14.0, 6.0);
        painter.text(
            at,
            Align2::LEFT_TOP,
            "time / s",
            small.clone(),
            palette.weak,
        );
        let cursor = x(at_s);
        let past = Rect::from_x_y_ranges(rect.left()..=cursor, lower.y_range());
        let to_come = Rect::from_x_y_ranges(cursor..=rect.right(), lower.y_range());
        for (part, opacity, width) in [(to_come, 0.30, 1.4), (past, 1.0, 1.8)] {
            let painter = painter.with_clip_rect(part);
            for curve in &self.curves {
                let stroke = Stroke::new(width, curve.colour.gamma_multiply(opacity));
                for piece in &curve.pieces {
                    let points: Vec<Pos2> = piece.iter().map(|p| pos2(x(p[0]), y(p[1]))).collect();
                    match curve.dashed {
                        true => {
                            painter.extend(egui::Shape::dashed_line(&points, stroke, 6.0, 4.0));
                        }
                        false => {
                            painter.add(egui::Shape::line(points, stroke));
                        }
                    }
                }
            }
        }
        painter.vline(
            cursor,
            rect.y_range().expand(4.0),
            Stroke::new(1.6, palette.text),
        );
        for curve in &self.curves {
            let Some(value) = history.value_at(curve.channel, at_s) else {
                continue;
            };
            if curve.dashed {
                continue;
            }
            painter.circle_filled(pos2(cursor, y(value)), 3.6, curve.colour);
            if self.curves.len() == 1 {
                let at = pos2(rect.right() + 14.0, rect.center().y);
                let text = format!("{} {}", fixed(value, 2), self.unit);
                let font = FontId::new(17.0, FontFamily::Proportional);
                painter.text(at, Align2::LEFT_CENTER, text, font, palette.text);
            }
        }
    }

    /// Title, and the names of the lines in their colours.
    fn head(&self, painter: &Painter, lower: Rect, rect: Rect, font: &FontId, palette: &Palette) {
        let title = format!("{} / {}", self.title, self.unit);
        let at = pos2(rect.left(), lower.top() + 10.0);
        painter.text(at, Align2::LEFT_TOP, title, font.clone(), palette.text);
        let mut right = rect.right();
        for curve in self.curves.iter().rev().filter(|c| !c.name.is_empty()) {
            let at = pos2(right, lower.top() + 10.0);
            let name = curve.name.as_str();
            let text = painter.text(at, Align2::RIGHT_TOP, name, font.clone(), palette.text);
            let y = text.center().y;
            let ends = [pos2(text.left() - 20.0, y), pos2(text.left() - 4.0, y)];
            let stroke = Stroke::new(2.4, curve.colour);
            match curve.dashed {
                true => painter.extend(egui::Shape::dashed_line(&ends, stroke, 5.0, 3.0)),
                false => {
                    painter.line_segment(ends, stroke);
                }
            }
            right = text.left() - 30.0;
        }
    }
}

/// Round values from one to another, about `count` of them, with their texts.
fn numbers(lo: f64, hi: f64, count: usize) -> Vec<(f64, String)> {
    let all = ticks(lo, hi, count.max(2));
    let step = match all[..] {
        [a, b, ..] => b - a,
        _ => 1.0,
    };
    let decimals = (-(step.log10() + 1e-9).floor()).clamp(0.0, 6.0) as usize;
    { all.into_iter() }
        .map(|v| (v, fixed(v, decimals)))
        .collect()
}
