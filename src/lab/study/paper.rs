//! A page with every table and figure of the paper that has numbers or an outcome: the paper's figure, ours, and that of
//! the paper's method on the same rig, with the rule by which they are compared.

use anyhow::{Context as _, Result};

use super::conditions::{GRAMS, MM_S, PAPER_40_N, PAPER_RINGING_MM, RINGING};
use super::setup::COLUMNS;
use crate::lab::table::{Table, number};

/// Where a figure of ours stands.
struct Place {
    study: &'static str,
    /// Starts of the labels of the rows: their mean counts.
    rows: Vec<String>,
    column: String,
}

/// A figure of ours.
enum Figure {
    None,
    At(Place),
    /// The first over the second.
    Ratio(Place, Place),
}

/// A line of a comparison.
struct Line {
    what: String,
    paper: Option<f64>,
    ours: Figure,
    /// The paper's method on the same rig.
    theirs: Figure,
}

/// Why networks that were trained on ideal bending are better without forces.
const BENT: &str = "Networks that were trained on an arm which bends as the simulator has it use that as a second source; half of our samples have \
     their pads displaced, so ours use springs and IMUs alone. Where nothing but a weight pulls, the simulator is right and its networks are \
     better; under 40 N (figure 13) they are not. Not tried: a network that chooses between the two.";

/// A table or figure of the paper.
struct Part {
    title: &'static str,
    rule: &'static str,
    /// Why the paper's method does better on the rig where it does, and what was tried; empty where it is not known.
    why: &'static str,
    lines: Vec<Line>,
}

fn at(study: &'static str, row: impl Into<String>, column: impl Into<String>) -> Figure {
    Figure::At(place(study, row, column))
}

fn place(study: &'static str, row: impl Into<String>, column: impl Into<String>) -> Place {
    Place {
        study,
        rows: vec![row.into()],
        column: column.into(),
    }
}

/// The four errors of a row, by the networks under test and by the paper's way.
fn accuracy(study: &'static str, label: &str, paper: [f64; 4], lines: &mut Vec<Line>) {
    for (column, paper) in COLUMNS.iter().zip(paper) {
        lines.push(Line {
            what: format!("{label}: {column}"),
            paper: Some(paper),
            ours: at(study, format!("{label}, after"), *column),
            theirs: at(
                study,
                format!("{label}, after"),
                format!("the paper's way: {column}"),
            ),
        });
    }
}

fn signals() -> Part {
    let rows = [
        ("springs and IMUs", [0.90, 1.06, 0.71, 0.66]),
        ("springs alone", [1.64, 1.33, 1.53, 1.67]),
        ("IMUs alone", [1.85, 1.13, 0.85, 1.01]),
    ];
    let mut lines = Vec::new();
    for (label, paper) in rows {
        for (column, paper) in COLUMNS.iter().zip(paper) {
            let (ours, theirs) = match label {
                "springs and IMUs" => (
                    at("modality", "springs and IMUs, networks under test", *column),
                    at("s2r", "the paper's way, with", *column),
                ),
                _ => (at("modality", label, *column), Figure::None),
            };
            lines.push(Line {
                what: format!("{label}: {column}"),
                paper: Some(paper),
                ours,
                theirs,
            });
        }
    }
    Part {
        title: "Figure 3: which signals",
        rule: "Mean of |error| on new motions at 5 mm/s without load, after the lab's calibration; mean over the test units. The paper's \
               errors are of its own test data.",
        why: BENT,
        lines,
    }
}

