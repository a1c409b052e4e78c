//! Motive's tables.

use super::*;

const MOTIVE: &str = "Format Version,1.23,Take Name,\"a, b\",Capture Frame Rate,240.000000,Export Frame Rate,120.000000,\
    Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global\n\n\
    ,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,\
    Rigid Body Marker,Rigid Body Marker,Rigid Body Marker,Rigid Body Marker,Marker,Marker,Marker\n\
    ,Name,pad,pad,pad,pad,pad,pad,pad,pad,pad:Marker1,pad:Marker1,pad:Marker1,pad:Marker1,pad:Marker2,pad:Marker2,pad:Marker2\n\
    ,ID,\"A:1\",\"A:1\",\"A:1\",\"A:1\",\"A:1\",\"A:1\",\"A:1\",\"A:1\",1,1,1,1,2,2,2\n\
    ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position,Position,Position,Marker Quality,Position,Position,Position\n\
    Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,,X,Y,Z\n\
    30,0.250000,QX,QY,QZ,QW,0.1,1.2,-0.3,0.0002,0.1,0.2,0.3,0.9,1,2,3\n\
    31,0.258333,,,,,,,,,,,,,1,2,3\n\
    33,0.275000,0,0,0,1,0.1,1.2,-0.3,0.0002,0.1,0.2,0.3,0.9,,,\n";

pub(super) fn motive_text() -> String {
    let q = UnitQuaternion::from_scaled_axis(Vector3::from(ANGLES));
    MOTIVE
        .replace("QX", &q.i.to_string())
        .replace("QY", &q.j.to_string())
        .replace("QZ", &q.k.to_string())
        .replace("QW", &q.w.to_string())
}

#[test]
fn motive_has_bodies_and_markers() {
    let f = read_motive(&motive_text()).unwrap();
    assert_eq!(f.format, MocapFormat::Motive);
    assert_eq!((f.rate_hz, f.first_frame, f.up), (120.0, 30, Some('y')));
    assert_eq!(
        (f.units.as_str(), f.rotation),
        ("m", Some(MocapRotation::Quaternion))
    );
    assert_eq!(f.frames, [30, 31, 33]);
    assert!((f.t_s[2] - 0.025).abs() < 1e-12);
    assert_eq!(f.objects.len(), 1);
    let pose = f.objects[0].poses[0].unwrap();
    assert!(off(&pose, rodrigues(ANGLES)) < 1e-12);
    assert_eq!(pose.translation.vector, Vector3::new(0.1, 1.2, -0.3));
    assert_eq!(f.gaps(&f.objects[0]), 2);
    let names: Vec<_> = f.markers.iter().map(|m| m.name.as_str()).collect();
    assert_eq!(names, ["pad:Marker1", "pad:Marker2"]);
    assert!(f.markers[0].positions_m[1].is_none() && f.markers[1].positions_m[2].is_none());
    let notes = f.notes.join("; ");
    assert!(
        notes.contains("y axis points up") && notes.contains("1 markers stand where"),
        "{notes}"
    );
    // A measured marker goes before the solved one of its name.
    let f = read_motive(&motive_text().replace("pad:Marker2", "pad:Marker1")).unwrap();
    assert_eq!(f.markers.len(), 1);
    assert_eq!(
        f.markers[0].positions_m[0],
        Some(Vector3::new(1.0, 2.0, 3.0))
    );
}

#[test]
fn motive_may_write_euler_angles_and_other_units() {
    let text = "\u{feff}Format Version,1.22,Export Frame Rate,100,Rotation Type,YXZ,Length Units,Millimeters\r\n,,,\r\n\
        ,,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Bone\r\n,,pad,pad,pad,pad,pad,pad,s:hip\r\n\
        ,,1,1,1,1,1,1,2\r\n,,Rotation,Rotation,Rotation,Position,Position,Position,Rotation\r\n\
        Frame,Time (Seconds),Y,X,Z,X,Y,Z,X\r\n0,0.0,40,-20,10,100,200,300,1\r\n";
    let f = read_motive(text).unwrap();
    assert_eq!(f.rotation, Some(MocapRotation::Euler([1, 0, 2])));
    assert_eq!(f.rotation.unwrap().name(), "euler-yxz");
    assert_eq!(f.units, "mm, deg");
    let [y, x, z] = [40.0f64, -20.0, 10.0].map(f64::to_radians);
    let pose = f.objects[0].poses[0].unwrap();
    assert!(off(&pose, about(1, y) * about(0, x) * about(2, z)) < 1e-12);
    assert!((pose.translation.vector - Vector3::new(0.1, 0.2, 0.3)).norm() < 1e-12);
    assert!(f.notes.iter().any(|n| n.contains("Bone")));
}

#[test]
fn motive_refusals_say_what_to_do() {
    let e = |from: &str, to: &str| {
        read_motive(&motive_text().replacen(from, to, 1))
            .unwrap_err()
            .to_string()
    };
    assert!(e("1.23", "1.1").contains("line 1, column 2: format version"));
    assert!(e("Meters", "Furlongs").contains("line 1, column 12"));
    assert!(e("Quaternion", "Matrix").contains("line 1, column 10"));
    assert!(e("Quaternion", "XYZ").contains("do not fit the rotation type euler-xyz"));
    assert!(e("Global", "Local").contains("Coordinate Space Global"));
    assert!(e("31,0.258333", "31,0.283333").contains("line 9, column 2"));
    assert!(e("31,0", "29,0").contains("line 9, column 1"));
    assert!(e(",1,0.1,1.2", ",2,0.1,1.2").contains("line 10, column 3"));
}
