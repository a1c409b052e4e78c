//! Plausible snapshots for tests and pictures: the arm moves slowly in constant-curvature bends.

use std::sync::Arc;

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use crate::robot::RobotSpec;
use crate::signal::{
    ArmShape, BOARDS, CHAMBERS, ClockFit, Estimate, Goal, Gripper, GroundTruth, Health, IMUS,
    LinkStatus, Matrix6, MeshShape, Mode, Pose, PressureCommand, Quality, RawFrame, Reach,
    ReachState, RoutineStatus, SIGNALS, SPRINGS, SensorFrame, SensorVec, Skin, Snapshot, Stamp,
    Trace, TruthSource, pose_from_ypr, ypr_from_rotation,
};

// A few-sine stand-in for noise: deterministic, mean near zero, amplitude 1.
fn noise(t_s: f64, channel: usize) -> f64 {
    let c = channel as f64;
    ((t_s * (61.3 + 7.1 * c) + c).sin()
        + (t_s * (27.7 + 3.3 * c) + 2.0 * c).sin()
        + (t_s * (5.9 + 0.7 * c)).sin())
        / 3.0
}

// Arc of length `length_m` bent by `bend_rad` towards `azimuth_rad`, hanging along -z.
fn arc(length_m: f64, bend_rad: f64, azimuth_rad: f64) -> Pose {
    let axis = Vector3::new(azimuth_rad.sin(), -azimuth_rad.cos(), 0.0);
    let r = UnitQuaternion::from_scaled_axis(axis * -bend_rad);
    let (along, aside) = if bend_rad.abs() < 1e-9 {
        (length_m, 0.0)
    } else {
        let radius = length_m / bend_rad;
        (radius * bend_rad.sin(), radius * (1.0 - bend_rad.cos()))
    };
    let p = Vector3::new(
        -aside * azimuth_rad.cos(),
        -aside * azimuth_rad.sin(),
        -along,
    );
    Pose::from_parts(Translation3::from(p), r)
}

fn shape(t_s: f64, spec: &RobotSpec) -> ArmShape {
    let bend = [
        0.35 + 0.12 * (0.21 * t_s).sin(),
        0.25 + 0.10 * (0.17 * t_s).cos(),
    ];
    let azimuth = [
        0.4 + 0.3 * (0.11 * t_s).sin(),
        0.9 + 0.2 * (0.13 * t_s).cos(),
    ];
    let length = [
        0.150 + 0.006 * (0.19 * t_s).sin(),
        0.147 + 0.005 * (0.23 * t_s).cos(),
    ];
    let sections = 12;
    let mut pads = [Pose::identity(); 3];
    let mut base = Pose::identity();
    let base_from_section = std::array::from_fn(|k| {
        let frames: Vec<Pose> = (0..=sections)
            .map(|i| {
                let u = f64::from(i) / f64::from(sections);
                base * arc(length[k] * u, bend[k] * u, azimuth[k])
            })
            .collect();
        pads[k + 1] = frames[frames.len() - 1];
        base = pads[k + 1] * Pose::translation(0.0, 0.0, -spec.pad_thickness_m);
        frames
    });
    let above = [
        pads[0],
        pads[1] * Pose::translation(0.0, 0.0, -spec.pad_thickness_m),
    ];
    ArmShape {
        base_from_section,
        base_from_pad: pads,
        spring_ends_m: std::array::from_fn(|i| {
            let top = above[i / 6] * nalgebra::Point3::from(spec.spring_top_m[i]);
            let bottom = pads[i / 6 + 1] * nalgebra::Point3::from(spec.spring_bottom_m[i]);
            [top.coords.into(), bottom.coords.into()]
        }),
    }
}

