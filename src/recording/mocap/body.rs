//! A rigid body from markers alone.
//!
//! The body's shape is that of the first frame in which all of its markers are seen; there its axes are parallel
//! to the world's and its origin is the markers' centroid. In each other frame the pose is the one that
//! takes the shape nearest to the visible markers. With aᵢ the shape, bᵢ the markers, both about
//! their means ā and b̄ over what is visible, and the singular values H = Σ aᵢ bᵢᵀ = U S Vᵀ:
//!
//! R = V diag(1, 1, det(V Uᵀ)) Uᵀ,  t = b̄ − R ā
//!
//! (W. Kabsch, Acta Crystallographica A32, 922 (1976), doi 10.1107/S0567739476001873; the sign after
//! S. Umeyama, IEEE PAMI 13, 376 (1991), doi 10.1109/34.88573). Fewer than three markers, or markers in a line, make a
//! gap.

use nalgebra::{Matrix3, Translation3, Vector3};

use super::file::{MocapFile, MocapMarker, MocapObject, unsupported};
use crate::recording::RecordingError;
use crate::signal::{Pose, nearest_rotation};

/// Markers that lie closer to a line than this (root mean square) do not settle a rotation, m.
const WIDTH_MIN_M: f64 = 1e-3;
/// The same, as a share of how long they stretch.
const WIDTH_MIN_RATIO: f64 = 0.01;

/// Largest root mean square residual of a rigid body's markers, m. Eight markers on a wooden box leave 0.3 mm; those on
/// a person, whose limbs move, 10 mm and more.
const RESIDUAL_MAX_M: f64 = 5e-3;

/// A body that was fitted to markers.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerBody {
    /// Its poses; world from body, m.
    pub object: MocapObject,
    /// The frame number that its shape comes from.
    pub reference_frame: i64,
    /// Root mean square of the distances between markers and fitted shape over all other frames, m.
    /// 0 when there is no other frame.
    pub residual_m: f64,
    /// Each marker on its own, in the order asked for.
    pub markers: Vec<MarkerFit>,
}

/// How well one marker belongs to a body.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerFit {
    /// Name as in the file.
    pub name: String,
    /// Root mean square distance to where the fitted shape has it, m.
    pub residual_m: f64,
    /// Frames in which it was seen.
    pub seen: usize,
}

/// Fits a rigid body to markers of a file. Names are those of the file; the part behind the colon will do
/// where only one marker has it.
///
/// # Errors
/// [`RecordingError::Unsupported`]: a name that no marker or more than one has, fewer than three markers, no
/// frame with all of them, markers in a line, or markers that do not move as one rigid body.
pub fn marker_body(
    file: &MocapFile,
    name: &str,
    markers: &[String],
) -> Result<MarkerBody, RecordingError> {
    let chosen = choose(file, markers)?;
    let refuse = |text: String| unsupported(&file.path, text);
    if chosen.len() < 3 {
        return Err(refuse(format!(
            "a rigid body takes three markers or more, {} were named",
            chosen.len()
        )));
    }
    let at = |m: &MocapMarker, n: usize| m.positions_m.get(n).copied().flatten();
    let whole = (0..file.frames.len()).find(|n| chosen.iter().all(|m| at(m, *n).is_some()));
    let Some(reference) = whole else {
        let least = chosen
            .iter()
            .min_by_key(|m| m.positions_m.iter().flatten().count())
            .map_or("", |m| m.name.as_str());
        return Err(refuse(format!(
            "no frame shows all {} markers: leave out those that are seen least, such as {least}",
            chosen.len()
        )));
    };
    let mut shape: Vec<Vector3<f64>> = chosen.iter().filter_map(|m| at(m, reference)).collect();
    let centroid = mean(&shape);
    shape.iter_mut().for_each(|p| *p -= centroid);
    if !spans_a_plane(&shape) {
        return Err(refuse(
            "these markers lie in a line: choose three that do not".to_owned(),
        ));
    }
    let mut poses = Vec::with_capacity(file.frames.len());
    let mut sums = vec![(0.0, 0_usize); chosen.len()];
    for n in 0..file.frames.len() {
        let seen: Vec<Option<Vector3<f64>>> = chosen.iter().map(|m| at(m, n)).collect();
        let pose = fit(&shape, &seen);
        if let Some(pose) = pose
            && n != reference
        {
            for ((a, b), (sum, count)) in shape.iter().zip(&seen).zip(&mut sums) {
                if let Some(b) = b {
                    *sum += (b - (pose.rotation * a + pose.translation.vector)).norm_squared();
                    *count += 1;
                }
            }
        }
        poses.push(pose);
    }
    let rms = |sum: f64, count: usize| (sum / count.max(1) as f64).sqrt();
    let body = MarkerBody {
        object: MocapObject {
            name: name.to_owned(),
            poses,
        },
        reference_frame: file.frames[reference],
        residual_m: rms(
            sums.iter().map(|(s, _)| s).sum(),
            sums.iter().map(|(_, n)| n).sum(),
        ),
        markers: chosen
            .iter()
            .zip(sums)
            .map(|(m, (sum, count))| MarkerFit {
                name: m.name.clone(),
                residual_m: rms(sum, count),
                seen: m.positions_m.iter().flatten().count(),
            })
            .collect(),
    };
    rigid(&body).map_err(refuse)?;
    Ok(body)
}

