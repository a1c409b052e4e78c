//! The suite of the blind test: the same seeds give the same cases.

use rand::Rng as _;
use sha2::{Digest as _, Sha256};

use crate::gap::score::About;
use crate::lab::shards::Shard;
use crate::rig::hidden::{Class, HIDDEN, Kind, kind};
use crate::signal::{Side, hex};
use crate::sim::dataset::sample_rng;

/// A part of the suite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// One effect at 2, 4 and 8 times the floor.
    Singles,
    /// No effect.
    Nulls,
    /// An effect that the finder does not know.
    Aliens,
    /// Two effects.
    Pairs,
    /// One effect at 0.5 and 1 times the floor.
    Ladder,
    /// What no table has, for the search of a law: proved on a third session.
    Laws,
    /// One effect at 4 or 8 times the floor that begins within the session; only when asked for.
    Onsets,
}

impl Part {
    /// All parts, each with its name and its content.
    pub const ALL: [(Self, &'static str, &'static str); 7] = [
        (
            Self::Laws,
            "laws",
            "What no table has, for the search of a law",
        ),
        (
            Self::Singles,
            "singles",
            "One effect at 2, 4 and 8 times the floor",
        ),
        (Self::Nulls, "nulls", "No effect"),
        (
            Self::Aliens,
            "aliens",
            "An effect that the finder does not know",
        ),
        (Self::Pairs, "pairs", "Two effects"),
        (
            Self::Ladder,
            "ladder",
            "One effect at 0.5 and 1 times the floor",
        ),
        (
            Self::Onsets,
            "onsets",
            "One effect that begins within the session (only when asked for)",
        ),
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        let of = Self::ALL.iter().find(|(part, ..)| *part == self);
        of.map_or("", |(_, name, _)| name)
    }

    /// The part of that name; `None` if there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        let of = Self::ALL.iter().find(|(_, n, _)| *n == name);
        of.map(|(part, ..)| *part)
    }
}

/// Strengths of the singles of every seed, times the floor.
const SINGLES: [f64; 3] = [2.0, 4.0, 8.0];
/// Strengths of the additional singles, in turn.
const LOW: [f64; 2] = [0.5, 1.0];
/// Interval of the seeds that have an additional single.
const LOW_EVERY: u64 = 3;
/// Strength of unmodelled effects and of each member of a pair.
const CLEAR: f64 = 4.0;
/// Strengths of what begins within a session, in turn.
const BEGUN: [f64; 2] = [4.0, 8.0];
/// Changes when the same plan makes other sessions.
const EDITION: u32 = 2;

/// The plan of a suite.
pub struct Suite {
    /// First seed.
    pub first_seed: u64,
    /// Number of seeds.
    pub seeds: u64,
    /// Parts; all of them that name effects if empty.
    pub parts: Vec<Part>,
    /// Length of the sessions, s.
    pub seconds: f64,
    /// Hash of the robot file.
    pub robot: String,
    /// Noise beyond that of the sensors, per cent of what each channel moves by.
    pub noise_percent: f64,
    /// Without motion capture of the suspect sessions, and what only that could show.
    pub without_cameras: bool,
}

/// A case to be made and solved.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// Its folder; a name that does not show what is hidden.
    pub name: String,
    /// Its part.
    pub part: Part,
    /// Its kind.
    pub about: About,
    /// Its own seed: every case is another rig.
    pub seed: u64,
    /// Times the floor.
    pub strength: f64,
    /// Effects to hide.
    pub effects: Vec<&'static str>,
    /// Effect that the finder must not use; `None`: it may use all.
    pub without: Option<&'static str>,
}

