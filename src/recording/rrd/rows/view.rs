//! What viewers draw: scalars in the units of their names and the scene, at a reduced rate.

use super::tables::Table;
use crate::recording::ArmDrawing;
use crate::recording::rrd::blueprint::Shown;
use crate::recording::rrd::scene::{Part, Scene};
use crate::recording::rrd::schema::{SPECS, table};
use crate::signal::{
    Pose, RawFrame, SPRINGS, SensorFrame, Snapshot, Stamp, pose_error, ypr_from_rotation,
};

/// Session time between two rows of a plot, ns.
const PLOT_NS: i64 = 50_000_000;
/// Session time between two pictures of the scene, ns.
const SCENE_NS: i64 = 100_000_000;
/// Session time after which a file's part for viewers is written, ns.
const FILE_NS: i64 = 5_000_000_000;

/// Rows for viewers since their last batch.
pub(super) struct View {
    tables: Vec<Table>,
    scene: Scene,
    drawing: Option<ArmDrawing>,
    shown: Shown,
    begun: Option<Stamp>,
    last: Option<Stamp>,
    last_plot: Option<Stamp>,
    last_scene: Option<Stamp>,
}

impl View {
    pub(super) fn new(drawing: Option<ArmDrawing>, shown: Shown) -> Self {
        Self {
            tables: SPECS.iter().map(Table::new).collect(),
            scene: Scene::default(),
            drawing,
            shown,
            begun: None,
            last: None,
            last_plot: None,
            last_scene: None,
        }
    }

    /// Takes a snapshot, if it is time for one.
    pub(super) fn push(&mut self, snapshot: &Snapshot) {
        let t = snapshot.stamp;
        self.begun.get_or_insert(t);
        self.last = Some(t);
        // Ticks lie beside their times by a little.
        let due = |last: Option<Stamp>, ns: i64| {
            last.is_none_or(|last| t.0.saturating_sub(last.0) >= ns - ns / 20)
        };
        if due(self.last_plot, PLOT_NS) {
            self.last_plot = Some(t);
            self.plot(t, snapshot);
        }
        if due(self.last_scene, SCENE_NS) {
            self.last_scene = Some(t);
            self.scene.push(snapshot, self.drawing.as_ref());
        }
    }

    /// Whether what waits is enough for a batch.
    pub(super) fn is_due(&self) -> bool {
        let waited = match (self.begun, self.last) {
            (Some(begun), Some(last)) => last.0.saturating_sub(begun.0),
            _ => return false,
        };
        self.shown == Shown::Live || waited >= FILE_NS
    }

    /// Takes what waits, an entity each.
    pub(super) fn take(&mut self) -> Result<Vec<Part>, arrow::error::ArrowError> {
        self.begun = None;
        let mut parts = self.scene.take();
        for table in &mut self.tables {
            parts.extend(table.take()?);
        }
        Ok(parts)
    }

    fn plot(&mut self, t: Stamp, snapshot: &Snapshot) {
        if let Some(raw) = &snapshot.raw {
            self.plot_raw(t, raw);
        }
        if let Some(frame) = &snapshot.sensors {
            self.plot_sensors(t, frame);
        }
        let predicted = snapshot.estimate.as_ref().map(|e| e.base_from_tip);
        if let Some(pose) = &predicted {
            self.plot_pose(t, pose, [table::PREDICTED, table::PREDICTED_YPR]);
        }
        let seen = snapshot.truth.as_ref().map(|g| g.base_from_tip);
        if let Some(pose) = &seen {
            self.plot_pose(t, pose, [table::VICON, table::VICON_YPR]);
        }
        if let (Some(predicted), Some(seen)) = (predicted, seen) {
            let e = pose_error(&predicted, &seen);
            self.tables[table::ERROR_MM].push(t, &[mm(e.fixed_rows::<3>(0).norm())]);
            self.tables[table::ERROR_DEG].push(t, &[e.fixed_rows::<3>(3).norm().to_degrees()]);
        }
        if let Some(d) = &snapshot.disagreement {
            self.tables[table::DISAGREEMENT].push(t, &[d.ratio]);
        }
        if let Some(command) = &snapshot.command {
            self.tables[table::SET].push(t, &command.chamber_pa().map(kpa));
        }
        if let Some(reference) = &snapshot.sensor_ref {
            let (spring_m, imu_rad) = reference.as_slice().split_at(SPRINGS);
            self.push_scaled(table::SPRING_REF, t, spring_m, mm);
            self.push_scaled(table::IMU_REF, t, imu_rad, f64::to_degrees);
        }
        if let Some(goal) = &snapshot.goal {
            self.tables[table::GOAL].push(t, &goal.position_m.map(mm));
        }
    }

    fn plot_raw(&mut self, t: Stamp, raw: &RawFrame) {
        self.tables[table::COUNTS].push(t, &raw.spring_counts.map(f64::from));
        self.tables[table::GATES].push(t, &raw.spring_gate_ticks.map(f64::from));
        let gyro: Vec<f64> = raw.imu.iter().flat_map(|i| i.gyro_rad_s).collect();
        let accel: Vec<f64> = raw.imu.iter().flat_map(|i| i.accel_m_s2).collect();
        self.tables[table::GYRO].push(t, &gyro);
        self.tables[table::ACCEL].push(t, &accel);
    }

    fn plot_sensors(&mut self, t: Stamp, frame: &SensorFrame) {
        self.push_scaled(table::SPRINGS, t, &frame.sensors.spring_m, mm);
        let imu_rad = frame.sensors.imu_ypr_rad.as_flattened();
        self.push_scaled(table::IMUS, t, imu_rad, f64::to_degrees);
        self.push_scaled(table::PRESSURE, t, &frame.chamber_pa, kpa);
    }

    fn plot_pose(&mut self, t: Stamp, pose: &Pose, [position, turn]: [usize; 2]) {
        let p = &pose.translation;
        self.tables[position].push(t, &[mm(p.x), mm(p.y), mm(p.z)]);
        let ypr_rad = ypr_from_rotation(&pose.rotation);
        self.tables[turn].push(t, &ypr_rad.map(f64::to_degrees));
    }

    fn push_scaled(&mut self, table: usize, t: Stamp, si: &[f64], unit: fn(f64) -> f64) {
        let shown: Vec<f64> = si.iter().map(|v| unit(*v)).collect();
        self.tables[table].push(t, &shown);
    }
}

fn mm(m: f64) -> f64 {
    m * 1e3
}

fn kpa(pa: f64) -> f64 {
    pa * 1e-3
}
