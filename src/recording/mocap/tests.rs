//! Small files of every format, hostile ones, and the rotations against formulas written out here.

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::super::RecordingError;
use super::*;
use crate::signal::pose_from_ypr;

fn vicon(text: &str) -> Result<MocapFile, RecordingError> {
    vicon::parse(text.as_bytes(), Path::new("v.csv"), None)
}

fn motive(text: &str) -> Result<MocapFile, RecordingError> {
    motive::parse(text.as_bytes(), Path::new("m.csv"))
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

const SEGMENT: [f64; 3] = [-13.8112, 1.34995, 55.7734];

fn segments(unit: &str, v: [f64; 3]) -> String {
    format!(
        "\u{feff}Segments\r\n200\r\n,,test rig:arm,,,,,,,,\r\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\r\n\
         ,,{unit},{unit},{unit},mm,mm,mm\r\n7,0,{},{},{},128.5,-175.25,492\r\n9,0,,,,,,\r\n\r\n",
        v[0], v[1], v[2]
    )
}

#[test]
fn segments_are_helical_in_the_unit_of_their_row() {
    let f = vicon(&segments("deg", SEGMENT)).unwrap();
    assert_eq!(f.format, MocapFormat::ViconSegments);
    assert_eq!((f.rate_hz, f.first_frame), (200.0, 7));
    assert_eq!(f.frames, [7, 9]);
    assert_eq!(f.t_s, [0.0, 0.01]);
    assert_eq!(f.rotation, Some(MocapRotation::Helical));
    assert_eq!(f.units, "mm, deg");
    assert_eq!(f.objects.len(), 1);
    assert_eq!(f.objects[0].name, "test rig:arm");
    assert_eq!(f.gaps(&f.objects[0]), 2);
    let pose = f.objects[0].poses[0].unwrap();
    let at_m = Vector3::new(0.1285, -0.17525, 0.492);
    assert!((pose.translation.vector - at_m).norm() < 1e-15);
    assert!(off(&pose, rodrigues(SEGMENT.map(f64::to_radians))) < 1e-12);
    // A hundredth of the vector, a hundred times over: not so for Euler angles.
    let part = vicon(&segments("deg", SEGMENT.map(|a| a / 100.0))).unwrap();
    let part = part.objects[0].poses[0].unwrap().rotation;
    let whole = (0..100).fold(UnitQuaternion::identity(), |q, _| q * part);
    assert!(whole.angle_to(&pose.rotation) < 1e-9);
    // The same numbers as Euler angles are another rotation altogether.
    let euler = SEGMENT.map(f64::to_radians);
    let euler = about(0, euler[0]) * about(1, euler[1]) * about(2, euler[2]);
    let euler = UnitQuaternion::from_matrix(&euler);
    assert!(euler.angle_to(&pose.rotation).to_degrees() > 6.0);
    // Radians by the units' row.
    let rad = vicon(&segments("rad", SEGMENT.map(f64::to_radians))).unwrap();
    assert!(
        rad.objects[0].poses[0]
            .unwrap()
            .rotation
            .angle_to(&pose.rotation)
            < 1e-12
    );
    assert_eq!(rad.units, "mm, rad");
}

const MARKERS: &str = "Trajectories,,,\n100\n,,\"box:left, front\",,,box:right,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n\
    ,,mm,mm,mm,mm,mm,mm\n\
    101,0,1,2,3,4,5,6,,,\n102,0,,,,4,5,7\n103,0,1,2,3\n106,0,1.5,2,3,4,,6\n";

#[test]
fn trajectories_keep_their_gaps() {
    let f = vicon(MARKERS).unwrap();
    assert_eq!(f.format, MocapFormat::ViconTrajectories);
    assert_eq!((f.rotation, f.units.as_str()), (None, "mm"));
    assert_eq!(f.frames, [101, 102, 103, 106]);
    assert_eq!(f.t_s, [0.0, 0.01, 0.02, 0.05]);
    assert_eq!(f.markers[0].name, "box:left, front");
    assert_eq!(f.subjects(), ["box"]);
    let seen = |m: usize| -> Vec<bool> {
        f.markers[m]
            .positions_m
            .iter()
            .map(Option::is_some)
            .collect()
    };
    assert_eq!(seen(0), [true, false, true, true]);
    // What a line leaves out, or has in part, is a gap as well.
    assert_eq!(seen(1), [true, true, false, false]);
    let p = f.markers[1].positions_m[1].unwrap();
    assert!((p - Vector3::new(0.004, 0.005, 0.007)).norm() < 1e-15);
}

#[test]
fn sections_repeat_and_others_are_passed_over() {
    let text = format!(
        "Devices\n1000\n,Force\nFrame,Sub Frame,Fx\n,,N\n101,0,1\n101,1,2\n\n{MARKERS}\n\
         Trajectories\n100\n,,box:top,,,box:left x,,\nFrame,Sub Frame,X,Y,Z,X',Y',Z'\n,,mm,mm,mm,mm/s,mm/s,mm/s\n\
         102,0,7,8,9,0,0,0\n107,0,7,8,9.5,0,0,0\n\n\
         Trajectories\n100\n,,box:right,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n107,0,4,5,6\n\n\n\
         Segments\n100\n,,box:box,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,rad,rad,rad,mm,mm,mm\n107,0,0,0,1,1,2,3\n\
         Model Outputs\n100\n,,box:Angle,,\nFrame,Sub Frame,X,Y,Z\n,,deg,deg,deg\n101,0,1,2,3\n"
    );
    let f = vicon(&text).unwrap();
    assert_eq!(f.frames, [101, 102, 103, 106, 107]);
    let names: Vec<_> = f.markers.iter().map(|m| m.name.as_str()).collect();
    assert_eq!(names, ["box:left, front", "box:right", "box:top"]);
    let right: Vec<_> = f.markers[1]
        .positions_m
        .iter()
        .map(Option::is_some)
        .collect();
    assert_eq!(right, [true, true, false, false, true]);
    assert!(f.markers[2].positions_m[0].is_none() && f.markers[2].positions_m[1].is_some());
    assert_eq!(f.objects[0].name, "box:box");
    assert_eq!(f.gaps(&f.objects[0]), 4 + 2);
    let notes = f.notes.join("; ");
    for said in ["'Devices' was", "'Model Outputs' was", "box:left x"] {
        assert!(notes.contains(said), "{notes}");
    }
    let twice = format!("{MARKERS}\n{}", MARKERS.replace("101,0,1,", "101,0,8,"));
    assert!(
        vicon(&twice)
            .unwrap_err()
            .to_string()
            .contains("two different values in frame 101")
    );
    assert_eq!(
        vicon(&format!("{MARKERS}\n{MARKERS}")).unwrap(),
        vicon(MARKERS).unwrap()
    );
    let faster = format!("{MARKERS}\n{}", MARKERS.replace("100\n", "200\n"));
    assert!(vicon(&faster).unwrap_err().to_string().contains("line 12"));
}

/// A Tracker file of one object, with its heading, columns, units and first values.
fn tracker(heading: &str, columns: &str, units: &str, values: &str) -> String {
    format!(
        "Objects,,,\n100\n,,{heading},,,,,,\nFrame,Sub Frame,{columns}\n,,{units}\n1,0,{values}\n2,0,,,,,,\n"
    )
}

const ANGLES: [f64; 3] = [0.3, -0.8, 1.2];

#[test]
fn tracker_writes_rotations_in_three_ways() {
    let three = "RX,RY,RZ,TX,TY,TZ";
    let rad = "rad,rad,rad,mm,mm,mm";
    let values = "0.3,-0.8,1.2,100,200,300";
    let helical = vicon(&tracker("Global Angle arm:pad 1", three, rad, values)).unwrap();
    assert_eq!(helical.format, MocapFormat::ViconTracker);
    assert_eq!(helical.objects[0].name, "arm:pad 1");
    assert_eq!(helical.rotation, Some(MocapRotation::Helical));
    assert!(
        helical
            .notes
            .iter()
            .any(|n| n.contains("--rotation euler-xyz"))
    );
    let pose = helical.objects[0].poses[0].unwrap();
    assert!(off(&pose, rodrigues(ANGLES)) < 1e-12);
    assert!(helical.objects[0].poses[1].is_none());

    let turned = about(0, 0.3) * about(1, -0.8) * about(2, 1.2);
    for text in [
        tracker("Global Angle (Euler XYZ) arm:pad", three, rad, values),
        tracker("Global Angle arm:pad", "EX,EY,EZ,TX,TY,TZ", rad, values),
        tracker("Global Angle arm:pad", three, rad, values).replacen(
            "Objects",
            "Objects (Euler XYZ)",
            1,
        ),
    ] {
        let f = vicon(&text).unwrap();
        assert_eq!(f.rotation, Some(MocapRotation::EULER_XYZ), "{text}");
        assert_eq!(f.objects[0].name, "arm:pad");
        assert!(off(&f.objects[0].poses[0].unwrap(), turned) < 1e-12);
    }
    let told = tracker("Global Angle arm:pad", three, rad, values);
    let told = vicon::parse(
        told.as_bytes(),
        Path::new("v"),
        Some(MocapRotation::EULER_XYZ),
    )
    .unwrap();
    assert!(off(&told.objects[0].poses[0].unwrap(), turned) < 1e-12);

    let q = UnitQuaternion::from_scaled_axis(Vector3::from(ANGLES));
    let values = format!("{},{},{},{},100,200,300", q.i, q.j, q.k, q.w);
    let f = vicon(&tracker(
        "Global Angle arm:pad",
        "RX,RY,RZ,RW,TX,TY,TZ",
        ",,,,mm,mm,mm",
        &values,
    ))
    .unwrap();
    assert_eq!(f.rotation, Some(MocapRotation::Quaternion));
    assert_eq!(f.units, "mm");
    assert!(off(&f.objects[0].poses[0].unwrap(), rodrigues(ANGLES)) < 1e-12);
}

#[test]
fn tracker_may_head_angles_and_translations_apart() {
    let text = "Objects\n100\n,,Global Angle a:a,,,Global Translation a:a,,,Local Angle a:b,,,,,\n\
        Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ,RX,RY,RZ,TX,TY,TZ\n\
        ,,deg,deg,deg,mm,mm,mm,deg,deg,deg,mm,mm,mm\n1,0,0,0,90,1,2,3,0,0,0,0,0,0\n";
    let f = vicon(text).unwrap();
    assert_eq!(f.objects.len(), 1);
    assert!(
        off(
            &f.objects[0].poses[0].unwrap(),
            about(2, 90f64.to_radians())
        ) < 1e-12
    );
    assert!(f.notes.iter().any(|n| n.contains("a:b")), "{:?}", f.notes);
}

#[test]
fn what_cannot_be_told_is_refused() {
    let three = "RX,RY,RZ,TX,TY,TZ";
    let rad = "rad,rad,rad,mm,mm,mm";
    let refused = |heading: &str, columns: &str, units: &str, values: &str| {
        vicon(&tracker(heading, columns, units, values))
            .unwrap_err()
            .to_string()
    };
    let e = refused(
        "Global Angle a:b",
        three,
        "rad,rad,rad,mm,mm,ft",
        "0,0,0,1,1,1",
    );
    assert!(
        e.contains("line 5, column 8") && e.contains("\"ft\""),
        "{e}"
    );
    let e = refused("Global Angle a:b", three, ",,,mm,mm,mm", "0,0,0,1,1,1");
    assert!(
        e.contains("line 5, column 3") && e.contains("deg or rad"),
        "{e}"
    );
    let e = refused("Global Angle Euler ZYX a:b", three, rad, "0,0,0,1,1,1");
    assert!(e.contains("cannot be told"), "{e}");
    // No helical rotation is longer than half a turn unless it is followed across.
    let e = refused("Global Angle a:b", three, rad, "3.1,1.2,-3,1,1,1");
    assert!(
        e.contains("line 6, column 3") && e.contains("--rotation"),
        "{e}"
    );
    let e = refused(
        "Global Angle a:b",
        "RX,RY,RZ,RW,TX,TY,TZ",
        ",,,,mm,mm,mm",
        "1,1,0,1,1,1,1",
    );
    assert!(e.contains("length 1.732"), "{e}");
}

#[test]
fn refusals_say_where() {
    let e = |text: &str| vicon(text).unwrap_err().to_string();
    assert!(e(&MARKERS.replace("102,0,,,,4", "102,0,,,,4x")).contains("line 7, column 6"));
    assert!(e(&MARKERS.replace("103,0", "102,0")).contains("line 8, column 1: frame 102"));
    assert!(e(&MARKERS.replace("103,0", "103,1")).contains("line 8, column 2: a sub frame"));
    assert!(e(&MARKERS.replace("103,", "one,")).contains("line 8, column 1"));
    assert!(e(&MARKERS.replace("100\n", "")).contains("line 3, column 1: the frame rate"));
    assert!(e(&MARKERS.replace("100\n", "-5\n")).contains("the frame rate"));
    assert!(
        e(&MARKERS.replace(",,mm,mm,mm,mm,mm,mm\n", ""))
            .contains("line 5, column 1: the line of units")
    );
    assert!(e(&MARKERS.replace("1.5,2,3", "1e9,2,3")).contains("line 9, column 3: 1000000 m"));
    // Cut within its last line.
    assert!(
        e(MARKERS.trim_end_matches(",,6\n")).contains("line 9, column 6: the file ends within")
    );
    assert!(
        e("Devices\n100\n,F\nFrame,Sub Frame,Fx\n,,N\n1,0,1\n")
            .contains("'Devices' was passed over")
    );
    assert!(
        e("Frame,Time (Seconds),X,Y,Z\n1,0,1,2,3\n").contains("Motive export without its header")
    );
    assert!(e(&MARKERS[..MARKERS.find("101,0").unwrap()]).contains("no frame"));
}

#[test]
fn exact_zeros_are_kept_and_said() {
    let f = vicon(&MARKERS.replace("101,0,1,2,3,", "101,0,0,0,0,")).unwrap();
    assert_eq!(f.markers[0].positions_m[0], Some(Vector3::zeros()));
    assert!(f.notes[0].contains("in 1 frames"), "{:?}", f.notes);
}

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

fn motive_text() -> String {
    let q = UnitQuaternion::from_scaled_axis(Vector3::from(ANGLES));
    MOTIVE
        .replace("QX", &q.i.to_string())
        .replace("QY", &q.j.to_string())
        .replace("QZ", &q.k.to_string())
        .replace("QW", &q.w.to_string())
}

#[test]
fn motive_has_bodies_and_markers() {
    let f = motive(&motive_text()).unwrap();
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
    let f = motive(&motive_text().replace("pad:Marker2", "pad:Marker1")).unwrap();
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
    let f = motive(text).unwrap();
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
        motive(&motive_text().replacen(from, to, 1))
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

/// A C3D file of our own: two labelled points and one without a label, three frames.
struct Made {
    order: u8,
    scale: f32,
    trial: Option<[u16; 4]>,
    header: [u16; 2],
}

impl Made {
    fn u16(&self, v: u16) -> [u8; 2] {
        if self.order == 86 {
            v.to_be_bytes()
        } else {
            v.to_le_bytes()
        }
    }

    fn f32(&self, v: f32) -> [u8; 4] {
        match self.order {
            84 => v.to_le_bytes(),
            86 => v.to_be_bytes(),
            _ => {
                let [a, b, c, d] = (v * 4.0).to_le_bytes();
                [c, d, a, b]
            }
        }
    }

    fn record(&self, out: &mut Vec<u8>, group: i8, name: &str, body: &[u8]) {
        out.push(name.len() as u8);
        out.push(group as u8);
        out.extend(name.bytes());
        out.extend(self.u16(body.len() as u16 + 3));
        out.extend(body);
        out.push(0);
    }

    fn bytes(&self) -> Vec<u8> {
        let mut out = vec![2, 0x50];
        for v in [3, 2, self.header[0], self.header[1], 0] {
            out.extend(self.u16(v));
        }
        out.extend(self.f32(self.scale));
        out.extend(self.u16(4));
        out.extend(self.u16(1));
        out.extend(self.f32(50.0));
        out.resize(512, 0);
        out.extend([0, 0x50, 2, self.order]);
        self.parameters(&mut out);
        out.resize(3 * 512, 0);
        for n in 0..3u8 {
            for point in 0..3u8 {
                let valid = !(n == 1 && point == 0);
                for k in 0..3u8 {
                    let v = f32::from(100 * n) + f32::from(10 * point + k) - 15.0;
                    self.value(&mut out, if valid { v } else { 0.0 }, true);
                }
                self.value(&mut out, if valid { 0.0 } else { -1.0 }, false);
            }
            // Analogue values, to be passed over.
            self.value(&mut out, 7.0, false);
            self.value(&mut out, 7.0, false);
        }
        out
    }

    fn value(&self, out: &mut Vec<u8>, v: f32, is_scaled: bool) {
        if self.scale < 0.0 {
            out.extend(self.f32(v));
        } else {
            let v = if is_scaled { v / self.scale } else { v };
            out.extend(self.u16(v.round() as i16 as u16));
        }
    }

    fn parameters(&self, out: &mut Vec<u8>) {
        let text = |dims: &[u8], s: &str| {
            let mut b = vec![255, dims.len() as u8];
            b.extend(dims);
            b.extend(s.bytes());
            b
        };
        let number = |b: &[u8], kind: u8| [&[kind, 0], b].concat();
        self.record(out, -1, "POINT", &[]);
        self.record(out, 1, "USED", &number(&self.u16(3), 2));
        self.record(out, 1, "SCALE", &number(&self.f32(self.scale), 4));
        self.record(out, 1, "RATE", &number(&self.f32(50.0), 4));
        self.record(out, 1, "UNITS", &text(&[2], "mm"));
        self.record(out, 1, "DATA_START", &number(&self.u16(4), 2));
        self.record(out, 1, "LABELS", &text(&[6, 1], "s:a   "));
        self.record(out, 1, "LABELS2", &text(&[6, 2], "s:b         "));
        if let Some([a, b, c, d]) = self.trial {
            self.record(out, -2, "TRIAL", &[]);
            let pair = |low: u16, high: u16| {
                [&[2, 1, 2], &self.u16(low)[..], &self.u16(high)[..]].concat()
            };
            self.record(out, 2, "ACTUAL_START_FIELD", &pair(a, b));
            self.record(out, 2, "ACTUAL_END_FIELD", &pair(c, d));
        }
    }

    fn read(&self) -> Result<MocapFile, RecordingError> {
        c3d::parse(&self.bytes(), Path::new("a.c3d"))
    }
}

const INTEL: Made = Made {
    order: 84,
    scale: -0.1,
    trial: None,
    header: [11, 13],
};

#[test]
fn c3d_of_every_machine_and_number_reads_alike() {
    let whole = INTEL.read().unwrap();
    assert_eq!((whole.rate_hz, whole.first_frame), (50.0, 11));
    assert_eq!(whole.frames, [11, 12, 13]);
    let names: Vec<_> = whole.markers.iter().map(|m| m.name.as_str()).collect();
    assert_eq!(names, ["s:a", "s:b"]);
    assert_eq!(whole.markers[0].positions_m[1], None);
    let p = whole.markers[1].positions_m[2].unwrap();
    assert!((p - Vector3::new(0.195, 0.196, 0.197)).norm() < 1e-7);
    assert!(whole.notes[0].contains("1 points without a label"));
    for order in [84, 85, 86] {
        for scale in [-0.1, 0.5] {
            let f = Made {
                order,
                scale,
                ..INTEL
            }
            .read()
            .unwrap();
            assert_eq!(f.frames, whole.frames);
            for (a, b) in f.markers.iter().zip(&whole.markers) {
                for (a, b) in a.positions_m.iter().zip(&b.positions_m) {
                    match (a, b) {
                        (Some(a), Some(b)) => assert!((a - b).norm() < 1e-7),
                        (a, b) => assert_eq!(a, b),
                    }
                }
            }
        }
    }
}

#[test]
fn c3d_frames_of_long_files_come_from_the_trial() {
    // Frame 70 000 and on: the header cannot say so.
    let f = Made {
        trial: Some([4464, 1, 4466, 1]),
        header: [65535, 65535],
        ..INTEL
    }
    .read()
    .unwrap();
    assert_eq!((f.first_frame, f.frames.len()), (70_000, 3));
    // A frame that is not there.
    let e = Made {
        trial: Some([1, 0, 4, 0]),
        header: [1, 4],
        ..INTEL
    }
    .read()
    .unwrap_err()
    .to_string();
    assert!(e.contains("after 3 of 4 frames"), "{e}");
    let mut bytes = INTEL.bytes();
    bytes[515] = 99;
    let e = c3d::parse(&bytes, Path::new("a.c3d"))
        .unwrap_err()
        .to_string();
    assert!(e.contains("byte 515") && e.contains("processor 99"), "{e}");
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

fn names(file: &MocapFile) -> Vec<String> {
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
    let e = vicon(&text).unwrap_err().to_string();
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
            if let Ok(f) = vicon::parse(bytes.as_slice(), path, wanted) {
                check(&f, bytes.len());
                let _ = marker_body(&f, "b", &names(&f));
            }
        }
        if let Ok(f) = motive::parse(bytes.as_slice(), path) {
            check(&f, bytes.len());
        }
        let _ = vicon::refuse_others(bytes.as_slice(), path);
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
        if let Ok(f) = c3d::parse(&bytes, Path::new("x")) {
            check(&f, bytes.len());
            let _ = marker_body(&f, "b", &names(&f));
        }
    }

    #[test]
    fn any_bytes_are_refused_or_sound(bytes in prop::collection::vec(any::<u8>(), 0..1500)) {
        let path = Path::new("x");
        let _ = vicon::parse(bytes.as_slice(), path, None);
        let _ = motive::parse(bytes.as_slice(), path);
        let _ = c3d::parse(&bytes, path);
        let _ = c3d::is_c3d(&bytes);
    }

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
