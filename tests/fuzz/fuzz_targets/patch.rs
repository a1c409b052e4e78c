//! Patches: what is taken is finite and survives its writer.
#![no_main]

use libfuzzer_sys::fuzz_target;
use springtwin::gap::Patch;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let patch = match Patch::from_toml(text) {
        Ok(patch) => patch,
        Err(e) => {
            let said = e.to_string();
            assert!(!said.is_empty() && !said.contains('\n'), "{said}");
            return;
        }
    };
    assert!(
        patch
            .values()
            .expect("checked")
            .iter()
            .all(|v| v.is_finite())
    );
    patch.active().expect("checked");
    let written = patch.to_toml();
    let again = Patch::from_toml(&written).unwrap_or_else(|e| panic!("{e}\n{written}"));
    assert_eq!(again.to_toml(), written);
});