/// Whether the markers move as one; the error is a sentence.
fn rigid(body: &MarkerBody) -> Result<(), String> {
    if body.residual_m <= RESIDUAL_MAX_M {
        return Ok(());
    }
    let worst = body
        .markers
        .iter()
        .max_by(|a, b| a.residual_m.total_cmp(&b.residual_m));
    Err(format!(
        "the {} markers of {} are no rigid body: their residual is {:.1} mm (root mean square) and {:.0} mm is the most \
         that is taken{}; name markers that are fixed to one another with --markers, or label the capture again",
        body.markers.len(),
        body.object.name,
        body.residual_m * 1e3,
        RESIDUAL_MAX_M * 1e3,
        worst.map_or(String::new(), |w| format!(
            " (worst: {} with {:.1} mm)",
            w.name,
            w.residual_m * 1e3
        )),
    ))
}

/// The markers of these names, each once.
fn choose<'a>(
    file: &'a MocapFile,
    names: &[String],
) -> Result<Vec<&'a MocapMarker>, RecordingError> {
    let mut chosen: Vec<&MocapMarker> = Vec::new();
    for name in names {
        let exact = file.markers.iter().filter(|m| m.name == *name);
        let behind = file
            .markers
            .iter()
            .filter(|m| m.name.split_once(':').is_some_and(|(_, n)| n == name));
        let mut found: Vec<&MocapMarker> = exact.collect();
        if found.is_empty() {
            found = behind.collect();
        }
        let text = match found[..] {
            [one] if chosen.iter().any(|c| c.name == one.name) => {
                format!("the marker {} is named twice", one.name)
            }
            [one] => {
                chosen.push(one);
                continue;
            }
            [] if file.markers.is_empty() => "the file holds no markers".to_owned(),
            [] => {
                let all: Vec<&str> = file.markers.iter().map(|m| m.name.as_str()).collect();
                format!("there is no marker {name:?}; it has {}", all.join(", "))
            }
            [one, ..] => format!(
                "{} markers are called {name:?}: name the subject too, as in {}",
                found.len(),
                one.name
            ),
        };
        return Err(unsupported(&file.path, text));
    }
    Ok(chosen)
}

fn mean(points: &[Vector3<f64>]) -> Vector3<f64> {
    points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64
}

/// Whether points settle a rotation: three or more, and not in a line.
fn spans_a_plane(points: &[Vector3<f64>]) -> bool {
    if points.len() < 3 {
        return false;
    }
    let centre = mean(points);
    let scatter: Matrix3<f64> = points
        .iter()
        .map(|p| (p - centre) * (p - centre).transpose())
        .sum::<Matrix3<f64>>()
        / points.len() as f64;
    let mut variances: [f64; 3] = scatter.symmetric_eigenvalues().into();
    variances.sort_by(|a, b| b.total_cmp(a));
    let [length_m, width_m] = [variances[0], variances[1]].map(|v| v.max(0.0).sqrt());
    width_m >= WIDTH_MIN_M && width_m >= WIDTH_MIN_RATIO * length_m
}

/// The pose that takes the shape nearest to the markers that are seen; `None` when these do not settle it.
fn fit(shape: &[Vector3<f64>], seen: &[Option<Vector3<f64>>]) -> Option<Pose> {
    let (a, b): (Vec<_>, Vec<_>) = shape
        .iter()
        .zip(seen)
        .filter_map(|(a, b)| Some((*a, (*b)?)))
        .unzip();
    if !spans_a_plane(&a) || !spans_a_plane(&b) {
        return None;
    }
    let (a_mean, b_mean) = (mean(&a), mean(&b));
    // Σ b aᵀ
    let h: Matrix3<f64> = a
        .iter()
        .zip(&b)
        .map(|(a, b)| (b - b_mean) * (a - a_mean).transpose())
        .sum();
    let rotation = nearest_rotation(&h)?;
    let pose = Pose::from_parts(Translation3::from(b_mean - rotation * a_mean), rotation);
    (pose.translation.vector.iter().all(|x| x.is_finite())
        && rotation.coords.iter().all(|x| x.is_finite()))
    .then_some(pose)
}
