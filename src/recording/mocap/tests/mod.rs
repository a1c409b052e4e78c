//! Which format a file is of, hostile files, and what the tests of each format share.

mod body;
mod c3d;
mod motive;
mod vicon;

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use self::body::names;
use self::c3d::{INTEL, Made};
use self::motive::motive_text;
use self::vicon::{ANGLES, MARKERS, SEGMENT, segments, tracker};
use super::*;
use crate::recording::RecordingError;
use crate::signal::Pose;

fn read_vicon(text: &str) -> Result<MocapFile, RecordingError> {
    super::vicon::parse(text.as_bytes(), Path::new("v.csv"), None)
}

fn read_motive(text: &str) -> Result<MocapFile, RecordingError> {
    super::motive::parse(text.as_bytes(), Path::new("m.csv"))
}

/// R = 1 + sin θ K + (1 − cos θ) K², K the cross product with the axis (Rodrigues).
fn rodrigues(v_rad: [f64; 3]) -> Matrix3<f64> {
    let angle = (v_rad[0].powi(2) + v_rad[1].powi(2) + v_rad[2].powi(2)).sqrt();
    let [x, y, z] = v_rad.map(|c| c / angle);
    let k = Matrix3::new(0.0, -z, y, z, 0.0, -x, -y, x, 0.0);
    Matrix3::identity() + k * angle.sin() + k * k * (1.0 - angle.cos())
}

fn about(axis: usize, a: f64) -> Matrix3<f64> {
    let (s, c) = a.sin_cos();
    match axis {
        0 => Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c),
        1 => Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c),
        _ => Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0),
    }
}

/// Largest difference of the entries of a pose's rotation matrix.
fn off(pose: &Pose, matrix: Matrix3<f64>) -> f64 {
    (Rotation3::from(pose.rotation).into_inner() - matrix).amax()
}

#[test]
fn files_are_told_by_what_they_hold() {
    let dir = std::env::temp_dir().join(format!("springtwin-mocap-{}", std::process::id()));
    std::fs::create_dir_all(&dir).unwrap();
    let read = |bytes: &[u8]| {
        let path = dir.join("capture.txt");
        std::fs::write(&path, bytes).unwrap();
        read_mocap(&path, None)
    };
    assert_eq!(
        read(MARKERS.as_bytes()).unwrap().format,
        MocapFormat::ViconTrajectories
    );
    assert_eq!(
        read(motive_text().as_bytes()).unwrap().format,
        MocapFormat::Motive
    );
    assert_eq!(read(&INTEL.bytes()).unwrap().format, MocapFormat::C3d);
    let others: [&[u8]; 5] = [
        b"",
        b"t_s,p1_kpa\n0,1\n",
        b"\x89PNG\r\n\x1a\n\0\0",
        b"\xff\xfeF\0r\0",
        b"{\"a\": 1}",
    ];
    for other in others {
        let e = read(other).unwrap_err().to_string();
        assert!(
            e.contains("expected a Vicon CSV") && e.contains("C3D"),
            "{e}"
        );
    }
    let e = read(MARKERS.replace(',', ";").as_bytes())
        .unwrap_err()
        .to_string();
    assert!(e.contains("semicolons"), "{e}");
    assert!(
        read_mocap(&dir, None)
            .unwrap_err()
            .to_string()
            .contains("no file")
    );
    let told = dir.join("capture.txt");
    std::fs::write(&told, segments("deg", SEGMENT)).unwrap();
    let e = read_mocap(&told, Some(MocapRotation::EULER_XYZ))
        .unwrap_err()
        .to_string();
    assert!(e.contains("helical, not as euler-xyz"), "{e}");
    std::fs::remove_dir_all(&dir).unwrap();
}

/// Everything a file that was read must keep to, whatever its bytes were.
fn check(file: &MocapFile, bytes: usize) {
    let n = file.frames.len();
    assert!(n > 0 && file.t_s.len() == n);
    assert!(file.frames.windows(2).all(|w| w[0] < w[1]));
    assert!(file.t_s.iter().all(|t| t.is_finite()));
    let series = file.markers.len() + file.objects.len();
    assert!(series > 0 && n * series <= bytes + (1 << 20));
    for m in &file.markers {
        assert_eq!(m.positions_m.len(), n);
        assert!(
            m.positions_m
                .iter()
                .flatten()
                .all(|p| p.iter().all(|x| x.is_finite()))
        );
    }
    for o in &file.objects {
        assert_eq!(o.poses.len(), n);
        for p in o.poses.iter().flatten() {
            assert!((p.rotation.norm() - 1.0).abs() < 1e-9);
            assert!(p.translation.vector.iter().all(|x| x.is_finite()));
        }
    }
}

