//! The encoding of messages against bytes written down by hand, definitions, and paths.

use proptest::prelude::*;

use crate::recording::mcap::cdr::{CdrReader, CdrWriter, Number};
use crate::recording::mcap::definition::{Definition, Kind, Shape};
use crate::recording::mcap::messages::{self, MessageKind};
use crate::recording::mcap::value::{FieldPath, FoundValue, Value};
use crate::signal::{Pose, Stamp, pose_from_ypr};

/// By hand from DDS-XTypes 1.3, 7.4.1: header, stamp 1 s 2 ns, frame "ab", and a double that begins at 16.
const STAMPED: [u8; 28] = [
    0x00, 0x01, 0x00, 0x00, // plain CDR, little-endian
    0x01, 0x00, 0x00, 0x00, // sec
    0x02, 0x00, 0x00, 0x00, // nanosec
    0x03, 0x00, 0x00, 0x00, b'a', b'b', 0x00, // the text with its zero
    0x00, // up to a multiple of eight
    0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0xf8, 0x3f, // 1.5
];

#[test]
fn numbers_stand_at_multiples_of_their_size() {
    let mut w = CdrWriter::new();
    w.i32(1);
    w.u32(2);
    w.text("ab");
    w.f64(1.5);
    assert_eq!(w.finish(), STAMPED);
    let mut r = CdrReader::new(&STAMPED).expect("a header");
    assert_eq!(r.number(Number::I32), Ok(1.0));
    assert_eq!(r.number(Number::U32), Ok(2.0));
    assert_eq!(r.text(), Ok(b"ab".as_slice()));
    assert_eq!(r.number(Number::F64), Ok(1.5));
    assert_eq!(r.left(), 0);
    assert!(r.number(Number::U8).is_err());

    // A byte, a short at 2, a byte, an integer at 8, a sequence of one double at 16.
    let mut w = CdrWriter::new();
    w.u8(7);
    let bytes = [
        0, 1, 0, 0, 7, 0, 0xfe, 0xff, 1, 0, 0, 0, 0xff, 0xff, 0xff, 0xff, 1, 0, 0, 0, 0, 0, 0, 0,
        0, 0, 0, 0x40,
    ];
    assert_eq!(w.finish(), bytes[..5]);
    let mut r = CdrReader::new(&bytes).expect("a header");
    assert_eq!(r.number(Number::U8), Ok(7.0));
    assert_eq!(r.number(Number::I16), Ok(-2.0));
    assert_eq!(r.number(Number::Bool), Ok(1.0));
    assert_eq!(r.number(Number::U32), Ok(f64::from(u32::MAX)));
    let n = r.length().expect("a length");
    let doubles = r.numbers(Number::F64, n).expect("there");
    assert_eq!(
        (doubles.len(), doubles.get(0), doubles.get(1)),
        (1, Some(2.0), None)
    );

    // Big-endian, and an empty sequence, behind which nothing is aligned.
    let bytes = [0, 0, 0, 0, 0, 0, 0, 0, 0x3f, 0x80, 0, 0];
    let mut r = CdrReader::new(&bytes).expect("a header");
    let n = r.length().expect("a length");
    assert_eq!(r.numbers(Number::F64, n).expect("none").len(), 0);
    assert_eq!(r.number(Number::F32), Ok(1.0));

    for (bytes, wrong) in [
        (vec![0, 1], "shorter than its header"),
        (vec![0, 7, 0, 0, 1], "encoding is 0007"),
    ] {
        let e = CdrReader::new(&bytes).err().expect("refused");
        assert!(e.contains(wrong), "{e}");
    }
    let mut r = CdrReader::new(&[0, 1, 0, 0, 0xff, 0xff, 0xff, 0x7f]).expect("a header");
    let e = r.length().expect_err("more than there is");
    assert!(e.contains("2147483647 elements"), "{e}");
}

const NESTED: &str = "# a comment\nuint8 KIND=3\nstring<=8 LABEL = \"a\"\nHeader header\nint16[2] pair\nOne[] ones 3\n\
    float32[<=4] few [1, 2] # with a default\nother_msgs/msg/Two two\n\
    ================================================================================\nMSG: std_msgs/Header\n\
    builtin_interfaces/Time stamp\nstring frame_id\n\
    ================================================================================\nMSG: builtin_interfaces/Time\n\
    int32 sec\nuint32 nanosec\n\
    ================================================================================\nMSG: my_msgs/One\nstring key\nfloat64 value\n\
    ================================================================================\nMSG: other_msgs/msg/Two\n# nothing\n";

#[test]
fn definitions_have_constants_defaults_bounds_and_other_messages() {
    let d = Definition::parse("my_msgs/msg/Mine", NESTED.as_bytes()).expect("reads");
    let names: Vec<&str> = d.messages.iter().map(|m| m.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "my_msgs/Mine",
            "std_msgs/Header",
            "builtin_interfaces/Time",
            "my_msgs/One",
            "other_msgs/Two"
        ]
    );
    let of = &d.messages[0].fields;
    let shapes: Vec<(&str, Shape)> = of.iter().map(|f| (f.name.as_str(), f.shape)).collect();
    assert_eq!(
        shapes,
        [
            ("header", Shape::One),
            ("pair", Shape::Array(2)),
            ("ones", Shape::Sequence),
            ("few", Shape::Sequence),
            ("two", Shape::One)
        ]
    );
    assert_eq!(of[2].kind, Kind::Message(3));
    // A message without fields takes a byte.
    assert_eq!(d.messages[4].fields.len(), 1);
    for (text, wrong) in [
        ("wstring name", "wstring"),
        ("float128 x", "definition of a/float128 is missing"),
        ("float64", "is no field"),
        ("float64[x] y", "is no type"),
        ("float64[ y", "is no type"),
        (
            "B b\n===\nMSG: a/B\nC c\n===\nMSG: a/C\nB b",
            "up to 16 levels",
        ),
    ] {
        let e = Definition::parse("a/msg/A", text.as_bytes()).expect_err(wrong);
        assert!(e.contains(wrong), "{e}");
    }
    assert!(Definition::parse("a/msg/A", &[0xff]).is_err());
    assert!(Definition::parse("a/msg/A", &vec![b'#'; 2 << 20]).is_err());
}

