use nalgebra::Rotation3;
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::*;
use crate::rig::circuit::{Circuit, USUAL_SCATTER};
use crate::rig::inertial::{Inertial, InertialErrors, PadMotion};
use crate::sensing::Calibration;
use crate::sensing::platform::{self, LEGS, Segment};
use crate::signal::{BOARDS, CHAMBERS, Pose, RawFrame, SPRINGS, Stamp};

const DT_S: f64 = 0.01;
const STILL_S: f64 = 5.0;
const MOTION_S: f64 = 90.0;

/// Errors of such parts as they are delivered: the largest of a data sheet are two of these.
fn as_delivered() -> InertialErrors {
    InertialErrors {
        gyro_bias_rad_s: 10f64.to_radians(),
        accel_bias_m_s2: 0.3,
        scale_ratio: 0.015,
        misalignment_max_rad: 1f64.to_radians(),
        ..InertialErrors::default()
    }
}

/// A base that hangs off level.
fn off_level() -> [f64; 2] {
    [2f64.to_radians(), -2.2f64.to_radians()]
}

/// A segment that bends by `angle_rad` towards `to_rad`, as an arc.
fn bent(angle_rad: f64, to_rad: f64) -> Pose {
    let (sin, cos) = to_rad.sin_cos();
    let axis = Vector3::new(-sin, cos, 0.0);
    let half = 0.5 * angle_rad;
    let away = Vector3::new(-half.sin() * cos, -half.sin() * sin, -half.cos()) * 0.145;
    Pose::from_parts(
        away.into(),
        UnitQuaternion::from_scaled_axis(axis * angle_rad),
    )
}

/// A rose of four petals after a rest, both segments by the same angle.
fn rose(t_s: f64) -> [Pose; 2] {
    let turn = TAU * ((t_s - STILL_S) / MOTION_S).clamp(0.0, 1.0);
    // Begins upright and gently.
    let swell = 1.0 - (-(t_s - STILL_S).max(0.0) / 2.0).exp();
    let angle_rad = 20f64.to_radians() * swell * (2.0 * turn).sin();
    [bent(angle_rad, turn); 2]
}

/// To one side only.
fn nod(t_s: f64) -> [Pose; 2] {
    let angle_rad = 0.3 * (1.0 - ((t_s - STILL_S).max(0.0) * 0.2).cos());
    [bent(0.5 * angle_rad, 0.4); 2]
}

/// Pads that follow a path: physical circuits, erring IMUs.
struct Rig {
    robot: RobotSpec,
    circuit: Circuit,
    inertial: Inertial,
    rng: Pcg64,
    frame: u32,
    path: fn(f64) -> [Pose; 2],
    gravity_in_base_m_s2: Vector3<f64>,
}

impl Rig {
    fn new(path: fn(f64) -> [Pose; 2], seed: u64, tilt_rad: [f64; 2]) -> Self {
        let robot = RobotSpec::reference();
        let base_from_level = Rotation3::new(-Vector3::new(tilt_rad[0], tilt_rad[1], 0.0));
        Self {
            circuit: Circuit::new(&robot, 1, USUAL_SCATTER),
            inertial: Inertial::new(&robot, seed, as_delivered()),
            rng: Pcg64::seed_from_u64(seed),
            frame: 0,
            path,
            gravity_in_base_m_s2: base_from_level * Vector3::z() * -model::GRAVITY_M_S2,
            robot,
        }
    }

    fn pads(&self, t_s: f64) -> [Pose; 2] {
        platform::pads(&self.robot, &(self.path)(t_s))
    }

    fn next(&mut self) -> RawFrame {
        self.frame += 1;
        let t_s = f64::from(self.frame) * DT_S;
        let relative = (self.path)(t_s);
        let lengths: [_; 2] =
            std::array::from_fn(|k| Segment::of(&self.robot, k).lengths_m(&relative[k]));
        let length_m: [f64; SPRINGS] = std::array::from_fn(|i| lengths[i / LEGS][i % LEGS]);
        self.circuit.step(DT_S, &length_m);
        let (spring_counts, spring_gate_ticks) = self.circuit.read(&mut self.rng);
        let h_s = 1e-3;
        let at = [t_s - h_s, t_s, t_s + h_s].map(|t| self.pads(t));
        let motion = [0, 1].map(|p| {
            let turn = at[0][p].rotation.inverse() * at[2][p].rotation;
            let [before, now, after] = at.map(|pads| pads[p].translation.vector);
            let accel = (before + after - now * 2.0) / (h_s * h_s);
            let rate = turn.scaled_axis() / (2.0 * h_s);
            PadMotion::new(&at[1][p].rotation, rate, accel, &self.gravity_in_base_m_s2)
        });
        RawFrame {
            seq: self.frame,
            stamp: Stamp::from_seconds(t_s),
            spring_counts,
            spring_gate_ticks,
            tick_rate_hz: [self.circuit.tick_rate_hz; BOARDS],
            tick_rate_sd: [0.0; BOARDS],
            imu: self
                .inertial
                .read(DT_S, &motion[0], &motion[1], &mut self.rng),
            chamber_pa: [0.0; CHAMBERS],
            present: RawFrame::ALL_PRESENT,
            board_age_s: [0.002; BOARDS],
            faults: 0,
        }
    }

