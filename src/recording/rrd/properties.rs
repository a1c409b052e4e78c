//! Properties of a recording as a whole.

use std::collections::BTreeMap;
use std::path::Path;

use arrow::array::{Array, AsArray};
use rerun::log::Chunk;

use super::schema;
use crate::recording::types::simulated_text;
use crate::recording::{RecordingError, RecordingMeta};
use crate::signal::SensorErrors;

/// Name of the operator's note.
pub(super) const NOTE: &str = "note";

/// Properties of a file, by name.
#[derive(Clone, Debug, Default)]
pub(super) struct Properties {
    texts: BTreeMap<String, String>,
    /// Whether it is a comparison for the viewer.
    is_comparison: bool,
}

impl Properties {
    /// Takes what is known of a static table.
    pub(super) fn take(&mut self, chunk: &Chunk) {
        let path = chunk.entity_path().to_string();
        self.is_comparison |= path == format!("/__properties/{}", schema::COMPARISON);
        if path != format!("/__properties/{}", schema::PROPERTY) {
            return;
        }
        for descriptor in chunk.component_descriptors() {
            let name = descriptor.component.as_str();
            let Some(key) = name.strip_prefix("springtwin:") else {
                continue;
            };
            if let Some(value) = chunk
                .components()
                .get_array(descriptor.component)
                .and_then(|list| list.values().as_string_opt::<i32>())
                .filter(|strings| !strings.is_empty() && strings.is_valid(0))
            {
                self.texts.insert(key.to_owned(), value.value(0).to_owned());
            }
        }
    }

    /// Whether the file's own description is there.
    pub(super) fn are_known(&self) -> bool {
        self.texts.contains_key("schema") || self.is_comparison
    }

    fn text(&self, key: &str) -> String {
        self.texts.get(key).cloned().unwrap_or_default()
    }

    /// Version of the layout.
    ///
    /// # Errors
    /// [`RecordingError::Unsupported`] for a newer one, and for what is no recording of this program.
    pub(super) fn layout(&self, path: &Path) -> Result<u32, RecordingError> {
        let refuse = |text: String| RecordingError::Unsupported {
            path: path.to_owned(),
            text,
        };
        match self.text("schema").parse::<u32>() {
            Ok(version) if (1..=schema::SCHEMA_VERSION).contains(&version) => Ok(version),
            Ok(version) => Err(refuse(format!(
                "the recording has layout {version}, and this program reads layouts up to {}: open it with a newer version \
                 of springtwin",
                schema::SCHEMA_VERSION
            ))),
            Err(_) if self.is_comparison => Err(refuse(
                "this is the comparison that `gap run` writes for the Rerun viewer, not a session: look at it with \
                 `rerun FILE`, and give the session or recording that it was made of"
                    .to_owned(),
            )),
            Err(_) => Err(refuse(
                "the recording was not made by this program, or was cut before its first data".to_owned(),
            )),
        }
    }

    /// The session as a whole.
    pub(super) fn meta(&self) -> RecordingMeta {
        RecordingMeta {
            id: self.text("id"),
            name: self.text("name"),
            robot: self.text("robot"),
            robot_hash: self.text("robot_hash"),
            source: self.text("source"),
            simulated: self.text("simulated").parse().ok(),
            payload_kg: self.text("payload_kg").parse().unwrap_or(0.0),
            begun: self.text("begun"),
            calibration: self.text("calibration"),
            corrected_by: SensorErrors::from_text(&self.text("corrected_by")),
            registration: self.text("registration"),
            networks: self.text("networks"),
            firmware: self.text("firmware"),
            controller: self.text("controller"),
            note: self.text(NOTE),
            program: self.text("program"),
            derived_from: self.text("derived_from"),
            drawing: None,
        }
    }

    /// Takes the note of a later segment.
    pub(super) fn set_note(&mut self, later: &Self) {
        self.texts.insert(NOTE.to_owned(), later.text(NOTE));
    }

    /// Number of the segment, from 1.
    pub(super) fn segment(&self) -> u32 {
        self.text("segment").parse().unwrap_or(1)
    }

    /// The properties of a recording to write: names and texts.
    pub(super) fn of(meta: &RecordingMeta, segment: u32) -> Vec<(&'static str, String)> {
        let simulated = simulated_text(meta.simulated);
        let corrected_by = meta.corrected_by.as_ref().and_then(SensorErrors::text);
        vec![
            ("schema", schema::SCHEMA_VERSION.to_string()),
            ("id", meta.id.clone()),
            ("segment", segment.to_string()),
            ("name", meta.name.clone()),
            ("robot", meta.robot.clone()),
            ("robot_hash", meta.robot_hash.clone()),
            ("source", meta.source.clone()),
            ("simulated", simulated.to_owned()),
            ("payload_kg", meta.payload_kg.to_string()),
            ("begun", meta.begun.clone()),
            ("calibration", meta.calibration.clone()),
            ("corrected_by", corrected_by.unwrap_or_default()),
            ("registration", meta.registration.clone()),
            ("networks", meta.networks.clone()),
            ("firmware", meta.firmware.clone()),
            ("controller", meta.controller.clone()),
            (NOTE, meta.note.clone()),
            ("program", meta.program.clone()),
            ("derived_from", meta.derived_from.clone()),
        ]
    }
}
