//! Score of the search for laws: what was hidden is in no table, and the law is proved on a third session.

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

use super::suite::Planned;
use super::{Places, finder};
use crate::drive::read_text;
use crate::gap::GapSize;
use crate::gap::score::{Key, median, median_ci95, wilson};
use crate::sim::effects::{Input, Site};

/// Where the law of a hidden effect may act, and on what it may depend.
fn answer(id: &str) -> Option<(&'static [Site], &'static [Input])> {
    use Input as I;
    use Site as S;
    Some(match id {
        "pressure-delay" => (&[S::SupplyPressure], &[I::PressureHistory, I::PressureRate]),
        "flow-limit" | "regulator-asymmetry" => (&[S::SupplyPressure], &[I::PressureRate]),
        "leak" => (&[S::SupplyPressure], &[I::Pressure]),
        "supply-coupling" => (&[S::SupplyPressure], &[I::OtherPressure]),
        "pressure-lag" => (&[S::ChamberPressure], &[I::PressureRate]),
        "gauge-error" => (&[S::ChamberPressure], &[I::None, I::Pressure]),
        "hysteresis" => (&[S::ChamberTension], &[I::Reversal]),
        "creep" => (
            &[S::ChamberTension],
            &[I::LengthHistory, I::PressureHistory],
        ),
        "damping" => (&[S::SegmentStiffness, S::ChamberTension], &[I::LengthRate]),
        "stiffening" | "chamber-stiffness" | "bellows-snap" | "bellows-touch" | "gripper-cable" => {
            (&[S::ChamberTension], &[I::Length])
        }
        "payload" | "tip-force" => (&[S::EndForce], &[I::None]),
        "com-offset" => (&[S::EndMoment], &[I::Orientation, I::None]),
        "base-tilt" => (&[S::Gravity], &[I::None]),
        "contact" => (&[S::EndForce], &[I::Position]),
        "torsion" => (&[S::SegmentStiffness], &[I::Twist]),
        "spring-lag" => (&[S::SpringReading], &[I::LengthRate]),
        "spring-crosstalk" => (&[S::SpringReading], &[I::PartnerLength]),
        "spring-calibration" => (&[S::SpringReading], &[I::None, I::Length]),
        "spring-drift" | "spring-stuck" => (&[S::SpringReading], &[I::Time]),
        "imu-drift" => (&[S::ImuReading], &[I::Time]),
        "imu-misalignment" => (&[S::ImuReading], &[I::None]),
        "clock-offset" | "clock-skew" => (&[S::Capture], &[I::PadRate]),
        "mocap-frame" => (&[S::Capture], &[I::None]),
        "temperature-stiffness" => (&[S::ChamberTension, S::SegmentStiffness], &[I::Time]),
        "area-growth" => (&[S::ChamberTension], &[I::Pressure]),
        "area-bending" => (&[S::ChamberTension], &[I::Bending]),
        "hose-drag" => (&[S::EndForce], &[I::Reversal]),
        "pump-interference" => (&[S::SpringReading], &[I::PressureRate]),
        "seat-stick-slip" => (&[S::SpringReading], &[I::Reversal]),
        // The library has no site for it: a law would be a wrong one.
        _ => return None,
    })
}

/// What may hold of a case.
type Holds = fn(&Solved) -> bool;

/// A case with its answer and the finder's.
pub struct Solved {
    name: String,
    key: Key,
    said: Value,
    left_out: bool,
}

/// Reads a case.
///
/// # Errors
/// When the answer or the verdict cannot be read.
pub fn read(planned: &Planned, places: &Places) -> Result<Solved> {
    let path = places.key(planned);
    let key: Key = serde_json::from_str(&read_text(&path)?)
        .with_context(|| format!("the key {} does not read", path.display()))?;
    let said = read_text(&places.case(planned).join(finder::VERDICT))?;
    Ok(Solved {
        name: planned.name.clone(),
        key,
        said: serde_json::from_str(&said).context("a verdict does not read")?,
        left_out: planned.without.is_some(),
    })
}

impl Solved {
    fn has_law(&self) -> bool {
        self.said["verdict"] == "law"
    }

    fn hidden(&self) -> Option<&str> {
        Some(&self.key.effects.first()?.id)
    }

    /// Whether the first law acts where it should, and whether it depends on what it should.
    fn right(&self) -> Option<[bool; 2]> {
        let (sites, inputs) = answer(self.hidden()?)?;
        let law = &self.said["laws"][0];
        let site = sites.iter().any(|s| json!(s) == law["site"]);
        let given = law["terms"][0]["inputs"].as_array();
        let is = |i: &Input| given.is_some_and(|g| g.contains(&json!(i)));
        Some([site, inputs.iter().any(is)])
    }

    /// The gap in the third session; none without a law.
    fn proof(&self) -> Option<GapSize> {
        serde_json::from_value(self.said["proof"].clone()).ok()
    }

