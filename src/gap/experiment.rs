//! Which excitation to drive next: of those that are possible, the one that separates what may still be missing best per second.
//!
//! An effect a of size s changes the innovations by about J_a s. Under an excitation it is apart from another effect b, whatever the
//! size of b and the calibration parameters of the rig within their uncertainty, by
//!
//! d(a, b) = ½ min over c of (J_a s − J_b c)ᵀ M (J_a s − J_b c),   d(a, 0) = ½ (J_a s)ᵀ M (J_a s)   nats,
//!
//! where 0 stands for a rig in order. M projects the calibration parameters out (`problem.rs`). Excitations that are driven one
//! after the other add up. What one is worth is the increase of
//!
//! U = Σ over a of w_a [ w_0 ln(1 + d(a, 0)/τ) + Σ over b of w_b ln(1 + d(a, b)/τ) ]
//!
//! with the weights w of the effects that may be missing and the significance threshold τ. It needs no data: which excitations
//! separate what is known from the commissioned twin. Effects of the supply alone have no part in it.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::{DMatrix, DVector};

use super::baseline::Commissioned;
use super::candidates::{Candidate, Start, Table, scene};
use super::commission::Baseline;
use super::config::CONFIG;
use super::explain::{admitted, moves};
use super::finding::{Finding, FoundEffect, Ranked, Verdict};
use super::problem::Replayed;
use super::replay::simulated_grid;
use super::session::Grid;
use super::{GapError, Progress, Stage, parallel};
use crate::robot::RobotSpec;
use crate::sim::effects::Trajectory;

/// An excitation that can be driven.
#[derive(Clone, Debug)]
pub struct Possible {
    /// Its name.
    pub name: String,
    /// After how long it can end, s since its beginning, rising.
    pub ends_s: Vec<f64>,
    /// The pressures that the pumps reach, gauge.
    pub pressures: Trajectory,
}

/// One way in which a candidate may act: a start of its search, with its columns among all.
struct Way {
    candidate: usize,
    start: Start,
    columns: Range<usize>,
}

/// An excitation with what it would show.
struct Shown {
    name: String,
    seconds: f64,
    /// Jᵀ M J of the columns of all ways.
    information: DMatrix<f64>,
    /// Whether the baseline's sessions moved the arm like this.
    covered: bool,
}

/// What possible excitations would show of every effect.
pub struct Design {
    candidates: Vec<Candidate>,
    ways: Vec<Way>,
    shown: Vec<Shown>,
}

/// How likely each effect is missing, and how large it would be.
#[derive(Clone, Debug, PartialEq)]
pub struct Belief {
    /// Weight of a rig in order.
    nothing: f64,
    /// Weight of each candidate, and the factor on its usual size.
    effects: Vec<(f64, f64)>,
    /// Whether there are effects that could still take the place of what is named.
    rivals: bool,
}

/// Weight of an effect that could take the place of one that is named.
const RIVAL: f64 = 0.1;

impl Belief {
    /// Whether what is named is apart from every effect that something could set it apart from.
    pub fn is_settled(&self) -> bool {
        !self.rivals
    }

    /// The candidates that may be missing.
    fn alive(&self) -> Vec<usize> {
        let all = 0..self.effects.len();
        all.filter(|i| self.effects[*i].0 > 0.0).collect()
    }
}

/// What to drive next.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// Index among the possible excitations, each with all its ends in order.
    pub index: usize,
    /// Why: one sentence.
    pub why: String,
}

/// What excitations that were driven have shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Driven(DMatrix<f64>);

