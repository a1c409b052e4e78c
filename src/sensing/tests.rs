use super::*;
use crate::rig::circuit::{Circuit, USUAL_SCATTER};
use crate::rig::inertial::{Inertial, InertialErrors, PadMotion};
use crate::signal::{Stamp, pose_from_ypr};
use nalgebra::Vector3;
use proptest::prelude::*;
use rand::SeedableRng;
use rand_pcg::Pcg64;

const DT_S: f64 = 0.01;

/// A rig whose pads follow a given path: physical circuits, erring IMUs.
struct Rig {
    spec: RobotSpec,
    circuit: Circuit,
    inertial: Inertial,
    rng: Pcg64,
    frame: u32,
    path: fn(f64) -> [Pose; 2],
}

/// The arm sways over most of its range at 1 to 5 degrees per second after two seconds of rest.
fn sway(t_s: f64) -> [Pose; 2] {
    let t = (t_s - 2.0).max(0.0);
    // Starts and goes on smoothly.
    let swell = 1.0 - (-t / 4.0).exp() * (1.0 + t / 4.0);
    let wave = |rate: f64, phase: f64| swell * ((rate * t + phase).sin() - phase.sin());
    let one = |phase: f64| {
        let (pitch, roll) = (14.0 * wave(0.13, phase), 12.0 * wave(0.17, phase + 1.0));
        let yaw = 4.0 * wave(0.11, phase + 2.0);
        let z = -0.145 - 0.025 * wave(0.10, phase);
        // Bends about its middle, as a soft segment does.
        let x = z * 0.5 * pitch.to_radians();
        let y = -z * 0.5 * roll.to_radians();
        pose_from_ypr([x, y, z], [yaw, pitch, roll].map(f64::to_radians))
    };
    [one(0.0), one(0.7)]
}

fn rest(_: f64) -> [Pose; 2] {
    [pose_from_ypr([0.0, 0.0, -0.145], [0.0; 3]); 2]
}

impl Rig {
    fn new(path: fn(f64) -> [Pose; 2]) -> Self {
        let spec = RobotSpec::reference();
        Self {
            circuit: Circuit::new(&spec, 1, USUAL_SCATTER),
            inertial: Inertial::new(&spec, 2, InertialErrors::zeroed()),
            rng: Pcg64::seed_from_u64(3),
            frame: 0,
            path,
            spec,
        }
    }

    fn t_s(&self) -> f64 {
        f64::from(self.frame) * DT_S
    }

    fn pads(&self, t_s: f64) -> [Pose; 2] {
        platform::pads(&self.spec, &(self.path)(t_s))
    }

    fn lengths_m(&self) -> [f64; SPRINGS] {
        let relative = (self.path)(self.t_s());
        let [a, b] = [0, 1].map(|k| Segment::of(&self.spec, k).lengths_m(&relative[k]));
        std::array::from_fn(|i| if i < LEGS { a[i] } else { b[i - LEGS] })
    }

    fn next(&mut self) -> RawFrame {
        self.frame += 1;
        let t = self.t_s();
        self.circuit.step(DT_S, &self.lengths_m());
        let (counts, gates) = self.circuit.read(&mut self.rng);
        let h = 1e-3;
        let (before, now, after) = (self.pads(t - h), self.pads(t), self.pads(t + h));
        let motion = [0, 1].map(|p| {
            let turn = before[p].rotation.inverse() * after[p].rotation;
            let accel = (before[p].translation.vector + after[p].translation.vector
                - now[p].translation.vector * 2.0)
                / (h * h);
            let gravity = Vector3::z() * -crate::sim::GRAVITY_M_S2;
            PadMotion::new(
                &now[p].rotation,
                turn.scaled_axis() / (2.0 * h),
                accel,
                &gravity,
            )
        });
        RawFrame {
            seq: self.frame,
            stamp: Stamp::from_seconds(t),
            spring_counts: counts,
            spring_gate_ticks: gates,
            tick_rate_hz: [self.circuit.tick_rate_hz; BOARDS],
            tick_rate_sd: [0.0; BOARDS],
            imu: self
                .inertial
                .read(DT_S, &motion[0], &motion[1], &mut self.rng),
            chamber_pa: [1000.0; CHAMBERS],
            present: RawFrame::ALL_PRESENT,
            board_age_s: [0.002; BOARDS],
            faults: 0,
        }
    }
}

fn sensing() -> Sensing {
    Sensing::new(&RobotSpec::reference(), calibrated())
}