    /// Share of the gap that closes in the third session, where what is hidden shows there.
    fn closed(&self) -> Option<f64> {
        self.proof().filter(GapSize::shows).map(|g| g.closed)
    }
}

pub(super) fn share(hits: usize, of: usize) -> String {
    let Some([low, high]) = wilson(hits, of) else {
        return "no cases".to_owned();
    };
    format!(
        "{hits}/{of} = {:.1} % [{:.1}, {:.1}]",
        100.0 * hits as f64 / of as f64,
        100.0 * low,
        100.0 * high
    )
}

/// The report as Markdown and JSON.
pub fn report(all: &[Solved], head: &str) -> (String, Value) {
    let mut text = format!(
        "# Blind test of the search for laws\n\nAll figures are from simulated sessions of the virtual rig; nothing here was measured on an arm. {head}\n\n\
         {} cases. Brackets: 95 % intervals (Wilson's for shares, order statistics for medians). Every effect has 4 times the noise floor, as far as its \
         bounds allow. A law is proved on a third session with another excitation. The driving input is right where the first term depends on it.\n\n\
         | | effects left out of the table | never in the table |\n|---|---|---|\n",
        all.len()
    );
    let group = |left_out: bool| -> Vec<&Solved> {
        let of = all.iter();
        of.filter(|s| s.hidden().and_then(answer).is_some() && s.left_out == left_out)
            .collect()
    };
    let groups = [group(true), group(false)];
    let rows: [(&str, Holds); 3] = [
        ("a law", Solved::has_law),
        ("a law at the right site", |s| {
            s.has_law() && s.right().is_some_and(|r| r[0])
        }),
        ("with the right driving input", |s| {
            s.has_law() && s.right() == Some([true, true])
        }),
    ];
    let mut json = json!({});
    for (name, is) in rows {
        let counts = groups.each_ref().map(|g| {
            let hits = g.iter().filter(|s| is(s)).count();
            share(hits, g.len())
        });
        text += &format!("| {name} | {} | {} |\n", counts[0], counts[1]);
        json[name] = json!(counts);
    }
    let closed = groups.each_ref().map(|g| {
        let mut shares: Vec<f64> = g
            .iter()
            .filter(|s| s.has_law())
            .filter_map(|s| s.closed())
            .collect();
        shares.sort_by(f64::total_cmp);
        match (median(&shares), median_ci95(&shares)) {
            (Some(m), Some([a, b])) => {
                format!("{:.1} % [{:.1}, {:.1}]", 100.0 * m, 100.0 * a, 100.0 * b)
            }
            (Some(m), None) => format!("{:.1} %", 100.0 * m),
            _ => "no cases".to_owned(),
        }
    });
    text += &format!(
        "| gap closed in the third session, median of the laws | {} | {} |\n",
        closed[0], closed[1]
    );
    let nulls: Vec<&Solved> = all.iter().filter(|s| s.key.effects.is_empty()).collect();
    let quiet = nulls.iter().filter(|s| !s.has_law()).count();
    text += &format!(
        "\nNothing hidden: no law in {}.\n",
        share(quiet, nulls.len())
    );
    json["nulls without a law"] = json!(share(quiet, nulls.len()));
    json["closed"] = json!(closed);
    let no_site: Vec<&Solved> = all
        .iter()
        .filter(|s| s.hidden().is_some_and(|id| answer(id).is_none()))
        .collect();
    let refused = no_site.iter().filter(|s| !s.has_law()).count();
    text += &format!(
        "Hidden where the library has no site: no law in {}.\n\n",
        share(refused, no_site.len())
    );
    text += "| case | hidden | times the floor | law | right (site, input) | closed in the third session | s |\n|---|---|---|---|---|---|---|\n";
    for s in all {
        let hidden = s.key.effects.first();
        let reached = hidden.and_then(|e| e.reached);
        let law = match s.has_law() {
            true => s.said["laws"][0]["terms"][0]["id"].as_str(),
            false => Some("none"),
        };
        let yes = |b: bool| if b { "yes" } else { "no" };
        text += &format!(
            "| {} | {} | {} | {} | {} | {} | {:.0} |\n",
            s.name,
            hidden.map_or("nothing", |e| &e.id),
            reached.map_or("-".to_owned(), |r| format!("{r:.1}")),
            law.unwrap_or("failed"),
            s.right()
                .filter(|_| s.has_law())
                .map_or("-".to_owned(), |[a, b]| format!("{}, {}", yes(a), yes(b))),
            s.closed().map_or(
                match s.proof() {
                    Some(_) => "no gap there".to_owned(),
                    None => "-".to_owned(),
                },
                |c| format!("{:.0} %", 100.0 * c)
            ),
            s.said["seconds"].as_f64().unwrap_or(f64::NAN)
        );
    }
    (text, json)
}
