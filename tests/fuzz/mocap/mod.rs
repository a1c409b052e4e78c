//! What every motion-capture file that is taken keeps.

use std::io::Cursor;
use std::path::Path;

use springtwin::recording::{MocapFile, MocapRotation, parse_mocap};

/// Reads `data`; what is taken has series of one length, rising frames and times, and finite poses in reach.
pub fn check(data: &[u8], rotation: Option<MocapRotation>) -> Option<MocapFile> {
    let read = parse_mocap(
        Cursor::new(data),
        data.len() as u64,
        Path::new("take"),
        rotation,
    );
    let file = match read {
        Ok(file) => file,
        Err(e) => {
            let said = e.to_string();
            assert!(said.starts_with("take"), "{said}");
            return None;
        }
    };
    let n = file.frames.len();
    assert!(n > 0 && file.t_s.len() == n);
    assert!(file.frames.windows(2).all(|w| w[0] < w[1]));
    assert!(
        file.t_s
            .iter()
            .all(|t| t.is_finite() && *t >= 0.0 && *t <= 3e9)
    );
    assert!(file.rate_hz > 0.0 && file.rate_hz <= 100_000.0);
    assert!(!file.objects.is_empty() || !file.markers.is_empty());
    for o in &file.objects {
        assert_eq!(o.poses.len(), n);
        for p in o.poses.iter().flatten() {
            assert!(p.translation.vector.amax() <= 10_000.0, "{p}");
            assert!((p.rotation.quaternion().norm() - 1.0).abs() < 1e-9, "{p}");
        }
        file.gaps(o);
    }
    for m in &file.markers {
        assert_eq!(m.positions_m.len(), n);
        assert!(m.positions_m.iter().flatten().all(|p| p.amax() <= 10_000.0));
    }
    assert!(file.usual_step() >= 1);
    file.subjects();
    Some(file)
}