/// Springs, IMUs and ends after their calibration, which found them as drawn.
fn calibrated() -> Calibration {
    let mut calibration = Calibration::as_drawn();
    for spring in &mut calibration.springs {
        spring.ends_off_m = [Vector3::repeat(1e-6); 2];
    }
    for i in 0..IMUS {
        let entry = calibration.imu_entry(i);
        calibration.set_imu(entry).expect("as drawn");
    }
    calibration
}

/// Angle between what IMU `i` says and the pad's true orientation, degrees.
fn off_deg(out: &SensorFrame, i: usize, truth: &[Pose; 2]) -> f64 {
    let said = UnitQuaternion::from_rotation_matrix(&out.sensors.base_from_imu_pad(i));
    said.angle_to(&truth[i / 2].rotation).to_degrees()
}

/// Five minutes of motion: lengths within tenths of a millimetre, orientations within half a
/// degree in spite of gyros that drift by degrees per minute, and no false alarm.
#[test]
fn five_minutes_of_motion_stay_within_half_a_degree_and_tenths_of_a_millimetre() {
    let mut rig = Rig::new(sway);
    // One gyro is worse than the rest: 6 degrees per minute about its vertical axis.
    rig.inertial
        .add_gyro_bias(0, Vector3::z() * 0.1_f64.to_radians());
    let mut calibration = calibrated();
    for i in 0..IMUS {
        let nominal = rig.spec.imus[i].pad_from_imu;
        let turned = rig.inertial.pad_from_imu(i) * nominal.inverse();
        let mut entry = calibration.imu_entry(i);
        entry.fit.correction_rad = turned.scaled_axis();
        calibration.set_imu(entry).expect("small");
    }
    let mut sensing = Sensing::new(&rig.spec, calibration);
    let mut worst_deg: f64 = 0.0;
    let (mut squares, mut n) = (0.0, 0.0);
    let mut alarms = 0;
    let (mut shortest, mut longest) = (1.0_f64, 0.0_f64);
    while rig.t_s() < 300.0 {
        let out = sensing.update(&rig.next());
        let truth = rig.pads(rig.t_s());
        for (got, want) in out.sensors.spring_m.iter().zip(rig.lengths_m()) {
            squares += (got - want) * (got - want);
            n += 1.0;
            shortest = shortest.min(want);
            longest = longest.max(want);
        }
        if rig.t_s() > 1.0 {
            alarms += usize::from(out.health != Health::default());
            for i in 0..IMUS {
                worst_deg = worst_deg.max(off_deg(&out, i, &truth));
            }
        }
    }
    let rmse_m = f64::sqrt(squares / n);
    assert!(
        longest - shortest > 0.08,
        "path too short: {shortest} to {longest}"
    );
    assert!(rmse_m < 0.2e-3, "{rmse_m}");
    assert!(worst_deg < 0.5, "{worst_deg}");
    assert_eq!(alarms, 0);
}

#[test]
fn stuck_spring_is_flagged_within_half_a_second_of_motion_and_heading_is_kept() {
    for victim in 0..SPRINGS {
        let mut rig = Rig::new(sway);
        let mut sensing = sensing();
        while rig.t_s() < 12.0 {
            sensing.update(&rig.next());
        }
        let raw = rig.next();
        let stuck = (raw.spring_counts[victim], raw.spring_gate_ticks[victim]);
        let before = rig.lengths_m()[victim];
        let mut motion_since_s: Option<f64> = None;
        let mut flagged_s = None;
        while rig.t_s() < 22.0 {
            let mut raw = rig.next();
            (raw.spring_counts[victim], raw.spring_gate_ticks[victim]) = stuck;
            let out = sensing.update(&raw);
            if (rig.lengths_m()[victim] - before).abs() > 0.3e-3 {
                motion_since_s.get_or_insert(rig.t_s());
            }
            for (i, h) in out.health.springs.iter().enumerate() {
                if i == victim {
                    if *h == ChannelHealth::Stuck {
                        flagged_s.get_or_insert(rig.t_s());
                    }
                } else {
                    assert_eq!(*h, ChannelHealth::Ok, "spring {i} at {}", rig.t_s());
                }
            }
            let truth = rig.pads(rig.t_s());
            for i in 0..IMUS {
                assert!(off_deg(&out, i, &truth) < 0.7, "IMU {i} at {}", rig.t_s());
            }
            if flagged_s.is_some() {
                assert!(!out.health.springs[victim].usable());
                // What it delivers is kept beside what stands in for it.
                let off_m = [
                    out.measured().spring_m[victim] - before,
                    out.sensors.spring_m[victim] - rig.lengths_m()[victim],
                ];
                assert!(off_m.iter().all(|off| off.abs() < 2e-3), "{off_m:?}");
                // Five springs and the IMUs still place the pads.
                let off = sensing.pads()[1].translation.vector - truth[1].translation.vector;
                assert!(off.norm() < 5e-3, "{off} at {}", rig.t_s());
            }
        }
        let delay_s = flagged_s.expect("flagged") - motion_since_s.expect("moved");
        assert!(delay_s <= 0.5, "spring {victim}: {delay_s}");
    }
}

