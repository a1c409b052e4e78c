//! Faults of what surrounds the program: adapter, display, viewer, clock, a second program.
