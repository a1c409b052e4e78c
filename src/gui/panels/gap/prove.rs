//! Prove: errors on held-out data before and after, the control, what got worse, and the report.

use std::path::Path;
use std::sync::Arc;

use egui::{Button, RichText, ScrollArea, Sense, Ui, vec2};

use super::chart::{Chart, Line};
use super::{GapState, Outcome, Show, Trouble, views};
use crate::gap::report::{self, Origin, short_number, shuffled};
use crate::gap::{ChannelError, Finding, GapSize};
use crate::gui::panels::plot::Dash;
use crate::gui::panels::widgets::card;
use crate::gui::panels::widgets::{
    Gate, badge, cell, cell_left, gated, heading, note, number, pane, status,
};
use crate::gui::services::{Content, Dialog, DialogKind, Job, Services};
use crate::gui::theme::{Level, Palette};

/// Name of a report that is saved.
const REPORT: &str = "gap-report.html";

/// Takes reports that were written and shown.
pub fn poll(state: &mut GapState, services: &mut Services) {
    state.saving.poll();
    if let Some(((show, folder), answer)) = state.opening.take_for() {
        match answer {
            Ok(()) => state.said = Some(format!("Written to {}.", folder.display())),
            Err(e) => state.trouble = Some(unshown(e, show, &folder)),
        }
    }
    let Some(outcome) = &mut state.outcome else {
        return;
    };
    let Some(((show, alternative), answer)) = outcome.keeping.take_for() else {
        return;
    };
    match answer {
        Ok(folder) => {
            let job = match show {
                Show::Page => (services.gap.open_page)(&folder.join(show.file())),
                Show::Overlay => (services.open_in_rerun)(&folder.join(show.file())),
            };
            state.opening.begin_for((show, folder.clone()), job);
            outcome.kept = Some((alternative, folder));
        }
        Err(e) => state.trouble = Some(unwritten(e)),
    }
}

fn unshown(e: String, show: Show, folder: &Path) -> Trouble {
    let path = folder.join(show.file());
    let remedy = match show {
        Show::Page => "Open it in a browser, here or on another computer: it needs no other file.",
        Show::Overlay => "Open it by hand: rerun with the path behind it.",
    };
    let text = format!("It is written all the same: {}", path.display());
    Trouble::new(e, &text, remedy).about(&path)
}

fn unwritten(e: String) -> Trouble {
    Trouble::new(
        e,
        "The report is not written; the finding is kept here.",
        "Choose another folder, or free some disk space.",
    )
}

fn page(outcome: &Outcome) -> Content {
    let (found, patch, origin) = (Arc::clone(&outcome.found), outcome.patch(), outcome.origin);
    Box::new(move || {
        let page = report::html(&found.finding, &patch.to_toml(), origin);
        Ok(page.into_bytes())
    })
}

/// The step.
pub fn ui(ui: &mut Ui, state: &mut GapState, services: &mut Services) {
    let height = ui.available_height();
    ui.horizontal_top(|ui| {
        let left = (ui.available_width() * 0.60).max(600.0);
        ui.allocate_ui(vec2(left, height), |ui| {
            card(ui, |ui| {
                ui.set_min_size(ui.available_size());
                if let Some(outcome) = &state.outcome {
                    gap(ui, outcome);
                    if !outcome.adds() && outcome.found.finding.channels.iter().any(|c| c.shuffled.is_some())
                    {
                        note(
                            ui,
                            "“After” is the best attempt of the table: it is measured here, and not offered as \
                             a patch.",
                        );
                    }
                    groups(ui, &outcome.found.finding);
                }
            });
        });
        ui.vertical(|ui| {
            pane(ui, "report", |ui| {
                reports(ui, state, services);
                if let Some(outcome) = &state.outcome {
                    ui.separator();
                    ways(ui, outcome);
                }
            });
        });
    });
}

// The gap where it shows best: three bars and how much of it is closed.
fn gap(ui: &mut Ui, outcome: &Outcome) {
    let p = *Palette::in_ui(ui);
    let g = &outcome.found.finding.gap;
    ui.horizontal(|ui| {
        ui.label(RichText::new("Error on held-out data").strong());
        if outcome.origin == Origin::Simulated {
            badge(ui, "simulated", p.raised, p.text).on_hover_text("From a virtual rig");
        }
        if outcome.adds() && g.closed.is_finite() {
            let text = format!("{} % of the gap closed", number(100.0 * g.closed, 0));
            ui.label(RichText::new(text).strong())
                .on_hover_text("(before − after) / (before − floor)");
        }
    });
    if !(g.before.is_finite() && g.before > 0.0) {
        return;
    }
    ui.scope(|ui| {
        ui.spacing_mut().item_spacing.y = 1.0;
        ui.spacing_mut().interact_size.y = 18.0;
        let [_, without, with] = views::colors(&p);
        let mut rows = vec![("without the effect", g.before, without)];
        if outcome.adds() {
            rows.push(("with the effect", g.after, with));
        }
        rows.push(("noise floor", g.floor, p.bar));
        let most = g.before.max(g.after).max(g.floor);
        for (name, value, color) in rows {
            gap_row(ui, g, name, value / most, value, color, &p);
        }
    });
    ui.separator();
}