/// A coil that is snagged still trembles: no equal counts, but it misses the motion.
#[test]
fn snagged_spring_with_noise_is_found_by_the_imus() {
    let mut rig = Rig::new(sway);
    let mut sensing = sensing();
    while rig.t_s() < 12.0 {
        sensing.update(&rig.next());
    }
    let victim = 4;
    let held_m = rig.lengths_m()[victim];
    let mut snagged = rig.circuit.clone();
    let mut rng = Pcg64::seed_from_u64(9);
    let mut flagged = None;
    while rig.t_s() < 20.0 && flagged.is_none() {
        let mut raw = rig.next();
        snagged.settle(&[held_m; SPRINGS]);
        let (counts, gates) = snagged.read(&mut rng);
        raw.spring_counts[victim] = counts[victim];
        raw.spring_gate_ticks[victim] = gates[victim];
        let out = sensing.update(&raw);
        let missed_m = (rig.lengths_m()[victim] - held_m).abs();
        if out.health.springs[victim] != ChannelHealth::Ok {
            flagged = Some((out.health.springs[victim], missed_m));
        }
    }
    let (health, missed_m) = flagged.expect("found");
    assert_eq!(health, ChannelHealth::Stuck);
    assert!(missed_m < 5e-3, "{missed_m}");
}

#[test]
fn dead_imu_is_flagged_within_three_frames_and_comes_back_aligned() {
    let mut rig = Rig::new(sway);
    let mut sensing = sensing();
    while rig.t_s() < 10.0 {
        sensing.update(&rig.next());
    }
    type Spoil = fn(&mut RawFrame);
    let faults: [Spoil; 4] = [
        |r| r.present &= !(1 << (SPRINGS + 1)),
        |r| r.imu[1].gyro_rad_s[0] = f64::NAN,
        |r| r.imu[1].accel_m_s2 = [0.0; 3],
        |r| r.imu[1].gyro_rad_s = [1e9; 3],
    ];
    for fault in faults {
        for k in 0..60 {
            let mut raw = rig.next();
            fault(&mut raw);
            let out = sensing.update(&raw);
            if k >= 2 {
                assert_eq!(out.health.imus[1], ChannelHealth::Missing, "frame {k}");
            }
            assert_eq!(out.health.imus[0], ChannelHealth::Ok);
            assert!(out.sensors.to_vector().iter().all(|x| x.is_finite()));
        }
        for _ in 0..200 {
            sensing.update(&rig.next());
        }
        let out = sensing.update(&rig.next());
        assert_eq!(out.health, Health::default());
        let off = off_deg(&out, 1, &rig.pads(rig.t_s()));
        assert!(off < 0.7, "{off}");
    }
}

#[test]
fn frozen_imu_is_stuck_in_motion() {
    let mut rig = Rig::new(sway);
    let mut sensing = sensing();
    while rig.t_s() < 10.0 {
        sensing.update(&rig.next());
    }
    let frozen = rig.next().imu[2];
    let mut health = ChannelHealth::Ok;
    for _ in 0..40 {
        let mut raw = rig.next();
        raw.imu[2] = frozen;
        health = sensing.update(&raw).health.imus[2];
    }
    assert_eq!(health, ChannelHealth::Stuck);
}

