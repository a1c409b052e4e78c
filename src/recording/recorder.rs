//! stand-in
#![allow(missing_docs)]
use crate::signal::*; use std::path::Path; use std::sync::Arc;
#[derive(Default)] pub struct RecordingMeta { pub name: String, pub robot: String, pub robot_hash: String, pub source: String, pub simulated: bool, pub payload_kg: f64, pub drawing: Option<()> }
pub struct RecordingSummary { pub written: u64, pub dropped: u64 }
pub struct Recorder;
impl Recorder { pub fn start(_p:&Path,_m:RecordingMeta)->Result<Self,super::RecordingError>{Ok(Self)} pub fn push(&self,_s:&Arc<Snapshot>){} pub fn event(&self,_s:Stamp,_t:&str){} pub fn stop(self)->Result<RecordingSummary,super::RecordingError>{Ok(RecordingSummary{written:0,dropped:0})} }
pub struct ReadRecording { pub trace: Trace } pub fn read_rrd(p:&Path)->Result<ReadRecording,super::RecordingError>{ Err(super::RecordingError::WithoutRrd{path:p.to_owned()}) }
