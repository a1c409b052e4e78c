//! Conformance suite of the two simulators.

use std::f64::consts::TAU;
use std::sync::LazyLock;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::mesh::{MeshModel, MeshState, observe_mesh, settle_mesh};
use super::validate::{REFERENCE_POSES, SettledPose};
use super::{Inputs, Model, Observation, SimError, State, observe, settle};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose, ypr_from_rotation};

static ROBOT: LazyLock<RobotSpec> = LazyLock::new(RobotSpec::reference);
static ROD: LazyLock<Model> = LazyLock::new(|| Model::nominal(&ROBOT));
static MESH: LazyLock<MeshModel> = LazyLock::new(|| MeshModel::new(&ROBOT).expect("meshes"));

/// A simulator: settled from rest.
type Simulator = fn(&Inputs) -> Result<Observation, SimError>;

fn rod(inputs: &Inputs) -> Result<Observation, SimError> {
    let mut state = State::rest(&ROD);
    settle(&ROD, &mut state, inputs)?;
    Ok(observe(&ROD, &state))
}

fn mesh(inputs: &Inputs) -> Result<Observation, SimError> {
    let mut state = MeshState::rest(&MESH);
    settle_mesh(&MESH, &mut state, inputs)?;
    Ok(observe_mesh(&MESH, &state))
}

fn at(kpa: [f64; CHAMBERS]) -> Inputs {
    Inputs {
        chamber_pa: kpa.map(|p| p * 1e3),
        ..Inputs::default()
    }
}

fn solved(simulator: Simulator, inputs: &Inputs) -> Observation {
    simulator(inputs).expect("settles")
}

fn millimetres(a: &Pose, b: &Pose) -> f64 {
    (a.translation.vector - b.translation.vector).norm() * 1e3
}

fn degrees(a: &Pose, b: &Pose) -> f64 {
    a.rotation.angle_to(&b.rotation).to_degrees()
}

/// Six pressures, kPa, that bend both segments differently.
const BENT: [f64; CHAMBERS] = [25.0, -10.0, -30.0, 5.0, 30.0, -20.0];

fn equal_pressures_extend_straight(simulator: Simulator) {
    let mut before = 0.0;
    for kpa in [-40.0, -20.0, 0.0, 20.0, 40.0] {
        let o = solved(simulator, &at([kpa; CHAMBERS]));
        let p = o.base_from_tip.translation.vector;
        assert!(p.xy().norm() < 1e-6, "{kpa} kPa: {p:?}");
        assert!(o.base_from_tip.rotation.angle() < 1e-5, "{kpa} kPa turns");
        assert!(-p.z > before + 0.05, "{kpa} kPa is not longer: {p:?}");
        before = -p.z;
        for segment in o.bellows_m.chunks(3) {
            assert!((segment[0] - segment[1]).abs() + (segment[1] - segment[2]).abs() < 1e-6);
        }
        let straight: f64 = o.bellows_m[0] + o.bellows_m[3] + ROBOT.pad_thickness_m;
        assert!((straight + p.z).abs() < 1e-6, "{straight} {p:?}");
    }
}

fn one_chamber_lengthens_with_its_pressure(simulator: Simulator) {
    let mut before = 0.0;
    for kpa in [-40.0, -15.0, 15.0, 40.0] {
        let mut p = BENT;
        p[1] = kpa;
        let length = solved(simulator, &at(p)).bellows_m[1];
        assert!(length > before + 5e-3, "{kpa} kPa: {length} after {before}");
        before = length;
    }
}

fn a_third_of_a_turn_turns_the_pose(simulator: Simulator) {
    let one = solved(simulator, &at(BENT)).base_from_tip;
    let p = BENT;
    let two = solved(simulator, &at([p[2], p[0], p[1], p[5], p[3], p[4]])).base_from_tip;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), TAU / 3.0);
    let turn = Isometry3::from_parts(Translation3::identity(), turn);
    let turned = turn * one * turn.inverse();
    assert!(millimetres(&turned, &two) < 0.05, "{turned} {two}");
    assert!(degrees(&turned, &two) < 0.05, "{turned} {two}");
}

fn payload_lowers_the_tip(simulator: Simulator) {
    for kpa in [[0.0; CHAMBERS], BENT] {
        let z = |payload_kg: f64| {
            let inputs = Inputs {
                payload_kg,
                ..at(kpa)
            };
            solved(simulator, &inputs).base_from_tip.translation.z
        };
        let (none, some, more) = (z(0.0), z(0.25), z(0.5));
        assert!(
            some < none - 1e-4 && more < some - 1e-4,
            "{none} {some} {more}"
        );
    }
    // The two segments in series carry it on three bellows each, springs aside.
    let stretch = |payload_kg: f64| {
        let inputs = Inputs {
            payload_kg,
            ..Inputs::default()
        };
        solved(simulator, &inputs).base_from_tip.translation.z
    };
    let by_hand = 2.0 * 0.5 * 9.806_65 / (3.0 * ROBOT.axial_stiffness_n_m[0]);
    let sunk = stretch(0.0) - stretch(0.5);
    assert!(sunk < by_hand && sunk > 0.9 * by_hand, "{sunk} {by_hand}");
}

fn a_push_moves_the_tip_its_way(simulator: Simulator) {
    let tip = |y: f64| {
        let inputs = Inputs {
            tip_force_n: [0.0, y, 0.0],
            ..Inputs::default()
        };
        solved(simulator, &inputs).base_from_tip.translation.vector
    };
    let (left, right) = (tip(-3.0), tip(3.0));
    assert!(right.y > 5e-3 && left.y < -5e-3, "{left:?} {right:?}");
    // The arm is its own mirror image in the plane of x and z.
    let mirrored = Vector3::new(left.x, -left.y, left.z);
    assert!((mirrored - right).norm() < 5e-5, "{left:?} {right:?}");
}