fn networks() -> Part {
    let mut lines = Vec::new();
    let mut line = |what: String, study, row: String, column: &str| {
        lines.push(Line {
            what,
            paper: None,
            ours: at(study, row, column),
            theirs: Figure::None,
        });
    };
    for hidden in ["240", "120 + 120", "80 + 80 + 80", "60 + 60 + 60 + 60"] {
        line(
            format!("a: layers of {hidden} neurons, on the rig, mm"),
            "layers",
            hidden.to_owned(),
            "on the rig: translation, mm",
        );
    }
    for net in [
        "120 + 120, one sample",
        "120 + 120, windows",
        "LSTM of 240, windows",
    ] {
        line(
            format!("a: {net}, on the rig, mm"),
            "sequences",
            net.to_owned(),
            COLUMNS[0],
        );
    }
    for neurons in [5, 15, 45, 90, 120] {
        line(
            format!("b: sim-to-real networks of {neurons} neurons, held out, mm"),
            "s2r-width",
            format!("{neurons} neurons"),
            COLUMNS[0],
        );
    }
    for n in [60, 120, 240, 480, 729] {
        lines.push(Line {
            what: format!("sim-to-real networks on {n} settled samples, mm"),
            paper: None,
            ours: Figure::None,
            theirs: at("n-grid", format!("{n} samples"), COLUMNS[0]),
        });
    }
    for with in ["without", "with"] {
        lines.push(Line {
            what: format!("c: {with} sim-to-real networks, mm"),
            paper: None,
            ours: at("s2r", format!("networks under test, {with}"), COLUMNS[0]),
            theirs: at("s2r", format!("the paper's way, {with}"), COLUMNS[0]),
        });
    }
    Part {
        title: "Figure 5: networks",
        rule: "The paper's figure has curves without numbers: two layers are better than one, an LSTM is no better than they, 45 neurons are chosen, the sim-to-real \
               networks make the gap smaller. It compares a and b on its own data; ours are errors of translation on the rig.",
        why: "",
        lines,
    }
}

fn moves() -> Part {
    let far = |who: &str| place("moves", format!("far: {who}, 0 g, stiffness 1"), "steps");
    let mut lines = vec![Line {
        what: "far target: steps without over steps with the initial guess".to_owned(),
        paper: Some(480.0 / 160.0),
        ours: Figure::None,
        theirs: Figure::Ratio(
            far("paper's controller, without initial guess"),
            far("paper's controller, with initial guess"),
        ),
    }];
    for target in ["near", "middle", "far"] {
        for column in ["steps", "final error, mm", "final error, deg"] {
            let of = |who: &str| {
                at(
                    "moves",
                    format!("{target}: {who}, 0 g, stiffness 1"),
                    column,
                )
            };
            lines.push(Line {
                what: format!("{target} target: {column}"),
                paper: None,
                ours: of("ours"),
                theirs: of("paper's controller, with initial guess"),
            });
        }
    }
    Part {
        title: "Figure 7: three target poses on the virtual platform",
        rule: "Steps of 10 ms until the true tip is within 1 mm and 1 degree and stays there; no number where one of the three test units \
               did not settle. The paper's iterations are not steps of ours, so only their ratio is compared.",
        why: "The last tenths of a millimetre are the estimator's: both controllers are read by the same networks.",
        lines,
    }
}

fn loads() -> Part {
    let mut lines = Vec::new();
    for (grams, paper) in GRAMS {
        accuracy("loads", &format!("{grams} g"), paper, &mut lines);
    }
    Part {
        title: "Figure 9: under loads",
        rule: "Mean of |error| in motion at 5 mm/s, after the lab's calibration; mean over the test units.",
        why: "As for figure 3.",
        lines,
    }
}

fn speeds() -> Part {
    let mut lines = Vec::new();
    for (mm_s, paper) in MM_S {
        accuracy("speeds", &format!("{mm_s:.1} mm/s"), paper, &mut lines);
    }
    Part {
        title: "Figure 10: at speeds",
        rule: "As figure 9, without load.",
        why: "As for figure 3.",
        lines,
    }
}

fn tasks() -> Part {
    let light = |study, who: &str| {
        let row = |grams: i32| format!("{who}, {grams} g, stiffness 1");
        Figure::At(Place {
            study,
            rows: [0, 35, 115].map(row).to_vec(),
            column: "mean, mm".to_owned(),
        })
    };
    let mut lines = vec![Line {
        what: "figure 11: fruit in the basket, %".to_owned(),
        paper: Some(100.0),
        ours: at("pick-place", "ours, stiffness 1", "in the basket, %"),
        theirs: at(
            "pick-place",
            "paper's controller, stiffness 1",
            "in the basket, %",
        ),
    }];
    for (study, what, paper) in [("circle", "circle", 3.7), ("eight", "figure 8", 3.3)] {
        lines.push(Line {
            what: format!("figure 12: {what} below 200 g, mean error, mm"),
            paper: Some(paper),
            ours: light(study, "ours"),
            theirs: light(study, "paper's controller"),
        });
        let heavy = |who: &str| at(study, format!("{who}, 500 g, stiffness 1"), "mean, mm");
        lines.push(Line {
            what: format!("figure 12: {what} with 500 g, mean error, mm"),
            paper: None,
            ours: heavy("ours"),
            theirs: heavy("paper's controller"),
        });
    }
    Part {
        title: "Figures 11 and 12: pick and place, paths",
        rule: "Errors of the true tip at the waypoints, mean over the test units. Each controller as it ships: the study `aids` has both with and \
               without the aids of ours. Waypoints are positions; the paper's have an orientation that it does not state.",
        why: "",
        lines,
    }
}