impl Design {
    /// Computes what each of the `possible` excitations would show of the effects of `table` on a rig in order, with the declared
    /// load.
    ///
    /// # Errors
    /// [`GapError`] when the arm cannot follow one of them, or `progress` stops the work.
    pub fn new(
        robot: &RobotSpec,
        table: Table<'_>,
        rig: &Commissioned,
        (possible, payload_kg): (&[Possible], f64),
        progress: &dyn Progress,
    ) -> Result<Self, GapError> {
        let rig = rig.seen_from(robot)?;
        let baseline = rig.arm_in(&rig.present);
        let grids = possible.iter().map(|p| {
            let grid = Grid::under(&robot.hash, payload_kg, &p.pressures)?;
            Ok(simulated_grid(robot, &grid, &baseline.values, &[])?)
        });
        let grids: Vec<Grid> = grids.collect::<Result<_, GapError>>()?;
        let candidates = admitted(table, &rig.present);
        // The same starts under every excitation.
        let scene = scene(&grids.iter().collect::<Vec<_>>());
        let mut ways = Vec::new();
        let mut count = 0;
        for (i, c) in candidates.iter().enumerate() {
            for start in c.starts(&scene) {
                let columns = count..count + start.moves.len();
                count = columns.end;
                ways.push(Way {
                    candidate: i,
                    start,
                    columns,
                });
            }
        }
        let done = AtomicUsize::new(0);
        let all: Vec<usize> = (0..grids.len()).collect();
        let shown = parallel(&all, |&k| {
            let (grid, p) = (&grids[k], &possible[k]);
            let exceeded = rig.coverage.as_ref().map(|c| c.exceeded_by(grid));
            let all_ends = information(robot, &baseline, (grid, &p.ends_s), &candidates, &ways)?;
            let done = 1 + done.fetch_add(1, Ordering::Relaxed);
            progress.at(Stage::Design, done as f64 / all.len() as f64)?;
            let ends = p.ends_s.iter().zip(all_ends);
            let shown = ends.map(|(seconds, information)| Shown {
                name: p.name.clone(),
                seconds: *seconds,
                information,
                covered: exceeded.is_none_or(|e| e <= CONFIG.coverage_max),
            });
            Ok(shown.collect::<Vec<_>>())
        });
        let shown = shown.into_iter().collect::<Result<Vec<_>, GapError>>()?;
        let shown = shown.into_iter().flatten().collect();
        Ok(Self {
            candidates,
            ways,
            shown,
        })
    }

    /// The excitations that are never proposed, because the baseline's sessions do not move the arm like that: errors of a healthy
    /// model have not been seen there.
    pub fn left_out(&self) -> Vec<String> {
        let out = self.shown.iter().filter(|s| !s.covered);
        let mut names: Vec<String> = out.map(|s| s.name.clone()).collect();
        names.dedup();
        names
    }

    /// Nothing was driven yet.
    pub fn nothing_driven(&self) -> Driven {
        let n = self.ways.last().map_or(0, |w| w.columns.end);
        Driven(DMatrix::zeros(n, n))
    }

    /// Adds what an excitation has shown.
    pub fn drove(&self, index: usize, driven: &mut Driven) {
        driven.0 += &self.shown[index].information;
    }

    /// Before anything was measured: every effect is as likely as the others, all of them together as likely as none.
    pub fn at_first(&self) -> Belief {
        self.alike(|_| true, 1.0)
    }

    /// The candidates that `may` be missing are alike, and together as likely as a share `nothing` of a rig in order.
    fn alike(&self, may: impl Fn(usize) -> bool, nothing: f64) -> Belief {
        let weight = |i: usize| if may(i) { 1.0 } else { 0.0 };
        let all: Vec<f64> = (0..self.candidates.len()).map(weight).collect();
        let sum = all.iter().sum::<f64>().max(1.0);
        Belief {
            nothing,
            effects: all.iter().map(|w| (w / sum, 1.0)).collect(),
            rivals: false,
        }
    }

    /// What is believed after a finding on all that was driven. Beside what is named stand the effects that could still take its
    /// place: nothing driven so far sets them apart, and something that takes at most `left_s` would.
    pub fn after(&self, finding: &Finding, driven: &Driven, left_s: f64) -> Belief {
        let f = finding;
        let belief = self.believed(f.verdict, &f.effects, &f.candidates, driven);
        match f.verdict {
            Verdict::Named => self.beside_rivals(belief, driven, left_s),
            _ => belief,
        }
    }

    /// What is named, with what could still take its place beside it.
    fn beside_rivals(&self, mut belief: Belief, driven: &Driven, left_s: f64) -> Belief {
        for rival in self.rivals(&belief, driven, left_s) {
            belief.effects[rival].0 = RIVAL;
            belief.rivals = true;
        }
        belief
    }

    /// Effects that are not apart from one that is believed in, and would be after an excitation of at most `left_s`.
    fn rivals(&self, belief: &Belief, driven: &Driven, left_s: f64) -> Vec<usize> {
        let named = belief.alive();
        let fits: Vec<DMatrix<f64>> = self
            .shown
            .iter()
            .filter(|s| s.covered && s.seconds <= left_s)
            .map(|s| &driven.0 + &s.information)
            .collect();
        let rival = |b: &usize| {
            named.iter().any(|&a| {
                let way = self.first_way(a);
                let apart = |information: &DMatrix<f64>| {
                    self.least_apart(information, way, *b, belief.effects[a].1)
                        >= CONFIG.experiment_nats
                };
                !apart(&driven.0) && fits.iter().any(apart)
            })
        };
        (0..self.candidates.len())
            .filter(|b| !named.contains(b))
            .filter(rival)
            .collect()
    }

