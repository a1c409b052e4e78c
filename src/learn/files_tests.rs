use std::ops::ControlFlow;
use std::sync::OnceLock;

use proptest::prelude::*;

use super::*;
use crate::learn::{PlantMap, PoseMap, synthetic, train};

/// A tiny model, trained once for all tests of this file.
fn model() -> &'static (Model, Vec<u8>) {
    static MODEL: OnceLock<(Model, Vec<u8>)> = OnceLock::new();
    MODEL.get_or_init(|| {
        let mut recipe = Recipe {
            members: 2,
            guess_samples: 20,
            ..Recipe::default()
        };
        for s in [&mut recipe.smap, &mut recipe.s2r, &mut recipe.plant] {
            s.hidden = vec![8];
            s.epochs = 2;
        }
        let (sim, real) = (synthetic::dataset(100, 1), synthetic::dataset(60, 2));
        let model = train(&sim, Some(&real), &recipe, &mut |_| {
            ControlFlow::Continue(())
        })
        .expect("it trains");
        let bytes = model.to_bytes().expect("it serialises");
        (model, bytes)
    })
}

#[test]
fn a_model_survives_the_round_trip() {
    let (model, bytes) = model();
    let read = Model::from_bytes(bytes).expect("our own bytes");
    assert_eq!(read.cascade.parts(), model.cascade.parts());
    assert_eq!(read.plant.net(), model.plant.net());
    assert_eq!(read.plant.bounds(), model.plant.bounds());
    assert_eq!(read.guess, model.guess);
    // JSON may move the last bit of a score.
    let (a, b) = (&read.scores.smap, &model.scores.smap);
    assert_eq!(a.data, b.data);
    assert!((a.test.translation_mm.p95 - b.test.translation_mm.p95).abs() < 1e-9);
    assert!(read.scores.s2r.is_some());
    assert_eq!(read.recipe.smap, model.recipe.smap);
    let sample = &synthetic::dataset(1, 9).samples[0];
    let s = sample.sensors.to_vector();
    assert_eq!(read.cascade.pose(&s), model.cascade.pose(&s));
    let (a, b) = (&read.plant, &model.plant);
    assert_eq!(
        a.sensors(&sample.chamber_pa, 0.1),
        b.sensors(&sample.chamber_pa, 0.1)
    );
}

#[test]
fn a_model_with_one_of_the_sim_to_real_networks_survives_the_round_trip() {
    let (model, _) = model();
    let rotation = synthetic_net();
    for correction in [
        Correction {
            translation: None,
            rotation: Some(rotation.clone()),
        },
        Correction {
            translation: Some(rotation),
            rotation: None,
        },
    ] {
        let mut parts = model.cascade.parts().clone();
        parts.correction = correction.clone();
        let one = Model {
            cascade: Cascade::new(parts).expect("same shapes"),
            ..model.clone()
        };
        let bytes = one.to_bytes().expect("it serialises");
        let read = Model::from_bytes(&bytes).expect("our own bytes");
        assert_eq!(read.cascade.parts().correction, correction);
    }
}

/// A network of a correction's shape.
fn synthetic_net() -> Mlp {
    use rand::SeedableRng;
    let scaling = |n| Scaling {
        mean: vec![0.0; n],
        std: vec![1.0; n],
    };
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(4);
    Mlp::random(vec![6, 8, 3], scaling(6), scaling(3), &mut rng)
}

#[test]
fn reports_of_earlier_versions_kept_both_networks_or_none() {
    use crate::learn::Kept;
    let both: Kept = serde_json::from_str("true").expect("as earlier versions wrote");
    assert!(both.translation && both.rotation);
    let one = Kept {
        translation: false,
        rotation: true,
    };
    let text = serde_json::to_string(&one).expect("it serialises");
    assert_eq!(serde_json::from_str::<Kept>(&text).expect("ours"), one);
}

#[test]
fn every_truncation_is_refused() {
    let (_, bytes) = model();
    for cut in (0..bytes.len())
        .step_by(97)
        .chain([7, 8, 9, bytes.len() - 1])
    {
        let e = Model::from_bytes(&bytes[..cut]).expect_err("it is cut off");
        assert!(matches!(e, ModelError::Container(_)), "cut at {cut}: {e}");
    }
}

/// The bytes with one piece of the header replaced by another of the same length.
fn edited(from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = model().1.clone();
    let at = bytes
        .windows(from.len())
        .position(|w| w == from.as_bytes())
        .unwrap_or_else(|| panic!("{from} is in the header"));
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    bytes
}

#[test]
fn refusals_name_what_is_wrong() {
    let check = |bytes: &[u8], wants: &str| {
        let e = Model::from_bytes(bytes).expect_err(wants).to_string();
        assert!(e.contains(wants), "{e}");
    };
    check(
        &edited("\"plant.bias.0\"", "\"plant.bias.7\""),
        "plant.bias.0",
    );
    check(&edited("\"spread.mean\"", "\"spread.meen\""), "spread.mean");
    check(&edited(r#"format\":2"#, r#"format\":9"#), "format 9");
    check(&edited(r#"members\":2"#, r#"members\":7"#), "7 sensor maps");
    check(
        &edited("\"springtwin\"", "\"somethings\""),
        "the entry is absent",
    );
    // Offsets that overflow when they are added up.
    let mut huge = br#"{"a":{"dtype":"U8","shape":[2305843009213693951],"data_offsets":[0,2305843009213693951]}}"#.to_vec();
    let mut bytes = (huge.len() as u64).to_le_bytes().to_vec();
    bytes.append(&mut huge);
    check(&bytes, "outside of the file");
    check(&u64::MAX.to_le_bytes(), "too long");
    // The last eight bytes belong to an f32 tensor; all ones are not a number.
    let mut bytes = model().1.clone();
    let n = bytes.len();
    bytes[n - 8..].fill(0xff);
    check(&bytes, "makes no sense");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn damaged_files_never_panic(
        damage in prop::collection::vec((0.0..1.0_f64, any::<u8>()), 1..6),
        in_header in any::<bool>(),
    ) {
        let mut bytes = model().1.clone();
        let length = u64::from_le_bytes(std::array::from_fn(|i| bytes[i])) as usize + 8;
        let reach = if in_header { length } else { bytes.len() };
        for (place, value) in damage {
            let at = (place * reach as f64) as usize;
            bytes[at] = value;
        }
        if let Ok(read) = Model::from_bytes(&bytes) {
            // What is accepted can be used.
            let eval = read.cascade.pose(&nalgebra::SVector::from_element(0.1));
            prop_assert!(eval.pose.len() == 6);
        }
    }

    #[test]
    fn arbitrary_bytes_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        prop_assert!(Model::from_bytes(&bytes).is_err());
    }
}
