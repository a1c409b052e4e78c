//! Integration tests: one binary, one module per subject.

mod calibrate;
mod conformance;
mod dataset;
mod edges;
mod examples;
mod faults;
#[cfg(unix)]
mod firmware;
#[cfg(unix)]
mod gap_bench;
mod gap_experiment;
mod gap_find;
mod gap_watch;
mod guide;
mod lockstep;
#[cfg(feature = "rrd")]
mod mcap;
mod notes;
mod outputs;
mod parsers;
mod process;
mod program;
#[cfg(unix)]
mod readme;
mod real_data;
#[cfg(target_os = "linux")]
mod realtime;
#[cfg(unix)]
mod rig_link;
mod robots;
mod safety;
mod shaders;
#[cfg(all(unix, feature = "rrd"))]
mod stream;
mod under_load;
mod window;
mod words;
mod written;
