//! Colours of the scene, sRGB from 0 to 1. One colour per signal, the same on both backgrounds in hue;
//! series and states come from a set that colour-blind eyes can distinguish, strain from a scale whose
//! lightness grows steadily.

use crate::signal::ReachState;

/// Light or dark background.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Theme {
    /// Dark grey background.
    #[default]
    Dark,
    /// Light grey background.
    Light,
}

/// Red, green, blue.
pub type Rgb = [f32; 3];

/// What depends on the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Palette {
    /// Backdrop at the top of the picture.
    pub back_top: Rgb,
    /// Backdrop at the bottom.
    pub back_bottom: Rgb,
    /// Light from above, linear.
    pub sky: Rgb,
    /// Light from below, linear.
    pub ground: Rgb,
    /// The key light, linear.
    pub key: Rgb,
    /// Light along the edges, linear.
    pub rim: Rgb,
    /// Floor lines and their opacity.
    pub grid: [f32; 4],
    /// Strength of the shadow on the floor.
    pub floor_shadow: f32,
    /// Bellows.
    pub bellows: Rgb,
    /// Pads.
    pub pad: Rgb,
    /// Ceiling plate and fittings.
    pub fixture: Rgb,
    /// Central tube.
    pub tube: Rgb,
    /// Gripper.
    pub gripper: Rgb,
    /// Payload.
    pub payload: Rgb,
    /// IMU housings.
    pub imu: Rgb,
    /// Derived from the sensors: estimate, predicted trail.
    pub predicted: Rgb,
    /// The model of a patch that is tried.
    pub tried: Rgb,
    /// Motion capture.
    pub truth: Rgb,
    /// Goal.
    pub goal: Rgb,
    /// Errors.
    pub error: Rgb,
    /// Selection.
    pub selected: Rgb,
    /// Text and thin marks.
    pub ink: Rgb,
}

impl Palette {
    /// The colours for a background.
    pub fn of(theme: Theme) -> Self {
        match theme {
            Theme::Dark => Self {
                back_top: hex(0x33383e),
                back_bottom: hex(0x191c20),
                sky: [0.42, 0.45, 0.50],
                ground: [0.10, 0.10, 0.11],
                key: [0.78, 0.75, 0.70],
                rim: [0.10, 0.12, 0.15],
                grid: [0.62, 0.66, 0.70, 0.34],
                floor_shadow: 0.75,
                bellows: hex(0xc9c6bf),
                pad: hex(0x4c5259),
                fixture: hex(0x6d737a),
                tube: hex(0xe6e2d8),
                gripper: hex(0x8f959c),
                payload: hex(0x9c8f7d),
                imu: hex(0x23272c),
                predicted: hex(0x2aaadb),
                tried: hex(0xdfa2c9),
                truth: hex(0xfaa317),
                goal: hex(0x2bd796),
                error: hex(0xef6d31),
                selected: hex(0xffffff),
                ink: hex(0xd8dce0),
            },
            Theme::Light => Self {
                back_top: hex(0xf2f3f4),
                back_bottom: hex(0xcfd3d7),
                sky: [0.60, 0.62, 0.65],
                ground: [0.26, 0.26, 0.27],
                key: [0.62, 0.60, 0.57],
                rim: [0.02, 0.02, 0.02],
                grid: [0.30, 0.33, 0.37, 0.34],
                floor_shadow: 0.42,
                bellows: hex(0xd3cfc7),
                pad: hex(0x535a62),
                fixture: hex(0x7d848b),
                tube: hex(0xeae6dc),
                gripper: hex(0x868d95),
                payload: hex(0xa59682),
                imu: hex(0x2a2f35),
                predicted: hex(0x5273aa),
                tried: hex(0xca5d95),
                truth: hex(0xba5403),
                goal: hex(0x085b3c),
                error: hex(0x9f1e07),
                selected: hex(0x111417),
                ink: hex(0x2b3036),
            },
        }
    }

