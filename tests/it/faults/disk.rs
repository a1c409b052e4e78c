//! Faults of the disk and of the program that records to it.
