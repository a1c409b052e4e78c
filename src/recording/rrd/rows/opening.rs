//! The messages that a recording begins with: identity, properties, styles, layout.

use rerun::external::re_log_types::{SetStoreInfo, StoreInfo, StoreSource};
use rerun::external::re_tuid::Tuid;
use rerun::log::{Chunk, ChunkId, LogMsg, RowId};
use rerun::{
    AsComponents as _, DynamicArchetype, SerializedComponentBatch, StoreId, StoreKind, TimePoint,
};

use super::tables::text_column;
use crate::recording::RecordingMeta;
use crate::recording::rrd::blueprint::{Shown, layout};
use crate::recording::rrd::error::BatchError;
use crate::recording::rrd::properties::{NOTE, Properties};
use crate::recording::rrd::scene::styles;
use crate::recording::rrd::schema::{self, SPECS, Spec};

/// Numbers of the messages of notes begin here, behind those of what comes first.
const NOTES_FROM: u64 = 1000;

/// Which recording it is, for viewers: its segments are one.
pub(in crate::recording::rrd) fn store_id(meta: &RecordingMeta) -> StoreId {
    StoreId::recording(schema::APPLICATION, meta.id.as_str())
}

/// The messages that come first: identity, properties, then what the arm and the plots look like. That can be given, by the
/// recording that this one is made of: a new layout has an identity of its own each time.
pub(in crate::recording::rrd) fn opening(
    meta: &RecordingMeta,
    segment: u32,
    shown: Shown,
    given: Option<&[LogMsg]>,
) -> Result<Vec<LogMsg>, BatchError> {
    let store = store_id(meta);
    let source = StoreSource::Other(schema::APPLICATION.to_owned());
    let mut messages = vec![LogMsg::SetStoreInfo(SetStoreInfo {
        row_id: Tuid::from_nanos_and_inc(0, 0),
        info: StoreInfo::new(store.clone(), source),
    })];
    let mut property = DynamicArchetype::new(schema::PREFIX);
    for (name, text) in Properties::of(meta, segment) {
        property = property.with_component_from_data(name, text_column(&text));
    }
    let entities = vec![
        (
            "/__properties".to_owned(),
            rerun::archetypes::RecordingInfo::new()
                .with_name(meta.name.clone())
                .as_serialized_batches(),
        ),
        (
            format!("/__properties/{}", schema::PROPERTY),
            property.as_serialized_batches(),
        ),
    ];
    for (i, (path, batches)) in entities.into_iter().enumerate() {
        messages.push(fixed(&store, i as u64 + 1, path, batches)?);
    }
    match given {
        Some(looks) => messages.extend(looks.iter().map(|message| match message {
            LogMsg::ArrowMsg(of, arrow) if of.kind() == StoreKind::Recording => {
                LogMsg::ArrowMsg(store.clone(), arrow.clone())
            }
            other => other.clone(),
        })),
        None => messages.extend(looks(meta, &store, shown)?),
    }
    Ok(messages)
}

/// What the arm, the plots and the viewer look like.
fn looks(meta: &RecordingMeta, store: &StoreId, shown: Shown) -> Result<Vec<LogMsg>, BatchError> {
    let styles = styles(meta.drawing.as_ref()).into_iter();
    let mut entities: Vec<_> = styles
        .map(|(path, batches)| (path.to_owned(), batches))
        .collect();
    for spec in SPECS.iter().filter(|s| s.scalars > 1) {
        let style = rerun::SeriesLines::update_fields()
            .with_names(series_names(spec))
            .with_colors(series_colours(spec))
            .with_widths(vec![series_width(spec); spec.scalars]);
        entities.push((spec.path.to_owned(), style.as_serialized_batches()));
    }
    let mut messages = Vec::new();
    for (i, (path, batches)) in entities.into_iter().enumerate() {
        messages.push(fixed(store, i as u64 + 100, path, batches)?);
    }
    // With rerun switched off in the environment there is no layout to be had; data go on.
    if rerun::decide_logging_enabled(true) {
        messages.extend(layout(shown)?);
    }
    Ok(messages)
}

