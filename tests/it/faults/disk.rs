//! Faults of the disk and of the program that records to it.
#![cfg(target_os = "linux")]

mod full;
pub mod killed;
mod soak;
