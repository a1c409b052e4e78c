//! A comparison as a recording: three ways of the tip in 3D, and plots beside them.
//!
//! | entity | holds |
//! |---|---|
//! | `/tip/{measured,before,after}` | pose of the tip with its axes, m |
//! | `/way/{measured,before,after}` | the whole way as a line, m |
//! | `/position/{x,y,z}_mm/{measured,before,after}` | scalars |
//! | `/residual/GROUP/{before,after}` | scalars, one series per channel of the group |

use std::fs::File;
use std::path::Path;

use rerun::blueprint::{
    Blueprint, ContainerLike, Horizontal, Spatial3DView, Tabs, TimePanel, TimeSeriesView, Vertical,
};
use rerun::external::re_log_encoding::rrd::{CrateVersion, Encoder, EncodingOptions};
use rerun::log::{Chunk, LogMsg};
use rerun::{
    DynamicArchetype, EntityPath, LineStrips3D, RecordingStream, RecordingStreamBuilder, Scalars,
    SerializedComponentColumn, SeriesLines, StoreId, TextDocument, TimeColumn, Transform3D,
};

use super::error::BatchError;
use super::rows::text_column;
use super::schema;
use crate::recording::{Overlay, RecordingError, TipSeries};

/// Colours of the series, as in the program: neutral, vermilion, blue.
const SERIES: [(&str, u32); 3] = [
    ("measured", 0xb4b9_c0ff),
    ("before", 0xe45f_28ff),
    ("after", 0x56b4_e9ff),
];

/// Writes a comparison, replacing a file of that name.
///
/// # Errors
/// [`RecordingError::Unsupported`] when the series differ in length or the times do not rise,
/// [`RecordingError::Io`] when the file cannot be made, [`RecordingError::Write`] when it takes no more.
pub fn write_overlay(path: &Path, overlay: &Overlay) -> Result<(), RecordingError> {
    overlay.check(path)?;
    let file = File::create(path).map_err(RecordingError::io(path, "create"))?;
    write(file, overlay).map_err(|e| RecordingError::Write {
        path: path.to_owned(),
        source: e.into(),
    })
}

fn write(file: File, overlay: &Overlay) -> Result<(), BatchError> {
    let (store_id, mut messages) = opening(overlay)?;
    messages.extend(rows(overlay, &store_id)?);
    let options = EncodingOptions::PROTOBUF_COMPRESSED;
    let mut encoder = Encoder::new_eager(CrateVersion::LOCAL, options, file)?;
    for message in &messages {
        encoder.append(message)?;
    }
    encoder.finish()?;
    encoder.flush_blocking()?;
    Ok(())
}

/// Channels of the same first word, with their places.
fn groups(channels: &[String]) -> Vec<(String, Vec<usize>)> {
    let mut groups: Vec<(String, Vec<usize>)> = Vec::new();
    for (i, channel) in channels.iter().enumerate() {
        let word = channel.split(' ').next().unwrap_or_default().to_lowercase();
        match groups.iter_mut().find(|(w, _)| *w == word) {
            Some((_, members)) => members.push(i),
            None => groups.push((word, vec![i])),
        }
    }
    groups
}

fn of(overlay: &Overlay, series: usize) -> TipSeriesOwned {
    let TipSeries {
        position_m,
        turn_wxyz,
    } = [overlay.measured, overlay.before, overlay.after][series];
    let mut tips = TipSeriesOwned::default();
    for (i, p) in position_m.iter().enumerate() {
        let q = turn_wxyz.get(i).copied().unwrap_or([1.0, 0.0, 0.0, 0.0]);
        let sound = p.iter().chain(&q).all(|v| v.is_finite());
        tips.poses.push(sound.then(|| {
            let q = [q[1], q[2], q[3], q[0]].map(|v| v as f32);
            (p.map(|v| v as f32), q)
        }));
    }
    tips
}

#[derive(Default)]
struct TipSeriesOwned {
    /// Position and quaternion x, y, z, w; `None` for a gap.
    poses: Vec<Option<([f32; 3], [f32; 4])>>,
}

