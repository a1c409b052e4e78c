//! What the operator asks the arm to do.
