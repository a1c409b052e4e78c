//! What can be pointed at in the 3D view.

use crate::gui::panels::widgets::number;
use crate::signal::{CHAMBERS, IMUS, SPRINGS, Snapshot, spring_name};

/// Something that can be pointed at. Numbers count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entity {
    /// A spring.
    Spring(usize),
    /// An IMU.
    Imu(usize),
    /// A bellows, that is a chamber.
    Bellows(usize),
    /// Top, middle or end pad.
    Pad(usize),
    /// The gripper.
    Gripper,
    /// What the gripper holds.
    Payload,
    /// A waypoint of the plan that is shown.
    Waypoint(usize),
}

/// Waypoints have the numbers from here on.
const WAYPOINTS: u32 = 10_000;

impl Entity {
    /// Number for the pick target; 0 stands for nothing.
    pub fn id(self) -> u32 {
        match self {
            Entity::Spring(i) => 100 + i as u32,
            Entity::Imu(i) => 200 + i as u32,
            Entity::Bellows(i) => 300 + i as u32,
            Entity::Pad(i) => 400 + i as u32,
            Entity::Gripper => 500,
            Entity::Payload => 501,
            Entity::Waypoint(i) => WAYPOINTS + i as u32,
        }
    }

    /// Back from [`Entity::id`].
    pub fn from_id(id: u32) -> Option<Self> {
        if let Some(i) = id.checked_sub(WAYPOINTS) {
            return Some(Entity::Waypoint(i as usize));
        }
        let i = (id % 100) as usize;
        match id / 100 {
            1 if i < SPRINGS => Some(Entity::Spring(i)),
            2 if i < IMUS => Some(Entity::Imu(i)),
            3 if i < CHAMBERS => Some(Entity::Bellows(i)),
            4 if i < 3 => Some(Entity::Pad(i)),
            5 if i == 0 => Some(Entity::Gripper),
            5 if i == 1 => Some(Entity::Payload),
            _ => None,
        }
    }

    /// Whether it is a sensor, which a click selects.
    pub fn is_sensor(self) -> bool {
        matches!(self, Entity::Spring(_) | Entity::Imu(_))
    }

    /// What the operator reads: name and, where there is one, the present value.
    pub fn label(self, snapshot: &Snapshot) -> String {
        match self {
            Entity::Spring(i) => match &snapshot.sensors {
                Some(s) => format!(
                    "spring {} ({}), {:.1} mm",
                    i + 1,
                    spring_name(i),
                    s.sensors.spring_m[i] * 1e3
                ),
                None => format!("spring {} ({})", i + 1, spring_name(i)),
            },
            Entity::Imu(i) => match &snapshot.sensors {
                Some(s) => {
                    let angles = s.sensors.imu_ypr_rad[i];
                    let [yaw, pitch, roll] = angles.map(|a| number(a.to_degrees(), 1));
                    format!("IMU {}, yaw {yaw}, pitch {pitch}, roll {roll} deg", i + 1)
                }
                None => format!("IMU {}", i + 1),
            },
            Entity::Bellows(i) => match &snapshot.sensors {
                Some(s) => {
                    let kpa = number(s.chamber_pa[i] * 1e-3, 1);
                    format!("chamber {}, {kpa} kPa", i + 1)
                }
                None => format!("chamber {}", i + 1),
            },
            Entity::Pad(0) => "top pad".to_owned(),
            Entity::Pad(1) => "middle pad".to_owned(),
            Entity::Pad(_) => "end pad".to_owned(),
            Entity::Gripper => "gripper".to_owned(),
            Entity::Payload => format!("payload, {:.2} kg", snapshot.payload_kg),
            Entity::Waypoint(i) => format!("waypoint {}", i + 1),
        }
    }
}
