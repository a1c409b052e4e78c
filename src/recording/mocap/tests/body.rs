//! Bodies of markers.

use super::*;
use crate::signal::pose_from_ypr;

/// A body of four markers, moved; `shake_m` is added to one of them in the last frame.
fn body_file(poses: &[Pose], shake_m: f64) -> MocapFile {
    let shape = [
        [0.0, 0.0, 0.0],
        [0.1, 0.0, 0.0],
        [0.0, 0.07, 0.0],
        [0.02, 0.03, 0.05],
    ];
    let mut file = MocapFile::new(Path::new("b.csv"), MocapFormat::ViconTrajectories);
    file.rate_hz = 100.0;
    file.frames = (1..=poses.len() as i64).collect();
    for (i, p) in shape.iter().enumerate() {
        let mut positions_m: Vec<_> = poses
            .iter()
            .map(|pose| Some(pose.rotation * Vector3::from(*p) + pose.translation.vector))
            .collect();
        if let (2, Some(Some(last))) = (i, positions_m.last_mut()) {
            last.x += shake_m;
        }
        file.markers.push(MocapMarker {
            name: format!("box:m{i}"),
            positions_m,
        });
    }
    file.finish().unwrap()
}

pub(super) fn names(file: &MocapFile) -> Vec<String> {
    file.markers.iter().map(|m| m.name.clone()).collect()
}

#[test]
fn a_body_of_markers_follows_them() {
    let moves = [
        pose_from_ypr([0.0; 3], [0.0; 3]),
        pose_from_ypr([0.3, -0.2, 0.1], [2.5, -0.4, 1.1]),
        pose_from_ypr([0.1, 0.2, 0.4], [0.0, 0.0, 3.1]),
        pose_from_ypr([0.1, 0.2, 0.4], [0.2, 0.0, 0.1]),
    ];
    let mut file = body_file(&moves, 0.0);
    // Hidden in the first frame: the second one is the reference.
    file.markers[3].positions_m[0] = None;
    file.markers[0].positions_m[2] = None;
    file.markers[1].positions_m[3] = None;
    file.markers[3].positions_m[3] = None;
    let body = marker_body(&file, "box", &names(&file)).unwrap();
    assert_eq!(body.reference_frame, 2);
    assert!(body.residual_m < 1e-12);
    let poses = &body.object.poses;
    let at = poses[1].unwrap();
    assert!(
        at.rotation.angle() < 1e-9,
        "parallel to the world in the reference frame"
    );
    // Two markers are not enough; three of four are.
    assert!(poses[3].is_none());
    for n in [0, 2] {
        let expected = moves[n] * moves[1].inverse() * at;
        let e = poses[n].unwrap().inverse() * expected;
        assert!(e.translation.vector.norm() < 1e-12 && e.rotation.angle() < 1e-7);
    }
    assert_eq!(body.markers[3].seen, 2);
}

#[test]
fn a_marker_that_is_not_rigid_shows() {
    let still = [pose_from_ypr([0.0; 3], [0.0; 3]); 2];
    let file = body_file(&still, 4e-3);
    let body = marker_body(&file, "box", &names(&file)).unwrap();
    assert!(
        (0.8e-3..2e-3).contains(&body.residual_m),
        "{}",
        body.residual_m
    );
    let worst = body
        .markers
        .iter()
        .max_by(|a, b| a.residual_m.total_cmp(&b.residual_m))
        .unwrap();
    assert_eq!(worst.name, "box:m2");
    let rotation = body.object.poses[1].unwrap().rotation;
    let det = Rotation3::from(rotation).matrix().determinant();
    assert!((det - 1.0).abs() < 1e-12);
}

#[test]
fn markers_that_move_by_themselves_are_no_body() {
    let still = [pose_from_ypr([0.0; 3], [0.0; 3]); 2];
    let file = body_file(&still, 60e-3);
    let e = marker_body(&file, "box", &names(&file)).unwrap_err();
    let e = e.to_string();
    for said in ["no rigid body", "5 mm is the most", "worst: box:m2"] {
        assert!(e.contains(said), "{said}: {e}");
    }
}

#[test]
fn bodies_that_settle_nothing_are_refused() {
    let file = body_file(&[pose_from_ypr([0.0; 3], [0.0; 3])], 0.0);
    let e = |list: &[&str]| {
        let list: Vec<String> = list.iter().map(|s| (*s).to_owned()).collect();
        marker_body(&file, "b", &list).unwrap_err().to_string()
    };
    assert!(e(&["m0", "m1"]).contains("three markers"));
    assert!(e(&["m0", "m1", "m9"]).contains("no marker \"m9\"; it has box:m0"));
    assert!(e(&["m0", "m1", "box:m0"]).contains("named twice"));
    let mut line = file.clone();
    line.markers[2].positions_m[0] = Some(Vector3::new(0.2, 0.0, 0.0005));
    let all: Vec<String> = names(&line)[..3].to_vec();
    let e = marker_body(&line, "b", &all).unwrap_err().to_string();
    assert!(e.contains("in a line"), "{e}");
    line.markers[1].positions_m[0] = None;
    let e = marker_body(&line, "b", &all).unwrap_err().to_string();
    assert!(
        e.contains("no frame shows all") && e.contains("box:m1"),
        "{e}"
    );
}

proptest! {
    #[test]
    fn bodies_move_as_they_were_moved(
        p in [-2.0..2.0, -2.0..2.0, -2.0..2.0f64],
        ypr in [-3.1..3.1, -1.5..1.5, -3.1..3.1f64],
        hidden in 0..5usize,
    ) {
        let moved = pose_from_ypr(p, ypr);
        let mut file = body_file(&[Pose::identity(), moved], 0.0);
        if let Some(m) = file.markers.get_mut(hidden) {
            m.positions_m[1] = None;
        }
        let body = marker_body(&file, "b", &names(&file)).unwrap();
        let start = body.object.poses[0].unwrap();
        let e = body.object.poses[1].unwrap().inverse() * moved * start;
        prop_assert!(e.translation.vector.norm() < 1e-9);
        prop_assert!(e.rotation.angle() < 1e-6);
        prop_assert!(body.residual_m < 1e-9);
    }
}