    fn believed(
        &self,
        verdict: Verdict,
        effects: &[FoundEffect],
        ranked: &[Ranked],
        driven: &Driven,
    ) -> Belief {
        let place = |id: &str, target: Option<usize>| {
            let mut all = self.candidates.iter();
            all.position(|c| c.effect.id == id && c.target.map(|t| t + 1) == target)
        };
        let mut found = self.alike(|_| false, 0.0);
        let mut add = |at: usize, gain: f64| {
            let usual = self.apart(&driven.0, self.first_way(at), None, 1.0);
            let size = (gain.max(0.0) / usual.max(1e-9)).sqrt().clamp(0.1, 10.0);
            found.effects[at] = (1.0, size);
        };
        match verdict {
            Verdict::Named | Verdict::Indistinguishable => {
                for e in effects {
                    let mut all = ranked.iter();
                    let gain = all.find(|r| r.id == e.id && r.target == e.target);
                    if let Some(at) = place(&e.id, e.target) {
                        add(at, gain.map_or(CONFIG.experiment_nats, |r| r.gain));
                    }
                }
                found
            }
            Verdict::Unknown => {
                for r in ranked.iter().filter(|r| r.gain > 0.0) {
                    if let Some(at) = place(&r.id, r.target) {
                        add(at, r.gain);
                    }
                }
                match found.effects.iter().any(|(w, _)| *w > 0.0) {
                    true => found,
                    false => self.at_first(),
                }
            }
            // What would have shown is not there.
            Verdict::NothingMissing | Verdict::NotExcited => {
                let shows: Vec<bool> = self.visible(driven).collect();
                self.alike(|i| !shows[i], 1.0)
            }
        }
    }

    /// Whether each candidate of usual size would have shown under what was driven.
    fn visible<'a>(&'a self, driven: &'a Driven) -> impl Iterator<Item = bool> + 'a {
        (0..self.candidates.len()).map(|i| {
            let way = self.first_way(i);
            self.apart(&driven.0, way, None, 1.0) >= CONFIG.experiment_nats
        })
    }

    /// Share of the candidates that would have shown, 0..1.
    pub fn visible_share(&self, driven: &Driven) -> f64 {
        let shown = self.visible(driven).filter(|v| *v).count();
        shown as f64 / self.candidates.len().max(1) as f64
    }

    /// The excitation that is worth most per second among those that take at most `left_s`; `None` where none fits.
    pub fn next(&self, belief: &Belief, driven: &Driven, left_s: f64) -> Option<Proposal> {
        let now = self.worth(&driven.0, belief);
        let fits: Vec<usize> = (0..self.shown.len())
            .filter(|k| self.shown[*k].covered && self.shown[*k].seconds <= left_s)
            .collect();
        let gains = parallel(&fits, |&k| {
            let then = &driven.0 + &self.shown[k].information;
            (self.worth(&then, belief) - now) / self.shown[k].seconds
        });
        let each = fits.iter().zip(gains);
        let (index, _) = each.max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(Proposal {
            index: *index,
            why: self.why(*index, belief, driven),
        })
    }

    /// What a proposal is for: how far it moves the first two apart where few effects are left, or what it would show.
    fn why(&self, index: usize, belief: &Belief, driven: &Driven) -> String {
        let shown = &self.shown[index];
        let then = Driven(&driven.0 + &shown.information);
        let mut alive = belief.alive();
        alive.sort_by(|a, b| belief.effects[*b].0.total_cmp(&belief.effects[*a].0));
        match alive[..] {
            [a, ..] if alive.len() > 1 && (belief.rivals || alive.len() <= FEW) => {
                let apart = |b: usize, d: &Driven| {
                    let size = belief.effects[a].1;
                    self.least_apart(&d.0, self.first_way(a), b, size)
                };
                let others = alive[1..].iter().map(|b| (*b, apart(*b, driven)));
                let nearest = others.min_by(|x, y| x.1.total_cmp(&y.1));
                let (b, now) = nearest.unwrap_or((a, 0.0));
                format!(
                    "'{}' for {:.0} s: {} and {} are expected to be {:.0} nats apart after it, {:.0} now",
                    shown.name,
                    shown.seconds,
                    self.label(a),
                    self.label(b),
                    apart(b, &then),
                    now
                )
            }
            _ => format!(
                "'{}' for {:.0} s: {:.0} % of the effects would show after it at their usual size, {:.0} % now",
                shown.name,
                shown.seconds,
                100.0 * self.visible_share(&then),
                100.0 * self.visible_share(driven)
            ),
        }
    }

