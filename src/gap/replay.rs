//! A session through the model: what differs from arm to arm, and what is left over.

use nalgebra::{UnitQuaternion, Vector3};

use super::session::{CHANNELS, Grid, IMU_0, SPRING_0};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, Pose, SPRINGS, pose_error};
use crate::sim::effects::{self, Active, EffectError, Simulated};
use crate::sim::{Model, Parameters, Resolution};

/// One number that differs from arm to arm and from mounting to mounting: a nuisance parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Knob {
    /// Axial stiffness of a bellows, as a factor less one.
    Stiffness(usize),
    /// Effective area of a chamber, as a factor less one.
    Area(usize),
    /// Rest length of a bellows, as a factor less one.
    RestLength(usize),
    /// Cubic hardening of all bellows.
    Hardening,
    /// Bending stiffness of a segment, as a factor less one.
    Bending(usize),
    /// Torsional stiffness of a segment, as a factor less one.
    Torsion(usize),
    /// Mass of the gripper, as a factor less one.
    Gripper,
    /// Tilt of the base about x, y, rad.
    Tilt(usize),
    /// Time constant of the arm's own damping, s.
    Damping,
    /// Offset of a spring, m.
    SpringOffset(usize),
    /// Gain of a spring about its rest length, less one.
    SpringGain(usize),
    /// Turn of an IMU on its pad (IMU, axis), rad.
    Mounting(usize, usize),
    /// Motion-capture frame: x, y, z (m), rotation vector (rad).
    Frame(usize),
    /// Clock of the motion capture, s.
    Clock,
    /// The tracked body on the end pad against the pad itself: x, y, z (m), rotation vector (rad).
    Body(usize),
    /// Height at which a segment's springs are fixed to both of its pads, m.
    SpringEnds(usize),
}

impl Knob {
    /// Whether it changes the motion of the arm, not only what is read.
    pub fn is_mechanical(self) -> bool {
        !matches!(
            self,
            Self::SpringOffset(_)
                | Self::SpringGain(_)
                | Self::Mounting(..)
                | Self::Frame(_)
                | Self::Clock
                | Self::Body(_)
        )
    }

    /// Value of the nominal arm.
    pub fn nominal(self) -> f64 {
        match self {
            Self::Damping => 0.05,
            _ => 0.0,
        }
    }

    /// How far a well-made arm departs from the nominal one (standard deviation).
    pub fn prior(self) -> f64 {
        match self {
            Self::Stiffness(_) | Self::Area(_) => 0.03,
            Self::RestLength(_) => 0.01,
            Self::Hardening => 0.2,
            Self::Bending(_) => 0.2,
            Self::Torsion(_) => 0.3,
            Self::Gripper => 0.05,
            Self::Tilt(_) => 0.01,
            Self::Damping => 0.05,
            Self::SpringOffset(_) => 2e-3,
            Self::SpringGain(_) => 0.02,
            Self::Mounting(..) => 0.02,
            Self::Frame(k) | Self::Body(k) if k < 3 => 10e-3,
            Self::Frame(_) | Self::Body(_) => 0.01,
            Self::SpringEnds(_) => 10e-3,
            Self::Clock => 0.03,
        }
    }
}

/// All knobs, in the order of the vectors that hold their values.
pub fn knobs() -> Vec<Knob> {
    let mut out = Vec::new();
    out.extend((0..CHAMBERS).map(Knob::Stiffness));
    out.extend((0..CHAMBERS).map(Knob::Area));
    out.extend((0..CHAMBERS).map(Knob::RestLength));
    out.push(Knob::Hardening);
    out.extend((0..2).map(Knob::Bending));
    out.extend((0..2).map(Knob::Torsion));
    out.push(Knob::Gripper);
    out.extend((0..2).map(Knob::Tilt));
    out.push(Knob::Damping);
    out.extend((0..SPRINGS).map(Knob::SpringOffset));
    out.extend((0..SPRINGS).map(Knob::SpringGain));
    for i in 0..IMUS {
        out.extend((0..3).map(|a| Knob::Mounting(i, a)));
    }
    out.extend((0..6).map(Knob::Frame));
    out.push(Knob::Clock);
    out.extend((0..6).map(Knob::Body));
    out.extend((0..2).map(Knob::SpringEnds));
    out
}

