use super::Pose;

/// The arm's shape, for drawing: cross-section frames along both segments and the three pads.
///
/// All frames have z up along the arm's axis at rest; the bellows of segment `k` run from pad
/// `k` to pad `k + 1` through `base_from_section[k]` in order, first and last included.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArmShape {
    /// Cross-sections along each segment, top to bottom, base from section.
    pub base_from_section: [Vec<Pose>; 2],
    /// Fixed top pad (lower face), middle pad (upper face), end pad (upper face), base from pad.
    pub base_from_pad: [Pose; 3],
    /// Both ends of each spring in the base frame, top then bottom, m.
    pub spring_ends_m: [[[f64; 3]; 2]; super::SPRINGS],
}