#[test]
fn undelivered_out_of_range_and_jumping_springs_are_reconstructed() {
    let mut rig = Rig::new(rest);
    let mut sensing = sensing();
    for _ in 0..50 {
        sensing.update(&rig.next());
    }
    let mut raw = rig.next();
    raw.present &= !(1 << 3);
    raw.spring_counts[5] = 0;
    raw.spring_gate_ticks[6] = 8_000;
    // In range, but 50 mm away from one frame to the next.
    raw.spring_gate_ticks[8] = (f64::from(raw.spring_gate_ticks[8]) * 0.985) as u32;
    raw.chamber_pa[2] = f64::NAN;
    raw.chamber_pa[3] = 1e7;
    let out = sensing.update(&raw);
    let h = &out.health;
    assert_eq!(h.springs[3], ChannelHealth::Missing);
    assert_eq!(h.springs[5], ChannelHealth::Missing);
    assert_eq!(h.springs[6], ChannelHealth::OutOfRange);
    assert_eq!(
        h.springs[8],
        ChannelHealth::Suspect,
        "beyond the gate for one frame"
    );
    assert_eq!(h.springs_usable(), 9);
    assert_eq!(h.chambers[2], ChannelHealth::Missing);
    assert_eq!(h.chambers[3], ChannelHealth::OutOfRange);
    assert_eq!(out.chamber_pa, [1000.0; CHAMBERS]);
    for l in out.sensors.spring_m {
        assert!((l - 0.153_8).abs() < 0.6e-3, "{l}");
    }
    assert_eq!(sensing.update(&rig.next()).health.springs_usable(), SPRINGS);
}

#[test]
fn stale_boards_and_old_frames_do_not_pass_as_fresh() {
    let mut rig = Rig::new(rest);
    let mut sensing = sensing();
    for _ in 0..20 {
        sensing.update(&rig.next());
    }
    let mut raw = rig.next();
    raw.board_age_s = [0.05, f64::NAN];
    let out = sensing.update(&raw);
    assert_eq!(out.health.springs[0], ChannelHealth::Suspect);
    assert_eq!(out.health.springs[11], ChannelHealth::Missing);
    assert_eq!(out.health.imus[3], ChannelHealth::Missing);
    assert_eq!(out.health.chambers[5], ChannelHealth::Missing);
    let mut old = rig.next();
    old.stamp = Stamp::from_seconds(0.1);
    assert_eq!(sensing.update(&old), out);
}

#[test]
fn same_frames_same_result_and_reset_forgets() {
    let mut rig = Rig::new(sway);
    let frames: Vec<RawFrame> = (0..400).map(|_| rig.next()).collect();
    let mut a = sensing();
    let first: Vec<SensorFrame> = frames.iter().map(|f| a.update(f)).collect();
    a.reset();
    let again: Vec<SensorFrame> = frames.iter().map(|f| a.update(f)).collect();
    assert_eq!(first, again);
}

#[test]
fn springs_without_a_calibration_are_missing() {
    let mut calibration = Calibration::as_drawn();
    calibration.springs.retain(|s| s.spring <= 10);
    assert_eq!(calibration.uncovered(), [11, 12]);
    let mut sensing = Sensing::new(&RobotSpec::reference(), calibration);
    let out = sensing.update(&Rig::new(rest).next());
    assert_eq!(out.health.springs[10], ChannelHealth::Missing);
    assert!((out.sensors.spring_m[10] - 0.153_808).abs() < 2e-3);
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        -10.0f64..10.0,
        any::<f64>(),
        Just(f64::NAN),
        Just(f64::INFINITY)
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever arrives, what leaves is finite and inside the calibrated lengths.
    #[test]
    fn garbage_never_leaves(
        frames in prop::collection::vec(
            (
                prop::array::uniform12(prop_oneof![any::<u32>(), 10_000u32..12_000]),
                prop::array::uniform12(prop_oneof![any::<u32>(), 15_900u32..16_100]),
                prop::array::uniform24(any_number()),
                prop::array::uniform6(any_number()),
                any::<u32>(),
                any_number(),
            ),
            1..30,
        ),
    ) {
        let mut sensing = sensing();
        for (k, (counts, gates, inertial, chamber_pa, present, rate)) in frames.into_iter().enumerate() {
            let three = |at: usize| std::array::from_fn(|j| inertial[at + j]);
            let out = sensing.update(&RawFrame {
                stamp: Stamp::from_seconds(0.01 * k as f64),
                spring_counts: counts,
                spring_gate_ticks: gates,
                tick_rate_hz: [if k % 3 == 0 { rate } else { 2.0e6 }, 2.0e6],
                tick_rate_sd: [0.0, if k % 5 == 0 { rate } else { 0.0 }],
                imu: std::array::from_fn(|i| crate::signal::ImuRaw {
                    gyro_rad_s: three(6 * i),
                    accel_m_s2: three(6 * i + 3),
                }),
                chamber_pa,
                present,
                ..RawFrame::default()
            });
            prop_assert!(out.sensors.to_vector().iter().all(|x| x.is_finite()));
            prop_assert!(out.chamber_pa.iter().all(|x| x.is_finite()));
            prop_assert!(out.sensors.spring_m.iter().all(|l| (0.06..0.26).contains(l)));
            let pads = sensing.pads();
            prop_assert!(pads.iter().all(|p| p.translation.vector.iter().all(|x| x.is_finite())));
            prop_assert!(Vector3::from(out.sensors.imu_ypr_rad[0]).norm() < 10.0);
        }
    }
}

