//! Library of the terms of a law: what a generalized force or a reading may depend on.
//!
//! A law is the sum of at most three of these. Each acts through the same operators as an effect of the table, so that it can be
//! fitted, proved and put into a patch in the same way. It states at which site it acts, on which inputs it depends and in which form.

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::effect::{
    BehindGauge, Call, Effect, Law, Line, Operator, Parameter, Plant, Posture, Reach, Reaction,
    Residual, Scene, Start,
};
use super::operators::{self as op, each_bellows};
use super::table::{at, flow_limits, half_spaces};
use crate::signal::{CHAMBERS, IMUS, SPRINGS, SensorVec, Side, Target, ypr_from_rotation};
use crate::sim::model::GRAVITY_M_S2;
use crate::sim::model::Pull;
use crate::sim::rod::{Branch, Drag, Floor, Hinge, Viscosity};
use Residual::{R1, R2, R3, R4, R5};

/// What a term changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Site {
    /// Tension of a bellows.
    ChamberTension,
    /// Stiffness of a segment's walls.
    SegmentStiffness,
    /// Force on the end pad.
    EndForce,
    /// Moment on the end pad.
    EndMoment,
    /// Direction of gravity at the base.
    Gravity,
    /// Reading of a spring.
    SpringReading,
    /// Reading of an IMU.
    ImuReading,
    /// Pressure between gauge and chamber.
    ChamberPressure,
    /// Pressure between command and gauge.
    SupplyPressure,
    /// Poses by motion capture.
    Capture,
}

/// What a term depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// Nothing: a constant.
    None,
    /// The chamber's own pressure.
    Pressure,
    /// How fast it changes.
    PressureRate,
    /// Pressure of the other chambers of the segment.
    NeighbourPressure,
    /// Pressure of the other segment, or of all other chambers.
    OtherPressure,
    /// Pressure before.
    PressureHistory,
    /// Length of the bellows or spring.
    Length,
    /// How fast it changes.
    LengthRate,
    /// Length before.
    LengthHistory,
    /// Way since the motion last turned.
    Reversal,
    /// Length of the other spring of a pair.
    PartnerLength,
    /// Bending of the segment.
    Bending,
    /// Twist of the segment.
    Twist,
    /// Place of the end pad.
    Position,
    /// Turn of the end pad against gravity.
    Orientation,
    /// How fast the pads move.
    PadRate,
    /// Time since the start.
    Time,
}

/// How it depends on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// A constant.
    Constant,
    /// In proportion.
    Linear,
    /// Second power.
    Squared,
    /// Third power.
    Cubed,
    /// Product of two inputs.
    Product,
    /// In proportion below a threshold.
    Below,
    /// In proportion beyond a threshold.
    Beyond,
    /// What a first-order memory has not yet followed.
    Memory,
    /// By the sign of the change.
    Sign,
    /// Holds from a time on.
    Held,
    /// By so much later.
    Delay,
    /// No faster than a limit.
    Limit,
}

/// A term of a law.
#[derive(Clone, Copy, Debug)]
pub struct Term {
    /// How it acts, with its coefficients.
    pub effect: Effect,
    /// What it changes.
    pub site: Site,
    /// What it depends on.
    pub inputs: &'static [Input],
    /// How.
    pub form: Form,
    /// Whether it depends on nothing but the present pressures and posture, and acts in every model of the arm.
    pub instant: bool,
}

/// The term with this id; `None` if there is none.
pub fn term(id: &str) -> Option<&'static Term> {
    TERMS.iter().find(|t| t.effect.id == id)
}

const fn n(name: &'static str, unit: &'static str, low: f64, high: f64) -> Parameter {
    Parameter::new(name, unit, 0.0, [low, high]).of_departure(0.1)
}

/// A number that shapes the term.
const fn shape(
    name: &'static str,
    unit: &'static str,
    usual: f64,
    [low, high]: [f64; 2],
) -> Parameter {
    Parameter::new(name, unit, usual, [low, high]).of_value(0.25)
}

/// A translation and a rotation vector.
const MOVED: &[Parameter] = &[
    n("x", "m", -0.1, 0.1),
    n("y", "m", -0.1, 0.1),
    n("z", "m", -0.1, 0.1),
    n("rx", "rad", -0.3, 0.3),
    n("ry", "rad", -0.3, 0.3),
    n("rz", "rad", -0.3, 0.3),
];

/// A length at which a hinge begins.
const LENGTH: Parameter = Parameter::new("length", "m", 0.145, [0.07, 0.22])
    .scale(5e-3)
    .absolute(2e-3);

const BARE: Term = Term {
    effect: Effect {
        id: "",
        name: "",
        doc: "",
        source: "library of terms",
        side: Side::Mechanics,
        target: Target::Chamber,
        parameters: &[],
        residuals: &[R2],
        operator: Operator::Mechanics(|_, _| {}),
        behind_gauge: None,
        also_read: None,
        also_moves: None,
        reach: Reach::Either,
        law: Law::Idealisation,
        gradual: true,
        memory: None,
        starts: |_, _| Vec::new(),
    },
    site: Site::ChamberTension,
    inputs: &[],
    form: Form::Linear,
    instant: false,
};

type Starts = fn(&Scene, Option<usize>) -> Vec<Start>;
type Act = fn(&Call, &mut Plant);

impl Term {
    const fn named(mut self, id: &'static str, name: &'static str, doc: &'static str) -> Self {
        self.effect.id = id;
        self.effect.name = name;
        self.effect.doc = doc;
        self
    }

    const fn numbers(mut self, parameters: &'static [Parameter], starts: Starts) -> Self {
        self.effect.parameters = parameters;
        self.effect.starts = starts;
        self
    }

