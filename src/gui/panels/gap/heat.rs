//! Residuals over time as a map: one row per channel, one column per instant, in multiples of the noise floor.

use egui::{
    Color32, ColorImage, EventFilter, FontId, Key, Rect, Role, Sense, Shape, Stroke, StrokeKind,
    TextureHandle, TextureOptions, Ui, WidgetInfo, pos2, vec2,
};

use crate::gap::report;
use crate::gui::panels::widgets::number;
use crate::gui::theme::Palette;

/// Residuals up to here occur on a healthy rig, in multiples of the noise floor: grey.
pub const HEALTHY: f64 = 2.0;
/// Columns of the picture at most.
const COLUMNS: usize = 1000;
/// Space for the names of the channels, and for the time axis.
const LEFT: f32 = 66.0;
const BOTTOM: f32 = 18.0;

/// A channel at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cell {
    /// Row of the traces.
    pub channel: usize,
    /// Bin of the grid.
    pub bin: usize,
}

/// The picture, drawn again when its key changes.
#[derive(Default)]
pub struct Cache {
    key: Option<(bool, usize)>,
    texture: Option<TextureHandle>,
}

/// A map.
pub struct HeatMap<'a> {
    /// Names of the rows.
    pub channels: &'a [String],
    /// Times, s.
    pub t_s: &'a [f64],
    /// Interval of the time at which what is missing begins, s.
    pub begins_s: Option<[f64; 2]>,
    /// Residuals in multiples of the noise floor.
    pub rows: &'a [Vec<f64>],
    /// End of the colour scale, in multiples of the noise floor.
    pub end: f64,
    /// Distinguishes the maps that share a cache.
    pub which: usize,
}

/// Share of the colour scale of a residual.
pub fn share(floors: f64, end: f64) -> f64 {
    (floors.abs() - HEALTHY) / (end - HEALTHY).max(1e-9)
}

