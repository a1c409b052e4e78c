//! Tables of a study: as JSON, as Markdown, as a picture.

use std::path::Path;

use anyhow::{Context as _, Result};
use plotters::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::super::drive::pictures::Chart;

/// Where a row's figures come from.
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
}

/// One line of figures.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What it is of.
    pub label: String,
    /// Who measured it.
    pub source: Source,
    /// One figure per column; `None` where there is none.
    pub cells: Vec<Option<f64>>,
}

/// Figures of one item under their label.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// What they are of.
    pub label: String,
    /// One figure per column; `None` where there is none.
    #[serde(with = "exact")]
    pub cells: Vec<Option<f64>>,
}

/// What one item of a study found for its table.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Rows of the table, or what they are made of.
    pub rows: Vec<Figures>,
    /// What there is to say about them.
    pub notes: Vec<String>,
}

impl Found {
    /// A single row.
    pub fn row(label: impl Into<String>, cells: Vec<Option<f64>>) -> Self {
        let mut found = Self::default();
        found.add(label, cells);
        found
    }

    /// The first figure of the first row.
    pub fn first(&self) -> Option<f64> {
        *self.rows.first()?.cells.first()?
    }

    /// One row more.
    pub fn add(&mut self, label: impl Into<String>, cells: Vec<Option<f64>>) {
        let label = label.into();
        self.rows.push(Figures { label, cells });
    }
}

/// Figures as texts: they come back bit for bit, the infinite ones too.
mod exact {
    use serde::{Deserialize as _, Deserializer, Serialize as _, Serializer, de::Error as _};