fn lateral() -> Part {
    let columns = [&COLUMNS[..], &["x, mm", "y, mm", "z, mm"]].concat();
    let paper = [&[None], PAPER_40_N.map(Some).as_slice()].concat();
    let line = |(column, paper): (&str, Option<f64>)| Line {
        what: format!("40 N: {column}"),
        paper,
        ours: at("lateral", "40 N, after", column),
        theirs: match COLUMNS.contains(&column) {
            true => at(
                "lateral",
                "40 N, after",
                format!("the paper's way: {column}"),
            ),
            false => Figure::None,
        },
    };
    let ringing = |column: &str| at("shocks", format!("{RINGING}, after"), column);
    let shock = Line {
        what: format!("{RINGING}: translation, mm"),
        paper: Some(PAPER_RINGING_MM),
        ours: ringing(COLUMNS[0]),
        theirs: ringing(&format!("the paper's way: {}", COLUMNS[0])),
    };
    let lines = columns.into_iter().zip(paper).map(line);
    Part {
        title: "Figure 13: under a lateral force, and after a blow",
        rule: "Mean of |error| under at least nine tenths of the force, and in the second in which the arm rings after a blow, after the lab's \
               calibration; mean over the test units. The paper's error after a blow is the largest that it names while its arm vibrates (y, section VI-A).",
        why: "",
        lines: lines.chain([shock]).collect(),
    }
}

fn parts() -> [Part; 7] {
    [
        signals(),
        networks(),
        moves(),
        loads(),
        speeds(),
        tasks(),
        lateral(),
    ]
}

impl Place {
    /// The mean of its rows; `None` where one of them has no figure.
    fn value(&self, tables: &[Table]) -> Result<Option<f64>> {
        let table = tables.iter().find(|t| t.name == self.study);
        let table = table.with_context(|| format!("there is no study {}", self.study))?;
        let column = table.columns.iter().position(|c| *c == self.column);
        let column =
            column.with_context(|| format!("{} has no column {}", self.study, self.column))?;
        let mut sum = 0.0;
        for start in &self.rows {
            let row = table
                .rows
                .iter()
                .find(|r| r.is_ours() && begins(&r.label, start));
            let row = row.with_context(|| format!("{} has no row {start}", self.study))?;
            match row.cells.get(column).copied().flatten() {
                Some(x) => sum += x / self.rows.len() as f64,
                None => return Ok(None),
            }
        }
        Ok(Some(sum))
    }
}

/// Whether a label begins with these whole words.
fn begins(label: &str, start: &str) -> bool {
    let rest = label.strip_prefix(start);
    rest.is_some_and(|rest| !rest.starts_with(char::is_alphanumeric))
}

impl Figure {
    fn value(&self, tables: &[Table]) -> Result<Option<f64>> {
        match self {
            Self::None => Ok(None),
            Self::At(place) => place.value(tables),
            Self::Ratio(a, b) => {
                let (a, b) = (a.value(tables)?, b.value(tables)?);
                Ok(a.zip(b).map(|(a, b)| a / b))
            }
        }
    }
}

