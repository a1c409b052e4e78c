//! Light and dark: restrained grey, colour only for what is abnormal, and a fixed colour per signal.
//!
//! Every colour a text can have stands in [`Palette`]; a test computes its contrast (WCAG 2.2, at
//! least 4.5:1) against every surface it is drawn on, and 3:1 for lines and marks. The series are
//! chosen to stay apart for deuteranopes and protanopes, which a test simulates.

use egui::{Color32, CornerRadius, FontFamily, FontId, Margin, Stroke, TextStyle, Theme, vec2};

use super::history::Channel;

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
    warning: Color32::from_rgb(0xff, 0xb9, 0x4f),
    critical: Color32::from_rgb(0xff, 0x8d, 0x83),
    critical_fill: Color32::from_rgb(0xc6, 0x28, 0x28),
    on_critical: Color32::WHITE,
    warning_fill: Color32::from_rgb(0x4d, 0x3a, 0x14),
    series: [
        Color32::from_rgb(0x56, 0xb4, 0xe9),
        Color32::from_rgb(0xe6, 0x9f, 0x00),
        Color32::from_rgb(0x00, 0xa8, 0x7c),
        Color32::from_rgb(0xe4, 0x5f, 0x28),
        Color32::from_rgb(0xd9, 0x8f, 0xb3),
        Color32::from_rgb(0xf2, 0xe8, 0x5c),
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
    warning: Color32::from_rgb(0x7d, 0x48, 0x00),
    critical: Color32::from_rgb(0xa8, 0x1c, 0x16),
    critical_fill: Color32::from_rgb(0xc6, 0x28, 0x28),
    on_critical: Color32::WHITE,
    warning_fill: Color32::from_rgb(0xff, 0xe6, 0xb8),
    series: [
        Color32::from_rgb(0x00, 0x72, 0xb2),
        Color32::from_rgb(0xc0, 0x83, 0x00),
        Color32::from_rgb(0x00, 0x6b, 0x50),
        Color32::from_rgb(0xad, 0x2f, 0x00),
        Color32::from_rgb(0xb9, 0x60, 0x9a),
        Color32::from_rgb(0x2e, 0x2a, 0x5c),
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

    /// Colour of text and marks at a level.
    pub fn level(&self, level: Level) -> Color32 {
        match level {
            Level::Normal => self.weak,
            Level::Warning => self.warning,
            Level::Critical => self.critical,
        }
    }

    /// The colour of a signal, the same on every screen. Springs share the colour of their X pair
    /// (the second of a pair is drawn dashed), set pressures that of their chamber; ground truth is
    /// neutral.
    pub fn signal(&self, channel: Channel) -> Color32 {
        match channel {
            Channel::Spring(i) => self.series[i / 2],
            Channel::Imu(i, _) => self.series[i],
            Channel::ChamberMeasured(i) | Channel::ChamberSet(i) => self.series[i],
            Channel::Tip(i) => self.series[i],
            Channel::Truth(_) => self.text,
            Channel::Error(i) => self.series[if i < 6 { i } else { 0 }],
        }
    }
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
    v.disabled_alpha = 0.6;
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

    fn linear(c: Color32) -> [f64; 3] {
        [c.r(), c.g(), c.b()].map(|u| {
            let s = f64::from(u) / 255.0;
            if s <= 0.04045 {
                s / 12.92
            } else {
                ((s + 0.055) / 1.055).powf(2.4)
            }
        })
    }

    // Relative luminance and contrast ratio of WCAG 2.2.
    fn contrast(a: Color32, b: Color32) -> f64 {
        let y = |c| {
            let [r, g, b] = linear(c);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let (hi, lo) = if y(a) > y(b) {
            (y(a), y(b))
        } else {
            (y(b), y(a))
        };
        (hi + 0.05) / (lo + 0.05)
    }

    #[test]
    fn contrast_has_its_anchors() {
        assert!((contrast(Color32::WHITE, Color32::BLACK) - 21.0).abs() < 1e-9);
        assert!((contrast(Color32::from_gray(0x77), Color32::WHITE) - 4.48).abs() < 0.01);
    }

    #[test]
    fn text_is_readable_on_every_surface() {
        for theme in [Theme::Dark, Theme::Light] {
            let p = Palette::of(theme);
            let surfaces = [p.window, p.panel, p.raised, p.sunken];
            for text in [p.text, p.weak, p.warning, p.critical] {
                for surface in surfaces {
                    let c = contrast(text, surface);
                    assert!(c >= 4.5, "{theme:?}: {text:?} on {surface:?} has {c:.2}");
                }
            }
            for (text, surface) in [
                (p.text, p.hovered),
                (p.text, p.selected),
                (p.text, p.warning_fill),
                (p.on_critical, p.critical_fill),
            ] {
                let c = contrast(text, surface);
                assert!(c >= 4.5, "{theme:?}: {text:?} on {surface:?} has {c:.2}");
            }
            for mark in p.series.into_iter().chain([p.bar]) {
                for surface in [p.panel, p.sunken] {
                    let c = contrast(mark, surface);
                    assert!(c >= 3.0, "{theme:?}: {mark:?} on {surface:?} has {c:.2}");
                }
            }
        }
    }

    // CIE L*a*b*, D65.
    fn lab([r, g, b]: [f64; 3]) -> [f64; 3] {
        let f = |t: f64| {
            if t > 0.008_856 {
                t.cbrt()
            } else {
                7.787 * t + 16.0 / 116.0
            }
        };
        let x = f((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
        let y = f(0.2126 * r + 0.7152 * g + 0.0722 * b);
        let z = f((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    #[test]
    fn series_stay_apart_for_colour_blind_eyes() {
        // Machado, Oliveira and Fernandes 2009 (doi:10.1109/TVCG.2009.113), severity 1.
        const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        const PROTAN: [[f64; 3]; 3] = [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ];
        const DEUTAN: [[f64; 3]; 3] = [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ];
        for theme in [Theme::Dark, Theme::Light] {
            for (eyes, m) in [("usual", IDENTITY), ("protan", PROTAN), ("deutan", DEUTAN)] {
                let seen: Vec<_> = Palette::of(theme)
                    .series
                    .iter()
                    .map(|&c| {
                        let c = linear(c);
                        lab(m.map(|row| {
                            (row[0] * c[0] + row[1] * c[1] + row[2] * c[2]).clamp(0.0, 1.0)
                        }))
                    })
                    .collect();
                for i in 0..seen.len() {
                    for j in 0..i {
                        let d = (0..3)
                            .map(|k| (seen[i][k] - seen[j][k]).powi(2))
                            .sum::<f64>()
                            .sqrt();
                        assert!(
                            d > 15.0,
                            "{theme:?}, {eyes} eyes: series {j} and {i}: {d:.1}"
                        );
                    }
                }
            }
        }
    }
}
