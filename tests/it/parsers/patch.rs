//! What every patch that is taken keeps.

use springtwin::gap::Patch;

/// Reads `text`: what is refused gets one sentence, what is taken is finite and survives its writer.
pub fn check(text: &str) {
    let patch = match Patch::from_toml(text) {
        Ok(patch) => patch,
        Err(e) => {
            let said = e.to_string();
            assert!(!said.is_empty() && !said.contains('\n'), "{said}");
            return;
        }
    };
    let values = patch.values().expect("checked");
    assert!(values.iter().all(|v| v.is_finite()), "{values:?}");
    patch.active().expect("checked");
    let written = patch.to_toml();
    let again = Patch::from_toml(&written).unwrap_or_else(|e| panic!("{e}\n{written}"));
    assert_eq!(again.to_toml(), written);
}
