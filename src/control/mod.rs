//! Sensor-space solver, ADRC and reachability.