/// Nominal values of all knobs.
pub fn nominal() -> Vec<f64> {
    knobs().into_iter().map(Knob::nominal).collect()
}

/// The model's parameters at these knobs.
pub fn parameters(values: &[f64]) -> Parameters {
    let mut p = Parameters::default();
    for (knob, &v) in knobs().iter().zip(values) {
        match *knob {
            Knob::Stiffness(i) => p.chamber_stiffness[i] += v,
            Knob::Area(i) => p.chamber_area[i] += v,
            Knob::RestLength(i) => p.rest_length[i] += v,
            Knob::Hardening => p.hardening += v,
            Knob::Bending(s) => p.bending[s] += v,
            Knob::Torsion(s) => p.torsion[s] += v,
            Knob::Gripper => p.gripper_mass += v,
            Knob::Tilt(a) => p.base_tilt_rad[a] += v,
            _ => {}
        }
    }
    p
}

/// The model at these knobs.
pub fn model(robot: &RobotSpec, values: &[f64]) -> Model {
    let mut robot = robot.clone();
    for (knob, &v) in knobs().iter().zip(values) {
        if let Knob::SpringEnds(s) = *knob {
            let (top_m, bottom_m) = (&mut robot.spring_top_m, &mut robot.spring_bottom_m);
            for i in 6 * s..6 * s + 6 {
                top_m[i].z += v;
                bottom_m[i].z += v;
            }
        }
    }
    Model::new(&robot, &parameters(values), Resolution::default())
}

/// The tracked body in the end pad's frame.
pub(super) fn pad_from_body(values: &[f64]) -> Pose {
    let mut b = [0.0; 6];
    for (knob, &v) in knobs().iter().zip(values) {
        if let Knob::Body(k) = *knob {
            b[k] = v;
        }
    }
    Pose::from_parts(
        Vector3::new(b[0], b[1], b[2]).into(),
        UnitQuaternion::from_scaled_axis(Vector3::new(b[3], b[4], b[5])),
    )
}

fn act(id: &str, target: Option<usize>, values: Vec<f64>) -> Option<Active> {
    // Knobs are corrections of healthy things: the bounds of faults do not bind them.
    effects::effect(id).map(|effect| Active {
        effect,
        target,
        values,
    })
}

/// What knobs change in the readings, as effects.
pub fn readings(robot: &RobotSpec, values: &[f64]) -> Vec<Active> {
    let mut offset_m = [0.0; SPRINGS];
    let mut gain = [0.0; SPRINGS];
    let mut mounting = [[0.0; 3]; IMUS];
    let mut frame = vec![0.0; 6];
    let mut clock_s = 0.0;
    for (knob, &v) in knobs().iter().zip(values) {
        match *knob {
            Knob::SpringOffset(i) => offset_m[i] = v,
            Knob::SpringGain(i) => gain[i] = v,
            Knob::Mounting(i, a) => mounting[i][a] = v,
            Knob::Frame(k) => frame[k] = v,
            Knob::Clock => clock_s = v,
            _ => {}
        }
    }
    let springs = (0..SPRINGS).map(|i| {
        // y = l + o + γ (l − l₀)
        let shift_m = offset_m[i] - gain[i] * robot.rest_length_m;
        ("spring-calibration", Some(i), vec![1.0 + gain[i], shift_m])
    });
    let imus = (0..IMUS).map(|i| ("imu-misalignment", Some(i), mounting[i].to_vec()));
    springs
        .chain(imus)
        .chain([
            ("clock-offset", None, vec![clock_s]),
            ("mocap-frame", None, frame.clone()),
        ])
        .filter_map(|(id, target, values)| act(id, target, values))
        .collect()
}