    pub fn serialize<S: Serializer>(cells: &[Option<f64>], to: S) -> Result<S::Ok, S::Error> {
        let texts: Vec<Option<String>> =
            cells.iter().map(|c| c.map(|x| format!("{x:?}"))).collect();
        texts.serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Option<f64>>, D::Error> {
        let texts = Vec::<Option<String>>::deserialize(from)?;
        let number = |text: String| text.parse().map_err(D::Error::custom);
        texts
            .into_iter()
            .map(|t| t.map(number).transpose())
            .collect()
    }
}

/// All of these figures.
pub fn some(cells: &[f64]) -> Vec<Option<f64>> {
    cells.iter().map(|c| Some(*c)).collect()
}

/// How a table is drawn: its first column over the rows, or a chart of its own.
#[derive(Clone, Debug, PartialEq)]
pub enum Drawn {
    /// A bar per row.
    Bars,
    /// A point per row, over the number that each label begins with.
    Line {
        /// What the labels count.
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
    /// What it shows.
    pub title: &'static str,
    /// How it was made and what it says.
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

    /// Adds what items found: their rows as rows of ours, their notes as notes.
    pub fn take(&mut self, found: Vec<Found>) {
        for f in found {
            for row in f.rows {
                self.ours(row.label, row.cells);
            }
            self.notes.extend(f.notes);
        }
    }

    /// Adds a row of ours.
    pub fn ours(&mut self, label: impl Into<String>, cells: Vec<Option<f64>>) {
        self.row(label, Source::Simulated, cells);
    }

    /// Adds a row of the paper's.
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
    pub fn write(&self, folder: &Path) -> Result<()> {
        let write = |ending: &str, text: &str| {
            let path = folder.join(format!("{}.{ending}", self.name));
            std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
        };
        write("json", &serde_json::to_string_pretty(&self.json())?)?;
        write("md", &self.markdown())?;
        write("svg", &self.picture()?)
    }

    fn picture(&self) -> Result<String> {
        if let Drawn::Chart(chart) = &self.drawn {
            return chart.svg();
        }
        let mut out = String::new();
        self.draw(&mut out)
            .map_err(|e| anyhow::anyhow!("cannot draw {}: {e}", self.name))?;
        Ok(out)
    }

    fn draw(&self, out: &mut String) -> Result<(), Box<dyn std::error::Error>> {
        let drawn: Vec<(&Row, f64)> = self
            .rows
            .iter()
            .filter_map(|r| Some((r, (*r.cells.first()?)?)))
            // Axes without an end are never drawn.
            .filter(|(_, y)| y.is_finite())
            .collect();
        let top = 1.1 * drawn.iter().map(|(_, y)| *y).fold(1e-6, f64::max);
        let colour = |source: Source| match source {
            Source::Simulated => RGBColor(0x1b, 0x6c, 0xa8),
            Source::Paper => RGBColor(0xc7, 0x7b, 0x0a),
        };
        match &self.drawn {
            Drawn::Chart(_) => {}
            Drawn::Bars => {
                let height = 90 + 30 * drawn.len() as u32;
                // Letters of this size are 7 px wide or so.
                let words = |(r, _): &(&Row, f64)| {
                    r.label.chars().count() + r.source.words().chars().count() + 3
                };
                let longest = drawn.iter().map(words).max().unwrap_or(0) as u32;
                let label_px = (7 * longest + 12).max(300);
                let root =
                    SVGBackend::with_string(out, (600 + label_px, height)).into_drawing_area();
                root.fill(&WHITE)?;
                let n = drawn.len() as f64;
                let mut chart = ChartBuilder::on(&root)
                    .caption(self.title, ("sans-serif", 18))
                    .margin(10)
                    .x_label_area_size(36)
                    .y_label_area_size(label_px)
                    .build_cartesian_2d(0.0..top, 0.0..n)?;
                chart
                    .configure_mesh()
                    .max_light_lines(1)
                    .disable_y_mesh()
                    .y_labels(0)
                    .x_desc(self.columns[0])
                    .draw()?;
                for (k, (row, y)) in drawn.iter().enumerate() {
                    let at = n - 1.0 - k as f64;
                    let bar = [(0.0, at + 0.15), (*y, at + 0.85)];
                    chart.draw_series([Rectangle::new(bar, colour(row.source).filled())])?;
                    let (x_px, y_px) = chart.backend_coord(&(0.0, at + 0.5));
                    let text = format!("{} ({})", row.label, row.source.words());
                    let style = ("sans-serif", 13).into_text_style(&root).pos(
                        plotters::style::text_anchor::Pos::new(
                            plotters::style::text_anchor::HPos::Right,
                            plotters::style::text_anchor::VPos::Center,
                        ),
                    );
                    root.draw_text(&text, &style, (x_px - 8, y_px))?;
                    let (x_px, y_px) = chart.backend_coord(&(*y, at + 0.5));
                    root.draw_text(
                        &number(Some(*y)),
                        &style.pos(plotters::style::text_anchor::Pos::new(
                            plotters::style::text_anchor::HPos::Left,
                            plotters::style::text_anchor::VPos::Center,
                        )),
                        (x_px + 4, y_px),
                    )?;
                }
                root.present()?;
            }
            &Drawn::Line { x, logarithmic } => {
                let points: Vec<(f64, f64, Source)> = drawn
                    .iter()
                    .filter_map(|(r, y)| Some((leading_number(&r.label)?, *y, r.source)))
                    .map(|(at, y, s)| (if logarithmic { at.max(1.0).log10() } else { at }, y, s))
                    .collect();
                let (lo, hi) = points
                    .iter()
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), p| {
                        (lo.min(p.0), hi.max(p.0))
                    });
                let pad = (0.05 * (hi - lo)).max(1e-3);
                let root = SVGBackend::with_string(out, (900, 420)).into_drawing_area();
                root.fill(&WHITE)?;
                let mut chart = ChartBuilder::on(&root)
                    .caption(self.title, ("sans-serif", 18))
                    .margin(10)
                    .x_label_area_size(40)
                    .y_label_area_size(60)
                    .build_cartesian_2d(lo - pad..hi + pad, 0.0..top)?;
                chart
                    .configure_mesh()
                    .max_light_lines(1)
                    .x_desc(x)
                    .y_desc(self.columns[0])
                    .x_label_formatter(&|v| {
                        format!("{:.0}", if logarithmic { 10f64.powf(*v) } else { *v })
                    })
                    .draw()?;
                for source in [Source::Simulated, Source::Paper] {
                    let mut own: Vec<(f64, f64)> = points
                        .iter()
                        .filter(|p| p.2 == source)
                        .map(|p| (p.0, p.1))
                        .collect();
                    own.sort_by(|a, b| a.0.total_cmp(&b.0));
                    if own.is_empty() {
                        continue;
                    }
                    let c = colour(source);
                    chart
                        .draw_series(LineSeries::new(own.clone(), c.stroke_width(2)))?
                        .label(source.words())
                        .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], c));
                    chart.draw_series(own.iter().map(|p| Circle::new(*p, 4, c.filled())))?;
                }
                chart
                    .configure_series_labels()
                    .position(SeriesLabelPosition::LowerLeft)
                    .background_style(WHITE)
                    .border_style(BLACK)
                    .draw()?;
                root.present()?;
            }
        }
        Ok(())
    }
}

/// Three significant digits or so; a dash for none.
fn number(x: Option<f64>) -> String {
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
            let svg = t.picture().expect("draws");
            assert!(
                svg.starts_with("<svg") && svg.contains("translation, mm"),
                "{svg}"
            );
        }
        assert_eq!(leading_number("2.5 mm/s"), Some(2.5));
    }

    #[test]
    fn what_an_item_found_is_read_back_bit_for_bit() {
        let cells = vec![
            Some(0.1 + 0.2),
            Some(1.0 / 3.0 * 1e-300),
            Some(f64::INFINITY),
            Some(-0.0),
            Some(f64::MIN_POSITIVE / 8.0),
            None,
        ];
        let found = Found::row("a", cells.clone());
        let text = serde_json::to_string(&found).expect("text");
        let back: Found = serde_json::from_str(&text).expect("reads");
        let bits = |c: &[Option<f64>]| c.iter().map(|x| x.map(f64::to_bits)).collect::<Vec<_>>();
        assert_eq!(bits(&back.rows[0].cells), bits(&cells));
    }
}
