use serde::{Deserialize, Deserializer, de::Error};

/// Deserializes a list of exactly `N` values, for `#[serde(deserialize_with = "exactly")]`: serde's own arrays leave
/// what is beyond their length unread.
///
/// # Errors
/// The deserializer's, and when the list is shorter or longer.
pub fn exactly<'de, D, T, const N: usize>(deserializer: D) -> Result<[T; N], D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    let list = Vec::<T>::deserialize(deserializer)?;
    <[T; N]>::try_from(list)
        .map_err(|list| D::Error::custom(format!("{N} values are needed here, not {}", list.len())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_as_long_as_it_must_be() {
        #[derive(Deserialize)]
        struct Pair {
            #[serde(deserialize_with = "exactly")]
            pair: [f64; 2],
        }
        let of = |text: &str| toml::from_str::<Pair>(text).map(|p| p.pair);
        assert_eq!(of("pair = [1, 2.5]").expect("two"), [1.0, 2.5]);
        for (text, found) in [
            ("pair = []", "not 0"),
            ("pair = [1]", "not 1"),
            ("pair = [1, 2, 3]", "not 3"),
        ] {
            let e = of(text).expect_err(text).to_string();
            assert!(
                e.contains("2 values are needed") && e.contains(found),
                "{e}"
            );
        }
        assert!(of("other = 1").is_err(), "a list that is missing");
    }
}
