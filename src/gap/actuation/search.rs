//! Search for the effects that explain a pressure log: forward addition from several starts, backward
//! deletion, comparison of the resulting sets.

use nalgebra::{DMatrix, DVector};

use super::healthy::{LineBaseline, LineModel, PressureNoise, chamber_rms_pa};
use super::line::{Lag, PressureGrid};
use super::significance::{Significance, significance};
use crate::gap::candidates::{Candidate, Table, candidates, fastest};
use crate::gap::config::CONFIG;
use crate::gap::explain::{Explained, columns, explain, weak_prior};
use crate::gap::fit::fit;
use crate::gap::problem::{Losses, Problem};
use crate::gap::{GapError, Progress};
use crate::robot::RobotSpec;
use crate::sim::effects::{Effect, Residual, Scene, Target};

/// Steps of a fit.
const STEPS: usize = 12;

/// A set of effects, fitted together.
#[derive(Clone, Debug)]
pub struct EffectSet {
    /// The fit; its gain is over no effect at all.
    pub explained: Explained,
    /// The supply it was fitted with: the commissioned one, or regulators fitted beside it.
    pub baseline: LineBaseline,
    /// Mean square innovation that is left.
    pub mean_square: f64,
}

/// Stages of the search on a pressure log.
#[derive(Clone, Debug)]
pub struct Stages {
    /// The model without effects: its supply (regulators fitted, unless commissioned).
    pub baseline: LineBaseline,
    /// Its loss.
    pub losses: Losses,
    /// Mean square innovation without effects.
    pub mean_square: f64,
    /// Rankings: the first of single effects, each further one on top of the best set so far; the
    /// last addition may have been refused.
    pub stages: Vec<Vec<Explained>>,
    /// Sets with a significant gain, best first; empty when there is none.
    pub sets: Vec<EffectSet>,
    /// The significance thresholds.
    pub significance: Significance,
}

/// Effects that show between command and gauge.
pub fn shows(effect: &Effect, lag: Lag) -> bool {
    effect.shows_in(Residual::R1) || (lag == Lag::BeforeGauge && effect.is_behind_gauge())
}

fn admitted(table: Table<'_>, grid: &PressureGrid, lag: Lag, commissioned: bool) -> Vec<Candidate> {
    candidates(table, |e| {
        // Without a healthy session the correct gauge readings are unknown.
        shows(e, lag) && (commissioned || !e.is_of_gauge())
    })
    .into_iter()
    .filter(|c| match (c.effect.target, c.target) {
        (Target::Chamber, Some(i)) => grid.present[i],
        _ => true,
    })
    .collect()
}

/// What a pressure log offers to starts.
fn scene(grid: &PressureGrid) -> Scene {
    Scene {
        seconds: grid.t_s[grid.len() - 1] - grid.t_s[0],
        fastest_pa_s: fastest(&grid.t_s, &grid.measured_pa),
        ..Scene::default()
    }
}

/// A search over one grid.
struct Search<'a> {
    all: Vec<Candidate>,
    commissioned: bool,
    progress: &'a dyn Progress,
}

