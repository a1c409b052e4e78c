//! Plausible sessions of any length and rate: slow waves with some noise, every part new in each snapshot.

use std::sync::Arc;

use springtwin::robot::RobotSpec;
use springtwin::signal::{
    ArmShape, Estimate, Goal, Gripper, GroundTruth, Health, ImuRaw, Matrix6, Mode, Pose,
    PressureCommand, PressureLimits, Quality, RawFrame, SIGNALS, SensorFrame, SensorRef, SensorVec,
    Snapshot, Stamp, TruthSource, pose_from_ypr,
};
use springtwin::sim::{Model, State, observe};

/// What stays the same in a session.
pub struct Session {
    rest: SensorVec,
    base_from_tip: Pose,
    shape: Arc<ArmShape>,
}

impl Session {
    /// The reference robot at rest.
    pub fn new() -> Self {
        let model = Model::nominal(&RobotSpec::reference());
        let observed = observe(&model, &State::rest(&model));
        Self {
            rest: observed.sensors,
            base_from_tip: observed.base_from_tip,
            shape: Arc::new(observed.shape),
        }
    }

    /// Snapshot `k` of a session at `hz`.
    pub fn snapshot(&self, k: u64, hz: u64) -> Snapshot {
        let stamp = Stamp((k * (1_000_000_000 / hz)) as i64);
        let t_s = stamp.seconds();
        // In -0.5..0.5, the same for the same snapshot and place.
        let noise = |i: usize| {
            let h = (k * 128 + i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 11;
            h as f64 / (1u64 << 53) as f64 - 0.5
        };
        let wave = |i: usize| (0.31 * t_s * (1.0 + 0.07 * i as f64) + i as f64).sin();
        let pa: [f64; 6] = std::array::from_fn(|i| 2e4 * wave(i) + 80.0 * noise(i));
        let sensors = SensorVec {
            spring_m: std::array::from_fn(|i| {
                self.rest.spring_m[i] + 0.01 * wave(i) + 2e-4 * noise(10 + i)
            }),
            imu_ypr_rad: std::array::from_fn(|i| {
                std::array::from_fn(|k| 0.2 * wave(3 * i + k) + 5e-3 * noise(30 + 3 * i + k))
            }),
        };
        let tip = |noise_m: f64| {
            let at: [f64; 3] = std::array::from_fn(|i| 0.05 * wave(i) + noise_m * noise(50 + i));
            let turn: [f64; 3] = std::array::from_fn(|i| 0.2 * wave(i) + noise_m * noise(55 + i));
            self.base_from_tip * pose_from_ypr(at, turn)
        };
        let limits = PressureLimits {
            min_pa: -1e6,
            max_pa: 1e6,
            rate_pa_s: 1e9,
        };
        let mut snapshot = Snapshot {
            stamp,
            mode: Mode::Moving,
            raw: Some(RawFrame {
                seq: k as u32,
                stamp,
                spring_counts: std::array::from_fn(|i| 4000 + (100.0 * noise(70 + i)) as u32),
                spring_gate_ticks: std::array::from_fn(|i| 1_600_000 + (4e4 * noise(i)) as u32),
                tick_rate_hz: [16e6; 2],
                tick_rate_sd: [1e-6; 2],
                imu: std::array::from_fn(|i| ImuRaw {
                    gyro_rad_s: std::array::from_fn(|k| 0.05 * noise(85 + 3 * i + k)),
                    accel_m_s2: std::array::from_fn(|k| 9.81 * noise(100 + 3 * i + k)),
                }),
                chamber_pa: pa,
                present: RawFrame::ALL_PRESENT,
                board_age_s: [0.004, 0.007],
                faults: 0,
            }),
            sensor_ref: Some(SensorRef::from_fn(|i, _| 0.1 * wave(i))),
            sensors: Some(SensorFrame {
                stamp,
                extra_sigma: [0.0; SIGNALS],
                delivered: Default::default(),
                sensors,
                chamber_pa: pa,
                health: Health::default(),
                quality: Quality::default(),
            }),
            estimate: Some(Estimate {
                stamp,
                base_from_tip: tip(5e-4),
                covariance: Matrix6::from_fn(|i, j| 1e-7 * (1.0 + noise(6 * i + j))),
                training_distance: 1.0 + 0.1 * noise(60),
            }),
            truth: Some(GroundTruth {
                stamp,
                base_from_tip: tip(0.0),
                source: TruthSource::VirtualRig,
            }),
            goal: Some(Goal::position([0.06, 0.04, -0.30])),
            command: Some(PressureCommand::limited(
                stamp,
                pa,
                Gripper::Open,
                None,
                &pa,
                &limits,
            )),
            shape: Some(Arc::clone(&self.shape)),
            ..Snapshot::default()
        };
        snapshot.link.connected = true;
        snapshot.link.simulated = true;
        snapshot.link.source = "virtual rig".into();
        snapshot.link.board_rate_hz = [100.0, 99.9];
        snapshot.link.frames = k;
        snapshot
    }
}
