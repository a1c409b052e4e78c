//! The object stream of Vicon Tracker (UDP, port 51001): pure bytes in, bytes out.
//!
//! A datagram, little-endian: `u32 frame, u8 items`, then per item `u8 id = 0, u16 size = 72,
//! char[24] name, f64 TX TY TZ` (mm)`, f64 RX RY RZ` (rad). Bytes after the last item are padding.
//!
//! Rotation convention: the three angles turn about the object's own moving axes, first x, then
//! the new y, then the new z, so that
//!
//! world_R_object = Rx(RX) · Ry(RY) · Rz(RZ).
//!
//! The stream does not say which convention it uses; a laboratory that set another one must
//! convert before it sends.

use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::signal::Pose;

/// UDP port the stream is sent to by default.
pub const PORT: u16 = 51_001;
/// Name of the object on the end pad.
pub const END_PAD: &str = "end_pad";

const NAME_BYTES: usize = 24;
const ITEM_BYTES: usize = 72;
/// Positions farther from the origin than this are refused, m.
const MAX_DISTANCE_M: f64 = 100.0;

/// One datagram: the objects of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectFrame {
    /// Frame number of the motion-capture system.
    pub frame: u32,
    /// The objects it saw.
    pub objects: Vec<Object>,
}

/// One tracked object.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    /// Its name, at most 24 bytes on the line.
    pub name: String,
    /// Pose of its frame in the motion-capture world; translation in m.
    pub world_from_object: Pose,
}

/// Why a datagram was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ObjectError {
    /// It ends early.
    #[error(
        "the motion-capture datagram ends after {0} bytes, within its items: check the sender's object stream settings"
    )]
    Short(usize),
    /// An item of a kind we do not know.
    #[error(
        "item {item} of the motion-capture datagram has id {id} and size {size}, expected 0 and 72: check that the sender streams objects"
    )]
    Item {
        /// Which item, 1-based.
        item: usize,
        /// Its id.
        id: u8,
        /// Its size.
        size: u16,
    },
    /// A pose that is not finite or out of any laboratory.
    #[error(
        "item {item} of the motion-capture datagram has a pose that is not finite or more than 100 m away: check the sender's units"
    )]
    Pose {
        /// Which item, 1-based.
        item: usize,
    },
}

/// The bytes of a frame. Names are cut to 24 bytes; at most 255 objects.
pub fn encode(frame: &ObjectFrame) -> Vec<u8> {
    let items = frame.objects.len().min(255);
    let mut out = Vec::with_capacity(5 + 75 * items);
    out.extend(frame.frame.to_le_bytes());
    out.push(items as u8);
    for object in frame.objects.iter().take(items) {
        out.push(0);
        out.extend((ITEM_BYTES as u16).to_le_bytes());
        let mut name = [0; NAME_BYTES];
        for (to, from) in name.iter_mut().zip(object.name.bytes()) {
            *to = from;
        }
        out.extend(name);
        let t_mm = object.world_from_object.translation.vector * 1e3;
        let angles_rad = xyz_from_rotation(&object.world_from_object.rotation);
        for x in [t_mm.x, t_mm.y, t_mm.z].into_iter().chain(angles_rad) {
            out.extend(x.to_le_bytes());
        }
    }
    out
}

/// Reads a datagram, whatever its bytes.
///
/// # Errors
/// [`ObjectError`]: what is wrong and with which item. Nothing of a bad datagram is used.
pub fn parse(datagram: &[u8]) -> Result<ObjectFrame, ObjectError> {
    let short = || ObjectError::Short(datagram.len());
    let (frame, rest) = datagram.split_first_chunk::<4>().ok_or_else(short)?;
    let (items, mut rest) = rest.split_first().ok_or_else(short)?;
    let mut objects = Vec::new();
    for item in 1..=usize::from(*items) {
        let (head, after) = rest.split_first_chunk::<3>().ok_or_else(short)?;
        let (id, size) = (head[0], u16::from_le_bytes([head[1], head[2]]));
        if id != 0 || usize::from(size) != ITEM_BYTES {
            return Err(ObjectError::Item { item, id, size });
        }
        let (body, after) = after.split_first_chunk::<ITEM_BYTES>().ok_or_else(short)?;
        objects.push(parse_object(body).ok_or(ObjectError::Pose { item })?);
        rest = after;
    }
    Ok(ObjectFrame {
        frame: u32::from_le_bytes(*frame),
        objects,
    })
}