/// What does not change: identity, styles, whole ways, layout.
fn opening(overlay: &Overlay) -> Result<(StoreId, Vec<LogMsg>), BatchError> {
    let (stream, storage) = RecordingStreamBuilder::new(schema::APPLICATION)
        .enabled(true)
        .recording_name(overlay.name)
        .memory()?;
    let property = DynamicArchetype::new(schema::PREFIX)
        .with_component_from_data("name", text_column(overlay.name))
        .with_component_from_data("simulated", text_column(&overlay.simulated.to_string()))
        .with_component_from_data("program", text_column(env!("CARGO_PKG_VERSION")));
    stream.send_property(schema::COMPARISON, &property)?;
    stream.log_static("/", &rerun::ViewCoordinates::RIGHT_HAND_Z_UP())?;
    for (i, (name, rgba)) in SERIES.into_iter().enumerate() {
        let colour = rerun::Color::from_u32(rgba);
        let tips = of(overlay, i);
        let strips: Vec<Vec<[f32; 3]>> = tips
            .poses
            .split(Option::is_none)
            .map(|piece| piece.iter().flatten().map(|(p, _)| *p).collect::<Vec<_>>())
            .filter(|piece| piece.len() > 1)
            .collect();
        let n = strips.len();
        let way = LineStrips3D::new(strips)
            .with_colors(vec![colour; n])
            .with_radii(vec![rerun::Radius::new_ui_points(1.5); n]);
        stream.log_static(format!("/way/{name}"), &way)?;
        stream.log_static(format!("/tip/{name}"), &rerun::TransformAxes3D::new(0.04))?;
        for axis in ["x", "y", "z"] {
            let style = SeriesLines::update_fields()
                .with_names([format!("{axis} {name}")])
                .with_colors([colour]);
            stream.log_static(format!("/position/{axis}_mm/{name}"), &style)?;
        }
    }
    for (group, members) in groups(overlay.channels) {
        for when in ["before", "after"] {
            let names = members
                .iter()
                .map(|c| format!("{} {when}", overlay.channels[*c]));
            let style = SeriesLines::update_fields().with_names(names);
            stream.log_static(format!("/residual/{group}/{when}"), &style)?;
        }
    }
    stream.log_static("/about", &TextDocument::from_markdown(about(overlay)))?;
    // With rerun switched off in the environment there is no layout to be had; data go on.
    if rerun::decide_logging_enabled(true) {
        layout(overlay).send(&stream, Default::default())?;
    }
    let messages = storage.take();
    // A stream that keeps its messages holds on to itself until it is disconnected.
    stream.disconnect();
    Ok((store_of(&stream), messages))
}

fn store_of(stream: &RecordingStream) -> StoreId {
    stream.store_info().map_or_else(
        || StoreId::random(rerun::StoreKind::Recording, schema::APPLICATION),
        |info| info.store_id,
    )
}

fn about(overlay: &Overlay) -> String {
    let simulated = if overlay.simulated {
        "The measured series come from the virtual rig: they are **simulated**.\n\n"
    } else {
        ""
    };
    format!(
        "# {}\n\n{simulated}Grey: measured. Orange: simulated without the effect. Blue: simulated with \
         it. Residuals are in {}.\n",
        overlay.name, overlay.residual_unit
    )
}