    const fn of(mut self, inputs: &'static [Input], form: Form) -> Self {
        self.inputs = inputs;
        self.form = form;
        self
    }

    const fn acts(mut self, f: Act) -> Self {
        self.effect.operator = Operator::Mechanics(f);
        self
    }

    const fn also(
        mut self,
        f: fn(&Call, &mut [SensorVec]),
        residuals: &'static [Residual],
    ) -> Self {
        self.effect.also_read = Some(f);
        self.effect.residuals = residuals;
        self
    }

    const fn instant(mut self) -> Self {
        self.instant = true;
        self
    }

    const fn remembers(mut self, parameter: usize) -> Self {
        self.effect.memory = Some(parameter);
        self
    }

    const fn abrupt(mut self) -> Self {
        self.effect.gradual = false;
        self
    }

    const fn on(mut self, site: Site, target: Target, reach: Reach) -> Self {
        self.site = site;
        self.effect.target = target;
        self.effect.reach = reach;
        self
    }
}

/// A tension of bellows.
const fn tension(id: &'static str, name: &'static str, doc: &'static str) -> Term {
    BARE.named(id, name, doc)
}

/// Something on the end pad.
const fn end(site: Site, id: &'static str, name: &'static str, doc: &'static str) -> Term {
    BARE.named(id, name, doc)
        .on(site, Target::None, Reach::Common)
}

/// An error of springs.
const fn spring(id: &'static str, name: &'static str, doc: &'static str) -> Term {
    let mut out = BARE
        .named(id, name, doc)
        .on(Site::SpringReading, Target::Spring, Reach::Either);
    out.effect.side = Side::Sensing;
    out.effect.residuals = &[R3, R5];
    out
}

/// An error of IMUs.
const fn imu(id: &'static str, name: &'static str, doc: &'static str) -> Term {
    let mut out = BARE
        .named(id, name, doc)
        .on(Site::ImuReading, Target::Imu, Reach::Either);
    out.effect.side = Side::Sensing;
    out.effect.residuals = &[R4, R5];
    out
}

impl Term {
    const fn reads(mut self, f: fn(&Call, &mut [SensorVec])) -> Self {
        self.effect.operator = Operator::Sensors(f);
        self
    }
}

/// A pressure behind the gauge.
const fn behind(
    id: &'static str,
    name: &'static str,
    doc: &'static str,
    f: BehindGauge,
    forward: fn(&Call, &mut Line),
) -> Term {
    let mut out =
        BARE.named(id, name, doc)
            .on(Site::ChamberPressure, Target::Chamber, Reach::Either);
    out.effect.side = Side::Actuation;
    out.effect.operator = Operator::Pressure(forward);
    out.effect.behind_gauge = Some(f);
    out
}

/// What the supply delivers.
const fn supply(
    id: &'static str,
    name: &'static str,
    doc: &'static str,
    f: fn(&Call, &mut Line),
) -> Term {
    let mut out =
        BARE.named(id, name, doc)
            .on(Site::SupplyPressure, Target::Chamber, Reach::Either);
    out.effect.side = Side::Actuation;
    out.effect.residuals = &[R1];
    out.effect.operator = Operator::Pressure(f);
    out
}

/// An error of motion capture.
const fn capture(
    id: &'static str,
    name: &'static str,
    doc: &'static str,
    f: fn(&Call, &mut [[crate::signal::Pose; 2]]),
) -> Term {
    let mut out = BARE
        .named(id, name, doc)
        .on(Site::Capture, Target::None, Reach::Common);
    out.effect.side = Side::FrameAndTime;
    out.effect.residuals = &[R2, R3, R4];
    out.effect.operator = Operator::Capture(f);
    out
}

/// The two other chambers of the same segment.
fn neighbours(i: usize) -> [usize; 2] {
    let s = 3 * (i / 3);
    [s + (i + 1) % 3, s + (i + 2) % 3]
}

fn pull(c: &Call, plant: &mut Plant, of: fn(&[f64; CHAMBERS], usize) -> f64) {
    plant.model.pulls.push(Pull {
        on: c.target,
        coefficient: c.values[0],
        of,
    });
}

fn react(c: &Call, plant: &mut Plant, of: fn(&Posture, usize) -> f64) {
    plant.reactions.push(Reaction {
        on: c.target,
        coefficient: c.values[0],
        of,
    });
}

/// A tension over time from the pressures of each chamber over time.
fn series(c: &Call, plant: &mut Plant, of: impl Fn(&[f64]) -> Vec<f64>) {
    let mut out = vec![[0.0; CHAMBERS]; c.chamber_pa.len()];
    for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
        let p: Vec<f64> = c.chamber_pa.iter().map(|row| row[i]).collect();
        for (row, y) in out.iter_mut().zip(of(&p)) {
            row[i] = c.values[0] * y;
        }
    }
    plant.tensions_n.push(out);
}

/// What a first-order memory of the series has not yet followed.
fn unfollowed(t_s: &[f64], x: &[f64], tau_s: f64) -> Vec<f64> {
    let slow = op::lagged_ramps(t_s, x, tau_s);
    x.iter().zip(slow).map(|(x, s)| x - s).collect()
}

fn hinge(c: &Call, plant: &mut Plant, beyond: bool) {
    let l0 = c.robot.rest_length_m;
    each_bellows(c, plant, |_, b| {
        b.hinges.push(Hinge {
            from: c.values[1] / l0,
            beyond,
            stiffness_n: c.values[0] * l0,
        });
    });
}

