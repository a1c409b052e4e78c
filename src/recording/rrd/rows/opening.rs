//! The messages that a recording begins with: identity, properties, styles, layout.

use rerun::log::LogMsg;
use rerun::{DynamicArchetype, RecordingStreamBuilder, StoreId};

use super::tables::text_column;
use crate::recording::RecordingMeta;
use crate::recording::rrd::blueprint::{Shown, layout};
use crate::recording::rrd::error::BatchError;
use crate::recording::rrd::scene::log_styles;
use crate::recording::rrd::schema::{self, SPECS, Spec};

/// The messages that come first: identity, properties, styles, layout.
pub(super) fn opening(
    meta: &RecordingMeta,
    shown: Shown,
) -> Result<(StoreId, Vec<LogMsg>), BatchError> {
    let (stream, storage) = RecordingStreamBuilder::new(schema::APPLICATION)
        .enabled(true)
        .recording_name(meta.name.clone())
        .memory()?;
    let simulated = match meta.simulated {
        Some(true) => "true",
        Some(false) => "false",
        None => "unknown",
    };
    let property = DynamicArchetype::new(schema::PREFIX)
        .with_component_from_data("schema", text_column(&schema::SCHEMA_VERSION.to_string()))
        .with_component_from_data("name", text_column(&meta.name))
        .with_component_from_data("robot", text_column(&meta.robot))
        .with_component_from_data("robot_hash", text_column(&meta.robot_hash))
        .with_component_from_data("source", text_column(&meta.source))
        .with_component_from_data("simulated", text_column(simulated))
        .with_component_from_data("payload_kg", text_column(&meta.payload_kg.to_string()))
        .with_component_from_data("begun", text_column(&meta.begun))
        .with_component_from_data("calibration", text_column(&meta.calibration))
        .with_component_from_data("program", text_column(env!("CARGO_PKG_VERSION")));
    stream.send_property(schema::PROPERTY, &property)?;
    log_styles(&stream, meta.drawing.as_ref())?;
    for spec in SPECS.iter().filter(|s| s.scalars > 1) {
        let names = series_names(spec);
        let style = rerun::SeriesLines::update_fields()
            .with_names(names)
            .with_colors(series_colours(spec))
            .with_widths(vec![series_width(spec); spec.scalars]);
        stream.log_static(spec.path, &style)?;
    }
    // With rerun switched off in the environment there is no layout to be had; data go on.
    let layout = match rerun::decide_logging_enabled(true) {
        true => layout(shown)?,
        false => Vec::new(),
    };
    let store_id = match stream.store_info() {
        Some(info) => info.store_id,
        None => StoreId::random(rerun::StoreKind::Recording, schema::APPLICATION),
    };
    let mut messages = storage.take();
    // A stream that keeps its messages holds on to itself, and to two threads, until it is disconnected.
    stream.disconnect();
    messages.extend(layout);
    Ok((store_id, messages))
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
        assert_eq!(SPECS[table::TICK].exact_path, "/tick");
    }
}