impl HeatMap<'_> {
    /// A cell in words.
    pub fn words(&self, cell: Cell) -> String {
        let name = self.channels.get(cell.channel).map_or("?", String::as_str);
        let t_s = self.t_s.get(cell.bin).copied().unwrap_or(f64::NAN);
        let row = self.rows.get(cell.channel);
        match row.and_then(|r| r.get(cell.bin)).filter(|v| v.is_finite()) {
            Some(v) => format!(
                "{name} at {} s: {} × noise floor",
                number(t_s, 1),
                number(*v, 1)
            ),
            None => format!("{name} at {} s: no data", number(t_s, 1)),
        }
    }

    fn image(&self, p: &Palette) -> ColorImage {
        let columns = self.t_s.len().clamp(1, COLUMNS);
        let mut pixels = Vec::with_capacity(columns * self.rows.len());
        for row in self.rows {
            let mut whole = row.clone();
            whole.resize(self.t_s.len(), f64::NAN);
            let thin = report::thinned(&whole, columns);
            pixels.extend(thin.into_iter().map(|v| p.heat(share(v, self.end))));
        }
        ColorImage::new([columns, self.rows.len()], pixels)
    }

    /// Draws the map and moves the selection by click, drag and arrow keys.
    pub fn show(&self, ui: &mut Ui, cache: &mut Cache, selected: &mut Cell, size: egui::Vec2) {
        let p = *Palette::in_ui(ui);
        let (n, rows) = (self.t_s.len(), self.rows.len());
        if n == 0 || rows == 0 {
            return;
        }
        let (whole, _) = ui.allocate_exact_size(size, Sense::hover());
        let map = Rect::from_min_max(whole.min + vec2(LEFT, 0.0), whole.max - vec2(2.0, BOTTOM));
        let response = ui.interact(map, ui.scope_id().with("heat map"), Sense::click_and_drag());
        let row_high = map.height() / rows as f32;
        let cell_at = |at: egui::Pos2| Cell {
            channel: (((at.y - map.top()) / row_high) as usize).min(rows - 1),
            bin: (((at.x - map.left()) / map.width() * n as f32) as usize).min(n - 1),
        };
        if (response.clicked() || response.dragged())
            && let Some(at) = response.interact_pointer_pos()
        {
            *selected = cell_at(at);
            response.request_focus();
        }
        self.keys(ui, &response, selected);
        let dark = ui.visuals().dark_mode;
        if cache.key != Some((dark, self.which)) {
            let image = self.image(&p);
            let name = "residuals over time";
            cache.texture = Some(ui.ctx().load_texture(name, image, TextureOptions::NEAREST));
            cache.key = Some((dark, self.which));
        }
        let painter = ui.painter();
        if let Some(texture) = &cache.texture {
            let uv = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
            painter.image(texture.id(), map, uv, Color32::WHITE);
        }
        self.names(ui, map, selected.channel, &p);
        self.time_axis(ui, map, &p);
        self.beginning(ui, map, &p);
        let x = map.left() + (selected.bin as f32 + 0.5) / n as f32 * map.width();
        let y = map.top() + selected.channel as f32 * row_high;
        let row = Rect::from_min_size(pos2(map.left(), y), vec2(map.width(), row_high));
        painter.rect_stroke(row, 0.0, Stroke::new(1.0, p.text), StrokeKind::Outside);
        painter.vline(x, map.y_range(), Stroke::new(1.0, p.text));
        if response.has_focus() {
            painter.rect_stroke(map, 0.0, Stroke::new(2.0, p.bar), StrokeKind::Outside);
        }
        let told = self.words(*selected);
        response.widget_info(|| {
            let mut info = WidgetInfo::labeled(Role::Image, true, "Residual heat map");
            info.current_text_value = Some(told.clone());
            info
        });
        if let Some(at) = response.hover_pos() {
            response.on_hover_text_at_pointer(self.words(cell_at(at)));
        }
    }

    fn keys(&self, ui: &Ui, response: &egui::Response, selected: &mut Cell) {
        if !response.has_focus() {
            return;
        }
        let arrows = EventFilter {
            horizontal_arrows: true,
            vertical_arrows: true,
            ..EventFilter::default()
        };
        ui.memory_mut(|m| m.set_focus_lock_filter(response.id, arrows));
        let [up, down, left, right] = [
            Key::ArrowUp,
            Key::ArrowDown,
            Key::ArrowLeft,
            Key::ArrowRight,
        ]
        .map(|k| ui.input(|i| i.num_presses(k)));
        let moved = |at: usize, plus: usize, minus: usize, most: usize| {
            (at + plus).saturating_sub(minus).min(most - 1)
        };
        selected.channel = moved(selected.channel, down, up, self.rows.len());
        selected.bin = moved(selected.bin, right, left, self.t_s.len());
    }

    fn names(&self, ui: &Ui, map: Rect, selected: usize, p: &Palette) {
        let row_high = map.height() / self.rows.len() as f32;
        let font = FontId::proportional(row_high.clamp(7.0, 11.5));
        let mut group = "";
        for (i, name) in self.channels.iter().enumerate().take(self.rows.len()) {
            let y = map.top() + (i as f32 + 0.5) * row_high;
            let color = if i == selected { p.text } else { p.weak };
            ui.painter().text(
                pos2(map.left() - 5.0, y),
                egui::Align2::RIGHT_CENTER,
                name,
                font.clone(),
                color,
            );
            let word = name.split(' ').next().unwrap_or_default();
            if i > 0 && word != group {
                let top = y - 0.5 * row_high;
                let line = egui::Rangef::new(map.left() - LEFT + 4.0, map.right());
                ui.painter().hline(line, top, Stroke::new(1.0, p.window));
            }
            group = word;
        }
    }

    fn beginning(&self, ui: &Ui, map: Rect, p: &Palette) {
        let (Some(begins_s), Some(from), Some(to)) =
            (self.begins_s, self.t_s.first(), self.t_s.last())
        else {
            return;
        };
        let x =
            |t: f64| map.left() + ((t - from) / (to - from)).clamp(0.0, 1.0) as f32 * map.width();
        let [a, b] = begins_s.map(x);
        for x in [a, b] {
            let line = Shape::dashed_line(
                &[pos2(x, map.top()), pos2(x, map.bottom())],
                Stroke::new(1.0, p.text),
                4.0,
                3.0,
            );
            ui.painter().extend(line);
        }
        let (side, at) = match b + 50.0 < map.right() {
            true => (egui::Align2::LEFT_TOP, b + 3.0),
            false => (egui::Align2::RIGHT_TOP, a - 3.0),
        };
        let font = FontId::proportional(11.5);
        let words = ui
            .painter()
            .layout_no_wrap("begins".to_owned(), font, p.text);
        let rect = side.anchor_size(pos2(at, map.top() + 2.0), words.size());
        ui.painter().rect_filled(rect.expand(2.0), 2.0, p.window);
        ui.painter().galley(rect.min, words, p.text);
    }

    fn time_axis(&self, ui: &Ui, map: Rect, p: &Palette) {
        let (Some(from), Some(to)) = (self.t_s.first(), self.t_s.last()) else {
            return;
        };
        let step = [5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0]
            .into_iter()
            .find(|s| (to - from) / s <= f64::from(map.width() / 70.0))
            .unwrap_or(600.0);
        let mut t = (from / step).ceil() * step;
        while t <= *to {
            let x = map.left() + ((t - from) / (to - from)) as f32 * map.width();
            let painter = ui.painter();
            painter.vline(
                x,
                egui::Rangef::new(map.bottom(), map.bottom() + 3.0),
                Stroke::new(1.0, p.weak),
            );
            painter.text(
                pos2(x, map.bottom() + 4.0),
                egui::Align2::CENTER_TOP,
                format!("{} s", number(t, 0)),
                FontId::proportional(11.0),
                p.weak,
            );
            t += step;
        }
    }
}