/// The message of [`NESTED`].
fn nested() -> Vec<u8> {
    let mut w = CdrWriter::new();
    w.i32(5);
    w.u32(6);
    w.text("f");
    // Two shorts.
    [1, 0, 2, 0].into_iter().for_each(|b| w.u8(b));
    w.length(2);
    for (key, value) in [("a", 1.0), ("b", 2.0)] {
        w.text(key);
        w.f64(value);
    }
    w.length(0);
    w.u8(9);
    w.finish()
}

#[test]
fn paths_lead_to_numbers_by_place_and_by_name() {
    let d = Definition::parse("my_msgs/msg/Mine", NESTED.as_bytes()).expect("reads");
    let bytes = nested();
    let value = Value::decode(&d, &bytes).expect("fits");
    let find = |path: &str| -> Result<Option<f64>, String> {
        let found = FieldPath::parse(path)?.find(&value)?;
        found.map(|f| f.value.number()).transpose()
    };
    for (path, number) in [
        ("pair[1]", Some(2.0)),
        ("pair[2]", None),
        ("ones[0].value", Some(1.0)),
        ("ones[key=b].value", Some(2.0)),
        ("ones[key=c].value", None),
        ("header.stamp.nanosec", Some(6.0)),
        ("few[0]", None),
        ("two.structure_needs_at_least_one_member", Some(9.0)),
    ] {
        assert_eq!(find(path), Ok(number), "{path}");
    }
    for (path, wrong) in [
        ("three", "my_msgs/Mine has header, pair"),
        ("header", "a number is needed, and it is std_msgs/Header"),
        ("pair", "it is 2 numbers"),
        ("pair[a]", "no sequence 'name'"),
        ("pair[0].x", "a number has no fields"),
        ("header[0]", "before its end stands std_msgs/Header"),
        ("pair[0", "is no field"),
        ("[0]", "is no field"),
        ("pair.", "is no field"),
        ("a]b", "there is no field"),
    ] {
        let e = find(path).expect_err(path);
        assert!(e.contains(wrong), "{path}: {e}");
    }
    let of = FieldPath::parse("ones[1].value").expect("a path");
    let found = of.find(&value).expect("fits").expect("there");
    assert_eq!(found.stamp_ns, Some(5_000_000_006));
    for end in 0..bytes.len() {
        assert!(Value::decode(&d, &bytes[..end]).is_err(), "{end}");
    }
    let springs = [("1A".to_owned(), 0.1), ("2B".to_owned(), 0.2)];
    let bytes = messages::joint_state(Stamp(7), &springs);
    let kind = MessageKind::JointState;
    let d = Definition::parse(kind.name(), kind.definition().as_bytes()).expect("own");
    let value = Value::decode(&d, &bytes).expect("fits");
    let found = |path: &str| {
        let found = FieldPath::parse(path)
            .expect("a path")
            .find(&value)
            .expect("fits");
        found.map(|f| f.value.number())
    };
    assert_eq!(found("position[2B]"), Some(Ok(0.2)));
    assert_eq!(found("position[name=1A]"), Some(Ok(0.1)));
    assert_eq!(found("position[3A]"), None);
}

#[test]
fn poses_and_transforms_are_places() {
    let pose = pose_from_ypr([0.1, 0.2, -0.3], [0.4, 0.5, 0.6]);
    let bytes = messages::transforms(Stamp(3), "base", &[("a", Pose::identity()), ("tip", pose)]);
    let kind = MessageKind::Transforms;
    let d = Definition::parse(kind.name(), kind.definition().as_bytes()).expect("own");
    let value = Value::decode(&d, &bytes).expect("fits");
    let path = FieldPath::parse("transforms[child_frame_id=tip].transform").expect("a path");
    let found = path.find(&value).expect("fits").expect("there");
    assert_eq!(found.stamp_ns, Some(3));
    let place = found.value.place().expect("a pose");
    assert_eq!(place[..3], [0.1, 0.2, -0.3]);
    assert_eq!(place[3..], *pose.rotation.coords.as_slice());
    assert!(FoundValue::Number(1.0).turn().is_err());
}

proptest! {
    #[test]
    fn any_definition_and_message_are_answered(
        text in "((u?int8|float64|string|B|a/B)(\\[[0-9]{0,9}\\]|\\[<=3\\]|) [a-z]{1,3}\n){0,6}(===\nMSG: a/B\n((int16|float32|string)(\\[\\]|) [a-z]\n){0,3})?",
        bytes in prop::collection::vec(prop_oneof![Just(0_u8), Just(1), any::<u8>()], 0..200),
        path in "[a-zB]{1,2}(\\[[a-c0-9=]{0,3}\\])?(\\.[a-z])?",
    ) {
        if let Ok(definition) = Definition::parse("a/msg/A", text.as_bytes()) {
            let mut message = vec![0, 1, 0, 0];
            message.extend_from_slice(&bytes);
            if let Ok(value) = Value::decode(&definition, &message)
                && let Ok(path) = FieldPath::parse(&path)
                && let Ok(Some(found)) = path.find(&value)
            {
                let _ = (found.value.number(), found.value.turn(), found.value.place());
            }
        }
    }
}