fn springs_span_the_pads(simulator: Simulator) {
    let o = solved(simulator, &at(BENT));
    let pads = &o.shape.base_from_pad;
    let down = Translation3::new(0.0, 0.0, -ROBOT.pad_thickness_m);
    let above = [pads[0], pads[1] * down];
    for (i, length) in o.sensors.spring_m.iter().enumerate() {
        let upper = above[i / 6] * nalgebra::Point3::from(ROBOT.spring_top_m[i]);
        let lower = pads[1 + i / 6] * nalgebra::Point3::from(ROBOT.spring_bottom_m[i]);
        assert!(((lower - upper).norm() - length).abs() < 1e-9, "spring {i}");
        let [a, b] = o.shape.spring_ends_m[i].map(nalgebra::Point3::from);
        assert!((a - upper).norm() + (b - lower).norm() < 1e-9, "spring {i}");
    }
    assert_eq!(pads[2], o.base_from_tip);
    let want = ypr_from_rotation(&pads[2].rotation);
    assert_eq!(o.sensors.imu_ypr_rad[3], want);
    for (segment, ends) in [(0, [above[0], pads[1]]), (1, [above[1], pads[2]])] {
        let sections = &o.shape.base_from_section[segment];
        for (got, want) in [(sections.first(), ends[0]), (sections.last(), ends[1])] {
            let got = got.expect("has sections");
            assert!(millimetres(got, &want) < 1e-6 && degrees(got, &want) < 1e-4);
        }
    }
}

fn same_inputs_give_same_bits(simulator: Simulator) {
    let inputs = at(BENT);
    assert_eq!(solved(simulator, &inputs), solved(simulator, &inputs));
}

/// The poses of an independent engine, as near as each simulator comes to them.
fn takes_the_known_poses(simulator: Simulator, within: impl Fn(&SettledPose) -> (f64, f64)) {
    for pose in REFERENCE_POSES {
        let tip = solved(simulator, &at(pose.kpa)).base_from_tip;
        let off_mm = (tip.translation.vector * 1e3 - Vector3::from(pose.mm)).norm();
        let angles = ypr_from_rotation(&tip.rotation);
        let angles = angles.iter().zip(pose.ypr_deg);
        let off_deg = angles.map(|(got, want)| (got.to_degrees() - want).abs());
        let off_deg = off_deg.fold(0.0, f64::max);
        println!("{:?} kPa: {off_mm:.2} mm, {off_deg:.2} deg off", pose.kpa);
        let (mm, deg) = within(&pose);
        assert!(off_mm <= mm && off_deg <= deg, "{off_mm} mm, {off_deg} deg");
    }
}

fn an_infinite_input_is_refused(simulator: Simulator) {
    let inputs = at([0.0, f64::INFINITY, 0.0, 0.0, 0.0, 0.0]);
    assert!(matches!(
        simulator(&inputs),
        Err(SimError::NotFinite { .. })
    ));
}

macro_rules! both {
    ($($check:ident),* $(,)?) => {
        mod rod_model {
            $(#[test] fn $check() { super::$check(super::rod); })*
        }
        mod mesh_model {
            $(#[test] fn $check() { super::$check(super::mesh); })*
        }
    };
}

both!(
    equal_pressures_extend_straight,
    one_chamber_lengthens_with_its_pressure,
    a_third_of_a_turn_turns_the_pose,
    payload_lowers_the_tip,
    a_push_moves_the_tip_its_way,
    springs_span_the_pads,
    same_inputs_give_same_bits,
    an_infinite_input_is_refused,
);

#[test]
fn the_rod_takes_the_known_poses() {
    takes_the_known_poses(rod, |pose| pose.rod_within);
}

#[test]
fn the_mesh_takes_the_known_poses() {
    takes_the_known_poses(mesh, |pose| pose.mesh_within);
}

/// Both models describe one robot. They share axial stiffness and one calibrated bend; the mesh gives
/// way in shear and in the course of every single bellows, which the rod does not.
#[test]
fn the_two_agree() {
    for (kpa, mm, deg) in [
        ([0.0; 6], 0.05, 0.05),
        ([40.0; 6], 0.05, 0.05),
        ([-40.0; 6], 0.05, 0.05),
        ([20.0, -20.0, -20.0, 20.0, -20.0, -20.0], 2.0, 0.3),
        (BENT, 2.0, 0.5),
        ([40.0, -40.0, -40.0, 0.0, 0.0, 0.0], 4.0, 1.0),
        ([40.0, -40.0, -40.0, -40.0, 40.0, 40.0], 5.0, 1.5),
        ([40.0, 40.0, -40.0, 40.0, 40.0, -40.0], 5.0, 1.5),
    ] {
        let (r, m) = (solved(rod, &at(kpa)), solved(mesh, &at(kpa)));
        let apart = millimetres(&r.base_from_tip, &m.base_from_tip);
        let turned = degrees(&r.base_from_tip, &m.base_from_tip);
        println!("{kpa:?}: {apart:.2} mm, {turned:.2} deg");
        assert!(
            apart < mm && turned < deg,
            "{kpa:?}: {apart} mm, {turned} deg"
        );
        for i in 0..12 {
            let d = (r.sensors.spring_m[i] - m.sensors.spring_m[i]).abs() * 1e3;
            assert!(d < mm, "{kpa:?}: spring {} differs by {d} mm", i + 1);
        }
    }
}
