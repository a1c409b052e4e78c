//! Vicon's tables, and their rotations against formulas written out.

use super::*;

pub(super) const SEGMENT: [f64; 3] = [-13.8112, 1.34995, 55.7734];

pub(super) fn segments(unit: &str, v: [f64; 3]) -> String {
    format!(
        "\u{feff}Segments\r\n200\r\n,,test rig:arm,,,,,,,,\r\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\r\n\
         ,,{unit},{unit},{unit},mm,mm,mm\r\n7,0,{},{},{},128.5,-175.25,492\r\n9,0,,,,,,\r\n\r\n",
        v[0], v[1], v[2]
    )
}

#[test]
fn segments_are_helical_in_the_unit_of_their_row() {
    let f = read_vicon(&segments("deg", SEGMENT)).unwrap();
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
    let part = read_vicon(&segments("deg", SEGMENT.map(|a| a / 100.0))).unwrap();
    let part = part.objects[0].poses[0].unwrap().rotation;
    let whole = (0..100).fold(UnitQuaternion::identity(), |q, _| q * part);
    assert!(whole.angle_to(&pose.rotation) < 1e-9);
    // The same numbers as Euler angles are another rotation altogether.
    let euler = SEGMENT.map(f64::to_radians);
    let euler = about(0, euler[0]) * about(1, euler[1]) * about(2, euler[2]);
    let euler = UnitQuaternion::from_matrix(&euler);
    assert!(euler.angle_to(&pose.rotation).to_degrees() > 6.0);
    // Radians by the units' row.
    let rad = read_vicon(&segments("rad", SEGMENT.map(f64::to_radians))).unwrap();
    assert!(
        rad.objects[0].poses[0]
            .unwrap()
            .rotation
            .angle_to(&pose.rotation)
            < 1e-12
    );
    assert_eq!(rad.units, "mm, rad");
}

pub(super) const MARKERS: &str = "Trajectories,,,\n100\n,,\"box:left, front\",,,box:right,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n\
    ,,mm,mm,mm,mm,mm,mm\n\
    101,0,1,2,3,4,5,6,,,\n102,0,,,,4,5,7\n103,0,1,2,3\n106,0,1.5,2,3,4,,6\n";

#[test]
fn trajectories_keep_their_gaps() {
    let f = read_vicon(MARKERS).unwrap();
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
    let f = read_vicon(&text).unwrap();
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
        read_vicon(&twice)
            .unwrap_err()
            .to_string()
            .contains("two different values in frame 101")
    );
    assert_eq!(
        read_vicon(&format!("{MARKERS}\n{MARKERS}")).unwrap(),
        read_vicon(MARKERS).unwrap()
    );
    let faster = format!("{MARKERS}\n{}", MARKERS.replace("100\n", "200\n"));
    assert!(
        read_vicon(&faster)
            .unwrap_err()
            .to_string()
            .contains("line 12")
    );
}

/// A Tracker file of one object, with its heading, columns, units and first values.
pub(super) fn tracker(heading: &str, columns: &str, units: &str, values: &str) -> String {
    format!(
        "Objects,,,\n100\n,,{heading},,,,,,\nFrame,Sub Frame,{columns}\n,,{units}\n1,0,{values}\n2,0,,,,,,\n"
    )
}

pub(super) const ANGLES: [f64; 3] = [0.3, -0.8, 1.2];

#[test]
fn tracker_writes_rotations_in_three_ways() {
    let three = "RX,RY,RZ,TX,TY,TZ";
    let rad = "rad,rad,rad,mm,mm,mm";
    let values = "0.3,-0.8,1.2,100,200,300";
    let helical = read_vicon(&tracker("Global Angle arm:pad 1", three, rad, values)).unwrap();
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
        tracker(
            "Global Angle arm:pad",
            "Euler X,Euler Y,Euler Z,TX,TY,TZ",
            rad,
            values,
        ),
        tracker("Global Angle arm:pad", three, rad, values).replacen(
            "Objects",
            "Objects (Euler XYZ)",
            1,
        ),
    ] {
        let f = read_vicon(&text).unwrap();
        assert_eq!(f.rotation, Some(MocapRotation::EULER_XYZ), "{text}");
        assert_eq!(f.objects[0].name, "arm:pad");
        assert!(off(&f.objects[0].poses[0].unwrap(), turned) < 1e-12);
    }
    let told = tracker("Global Angle arm:pad", three, rad, values);
    let told = crate::recording::mocap::vicon::parse(
        told.as_bytes(),
        Path::new("v"),
        Some(MocapRotation::EULER_XYZ),
    )
    .unwrap();
    assert!(off(&told.objects[0].poses[0].unwrap(), turned) < 1e-12);

    let q = UnitQuaternion::from_scaled_axis(Vector3::from(ANGLES));
    let values = format!("{},{},{},{},100,200,300", q.i, q.j, q.k, q.w);
    let f = read_vicon(&tracker(
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
    let f = read_vicon(text).unwrap();
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
        read_vicon(&tracker(heading, columns, units, values))
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
    assert!(e.contains("is ambiguous"), "{e}");
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
    let e = |text: &str| read_vicon(text).unwrap_err().to_string();
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
        e("Devices\n100\n,F\nFrame,Sub Frame,Fx\n,,N\n1,0,1\n").contains("'Devices' was ignored")
    );
    assert!(
        e("Frame,Time (Seconds),X,Y,Z\n1,0,1,2,3\n").contains("Motive export without its header")
    );
    assert!(e(&MARKERS[..MARKERS.find("101,0").unwrap()]).contains("no frame"));
}

#[test]
fn exact_zeros_are_kept_and_said() {
    let f = read_vicon(&MARKERS.replace("101,0,1,2,3,", "101,0,0,0,0,")).unwrap();
    assert_eq!(f.markers[0].positions_m[0], Some(Vector3::zeros()));
    assert!(f.notes[0].contains("in 1 frames"), "{:?}", f.notes);
}
