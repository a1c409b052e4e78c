//! Light and dark: restrained grey, colour only for what is abnormal, and a fixed colour per signal.
//!
//! Every colour a text can have stands in [`Palette`]; a test computes its contrast (WCAG 2.2, at
//! least 4.5:1) against every surface it is drawn on, and 3:1 for lines and marks. The series are
//! chosen to stay apart for protanopes, deuteranopes and tritanopes, which a test simulates.

use egui::{Color32, CornerRadius, FontFamily, FontId, Margin, Stroke, TextStyle, Theme, vec2};

use crate::analysis::history::Channel;

/// How abnormal something is. Always shown as glyph and text beside the colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// As it should be: grey.
    Normal,
    /// Worth a look.
    Warning,
    /// Motion has stopped or must not start.
    Critical,
}

impl Level {
    /// The glyph that goes with the colour.
    pub fn glyph(self) -> &'static str {
        match self {
            Self::Normal => "●",
            Self::Warning => "▲",
            Self::Critical => "⊗",
        }
    }
}

/// The colours of one theme.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Palette {
    /// Behind the panels.
    pub window: Color32,
    /// Panels.
    pub panel: Color32,
    /// Buttons and badges.
    pub raised: Color32,
    /// Buttons under the pointer.
    pub hovered: Color32,
    /// Text fields and plots.
    pub sunken: Color32,
    /// Lines between things.
    pub line: Color32,
    /// Text.
    pub text: Color32,
    /// Text of lesser importance.
    pub weak: Color32,
    /// What is selected: fill under [`Self::text`].
    pub selected: Color32,
    /// Bars of normal values.
    pub bar: Color32,
    /// Ticks of what is ready.
    pub ready: Color32,
    /// Text and marks of warnings.
    pub warning: Color32,
    /// Text and marks of critical states.
    pub critical: Color32,
    /// Fill of the stop button and critical banners, under [`Self::on_critical`].
    pub critical_fill: Color32,
    /// Text on [`Self::critical_fill`].
    pub on_critical: Color32,
    /// Fill of warning banners, under [`Self::text`].
    pub warning_fill: Color32,
    /// One colour per signal of a group of up to six.
    pub series: [Color32; 6],
}

const DARK: Palette = Palette {
    window: Color32::from_rgb(0x14, 0x16, 0x19),
    panel: Color32::from_rgb(0x1d, 0x20, 0x24),
    raised: Color32::from_rgb(0x2b, 0x2f, 0x35),
    hovered: Color32::from_rgb(0x39, 0x3f, 0x47),
    sunken: Color32::from_rgb(0x12, 0x14, 0x17),
    line: Color32::from_rgb(0x3a, 0x40, 0x48),
    text: Color32::from_rgb(0xe8, 0xea, 0xed),
    weak: Color32::from_rgb(0xa9, 0xb0, 0xb8),
    selected: Color32::from_rgb(0x3b, 0x50, 0x66),
    bar: Color32::from_rgb(0x7d, 0x88, 0x94),
    ready: Color32::from_rgb(0x5f, 0xd3, 0x8f),
    warning: Color32::from_rgb(0xff, 0xb9, 0x4f),
    critical: Color32::from_rgb(0xff, 0x8d, 0x83),
    critical_fill: Color32::from_rgb(0xc6, 0x28, 0x28),
    on_critical: Color32::WHITE,
    warning_fill: Color32::from_rgb(0x4d, 0x3a, 0x14),
    series: [
        Color32::from_rgb(0x54, 0xc3, 0xff),
        Color32::from_rgb(0xfa, 0xb0, 0x13),
        Color32::from_rgb(0x04, 0xab, 0x74),
        Color32::from_rgb(0xef, 0x57, 0x2a),
        Color32::from_rgb(0xdf, 0xa2, 0xc9),
        Color32::from_rgb(0xfb, 0xf7, 0x5b),
    ],
};

const LIGHT: Palette = Palette {
    window: Color32::from_rgb(0xe4, 0xe7, 0xea),
    panel: Color32::from_rgb(0xf6, 0xf7, 0xf8),
    raised: Color32::from_rgb(0xe3, 0xe6, 0xe9),
    hovered: Color32::from_rgb(0xd3, 0xd8, 0xdd),
    sunken: Color32::from_rgb(0xff, 0xff, 0xff),
    line: Color32::from_rgb(0xc2, 0xc8, 0xce),
    text: Color32::from_rgb(0x17, 0x1a, 0x1e),
    weak: Color32::from_rgb(0x4b, 0x53, 0x5c),
    selected: Color32::from_rgb(0xbf, 0xd0, 0xe0),
    bar: Color32::from_rgb(0x7b, 0x86, 0x92),
    ready: Color32::from_rgb(0x16, 0x66, 0x3a),
    warning: Color32::from_rgb(0x7d, 0x48, 0x00),
    critical: Color32::from_rgb(0xa8, 0x1c, 0x16),
    critical_fill: Color32::from_rgb(0xc6, 0x28, 0x28),
    on_critical: Color32::WHITE,
    warning_fill: Color32::from_rgb(0xff, 0xe6, 0xb8),
    series: [
        Color32::from_rgb(0x0c, 0x81, 0xc9),
        Color32::from_rgb(0xb5, 0x84, 0x00),
        Color32::from_rgb(0x00, 0x6b, 0x50),
        Color32::from_rgb(0xb2, 0x24, 0x08),
        Color32::from_rgb(0xca, 0x5d, 0x95),
        Color32::from_rgb(0x30, 0x28, 0x66),
    ],
};