fn parse_object(body: &[u8; ITEM_BYTES]) -> Option<Object> {
    let (name, numbers) = body.split_at(NAME_BYTES);
    let name: Vec<u8> = name.iter().copied().take_while(|b| *b != 0).collect();
    let mut v = [0.0; 6];
    for (to, from) in v.iter_mut().zip(numbers.chunks_exact(8)) {
        *to = f64::from_le_bytes(from.try_into().ok()?);
    }
    let t_m = Vector3::new(v[0], v[1], v[2]) * 1e-3;
    // `!(a < b)` would let a NaN through here, so ask for what must hold.
    let sound = v.iter().all(|x| x.is_finite())
        && t_m.amax() < MAX_DISTANCE_M
        && v[3..].iter().all(|a| a.abs() < 1e3);
    sound.then(|| Object {
        name: String::from_utf8_lossy(&name).into_owned(),
        world_from_object: Pose::from_parts(
            Translation3::from(t_m),
            rotation_from_xyz([v[3], v[4], v[5]]),
        ),
    })
}

/// R = Rx(a) · Ry(b) · Rz(c), angles in rad.
pub fn rotation_from_xyz([a, b, c]: [f64; 3]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), a)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), b)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), c)
}

/// The inverse of [`rotation_from_xyz`], angles in rad.
pub fn xyz_from_rotation(rotation: &UnitQuaternion<f64>) -> [f64; 3] {
    // Rᵀ = Rz(−c) Ry(−b) Rx(−a): the yaw-pitch-roll form with all signs turned.
    let (roll, pitch, yaw) = Rotation3::from(rotation.inverse()).euler_angles();
    [-roll, -pitch, -yaw]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn object(name: &str, v: [f64; 6]) -> Object {
        Object {
            name: name.into(),
            world_from_object: Pose::from_parts(
                Translation3::new(v[0], v[1], v[2]),
                rotation_from_xyz([v[3], v[4], v[5]]),
            ),
        }
    }

    #[test]
    fn layout_is_that_of_the_stream() {
        let f = ObjectFrame {
            frame: 0x0102_0304,
            objects: vec![object(END_PAD, [0.001, -0.002, 0.003, 0.1, 0.0, 0.0])],
        };
        let bytes = encode(&f);
        assert_eq!(bytes.len(), 5 + 75);
        assert_eq!(bytes[..8], [4, 3, 2, 1, 1, 0, 72, 0]);
        assert_eq!(&bytes[8..16], b"end_pad\0");
        let number = |i: usize| {
            f64::from_le_bytes(bytes[32 + 8 * i..40 + 8 * i].try_into().expect("8 bytes"))
        };
        assert!((number(0) - 1.0).abs() < 1e-12, "millimetres");
        assert!((number(1) + 2.0).abs() < 1e-12);
        assert!((number(3) - 0.1).abs() < 1e-12, "radians");
    }

    /// The object's x axis turned by 90° about z, then the whole by 90° about the world's x.
    #[test]
    fn x_comes_last_in_world_axes() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let r = rotation_from_xyz([quarter, 0.0, quarter]);
        assert!((r * Vector3::x() - Vector3::z()).norm() < 1e-12);
    }

    proptest! {
        #[test]
        fn frames_survive(
            frame in any::<u32>(),
            poses in prop::collection::vec(
                [-2.0..2.0, -2.0..2.0, -2.0..2.0, -3.1..3.1, -1.5..1.5, -3.1..3.1f64], 0..6),
        ) {
            let f = ObjectFrame {
                frame,
                objects: poses.iter().map(|v| object("pad", *v)).collect(),
            };
            let back = parse(&encode(&f)).expect("own bytes");
            prop_assert_eq!(back.frame, f.frame);
            prop_assert_eq!(back.objects.len(), f.objects.len());
            for (a, b) in back.objects.iter().zip(&f.objects) {
                let d = a.world_from_object.inverse() * b.world_from_object;
                prop_assert!(d.translation.vector.norm() < 1e-9);
                prop_assert!(d.rotation.angle() < 1e-7);
            }
        }

        #[test]
        fn hostile_datagrams_are_refused_or_finite(
            mut bytes in prop::collection::vec(any::<u8>(), 0..400),
            plausible in any::<bool>(),
        ) {
            if plausible && bytes.len() > 8 {
                bytes[4] = 2;
                bytes[5..8].copy_from_slice(&[0, 72, 0]);
            }
            if let Ok(f) = parse(&bytes) {
                for o in f.objects {
                    prop_assert!(o.world_from_object.translation.vector.norm().is_finite());
                    prop_assert!(o.world_from_object.rotation.angle().is_finite());
                }
            }
        }
    }

    #[test]
    fn bad_items_are_named() {
        let mut f = encode(&ObjectFrame {
            frame: 7,
            objects: vec![object("a", [0.0; 6]), object("b", [0.0; 6])],
        });
        assert_eq!(parse(&f[..100]), Err(ObjectError::Short(100)));
        let nan = f64::NAN.to_le_bytes();
        f[5 + 75 + 27..5 + 75 + 35].copy_from_slice(&nan);
        assert_eq!(parse(&f), Err(ObjectError::Pose { item: 2 }));
        f[6] = 71;
        assert!(matches!(
            parse(&f),
            Err(ObjectError::Item {
                item: 1,
                size: 71,
                ..
            })
        ));
    }
}