    fn windows(
        &mut self,
        seconds: f64,
        spoil: &mut dyn FnMut(&mut RawFrame),
    ) -> (Vec<Window>, Windows) {
        let mut windows = Windows::new(&self.robot, &Calibration::as_drawn());
        let frames = (seconds / DT_S) as usize;
        let made = (0..frames)
            .filter_map(|_| {
                let mut raw = self.next();
                spoil(&mut raw);
                windows.push(&raw)
            })
            .collect();
        (made, windows)
    }
}

fn captured(robot: &RobotSpec, windows: &[Window]) -> [Capture; IMUS] {
    std::array::from_fn(|i| {
        let mut capture = Capture::default();
        for w in windows {
            if let (Some(pad), Some(raw)) = (&w.base_from_pad[robot.imus[i].pad.index()], &w.imu[i])
            {
                capture.add(w.t_s, pad, raw);
            }
        }
        capture
    })
}

fn start(rest: Option<RestZero>, springs_out: Vec<usize>) -> Start {
    Start {
        gyro_bias_rad_s: rest.map_or([None; IMUS], |r| r.gyro_bias_rad_s),
        base_tilt_rad: [0.0; 2],
        springs_out,
        ends_sigma_m: 0.05e-3,
    }
}

/// RMS angle between a pad's true inclination and that by its IMU, over tilts up to `most_rad` to all sides, rad.
fn inclination_rms_rad(rig: &mut Rig, fit: &ImuFit, most_rad: f64) -> f64 {
    let i = fit.entry.imu - 1;
    let nominal = UnitQuaternion::from_rotation_matrix(&rig.robot.imus[i].pad_from_imu);
    let pad_from_imu = UnitQuaternion::from_scaled_axis(fit.entry.fit.correction_rad) * nominal;
    let (mut squares, mut n) = (0.0, 0.0);
    for ring in 0..=4 {
        for side in 0..16 {
            let to = TAU * f64::from(side) / 16.0;
            let pad = bent(most_rad * f64::from(ring) / 4.0, to).rotation;
            let zero = Vector3::zeros();
            let motion = PadMotion::new(&pad, zero, zero, &rig.gravity_in_base_m_s2);
            let mut mean = Vector3::zeros();
            for _ in 0..100 {
                let raw = rig.inertial.read(0.0, &motion, &motion, &mut rig.rng)[i];
                mean += Vector3::from(fit.entry.zero.remove(&raw).accel_m_s2) / 100.0;
            }
            squares += (pad_from_imu * mean).angle(&motion.up_in_pad).powi(2);
            n += 1.0;
        }
    }
    f64::sqrt(squares / n)
}

#[test]
fn raw_imus_on_a_base_off_level_are_calibrated() {
    for seed in 1..=4 {
        let mut rig = Rig::new(rose, seed, off_level());
        let (windows, _) = rig.windows(STILL_S + MOTION_S, &mut |_| ());
        let rest = first_rest(&windows, &rig.robot).expect("rests");
        let captures = captured(&rig.robot, &windows);
        let fit = fit(
            &rig.robot,
            &captures.each_ref().map(Some),
            &start(Some(rest), Vec::new()),
        );
        let tilt_off_deg: [f64; 2] =
            std::array::from_fn(|a| (fit.base_tilt_rad[a] - off_level()[a]).to_degrees());
        println!(
            "seed {seed}: tilt off {tilt_off_deg:?} deg, open {:?}",
            fit.open()
        );
        for found in fit.imus.iter().flatten() {
            let found = found.as_ref().expect("fits");
            let i = found.entry.imu - 1;
            let [near_deg, far_deg] = [20f64, 40.0].map(|most_deg| {
                inclination_rms_rad(&mut rig, found, most_deg.to_radians()).to_degrees()
            });
            let nominal = UnitQuaternion::from_rotation_matrix(&rig.robot.imus[i].pad_from_imu);
            let mounted =
                UnitQuaternion::from_scaled_axis(found.entry.fit.correction_rad) * nominal;
            let truth = UnitQuaternion::from_rotation_matrix(&rig.inertial.pad_from_imu(i));
            let mounting_deg = mounted.angle_to(&truth).to_degrees();
            println!(
                "  IMU {}: inclination {near_deg:.3} deg to 20, {far_deg:.3} to 40; mounting off {mounting_deg:.3}; residual {:.3}",
                i + 1,
                found.entry.fit.residual_rad.to_degrees()
            );
            assert!(near_deg < 0.3 && far_deg < 0.3, "{near_deg} {far_deg}");
            assert!(mounting_deg < 0.3, "{mounting_deg}");
            if seed == 1 {
                for p in &found.parameters {
                    println!("    {} {:.4} +- {:.4} {}", p.name, p.value, p.sigma, p.unit);
                }
            }
        }
        assert!(
            tilt_off_deg.iter().all(|d| d.abs() < 0.1),
            "{tilt_off_deg:?}"
        );
    }
}

