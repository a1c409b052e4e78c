//! From counts to lengths, from rates to orientations.
