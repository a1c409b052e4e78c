//! Tables of figures, ours beside the paper's: as JSON, as Markdown, as a picture.

use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

use crate::charts::{Axes, Bar, Bars, Chart, Line};

/// Origin of a row's figures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Ours, on the virtual rig or in simulation.
    Simulated,
    /// The paper's, on hardware.
    Paper,
}

impl Source {
    fn words(self) -> &'static str {
        match self {
            Self::Simulated => "simulated",
            Self::Paper => "paper, hardware",
        }
    }

    /// Index of its colour.
    fn colour(self) -> usize {
        match self {
            Self::Simulated => 1,
            Self::Paper => 5,
        }
    }
}

/// One line of figures.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Label of the row.
    pub label: String,
    /// Origin of the figures.
    pub source: Source,
    /// One figure per column; `None` where there is none.
    pub cells: Vec<Option<f64>>,
}

impl Row {
    /// Whether the figures are ours.
    pub fn is_ours(&self) -> bool {
        self.source == Source::Simulated
    }
}

/// All of these figures.
pub fn some(cells: &[f64]) -> Vec<Option<f64>> {
    cells.iter().map(|c| Some(*c)).collect()
}

/// Picture of a table: its first column over the rows, or a chart of its own.
#[derive(Clone, Debug, PartialEq)]
pub enum Drawn {
    /// A bar per row.
    Bars,
    /// A point per row, over the number that each label begins with.
    Line {
        /// Quantity that the labels count.
        x: &'static str,
        /// Whether they are spread by their logarithm.
        logarithmic: bool,
    },
    /// Lines that the study drew itself.
    Chart(Box<Chart>),
}

/// A table of a study.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// File name without its ending.
    pub name: &'static str,
    /// Its title.
    pub title: &'static str,
    /// Notes on method and result.
    pub notes: Vec<String>,
    /// Names of the columns, with units.
    pub columns: Vec<&'static str>,
    /// The figures.
    pub rows: Vec<Row>,
    /// The picture.
    pub drawn: Drawn,
}