/// The message of another note; `number` counts those of a recording.
pub(in crate::recording::rrd) fn noted(
    meta: &RecordingMeta,
    number: u64,
) -> Result<LogMsg, BatchError> {
    let note = text_column(&meta.note);
    let property = DynamicArchetype::new(schema::PREFIX).with_component_from_data(NOTE, note);
    let path = format!("/__properties/{}", schema::PROPERTY);
    let batches = property.as_serialized_batches();
    fixed(&store_id(meta), NOTES_FROM + number, path, batches)
}

/// A message of what does not change.
fn fixed(
    store: &StoreId,
    number: u64,
    path: String,
    batches: Vec<SerializedComponentBatch>,
) -> Result<LogMsg, BatchError> {
    let id = Tuid::from_nanos_and_inc(0, number);
    let chunk = Chunk::builder_with_id(ChunkId::from_tuid(id), path)
        .with_serialized_batches(RowId::from_tuid(id), TimePoint::default(), batches)
        .build()?;
    Ok(LogMsg::ArrowMsg(store.clone(), chunk.to_arrow_msg()?))
}

/// Names of an entity's plotted series.
pub(super) fn series_names(spec: &Spec) -> Vec<String> {
    let what = spec.path.rsplit('/').next().unwrap_or_default();
    let numbered = |name: &str, n: usize| (1..=n).map(|i| format!("{name} {i}")).collect();
    let group = spec.path.split('/').nth(1).unwrap_or_default();
    match (group, what, spec.scalars) {
        (_, "position_mm", _) => {
            let whose = spec.path.trim_end_matches("/position_mm");
            let whose = whose.rsplit('/').next().unwrap_or_default();
            ["x", "y", "z"].map(|a| format!("{whose} {a}")).into()
        }
        (_, "ypr_deg", _) => ["yaw", "pitch", "roll"].map(str::to_owned).into(),
        (_, "imu_deg" | "imu_ref_deg", _) => (1..=4)
            .flat_map(|i| ["yaw", "pitch", "roll"].map(|a| format!("imu {i} {a}")))
            .collect(),
        (_, "gyro_rad_s" | "accel_m_s2", _) => (1..=4)
            .flat_map(|i| ["x", "y", "z"].map(|a| format!("imu {i} {a}")))
            .collect(),
        (_, "set_kpa", n) => numbered("set", n),
        (_, _, 6) => numbered("chamber", 6),
        (_, _, n) => numbered("spring", n),
    }
}

/// Six colours that colour-blind readers can distinguish, too.
const SIX: [u32; 6] = [
    0x4c9b_e8ff,
    0xe69f_00ff,
    0x2fbf_8fff,
    0xe45f_28ff,
    0xcc79_a7ff,
    0xf0e4_42ff,
];

/// Colours of an entity's plotted series: one for each chamber, pair of springs, axis.
pub(super) fn series_colours(spec: &Spec) -> Vec<rerun::Color> {
    let each = match spec.scalars {
        12 if spec.path.contains("spring") || spec.path.contains("gate") => 2,
        _ => 1,
    };
    let first = match spec.path {
        path if path.starts_with("/tip/predicted") => 0,
        path if path.starts_with("/tip/vicon") => 3,
        _ => 0,
    };
    let whose = |i: usize| match spec.scalars {
        3 => SIX[first + i],
        _ => SIX[(i / each) % SIX.len()],
    };
    (0..spec.scalars)
        .map(|i| match spec.path {
            "/goal/position_mm" => rerun::Color::from_u32(0xb4b9_c0ff),
            _ => rerun::Color::from_u32(whose(i)),
        })
        .collect()
}

/// Line width of a series: commanded values are thinner than measured ones.
fn series_width(spec: &Spec) -> f32 {
    let commanded = spec.path.contains("set_") || spec.path.contains("_ref_");
    if commanded { 0.8 } else { 1.6 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::rrd::schema::table;

    #[test]
    fn series_are_named() {
        for s in &SPECS {
            if s.scalars > 1 {
                assert_eq!(series_names(s).len(), s.scalars, "{}", s.path);
                assert_eq!(series_colours(s).len(), s.scalars, "{}", s.path);
            }
        }
        assert_eq!(series_names(&SPECS[table::VICON])[0], "vicon x");
    }
}