#[test]
fn a_rest_is_refused_for_the_fit_and_gives_the_gyros_zeros() {
    let mut rig = Rig::new(|_| [bent(0.0, 0.0); 2], 2, [0.0; 2]);
    let (windows, _) = rig.windows(40.0, &mut |_| ());
    let captures = captured(&rig.robot, &windows);
    let fit = fit(
        &rig.robot,
        &captures.each_ref().map(Some),
        &start(None, Vec::new()),
    );
    for found in fit.imus.iter().flatten() {
        assert_eq!(found, &Err(FitError::Sides { seen: 0 }));
    }
    let zero = rest(&windows, &rig.robot).expect("rests");
    for (i, bias) in zero.gyro_bias_rad_s.iter().enumerate() {
        let bias = bias.expect("was read");
        let mean: Vector3<f64> = windows
            .iter()
            .filter_map(|w| Some(Vector3::from(w.imu[i]?.gyro_rad_s)))
            .sum::<Vector3<f64>>()
            / windows.len() as f64;
        assert!((bias - mean).norm().to_degrees() < 0.02 && bias.norm() > 0.01);
    }
}

#[test]
fn a_moving_arm_is_no_rest_and_the_refusal_names_the_imu() {
    let mut rig = Rig::new(rose, 3, [0.0; 2]);
    let (windows, _) = rig.windows(30.0, &mut |_| ());
    let e = rest(&windows, &rig.robot).expect_err("moves");
    let RestError::Moved { imu, rate_rad_s } = e else {
        panic!("{e:?}");
    };
    assert!((1..=IMUS).contains(&imu) && rate_rad_s > REST_RATE);
    assert!(e.to_string().contains("deg/s; hold the arm still"), "{e}");
    let e = rest(&windows[..10], &rig.robot).expect_err("short");
    assert!(matches!(e, RestError::TooShort { .. }));
    assert!(
        first_rest(&windows, &rig.robot).is_ok(),
        "it began with one"
    );
}

const REST_RATE: f64 = 0.3 * std::f64::consts::PI / 180.0;

#[test]
fn motion_to_one_side_and_springs_that_are_out_are_refused() {
    let mut rig = Rig::new(nod, 5, [0.0; 2]);
    let (windows, _) = rig.windows(60.0, &mut |_| ());
    let captures = captured(&rig.robot, &windows);
    let found = fit(
        &rig.robot,
        &captures.each_ref().map(Some),
        &start(None, Vec::new()),
    );
    for found in found.imus.iter().flatten() {
        let e = found.as_ref().expect_err("one side");
        assert!(e.to_string().contains("of 8 sides only"), "{e}");
    }
    let mut rig = Rig::new(rose, 5, [0.0; 2]);
    let (windows, springs) = rig.windows(60.0, &mut |raw| raw.present &= !(1 << 8));
    assert_eq!(springs.springs_out(), [9]);
    assert!(windows.iter().all(|w| w.base_from_pad[1].is_none()));
    let captures = captured(&rig.robot, &windows);
    let found = fit(
        &rig.robot,
        &captures.each_ref().map(Some),
        &start(None, springs.springs_out()),
    );
    for (i, found) in found.imus.iter().flatten().enumerate() {
        match rig.robot.imus[i].pad.index() {
            0 => assert!(!matches!(found, Err(FitError::Springs { .. }))),
            _ => {
                let e = found.as_ref().expect_err("no springs").to_string();
                assert!(e.contains("spring 9 gave no length"), "{e}");
            }
        }
    }
}