fn gap_row(
    ui: &mut Ui,
    g: &GapSize,
    name: &str,
    share: f64,
    value: f64,
    color: egui::Color32,
    p: &Palette,
) {
    ui.horizontal(|ui| {
        cell_left(ui, 130.0, RichText::new(name).color(p.weak));
        let width = ui.available_width() - 110.0;
        let (rect, _) = ui.allocate_exact_size(vec2(width, 12.0), Sense::hover());
        let mut fill = rect;
        fill.set_width((rect.width() * share.clamp(0.0, 1.0) as f32).max(1.0));
        ui.painter().rect_filled(fill, 2.0, color);
        ui.label(format!("{} {}", short_number(value), g.unit));
    });
}

const HEAD: [(&str, &str); 7] = [
    ("before", "Root-mean-square error without the effect"),
    ("after", "With the effect"),
    ("95 %", "95 % interval of “after”, from block to block"),
    (
        "shuffled",
        "With the effect driven by inputs in the wrong order: must not help",
    ),
    ("floor", "Noise floor: the error that a healthy rig keeps"),
    ("closed", "(before − after) / (before − floor)"),
    ("unit", "Unit of the errors"),
];

fn groups(ui: &mut Ui, finding: &Finding) {
    let p = *Palette::in_ui(ui);
    if finding.worse.is_empty() {
        ui.label("● No group of channels got worse on held-out data.");
    } else {
        let names: Vec<&str> = finding.worse.iter().map(|c| c.name.as_str()).collect();
        status(
            ui,
            Level::Warning,
            &format!("Got worse: {}.", names.join(", ")),
        );
    }
    for fold in &finding.failed_folds {
        status(ui, Level::Warning, &fold.text());
    }
    if let Some(text) = shuffled(&finding.channels) {
        note(ui, text);
    }
    let name = 112.0;
    let interval = 122.0;
    let width =
        ((ui.available_width() - name - interval - 34.0 - 8.0 * 4.0 - 12.0) / 5.0).max(40.0);
    let widths = [width, width, interval, width, width, width, 34.0];
    ui.spacing_mut().item_spacing = vec2(4.0, 1.0);
    ui.spacing_mut().interact_size.y = 18.0;
    ui.horizontal(|ui| {
        cell_left(ui, name, RichText::new("channels").small().color(p.weak));
        for ((text, hover), w) in HEAD.into_iter().zip(widths) {
            cell(ui, w, RichText::new(text).small().color(p.weak)).on_hover_text(hover);
        }
    });
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        for c in &finding.channels {
            let worse = finding.worse.iter().any(|w| w.name == c.name);
            group(ui, c, worse, name, widths, &p);
        }
    });
}

fn group(ui: &mut Ui, c: &ChannelError, worse: bool, name: f32, widths: [f32; 7], p: &Palette) {
    let maybe = |v: Option<f64>| v.map_or("–".to_owned(), short_number);
    // Where nothing exceeds the noise floor, nothing can be closed.
    let closed = c.floor.filter(|f| c.before > 1.5 * f).map(|f| {
        format!(
            "{} %",
            number(100.0 * (c.before - c.after) / (c.before - f), 0)
        )
    });
    let texts = [
        short_number(c.before),
        short_number(c.after),
        format!(
            "{} to {}",
            short_number(c.after_ci95[0]),
            short_number(c.after_ci95[1])
        ),
        maybe(c.shuffled),
        maybe(c.floor),
        closed.unwrap_or("–".to_owned()),
        c.unit.clone(),
    ];
    ui.horizontal(|ui| {
        let (text, color) = if worse {
            (format!("▲ {}", c.name), p.warning)
        } else {
            (c.name.clone(), p.text)
        };
        let row = cell_left(ui, name, RichText::new(text).color(color));
        if worse {
            row.on_hover_text("It got worse with the effect");
        }
        for (i, (text, w)) in texts.into_iter().zip(widths).enumerate() {
            let weak = matches!(i, 2 | 6);
            let color = if weak { p.weak } else { p.text };
            cell(ui, w, RichText::new(text).color(color));
        }
    });
}