/// The colour scale in words and colours.
pub fn legend(ui: &mut Ui, end: f64) {
    let p = *Palette::in_ui(ui);
    let small = |ui: &mut Ui, text: String| {
        ui.label(egui::RichText::new(text).small().color(p.weak));
    };
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 5.0;
        let patch = |ui: &mut Ui, color: Color32| {
            let (rect, _) = ui.allocate_exact_size(vec2(14.0, 10.0), Sense::hover());
            ui.painter().rect_filled(rect, 2.0, color);
            let stroke = Stroke::new(1.0, p.bar);
            ui.painter()
                .rect_stroke(rect, 2.0, stroke, StrokeKind::Inside);
        };
        patch(ui, p.heat(0.0));
        small(
            ui,
            format!("up to {} × noise floor: healthy", number(HEALTHY, 0)),
        );
        ui.add_space(6.0);
        let (rect, _) = ui.allocate_exact_size(vec2(110.0, 10.0), Sense::hover());
        let steps = 55;
        for i in 0..steps {
            let at = |k: i32| rect.left() + rect.width() * k as f32 / steps as f32;
            let bar = Rect::from_x_y_ranges(at(i)..=at(i + 1), rect.y_range());
            let share = f64::from(i) / f64::from(steps - 1);
            ui.painter().rect_filled(bar, 0.0, p.heat(share));
        }
        small(ui, format!("{} × noise floor or more", number(end, 0)));
        ui.add_space(6.0);
        patch(ui, p.heat(f64::NAN));
        small(ui, "no data".into());
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_healthy_rig_leaves_stays_grey_and_words_are_numbers() {
        let p = Palette::of(egui::Theme::Dark);
        for v in [0.0, 1.0, -2.0] {
            assert_eq!(p.heat(share(v, 10.0)), p.line);
        }
        assert_ne!(p.heat(share(-3.0, 10.0)), p.line);
        assert_eq!(p.heat(share(10.0, 10.0)), p.series[5]);
        let map = HeatMap {
            channels: &["tip x".into(), "spring 1".into()],
            t_s: &[0.0, 0.5],
            begins_s: None,
            rows: &[vec![1.0, -7.25], vec![f64::NAN]],
            end: 10.0,
            which: 0,
        };
        let at = |channel, bin| map.words(Cell { channel, bin });
        assert_eq!(at(0, 1), "tip x at 0.5 s: −7.2 × noise floor");
        assert_eq!(at(1, 0), "spring 1 at 0.0 s: no data");
        assert_eq!(at(1, 1), "spring 1 at 0.5 s: no data");
        let image = map.image(p);
        assert_eq!(image.size, [2, 2]);
        assert_eq!(image.pixels[3], p.sunken, "a shorter row ends early");
    }
}
