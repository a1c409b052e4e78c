//! Studies: the paper's tables and figures on sensing and control, made again on the virtual rig.
//!
//! Every study trains the networks it compares on simulated samples and scores it on the rig, which is another
//! simulator with sensors of its own. Figures are over the test units ([`crate::lab::units`]), to which nothing is
//! fitted but what a lab would calibrate: the curves of the springs, and sim-to-real networks with their stated
//! uncertainties from a motion-capture session; motions are new. The paper's figures, from hardware, stand beside ours.
//!
//! A study consists of items that do not need each other (a training, a condition, a candidate), and a
//! table that is made of their findings. A shard does a contiguous range of the items of all studies asked for.
//! A new study is a file with its [`Study`] and a line in [`STUDIES`].

mod bound;
mod conditions;
mod control;
mod coverage;
mod faults;
mod heading;
mod item;
mod list;
mod networks;
mod options;
mod paper;
mod parts;
mod report;
mod run;
mod samples;
mod scores;
mod sensing;
mod setup;

pub use item::{Figures, Found, Study};
pub use list::STUDIES;
pub use options::{Options, Selection};
pub use parts::Merge;
pub use run::run;
pub use setup::{Setup, Sizes};