impl Palette {
    /// The colours of a theme.
    pub fn of(theme: Theme) -> &'static Self {
        match theme {
            Theme::Dark => &DARK,
            Theme::Light => &LIGHT,
        }
    }

    /// The colours the given piece of window is drawn in.
    pub fn in_ui(ui: &egui::Ui) -> &'static Self {
        if ui.visuals().dark_mode {
            &DARK
        } else {
            &LIGHT
        }
    }

    /// Colour of a sentence at a level: plain text when all is well.
    pub fn level_text(&self, level: Level) -> Color32 {
        match level {
            Level::Normal => self.text,
            level => self.level(level),
        }
    }

    /// Colour of text and marks at a level.
    pub fn level(&self, level: Level) -> Color32 {
        match level {
            Level::Normal => self.weak,
            Level::Warning => self.warning,
            Level::Critical => self.critical,
        }
    }

    /// Colour of a magnitude, `share` 0..1 of the scale's end: grey where nothing is abnormal, then ever
    /// further from the background's luminance, so that it reads in every kind of colour vision. A share
    /// that is no number has the colour of no data.
    pub fn heat(&self, share: f64) -> Color32 {
        if !share.is_finite() {
            return self.sunken;
        }
        // From the grey of lines through the series in the order of their luminance.
        let [_, amber, _, red, _, end] = self.series;
        let stops = if luma(self.window) < 0.5 {
            [self.line, red, amber, end]
        } else {
            [self.line, amber, red, end]
        };
        let at = share.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
        let i = (at as usize).min(stops.len() - 2);
        stops[i].lerp_to_gamma(stops[i + 1], (at - i as f64) as f32)
    }

    /// The colour of a patch that is tried beside the twin's own model.
    pub fn tried(&self) -> Color32 {
        self.series[4]
    }

    /// The colour of a signal, the same on every screen. Springs share the colour of their X pair
    /// (the second of a pair is drawn dashed), set pressures that of their chamber; ground truth is
    /// neutral.
    pub fn signal(&self, channel: Channel) -> Color32 {
        match channel {
            Channel::Spring(i) | Channel::SpringRaw(i) | Channel::SpringResidual(i) => {
                self.series[i / 2]
            }
            Channel::Imu(i, _) | Channel::Gyro(i, _) | Channel::ImuResidual(i, _) => self.series[i],
            Channel::Payload | Channel::Disagreement => self.text,
            Channel::SpringTried(_) | Channel::ImuTried(..) => self.tried(),
            Channel::ChamberMeasured(i) | Channel::ChamberSet(i) => self.series[i],
            Channel::Tip(i) => self.series[i],
            Channel::Truth(_) => self.text,
            Channel::Error(i) => self.series[if i < 6 { i } else { 0 }],
        }
    }
}

// Rough luminance, 0..1.
fn luma(c: Color32) -> f64 {
    (0.2126 * f64::from(c.r()) + 0.7152 * f64::from(c.g()) + 0.0722 * f64::from(c.b())) / 255.0
}

/// Sets both themes' styles, and lets the monospace font supply the signs (●, ▲, ⊗ …) that the
/// text font has not. Idempotent; call once before the first frame.
pub fn install(ctx: &egui::Context) {
    let mut fonts = egui::FontDefinitions::default();
    let signs = fonts.families.get(&FontFamily::Monospace).cloned();
    if let (Some(text), Some(signs)) = (fonts.families.get_mut(&FontFamily::Proportional), signs) {
        for font in signs {
            if !text.contains(&font) {
                text.push(font);
            }
        }
    }
    ctx.set_fonts(fonts);
    // A press takes the keyboard from a text field, however long it lasts: Space holds again.
    ctx.options_mut(|o| o.input_options.surrender_focus_on = egui::SurrenderFocusOn::Presses);
    for theme in [Theme::Dark, Theme::Light] {
        ctx.style_mut_of(theme, |style| {
            style.visuals = visuals(theme);
            for (text_style, size) in [
                (TextStyle::Small, 12.0),
                (TextStyle::Body, 14.0),
                (TextStyle::Button, 14.0),
                (TextStyle::Heading, 17.0),
            ] {
                style
                    .text_styles
                    .insert(text_style, FontId::new(size, FontFamily::Proportional));
            }
            style.text_styles.insert(
                TextStyle::Monospace,
                FontId::new(13.0, FontFamily::Monospace),
            );
            let s = &mut style.spacing;
            s.item_spacing = vec2(8.0, 6.0);
            s.button_padding = vec2(10.0, 5.0);
            s.interact_size = vec2(40.0, 26.0);
            s.window_margin = Margin::same(12);
            s.menu_margin = Margin::same(8);
            s.tooltip_width = 340.0;
            s.combo_width = 90.0;
        });
    }
}