    /// Colour of a verdict. The marker's shape has the same meaning.
    pub fn reach(&self, state: Option<ReachState>) -> Rgb {
        match (state, self.ink[0] > 0.5) {
            (Some(ReachState::Reachable), _) => self.goal,
            (Some(ReachState::Marginal), true) => hex(0xe9f054),
            (Some(ReachState::Marginal), false) => hex(0x81753a),
            (Some(ReachState::Unreachable), _) => self.error,
            (Some(ReachState::OutsideData), true) => hex(0xdf94bd),
            (Some(ReachState::OutsideData), false) => hex(0xa31f8b),
            (None, _) => self.ink,
        }
    }

    /// Colours of the x, y and z axis.
    pub fn axis(&self, axis: usize) -> Rgb {
        let dark = self.ink[0] > 0.5;
        match (axis, dark) {
            (0, true) => hex(0xee6a50),
            (0, false) => hex(0xc0392b),
            (1, true) => hex(0x5fce8b),
            (1, false) => hex(0x1f8a4c),
            (_, true) => hex(0x6aa5ff),
            (_, false) => hex(0x2a62c9),
        }
    }
}

/// A colour from its usual six digits.
pub const fn hex(rgb: u32) -> Rgb {
    [
        ((rgb >> 16) & 0xff) as f32 / 255.0,
        ((rgb >> 8) & 0xff) as f32 / 255.0,
        (rgb & 0xff) as f32 / 255.0,
    ]
}

/// A sequential scale from purple over teal to yellow for `t` from 0 to 1; its lightness grows
/// steadily, so it reads in grey and with any colour vision.
pub fn sequential(t: f32) -> Rgb {
    const STOPS: [Rgb; 6] = [
        hex(0x46257a),
        hex(0x414c8a),
        hex(0x2a7a8e),
        hex(0x22a884),
        hex(0x7ad151),
        hex(0xfde725),
    ];
    let x = t.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let i = (x as usize).min(STOPS.len() - 2);
    let f = x - i as f32;
    std::array::from_fn(|c| STOPS[i][c] + (STOPS[i + 1][c] - STOPS[i][c]) * f)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gui::vision::{Eyes, contrast, difference};

    fn of(c: Rgb) -> [f64; 3] {
        c.map(f64::from)
    }

    #[test]
    fn marks_stand_out_from_the_backdrop_and_stay_apart_for_colour_blind_eyes() {
        use ReachState::{Marginal, OutsideData, Reachable, Unreachable};
        for theme in [Theme::Dark, Theme::Light] {
            let p = Palette::of(theme);
            let signals = [p.predicted, p.truth, p.goal, p.error];
            let verdicts =
                [Reachable, Marginal, Unreachable, OutsideData].map(|s| p.reach(Some(s)));
            for mark in signals.into_iter().chain(verdicts).chain([p.ink]) {
                for back in [p.back_top, p.back_bottom] {
                    let c = contrast(of(mark), of(back));
                    assert!(c >= 3.0, "{theme:?}: {mark:?} on {back:?} has {c:.2}");
                }
            }
            for eyes in Eyes::ALL {
                for set in [signals, verdicts] {
                    for i in 0..4 {
                        for j in 0..i {
                            let d = difference(eyes, of(set[i]), of(set[j]));
                            assert!(d > 15.0, "{theme:?}, {eyes:?} eyes: {j} and {i}: {d:.1}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn the_sequential_scale_grows_lighter_everywhere() {
        let light = |t: f32| {
            let [r, g, b] = sequential(t).map(|x| x.powf(2.2));
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        for k in 0..50 {
            let (a, b) = (k as f32 / 50.0, (k + 1) as f32 / 50.0);
            assert!(light(b) > light(a), "between {a} and {b}");
        }
        assert_eq!(sequential(-1.0), sequential(0.0));
        assert_eq!(sequential(7.0), sequential(1.0));
    }
}
