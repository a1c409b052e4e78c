//! The virtual rig: an emulated arm with its boards, behind the same wire protocol as hardware.

pub mod plant;