impl Table {
    /// A table without rows.
    pub fn new(
        name: &'static str,
        title: &'static str,
        columns: &[&'static str],
        drawn: Drawn,
    ) -> Self {
        Self {
            name,
            title,
            notes: Vec::new(),
            columns: columns.to_vec(),
            rows: Vec::new(),
            drawn,
        }
    }

    /// Adds a row of ours: one figure per column, `None` where there is none.
    pub fn ours(&mut self, label: impl Into<String>, cells: Vec<Option<f64>>) {
        self.row(label, Source::Simulated, cells);
    }

    /// Adds a row of the paper's: figures of the first columns, `None` where there is none.
    pub fn paper(&mut self, label: impl Into<String>, mut cells: Vec<Option<f64>>) {
        let width = self.columns.len();
        cells.resize(width, None);
        self.row(label, Source::Paper, cells);
    }

    fn row(&mut self, label: impl Into<String>, source: Source, cells: Vec<Option<f64>>) {
        self.rows.push(Row {
            label: label.into(),
            source,
            cells,
        });
    }

    /// As JSON: columns, rows with label, source and figures.
    pub fn json(&self) -> Value {
        let rows: Vec<Value> = self
            .rows
            .iter()
            .map(|r| json!({"label": r.label, "source": r.source.words(), "cells": r.cells}))
            .collect();
        json!({
            "name": self.name, "title": self.title, "notes": self.notes, "columns": self.columns, "rows": rows,
        })
    }

    /// As a section of Markdown.
    pub fn markdown(&self) -> String {
        let mut out = format!("## {}\n\n", self.title);
        for note in &self.notes {
            out += &format!("{note}\n\n");
        }
        out += &format!("| | source | {} |\n|---|---|", self.columns.join(" | "));
        out += &"---|".repeat(self.columns.len());
        out.push('\n');
        for r in &self.rows {
            let cells: Vec<String> = r.cells.iter().map(|c| number(*c)).collect();
            out += &format!(
                "| {} | {} | {} |\n",
                r.label,
                r.source.words(),
                cells.join(" | ")
            );
        }
        out += &format!("\n![{}]({}.svg)\n", self.title, self.name);
        out
    }

    /// Writes NAME.json, NAME.md and NAME.svg.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let write = |ending: &str, text: &str| {
            let path = folder.join(format!("{}.{ending}", self.name));
            std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
        };
        write("json", &serde_json::to_string_pretty(&self.json())?)?;
        write("md", &self.markdown())?;
        write("svg", &self.picture())
    }

    /// The picture as SVG.
    fn picture(&self) -> String {
        let drawn = || {
            let rows = self.rows.iter();
            let first = rows.filter_map(|r| Some((r, (*r.cells.first()?)?)));
            // Axes without an end are never drawn.
            first.filter(|(_, y)| y.is_finite())
        };
        match &self.drawn {
            Drawn::Chart(chart) => chart.svg(),
            Drawn::Bars => {
                let bar = |(r, y): (&Row, f64)| Bar {
                    label: format!("{} ({})", r.label, r.source.words()),
                    value: y,
                    text: number(Some(y)),
                    colour: r.source.colour(),
                };
                let bars = Bars {
                    title: self.title.to_owned(),
                    x: self.columns[0],
                    bars: drawn().map(bar).collect(),
                };
                bars.svg()
            }
            &Drawn::Line { x, logarithmic } => {
                // A line per source and per variant, which stands behind a comma.
                let of = |r: &Row| {
                    let variant = r.label.split_once(", ").map(|(_, variant)| variant);
                    (
                        r.source,
                        variant.unwrap_or_else(|| r.source.words()).to_owned(),
                    )
                };
                let mut names: Vec<(Source, String)> = Vec::new();
                for (r, _) in drawn() {
                    let name = of(r);
                    if !names.contains(&name) {
                        names.push(name);
                    }
                }
                names.sort_by_key(|(source, _)| source.colour());
                let line = |(k, (source, name)): (usize, &(Source, String))| {
                    let own = drawn().filter(|(r, _)| of(r) == (*source, name.clone()));
                    let mut points: Vec<(f64, f64)> = own
                        .filter_map(|(r, y)| Some((leading_number(&r.label)?, y)))
                        .collect();
                    points.sort_by(|a, b| a.0.total_cmp(&b.0));
                    Line {
                        dots: true,
                        ..Line::new(name.clone(), source.colour().max(k + 1), points)
                    }
                };
                let lines = names.iter().enumerate().map(line);
                let chart = Chart {
                    title: self.title.to_owned(),
                    x,
                    y: self.columns[0],
                    lines: lines.filter(|l| !l.points.is_empty()).collect(),
                    axes: match logarithmic {
                        true => Axes::LogX,
                        false => Axes::FromZero,
                    },
                };
                chart.svg()
            }
        }
    }
}

/// Three significant digits or so; a dash for `None`.
pub fn number(x: Option<f64>) -> String {
    match x {
        None => "–".to_owned(),
        Some(x) if x.abs() >= 100.0 => format!("{x:.0}"),
        Some(x) if x.abs() >= 10.0 => format!("{x:.1}"),
        Some(x) => format!("{x:.2}"),
    }
}

fn leading_number(label: &str) -> Option<f64> {
    let end = label
        .find(|c: char| !(c.is_ascii_digit() || c == '.'))
        .unwrap_or(label.len());
    label[..end].parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_says_who_measured_what_in_all_three_forms() {
        let mut t = Table {
            name: "demo",
            title: "Demo",
            notes: vec!["A note.".to_owned()],
            columns: vec!["translation, mm", "yaw, deg"],
            rows: Vec::new(),
            drawn: Drawn::Bars,
        };
        t.ours("fusion", vec![Some(0.456), None]);
        t.paper("fusion", vec![Some(0.9)]);
        let text = t.markdown();
        assert!(text.contains("| fusion | simulated | 0.46 | – |"), "{text}");
        assert!(
            text.contains("| fusion | paper, hardware | 0.90 | – |"),
            "{text}"
        );
        assert_eq!(t.json()["rows"][1]["source"], "paper, hardware");
        for drawn in [
            Drawn::Bars,
            Drawn::Line {
                x: "samples",
                logarithmic: true,
            },
        ] {
            let row = |label: &str, cell: f64| Row {
                label: label.to_owned(),
                source: Source::Simulated,
                cells: vec![Some(cell), None],
            };
            let t = Table {
                drawn,
                rows: vec![row("729 samples", 0.5), row("9 samples", f64::INFINITY)],
                ..t.clone()
            };
            let svg = t.picture();
            assert!(
                svg.starts_with("<svg") && svg.contains("translation, mm"),
                "{svg}"
            );
        }
        assert_eq!(leading_number("2.5 mm/s"), Some(2.5));
    }
}