/// Readings of the springs changed by a function of place in the session, spring and true lengths.
fn each_spring(
    c: &Call,
    sensors: &mut [SensorVec],
    f: impl Fn(usize, usize, &[f64; SPRINGS]) -> f64,
) {
    for (k, row) in sensors.iter_mut().enumerate() {
        let clean = row.spring_m;
        for i in (0..SPRINGS).filter(|i| c.hits(*i)) {
            row.spring_m[i] += c.values[0] * f(k, i, &clean);
        }
    }
}

/// How fast the pressures change together at an instant, Pa/s.
fn flow(c: &Call, k: usize) -> f64 {
    let k = k.max(1);
    let (Some(now), Some(before)) = (c.chamber_pa.get(k), c.chamber_pa.get(k - 1)) else {
        return 0.0;
    };
    let dt_s = c.t_s[k] - c.t_s[k - 1];
    (0..CHAMBERS)
        .map(|i| (now[i] - before[i]).abs() / dt_s)
        .sum()
}

/// IMU readings turned about x and y of the pad, more and more.
fn imu_turning(c: &Call, sensors: &mut [SensorVec]) {
    let rate = Vector3::new(c.values[0], c.values[1], 0.0);
    for (t, row) in c.t_s.iter().zip(sensors) {
        let off = UnitQuaternion::from_scaled_axis(rate * (t - c.t_s[0]));
        for i in (0..IMUS).filter(|i| c.hits(*i)) {
            let read = UnitQuaternion::from(row.base_from_imu_pad(i)) * off;
            row.imu_ypr_rad[i] = ypr_from_rotation(&read);
        }
    }
}

/// Changes the pressures of the chambers it acts on.
fn each_pressure(c: &Call, rows: &mut [[f64; CHAMBERS]], f: impl Fn(f64) -> f64) {
    for row in rows {
        for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
            row[i] = f(row[i]);
        }
    }
}

fn behind_others(c: &Call, chamber_pa: &mut [[f64; CHAMBERS]]) {
    let clean = chamber_pa.to_vec();
    for (row, clean) in chamber_pa.iter_mut().zip(clean) {
        for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
            let others: f64 = clean.iter().sum::<f64>() - clean[i];
            row[i] += c.values[0] * others;
        }
    }
}

/// Follows a command up to so much short of it where it rises.
fn short_of_rise(c: &Call, line: &mut Line) {
    for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
        let mut rises = 0.0;
        let mut before = line.chamber_pa.first().map_or(0.0, |row| row[i]);
        for k in 0..line.chamber_pa.len() {
            let now = line.chamber_pa[k][i];
            if now != before {
                rises = f64::from(now > before);
            }
            before = now;
            line.chamber_pa[k][i] -= c.values[0] * rises;
            line.gauge_pa[k][i] -= c.values[0] * rises;
        }
    }
}

/// A share of the command that is missing.
fn short_of_level(c: &Call, line: &mut Line) {
    for rows in [&mut line.chamber_pa, &mut line.gauge_pa] {
        each_pressure(c, rows, |p| p * (1.0 - c.values[0]));
    }
}

/// Command and gauge follow with a lag.
fn supply_lag(c: &Call, line: &mut Line) {
    op::pressure_lag(c, line);
    for (gauge, chamber) in line.gauge_pa.iter_mut().zip(&line.chamber_pa) {
        for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
            gauge[i] = chamber[i];
        }
    }
}