impl Suite {
    /// All of it as names and texts, for a shard; see [`Suite::from_about`].
    pub fn about(&self) -> Vec<(String, String)> {
        let parts: Vec<&str> = self.parts.iter().map(|p| p.name()).collect();
        [
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("robot", self.robot.clone()),
            ("first-seed", self.first_seed.to_string()),
            ("seeds", self.seeds.to_string()),
            ("only", parts.join(",")),
            ("seconds", self.seconds.to_string()),
            ("extra-noise", self.noise_percent.to_string()),
            ("without-cameras", self.without_cameras.to_string()),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
    }

    /// The suite of a shard; `None` when something in it does not read.
    pub fn from_about<T>(shard: &Shard<T>) -> Option<Self> {
        let parts = shard.option("only").split(',').filter(|p| !p.is_empty());
        Some(Self {
            first_seed: shard.option("first-seed").parse().ok()?,
            seeds: shard.option("seeds").parse().ok()?,
            parts: parts.map(Part::from_name).collect::<Option<_>>()?,
            seconds: shard.option("seconds").parse().ok()?,
            robot: shard.option("robot").to_owned(),
            noise_percent: shard.option("extra-noise").parse().ok()?,
            without_cameras: shard.option("without-cameras").parse().ok()?,
        })
    }

    /// All cases, in the order of their names, which is none.
    pub fn cases(&self) -> Vec<Planned> {
        let of_parts = |p: &Planned| match self.parts.is_empty() {
            true => !matches!(p.part, Part::Laws | Part::Onsets),
            false => self.parts.contains(&p.part),
        };
        let of_cameras = |id: &&str| kind(id).is_some_and(|k| k.side == Side::FrameAndTime);
        let shows = |p: &Planned| !(self.without_cameras && p.effects.iter().any(of_cameras));
        let wanted = |p: &Planned| of_parts(p) && shows(p);
        let seeds = (0..self.seeds).map(|i| self.first_seed.wrapping_add(i));
        let all = seeds.flat_map(|s| self.of_seed(s));
        let mut out: Vec<Planned> = all.filter(wanted).collect();
        out.sort_by(|a, b| a.name.cmp(&b.name));
        out
    }

    fn of_seed(&self, seed: u64) -> Vec<Planned> {
        let (known, aliens) = (of(Class::Known), of(Class::Unmodelled));
        // Ten is coprime with the 27 effects, and nine seeds make one round of all.
        let nth = |i: u64, step: u64, from: u64| {
            let n = known.len() as u64;
            known[((i % n * step + from) % n) as usize]
        };
        let mut out = Vec::new();
        let mut add = |part, about, strength, kinds: &[&'static Kind], without| {
            let effects = kinds.iter().map(|k| k.id).collect();
            out.push(self.planned(seed, out.len(), part, about, strength, effects, without));
        };
        for (k, strength) in SINGLES.into_iter().enumerate() {
            let kind = nth(seed, 10, 9 * k as u64);
            add(Part::Singles, About::Single, strength, &[kind], None);
        }
        add(Part::Nulls, About::Null, 0.0, &[], None);
        let turn = seed / 2;
        if seed.is_multiple_of(2) {
            let kind = aliens[(turn % aliens.len() as u64) as usize];
            add(Part::Aliens, About::Alien, CLEAR, &[kind], None);
        } else {
            let kind = nth(turn, 10, 13);
            add(Part::Aliens, About::Alien, CLEAR, &[kind], Some(kind.id));
        }
        let first = nth(seed, 10, 4);
        let others: Vec<_> = known.iter().filter(|k| k.side != first.side).collect();
        let second = others[sample_rng(seed, 0x9a18).random_range(0..others.len())];
        add(Part::Pairs, About::Pair, CLEAR, &[first, second], None);
        if seed.is_multiple_of(LOW_EVERY) {
            let turn = seed / LOW_EVERY;
            let strength = LOW[(turn % 2) as usize];
            let kind = nth(turn, 10, 5);
            add(Part::Ladder, About::Single, strength, &[kind], None);
        }
        // Every effect of the table left out in turn, every unmodelled one, and none.
        let kind = nth(seed, 10, 13);
        add(Part::Laws, About::Alien, CLEAR, &[kind], Some(kind.id));
        let kind = aliens[(seed % aliens.len() as u64) as usize];
        add(Part::Laws, About::Alien, CLEAR, &[kind], None);
        add(Part::Laws, About::Null, 0.0, &[], None);
        let kind = nth(seed, 10, 22);
        let strength = BEGUN[(seed % 2) as usize];
        add(Part::Onsets, About::Begun, strength, &[kind], None);
        out
    }

    fn planned(
        &self,
        seed: u64,
        slot: usize,
        part: Part,
        about: About,
        strength: f64,
        effects: Vec<&'static str>,
        without: Option<&'static str>,
    ) -> Planned {
        let case_seed = sample_rng(seed, 0xbe00 + slot).random();
        let version = env!("CARGO_PKG_VERSION");
        let (seconds, robot) = (self.seconds, &self.robot);
        let mut all = format!(
            "{EDITION} {version} {robot} {seconds} {case_seed} {about:?} {strength} {effects:?} {without:?}"
        );
        if self.noise_percent > 0.0 {
            all += &format!(" {}", self.noise_percent);
        }
        Planned {
            name: hex(&Sha256::digest(all)[..6]),
            part,
            about,
            seed: case_seed,
            strength,
            effects,
            without,
        }
    }
}

fn of(class: Class) -> Vec<&'static Kind> {
    HIDDEN.iter().filter(|k| k.class == class).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;

