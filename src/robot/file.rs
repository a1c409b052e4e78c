//! The robot file: TOML with mm, kPa and degrees in, [`RobotSpec`] in SI out.

use nalgebra::{Rotation3, Unit, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::patch::{Patch, applied, hash_of};
use super::{
    ImuMount, KeepOut, PadId, RobotError, RobotSpec, SegmentSpec, SpringSpec, SupplyOff,
    Uncertainty,
};
use crate::signal::{CHAMBERS, Pose, PressureLimits, exactly};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    base: Base,
    bellows: Bellows,
    segment: Segment,
    #[serde(default)]
    segments: Vec<OneSegment>,
    pressure: Pressure,
    mass: Mass,
    springs: Option<Springs>,
    #[serde(default)]
    imus: Vec<Imu>,
    motion: Motion,
    #[serde(default)]
    chambers: Vec<Chamber>,
    #[serde(default)]
    tracked_bodies: Bodies,
    #[serde(default)]
    uncertainty: Uncertain,
    #[serde(default)]
    keep_out: Vec<Beyond>,
    virtual_rig: Option<VirtualRig>,
    #[serde(default)]
    patches: Vec<Patch>,
}

/// The virtual arm that the file was measured on.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct VirtualRig {
    unit: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Base {
    bellows_circle_radius_mm: f64,
    #[serde(deserialize_with = "exactly")]
    bellows_angles_deg: [f64; CHAMBERS],
    pad_thickness_mm: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Bellows {
    inner_diameter_mm: f64,
    outer_diameter_mm: f64,
    #[serde(rename = "wall_mm")]
    _wall_mm: f64,
    rest_length_mm: f64,
    #[serde(deserialize_with = "exactly")]
    length_range_mm: [f64; 2],
    effective_diameter_mm: f64,
    axial_stiffness_n_m: f64,
}

/// What one chamber has of its own.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Chamber {
    #[serde(default, deserialize_with = "place")]
    at_mm: Option<[f64; 2]>,
    area_mm2: Option<f64>,
    axial_stiffness_n_m: Option<f64>,
}

/// A place of two coordinates, where it is there.
fn place<'de, D: serde::Deserializer<'de>>(d: D) -> Result<Option<[f64; 2]>, D::Error> {
    exactly(d).map(Some)
}

/// Where motion capture's bodies sit on the base and on the pads.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Bodies {
    base: Option<Body>,
    middle: Option<Body>,
    end: Option<Body>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Body {
    #[serde(deserialize_with = "exactly")]
    xyz_mm: [f64; 3],
    #[serde(deserialize_with = "exactly")]
    ypr_deg: [f64; 3],
}

/// Standard deviations of what is not measured; those that an arm by its drawing has where a key is missing.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Uncertain {
    area: f64,
    axial_stiffness: f64,
    bending_stiffness: f64,
    torsional_stiffness: f64,
    rest_length: f64,
    hardening: f64,
    mass: f64,
    body_mm: f64,
    body_deg: f64,
    repeat_mm: f64,
    repeat_deg: f64,
}

