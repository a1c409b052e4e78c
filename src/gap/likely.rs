//! Which effects of the table the live monitor's errors look like.
//!
//! Of every effect it follows what a usual size of it would change in the errors e of a second: columns J, one for each of its
//! parameters. With S the covariance of e in a rig in order and b and G the means of Jᵀ S⁻¹ e and Jᵀ S⁻¹ J over the last seconds,
//! bᵀ G⁻¹ b is what the effect explains of the mean of eᵀ S⁻¹ e. In a rig in order, whose errors of one second are like those of
//! the next, that is at most about the number of its parameters.

use nalgebra::{DMatrix, DVector};

use super::candidates::{Candidate, Table};
use super::commission::row_difference as difference;
use super::config::CONFIG;
use super::explain::{admitted, score};
use super::follow::{Follower, Moment};
use super::replay::{Row, is_mechanical, residuals};
use super::session::SPRING_0;
use crate::robot::RobotSpec;
use crate::sim::effects::{Active, Effect, Operator, Scene};

/// So many are listed at most.
const LISTED: usize = 3;
/// An effect that explains less than this share of what the first one does is not likely.
const LIKELY: f64 = 0.5;

/// All effects, followed one beside the other.
pub(super) struct Likely(Vec<Followed>);

/// An effect that is followed.
struct Followed {
    candidate: Candidate,
    /// Its name, with its channel.
    name: String,
    /// Whether it is known, and no longer looked for.
    muted: bool,
    ways: Vec<Way>,
    /// Means of Jᵀ S⁻¹ e and Jᵀ S⁻¹ J, and when they were last those of a rig in order.
    right: DVector<f64>,
    gram: DMatrix<f64>,
    quiet_s: f64,
}

/// What one parameter of an effect changes.
struct Way {
    acting: Active,
    /// The arm that moves with it; none for what changes readings alone.
    arm: Option<Follower>,
}

/// What an effect explains, over its limit.
#[derive(Clone, Debug)]
pub(super) struct Suspect {
    /// Its name, with its channel.
    pub name: String,
    /// What it explains over its limit.
    pub ratio: f64,
    /// When that was last as in a rig in order, s.
    pub since_s: f64,
}

impl Likely {
    /// Those of `table` that springs and IMUs of a commissioned rig can show.
    pub fn new(robot: &RobotSpec, table: Table<'_>, present: &[bool], values: &[f64]) -> Self {
        let judged = std::array::from_fn(|c| c >= SPRING_0 && present[c]);
        let reads =
            |e: &Effect| matches!(e.operator, Operator::Sensors(_)) || e.also_read.is_some();
        let acts = |c: &Candidate| {
            let e = c.effect;
            let active = c.with(&c.nominal());
            is_mechanical(&active) || e.behind_gauge.is_some() || reads(e)
        };
        let follow = |candidate: Candidate| {
            let start = candidate.starts(&Scene::default()).into_iter().next()?;
            let nominal = candidate.nominal();
            let ways = start.moves.iter().map(|&moved| {
                let mut at = start.at.clone();
                for &other in start.moves.iter().filter(|other| **other != moved) {
                    at[other] = nominal[other];
                }
                let acting = candidate.with(&at);
                let moves = is_mechanical(&acting) || candidate.effect.behind_gauge.is_some();
                let arm = moves
                    .then(|| Follower::new(robot, values.to_vec(), std::slice::from_ref(&acting)));
                Way { acting, arm }
            });
            let ways: Vec<Way> = ways.collect();
            let n = ways.len();
            let name = candidate.effect.name.to_lowercase();
            Some(Followed {
                candidate,
                name: match candidate.target {
                    Some(t) => format!("{name} {}", t + 1),
                    None => name,
                },
                muted: false,
                ways,
                right: DVector::zeros(n),
                gram: DMatrix::zeros(n, n),
                quiet_s: 0.0,
            })
        };
        let all = admitted(table, &judged).into_iter().filter(acts);
        Self(all.filter_map(follow).collect())
    }