/// One row of residuals, measured − predicted; NaN where nothing was measured.
pub type Row = [f64; CHANNELS];

/// Moves the arm of these knobs, with `effects`, through the grid's measured pressures.
///
/// # Errors
/// [`EffectError::Sim`] when the arm finds no equilibrium.
pub fn move_arm(
    robot: &RobotSpec,
    grid: &Grid,
    values: &[f64],
    effects: &[Active],
) -> Result<Simulated, EffectError> {
    let model = model(robot, values);
    let fine = &grid.session.t_s;
    let chamber_pa = if effects.iter().any(is_pressure) {
        grid.binned(&effects::behind_gauges(
            robot,
            fine,
            &grid.gauge_pa,
            effects,
        ))
    } else {
        grid.binned(&grid.gauge_pa)
    };
    let mut acting: Vec<Active> = effects
        .iter()
        .filter(|a| is_mechanical(a))
        .cloned()
        .collect();
    let damping_s = knobs()
        .iter()
        .zip(values)
        .find_map(|(k, v)| (*k == Knob::Damping).then_some(*v));
    acting.extend(act(
        "damping",
        None,
        vec![damping_s.unwrap_or(0.0).max(0.0)],
    ));
    effects::arm_only(
        &model,
        &grid.t_s,
        &chamber_pa,
        grid.session.payload_kg,
        &acting,
    )
}

fn is_pressure(a: &Active) -> bool {
    matches!(a.effect.operator, effects::Operator::Pressure(_))
}

/// Whether an effect acts on the arm itself.
pub fn is_mechanical(a: &Active) -> bool {
    matches!(a.effect.operator, effects::Operator::Mechanics(_))
}

/// The grid as it would have been measured on an arm with these knobs and effects, without noise.
///
/// # Errors
/// As [`move_arm`].
pub fn pretend(
    robot: &RobotSpec,
    grid: &Grid,
    values: &[f64],
    effects: &[Active],
) -> Result<Grid, EffectError> {
    let moved = move_arm(robot, grid, values, effects)?;
    let read = read_off(robot, grid, &moved, values, effects);
    let pad_from_body = pad_from_body(values);
    Ok(Grid {
        captured: read
            .captured
            .iter()
            .map(|pads| Some(pads[1] * pad_from_body))
            .collect(),
        sensors: read.sensors,
        ..grid.clone()
    })
}

/// What sensors and motion capture would tell of a motion.
fn read_off(
    robot: &RobotSpec,
    grid: &Grid,
    moved: &Simulated,
    values: &[f64],
    effects: &[Active],
) -> Simulated {
    let mut read = moved.clone();
    let mut acting = readings(robot, values);
    acting.extend(effects.iter().cloned());
    effects::read(robot, &grid.t_s, &mut read, &acting);
    read
}

/// Measured less predicted, for a motion and what knobs and `effects` do to the readings.
pub fn left_over(
    robot: &RobotSpec,
    grid: &Grid,
    moved: &Simulated,
    values: &[f64],
    effects: &[Active],
) -> Vec<Row> {
    let read = read_off(robot, grid, moved, values, effects);
    let pad_from_body = pad_from_body(values);
    (0..grid.len())
        .map(|k| {
            let mut row = [f64::NAN; CHANNELS];
            if let Some(truth) = &grid.captured[k] {
                let e = pose_error(truth, &(read.captured[k][1] * pad_from_body));
                row[..6].copy_from_slice(e.as_slice());
            }
            let (seen, told) = (&grid.sensors[k], &read.sensors[k]);
            for i in 0..SPRINGS {
                row[SPRING_0 + i] = seen.spring_m[i] - told.spring_m[i];
            }
            for i in 0..IMUS {
                let turn = told.base_from_imu_pad(i).inverse() * seen.base_from_imu_pad(i);
                let w = UnitQuaternion::from(turn).scaled_axis();
                row[IMU_0 + 3 * i..IMU_0 + 3 * i + 3].copy_from_slice(w.as_slice());
            }
            row
        })
        .collect()
}