#[test]
fn small_tilts_leave_parameters_open_and_the_remedy_is_stated() {
    fn little(t_s: f64) -> [Pose; 2] {
        rose(t_s).map(|p| {
            let rotation = UnitQuaternion::identity().slerp(&p.rotation, 0.3);
            Pose::from_parts(p.translation, rotation)
        })
    }
    let mut rig = Rig::new(little, 6, [0.0; 2]);
    let (windows, _) = rig.windows(STILL_S + MOTION_S, &mut |_| ());
    let captures = captured(&rig.robot, &windows);
    let found = fit(
        &rig.robot,
        &captures.each_ref().map(Some),
        &start(None, Vec::new()),
    );
    let open = found.open();
    println!("{open:#?}");
    assert!(
        open.iter()
            .any(|s| s.contains("accelerometer gain") && s.contains("20 degrees")),
        "{open:?}"
    );
}

#[test]
fn a_gyro_that_no_working_part_has_is_refused() {
    let mut rig = Rig::new(rose, 7, [0.0; 2]);
    rig.inertial.add_gyro_bias(2, Vector3::x() * 1.2);
    let (windows, _) = rig.windows(STILL_S + MOTION_S, &mut |_| ());
    let captures = captured(&rig.robot, &windows);
    let rested = first_rest(&windows, &rig.robot).expect("rests");
    let found = fit(
        &rig.robot,
        &captures.each_ref().map(Some),
        &start(Some(rested), Vec::new()),
    );
    let Some(Err(e)) = &found.imus[2] else {
        panic!("{:?}", found.imus[2]);
    };
    assert!(e.to_string().contains("gyro_bias_deg_s"), "{e}");
    assert!(matches!(found.imus[0], Some(Ok(_))));
}

#[test]
fn a_long_capture_stays_small_and_fast_motion_is_left_out() {
    let raw = ImuRaw {
        gyro_rad_s: [0.0; 3],
        accel_m_s2: [0.0, 0.0, model::GRAVITY_M_S2],
    };
    let mut capture = Capture::default();
    for k in 0..18_000 {
        let lean = bent(0.1 + 1e-6 * f64::from(k), 0.3).rotation;
        capture.add(0.1 * f64::from(k), &SpringPad::exact(lean), &raw);
    }
    assert!((SAMPLES_MAX / 2 - 1..SAMPLES_MAX).contains(&capture.samples()));
    assert_eq!(capture.tilts_rad().len(), capture.samples());
    assert!(capture.tilts_rad()[0][0] < 0.097 && !capture.is_complete());
    let mut fast = Capture::default();
    for k in 0..100 {
        let lean = bent(0.1 * f64::from(k % 2), 0.3).rotation;
        fast.add(0.1 * f64::from(k), &SpringPad::exact(lean), &raw);
    }
    assert_eq!(fast.samples(), 1);
}

#[test]
fn tilt_points_to_where_the_pad_leans() {
    let [x, y] = tilt(&UnitQuaternion::from_scaled_axis(Vector3::y() * 0.2));
    assert!((x - 0.2).abs() < 1e-12 && y.abs() < 1e-12, "{x} {y}");
    assert_eq!(tilt(&UnitQuaternion::identity()), [0.0, 0.0]);
}

#[test]
fn a_pad_turns_with_its_springs_ends_as_the_derivative_states() {
    let mut rig = Rig::new(rose, 8, [0.0; 2]);
    let frames: Vec<RawFrame> = (0..2500).map(|_| rig.next()).collect();
    let pad = |calibration: &Calibration| {
        let mut windows = Windows::new(&rig.robot, calibration);
        let last = frames.iter().filter_map(|raw| windows.push(raw)).last();
        last.and_then(|w| w.base_from_pad[1].clone())
            .expect("a pad")
    };
    let nominal = Calibration::as_drawn();
    let at = pad(&nominal);
    assert!(tilt(&at.rotation)[0].hypot(tilt(&at.rotation)[1]) > 0.2);
    let h_m = 1e-5;
    for (spring, end, axis) in [(0, 0, 1), (4, 1, 0), (7, 0, 2), (11, 1, 1)] {
        let mut other = nominal.clone();
        other.springs[spring].ends_off_m[end][axis] += h_m;
        let turned = (at.rotation.inverse() * pad(&other).rotation).scaled_axis() / h_m;
        let wanted = at.by_ends.column(6 * spring + 3 * end + axis).into_owned();
        assert!(
            (turned - wanted).norm() < 1e-2 * (1.0 + wanted.norm()),
            "{turned} {wanted}"
        );
    }
}
