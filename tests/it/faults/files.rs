//! Files that are cut, damaged, hostile or of the wrong units.
