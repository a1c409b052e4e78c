//! The sample recordings, which the program holds itself.

use std::path::Path;

use springtwin::recording::write_bytes;

/// Names and contents. A program that reads no recordings has none.
#[cfg(feature = "rrd")]
const SAMPLES: [(&str, &[u8]); 2] = [
    (
        "payload-200g.rrd",
        include_bytes!("../../../../recordings/payload-200g.rrd"),
    ),
    (
        "point-to-point.rrd",
        include_bytes!("../../../../recordings/point-to-point.rrd"),
    ),
];
#[cfg(not(feature = "rrd"))]
const SAMPLES: [(&str, &[u8]); 0] = [];

/// Writes those into a folder that are not there, or there in another size.
pub fn unpack(folder: &Path) -> Result<(), String> {
    for (name, bytes) in SAMPLES {
        let path = folder.join(name);
        let there = std::fs::metadata(&path).is_ok_and(|m| m.len() == bytes.len() as u64);
        if there {
            continue;
        }
        std::fs::create_dir_all(folder)
            .map_err(|e| format!("{} cannot be made: {e}", folder.display()))?;
        write_bytes(&path, bytes).map_err(|e| e.to_string())?;
    }
    Ok(())
}
