//! Reading and writing of recordings, session logs, datasets and motion-capture files. It imports `signal`
//! alone and computes nothing of the arm.
//!
//! - Recordings ([`RecordingWriter`], [`read_rrd`]): `.rrd` files that hold whole snapshots, for
//!   replay and for the Rerun viewer. Only the submodule `rrd` knows rerun.
//!   [`Recorder`] writes one on a thread of its own.
//!   [`LiveStream`] sends the same to a viewer that runs.
//!   [`write_overlay`] writes a comparison of a measured and a simulated path, for the viewer alone.
//! - Notes and marks ([`annotate`]) are in a recording, or beside it where they are made afterwards.
//! - The rolling recording ([`RollingFolder`], [`keep_last`]): the last hours of what the arm did.
//! - Session logs ([`read_session`], [`write_session`]): a folder with `session.toml` and `log.csv`.
//! - Logs of other labs ([`LogMap`]), read by a map of their columns.
//! - MCAP files with ROS 2 messages ([`write_mcap`], [`read_mcap`]), and those of other labs by a map of their topics ([`BagMap`]).
//! - [`read_log`] reads the signals of either, [`inspect`] lists their contents.
//! - Motion capture ([`read_mocap`]): tables of Vicon and OptiTrack, and C3D; [`marker_body`] makes a pose of
//!   markers.
//! - Data sets for training ([`read_dataset`], [`DatasetWriter`]): Parquet. [`DatasetJournal`]
//!   keeps what a long run has computed, until its data set is whole.

mod annotate;
mod asu;
mod csv;
mod dataset;
mod either;
mod error;
#[cfg(test)]
pub(crate) mod hostile;
mod imu_log;
mod inspect;
mod journal;
mod live;
mod lock;
mod log;
mod map_units;
mod mapped;
mod mcap;
mod mocap;
mod notes;
mod overlay;
mod parquet_guard;
mod patience;
mod recorder;
mod rolling;
#[cfg(feature = "rrd")]
mod rrd;
#[cfg(not(feature = "rrd"))]
#[path = "rrd_stub.rs"]
mod rrd;
mod segments;
mod session_file;
mod size_limit;
mod space;
mod table;
mod types;
mod units;
mod whole;
mod window;

pub use annotate::{annotate, annotations};
pub use asu::{AsuArmLog, PSI_PA, read_asu_arm};
pub use dataset::{
    DATASET_SAMPLE_BYTES, DatasetWriter, dataset_columns, read_dataset, write_dataset,
};
pub use either::{each_snapshot, is_rrd, is_simulated, part_of, read_log};
pub use error::RecordingError;
pub use imu_log::{ImuSample, read_imu_log};
pub use inspect::{
    ChannelReport, FileHealth, Gap, InspectedKind, InspectedMark, Inspection, Inspector,
    Provenance, inspect, inspect_log,
};
pub use journal::DatasetJournal;
pub use live::LiveStream;
pub use lock::wait_for_lock;
pub use log::{
    SESSION_FILES, SessionLog, parse_log, read_session, read_session_with, session_table,
    write_session, write_session_table,
};
pub use mapped::{LogMap, MappedBodies, MappedLog};
pub use mcap::{
    BagMap, MappedBag, McapSummary, OwnBag, is_mcap, parse_mcap, read_mcap, write_mcap,
    write_session_mcap,
};
pub use mocap::{
    MarkerBody, MarkerFit, MocapFile, MocapFormat, MocapMarker, MocapObject, MocapRotation,
    marker_body, parse_mocap, read_mocap,
};
pub use notes::{MARKS, notes_path};
pub use overlay::{Overlay, TipSeries};
pub use recorder::{QueueFull, Recorder, RecorderState};
pub use rolling::{ROLLING_BYTES, RollingFolder, keep_last};
#[cfg(feature = "rrd")]
pub use rrd::SCHEMA_VERSION;
pub use rrd::{RecordingFile, RecordingWriter, join, read_rrd, write_overlay};
pub use segments::{is_later_segment, segment_path};
pub use session_file::{SessionFile, parse_session_file};
pub use size_limit::{Limited, SizeLimit, file_sha256, size_text};
pub use space::{LOW_SPACE_BYTES, free_bytes};
pub use table::{Table, table_file};
pub use types::{
    ArmDrawing, Channel, ChannelValues, ReadRecording, RecordedEvent, RecordingMeta,
    RecordingSummary, Selection, Thinning,
};
pub use units::suspected_units;
pub use whole::{write_bytes, write_text};
pub use window::Window;

pub use crate::signal::{Annotations, Mark, NoteChange};