    fn suite(first_seed: u64, seeds: u64, parts: &[Part]) -> Vec<Planned> {
        let suite = Suite {
            first_seed,
            seeds,
            parts: parts.to_vec(),
            seconds: 90.0,
            robot: "r".to_owned(),
            noise_percent: 0.0,
            without_cameras: false,
        };
        suite.cases()
    }

    #[test]
    fn a_seed_has_the_same_cases_in_every_suite() {
        assert_eq!(suite(1, 30, &[]), suite(1, 30, &[]));
        let (some, all) = (suite(7, 2, &[]), suite(1, 30, &[]));
        assert!(some.len() >= 12 && some.iter().all(|c| all.contains(c)));
        let nulls = suite(1, 30, &[Part::Nulls]);
        assert!(nulls.len() == 30 && nulls.iter().all(|c| all.contains(c)));
        let names: BTreeSet<_> = all.iter().map(|c| &c.name).collect();
        let seeds: BTreeSet<_> = all.iter().map(|c| c.seed).collect();
        assert_eq!((names.len(), seeds.len()), (190, 190));
    }

    #[test]
    fn effects_strengths_and_parts_are_balanced() {
        let all = suite(1, 30, &[]);
        let count = |p: Part| all.iter().filter(|c| c.part == p).count();
        use Part::{Aliens, Ladder, Nulls, Pairs, Singles};
        assert_eq!(
            [Singles, Nulls, Aliens, Pairs, Ladder].map(count),
            [90, 30, 30, 30, 10]
        );
        // 27 seeds: every effect once at each strength.
        let mut times: BTreeMap<(&str, u64), usize> = BTreeMap::new();
        for c in suite(5, 27, &[Singles]) {
            *times.entry((c.effects[0], c.strength as u64)).or_default() += 1;
        }
        assert_eq!(times.len(), 3 * 27);
        assert!(times.values().all(|n| *n == 1));
        // Nine: every effect once.
        let ids: BTreeSet<_> = suite(1, 9, &[Singles])
            .iter()
            .map(|c| c.effects[0])
            .collect();
        assert_eq!(ids.len(), 27);
        let left_out = all.iter().filter(|c| c.without.is_some());
        let ids: BTreeSet<_> = left_out.map(|c| c.effects[0]).collect();
        assert_eq!(ids.len(), 15);
        let low: Vec<f64> = all
            .iter()
            .filter(|c| c.part == Ladder)
            .map(|c| c.strength)
            .collect();
        assert_eq!(low.iter().filter(|s| **s == 0.5).count(), 5);
        for c in &all {
            let sides: Vec<_> = HIDDEN
                .iter()
                .filter(|k| c.effects.contains(&k.id))
                .map(|k| (k.class, k.side))
                .collect();
            match c.about {
                About::Null => assert!(sides.is_empty()),
                About::Pair => assert!(sides.len() == 2 && sides[0].1 != sides[1].1),
                About::Alien => assert_eq!(c.without.is_some(), sides[0].0 == Class::Known),
                About::Single | About::Begun => assert_eq!(sides[0].0, Class::Known),
            }
        }
    }
}