/// Runs ten seconds of motion, then ten more with frames spoiled; what came out of those.
fn spoiled(spoil: impl Fn(&mut RawFrame)) -> Vec<(SensorFrame, [f64; SPRINGS], [Pose; 2])> {
    let mut rig = Rig::new(sway);
    let mut sensing = sensing();
    while rig.t_s() < 10.0 {
        sensing.update(&rig.next());
    }
    let mut out = Vec::new();
    while rig.t_s() < 20.0 {
        let mut raw = rig.next();
        spoil(&mut raw);
        let frame = sensing.update(&raw);
        out.push((frame, rig.lengths_m(), rig.pads(rig.t_s())));
    }
    out
}

#[test]
fn five_springs_and_the_imus_stand_in_for_the_sixth() {
    for victim in [1, 8] {
        let frames = spoiled(|raw| raw.present &= !(1 << victim));
        let (mut squares, mut stated) = (0.0, 0.0);
        for (frame, lengths_m, _) in &frames {
            assert!(frame.extra_sigma[victim] > 0.0 && !frame.is_blind());
            squares += (frame.sensors.spring_m[victim] - lengths_m[victim]).powi(2);
            stated += frame.extra_sigma[victim].powi(2);
        }
        let n = frames.len() as f64;
        let (off_m, stated_m) = (f64::sqrt(squares / n), f64::sqrt(stated / n));
        // The last good length would be off by centimetres.
        assert!(off_m < 2e-3, "spring {victim}: {off_m}");
        assert!(
            (0.2..1.5).contains(&(off_m / stated_m)),
            "{off_m} against {stated_m}"
        );
    }
}

#[test]
fn the_springs_stand_in_for_the_imus() {
    let frames = spoiled(|raw| raw.present &= !(0b1111 << SPRINGS));
    for (frame, _, pads) in &frames {
        assert!(!frame.is_blind());
        for i in 0..IMUS {
            assert!(off_deg(frame, i, pads) < 0.7, "IMU {i}");
            assert!(frame.extra_sigma[SPRINGS + 3 * i] > 0.0);
        }
    }
}

#[test]
fn nothing_stands_in_for_a_spring_without_imus() {
    let frames = spoiled(|raw| raw.present &= !(1 << 4 | 0b1111 << SPRINGS));
    // A pad's way is known from its velocity for a moment.
    assert!(
        frames
            .iter()
            .skip(100)
            .all(|(frame, _, _)| frame.is_blind())
    );
}

/// Changes the gate of spring `i` so that its length reads longer by `off_m`.
fn shift(raw: &mut RawFrame, calibration: &Calibration, i: usize, off_m: f64) {
    let rate_hz = raw.spring_tick_rate_hz(i);
    let length_m = |ticks: u32| {
        let read = spring::read(calibration.spring(i), raw.spring_counts[i], ticks, rate_hz);
        match read {
            SpringReading::Length(length_m) => length_m,
            _ => f64::INFINITY,
        }
    };
    let now = raw.spring_gate_ticks[i];
    let wanted_m = length_m(now) + off_m;
    let off = |ticks: &u32| (length_m(*ticks) - wanted_m).abs();
    let best = (now - 200..now + 200).min_by(|a, b| off(a).total_cmp(&off(b)));
    raw.spring_gate_ticks[i] = best.expect("some");
}

/// Two springs that jump at once are both named, and no other is (before: one of them, a healthy one, or nobody).
#[test]
fn two_springs_that_jump_are_both_named() {
    for (a, b, off_m) in [
        (0, 1, [3e-3, -3e-3]),
        (2, 5, [-7e-3, 4e-3]),
        (7, 10, [9e-3, 9e-3]),
    ] {
        let mut rig = Rig::new(sway);
        let mut sensing = sensing();
        let calibration = Calibration::as_drawn();
        while rig.t_s() < 10.0 {
            sensing.update(&rig.next());
        }
        let mut last = None;
        while rig.t_s() < 14.0 {
            let mut raw = rig.next();
            shift(&mut raw, &calibration, a, off_m[0]);
            shift(&mut raw, &calibration, b, off_m[1]);
            last = Some(sensing.update(&raw));
        }
        let health = last.expect("frames").health;
        for (i, h) in health.springs.iter().enumerate() {
            assert_eq!(
                *h != ChannelHealth::Ok,
                i == a || i == b,
                "{i} of {a} {b}: {h:?}"
            );
        }
    }
}

