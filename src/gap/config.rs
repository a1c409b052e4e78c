//! Every threshold of the finder, in one place.

/// Thresholds of the finder. Those marked *statistics* follow from sizes of samples or are usual in the field; those marked
/// *development* were set on the eight sessions of the independent rigid-disc engine, on development seeds 1 to 30 of the
/// virtual rig and on logs of a real arm's supply; those marked *time* limit what is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinderConfig {
    /// Resampled sessions behind the significance threshold. Statistics.
    pub draws: usize,
    /// Length of the resampled blocks, bins: longer than the correlation time of a healthy rig. Statistics.
    pub draw_bins: usize,
    /// Resampled sessions behind the supply's significance thresholds. Statistics.
    pub supply_draws: usize,
    /// Length of the pieces that they are resampled from, bins. Statistics.
    pub supply_draw_bins: usize,
    /// Factor on the significance threshold from which the gain of an idealised law counts: the threshold is resampled from one
    /// healthy session, and the model inadequacy differs in the next. Development.
    pub idealisation_factor: f64,
    /// Least gain of an effect of the supply that counts, nats: one parameter's worth by the Bayesian criterion. Statistics.
    pub supply_gain_min: f64,
    /// Share of the excess over the floor that has to go before an effect is named. Development.
    pub closed_min: f64,
    /// The same for sensors, frames and steady loads, whose laws are nearly definitions. Clocks wander. Development.
    pub closed_min_definition: f64,
    /// Share of the held-out gap that has to close before an effect is named. Development.
    pub proven_min: f64,
    /// Folds that have to choose an effect before it is named. Development.
    pub folds_min: usize,
    /// Share of what the varying part of a response takes from the square error that its response to the pressures in another
    /// order may take. Development.
    pub control_max: f64,
    /// Two responses whose varying parts differ by less than this share are the same under any pressures. Development.
    pub same_response: f64,
    /// Share of the square error that what varies of a response takes, from which on it is compared with the response to
    /// other pressures. Development.
    pub varying_min: f64,
    /// The group of an effect counts when it exceeds its noise floor by this factor. Development.
    pub own_group_min: f64,
    /// A group that got worse by this share of its noise floor is reported. Development.
    pub worse: f64,
    /// Significant excess of the mean square innovation over the noise floor, relative to it. Development.
    pub innovation_excess: f64,
    /// Significant mean square bias of a channel, in units of a healthy session's: the next healthy session
    /// reaches 2 to 3 in some channel. Development.
    pub bias_max: f64,
    /// Significant change of the rig's parameters over its expectation: model inadequacy makes parameters
    /// change with the motion, up to 6 for a healthy arm of rigid discs. Development.
    pub change_max: f64,
    /// Errors within this factor of a healthy session's are at its floor, and nothing is named for them. Development.
    pub at_floor: f64,
    /// Errors beyond this factor are far from it, and something is missing whatever a search found. Development.
    pub far: f64,
    /// A further effect has to bring some combination of channels this much closer to its floor. Development.
    pub further_min: f64,
    /// At most so many effects at once. Development.
    pub effects_max: usize,
    /// Share of what the best effect explains that a rival has to explain. Development.
    pub rival_explains: f64,
    /// A best effect that leaves more than this share of the excess is not at the floor. Development.
    pub leaves_little: f64,
    /// A rival is excluded when it leaves this many times what the best one leaves. Development.
    pub rival_leaves: f64,
    /// A margin below this share of what the best effect gains is small. Development.
    pub small_margin: f64,
    /// Share of what some blocks gain that others may lose. Development.
    pub lost: f64,
    /// Model inadequacy where the pressures differ from the healthy session's: standard deviation, in units
    /// of the healthy session's residuals, per pressure at its usual size. Development.
    pub inadequacy: f64,
    /// The same for how fast a pressure changes. Development.
    pub inadequacy_rate: f64,
    /// Contiguous pieces of a session that gains are summed over. Statistics.
    pub blocks: usize,
    /// Held-out folds: every block is held out in one of them. Statistics.
    pub folds: usize,
    /// Blocks of one fold at most: several, so that what begins in the middle of the session is in both parts. Statistics.
    pub fold_blocks_max: usize,
    /// Share of a block that is given up to the embargo at each of its ends at most. Statistics.
    pub embargo_max: f64,
    /// Pieces of a training part that its own gains are summed over, at least. Statistics.
    pub pieces_min: usize,
    /// Standard deviation of a nuisance parameter from session to session, as a share of its prior. Development.
    pub between: f64,
    /// What restarts in every session is usual up to this many of its standard deviations and taken from the session; what is
    /// more is an effect. Student's t with 4 degrees of freedom, 5 % over four IMUs. Statistics.
    pub restarted_max: f64,
    /// What a heading wanders by in a session on average, rad: gyroscope noise of 0.01 deg/s/√Hz, summed up over 90 s. Data
    /// sheets.
    pub heading_walk_rad: f64,
    /// The drift of a heading is a straight line for this long, s. Statistics: as long as what a baseline is made from, usually.
    pub heading_bend_s: f64,
    /// Change of that drift from one such stretch to the next, rad/s: a gyro's zero rate that wanders by 2e-3 deg/s/√s, as in the
    /// fusion filter. Data sheets.
    pub heading_bend_rad_s: f64,
    /// The live monitor averages squares of errors over this time, s. Development.
    pub monitor_s: f64,
    /// Limits of that average, in squares of what a rig in order has on average: of all channels together, and of one given the
    /// others. Development.
    pub monitor_limit: [f64; 2],
    /// The same for what one effect of the table explains, per parameter. Development.
    pub monitor_effect_limit: f64,
    /// What an effect explains is averaged over more time while the arm rests, whose errors are then always the same: by this factor at
    /// most a second counts less. Development.
    pub monitor_at_rest: f64,
    /// The square of one second counts at most so much. Development.
    pub monitor_square_max: f64,
    /// What would be this far from a rig in order shows, and effects that are this far apart are separated, nats: about the
    /// significance threshold of 90 s. Development.
    pub experiment_nats: f64,
    /// Share of the effects that must have had to show before an experiment ends with *nothing missing*. Development.
    pub experiment_visible: f64,
    /// Where a session goes beyond the motion of the baseline by more than this factor of its square, the model's errors there are not
    /// known, and no experiment drives it. Development.
    pub coverage_max: f64,
    /// From this factor on a finding notes it. Development.
    pub coverage_noted: f64,
    /// Share of the diagonal in the covariance (shrinkage against chance correlations). Statistics.
    pub shrinkage: f64,
    /// Largest autoregressive coefficient; slower errors are treated as this slow. Statistics.
    pub phi_max: f64,
    /// Number of independent observations of a persistent bias per session: offsets, drifts and tilts persist,
    /// and the innovations hardly show them. Statistics.
    pub looks: f64,
    /// Candidates that go from the score test into a full fit at most. Time.
    pub fits_first: usize,
    /// The same once an effect was found: the score test is then sharp. Time.
    pub fits_further: usize,
    /// So many are fitted even where none is significant. Time.
    pub fits_min: usize,
    /// At most so many channels of one effect among them. Time.
    pub fits_per_effect: usize,
    /// Different effects that a search in the supply begins with. Time.
    pub supply_beginnings: usize,
    /// Share of the best score from the start by which one that begins later must be better. Development.
    pub onset_min_share: f64,
    /// Nats by which an effect that begins within the session must beat the best one from the start, at noise. Development.
    pub onset_gain_min: f64,
    /// Excess of the innovations before a beginning over those of a rig in order, as a share of these, at most: the usual drift of
    /// the headings is taken from the whole session, which the effect disturbs. Development.
    pub onset_before_max: f64,
    /// By how much the time of a beginning is wrong besides noise, s: how it begins no law describes. Its interval is wider by so
    /// much at each end. Development.
    pub onset_takes_s: f64,
    /// Pressures that all stay within this excite little, Pa. Development.
    pub excited_pa: f64,
    /// Smallest share of variance that is listed. Development.
    pub located_share_min: f64,
    /// What is located has to be in a channel that exceeds its floor by this factor. Development.
    pub located_over_floor: f64,
    /// Factor on the significance threshold of the supply's mean square above which its residuals count. Development.
    pub supply_mean_square: f64,
    /// Share of the gain so far that a further effect of the supply must add: no law in the table is exact, and what an
    /// inadequate one leaves is no further effect. Development.
    pub supply_further_share: f64,
    /// Standard errors by which the first effect of the supply has to gain: Student's t over the blocks, one-sided 5 %, so
    /// that no effect is named for what happens in one block. Statistics.
    pub supply_first_se: f64,
    /// Standard errors by which a set of the supply's effects with one more has to be better. Development.
    pub supply_further_se: f64,
    /// Share of the mean square that effects of an unknown supply may leave at most. Development.
    pub supply_without_healthy: f64,
    /// Margins between sets of the supply's effects below this many standard errors are not significant. Development.
    pub supply_margin_se: f64,
}