    /// The arms are somewhere else.
    pub fn begin_again(&mut self) {
        let ways = self.0.iter_mut().flat_map(|f| &mut f.ways);
        ways.filter_map(|w| w.arm.as_mut())
            .for_each(Follower::begin_again);
    }

    /// What every effect changes now.
    pub fn columns(&mut self, robot: &RobotSpec, now: &Moment<'_>) -> Vec<Vec<Row>> {
        let column = |way: &mut Way| -> Row {
            let acting = std::slice::from_ref(&way.acting);
            match &mut way.arm {
                Some(arm) => {
                    let moved = now.moved(robot, arm, acting);
                    moved.map_or([0.0; _], |row| difference(&now.coarse, &row, 1.0))
                }
                None => {
                    let (session, read) = now.tail;
                    let rows = residuals(robot, session, read, now.values, acting);
                    difference(now.last, &rows[rows.len() - 1], 1.0)
                }
            }
        };
        let of = |f: &mut Followed| f.ways.iter_mut().map(column).collect();
        self.0.iter_mut().map(of).collect()
    }

    /// Takes the errors of a second, weighed by S⁻¹, in the channels that are `known`; they count with a share `new` of the mean.
    pub fn add(
        &mut self,
        columns: &[Vec<Row>],
        known: &[usize],
        (inverse, weighed): (&DMatrix<f64>, &DVector<f64>),
        (t_s, new): (f64, f64),
    ) {
        for (f, columns) in self.0.iter_mut().zip(columns) {
            let j = DMatrix::from_fn(known.len(), columns.len(), |a, k| {
                columns[k][SPRING_0 + known[a]]
            });
            f.right += (j.tr_mul(weighed) - &f.right) * new;
            f.gram += (j.tr_mul(&(inverse * &j)) - &f.gram) * new;
            if f.explains() <= 1.0 {
                f.quiet_s = t_s;
            }
        }
    }

    /// Looks no longer for the effect of this name, or again; whether there is one.
    pub fn mute(&mut self, name: &str, muted: bool) -> bool {
        let mut named = self.0.iter_mut().filter(|f| f.name == name);
        let found = named.next();
        found.map(|f| f.muted = muted).is_some()
    }

    /// The names of those that are muted.
    pub fn muted(&self) -> Vec<String> {
        let all = self.0.iter().filter(|f| f.muted);
        all.map(|f| f.name.clone()).collect()
    }

    /// Of the `columns` of all effects those of the muted ones.
    pub fn of_muted<'a>(&'a self, columns: &'a [Vec<Row>]) -> impl Iterator<Item = &'a Row> {
        let both = self.0.iter().zip(columns);
        both.filter(|(f, _)| f.muted)
            .flat_map(|(_, columns)| columns)
    }

    /// Those that explain most, the best first; an effect on another channel of the same is not listed.
    pub fn best(&self) -> Vec<Suspect> {
        let heard = self.0.iter().filter(|f| !f.muted);
        let mut all: Vec<(f64, &Followed)> = heard.map(|f| (f.ratio(), f)).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let most = all.first().map_or(0.0, |(ratio, _)| *ratio);
        let mut listed: Vec<(f64, &Followed)> = Vec::new();
        for (ratio, f) in all {
            let is_listed =
                |(_, other): &(f64, &Followed)| other.candidate.effect.id == f.candidate.effect.id;
            if ratio >= LIKELY * most && !listed.iter().any(is_listed) {
                listed.push((ratio, f));
            }
        }
        let suspects = listed.into_iter().map(|(ratio, f)| Suspect {
            name: f.name.clone(),
            ratio,
            since_s: f.quiet_s,
        });
        suspects.take(LISTED).collect()
    }
}

impl Followed {
    /// bᵀ G⁻¹ b per parameter.
    fn explains(&self) -> f64 {
        2.0 * score(&self.gram, &self.right).0 / self.ways.len() as f64
    }

    fn ratio(&self) -> f64 {
        self.explains() / CONFIG.monitor_effect_limit
    }
}