#[test]
fn long_headers_over_empty_lines_do_not_fill_the_memory() {
    let n = 100_000;
    let mut text = "Trajectories\n100\n,".to_owned();
    (0..n).for_each(|i| text.push_str(&format!(",a:{i},,")));
    text.push_str("\nFrame,Sub Frame");
    (0..n).for_each(|_| text.push_str(",X,Y,Z"));
    text.push_str("\n,");
    (0..n).for_each(|_| text.push_str(",mm,mm,mm"));
    text.push('\n');
    (0..1000).for_each(|i| text.push_str(&format!("{i}\n")));
    let e = read_vicon(&text).unwrap_err().to_string();
    assert!(e.contains("far more columns"), "{e}");
}

proptest! {
    #[test]
    fn broken_tables_are_refused_or_sound(
        which in 0..5usize,
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4u8), 1..6),
        cut in any::<prop::sample::Index>(),
        keep in any::<bool>(),
    ) {
        let text = match which {
            0 => MARKERS.to_owned(),
            1 => segments("deg", SEGMENT),
            2 => tracker("Global Angle a:b", "RX,RY,RZ,RW,TX,TY,TZ", ",,,,mm,mm,mm", "0,0,0,1,1,1,1"),
            3 => motive_text(),
            _ => format!("{MARKERS}\n{}", segments("rad", [0.1, 0.2, 0.3]).replace("200", "100")),
        };
        let mut bytes = text.into_bytes();
        for (at, byte, kind) in edits {
            let i = at.index(bytes.len());
            match kind {
                0 => bytes[i] = byte,
                1 => bytes[i] = b"0129,.\n-eE\"X"[usize::from(byte) % 12],
                2 => bytes.insert(i, b",\n\"19eE-"[usize::from(byte) % 8]),
                _ => { bytes.remove(i); }
            }
        }
        if !keep {
            bytes.truncate(cut.index(bytes.len()));
        }
        let path = Path::new("x");
        for wanted in [None, Some(MocapRotation::EULER_XYZ)] {
            if let Ok(f) = super::vicon::parse(bytes.as_slice(), path, wanted) {
                check(&f, bytes.len());
                let _ = marker_body(&f, "b", &names(&f));
            }
        }
        if let Ok(f) = super::motive::parse(bytes.as_slice(), path) {
            check(&f, bytes.len());
        }
        let _ = super::vicon::refuse_others(bytes.as_slice(), path);
    }

    #[test]
    fn broken_c3d_is_refused_or_sound(
        order in 84..=86u8,
        is_float in any::<bool>(),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), any::<bool>()), 1..12),
        cut in any::<prop::sample::Index>(),
        keep in any::<bool>(),
    ) {
        let scale = if is_float { -0.1 } else { 0.5 };
        let mut bytes = Made { order, scale, trial: Some([11, 0, 13, 0]), header: [11, 13] }.bytes();
        for (at, byte, in_head) in edits {
            // Most of the sense is in the header and the parameters.
            let end = if in_head { 900 } else { bytes.len() };
            let i = at.index(end);
            bytes[i] = byte;
        }
        if !keep {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(f) = super::c3d::parse(&bytes, Path::new("x")) {
            check(&f, bytes.len());
            let _ = marker_body(&f, "b", &names(&f));
        }
    }

    #[test]
    fn any_bytes_are_refused_or_sound(bytes in prop::collection::vec(any::<u8>(), 0..1500)) {
        let path = Path::new("x");
        let _ = super::vicon::parse(bytes.as_slice(), path, None);
        let _ = super::motive::parse(bytes.as_slice(), path);
        let _ = super::c3d::parse(&bytes, path);
        let _ = super::c3d::is_c3d(&bytes);
    }
}

#[test]
fn exports_of_every_tenth_frame_have_no_gaps_of_nine() {
    let file = |frames: &[i64]| {
        let mut file = MocapFile::new(Path::new("x.csv"), MocapFormat::ViconSegments);
        file.frames = frames.to_vec();
        file
    };
    let usual_step = |frames: &[i64]| file(frames).usual_step();
    assert_eq!(usual_step(&[1]), 1);
    assert_eq!(usual_step(&[1, 11, 21, 41]), 10);
    assert_eq!(usual_step(&[11, 12, 15]), 1);
    assert_eq!(usual_step(&[11, 12, 150]), 138);
    let object = |n: usize| MocapObject {
        name: "pad".into(),
        poses: vec![Some(Pose::identity()); n],
    };
    assert_eq!(file(&[1, 11, 21, 31]).gaps(&object(4)), 0);
    assert_eq!(file(&[1, 11, 21, 41, 51]).gaps(&object(5)), 1);
    assert_eq!(file(&[1, 2, 5, 6]).gaps(&object(4)), 2);
}
