//! Recipes of trainings: what is taken passes its check, and its writer's text is taken again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use springtwin::learn::Recipe;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let Ok(recipe) = Recipe::from_toml(text) else {
        return;
    };
    recipe.check().expect("what was taken holds");
    let written = recipe.to_toml();
    assert!(!written.is_empty());
    let again = Recipe::from_toml(&written).unwrap_or_else(|e| panic!("{e}\n{written}"));
    assert_eq!((again.seed, &again.smap), (recipe.seed, &recipe.smap));
});