    fn label(&self, i: usize) -> String {
        let c = &self.candidates[i];
        let name = c.effect.name.to_lowercase();
        c.target
            .map_or(name.clone(), |t| format!("{name} {}", t + 1))
    }

    fn first_way(&self, candidate: usize) -> Option<&Way> {
        self.ways.iter().find(|w| w.candidate == candidate)
    }

    /// U, with this much information.
    fn worth(&self, information: &DMatrix<f64>, belief: &Belief) -> f64 {
        let alive = belief.alive();
        let log = |nats: f64| (1.0 + nats / CONFIG.experiment_nats).ln();
        let of = |&a: &usize| {
            let (weight, size) = belief.effects[a];
            let way = self.first_way(a);
            let nothing = belief.nothing * log(self.apart(information, way, None, size));
            let others = alive
                .iter()
                .filter(|b| **b != a)
                .map(|&b| belief.effects[b].0 * log(self.least_apart(information, way, b, size)));
            weight * (nothing + others.sum::<f64>())
        };
        alive.iter().map(of).sum()
    }

    /// How far an effect is from another one however that acts, nats.
    fn least_apart(&self, information: &DMatrix<f64>, a: Option<&Way>, b: usize, size: f64) -> f64 {
        let ways = self.ways.iter().filter(|w| w.candidate == b);
        let apart = ways.map(|b| self.apart(information, a, Some(b), size));
        apart.fold(f64::INFINITY, f64::min)
    }

    /// d(a, b) for a full move of `a` times `size`; without `b` d(a, 0).
    fn apart(
        &self,
        information: &DMatrix<f64>,
        a: Option<&Way>,
        b: Option<&Way>,
        size: f64,
    ) -> f64 {
        let Some(a) = a else { return 0.0 };
        let block = |r: &Range<usize>, c: &Range<usize>| {
            information
                .view((r.start, c.start), (r.len(), c.len()))
                .into_owned()
        };
        let of_a = block(&a.columns, &a.columns).sum();
        let explained = b.map_or(0.0, |b| {
            let mut of_b = block(&b.columns, &b.columns);
            for i in 0..of_b.nrows() {
                of_b[(i, i)] += 1e-9 + 1e-9 * of_b[(i, i)];
            }
            let both: DVector<f64> = block(&b.columns, &a.columns).column_sum();
            of_b.cholesky().map_or(0.0, |l| both.dot(&l.solve(&both)))
        });
        0.5 * size * size * (of_a - explained).max(0.0)
    }
}

/// Of at most so many effects that are left it is stated how far they are apart.
const FEW: usize = 6;