fn visuals(theme: Theme) -> egui::Visuals {
    let p = Palette::of(theme);
    let mut v = theme.default_visuals();
    let radius = CornerRadius::same(4);
    v.panel_fill = p.panel;
    v.window_fill = p.panel;
    v.window_stroke = Stroke::new(1.0, p.line);
    v.extreme_bg_color = p.sunken;
    v.text_edit_bg_color = Some(p.sunken);
    v.faint_bg_color = p.raised.gamma_multiply(0.5);
    v.code_bg_color = p.raised;
    v.weak_text_color = Some(p.weak);
    v.warn_fg_color = p.warning;
    v.error_fg_color = p.critical;
    v.hyperlink_color = p.text;
    v.selection.bg_fill = p.selected;
    v.selection.stroke = Stroke::new(1.0, p.text);
    v.window_corner_radius = radius;
    v.menu_corner_radius = radius;
    // A disabled control still has to be read: its reason is on it.
    v.disabled_alpha = 0.65;
    let w = &mut v.widgets;
    for (state, fill, text, line) in [
        (&mut w.noninteractive, p.panel, p.text, p.line),
        (&mut w.inactive, p.raised, p.text, p.line),
        (&mut w.hovered, p.hovered, p.text, p.bar),
        (&mut w.active, p.selected, p.text, p.bar),
        (&mut w.open, p.hovered, p.text, p.bar),
    ] {
        state.bg_fill = fill;
        state.weak_bg_fill = fill;
        state.bg_stroke = Stroke::new(1.0, line);
        state.fg_stroke = Stroke::new(1.0, text);
        state.corner_radius = radius;
        state.expansion = 0.0;
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gui::vision::{Eyes, contrast, difference};

    fn of(c: Color32) -> [f64; 3] {
        [c.r(), c.g(), c.b()].map(|u| f64::from(u) / 255.0)
    }

    #[test]
    fn text_is_readable_on_every_surface() {
        for theme in [Theme::Dark, Theme::Light] {
            let p = Palette::of(theme);
            let surfaces = [p.window, p.panel, p.raised, p.sunken];
            for text in [p.text, p.weak, p.ready, p.warning, p.critical] {
                for surface in surfaces {
                    let c = contrast(of(text), of(surface));
                    assert!(c >= 4.5, "{theme:?}: {text:?} on {surface:?} has {c:.2}");
                }
            }
            for (text, surface) in [
                (p.text, p.hovered),
                (p.text, p.selected),
                (p.text, p.warning_fill),
                (p.on_critical, p.critical_fill),
            ] {
                let c = contrast(of(text), of(surface));
                assert!(c >= 4.5, "{theme:?}: {text:?} on {surface:?} has {c:.2}");
            }
            for mark in p.series.into_iter().chain([p.bar]) {
                for surface in [p.panel, p.sunken] {
                    let c = contrast(of(mark), of(surface));
                    assert!(c >= 3.0, "{theme:?}: {mark:?} on {surface:?} has {c:.2}");
                }
            }
        }
    }

    #[test]
    fn heat_leaves_the_grey_of_the_floor_in_one_direction_of_luminance() {
        for theme in [Theme::Dark, Theme::Light] {
            let p = Palette::of(theme);
            assert_eq!(p.heat(0.0), p.line);
            assert_eq!(p.heat(-3.0), p.line);
            assert_eq!(p.heat(7.0), p.series[5]);
            assert_eq!(p.heat(f64::NAN), p.sunken);
            let shares = (0..=20).map(|i| p.heat(f64::from(i) / 20.0));
            let contrasts: Vec<f64> = shares.map(|c| contrast(of(c), of(p.sunken))).collect();
            for w in contrasts.windows(2) {
                assert!(w[1] > w[0], "{theme:?}: {contrasts:.2?}");
            }
        }
    }

    #[test]
    fn what_is_stale_is_greyed_and_still_readable() {
        // Drawn with 0.65 of its opacity (see `View::grey_if_stale`), as controls that are off are.
        for theme in [Theme::Dark, Theme::Light] {
            let p = Palette::of(theme);
            for surface in [p.panel, p.raised, p.sunken] {
                let (text, under) = (of(p.text), of(surface));
                let seen = std::array::from_fn(|k| 0.65 * text[k] + 0.35 * under[k]);
                let c = contrast(seen, under);
                assert!(c >= 4.5, "{theme:?}: stale text on {surface:?} has {c:.2}");
            }
        }
    }

    #[test]
    fn series_stay_apart_for_colour_blind_eyes() {
        for theme in [Theme::Dark, Theme::Light] {
            let series = Palette::of(theme).series.map(of);
            for eyes in Eyes::ALL {
                for i in 0..series.len() {
                    for j in 0..i {
                        let d = difference(eyes, series[i], series[j]);
                        assert!(
                            d > 15.0,
                            "{theme:?}, {eyes:?} eyes: series {j} and {i}: {d:.1}"
                        );
                    }
                }
            }
        }
    }
}
