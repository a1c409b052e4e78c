//! What every recipe that is taken keeps.

use springtwin::learn::Recipe;

/// Reads `text`: what is taken passes its check, and its writer's text is taken again.
pub fn check(text: &str) {
    let Ok(recipe) = Recipe::from_toml(text) else {
        return;
    };
    recipe.check().expect("what was taken holds");
    let written = recipe.to_toml();
    assert!(!written.is_empty());
    let again = Recipe::from_toml(&written).unwrap_or_else(|e| panic!("{e}\n{written}"));
    assert_eq!((again.seed, &again.smap), (recipe.seed, &recipe.smap));
}
