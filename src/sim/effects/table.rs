//! The table of effects. Operators act in this order.

use nalgebra::{Rotation3, Vector3};

use super::effect::{Effect, Law, Operator, Parameter, Reach, Residual, Scene, Start};
use super::operators as op;
use crate::signal::{Side, Target};
use Residual::{R1, R2, R3, R4, R5};

const fn p(name: &'static str, unit: &'static str, nominal: f64, low: f64, high: f64) -> Parameter {
    Parameter::new(name, unit, nominal, [low, high])
}

/// Starts that are the same in every session.
pub(super) fn at<const N: usize, const P: usize>(
    all: [[f64; P]; N],
    moves: &[usize],
) -> Vec<Start> {
    all.iter().map(|at| Start::new(at, moves)).collect()
}

/// Every effect there is, in the order in which they act.
pub const EFFECTS: &[Effect] = &[
    Effect {
        id: "pressure-delay",
        name: "Pressure delay",
        doc: "p(t) = u(t − T): command and pressure differ by a dead time of link, valve and line.",
        source: "definition",
        side: Side::Actuation,
        target: Target::Chamber,
        parameters: &[p("delay", "s", 0.0, 0.0, 2.0)
            .of_departure(0.1)
            .absolute(1e-2)],
        residuals: &[R1],
        operator: Operator::Pressure(op::pressure_delay),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Idealisation,
        gradual: true,
        memory: Some(0),
        starts: |_, _| at([[0.05], [0.4]], &[0]),
    },
    Effect {
        id: "flow-limit",
        name: "Flow limit",
        doc: "−r₋ ≤ dp/dt ≤ r₊: the pump cannot fill or empty the chamber faster.",
        source: "definition; a displacement pump gives a constant flow",
        side: Side::Actuation,
        target: Target::Chamber,
        parameters: &[
            p("inflate", "Pa/s", 1e6, 50.0, 1e6)
                .of_departure(0.1)
                .scale(900.0),
            p("deflate", "Pa/s", 1e6, 50.0, 1e6)
                .of_departure(0.1)
                .scale(900.0),
        ],
        residuals: &[R1],
        operator: Operator::Pressure(op::flow_limit),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Idealisation,
        gradual: false,
        memory: None,
        starts: flow_limits,
    },
    Effect {
        id: "leak",
        name: "Leak",
        doc: "dw/dt = λ p − w/τ, p = u − w, τ = 0.1 s: air escapes in proportion to the gauge \
              pressure while the regulator refills, by λ p more slowly where the pump is at its limit.",
        source: "linearised orifice at small pressure ratio (ISO 6358)",
        side: Side::Actuation,
        target: Target::Chamber,
        parameters: &[p("rate", "1/s", 0.0, 0.0, 10.0).of_departure(0.1)],
        residuals: &[R1],
        operator: Operator::Pressure(op::leak),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Single,
        law: Law::Idealisation,
        gradual: true,
        memory: None,
        starts: |_, _| at([[0.5]], &[0]),
    },
    Effect {
        id: "supply-coupling",
        name: "Supply coupling",
        doc: "p_i = u_i − k Σ_{j≠i} (u_j − ū_j), τ dū/dt = u − ū: chambers that fill draw the \
              common supply down for the others.",
        source: "linear reservoir",
        side: Side::Actuation,
        target: Target::Chamber,
        parameters: &[
            p("share", "", 0.0, -0.5, 0.5).of_departure(0.2),
            p("time", "s", 0.3, 0.02, 5.0).of_value(0.25),
        ],
        residuals: &[R1],
        operator: Operator::Pressure(op::supply_coupling),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Idealisation,
        gradual: true,
        memory: Some(1),
        starts: |_, _| at([[0.05, 0.1], [0.05, 0.8]], &[0]),
    },
    Effect {
        id: "pressure-lag",
        name: "Pressure lag",
        doc: "τ (dp/dt + g p_ambient (dl/dt)/l) = p_gauge − p: the chamber follows its gauge through the line; its gas gives way \
              with the bellows' length, by a share g.",
        source: "first-order pneumatic line, isothermal gas",
        side: Side::Actuation,
        target: Target::Chamber,
        parameters: &[
            p("time", "s", 0.0, 0.0, 5.0).of_departure(0.1),
            p("gas", "", 0.0, 0.0, 3.0).scale(0.5).optional(),
        ],
        residuals: &[R2],
        operator: Operator::Pressure(op::pressure_lag),
        behind_gauge: Some(op::behind_lag),
        also_read: None,
        also_moves: Some(op::gas_spring),
        reach: Reach::Either,
        law: Law::Idealisation,
        gradual: true,
        memory: Some(0),
        starts: |_, _| at([[0.1, 1.0], [0.8, 1.0]], &[0]),
    },
    Effect {
        id: "gauge-error",
        name: "Gauge error",
        doc: "p_gauge = g p + o: the gauge reads wrong.",
        source: "definition",
        side: Side::Actuation,
        target: Target::Chamber,
        parameters: &[
            p("gain", "", 1.0, 0.5, 1.5),
            p("offset", "Pa", 0.0, -10e3, 10e3),
        ],
        residuals: &[R1, R2],
        operator: Operator::Pressure(op::gauge_error),
        behind_gauge: Some(op::behind_gauge),
        also_read: None,
        also_moves: None,
        reach: Reach::Single,
        law: Law::Idealisation,
        gradual: true,
        memory: None,
        starts: |_, _| at([[1.03, 300.0]], &[0, 1]),
    },
    Effect {
        id: "hysteresis",
        name: "Hysteresis",
        doc: "dF/dx = (F_max − F sgn ẋ)/w: dry friction in the bellows' folds, built up over a \
              travel w after every reversal; up and down differ.",
        source: "Dahl's solid friction model; P. R. Dahl, Solid friction damping of mechanical \
                 vibrations, AIAA Journal 1976",
        side: Side::Mechanics,
        target: Target::Chamber,
        parameters: &[
            p("force", "N", 0.0, 0.0, 30.0).of_departure(0.1),
            p("travel", "m", 0.005, 0.002, 0.05).of_value(0.25),
        ],
        residuals: &[R2],
        operator: Operator::Mechanics(op::hysteresis),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Idealisation,
        gradual: true,
        memory: None,
        starts: |_, _| at([[4.0, 0.003], [4.0, 0.01], [4.0, 0.03]], &[0]),
    },
    Effect {
        id: "creep",
        name: "Creep",
        doc: "F = k x + B, dB/dt = c k dx/dt − B/τ: standard linear solid; a step of pressure \
              moves the arm at first by about 1/(1 + c) of its way.",
        source: "W. N. Findley, J. S. Lai, K. Onaran, Creep and Relaxation of Nonlinear \
                 Viscoelastic Materials, North-Holland 1976, ch. 5 (linear viscoelasticity)",
        side: Side::Mechanics,
        target: Target::Chamber,
        parameters: &[
            p("share", "", 0.0, 0.0, 1.0).of_departure(0.1),
            // What relaxes faster is damping.
            p("time", "s", 10.0, 0.8, 300.0).of_value(0.25),
        ],
        residuals: &[R2],
        operator: Operator::Mechanics(op::creep),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Idealisation,
        gradual: true,
        memory: Some(1),
        starts: |_, _| at([[0.1, 1.0], [0.1, 3.0], [0.1, 12.0], [0.1, 60.0]], &[0]),
    },
    Effect {
        id: "stiffening",
        name: "Stiffening",
        doc: "F = k l₀ (λ − λ₀) + β k l₀ (λ − λ₀)³: bellows harden towards the ends of their travel.",
        source: "cubic Duffing term",
        side: Side::Mechanics,
        target: Target::Chamber,
        parameters: &[p("cubic", "", 0.0, 0.0, 5.0).of_departure(0.1)],
        residuals: &[R2],
        operator: Operator::Mechanics(op::stiffening),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Idealisation,
        gradual: true,
        memory: None,
        starts: |_, _| at([[0.3]], &[0]),
    },
    Effect {
        id: "damping",
        name: "Damping",
        doc: "f = −τ (K_bellows + c K_core) dξ/dt: resistance of bellows and core to motion, with c the core's share.",
        source: "Kelvin-Voigt solid",
        side: Side::Mechanics,
        target: Target::None,
        parameters: &[
            p("time", "s", 0.0, 0.0, 3.0).of_departure(0.2),
            p("core", "", 1.0, 0.0, 2.0).scale(0.5).optional(),
        ],
        residuals: &[R2],
        operator: Operator::Mechanics(op::damping),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Common,
        law: Law::Idealisation,
        gradual: true,
        memory: Some(0),
        starts: |_, _| at([[0.15, 1.0], [0.8, 1.0]], &[0]),
    },
    Effect {
        id: "chamber-stiffness",
        name: "Chamber stiffness",
        doc: "k → f k: one bellows is stiffer or softer than the others.",
        source: "definition",
        side: Side::Mechanics,
        target: Target::Chamber,
        parameters: &[p("factor", "", 1.0, 0.4, 2.5).of_departure(0.1)],
        residuals: &[R2],
        operator: Operator::Mechanics(op::chamber_stiffness),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Single,
        law: Law::Idealisation,
        gradual: true,
        memory: None,
        starts: |_, _| at([[1.05]], &[0]),
    },
    Effect {
        id: "payload",
        name: "Undeclared payload",
        doc: "m = m_declared + Δm: the gripper carries more or less than was declared.",
        source: "definition",
        side: Side::Mechanics,
        target: Target::None,
        parameters: &[p("mass", "kg", 0.0, -1.0, 2.0).of_departure(0.1)],
        residuals: &[R2],
        operator: Operator::Mechanics(op::payload),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Common,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[0.1]], &[0]),
    },
    Effect {
        id: "com-offset",
        name: "Centre of mass",
        doc: "c = c_nominal + Δc: gripper and payload hang beside their nominal centre, in the \
              end pad's axes.",
        source: "definition",
        side: Side::Mechanics,
        target: Target::None,
        parameters: &[
            p("x", "m", 0.0, -0.15, 0.15).of_departure(0.1),
            p("y", "m", 0.0, -0.15, 0.15).of_departure(0.1),
            p("z", "m", 0.0, -0.15, 0.15).of_departure(0.1),
        ],
        residuals: &[R2],
        operator: Operator::Mechanics(op::com_offset),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Common,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[0.02, 0.02, 0.02]], &[0, 1, 2]),
    },
    Effect {
        id: "base-tilt",
        name: "Base tilt",
        doc: "g → R(x, y) g: the base does not hang level. IMUs measure against gravity and read the pads turned back by so much \
              (imus = 1), unless they were zeroed on the tilted base (imus = 0).",
        source: "definition",
        side: Side::Mechanics,
        target: Target::None,
        parameters: &[
            p("x", "rad", 0.0, -0.35, 0.35).of_departure(0.1),
            p("y", "rad", 0.0, -0.35, 0.35).of_departure(0.1),
            p("imus", "", 0.0, -0.5, 1.5).scale(1.0).optional(),
        ],
        residuals: &[R2, R4, R5],
        operator: Operator::Mechanics(op::base_tilt),
        behind_gauge: None,
        also_read: Some(op::tilted_imus),
        also_moves: None,
        reach: Reach::Common,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[0.03, 0.03, 1.0], [0.03, 0.03, 0.0]], &[0, 1]),
    },
    Effect {
        id: "tip-force",
        name: "Tip force",
        doc: "A constant force on the end pad's origin in the base frame: a cable, a hose.",
        source: "definition",
        side: Side::Mechanics,
        target: Target::None,
        parameters: &[
            p("x", "N", 0.0, -20.0, 20.0).of_departure(0.1),
            p("y", "N", 0.0, -20.0, 20.0).of_departure(0.1),
            p("z", "N", 0.0, -20.0, 20.0).of_departure(0.1),
        ],
        residuals: &[R2],
        operator: Operator::Mechanics(op::tip_force),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Common,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[0.5, 0.5, 0.5]], &[0, 1, 2]),
    },
    Effect {
        id: "contact",
        name: "Contact",
        doc: "N = k max(0, h − n·p): the end pad's origin rests on an elastic half-space (a floor, a wall, a slope) and drags \
              over it with at most μ N; n is the vertical turned by the rotation vector (x, y, 0). One that presses the arm \
              until it folds has no equilibrium.",
        source: "penalty contact with regularised Coulomb friction; K. L. Johnson, Contact Mechanics, \
                 Cambridge University Press 1985",
        side: Side::Mechanics,
        target: Target::None,
        parameters: &[
            p("height", "m", -0.7, -0.7, 0.2)
                .scale(0.4)
                .of_departure(0.0)
                .absolute(3e-3),
            p("rate", "N/m", 1000.0, 50.0, 5000.0)
                .scale(90.0)
                .of_value(0.25),
            p("friction", "", 0.0, 0.0, 1.0)
                .scale(0.06)
                .of_departure(0.1),
            p("x", "rad", 0.0, -1.75, 1.75)
                .scale(0.2)
                .absolute(0.03)
                .optional(),
            p("y", "rad", 0.0, -1.75, 1.75)
                .scale(0.2)
                .absolute(0.03)
                .optional(),
        ],
        residuals: &[R2],
        operator: Operator::Mechanics(op::contact),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Common,
        law: Law::Idealisation,
        gradual: false,
        memory: None,
        starts: half_spaces,
    },
    Effect {
        id: "torsion",
        name: "Torsional stiffness",
        doc: "k_t → f k_t: a segment is stiffer or softer against twist.",
        source: "definition",
        side: Side::Mechanics,
        target: Target::Segment,
        parameters: &[p("factor", "", 1.0, 0.1, 10.0).of_departure(0.1)],
        residuals: &[R2],
        operator: Operator::Mechanics(op::torsion),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Idealisation,
        gradual: true,
        memory: None,
        starts: |_, _| at([[1.3]], &[0]),
    },
    Effect {
        id: "spring-lag",
        name: "Spring lag",
        doc: "τ dy/dt = l − y: the reading follows the length.",
        source: "first-order low-pass",
        side: Side::Sensing,
        target: Target::Spring,
        parameters: &[p("time", "s", 0.0, 0.0, 3.0).of_departure(0.1)],
        residuals: &[R3, R5],
        operator: Operator::Sensors(op::spring_lag),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Definition,
        gradual: true,
        memory: Some(0),
        starts: |_, _| at([[0.1], [0.6]], &[0]),
    },
    Effect {
        id: "spring-crosstalk",
        name: "Spring crosstalk",
        doc: "y_A = l_A + c (l_B − l₀): the coils of an X pair couple; l₀ is the length at 0 Pa.",
        source: "mutual inductance, to first order",
        side: Side::Sensing,
        target: Target::Spring,
        parameters: &[p("share", "", 0.0, -0.3, 0.3)],
        residuals: &[R3, R5],
        operator: Operator::Sensors(op::spring_crosstalk),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[0.03]], &[0]),
    },
    Effect {
        id: "spring-calibration",
        name: "Spring calibration",
        doc: "y = g l + o: gain and offset of a spring are off.",
        source: "definition",
        side: Side::Sensing,
        target: Target::Spring,
        parameters: &[
            p("gain", "", 1.0, 0.5, 1.5),
            p("offset", "m", 0.0, -0.05, 0.05),
        ],
        residuals: &[R3, R5],
        operator: Operator::Sensors(op::spring_calibration),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Single,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[1.03, 1e-3]], &[0, 1]),
    },
    Effect {
        id: "spring-drift",
        name: "Spring drift",
        doc: "y = l + r t: all springs drift together, as with the temperature of their oscillators.",
        source: "definition",
        side: Side::Sensing,
        target: Target::Spring,
        parameters: &[p("rate", "m/s", 0.0, -1e-3, 1e-3).of_departure(0.2)],
        residuals: &[R3, R5],
        operator: Operator::Sensors(op::spring_drift),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Common,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[2e-5]], &[0]),
    },
    Effect {
        id: "spring-stuck",
        name: "Stuck spring",
        doc: "y(t) = y(t₁) for t ≥ t₁: the reading no longer moves.",
        source: "definition",
        side: Side::Sensing,
        target: Target::Spring,
        parameters: &[p("from", "s", 1e5, 0.0, 1e5).scale(10.0).of_departure(0.0)],
        residuals: &[R3, R5],
        operator: Operator::Sensors(op::spring_stuck),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Single,
        law: Law::Definition,
        gradual: false,
        memory: None,
        starts: moments,
    },
    Effect {
        id: "imu-drift",
        name: "IMU drift",
        doc: "R_read = Rz(r t) R: the heading of an IMU without magnetometer turns away.",
        source: "constant gyroscope bias about the vertical",
        side: Side::Sensing,
        target: Target::Imu,
        parameters: &[p("rate", "rad/s", 0.0, -0.02, 0.02).of_departure(0.2)],
        residuals: &[R4, R5],
        operator: Operator::Sensors(op::imu_drift),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Single,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[1e-3]], &[0]),
    },
    Effect {
        id: "imu-misalignment",
        name: "IMU misalignment",
        doc: "R_read = R exp(δ): the IMU sits turned on its pad, δ in the pad's axes.",
        source: "definition",
        side: Side::Sensing,
        target: Target::Imu,
        parameters: &[
            p("x", "rad", 0.0, -0.35, 0.35),
            p("y", "rad", 0.0, -0.35, 0.35),
            p("z", "rad", 0.0, -0.35, 0.35),
        ],
        residuals: &[R4, R5],
        operator: Operator::Sensors(op::imu_misalignment),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Single,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[0.02, 0.02, 0.02]], &[0, 1, 2]),
    },
    Effect {
        id: "clock-skew",
        name: "Clock skew",
        doc: "T_read(t) = T(t − s t): the clock of the motion capture runs fast by s.",
        source: "definition",
        side: Side::FrameAndTime,
        target: Target::None,
        parameters: &[p("skew", "", 0.0, -0.02, 0.02)
            .of_departure(0.1)
            .shown(1e3, "‰")],
        residuals: &[R2, R3, R4],
        operator: Operator::Capture(op::clock_skew),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Common,
        law: Law::Idealisation,
        gradual: true,
        memory: None,
        starts: |_, _| at([[2e-3]], &[0]),
    },
    Effect {
        id: "clock-offset",
        name: "Clock offset",
        doc: "T_read(t) = T(t − o): the motion capture is stamped late by o.",
        source: "definition",
        side: Side::FrameAndTime,
        target: Target::None,
        parameters: &[p("offset", "s", 0.0, -2.0, 2.0)],
        residuals: &[R2, R3, R4],
        operator: Operator::Capture(op::clock_offset),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Common,
        law: Law::Idealisation,
        gradual: true,
        memory: None,
        starts: |_, _| at([[0.05], [0.4]], &[0]),
    },
    Effect {
        id: "mocap-frame",
        name: "Motion-capture frame",
        doc: "T_read = (exp(ρ), d) T: the frame of the motion capture is not the base frame; ρ is \
              a rotation vector.",
        source: "definition",
        side: Side::FrameAndTime,
        target: Target::None,
        parameters: &[
            p("x", "m", 0.0, -0.1, 0.1),
            p("y", "m", 0.0, -0.1, 0.1),
            p("z", "m", 0.0, -0.1, 0.1),
            p("rx", "rad", 0.0, -0.35, 0.35),
            p("ry", "rad", 0.0, -0.35, 0.35),
            p("rz", "rad", 0.0, -0.35, 0.35),
        ],
        residuals: &[R2, R3, R4],
        operator: Operator::Capture(op::mocap_frame),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Common,
        law: Law::Definition,
        gradual: true,
        memory: None,
        starts: |_, _| at([[3e-3, 3e-3, 3e-3, 0.01, 0.01, 0.01]], &[0, 1, 2, 3, 4, 5]),
    },
];