/// All terms.
pub const TERMS: &[Term] = &[
    // Tensions of bellows by the pressures.
    tension("tension-constant", "Constant tension", "ΔT = c: the bellows is pre-tensioned.")
        .of(&[Input::None], Form::Constant)
        .numbers(&[n("force", "N", -60.0, 60.0)], |_, _| at([[3.0]], &[0]))
        .acts(|c, plant| pull(c, plant, |_, _| 1.0))
        .instant(),
    tension("tension-pressure", "Tension by pressure", "ΔT_i = c p_i: the effective area is another one.")
        .of(&[Input::Pressure], Form::Linear)
        .numbers(&[n("slope", "N/Pa", -5e-3, 5e-3)], |_, _| at([[2e-4]], &[0]))
        .acts(|c, plant| pull(c, plant, |p, i| p[i]))
        .instant(),
    tension("tension-pressure-squared", "Tension by squared pressure", "ΔT_i = c p_i².")
        .of(&[Input::Pressure], Form::Squared)
        .numbers(&[n("slope", "N/Pa²", -2e-7, 2e-7)], |_, _| at([[1e-8]], &[0]))
        .acts(|c, plant| pull(c, plant, |p, i| p[i] * p[i]))
        .instant(),
    tension(
        "tension-neighbour-pressure",
        "Tension by the neighbours' pressure",
        "ΔT_i = c (p_j + p_k), j and k its neighbours in the segment.",
    )
    .of(&[Input::NeighbourPressure], Form::Linear)
    .numbers(&[n("slope", "N/Pa", -5e-3, 5e-3)], |_, _| at([[2e-4]], &[0]))
    .acts(|c, plant| pull(c, plant, |p, i| neighbours(i).map(|j| p[j]).iter().sum()))
    .instant(),
    tension(
        "tension-neighbour-product",
        "Tension by the product of the neighbours' pressures",
        "ΔT_i = c p_j p_k, j and k its neighbours in the segment.",
    )
    .of(&[Input::NeighbourPressure], Form::Product)
    .numbers(&[n("slope", "N/Pa²", -2e-7, 2e-7)], |_, _| at([[1e-8]], &[0]))
    .acts(|c, plant| pull(c, plant, |p, i| neighbours(i).map(|j| p[j]).iter().product()))
    .instant(),
    tension(
        "tension-other-segment",
        "Tension by the other segment's pressure",
        "ΔT_i = c p_{i±3}: by the chamber of the same number in the other segment.",
    )
    .of(&[Input::OtherPressure], Form::Linear)
    .numbers(&[n("slope", "N/Pa", -5e-3, 5e-3)], |_, _| at([[2e-4]], &[0]))
    .acts(|c, plant| pull(c, plant, |p, i| p[(i + 3) % CHAMBERS]))
    .instant(),
    tension(
        "tension-pressure-memory",
        "Tension that forgets the pressure",
        "ΔT_i = c (p_i − p̄_i), τ dp̄/dt = p − p̄.",
    )
    .of(&[Input::PressureHistory], Form::Memory)
    .numbers(
        &[n("slope", "N/Pa", -5e-3, 5e-3), shape("time", "s", 10.0, [0.3, 300.0])],
        |_, _| at([[4e-4, 1.0], [4e-4, 5.0], [4e-4, 30.0]], &[0]),
    )
    .acts(|c, plant| series(c, plant, |p| unfollowed(c.t_s, p, c.values[1])))
    .remembers(1),
    tension("tension-time", "Tension that grows with time", "ΔT_i = c t.")
        .of(&[Input::Time], Form::Linear)
        .numbers(&[n("slope", "N/s", -1.0, 1.0)], |_, _| at([[0.05]], &[0]))
        .acts(|c, plant| {
            let seconds: Vec<f64> = c.t_s.iter().map(|t| t - c.t_s[0]).collect();
            series(c, plant, |_| seconds.clone());
        }),
    tension(
        "tension-pressure-time",
        "Tension by pressure that grows with time",
        "ΔT_i = c p_i t.",
    )
    .of(&[Input::Pressure, Input::Time], Form::Product)
    .numbers(&[n("slope", "N/(Pa s)", -5e-5, 5e-5)], |_, _| at([[4e-6]], &[0]))
    .acts(|c, plant| {
        series(c, plant, |p| {
            p.iter().zip(c.t_s).map(|(p, t)| p * (t - c.t_s[0])).collect()
        });
    }),
    // Tensions by the length.
    tension("tension-length", "Tension by length", "ΔT_i = c (l_i − l₀).")
        .of(&[Input::Length], Form::Linear)
        .numbers(&[n("rate", "N/m", -2000.0, 6000.0)], |_, _| at([[150.0]], &[0]))
        .acts(|c, plant| {
            let l0 = c.robot.rest_length_m;
            each_bellows(c, plant, |_, b| b.stiffness_n += c.values[0] * l0);
        })
        .instant(),
    tension("tension-length-cubed", "Tension by cubed length", "ΔT_i = c (l_i − l₀)³.")
        .of(&[Input::Length], Form::Cubed)
        .numbers(&[n("rate", "N/m³", 0.0, 1e6)], |_, _| at([[5e4]], &[0]))
        .acts(|c, plant| {
            let l0 = c.robot.rest_length_m;
            each_bellows(c, plant, |_, b| b.cubic_n += c.values[0] * l0.powi(3));
        })
        .instant(),
    tension(
        "tension-below-length",
        "Push below a length",
        "ΔT_i = −c max(0, l₁ − l_i): the bellows pushes where it is shorter than l₁.",
    )
    .of(&[Input::Length], Form::Below)
    .numbers(
        &[n("rate", "N/m", 0.0, 30e3), LENGTH],
        |_, _| at([[1e3, 0.148], [1e3, 0.142], [1e3, 0.136], [1e3, 0.13]], &[0]),
    )
    .acts(|c, plant| hinge(c, plant, false))
    .instant(),
    tension(
        "tension-beyond-length",
        "Pull beyond a length",
        "ΔT_i = c max(0, l_i − l₁): the bellows pulls where it is longer than l₁.",
    )
    .of(&[Input::Length], Form::Beyond)
    .numbers(
        &[n("rate", "N/m", 0.0, 30e3), LENGTH],
        |_, _| at([[1e3, 0.142], [1e3, 0.148], [1e3, 0.154], [1e3, 0.16]], &[0]),
    )
    .acts(|c, plant| hinge(c, plant, true))
    .instant(),
    tension(
        "tension-reversal",
        "Friction of the length",
        "dT/dl = (c − T sgn dl/dt)/w: builds up over a travel w after every reversal.",
    )
    .of(&[Input::Reversal], Form::Sign)
    .numbers(
        &[n("force", "N", 0.0, 60.0), shape("travel", "m", 5e-3, [1e-3, 0.05])],
        |_, _| at([[4.0, 0.003], [4.0, 0.01], [4.0, 0.03]], &[0]),
    )
    .acts(op::hysteresis),
    tension(
        "tension-length-memory",
        "Tension that forgets the length",
        "ΔT_i = B, dB/dt = c dl/dt − B/τ.",
    )
    .of(&[Input::LengthHistory], Form::Memory)
    .numbers(
        &[n("rate", "N/m", 0.0, 6000.0), shape("time", "s", 10.0, [0.5, 300.0])],
        |_, _| at([[300.0, 1.0], [300.0, 3.0], [300.0, 12.0], [300.0, 60.0]], &[0]),
    )
    .acts(|c, plant| {
        each_bellows(c, plant, |_, b| {
            if c.values[0] > 0.0 {
                b.branches.push(Branch {
                    rate_n_m: c.values[0],
                    tau_s: c.values[1],
                });
            }
        });
    })
    .remembers(1),
    tension("tension-length-rate", "Tension by how fast the length changes", "ΔT_i = c dl_i/dt.")
        .of(&[Input::LengthRate], Form::Linear)
        .numbers(&[n("rate", "N s/m", 0.0, 8000.0)], |_, _| at([[300.0]], &[0]))
        .acts(|c, plant| {
            const TAU_S: f64 = 0.02;
            each_bellows(c, plant, |_, b| {
                if c.values[0] > 0.0 {
                    b.branches.push(Branch {
                        rate_n_m: c.values[0] / TAU_S,
                        tau_s: TAU_S,
                    });
                }
            });
        }),
    tension(
        "tension-length-time",
        "Stiffness that changes with time",
        "ΔT_i = c (l_i − l₀) t.",
    )
    .of(&[Input::Length, Input::Time], Form::Product)
    .numbers(&[n("rate", "N/(m s)", -30.0, 30.0)], |_, _| at([[-3.0]], &[0]))
    .acts(|c, plant| react(c, plant, |at, i| at.longer_m[i] * at.t_s)),
    tension(
        "tension-pressure-length",
        "Tension by pressure and length",
        "ΔT_i = c p_i (l_i − l₀): the effective area follows the stretch.",
    )
    .of(&[Input::Pressure, Input::Length], Form::Product)
    .numbers(&[n("slope", "N/(Pa m)", -0.1, 0.1)], |_, _| at([[5e-3]], &[0]))
    .acts(|c, plant| react(c, plant, |at, i| at.chamber_pa[i] * at.longer_m[i])),
    tension(
        "tension-pressure-bending",
        "Tension by pressure and bending",
        "ΔT_i = c p_i θ, θ the bending angle of the segment.",
    )
    .of(&[Input::Pressure, Input::Bending], Form::Product)
    .numbers(&[n("slope", "N/(Pa rad)", -0.01, 0.01)], |_, _| at([[1e-3]], &[0]))
    .acts(|c, plant| react(c, plant, |at, i| at.chamber_pa[i] * at.bend_rad[i / 3])),
    // Walls of a segment.
    BARE.named(
        "stiffness-bending",
        "Bending stiffness",
        "ΔM = c k_b θ: a segment is stiffer or softer against bending.",
    )
    .on(Site::SegmentStiffness, Target::Segment, Reach::Either)
    .of(&[Input::Bending], Form::Linear)
    .numbers(&[n("share", "", -0.9, 5.0)], |_, _| at([[0.3]], &[0]))
    .acts(|c, plant| {
        for (s, section) in plant.model.rod.sections.iter_mut().enumerate() {
            if c.hits(s) {
                section.rigidity[0] *= 1.0 + c.values[0];
                section.rigidity[1] *= 1.0 + c.values[0];
            }
        }
    })
    .instant(),
    BARE.named(
        "stiffness-twist",
        "Torsional stiffness",
        "ΔM = c k_t φ: a segment is stiffer or softer against twist.",
    )
    .on(Site::SegmentStiffness, Target::Segment, Reach::Either)
    .of(&[Input::Twist], Form::Linear)
    .numbers(&[n("share", "", -0.9, 9.0)], |_, _| at([[0.3]], &[0]))
    .acts(|c, plant| {
        for (s, section) in plant.model.rod.sections.iter_mut().enumerate() {
            if c.hits(s) {
                section.rigidity[2] *= 1.0 + c.values[0];
            }
        }
    })
    .instant(),
    BARE.named(
        "stiffness-beyond-length",
        "A cable along a segment",
        "ΔT = c max(0, l − l₁) on each bellows of a segment: something pulls its ends together where it is longer than l₁.",
    )
    .on(Site::ChamberTension, Target::Segment, Reach::Single)
    .of(&[Input::Length], Form::Beyond)
    .numbers(
        &[n("rate", "N/m", 0.0, 30e3), LENGTH],
        |_, _| at([[300.0, 0.142], [300.0, 0.148], [300.0, 0.154]], &[0]),
    )
    .acts(|c, plant| {
        let l0 = c.robot.rest_length_m;
        for (i, b) in plant.model.rod.bellows_mut().enumerate() {
            if c.hits(i / 3) {
                b.hinges.push(Hinge {
                    from: c.values[1] / l0,
                    beyond: true,
                    stiffness_n: c.values[0] * l0,
                });
            }
        }
    })
    .instant(),
    BARE.named(
        "stiffness-damping",
        "Damping of the whole arm",
        "ΔF = −τ K dξ/dt: resists every change of shape in proportion to its stiffness.",
    )
    .on(Site::SegmentStiffness, Target::None, Reach::Common)
    .of(&[Input::LengthRate], Form::Linear)
    .numbers(&[n("time", "s", 0.0, 3.0)], |_, _| at([[0.15], [0.8]], &[0]))
    .acts(|c, plant| plant.viscosity.add(Viscosity::proportional(c.values[0])))
    .remembers(0),
    // On the end pad.
    end(
        Site::EndForce,
        "force-vertical",
        "Constant vertical force",
        "ΔF_z = c on the end pad's origin, base axes.",
    )
    .of(&[Input::None], Form::Constant)
    .numbers(&[n("z", "N", -30.0, 30.0)], |_, _| at([[-1.0]], &[0]))
    .acts(|c, plant| plant.tip_force_n.z += c.values[0])
    .instant(),
    end(
        Site::EndForce,
        "load-vertical",
        "Constant vertical force where loads hang",
        "ΔF_z = c on the point where payloads hang, base axes.",
    )
    .of(&[Input::None], Form::Constant)
    .numbers(&[n("z", "N", -30.0, 30.0)], |_, _| at([[-1.0]], &[0]))
    .acts(|c, plant| plant.payload_kg -= c.values[0] / GRAVITY_M_S2)
    .instant(),
    end(
        Site::EndForce,
        "force-constant",
        "Constant force",
        "ΔF = (x, y, z) on the end pad's origin, base axes.",
    )
    .of(&[Input::None], Form::Constant)
    .numbers(
        &[n("x", "N", -30.0, 30.0), n("y", "N", -30.0, 30.0), n("z", "N", -30.0, 30.0)],
        |_, _| at([[0.5, 0.5, 0.5]], &[0, 1, 2]),
    )
    .acts(op::tip_force)
    .instant(),
    end(
        Site::EndForce,
        "force-time",
        "Force that grows with time",
        "ΔF = (x, y, z) t on the end pad's origin, base axes.",
    )
    .of(&[Input::Time], Form::Linear)
    .numbers(
        &[n("x", "N/s", -1.0, 1.0), n("y", "N/s", -1.0, 1.0), n("z", "N/s", -1.0, 1.0)],
        |_, _| at([[0.01, 0.01, 0.01]], &[0, 1, 2]),
    )
    .acts(|c, plant| plant.tip_force_n_s += Vector3::from_column_slice(c.values)),
    end(
        Site::EndForce,
        "force-reversal",
        "Friction of the end pad",
        "ΔF = −k u, no more than c: against the motion of the end pad, built up over a way c/k after every reversal.",
    )
    .of(&[Input::Reversal], Form::Sign)
    .numbers(
        &[n("force", "N", 0.0, 20.0), shape("rate", "N/m", 300.0, [50.0, 5000.0])],
        |_, _| at([[1.0, 300.0], [3.0, 300.0], [3.0, 1000.0]], &[0]),
    )
    .acts(|c, plant| {
        if c.values[0] > 0.0 && plant.model.rod.floor.is_none() {
            plant.model.rod.floor = Some(Floor {
                surface_from_base: nalgebra::Rotation3::identity(),
                height_m: -1e3,
                rate_n_m: 0.0,
                friction: 0.0,
                drag: Some(Drag {
                    force_n: c.values[0],
                    rate_n_m: c.values[1],
                }),
            });
        }
    })
    .abrupt(),
    end(
        Site::EndForce,
        "force-surface",
        "A surface",
        "ΔF = k max(0, h − n·p) along the normal n, the vertical turned by (x, y, 0): the end pad rests on something.",
    )
    .of(&[Input::Position], Form::Below)
    .numbers(
        &[
            Parameter::new("height", "m", -0.7, [-0.7, 0.2]).scale(0.4).absolute(3e-3),
            Parameter::new("rate", "N/m", 1000.0, [50.0, 5000.0]).scale(90.0).of_value(0.25),
            Parameter::new("x", "rad", 0.0, [-1.75, 1.75]).scale(0.2).absolute(0.03),
            Parameter::new("y", "rad", 0.0, [-1.75, 1.75]).scale(0.2).absolute(0.03),
        ],
        |scene, target| {
            let without_grip = |s: &Start| Start {
                at: vec![s.at[0], s.at[1], s.at[3], s.at[4]],
                moves: s.moves.iter().map(|m| if *m > 2 { m - 1 } else { *m }).collect(),
            };
            half_spaces(scene, target).iter().map(without_grip).collect()
        },
    )
    .acts(|c, plant| {
        let values = [c.values[0], c.values[1], 0.0, c.values[2], c.values[3]];
        op::contact(&Call { values: &values, ..*c }, plant);
    })
    .abrupt(),
    end(
        Site::EndMoment,
        "moment-constant",
        "Constant moment",
        "ΔM = (x, y, z) on the end pad, base axes.",
    )
    .of(&[Input::None], Form::Constant)
    .numbers(
        &[n("x", "N m", -3.0, 3.0), n("y", "N m", -3.0, 3.0), n("z", "N m", -3.0, 3.0)],
        |_, _| at([[0.05, 0.05, 0.05]], &[0, 1, 2]),
    )
    .acts(|c, plant| plant.model.hidden_moment_nm += Vector3::from_column_slice(c.values))
    .instant(),
    end(
        Site::EndMoment,
        "moment-of-weight",
        "Moment of the weight",
        "ΔM = m g × (x, y, z) in the end pad's axes: what it carries hangs beside its centre.",
    )
    .of(&[Input::Orientation], Form::Linear)
    .numbers(
        &[n("x", "m", -0.15, 0.15), n("y", "m", -0.15, 0.15), n("z", "m", -0.15, 0.15)],
        |_, _| at([[0.02, 0.02, 0.02]], &[0, 1, 2]),
    )
    .acts(op::com_offset)
    .instant(),
    end(
        Site::Gravity,
        "gravity-direction",
        "Direction of gravity",
        "g → R(x, y) g: gravity has another direction at the base. IMUs, which measure against it, see that (imus = 1) or do not.",
    )
    .of(&[Input::None], Form::Constant)
    .numbers(
        &[
            n("x", "rad", -0.35, 0.35),
            n("y", "rad", -0.35, 0.35),
            Parameter::new("imus", "", 0.0, [-0.5, 1.5]).scale(1.0),
        ],
        |_, _| at([[0.03, 0.03, 1.0], [0.03, 0.03, 0.0]], &[0, 1]),
    )
    .acts(op::base_tilt)
    .also(op::tilted_imus, &[R2, R4, R5])
    .instant(),
    // Readings of springs.
    spring("spring-constant", "Offset of a spring", "Δy = c.")
        .of(&[Input::None], Form::Constant)
        .numbers(&[n("offset", "m", -0.03, 0.03)], |_, _| at([[1e-3]], &[0]))
        .reads(|c, s| each_spring(c, s, |_, _, _| 1.0)),
    spring("spring-length", "Gain of a spring", "Δy = c (l − l₀).")
        .of(&[Input::Length], Form::Linear)
        .numbers(&[n("gain", "", -0.5, 0.5)], |_, _| at([[0.03]], &[0]))
        .reads(|c, s| each_spring(c, s, |_, i, l| l[i] - c.robot.rest_length_m)),
    spring("spring-length-squared", "Curved scale of a spring", "Δy = c (l − l₀)².")
        .of(&[Input::Length], Form::Squared)
        .numbers(&[n("curve", "1/m", -20.0, 20.0)], |_, _| at([[1.0]], &[0]))
        .reads(|c, s| each_spring(c, s, |_, i, l| (l[i] - c.robot.rest_length_m).powi(2))),
    spring(
        "spring-partner",
        "Spring by its partner's length",
        "Δy_A = c (l_B − l₀), B the other spring of the pair.",
    )
    .of(&[Input::PartnerLength], Form::Linear)
    .numbers(&[n("share", "", -0.5, 0.5)], |_, _| at([[0.05]], &[0]))
    .reads(op::spring_crosstalk),
    spring("spring-time", "Drift of a spring", "Δy = c t.")
        .of(&[Input::Time], Form::Linear)
        .numbers(&[n("rate", "m/s", -1e-3, 1e-3)], |_, _| at([[2e-5]], &[0]))
        .reads(op::spring_drift),
    spring("spring-length-rate", "Lag of a spring", "τ dy/dt = l − y.")
        .of(&[Input::LengthRate], Form::Linear)
        .numbers(&[n("time", "s", 0.0, 3.0)], |_, _| at([[0.1], [0.6]], &[0]))
        .reads(op::spring_lag)
        .remembers(0),
    spring(
        "spring-reversal",
        "Dead band of a spring",
        "|l − y| ≤ w/2: the reading follows once it has taken up the play w.",
    )
    .of(&[Input::Reversal], Form::Sign)
    .numbers(&[n("play", "m", 0.0, 0.02)], |_, _| at([[1e-3], [3e-3]], &[0]))
    .reads(|c, sensors| {
        let half_m = 0.5 * c.values[0];
        let mut read = sensors.first().map_or([0.0; SPRINGS], |s| s.spring_m);
        for row in sensors {
            for i in (0..SPRINGS).filter(|i| c.hits(*i)) {
                read[i] = read[i].clamp(row.spring_m[i] - half_m, row.spring_m[i] + half_m);
                row.spring_m[i] = read[i];
            }
        }
    })
    .abrupt(),
    spring("spring-held", "A spring that stands still", "y(t) = y(t₁) from t₁ on.")
        .of(&[Input::Time], Form::Held)
        .numbers(
            &[Parameter::new("since", "s", 1e4, [0.0, 1e4]).scale(30.0).absolute(1.0)],
            |scene, target| match target.and_then(|i| scene.still_since_s[i]) {
                Some(since_s) => at([[since_s]], &[0]),
                None => at([[0.3 * scene.seconds], [0.6 * scene.seconds]], &[0]),
            },
        )
        .reads(op::spring_stuck)
        .abrupt(),
    spring(
        "spring-flow",
        "Springs by the flow of air",
        "Δy = c Σ_j |dp_j/dt|: valves and pumps disturb the oscillators.",
    )
    .of(&[Input::PressureRate], Form::Linear)
    .numbers(&[n("slope", "m s/Pa", -2e-6, 2e-6)], |_, _| at([[3e-8]], &[0]))
    .reads(|c, s| each_spring(c, s, |k, _, _| flow(c, k))),
    spring(
        "spring-pressure",
        "Springs by the pressure of their segment",
        "Δy = c (p_1 + p_2 + p_3), the chambers of its segment.",
    )
    .of(&[Input::Pressure], Form::Linear)
    .numbers(&[n("slope", "m/Pa", -1e-6, 1e-6)], |_, _| at([[3e-8]], &[0]))
    .reads(|c, s| {
        each_spring(c, s, |k, i, _| {
            let segment = 3 * (i / 6);
            c.chamber_pa.get(k).map_or(0.0, |p| p[segment..segment + 3].iter().sum())
        });
    }),
    // Readings of IMUs.
    imu("imu-constant", "Turn of an IMU", "R_read = R exp(x, y, z).")
        .of(&[Input::None], Form::Constant)
        .numbers(
            &[n("x", "rad", -0.5, 0.5), n("y", "rad", -0.5, 0.5), n("z", "rad", -0.5, 0.5)],
            |_, _| at([[0.02, 0.02, 0.02]], &[0, 1, 2]),
        )
        .reads(op::imu_misalignment),
    imu("imu-heading-time", "Drift of a heading", "R_read = R_z(c t) R.")
        .of(&[Input::Time], Form::Linear)
        .numbers(&[n("rate", "rad/s", -0.05, 0.05)], |_, _| at([[1e-3]], &[0]))
        .reads(op::imu_drift),
    imu("imu-turn-time", "Drift of an IMU's pitch and roll", "R_read = R exp((x, y, 0) t).")
        .of(&[Input::Time], Form::Linear)
        .numbers(&[n("x", "rad/s", -0.05, 0.05), n("y", "rad/s", -0.05, 0.05)], |_, _| {
            at([[1e-3, 1e-3]], &[0, 1])
        })
        .reads(imu_turning),
    // Between gauge and chamber.
    behind(
        "pressure-rate",
        "Chambers that follow their gauges late",
        "τ dp/dt = p_gauge − p.",
        op::behind_lag,
        op::pressure_lag,
    )
    .of(&[Input::PressureRate], Form::Linear)
    .numbers(&[n("time", "s", 0.0, 5.0)], |_, _| at([[0.1], [0.8]], &[0]))
    .remembers(0),
    behind(
        "pressure-others",
        "Chambers by the pressure of all others",
        "p_i = p_gauge,i + c Σ_{j≠i} p_gauge,j.",
        behind_others,
        |c, line| behind_others(c, &mut line.chamber_pa),
    )
    .of(&[Input::OtherPressure], Form::Linear)
    .numbers(&[n("share", "", -0.3, 0.3)], |_, _| at([[0.01]], &[0])),
    behind(
        "pressure-offset",
        "Offset of a gauge",
        "p = p_gauge + c.",
        |c, chamber_pa| each_pressure(c, chamber_pa, |p| p + c.values[0]),
        |c, line| each_pressure(c, &mut line.chamber_pa, |p| p + c.values[0]),
    )
    .of(&[Input::None], Form::Constant)
    .numbers(&[n("offset", "Pa", -10e3, 10e3)], |_, _| at([[300.0]], &[0])),
    behind(
        "pressure-gain",
        "Gain of a gauge",
        "p = (1 + c) p_gauge.",
        |c, chamber_pa| each_pressure(c, chamber_pa, |p| p * (1.0 + c.values[0])),
        |c, line| each_pressure(c, &mut line.chamber_pa, |p| p * (1.0 + c.values[0])),
    )
    .of(&[Input::Pressure], Form::Linear)
    .numbers(&[n("gain", "", -0.5, 1.0)], |_, _| at([[0.03]], &[0])),
    // Between command and gauge.
    supply("supply-lag", "A supply that follows late", "τ dp/dt = u − p.", supply_lag)
        .of(&[Input::PressureRate], Form::Linear)
        .numbers(&[n("time", "s", 0.0, 5.0)], |_, _| at([[0.1], [0.8]], &[0]))
        .remembers(0),
    supply("supply-delay", "A supply that follows after a dead time", "p(t) = u(t − T).", op::pressure_delay)
        .of(&[Input::PressureHistory], Form::Delay)
        .numbers(&[n("delay", "s", 0.0, 2.0)], |_, _| at([[0.05], [0.4]], &[0]))
        .remembers(0),
    supply("supply-limit", "A supply with a limited rate", "−r₋ ≤ dp/dt ≤ r₊.", op::flow_limit)
        .of(&[Input::PressureRate], Form::Limit)
        .numbers(
            &[
                Parameter::new("inflate", "Pa/s", 1e6, [50.0, 1e6]).of_departure(0.1).scale(900.0),
                Parameter::new("deflate", "Pa/s", 1e6, [50.0, 1e6]).of_departure(0.1).scale(900.0),
            ],
            flow_limits,
        )
        .abrupt(),
    supply(
        "supply-others",
        "A supply that the other chambers draw on",
        "p_i = u_i − c Σ_{j≠i} (u_j − ū_j), τ dū/dt = u − ū.",
        op::supply_coupling,
    )
    .of(&[Input::OtherPressure], Form::Memory)
    .numbers(
        &[n("share", "", -0.5, 0.5), shape("time", "s", 0.3, [0.02, 5.0])],
        |_, _| at([[0.05, 0.1], [0.05, 0.8]], &[0]),
    )
    .remembers(1),
    supply(
        "supply-sign",
        "A supply that stops short where it fills",
        "p = u − c where u last rose.",
        short_of_rise,
    )
    .of(&[Input::PressureRate], Form::Sign)
    .numbers(&[n("short", "Pa", -5e3, 5e3)], |_, _| at([[300.0]], &[0])),
    supply("supply-level", "A supply that falls short in proportion", "p = (1 − c) u.", short_of_level)
        .of(&[Input::Pressure], Form::Linear)
        .numbers(&[n("share", "", -0.5, 0.5)], |_, _| at([[0.05]], &[0])),
    // Motion capture.
    capture(
        "frame-constant",
        "Frame of the motion capture",
        "T → exp(x, y, z, rx, ry, rz) T.",
        op::mocap_frame,
    )
    .of(&[Input::None], Form::Constant)
    .numbers(MOVED, |_, _| at([[3e-3, 3e-3, 3e-3, 0.01, 0.01, 0.01]], &[0, 1, 2, 3, 4, 5])),
    capture(
        "body-constant",
        "Slipped tracked body",
        "T_i → T_i exp(x, y, z, rx, ry, rz): the body that motion capture tracks on the middle (1) or the end pad (2) sits elsewhere.",
        op::tracked_body,
    )
    .on(Site::Capture, Target::Segment, Reach::Single)
    .of(&[Input::None], Form::Constant)
    .numbers(MOVED, |_, _| at([[3e-3, 3e-3, 3e-3, 0.01, 0.01, 0.01]], &[0, 1, 2, 3, 4, 5])),
    capture(
        "clock-constant",
        "Clock of the motion capture",
        "T(t) → T(t − c).",
        op::clock_offset,
    )
    .of(&[Input::PadRate], Form::Linear)
    .numbers(&[n("offset", "s", -2.0, 2.0)], |_, _| at([[0.1]], &[0])),
    capture(
        "clock-time",
        "Rate of the motion capture's clock",
        "T(t) → T(t − c t).",
        op::clock_skew,
    )
    .of(&[Input::PadRate, Input::Time], Form::Product)
    .numbers(&[n("skew", "", -0.02, 0.02)], |_, _| at([[1e-3]], &[0])),
];
