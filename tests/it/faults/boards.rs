//! Faults of boards, sensors, pneumatics and of the line to them.