/// One spring unplugged from the start: the pads' poses are found, and stay known (before: never aligned).
#[test]
fn any_one_spring_may_be_missing_from_the_start() {
    for victim in [0, 5, 9] {
        let mut rig = Rig::new(sway);
        let mut sensing = sensing();
        let mut found_s = None;
        while rig.t_s() < 40.0 {
            let mut raw = rig.next();
            raw.present &= !(1 << victim);
            let out = sensing.update(&raw);
            if sensing.need().is_none() {
                found_s.get_or_insert(rig.t_s());
            }
            assert!(
                rig.t_s() < 1.0 || !out.is_blind(),
                "{victim} at {}",
                rig.t_s()
            );
        }
        assert!(found_s.is_some_and(|t| t < 15.0), "{victim}: {found_s:?}");
    }
}

/// A board's counter that repeats all six pairs while the arm moves straight (before: nobody stuck).
#[test]
fn a_hung_counter_is_stuck_within_half_a_second() {
    let mut rig = Rig::new(sway);
    let mut sensing = sensing();
    while rig.t_s() < 10.0 {
        sensing.update(&rig.next());
    }
    let held = rig.next();
    let since_s = rig.t_s();
    let mut stuck_s = None;
    while rig.t_s() < since_s + 1.0 {
        let mut raw = rig.next();
        raw.spring_counts[..LEGS].copy_from_slice(&held.spring_counts[..LEGS]);
        raw.spring_gate_ticks[..LEGS].copy_from_slice(&held.spring_gate_ticks[..LEGS]);
        let out = sensing.update(&raw);
        let all = out.health.springs[..LEGS].iter();
        if all.clone().all(|h| *h == ChannelHealth::Stuck) {
            stuck_s.get_or_insert(rig.t_s() - since_s);
        }
        assert!(
            out.health.springs[LEGS..]
                .iter()
                .all(|h| *h == ChannelHealth::Ok)
        );
    }
    assert!(stuck_s.is_some_and(|t| t <= 0.5), "{stuck_s:?}");
}

/// A spring that comes back after minutes accuses nobody.
#[test]
fn a_spring_that_returns_accuses_nobody() {
    let mut rig = Rig::new(sway);
    let mut sensing = sensing();
    while rig.t_s() < 180.0 {
        let mut raw = rig.next();
        if (20.0..150.0).contains(&rig.t_s()) {
            raw.present &= !(1 << 3);
        }
        let out = sensing.update(&raw);
        for (i, h) in out.health.springs.iter().enumerate() {
            assert!(
                i == 3 || *h == ChannelHealth::Ok,
                "{i} {h:?} at {}",
                rig.t_s()
            );
        }
        assert!(out.health.imus.iter().all(|h| *h == ChannelHealth::Ok));
        if rig.t_s() > 152.0 {
            assert_eq!(out.health.springs[3], ChannelHealth::Ok, "at {}", rig.t_s());
        }
    }
}

/// Exchanged boards and plugs are named after some motion (before: never).
#[test]
fn exchanged_plugs_and_boards_are_named() {
    for swap in [Swap::Boards, Swap::Springs(1, 4), Swap::Imus(2, 3)] {
        let mut rig = Rig::new(sway);
        let mut sensing = sensing();
        let mut named = None;
        while rig.t_s() < 120.0 && named.is_none() {
            let mut raw = rig.next();
            match swap {
                Swap::Boards => {
                    raw.spring_counts.rotate_left(LEGS);
                    raw.spring_gate_ticks.rotate_left(LEGS);
                    raw.imu.rotate_left(2);
                }
                Swap::Springs(a, b) => {
                    raw.spring_counts.swap(a, b);
                    raw.spring_gate_ticks.swap(a, b);
                }
                Swap::Imus(a, b) => raw.imu.swap(a, b),
            }
            sensing.update(&raw);
            named = sensing.wiring();
        }
        assert_eq!(named, Some(swap));
    }
}