/// Shares of the fastest change that was measured.
pub(super) fn flow_limits(scene: &Scene, target: Option<usize>) -> Vec<Start> {
    let fastest_pa_s = match target {
        Some(i) => scene.fastest_pa_s[i],
        None => scene.fastest_pa_s.iter().copied().fold(0.0, f64::max),
    };
    let limits = [0.35, 0.6, 1.0].map(|share| (share * fastest_pa_s.max(1e3)).clamp(600.0, 9e5));
    at(limits.map(|r| [r, r]), &[0])
}

/// Floors and walls that cut off a part of where the end pad went.
pub(super) fn half_spaces(scene: &Scene, _: Option<usize>) -> Vec<Start> {
    const FLOORS: &[f64] = &[0.05, 0.2, 0.4, 0.7];
    const WALLS: &[f64] = &[0.05, 0.3];
    const HEADINGS: u32 = 8;
    let mut out = Vec::new();
    let mut cut = |turn: [f64; 2], shares: &[f64]| {
        let turned = Vector3::new(turn[0], turn[1], 0.0);
        let normal = Rotation3::new(turned) * Vector3::z();
        let mut along_m: Vec<f64> = scene
            .tip_m
            .iter()
            .map(|p| normal.dot(&Vector3::from(*p)))
            .collect();
        along_m.sort_by(f64::total_cmp);
        let heights_m = shares
            .iter()
            .filter_map(|q| along_m.get((q * along_m.len() as f64) as usize));
        out.extend(heights_m.map(|h| Start::new(&[*h, 300.0, 0.2, turn[0], turn[1]], &[0])));
    };
    cut([0.0; 2], FLOORS);
    for k in 0..HEADINGS {
        let heading = std::f64::consts::TAU * f64::from(k) / f64::from(HEADINGS);
        cut(
            [heading.cos(), heading.sin()].map(|x| x * std::f64::consts::FRAC_PI_2),
            WALLS,
        );
    }
    out
}

/// When the reading came to rest, a little before and after, and moments throughout the session.
fn moments(scene: &Scene, target: Option<usize>) -> Vec<Start> {
    let rest_s = target.and_then(|i| scene.still_since_s[i]);
    let near = rest_s
        .into_iter()
        .flat_map(|t| [-0.4, 0.0, 0.2, 0.5, 1.0].map(|by| t + by));
    let throughout = (0..10).map(|k| scene.seconds * f64::from(k) / 10.0);
    near.chain(throughout)
        .map(|from_s| Start::new(&[from_s.max(0.0)], &[0]))
        .collect()
}