/// The page, of the tables of all studies.
///
/// # Errors
/// When a table, a row or a column is missing.
pub(super) fn page(tables: &[Table], seed: u64) -> Result<String> {
    let mut out = format!(
        "# The paper, line by line\n\nThe paper's figures are from its hardware. *Ours* are simulated: the program as it ships on the \
         virtual rig, whose test units no network and no gain was fitted to. *The paper's method* is simulated on the same rig: its \
         networks, trained as it trains them (unloaded samples of the geometric simulator, then the unit's own session), or its \
         controller. Made by `springtwin study all`, version {}, seed {seed}.\n",
        env!("CARGO_PKG_VERSION")
    );
    let (mut behind, mut beaten) = (Vec::new(), Vec::new());
    for part in parts() {
        let before = beaten.len();
        out += &format!(
            "\n## {}\n\n{}\n\n| | paper, hardware | ours | the paper's method on the rig |\n|---|---|---|---|\n",
            part.title, part.rule
        );
        for line in &part.lines {
            let (ours, theirs) = (line.ours.value(tables)?, line.theirs.value(tables)?);
            let cells = [line.paper, ours, theirs].map(number).join(" | ");
            out += &format!("| {} | {cells} |\n", line.what);
            let against = |other: f64, ours: f64| {
                let [ours, other] = [ours, other].map(|x| number(Some(x)));
                format!("- {}: {ours} against {other}", line.what)
            };
            let more_is_better = line.what.ends_with('%');
            let worse = |a: f64, b: f64| if more_is_better { a < b } else { a > b };
            if let (Some(paper), Some(ours)) = (line.paper, ours)
                && worse(ours, paper)
            {
                behind.push(against(paper, ours));
            }
            if let (Some(theirs), Some(ours)) = (theirs, ours)
                && worse(ours, theirs)
            {
                beaten.push(against(theirs, ours));
            }
        }
        if beaten.len() > before && !part.why.is_empty() {
            beaten.push(format!("\n{}\n", part.why));
        }
    }
    let list = |lines: Vec<String>| match lines.is_empty() {
        true => "Nowhere.".to_owned(),
        false => lines.join("\n").trim_end().to_owned(),
    };
    out += &format!(
        "\n## Where the paper's figure is the better one\n\n{}\n\n## Where the paper's method does better on the rig than ours\n\n{}\n",
        list(behind),
        list(beaten)
    );
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::super::list::STUDIES;
    use super::*;
    use crate::lab::table::Drawn;

    /// Tables with the rows that the page asks for: every figure is 0.5.
    fn tables() -> Vec<Table> {
        let mut tables: Vec<Table> = Vec::new();
        let mut add = |place: &Place| {
            let known = tables.iter().position(|t| t.name == place.study);
            let k = known.unwrap_or_else(|| {
                assert!(
                    STUDIES.iter().any(|s| s.name == place.study),
                    "{}",
                    place.study
                );
                tables.push(Table::new(place.study, "", &[], Drawn::Bars));
                tables.len() - 1
            });
            let column: &'static str = Box::leak(place.column.clone().into_boxed_str());
            if !tables[k].columns.contains(&column) {
                tables[k].columns.push(column);
            }
            for row in &place.rows {
                tables[k].ours(row.clone(), vec![Some(0.5); 40]);
            }
        };
        for part in parts() {
            for line in part.lines {
                for figure in [line.ours, line.theirs] {
                    match figure {
                        Figure::None => {}
                        Figure::At(place) => add(&place),
                        Figure::Ratio(a, b) => [a, b].iter().for_each(&mut add),
                    }
                }
            }
        }
        tables
    }

    #[test]
    fn the_page_is_made_of_the_first_studies() {
        let names = |studies: &[super::super::item::Study]| {
            let mut names: Vec<&str> = studies.iter().map(|s| s.name).collect();
            names.sort_unstable();
            names
        };
        let mut used: Vec<&str> = tables().iter().map(|t| t.name).collect();
        used.sort_unstable();
        assert_eq!(used, names(super::super::list::of_paper()));
    }

    #[test]
    fn the_page_lists_where_the_paper_is_better_and_misses_no_row() {
        let mut all = tables();
        let text = page(&all, 1).expect("a page");
        let behind = text.split("better one").nth(1).expect("the list");
        assert!(
            behind.contains("270 g: pitch, deg: 0.50 against 0.40"),
            "{behind}"
        );
        assert!(
            behind.contains("fruit in the basket, %: 0.50 against 100"),
            "{behind}"
        );
        assert!(!behind.contains("circle below 200 g"), "{behind}");
        assert!(text.contains(
            "| far target: steps without over steps with the initial guess | 3.00 | – | 1.00 |"
        ));
        all.retain(|t| t.name != "eight");
        let missing = page(&all, 1).expect_err("a study is missing").to_string();
        assert!(missing.contains("eight"), "{missing}");
    }
}