impl Search<'_> {
    /// The ranking of every candidate on top of `so_far`.
    fn rank(
        &self,
        model: &LineModel,
        problem: &Problem,
        so_far: Option<&Explained>,
    ) -> Result<Vec<Explained>, GapError> {
        let base = so_far.map(|e| e.fit.effects.clone()).unwrap_or_default();
        let ready = columns(problem, &self.all, &scene(model.grid), &base, false)?;
        explain(problem, &self.all, &ready, so_far, 0.0, self.progress)
    }

    /// Refits the effects of `e`, with the regulators at their new optimum.
    fn settle(&self, model: &mut LineModel, e: &Explained) -> Result<Explained, GapError> {
        let mut out = e.clone();
        let rounds = if self.commissioned { 1 } else { 3 };
        for _ in 0..rounds {
            if !self.commissioned {
                model.refit_regulators(&out.fit.active())?;
            }
            let problem = model.problem(&out.fit.active())?;
            if let Some(f) = fit(&problem, out.fit.effects.clone(), STEPS) {
                out.losses = problem.held_out(&f.residual, &f.columns, &weak_prior(&f));
                out.fit = f;
            }
        }
        Ok(out)
    }

    /// Whether a further effect brings some chamber close to its floor, where that is known: what an inadequate law leaves is
    /// no further effect.
    fn pays(before: (&LineModel, &Explained), after: (&LineModel, &Explained)) -> bool {
        let floors_pa = before.0.baseline.chamber_floor_pa;
        let sizes_pa =
            |(model, e): (&LineModel, &Explained)| chamber_rms_pa(&model.rows(&e.fit.active()));
        let (before_pa, after_pa) = (sizes_pa(before), sizes_pa(after));
        let mut chambers = after.0.grid.chambers().into_iter();
        chambers.any(|i| {
            let [before, after, floor] = [before_pa[i], after_pa[i], floors_pa[i]].map(|x| x * x);
            let closes = before - after >= CONFIG.further_min * (before - floor);
            floor.is_nan() || (before > 2.0 * floor && closes)
        })
    }

    /// From one effect on: adds what gains, then takes out what does not.
    fn grow(
        &self,
        mut model: LineModel,
        first: &Explained,
        base: &Losses,
        threshold: f64,
    ) -> Result<(EffectSet, Vec<Vec<Explained>>), GapError> {
        let mut best = self.settle(&mut model, first)?;
        let mut stages = Vec::new();
        while best.fit.effects.len() < CONFIG.effects_max {
            let problem = model.problem(&best.fit.active())?;
            let ranked = self.rank(&model, &problem, Some(&best))?;
            let next = ranked.first().cloned();
            stages.push(ranked);
            let Some(next) = next else { break };
            if next.gain < threshold || !next.losses.beats(&best.losses, CONFIG.supply_further_se) {
                break;
            }
            let mut wider = model.clone();
            let settled = self.settle(&mut wider, &next)?;
            let (gain, _) = settled.losses.gain_over(&best.losses);
            let (so_far, _) = best.losses.gain_over(base);
            let sure = settled.losses.beats(&best.losses, CONFIG.supply_further_se);
            let pays = Self::pays((&model, &best), (&wider, &settled));
            if gain < threshold.max(CONFIG.supply_further_share * so_far) || !sure || !pays {
                break;
            }
            drop(problem);
            (best, model) = (settled, wider);
        }
        // Backwards: what the later ones have made superfluous.
        let mut again = best.fit.effects.len() > 1;
        while again {
            again = false;
            for out in 0..best.fit.effects.len() {
                let mut less = best.clone();
                less.fit.effects.remove(out);
                let mut narrower = model.clone();
                let settled = self.settle(&mut narrower, &less)?;
                let (lost, _) = best.losses.gain_over(&settled.losses);
                let (whole, _) = best.losses.gain_over(base);
                let sure = best.losses.beats(&settled.losses, CONFIG.supply_further_se);
                let pays = Self::pays((&narrower, &settled), (&model, &best));
                if lost < threshold.max(CONFIG.supply_further_share * whole) || !sure || !pays {
                    (best, model) = (settled, narrower);
                    again = best.fit.effects.len() > 1;
                    break;
                }
            }
        }
        if let Some((candidate, _)) = best.fit.effects.first() {
            best.candidate = *candidate;
        }
        (best.gain, best.se) = best.losses.gain_over(base);
        let mean_square = best.fit.cost / best.fit.residual.len() as f64;
        let set = EffectSet {
            explained: best,
            baseline: model.baseline,
            mean_square,
        };
        Ok((set, stages))
    }

    /// One pass with the noise of `model`.
    fn pass(
        &self,
        mut model: LineModel,
        healthy: Option<&DVector<f64>>,
    ) -> Result<Stages, GapError> {
        if !self.commissioned {
            model.refit_regulators(&[])?;
        }
        let per_bin = model.grid.chambers().len();
        let problem = model.problem(&[])?;
        let r = problem.residual(&[])?;
        let losses = problem.held_out(&r, &DMatrix::zeros(r.len(), 0), &DVector::zeros(0));
        let mean_square = crate::gap::fit::cost(&problem, &r) / r.len() as f64;
        let ready = columns(&problem, &self.all, &scene(model.grid), &[], false)?;
        let significance = match healthy {
            Some(healthy) => {
                let (nuisance, lambda) = model.nuisance(&[])?;
                let edges = model.edges();
                significance(
                    &nuisance,
                    &lambda,
                    model.stiffness(),
                    &edges,
                    &ready,
                    healthy,
                    per_bin,
                    SEED,
                )
            }
            None => Significance {
                gain: CONFIG.supply_gain_min,
                mean_square: 1.0,
            },
        };
        let threshold = significance.gain.max(CONFIG.supply_gain_min);
        let mut singles = explain(&problem, &self.all, &ready, None, 0.0, self.progress)?;
        if !self.commissioned {
            // Regulators that were fitted without an effect take its part: each common effect is
            // judged with the regulators that go with it.
            for e in singles.iter_mut().filter(|e| e.candidate.target.is_none()) {
                *e = self.settle(&mut model.clone(), e)?;
                (e.gain, e.se) = e.losses.gain_over(&losses);
            }
            singles.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        }
        let mut begun: Vec<&str> = Vec::new();
        let mut grown: Vec<(EffectSet, Vec<Vec<Explained>>)> = Vec::new();
        for e in singles
            .iter()
            .filter(|e| e.gain > threshold.max(CONFIG.supply_first_se * e.se))
        {
            if begun.contains(&e.candidate.effect.id) || begun.len() >= CONFIG.supply_beginnings {
                continue;
            }
            begun.push(e.candidate.effect.id);
            grown.push(self.grow(model.clone(), e, &losses, threshold)?);
        }
        grown.sort_by(|a, b| b.0.explained.gain.total_cmp(&a.0.explained.gain));
        let mut stages = vec![singles];
        if let Some((_, further)) = grown.first() {
            stages.extend(further.clone());
        }
        let mut sets: Vec<EffectSet> = Vec::new();
        for (set, _) in grown {
            let known = sets.iter().any(|s| same(&s.explained, &set.explained));
            // Regulators that nobody measured take small effects' part as well as the effects do.
            let more =
                self.commissioned || set.mean_square < CONFIG.supply_without_healthy * mean_square;
            if set.explained.gain > threshold && more && !known {
                sets.push(set);
            }
        }
        // The smallest set within one standard error of the best.
        if let Some(best) = sets.first().cloned() {
            let size = |s: &EffectSet| s.explained.fit.effects.len();
            let small = (1..sets.len())
                .filter(|k| size(&sets[*k]) < size(&best))
                .filter(|k| {
                    let other = &sets[*k].explained.losses;
                    let (margin, se) = best.explained.losses.gain_over(other);
                    margin < se
                })
                .min_by_key(|k| size(&sets[*k]));
            if let Some(k) = small {
                let set = sets.remove(k);
                sets.insert(0, set);
            }
        }
        drop(problem);
        Ok(Stages {
            baseline: model.baseline,
            losses,
            mean_square,
            stages,
            sets,
            significance: Significance {
                gain: threshold,
                ..significance
            },
        })
    }
}