/// The ways in 3D, positions and residuals beside them.
fn layout(overlay: &Overlay) -> Blueprint {
    let plot = |name: String, contents: String| -> ContainerLike {
        TimeSeriesView::new(name)
            .with_origin("/")
            .with_contents([contents])
            .into()
    };
    let way = Spatial3DView::new("Way of the tip")
        .with_origin("/")
        .with_contents(["+ /way/**", "+ /tip/**"])
        .into();
    let about = rerun::blueprint::TextDocumentView::new("About")
        .with_origin("/about")
        .into();
    let left = Vertical::new([way, about])
        .with_row_shares([5.0, 1.0])
        .into();
    let positions: Vec<ContainerLike> = ["x", "y", "z"]
        .into_iter()
        .map(|a| plot(format!("{a}, mm"), format!("+ /position/{a}_mm/**")))
        .collect();
    let mut right: Vec<ContainerLike> = vec![Vertical::new(positions).into()];
    let tabs: Vec<ContainerLike> = groups(overlay.channels)
        .into_iter()
        .map(|(group, _)| {
            let pair = ["before", "after"].map(|when| {
                plot(
                    format!("Residuals {when}, {group}, in {}", overlay.residual_unit),
                    format!("+ /residual/{group}/{when}"),
                )
            });
            Vertical::new(pair).with_name(group).into()
        })
        .collect();
    if !tabs.is_empty() {
        right.push(Tabs::new(tabs).into());
    }
    Blueprint::new(
        Horizontal::new([left, Vertical::new(right).into()]).with_column_shares([1.0, 1.0]),
    )
    .with_auto_views(false)
    .with_auto_layout(false)
    .with_time_panel(TimePanel::new().with_timeline(schema::TIMELINE))
}

/// What changes over time.
fn rows(overlay: &Overlay, store_id: &StoreId) -> Result<Vec<LogMsg>, BatchError> {
    let times: Vec<i64> = overlay
        .t_s
        .iter()
        .map(|t| (t * 1e9).round() as i64)
        .collect();
    let mut messages = Vec::new();
    if times.is_empty() {
        return Ok(messages);
    }
    let mut send = |path: String, times: Vec<i64>, columns: Columns| -> Result<(), BatchError> {
        let time = TimeColumn::new_duration_nanos(schema::TIMELINE, times);
        let columns = columns.into_iter().map(|c| (c.descriptor, c.list_array));
        let chunk = Chunk::from_columns(EntityPath::from(path), [time], columns)?;
        messages.push(LogMsg::ArrowMsg(store_id.clone(), chunk.to_arrow_msg()?));
        Ok(())
    };
    for (i, (name, _)) in SERIES.into_iter().enumerate() {
        let tips = of(overlay, i);
        let (t, poses): (Vec<i64>, Vec<_>) = times
            .iter()
            .zip(&tips.poses)
            .filter_map(|(t, p)| p.map(|p| (*t, p)))
            .unzip();
        if t.is_empty() {
            continue;
        }
        let transform = Transform3D::update_fields()
            .with_many_translation(poses.iter().map(|p| p.0))
            .with_many_quaternion(poses.iter().map(|p| rerun::Quaternion::from_xyzw(p.1)));
        let columns = transform.columns_of_unit_batches()?.collect();
        send(format!("/tip/{name}"), t, columns)?;
    }
    for (a, axis) in ["x", "y", "z"].into_iter().enumerate() {
        for (i, (name, _)) in SERIES.into_iter().enumerate() {
            let series = [overlay.measured, overlay.before, overlay.after][i];
            // A gap is written as NaN, so that no line is drawn across it.
            let mm = series.position_m.iter().map(|p| 1e3 * p[a]);
            let columns = Scalars::new(mm).columns_of_unit_batches()?.collect();
            send(
                format!("/position/{axis}_mm/{name}"),
                times.clone(),
                columns,
            )?;
        }
    }
    for (group, members) in groups(overlay.channels) {
        for (when, rows) in [
            ("before", overlay.residual_before),
            ("after", overlay.residual_after),
        ] {
            let values = (0..times.len()).flat_map(|k| members.iter().map(move |c| rows[*c][k]));
            let columns = Scalars::new(values)
                .columns(std::iter::repeat_n(members.len(), times.len()))?
                .collect();
            send(format!("/residual/{group}/{when}"), times.clone(), columns)?;
        }
    }
    Ok(messages)
}

type Columns = Vec<SerializedComponentColumn>;

#[cfg(test)]
mod tests {
    use rerun::StoreKind;
    use rerun::external::re_log_encoding::rrd::DecoderApp;

    use super::*;