impl GapState {
    /// Whether a report of the finding can be written, or why not.
    pub fn report_gate(&self) -> Gate {
        let outcome = self.finding()?;
        let busy = outcome.keeping.is_busy() || self.opening.is_busy() || self.saving.is_busy();
        match busy {
            true => Err("The report is being written.".to_owned()),
            false => Ok(()),
        }
    }

    /// Asks where the report shall be written.
    pub fn ask_for_report(&mut self, services: &Services) {
        self.saving.ask(&services.exports.join(REPORT));
    }

    /// Writes the report and shows it in the browser.
    pub fn open_report(&mut self, services: &mut Services) {
        self.keep(Show::Page, services);
    }

    /// Writes the report and shows a part of it.
    fn keep(&mut self, show: Show, services: &mut Services) {
        let Some(outcome) = &mut self.outcome else {
            return;
        };
        let job = match &outcome.kept {
            Some((of, folder)) if *of == outcome.alternative => Job::ready(Ok(folder.clone())),
            _ => (services.gap.keep)(&outcome.found, &outcome.patch(), outcome.origin),
        };
        outcome.keeping.begin_for((show, outcome.alternative), job);
        (self.said, self.saving.said) = (None, None);
    }
}

fn reports(ui: &mut Ui, state: &mut GapState, services: &mut Services) {
    let idle = state.report_gate();
    let Some(outcome) = &mut state.outcome else {
        return;
    };
    ui.label(RichText::new("Report").strong());
    if state.saving.is_asking() {
        let dialog = || Dialog {
            title: "Save the gap report".to_owned(),
            kind: DialogKind::Save,
            filter: Some(("web pages".to_owned(), vec!["html".to_owned()])),
            name: REPORT.to_owned(),
        };
        let hover = "Write the report: one page that needs nothing else";
        if let Some(to) = state.saving.ui(ui, hover, dialog, services) {
            let content = page(outcome);
            state.saving.write(to, "the report", content, services);
        }
        return;
    }
    let mut keep = None;
    let busy = outcome.keeping.is_busy() || state.opening.is_busy();
    ui.horizontal_wrapped(|ui| {
        let hover = "Write the report and show it in the browser";
        if gated(ui, &idle, Button::new("Open report"), hover).clicked() {
            keep = Some(Show::Page);
        }
        let hover = "Write the report where you like: one page that needs nothing else";
        if gated(ui, &idle, Button::new("Save report…"), hover).clicked() {
            state.ask_for_report(services);
        }
        let hover = "The measured path of the tip beside the simulated ones, in the Rerun viewer";
        if gated(ui, &idle, Button::new("Open in Rerun"), hover).clicked() {
            keep = Some(Show::Overlay);
        }
        if busy {
            ui.spinner();
        }
    });
    if let Some(show) = keep {
        state.keep(show, services);
    }
    ui.horizontal(|ui| state.saving.show(ui));
    if let Some(said) = &state.said {
        note(ui, said.as_str());
    }
}

// Way of the end pad, measured and simulated.
fn ways(ui: &mut Ui, outcome: &Outcome) {
    let p = *Palette::in_ui(ui);
    let t = &outcome.found.finding.traces;
    let (Some(from), Some(to)) = (t.t_s.first(), t.t_s.last()) else {
        note(ui, "There are no traces to draw.");
        return;
    };
    heading(ui, "Path of the end pad, measured and simulated");
    if !t.measured_m.iter().flatten().any(|v| v.is_finite()) {
        note(ui, "No motion capture: simulated paths only.");
    }
    let [measured, without, with] = views::colors(&p);
    ui.spacing_mut().item_spacing.y = 2.0;
    let height = (ui.available_height() / 3.0 - 3.0).max(56.0);
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        let line = |name, color, dash, way: &[[f64; 3]]| Line {
            name,
            color,
            dash,
            values: way.iter().map(|m| 1e3 * m[i]).collect(),
        };
        let mut lines = vec![
            line("measured", measured, Dash::Solid, &t.measured_m),
            line("without", without, Dash::Dashed, &t.before_m),
        ];
        if outcome.adds() {
            lines.push(line("with", with, Dash::Dashed, &t.after_m));
        }
        Chart {
            title: &format!("{axis} / mm"),
            unit: "mm",
            t_s: &t.t_s,
            lines,
            range_s: [*from, *to],
            mark_s: None,
            begins_s: outcome.found.finding.onset.map(|o| o.ci95),
            band: None,
            limits: None,
            min_span: 2.0,
            legend: i == 0,
        }
        .show(ui, height);
    }
}
