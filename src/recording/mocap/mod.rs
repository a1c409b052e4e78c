//! Files of motion-capture systems: poses of objects and positions of markers, SI units.
//!
//! The format is detected from the content of a file, not from its name:
//!
//! | format | read | not read |
//! |---|---|---|
//! | Vicon Nexus, `Trajectories` (CSV) | X, Y, Z per marker | speeds and accelerations |
//! | Vicon, `Segments` (CSV) | RX, RY, RZ helical, deg or rad by the units' row; TX, TY, TZ | |
//! | Vicon Tracker, `Objects` or `Global Angle Subject:Object` (CSV) | RX, RY, RZ (helical or Euler XYZ) or RX, RY, RZ, RW (quaternion); TX, TY, TZ | poses in a parent's frame |
//! | OptiTrack Motive, format version 1.2 and later (CSV) | rigid bodies (quaternion or Euler angles), markers | bones, errors and qualities |
//! | C3D (Intel, DEC and MIPS; float and integer) | labelled points | analogue channels, angles, forces and the like among the points |
//!
//! A helical rotation is a vector: the axis times the angle. Euler angles turn about the object's
//! own moving axes, in the order of their name: XYZ is R = Rx · Ry · Rz.
//!
//! Other sections of a Vicon table (`Devices`, `Model Outputs`, `Joints`, ...) are ignored, with a
//! note. An empty cell, an invalid point and a frame number that is left out are gaps: nothing is
//! filled in. Axes stay those of the file.

mod body;
mod c3d;
mod columns;
mod file;
mod motive;
mod rotation;
mod sections;
mod table;
#[cfg(test)]
mod tests;
mod vicon;

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use super::{RecordingError, SizeLimit};
pub use body::{MarkerBody, MarkerFit, marker_body};
use file::{ACCEPTED, unsupported};
pub use file::{MocapFile, MocapFormat, MocapMarker, MocapObject};
pub use rotation::MocapRotation;

/// Memory that a C3D file takes at most, per byte of it: itself, and 32 bytes for every point of 8.
const C3D_UNPACKED: u64 = 5;

/// Reads a motion-capture file of any of the formats above.
///
/// `rotation` states how a Vicon Tracker file writes three angles, which such a file may leave open;
/// with `None` they are helical.
///
/// # Errors
/// [`RecordingError::Unsupported`] for any other file, one that holds neither objects nor
/// markers, and a `rotation` that the file contradicts; [`RecordingError::Cell`] with line and column for a table,
/// [`RecordingError::Corrupt`] with the byte for C3D, [`RecordingError::Io`] when it cannot be read.
pub fn read_mocap(
    path: &Path,
    rotation: Option<MocapRotation>,
) -> Result<MocapFile, RecordingError> {
    let file = File::open(path).map_err(RecordingError::io(path, "open"))?;
    let about = file.metadata().map_err(RecordingError::io(path, "read"))?;
    if !about.is_file() {
        return Err(unsupported(path, format!("this is no file: {ACCEPTED}")));
    }
    SizeLimit::of_memory().check(path, about.len())?;
    parse_mocap(file, about.len(), path, rotation)
}

/// Reads what a motion-capture file holds, as [`read_mocap`] does: `length` bytes of `file`, which stands
/// at its beginning. `path` is for refusals.
///
/// # Errors
/// As [`read_mocap`].
pub fn parse_mocap(
    mut file: impl Read + Seek,
    length: u64,
    path: &Path,
    rotation: Option<MocapRotation>,
) -> Result<MocapFile, RecordingError> {
    let mut head = Vec::new();
    (&mut file)
        .take(4096)
        .read_to_end(&mut head)
        .map_err(RecordingError::io(path, "read"))?;
    file.rewind().map_err(RecordingError::io(path, "read"))?;
    let limit = SizeLimit::of_memory();
    let read = if c3d::is_c3d(&head) {
        limit.check(path, length.saturating_mul(C3D_UNPACKED))?;
        let mut bytes = Vec::new();
        // A file that grows meanwhile is read as far as it was.
        file.take(length)
            .read_to_end(&mut bytes)
            .map_err(RecordingError::io(path, "read"))?;
        c3d::parse(&bytes, path)?
    } else if motive::is_motive(&head) {
        motive::parse(BufReader::new(file), path)?
    } else {
        vicon::refuse_others(BufReader::new(&mut file), path)?;
        file.rewind().map_err(RecordingError::io(path, "read"))?;
        vicon::parse(BufReader::new(file), path, rotation)?
    };
    match (rotation, read.rotation) {
        (Some(wanted), Some(found)) if wanted != found => Err(unsupported(
            path,
            format!(
                "the file writes rotations as {}, not as {}",
                found.name(),
                wanted.name()
            ),
        )),
        _ => Ok(read),
    }
}
