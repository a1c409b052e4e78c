//! Recipes of trainings: what is taken passes its check, and its writer's text is taken again.
#![no_main]

#[path = "../../it/parsers/recipe.rs"]
mod recipe;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(text) = std::str::from_utf8(data) {
        recipe::check(text);
    }
});
