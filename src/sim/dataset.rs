//! Settled samples drawn over the actuator space.
