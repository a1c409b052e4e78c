//! C3D files made here.

use super::*;

/// A C3D file of our own: two labelled points and one without a label, three frames.
pub(super) struct Made {
    pub(super) order: u8,
    pub(super) scale: f32,
    pub(super) trial: Option<[u16; 4]>,
    pub(super) header: [u16; 2],
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

    pub(super) fn bytes(&self) -> Vec<u8> {
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
            // Analogue values, to be ignored.
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
        crate::recording::mocap::c3d::parse(&self.bytes(), Path::new("a.c3d"))
    }
}

pub(super) const INTEL: Made = Made {
    order: 84,
    scale: -0.1,
    trial: None,
    header: [11, 13],
};

/// 1 as a VAX F float.
#[test]
fn numbers_of_dec_machines_are_those_of_their_manual() {
    let dec = Made { order: 85, ..INTEL };
    assert_eq!(dec.f32(1.0), [0x80, 0x40, 0, 0]);
    assert_eq!(dec.f32(-0.5), [0x00, 0xc0, 0, 0]);
}

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
    let e = crate::recording::mocap::c3d::parse(&bytes, Path::new("a.c3d"))
        .unwrap_err()
        .to_string();
    assert!(e.contains("byte 515") && e.contains("processor 99"), "{e}");
}