/// What the finder uses.
pub const CONFIG: FinderConfig = FinderConfig {
    draws: 400,
    draw_bins: 50,
    supply_draws: 200,
    supply_draw_bins: 60,
    idealisation_factor: 2.0,
    supply_gain_min: 4.0,
    closed_min: 0.5,
    closed_min_definition: 0.8,
    proven_min: 0.5,
    folds_min: 3,
    control_max: 0.5,
    same_response: 0.5,
    varying_min: 0.1,
    own_group_min: 1.5,
    worse: 0.1,
    innovation_excess: 0.5,
    bias_max: 4.0,
    change_max: 8.0,
    at_floor: 1.25,
    far: 3.0,
    further_min: 0.6,
    effects_max: 3,
    rival_explains: 0.5,
    leaves_little: 0.05,
    rival_leaves: 2.0,
    small_margin: 0.05,
    lost: 0.1,
    inadequacy: 0.15,
    inadequacy_rate: 0.15,
    blocks: 12,
    folds: 4,
    fold_blocks_max: 3,
    embargo_max: 1.0 / 3.0,
    pieces_min: 8,
    between: 0.01,
    restarted_max: 4.3,
    heading_walk_rad: 2e-3,
    heading_bend_s: 90.0,
    heading_bend_rad_s: 3.3e-4,
    monitor_s: 30.0,
    monitor_limit: [5.0, 20.0],
    monitor_effect_limit: 25.0,
    monitor_at_rest: 0.125,
    monitor_square_max: 60.0,
    experiment_nats: 20.0,
    experiment_visible: 0.9,
    coverage_max: 4.0,
    coverage_noted: 10.0,
    shrinkage: 0.1,
    phi_max: 0.97,
    looks: 2.0,
    fits_first: 10,
    fits_further: 4,
    fits_min: 3,
    fits_per_effect: 3,
    supply_beginnings: 4,
    onset_min_share: 0.1,
    onset_gain_min: 10.0,
    onset_before_max: 1.0,
    onset_takes_s: 1.2,
    excited_pa: 8e3,
    located_share_min: 0.2,
    located_over_floor: 1.3,
    supply_mean_square: 2.0,
    supply_further_share: 0.1,
    supply_first_se: 1.8,
    supply_further_se: 2.0,
    supply_without_healthy: 0.8,
    supply_margin_se: 2.0,
};