impl Default for Uncertain {
    fn default() -> Self {
        Self {
            area: 0.03,
            axial_stiffness: 0.05,
            bending_stiffness: 0.1,
            torsional_stiffness: 0.2,
            rest_length: 0.005,
            hardening: 0.3,
            mass: 0.05,
            body_mm: 2.0,
            body_deg: 0.02_f64.to_degrees(),
            repeat_mm: 1.0,
            repeat_deg: 0.01_f64.to_degrees(),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Segment {
    bending_stiffness_nm_rad: f64,
    torsional_stiffness_nm_rad: f64,
    #[serde(default)]
    axial_stiffness_n_m: f64,
}

/// What one segment has of its own.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct OneSegment {
    bending_stiffness_nm_rad: Option<f64>,
    torsional_stiffness_nm_rad: Option<f64>,
    axial_stiffness_n_m: Option<f64>,
    locked: bool,
}

/// A locked segment and its bellows are so many times as stiff: what would move it by 50 mm moves it by 0.05.
const LOCKED: f64 = 1e3;

impl File {
    /// How many times as stiff a segment (0 or 1) is as its numbers state.
    fn locked(&self, segment: usize) -> f64 {
        match self.segments.get(segment).is_some_and(|s| s.locked) {
            true => LOCKED,
            false => 1.0,
        }
    }

    fn segment(&self, k: usize) -> SegmentSpec {
        let own = self.segments.get(k);
        let bending = own.and_then(|s| s.bending_stiffness_nm_rad);
        let torsional = own.and_then(|s| s.torsional_stiffness_nm_rad);
        let axial = own.and_then(|s| s.axial_stiffness_n_m);
        let locked = self.locked(k);
        SegmentSpec {
            bending_nm_rad: locked * bending.unwrap_or(self.segment.bending_stiffness_nm_rad),
            torsional_nm_rad: locked * torsional.unwrap_or(self.segment.torsional_stiffness_nm_rad),
            axial_n_m: locked * axial.unwrap_or(self.segment.axial_stiffness_n_m),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pressure {
    #[serde(deserialize_with = "exactly")]
    range_kpa: [f64; 2],
    rate_kpa_s: f64,
    over_pressure_kpa: f64,
    pump_flow_l_min: f64,
    #[serde(default)]
    supply_off: SupplyOff,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Mass {
    bellows_kg: f64,
    middle_pad_kg: f64,
    end_pad_kg: f64,
    gripper_kg: f64,
    #[serde(rename = "top_fittings_kg")]
    _top_fittings_kg: f64,
    gripper_com_mm: f64,
    payload_com_mm: f64,
    payload_max_kg: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Springs {
    attachment_radius_mm: f64,
    #[serde(deserialize_with = "exactly")]
    pair_angles_deg: [f64; 3],
    half_spread_deg: f64,
    rate_n_m: f64,
    free_length_mm: f64,
    outer_diameter_mm: f64,
    wire_diameter_mm: f64,
    #[serde(deserialize_with = "exactly")]
    range_mm: [f64; 2],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Imu {
    pad: Pad,
    #[serde(deserialize_with = "exactly")]
    mounting_ypr_deg: [f64; 3],
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Pad {
    Middle,
    End,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Motion {
    tip_speed_max_mm_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Beyond {
    name: String,
    #[serde(deserialize_with = "exactly")]
    point_mm: [f64; 3],
    #[serde(deserialize_with = "exactly")]
    outward: [f64; 3],
}

/// The pressures of an arm that other boards drive, kPa.
const PRESSURE_OTHERS_KPA: [f64; 2] = [-100.0, 2000.0];

impl Springs {
    /// For an arm without any: on the circle of its bellows, and without a force.
    fn none(radius_mm: f64) -> Self {
        Self {
            attachment_radius_mm: radius_mm,
            pair_angles_deg: [60.0, 180.0, 300.0],
            half_spread_deg: 20.0,
            rate_n_m: 0.0,
            free_length_mm: 60.0,
            outer_diameter_mm: 4.0,
            wire_diameter_mm: 0.4,
            range_mm: SPRING_RANGE_MM,
        }
    }
}

/// No number of an arm, in the units of its file, is larger.
const LARGEST: f64 = 1e6;
/// The arm's lengths are larger; in metres they are smaller, mm.
const LENGTH_LEAST_MM: f64 = 1.0;
/// The widest range of set pressures: what the boards' firmware is built for, kPa.
const PRESSURE_RANGE_KPA: [f64; 2] = [-40.0, 40.0];
/// The widest working range of the springs, mm.
const SPRING_RANGE_MM: [f64; 2] = [70.0, 240.0];

impl RobotSpec {
    /// Reads the text of a robot file.
    ///
    /// # Errors
    /// [`RobotError`] with line and column for syntax, with key and bound for values.
    pub fn from_toml(text: &str) -> Result<Self, RobotError> {
        let mut f: File = toml::from_str(text).map_err(|e| syntax(text, &e))?;
        let has_springs = f.springs.is_some();
        let has_imus = !f.imus.is_empty();
        let s = match &f.springs {
            Some(s) => s,
            None => &Springs::none(f.base.bellows_circle_radius_mm),
        };
        check(&f, s)?;
        let patches = applied(text, std::mem::take(&mut f.patches))?;
        let hash = hash_of(text);
        let on_circle = |radius_mm: f64, deg: f64| {
            let a = deg.to_radians();
            Vector3::new(a.cos(), a.sin(), 0.0) * radius_mm * 1e-3
        };
        // Springs per segment in the order pair 1 A, B, pair 2 A, B, pair 3 A, B; the pairs sit
        // between the bellows, so they turn with the segment's first bellows.
        let spring_end = |i: usize, top: bool| {
            let a = i.is_multiple_of(2);
            let sign = if a == top { -1.0 } else { 1.0 };
            let segment_deg = f.base.bellows_angles_deg[3 * (i / 6)];
            let deg = segment_deg + s.pair_angles_deg[(i % 6) / 2] + sign * s.half_spread_deg;
            on_circle(s.attachment_radius_mm, deg)
        };
        let mount = |i: &Imu| {
            let [yaw, pitch, roll] = i.mounting_ypr_deg.map(f64::to_radians);
            ImuMount {
                pad: match i.pad {
                    Pad::Middle => PadId::Middle,
                    Pad::End => PadId::End,
                },
                pad_from_imu: Rotation3::from_euler_angles(roll, pitch, yaw),
            }
        };
        Ok(Self {
            name: f.name.clone(),
            bellows_m: std::array::from_fn(|i| match f.chambers.get(i).and_then(|c| c.at_mm) {
                Some([x, y]) => Vector3::new(x, y, 0.0) * 1e-3,
                None => on_circle(
                    f.base.bellows_circle_radius_mm,
                    f.base.bellows_angles_deg[i],
                ),
            }),
            pad_thickness_m: f.base.pad_thickness_mm * 1e-3,
            rest_length_m: f.bellows.rest_length_mm * 1e-3,
            length_range_m: f.bellows.length_range_mm.map(|x| x * 1e-3),
            bellows_outer_diameter_m: f.bellows.outer_diameter_mm * 1e-3,
            bellows_inner_diameter_m: f.bellows.inner_diameter_mm * 1e-3,
            area_m2: std::array::from_fn(|i| match f.chambers.get(i).and_then(|c| c.area_mm2) {
                Some(mm2) => mm2 * 1e-6,
                None => {
                    std::f64::consts::FRAC_PI_4 * (f.bellows.effective_diameter_mm * 1e-3).powi(2)
                }
            }),
            axial_stiffness_n_m: std::array::from_fn(|i| {
                let own = f.chambers.get(i).and_then(|c| c.axial_stiffness_n_m);
                f.locked(i / 3) * own.unwrap_or(f.bellows.axial_stiffness_n_m)
            }),
            segments: std::array::from_fn(|k| f.segment(k)),
            pressure: PressureLimits {
                min_pa: f.pressure.range_kpa[0] * 1e3,
                max_pa: f.pressure.range_kpa[1] * 1e3,
                rate_pa_s: f.pressure.rate_kpa_s * 1e3,
            },
            over_pressure_pa: f.pressure.over_pressure_kpa * 1e3,
            pump_flow_m3_s: f.pressure.pump_flow_l_min * 1e-3 / 60.0,
            bellows_kg: f.mass.bellows_kg,
            middle_pad_kg: f.mass.middle_pad_kg,
            end_pad_kg: f.mass.end_pad_kg,
            gripper_kg: f.mass.gripper_kg,
            gripper_com_m: f.mass.gripper_com_mm * 1e-3,
            payload_com_m: f.mass.payload_com_mm * 1e-3,
            payload_max_kg: f.mass.payload_max_kg,
            spring_top_m: std::array::from_fn(|i| spring_end(i, true)),
            spring_bottom_m: std::array::from_fn(|i| spring_end(i, false)),
            spring: SpringSpec {
                rate_n_m: s.rate_n_m,
                free_length_m: s.free_length_mm * 1e-3,
                outer_diameter_m: s.outer_diameter_mm * 1e-3,
                wire_diameter_m: s.wire_diameter_mm * 1e-3,
                range_m: s.range_mm.map(|x| x * 1e-3),
            },
            imus: std::array::from_fn(|i| f.imus.get(i).map_or_else(|| unmounted(i), mount)),
            has_springs,
            has_imus,
            bodies: [
                &f.tracked_bodies.base,
                &f.tracked_bodies.middle,
                &f.tracked_bodies.end,
            ]
            .map(|b| b.as_ref().map_or_else(Pose::identity, body)),
            uncertainty: f.uncertainty.spec(),
            tip_speed_max_m_s: f.motion.tip_speed_max_mm_s * 1e-3,
            supply_off: f.pressure.supply_off,
            keep_out: f.keep_out.iter().map(keep_out).collect(),
            virtual_unit: f.virtual_rig.as_ref().map(|v| v.unit),
            base_hash: patches.first().map_or(&hash, |a| &a.onto).clone(),
            hash,
            patches,
        })
    }
}

/// The place of an IMU that an arm lacks.
fn unmounted(i: usize) -> ImuMount {
    ImuMount {
        pad: if i < 2 { PadId::Middle } else { PadId::End },
        pad_from_imu: Rotation3::identity(),
    }
}

/// The pose of a tracked body on its pad.
fn body(b: &Body) -> Pose {
    let [yaw, pitch, roll] = b.ypr_deg.map(f64::to_radians);
    Pose::from_parts(
        (Vector3::from(b.xyz_mm) * 1e-3).into(),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    )
}

impl Uncertain {
    fn spec(&self) -> Uncertainty {
        Uncertainty {
            area: self.area,
            axial_stiffness: self.axial_stiffness,
            bending_stiffness: self.bending_stiffness,
            torsional_stiffness: self.torsional_stiffness,
            rest_length: self.rest_length,
            hardening: self.hardening,
            mass: self.mass,
            body_m: self.body_mm * 1e-3,
            body_rad: self.body_deg.to_radians(),
            repeat_m: self.repeat_mm * 1e-3,
            repeat_rad: self.repeat_deg.to_radians(),
        }
    }

    fn numbers(&self) -> [(&'static str, f64); 11] {
        [
            ("uncertainty.area", self.area),
            ("uncertainty.axial_stiffness", self.axial_stiffness),
            ("uncertainty.bending_stiffness", self.bending_stiffness),
            ("uncertainty.torsional_stiffness", self.torsional_stiffness),
            ("uncertainty.rest_length", self.rest_length),
            ("uncertainty.hardening", self.hardening),
            ("uncertainty.mass", self.mass),
            ("uncertainty.body_mm", self.body_mm),
            ("uncertainty.body_deg", self.body_deg),
            ("uncertainty.repeat_mm", self.repeat_mm),
            ("uncertainty.repeat_deg", self.repeat_deg),
        ]
    }
}

fn keep_out(b: &Beyond) -> KeepOut {
    KeepOut {
        name: b.name.clone(),
        point_m: Vector3::from(b.point_mm) * 1e-3,
        outward: Unit::new_normalize(Vector3::from(b.outward)),
    }
}

fn syntax(text: &str, e: &toml::de::Error) -> RobotError {
    let at = e.span().map_or(0, |s| s.start).min(text.len());
    let before = text.get(..at).unwrap_or_default();
    RobotError::Syntax {
        line: before.matches('\n').count() + 1,
        column: before.chars().rev().take_while(|c| *c != '\n').count() + 1,
        message: e.message().replace('\n', " "),
    }
}

fn check(f: &File, springs: &Springs) -> Result<(), RobotError> {
    if !(f.chambers.is_empty() || f.chambers.len() == CHAMBERS) {
        return Err(RobotError::Value {
            key: "chambers",
            value: format!("{} tables", f.chambers.len()),
            must: "six [[chambers]] tables, or none",
        });
    }
    if !(f.segments.is_empty() || f.segments.len() == 2) {
        return Err(RobotError::Value {
            key: "segments",
            value: format!("{} tables", f.segments.len()),
            must: "two [[segments]] tables, or none",
        });
    }
    let segments = f.segments.iter().flat_map(|s| {
        let own = [
            (
                "segments.bending_stiffness_nm_rad",
                s.bending_stiffness_nm_rad,
            ),
            (
                "segments.torsional_stiffness_nm_rad",
                s.torsional_stiffness_nm_rad,
            ),
        ];
        own.into_iter().filter_map(|(key, v)| Some((key, v?)))
    });
    let chambers = f.chambers.iter().flat_map(|c| {
        let own = [
            ("chambers.area_mm2", c.area_mm2),
            ("chambers.axial_stiffness_n_m", c.axial_stiffness_n_m),
        ];
        own.into_iter().filter_map(|(key, v)| Some((key, v?)))
    });
    for (key, value) in chambers.chain(segments).chain(f.uncertainty.numbers()) {
        if !(value > 0.0 && value <= LARGEST) {
            return Err(RobotError::Value {
                key,
                value: value.to_string(),
                must: "greater than 0 and at most a million",
            });
        }
    }

    let positive = [
        (
            "base.bellows_circle_radius_mm",
            f.base.bellows_circle_radius_mm,
        ),
        ("bellows.rest_length_mm", f.bellows.rest_length_mm),
        (
            "bellows.effective_diameter_mm",
            f.bellows.effective_diameter_mm,
        ),
        ("bellows.axial_stiffness_n_m", f.bellows.axial_stiffness_n_m),
        (
            "segment.bending_stiffness_nm_rad",
            f.segment.bending_stiffness_nm_rad,
        ),
        (
            "segment.torsional_stiffness_nm_rad",
            f.segment.torsional_stiffness_nm_rad,
        ),
        ("pressure.rate_kpa_s", f.pressure.rate_kpa_s),
        ("pressure.pump_flow_l_min", f.pressure.pump_flow_l_min),
        ("springs.attachment_radius_mm", springs.attachment_radius_mm),
        ("springs.free_length_mm", springs.free_length_mm),
        ("springs.wire_diameter_mm", springs.wire_diameter_mm),
        ("springs.outer_diameter_mm", springs.outer_diameter_mm),
        ("motion.tip_speed_max_mm_s", f.motion.tip_speed_max_mm_s),
        ("pressure.over_pressure_kpa", f.pressure.over_pressure_kpa),
    ];
    for (key, value) in positive {
        if !(value > 0.0 && value <= LARGEST) {
            return Err(RobotError::Value {
                key,
                value: value.to_string(),
                must: "greater than 0 and at most a million",
            });
        }
    }
    let lengths = [
        (
            "base.bellows_circle_radius_mm",
            f.base.bellows_circle_radius_mm,
        ),
        ("bellows.rest_length_mm", f.bellows.rest_length_mm),
        ("bellows.length_range_mm", f.bellows.length_range_mm[1]),
        (
            "bellows.effective_diameter_mm",
            f.bellows.effective_diameter_mm,
        ),
        ("springs.attachment_radius_mm", springs.attachment_radius_mm),
        ("springs.free_length_mm", springs.free_length_mm),
    ];
    for (key, value) in lengths {
        if value > 0.0 && value < LENGTH_LEAST_MM {
            return Err(RobotError::Metres { key, value });
        }
    }
    let not_negative = [
        ("base.pad_thickness_mm", f.base.pad_thickness_mm),
        ("mass.bellows_kg", f.mass.bellows_kg),
        ("mass.middle_pad_kg", f.mass.middle_pad_kg),
        ("mass.end_pad_kg", f.mass.end_pad_kg),
        ("mass.gripper_kg", f.mass.gripper_kg),
        ("mass.payload_max_kg", f.mass.payload_max_kg),
        ("springs.rate_n_m", springs.rate_n_m),
        ("segment.axial_stiffness_n_m", f.segment.axial_stiffness_n_m),
    ];
    let cores = f.segments.iter().filter_map(|s| s.axial_stiffness_n_m);
    let cores = cores.map(|v| ("segments.axial_stiffness_n_m", v));
    for (key, value) in not_negative.into_iter().chain(cores) {
        if !(0.0..=LARGEST).contains(&value) {
            return Err(RobotError::Value {
                key,
                value: value.to_string(),
                must: "0 or more, at most a million",
            });
        }
    }
    let numbers = [
        ("base.bellows_angles_deg", &f.base.bellows_angles_deg[..]),
        ("springs.pair_angles_deg", &springs.pair_angles_deg),
        ("springs.half_spread_deg", &[springs.half_spread_deg]),
        ("bellows.outer_diameter_mm", &[f.bellows.outer_diameter_mm]),
        ("bellows.inner_diameter_mm", &[f.bellows.inner_diameter_mm]),
        ("mass.gripper_com_mm", &[f.mass.gripper_com_mm]),
        ("mass.payload_com_mm", &[f.mass.payload_com_mm]),
    ];
    let places = f
        .chambers
        .iter()
        .filter_map(|c| Some(("chambers.at_mm", &c.at_mm.as_ref()?[..])));
    let bodies = [
        &f.tracked_bodies.base,
        &f.tracked_bodies.middle,
        &f.tracked_bodies.end,
    ];
    let bodies = bodies.into_iter().flatten();
    let bodies = bodies.flat_map(|b| {
        [
            ("tracked_bodies.xyz_mm", &b.xyz_mm[..]),
            ("tracked_bodies.ypr_deg", &b.ypr_deg[..]),
        ]
    });
    let mountings = f
        .imus
        .iter()
        .map(|i| ("imus.mounting_ypr_deg", &i.mounting_ypr_deg[..]));
    for (key, values) in numbers
        .into_iter()
        .chain(mountings)
        .chain(places)
        .chain(bodies)
    {
        if !values.iter().all(|x| x.abs() <= LARGEST) {
            return Err(RobotError::Value {
                key,
                value: format!("{values:?}"),
                must: "a number, at most a million",
            });
        }
    }
    for b in &f.keep_out {
        let is_number = b
            .point_mm
            .iter()
            .chain(&b.outward)
            .all(|x| x.abs() <= LARGEST);
        if !is_number || b.outward.iter().map(|x| x * x).sum::<f64>() < 1e-12 {
            return Err(RobotError::Value {
                key: "keep_out",
                value: format!("point_mm {:?}, outward {:?}", b.point_mm, b.outward),
                must: "a point, and a direction that is not zero",
            });
        }
    }
    let ranges = [
        ("pressure.range_kpa", f.pressure.range_kpa),
        ("bellows.length_range_mm", f.bellows.length_range_mm),
        ("springs.range_mm", springs.range_mm),
    ];
    for (key, [lo, hi]) in ranges {
        if !(lo.is_finite() && hi.is_finite() && lo < hi) {
            return Err(RobotError::Value {
                key,
                value: format!("[{lo}, {hi}]"),
                must: "a low and a high value, in this order",
            });
        }
    }
    // What this kind of arm can be: another unit gives numbers beyond it.
    let within = [
        (
            "pressure.range_kpa",
            f.pressure.range_kpa,
            if f.springs.is_some() {
                PRESSURE_RANGE_KPA
            } else {
                PRESSURE_OTHERS_KPA
            },
            match f.springs.is_some() {
                true => "within -40 to 40 kPa",
                false => "within -100 to 2000 kPa",
            },
        ),
        (
            "springs.range_mm",
            springs.range_mm,
            SPRING_RANGE_MM,
            "within 70 to 240 mm",
        ),
    ];
    for (key, [lo, hi], [lowest, highest], must) in within {
        if lo < lowest || hi > highest {
            return Err(RobotError::Value {
                key,
                value: format!("[{lo}, {hi}]"),
                must,
            });
        }
    }
    let over = f.pressure.over_pressure_kpa;
    let [lowest, highest] = f.pressure.range_kpa;
    if !over.is_finite() || over < highest || -over > lowest {
        return Err(RobotError::Value {
            key: "pressure.over_pressure_kpa",
            value: over.to_string(),
            must: "at or beyond both ends of pressure.range_kpa, since it bounds either sign",
        });
    }
    if !(f.imus.is_empty() || f.imus.len() == crate::signal::IMUS) {
        return Err(RobotError::Value {
            key: "imus",
            value: format!("{} tables", f.imus.len()),
            must: "four [[imus]] tables, or none",
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::SPRINGS;

    use crate::robot::REFERENCE;

    /// A file in which one text stands for another is refused with these words.
    fn refused(text: &str, (from, to): (&str, &str), says: &str) {
        let bad = text.replacen(from, to, 1);
        assert_ne!(bad, text, "{from}");
        let e = RobotSpec::from_toml(&bad).expect_err(to).to_string();
        assert!(e.contains(says), "{e}");
    }

    #[test]
    fn reference_robot_has_the_geometry_of_its_description() {
        let r = RobotSpec::reference();
        // X-pair spring at rest: 145 mm down, 2 · 75 · sin 20° across.
        for i in 0..SPRINGS {
            let span = r.spring_bottom_m[i] - r.spring_top_m[i] - Vector3::z() * r.rest_length_m;
            assert!(
                (span.norm() - 0.153_80).abs() < 1e-4,
                "spring {i}: {}",
                span.norm()
            );
        }
        // Spring A of pair 1 starts at 40° on top and ends at 80° below.
        let top = r.spring_top_m[0];
        assert!((top.y.atan2(top.x).to_degrees() - 40.0).abs() < 1e-9);
        assert!((r.area_m2[0] - 53.46e-4).abs() < 1e-6);
        assert!((r.pressure.max_pa * r.area_m2[0] / r.axial_stiffness_n_m[0] - 0.075).abs() < 1e-4);
    }

    /// Every key of the file is read.
    #[test]
    fn a_list_that_is_too_long_is_refused_at_its_place() {
        for (key, list, wanted) in [
            (
                "bellows_angles_deg",
                "[60, 180, 300, 0, 120, 240, 30, 90]",
                "6 values are needed here, not 8",
            ),
            (
                "bellows_angles_deg",
                "[60, 180, 300, 0, 120]",
                "6 values are needed here, not 5",
            ),
            ("pair_angles_deg", "[60, 180, 300, 0]", "3 values"),
            ("range_kpa", "[-40, 40, 42]", "2 values"),
            ("length_range_mm", "[60, 200, 210]", "2 values"),
            ("range_mm", "[70, 240, 250]", "2 values"),
            ("mounting_ypr_deg", "[0, 0, 0, 0]", "3 values"),
        ] {
            let lines: Vec<&str> = REFERENCE.lines().collect();
            let is_it = |l: &&str| l.split('=').next().is_some_and(|k| k.trim() == key);
            let line = lines.iter().position(is_it).expect(key);
            let mut bad: Vec<String> = lines.iter().map(|l| (*l).to_owned()).collect();
            bad[line] = format!("{key} = {list}");
            let e = RobotSpec::from_toml(&bad.join("\n"))
                .expect_err(key)
                .to_string();
            let place = format!("line {}, column {}", line + 1, key.len() + 4);
            assert!(e.contains(&place) && e.contains(wanted), "{key}: {e}");
        }
    }

    #[test]
    fn refusals_name_the_key_or_the_line() {
        let bad = REFERENCE.replace("axial_stiffness_n_m = 2851.0", "axial_stiffness_n_m = -1.0");
        let e = RobotSpec::from_toml(&bad)
            .expect_err("negative stiffness")
            .to_string();
        assert!(
            e.contains("bellows.axial_stiffness_n_m") && e.contains("greater than 0"),
            "{e}"
        );
        let bad = REFERENCE.replace("over_pressure_kpa = 42.0", "over_pressure_kpa = 39.0");
        let e = RobotSpec::from_toml(&bad).expect_err("too low").to_string();
        assert!(e.contains("pressure.over_pressure_kpa"), "{e}");
        // The bound holds for either sign.
        let bad = REFERENCE
            .replace("range_kpa = [-40.0, 40.0]", "range_kpa = [-40.0, 20.0]")
            .replace("over_pressure_kpa = 42.0", "over_pressure_kpa = 25.0");
        let e = RobotSpec::from_toml(&bad).expect_err("trips").to_string();
        assert!(
            e.contains("pressure.over_pressure_kpa") && e.contains("either sign"),
            "{e}"
        );
        let bad = REFERENCE.replace("rest_length_mm = 145.0", "rest_length_mm = 0.145");
        let e = RobotSpec::from_toml(&bad).expect_err("metres").to_string();
        assert!(
            e.contains("bellows.rest_length_mm = 0.145, which looks like metres")
                && e.contains("write 145"),
            "{e}"
        );
        let bad = REFERENCE.replace("rate_kpa_s = 12.0", "rate_kpa_s = ");
        let e = RobotSpec::from_toml(&bad).expect_err("syntax").to_string();
        assert!(e.contains("line"), "{e}");
        let bad = REFERENCE.replace("name = \"reference\"", "name = \"reference\"\ncolour = 3");
        let e = RobotSpec::from_toml(&bad)
            .expect_err("unknown key")
            .to_string();
        assert!(e.contains("colour"), "{e}");
        for (from, to, says) in [
            (
                "range_kpa = [-40.0, 40.0]",
                "range_kpa = [-40000.0, 40000.0]",
                "within -40 to 40 kPa",
            ),
            (
                "half_spread_deg = ",
                "half_spread_deg = inf # ",
                "springs.half_spread_deg",
            ),
            (
                "range_mm = [70.0, 240.0]",
                "range_mm = [0.07, 0.24]",
                "within 70 to 240 mm",
            ),
        ] {
            refused(REFERENCE, (from, to), says);
        }
    }

    #[test]
    fn a_segment_may_have_stiffnesses_of_its_own_a_core_or_be_locked() {
        let plain = RobotSpec::reference();
        let text = format!(
            "{REFERENCE}\n[[segments]]\nlocked = true\n[[segments]]\nbending_stiffness_nm_rad = 3.5\naxial_stiffness_n_m = 500.0\n"
        );
        let r = RobotSpec::from_toml(&text).expect("reads");
        let (before, [first, second]) = (plain.segments[0], r.segments);
        assert_eq!(first.bending_nm_rad, 1e3 * before.bending_nm_rad);
        assert_eq!(r.axial_stiffness_n_m[0], 1e3 * plain.axial_stiffness_n_m[0]);
        assert_eq!(r.axial_stiffness_n_m[3], plain.axial_stiffness_n_m[3]);
        assert_eq!(
            (
                second.bending_nm_rad,
                second.axial_n_m,
                second.torsional_nm_rad
            ),
            (3.5, 500.0, before.torsional_nm_rad)
        );
        assert_eq!(plain.segments[1].axial_n_m, 0.0);
        for (from, to, says) in [
            ("locked = true", "locked = 1", "boolean"),
            (
                "[[segments]]\nlocked = true\n",
                "",
                "two [[segments]] tables",
            ),
            ("= 3.5", "= 0.0", "segments.bending_stiffness_nm_rad"),
            ("= 500.0", "= -1.0", "segments.axial_stiffness_n_m"),
        ] {
            refused(&text, (from, to), says);
        }
    }

    #[test]
    fn an_arm_of_another_lab_has_chambers_of_its_own_and_no_sensors() {
        let text = include_str!("../../assets/robots/asu-arm.toml");
        let r = RobotSpec::from_toml(text).expect("reads");
        assert!(!r.has_springs && !r.has_imus && r.spring.rate_n_m == 0.0);
        assert_eq!(r.bellows_m[4], Vector3::new(0.048, 0.0, 0.0));
        assert!((r.area_m2[2] - 2.0 * r.area_m2[0]).abs() < 1e-6);
        assert_eq!(r.axial_stiffness_n_m[5], 6600.0);
        assert_eq!(r.bodies[2].translation.vector.z, 5e-3);
        assert_eq!(r.uncertainty.repeat_m, 1e-3);
        assert!(
            r.why_not_driven()
                .is_some_and(|why| why.contains("no springs"))
        );
        assert_eq!(RobotSpec::reference().why_not_driven(), None);
        for (from, to, says) in [
            ("area_mm2 = 3000.0", "area_mm2 = 0.0", "chambers.area_mm2"),
            (
                "[[chambers]]\nat_mm = [-48.0, 0.0]\n",
                "",
                "six [[chambers]] tables",
            ),
            ("area = 0.5", "area = -1.0", "uncertainty.area"),
            ("body_mm = 10.0", "body_m = 0.01", "body_m"),
            (
                "xyz_mm = [0.0, 0.0, 5.0]",
                "xyz_mm = [0.0, 5.0]",
                "3 values",
            ),
        ] {
            refused(text, (from, to), says);
        }
    }
}