/// Seed of the resampled sessions.
const SEED: u64 = 0x5eed;

/// Whether two fits name the same effects on the same channels.
pub fn same(a: &Explained, b: &Explained) -> bool {
    let (a, b) = (&a.fit.effects, &b.fit.effects);
    a.len() == b.len() && a.iter().all(|(c, _)| b.iter().any(|(d, _)| c == d))
}

/// Explains a pressure log, against a commissioned supply or an ideal one, with the effects of `table`. Against an ideal
/// one, regulators are fitted beside the effects, and the noise is the residual of the best fit.
///
/// # Errors
/// [`GapError`] when stopped, or numbers are not finite.
pub fn supply_stages(
    robot: &RobotSpec,
    grid: &PressureGrid,
    baseline: &LineBaseline,
    lag: Lag,
    table: Table<'_>,
    progress: &dyn Progress,
) -> Result<Stages, GapError> {
    let commissioned = baseline.healthy.is_some();
    let search = Search {
        all: admitted(table, grid, lag, commissioned),
        commissioned,
        progress,
    };
    let mut model = LineModel {
        robot,
        grid,
        baseline: baseline.clone(),
        lag,
        seen: None,
    };
    if let Some(rows) = &baseline.healthy {
        let chambers = grid.chambers();
        let healthy = DVector::from_iterator(
            rows.len() * chambers.len(),
            rows.iter().flat_map(|row| chambers.iter().map(|i| row[*i])),
        );
        return search.pass(model, Some(&healthy));
    }
    let mut out = search.pass(model.clone(), None)?;
    for _ in 0..2 {
        let (regulators, effects) = match out.sets.first() {
            Some(s) => (s.baseline.regulators, s.explained.fit.active()),
            None => (out.baseline.regulators, Vec::new()),
        };
        let mut best = model.clone();
        best.baseline.regulators = regulators;
        let rows = best.rows(&effects);
        model.baseline.noise = PressureNoise::from_rows(&rows);
        best.baseline.noise = model.baseline.noise.clone();
        let healthy = best.stack(&rows);
        out = search.pass(model.clone(), Some(&healthy))?;
    }
    Ok(out)
}