/// Jᵀ M J of all ways under the pressures of a simulated session of a rig in order, up to each end.
fn information(
    robot: &RobotSpec,
    baseline: &Baseline,
    (grid, ends_s): (&Grid, &[f64]),
    candidates: &[Candidate],
    ways: &[Way],
) -> Result<Vec<DMatrix<f64>>, GapError> {
    let grids = [grid];
    let replayed = Replayed::new(robot, &grids, baseline)?;
    let problem = replayed.problem()?;
    let r0 = problem.residual(&[])?;
    let residual = |effects: &[_]| problem.residual(effects);
    let columns = ways.iter().flat_map(|way| {
        let moved = moves(&residual, &r0, &[], candidates[way.candidate], &way.start);
        // What the arm cannot do shows nothing.
        moved.unwrap_or_else(|| vec![DVector::zeros(r0.len()); way.start.moves.len()])
    });
    let all: Vec<DVector<f64>> = columns.collect();
    let all = DMatrix::from_columns(&all);
    let of_end = |end_s: &f64| {
        let bins = grid.t_s.partition_point(|t| t - grid.t_s[0] < *end_s);
        let part = problem.part(std::slice::from_ref(&(0..bins)))?;
        let rows = bins * problem.per_bin();
        Ok(part.gram(&all.rows(0, rows).into_owned()))
    };
    ends_s.iter().map(of_end).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::effects;

    /// Two effects with one column each, and excitations of given duration and information.
    fn design(shown: &[(f64, [f64; 4])]) -> Design {
        let table = effects::table();
        let candidate = |i: usize| Candidate {
            effect: table[i],
            target: None,
        };
        let way = |i: usize| Way {
            candidate: i,
            start: candidate(i)
                .starts(&crate::sim::effects::Scene::default())
                .swap_remove(0),
            columns: i..i + 1,
        };
        let shown = shown.iter().enumerate().map(|(k, (seconds, g))| Shown {
            name: format!("excitation {k}"),
            seconds: *seconds,
            information: DMatrix::from_row_slice(2, 2, g),
            covered: true,
        });
        Design {
            candidates: vec![candidate(0), candidate(1)],
            ways: vec![way(0), way(1)],
            shown: shown.collect(),
        }
    }

    const ALIKE: [f64; 4] = [100.0, 100.0, 100.0, 100.0];
    const APART: [f64; 4] = [100.0, 0.0, 0.0, 100.0];
    const SLANTED: [f64; 4] = [100.0, 60.0, 60.0, 100.0];

    /// ½ g_aa and ½ (g_aa − g_ab²/g_bb), the size squared.
    #[test]
    fn distances_are_those_of_the_closed_form() {
        let d = design(&[(30.0, ALIKE), (30.0, APART), (30.0, SLANTED)]);
        let at = |k: usize, size: f64| {
            let g = &d.shown[k].information;
            let way = d.first_way(0);
            [d.apart(g, way, None, size), d.least_apart(g, way, 1, size)]
        };
        let near = |a: [f64; 2], b: [f64; 2]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(near(at(0, 1.0), [50.0, 0.0]), "{:?}", at(0, 1.0));
        assert!(near(at(1, 1.0), [50.0, 50.0]), "{:?}", at(1, 1.0));
        assert!(near(at(2, 1.0), [50.0, 32.0]), "{:?}", at(2, 1.0));
        assert!(near(at(2, 2.0), [200.0, 128.0]), "{:?}", at(2, 2.0));
    }

    #[test]
    fn what_separates_is_driven_unless_it_takes_too_long() {
        let both = Belief {
            nothing: 0.0,
            effects: vec![(1.0, 1.0), (1.0, 1.0)],
            rivals: false,
        };
        let chosen = |all: &[(f64, [f64; 4])], left_s: f64| {
            let d = design(all);
            d.next(&both, &d.nothing_driven(), left_s).map(|p| p.index)
        };
        let all = [(30.0, ALIKE), (60.0, APART), (30.0, SLANTED)];
        // ln(1 + 50/τ)/60 against ln(1 + 32/τ)/30.
        assert_eq!(chosen(&all, 600.0), Some(2));
        assert_eq!(chosen(&all[..2], 600.0), Some(1));
        assert_eq!(chosen(&all[..2], 40.0), Some(0));
        assert_eq!(chosen(&all, 20.0), None);
    }

    /// One that was driven under what shows both alike is a rival as long as something can set it apart in the time that is left.
    #[test]
    fn what_could_take_the_place_of_a_name_is_driven_before_it_counts() {
        let d = design(&[(30.0, ALIKE), (60.0, APART)]);
        let mut driven = d.nothing_driven();
        d.drove(0, &mut driven);
        let first = d.believed(Verdict::Named, &[named(&d, 0)], &[], &driven);
        assert_eq!(d.rivals(&first, &driven, 60.0), [1]);
        assert!(d.rivals(&first, &driven, 40.0).is_empty());
        let belief = d.beside_rivals(first.clone(), &driven, 60.0);
        assert!(!belief.is_settled());
        let proposed = d.next(&belief, &driven, 60.0).expect("an excitation");
        assert_eq!(proposed.index, 1);
        assert!(proposed.why.contains("apart after it"), "{}", proposed.why);
        d.drove(1, &mut driven);
        assert!(d.rivals(&first, &driven, 600.0).is_empty());
    }

    fn named(d: &Design, i: usize) -> FoundEffect {
        FoundEffect {
            id: d.candidates[i].effect.id.to_owned(),
            side: String::new(),
            target: None,
            params: std::collections::BTreeMap::new(),
            instead_of: None,
            chosen_by: None,
        }
    }

    #[test]
    fn what_would_have_shown_is_not_looked_for_again() {
        let d = design(&[
            (30.0, [100.0, 0.0, 0.0, 1.0]),
            (30.0, [1.0, 0.0, 0.0, 100.0]),
        ]);
        let mut driven = d.nothing_driven();
        assert_eq!(d.visible_share(&driven), 0.0);
        d.drove(0, &mut driven);
        assert_eq!(d.visible_share(&driven), 0.5);
        let belief = d.believed(Verdict::NothingMissing, &[], &[], &driven);
        assert_eq!((belief.effects[0].0, belief.effects[1].0), (0.0, 1.0));
        assert_eq!(d.next(&belief, &driven, 60.0).map(|p| p.index), Some(1));
    }
}