/// Everything healthy, moving, at `t_s`.
pub fn snapshot(t_s: f64) -> Snapshot {
    let spec = RobotSpec::reference();
    let stamp = Stamp::from_seconds(t_s);
    let shape = shape(t_s, &spec);
    let tip = shape.base_from_pad[2];
    let chamber_pa = std::array::from_fn(|i| {
        let phase = i as f64 * 1.1;
        22e3 * (0.2 * t_s + phase).sin() + 8e3 * phase.cos() + 60.0 * noise(t_s, i)
    });
    let sensors = SensorVec {
        spring_m: std::array::from_fn(|i| {
            let [a, b] = shape.spring_ends_m[i].map(Vector3::from);
            (b - a).norm() + 1.2e-4 * noise(t_s, 10 + i)
        }),
        imu_ypr_rad: std::array::from_fn(|i| {
            let ypr = ypr_from_rotation(&shape.base_from_pad[1 + i / 2].rotation);
            std::array::from_fn(|k| ypr[k] + 0.004 * noise(t_s, 30 + 3 * i + k))
        }),
    };
    let wobble = |scale: f64, at: usize| -> [f64; 3] {
        std::array::from_fn(|k| {
            scale * (0.7 * noise(t_s, at + k) + 0.6 * (0.4 * t_s + k as f64).sin())
        })
    };
    let estimate = tip * pose_from_ypr(wobble(0.7e-3, 50), wobble(0.009, 60));
    let mut raw = RawFrame {
        seq: (t_s * 100.0) as u32,
        stamp,
        present: RawFrame::ALL_PRESENT,
        chamber_pa,
        board_age_s: [0.004, 0.007],
        ..RawFrame::default()
    };
    raw.tick_rate_hz = [16e6; 2];
    let limits = &spec.pressure;
    let goal_m = [-0.062, -0.041, -0.268];
    Snapshot {
        stamp,
        mode: Mode::Moving,
        link: LinkStatus {
            connected: true,
            refusal: None,
            source: "virtual rig".into(),
            simulated: true,
            practice: false,
            frames: (t_s * 100.0) as u64,
            frames_lost: 3,
            frames_late: 0,
            age_s: 0.012,
            retry_in_s: None,
            gripper: Some(Gripper::Open),
            pumps: [Some(true); BOARDS],
            venting: false,
            stop_open: false,
            supply_cut: false,
            board_simulated: [Some(true); BOARDS],
            rig: [None; BOARDS],
            trouble: None,
            mocap_trouble: None,
            host_delay: None,
            board_rate_hz: [100.0, 99.9],
            board_clock: [(-3.1, -38e-6), (-1207.4, 21e-6)].map(|(offset_s, skew_ratio)| {
                Some(ClockFit {
                    offset_s,
                    skew_ratio,
                    residual_s: 42e-6,
                    round_trip_s: 1.1e-3,
                })
            }),
        },
        raw: Some(raw),
        sensors: Some(SensorFrame {
            stamp,
            extra_sigma: [0.0; SIGNALS],
            delivered: Default::default(),
            sensors,
            chamber_pa,
            health: Health::default(),
            quality: Quality::default(),
        }),
        estimate: Some(Estimate {
            stamp,
            base_from_tip: estimate,
            covariance: Matrix6::from_diagonal(&[2.5e-7, 2.5e-7, 1.6e-7, 9e-5, 9e-5, 9e-5].into()),
            training_distance: 1.1,
        }),
        truth: Some(GroundTruth {
            stamp,
            base_from_tip: tip,
            source: TruthSource::VirtualRig,
        }),
        goal: Some(Goal::position(goal_m)),
        preview: None,
        sensor_ref: None,
        command: Some(PressureCommand::limited(
            stamp,
            chamber_pa.map(|p| p + 1.8e3),
            Gripper::Open,
            None,
            &chamber_pa.map(|p| p + 1.8e3),
            limits,
        )),
        shape: Some(Arc::new(shape)),
        payload_kg: 0.035,
        ..Snapshot::default()
    }
}

/// A skin of plain cylinders around a snapshot's bellows and tubes, on the snapshot's shape.
pub fn mesh(of: &Snapshot) -> MeshShape {
    const SECTORS: usize = 12;
    let spec = RobotSpec::reference();
    let shape = of.shape.as_deref().cloned().unwrap_or_default();
    let mut skin = Skin::default();
    for column in 0..CHAMBERS + 2 {
        let (segment, centre, radius_m) = if column < CHAMBERS {
            let radius_m = 0.5 * spec.bellows_outer_diameter_m;
            (column / 3, spec.bellows_m[column], radius_m)
        } else {
            (column - CHAMBERS, Vector3::zeros(), 0.01)
        };
        let first = skin.triangles.len();
        for (layer, frame) in shape.base_from_section[segment].iter().enumerate() {
            for j in 0..SECTORS {
                let a = std::f64::consts::TAU * j as f64 / SECTORS as f64;
                let out = Vector3::new(a.cos(), a.sin(), 0.0);
                let at = frame * nalgebra::Point3::from(centre + out * radius_m);
                if layer > 0 {
                    let here = skin.positions_m.len() - j;
                    let id = |back: usize, j: usize| (here - back * SECTORS + j % SECTORS) as u32;
                    let (a, b, d, e) = (id(1, j), id(1, j + 1), id(0, j), id(0, j + 1));
                    skin.triangles.extend([[a, d, e], [a, e, b]]);
                }
                skin.positions_m.push(at.coords.into());
                skin.normals.push((frame.rotation * out).into());
            }
        }
        skin.columns.push(first..skin.triangles.len());
    }
    MeshShape {
        stamp: of.stamp,
        shape,
        skin,
        apart_m: Some(4.2e-3),
    }
}

/// `seconds` of [`snapshot`]s at 50 Hz, beginning at 100 s.
pub fn session(seconds: usize) -> Vec<Snapshot> {
    (0..seconds * 50)
        .map(|i| snapshot(100.0 + i as f64 * 0.02))
        .collect()
}

/// A verdict on `goal_m`.
pub fn reach(state: ReachState, goal_m: [f64; 3]) -> Reach {
    let [x, y, z] = goal_m;
    let (distance_m, nearest_m, limiting_chamber) = match state {
        ReachState::Reachable => (0.0, goal_m, None),
        ReachState::Marginal => (0.0, goal_m, Some((2, 38.4e3))),
        ReachState::Unreachable => (0.018, [x * 0.9, y * 0.9, z + 0.01], Some((4, 40e3))),
        ReachState::OutsideData => (0.031, [x * 0.8, y * 0.8, z], None),
    };
    Reach {
        state,
        distance_m,
        nearest_m,
        limiting_chamber,
        chamber_pa: [0.0; CHAMBERS],
    }
}

/// A recording of `seconds`.
pub fn trace(name: &str, seconds: usize) -> Trace {
    Trace {
        name: name.into(),
        snapshots: session(seconds),
        payload_kg: 0.035,
        simulated: Some(true),
    }
}

const _: () = assert!(SPRINGS == 12 && IMUS == 4);

/// A plan of one leg, under way or paused.
pub fn routine(name: &str) -> RoutineStatus {
    RoutineStatus {
        name: name.to_owned(),
        legs_done: 0,
        legs: 1,
        waypoint: None,
        via: None,
    }
}