    struct Data {
        t_s: Vec<f64>,
        position_m: Vec<[f64; 3]>,
        turn_wxyz: Vec<[f64; 4]>,
        channels: Vec<String>,
        rows: Vec<Vec<f64>>,
    }

    fn data() -> Data {
        let t_s: Vec<f64> = (0..300).map(|i| 0.1 * f64::from(i)).collect();
        let mut position_m: Vec<[f64; 3]> = t_s
            .iter()
            .map(|t| [0.1 * (0.4 * t).cos(), 0.1 * (0.4 * t).sin(), -0.3])
            .collect();
        position_m[100..110].fill([f64::NAN; 3]);
        let channels = ["tip x", "tip y", "spring 1", "IMU 1 x", "IMU 1 y"].map(str::to_owned);
        Data {
            turn_wxyz: t_s
                .iter()
                .map(|t| [(0.1 * t).cos(), 0.0, 0.0, (0.1 * t).sin()])
                .collect(),
            rows: (0..channels.len())
                .map(|c| t_s.iter().map(|t| (t + c as f64).sin()).collect())
                .collect(),
            channels: channels.to_vec(),
            position_m,
            t_s,
        }
    }

    fn overlay(d: &Data) -> Overlay<'_> {
        let tip = TipSeries {
            position_m: &d.position_m,
            turn_wxyz: &d.turn_wxyz,
        };
        Overlay {
            name: "payload",
            simulated: true,
            t_s: &d.t_s,
            measured: tip,
            before: tip,
            after: TipSeries {
                turn_wxyz: &[],
                ..tip
            },
            channels: &d.channels,
            residual_before: &d.rows,
            residual_after: &d.rows,
            residual_unit: "floors",
        }
    }

    fn scratch(name: &str) -> std::path::PathBuf {
        std::env::temp_dir().join(format!("springtwin-overlay-{}-{name}", std::process::id()))
    }

    #[test]
    fn every_series_arrives() {
        let d = data();
        let path = scratch("whole.rrd");
        write_overlay(&path, &overlay(&d)).expect("writes");
        let bytes = std::fs::read(&path).expect("reads");
        std::fs::remove_file(&path).expect("removes");
        let mut decoder = DecoderApp::new();
        decoder.push_byte_chunk(bytes);
        let mut seen = std::collections::BTreeMap::new();
        while let Some(message) = decoder.try_read().expect("decodes") {
            if let LogMsg::ArrowMsg(store, arrow) = message
                && store.kind() == StoreKind::Recording
            {
                let chunk = Chunk::from_arrow_msg(&arrow).expect("is a chunk");
                if !chunk.is_static() {
                    seen.insert(chunk.entity_path().to_string(), chunk.num_rows());
                }
            }
        }
        let n = d.t_s.len();
        for series in ["measured", "before", "after"] {
            assert_eq!(seen[&format!("/tip/{series}")], n - 10);
            for axis in ["x", "y", "z"] {
                assert_eq!(seen[&format!("/position/{axis}_mm/{series}")], n);
            }
        }
        for group in ["tip", "spring", "imu"] {
            assert_eq!(seen[&format!("/residual/{group}/before")], n);
            assert_eq!(seen[&format!("/residual/{group}/after")], n);
        }
        assert_eq!(seen.len(), 3 + 9 + 6);
    }

    #[test]
    fn series_that_do_not_fit_are_refused() {
        let d = data();
        let path = scratch("refused.rrd");
        let short = &d.position_m[1..];
        let mut o = overlay(&d);
        o.before.position_m = short;
        let e = write_overlay(&path, &o).expect_err("short").to_string();
        assert!(e.contains("300 times, but 299 positions"), "{e}");
        let mut o = overlay(&d);
        o.residual_after = &d.rows[1..];
        assert!(write_overlay(&path, &o).is_err());
        let mut o = overlay(&d);
        let backwards: Vec<f64> = d.t_s.iter().rev().copied().collect();
        o.t_s = &backwards;
        assert!(write_overlay(&path, &o).is_err());
        assert!(!path.exists());
    }
}
