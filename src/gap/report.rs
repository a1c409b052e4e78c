//! A finding as one HTML page: no script, no external resources, readable on a phone, in print,
//! in light and dark. The markup is well-formed XML.

mod heat;
mod markup;
mod plot;
mod words;

#[cfg(test)]
mod tests;

use super::finding::{ChannelError, Explained, Finding, FoundEffect, Verdict};
use crate::sim::effects::effect_or_term;
pub use heat::{scale, thinned};
use markup::{base64, escape, fixed, number, percent};
pub use markup::{number as short_number, with_error};
pub use words::{
    Quantity, effect_name, equation, next_step, parameter, plainly, quantity, ranked_name,
    residual_name, sentence, shuffled, verdict_name,
};

/// What the session was recorded on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A virtual rig: every figure is labelled as simulated.
    Simulated,
    /// A real arm.
    Measured,
}

/// The commands that apply and revert a patch.
const APPLY: &str = "springtwin gap apply patch.toml --out robot.toml";
const UNDO: &str = "springtwin gap apply --undo robot.toml --out before.toml";
/// Rows of the table of places.
const LOCATED: usize = 12;

/// The page. `patch_toml` is the text of the patch; empty when there is none to apply.
pub fn html(finding: &Finding, patch_toml: &str, origin: Origin) -> String {
    let page = Page { finding, origin };
    let body: String = [
        page.header(),
        page.verdict(),
        page.effects(),
        page.explained(),
        page.tension(),
        page.notes(),
        page.gap(),
        page.residuals(),
        page.tip(),
        page.ranking(),
        page.channels(),
        page.located(),
        page.patch(patch_toml),
        page.data(),
    ]
    .concat();
    format!(
        "<!DOCTYPE html>\n<html xmlns=\"http://www.w3.org/1999/xhtml\" lang=\"en\">\n<head>\n\
         <meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <title>Gap report: {}</title>\n<style>\n{}</style>\n</head>\n<body>\n<main>\n{body}</main>\n\
         </body>\n</html>\n",
        verdict_name(finding.verdict),
        include_str!("report/style.css"),
    )
}

struct Page<'a> {
    finding: &'a Finding,
    origin: Origin,
}

fn section(title: &str, body: &str) -> String {
    format!("<section>\n<h2>{}</h2>\n{body}</section>\n", escape(title))
}

fn paragraph(text: &str) -> String {
    format!("<p>{}</p>\n", escape(text))
}

/// A table; cells are markup, and those from column `numeric` on hold numbers.
fn table(head: &[&str], rows: &[Vec<String>], numeric: usize) -> String {
    let class = |i: usize| if i >= numeric { " class=\"n\"" } else { "" };
    let cells = |tag: &str, row: &[String]| -> String {
        row.iter()
            .enumerate()
            .map(|(i, c)| format!("<{tag}{}>{c}</{tag}>", class(i)))
            .collect()
    };
    let head: Vec<String> = head.iter().map(|h| escape(h)).collect();
    let body: String = rows
        .iter()
        .map(|r| format!("<tr>{}</tr>\n", cells("td", r)))
        .collect();
    format!(
        "<div class=\"scroll\"><table>\n<thead><tr>{}</tr></thead>\n<tbody>\n{body}</tbody></table></div>\n",
        cells("th", &head)
    )
}

/// A sample of a line or an area with its meaning.
fn swatch(shape: &str, meaning: &str) -> String {
    format!(
        "<span><svg xmlns=\"http://www.w3.org/2000/svg\" class=\"swatch\" viewBox=\"0 0 36 14\" \
         aria-hidden=\"true\">{shape}</svg>{}</span>\n",
        escape(meaning)
    )
}

fn sample_line(class: &str) -> String {
    format!("<path d=\"M0 7L36 7\" class=\"line {class}\"/>")
}

fn sample_box(class: &str) -> String {
    format!("<rect x=\"12\" y=\"2\" width=\"10\" height=\"10\" class=\"{class}\"/>")
}

impl Page<'_> {
    /// A picture with its caption; nothing when there is no picture.
    fn figure(&self, picture: &str, caption: &str) -> String {
        if picture.is_empty() {
            return String::new();
        }
        let simulated = match self.origin {
            Origin::Simulated => " <span class=\"tag simulated\">simulated</span>",
            Origin::Measured => "",
        };
        format!(
            "<figure>\n{picture}<figcaption>{}{simulated}</figcaption>\n</figure>\n",
            escape(caption)
        )
    }

    fn header(&self) -> String {
        let simulated = match self.origin {
            Origin::Simulated => {
                "<p><span class=\"tag simulated\">simulated</span> The session comes from the virtual \
                 rig: all its figures are simulated.</p>\n"
            }
            Origin::Measured => "",
        };
        format!(
            "<header>\n<h1>Gap report</h1>\n<p>Where simulation and measurement disagree, which effect is \
             missing from the model, and what is gained by adding it.</p>\n{simulated}</header>\n"
        )
    }

    fn verdict(&self) -> String {
        format!(
            "<section class=\"verdict\">\n<span class=\"tag\">{}</span>\n\
             <p class=\"sentence\">{}</p>\n{}</section>\n",
            verdict_name(self.finding.verdict),
            escape(&sentence(self.finding)),
            self.next()
        )
    }

    /// The next step.
    fn next(&self) -> String {
        match (self.finding.verdict, &self.finding.separate_by) {
            (Verdict::Indistinguishable, Some(s)) => {
                format!(
                    "<p><strong>What to run:</strong> the excitation <code>{}</code>, which \
                     separates {}. {}</p>\n",
                    escape(&s.excitation),
                    escape(&words::separated(s)),
                    escape(&s.why)
                )
            }
            _ => paragraph(&next_step(self.finding)),
        }
    }

    fn effects(&self) -> String {
        let (sure, open) = self.finding.sure_and_open();
        let of = |title, effects: Vec<&FoundEffect>| {
            let body: String = effects.into_iter().map(found_effect).collect();
            section(title, &body)
        };
        let mut out = String::new();
        if !sure.is_empty() {
            out += &of("What was found", sure);
        }
        for choice in open {
            out += &of("What it could be: one of these", choice);
        }
        out
    }

    fn explained(&self) -> String {
        let Some(explained) = Explained::of(&self.finding.traces) else {
            return String::new();
        };
        if self.finding.effects.is_empty() {
            return String::new();
        }
        let caption = format!(
            "{}, one point per instant: the residual without the effect over the part of it that the effect explains, both in noise \
             floors. Points on the line are explained completely.",
            explained.channel
        );
        let picture = self.figure(&plot::explained(&explained), &caption);
        section("What it explains", &picture)
    }

    fn tension(&self) -> String {
        let Some(d) = &self.finding.traces.tension else {
            return String::new();
        };
        let caption = format!(
            "{}. One point per instant: what that bellows would have to pull besides, without a law, over {}.",
            d.text(),
            d.input
        );
        section(
            "Where a force is missing",
            &self.figure(&plot::dependence(d), &caption),
        )
    }

    fn notes(&self) -> String {
        if self.finding.notes.is_empty() {
            return String::new();
        }
        let items: String = self
            .finding
            .notes
            .iter()
            .map(|n| format!("<li>{}</li>\n", escape(n)))
            .collect();
        let title = match self.finding.verdict {
            Verdict::Unknown => "What was observed, and what limits this verdict",
            _ => "What limits this verdict",
        };
        section(title, &format!("<ul>\n{items}</ul>\n"))
    }

    fn gap(&self) -> String {
        let g = &self.finding.gap;
        if !(g.before.is_finite() && g.before > 0.0) {
            return String::new();
        }
        let adds = !self.finding.effects.is_empty();
        let closed = if adds && g.closed.is_finite() {
            format!(
                "<p><strong>Closed {}</strong> of the gap: (before − after) / (before − noise floor).</p>\n",
                percent(g.closed)
            )
        } else {
            String::new()
        };
        let picture = self.figure(
            &plot::gap(g),
            "Root-mean-square error on held-out data, in the residual that shows the gap best. The noise floor \
             is the error of a healthy rig.",
        );
        section("The gap", &format!("{closed}{picture}"))
    }

    fn residuals(&self) -> String {
        let t = &self.finding.traces;
        let end = heat::scale(&t.before);
        let map = |title: &str, rows: &[Vec<f64>], caption: &str| {
            heat::map(title, (t, self.finding.onset.as_ref()), rows, end)
                .map(|m| self.figure(&m, caption))
                .unwrap_or_default()
        };
        let before = map(
            "Residuals over time without the effect",
            &t.before,
            "Without the effect: measured less simulated, one row per channel.",
        );
        if before.is_empty() {
            return String::new();
        }
        let after = if self.finding.effects.is_empty() {
            String::new()
        } else {
            map(
                "Residuals over time with the effect",
                &t.after,
                "With the effect, same scale. The residuals should look like noise.",
            )
        };
        section(
            "Where and when they disagree",
            &format!("{}{before}{after}", heat::key(end)),
        )
    }

    fn tip(&self) -> String {
        let picture = plot::tip(&self.finding.traces, self.finding.onset.as_ref());
        if picture.is_empty() {
            return String::new();
        }
        let key = format!(
            "<p class=\"key\">{}{}{}</p>\n",
            swatch(&sample_line("measured-line"), "measured (solid)"),
            swatch(&sample_line("before-line"), "without the effect (dashed)"),
            swatch(&sample_line("after-line"), "with the effect (dotted)"),
        );
        let figure = self.figure(
            &picture,
            "Position of the end pad in the frame of the motion capture.",
        );
        section("Path of the tip", &format!("{key}{figure}"))
    }

    fn ranking(&self) -> String {
        let f = self.finding;
        let picture = plot::ranking(&f.candidates, f.threshold);
        if picture.is_empty() {
            return String::new();
        }
        let more = f.candidates.len().saturating_sub(plot::DRAWN);
        let more = match more {
            0 => String::new(),
            n => format!(" {n} more were fitted and gained less."),
        };
        let caption = format!(
            "How much better each candidate predicts held-out data than the model without it, ± one \
             standard error. The dashed line is the significance threshold (5 % false-positive rate); a gain \
             below it is not significant.{more}"
        );
        section("Candidates", &self.figure(&picture, &caption))
    }

    fn channels(&self) -> String {
        let f = self.finding;
        if f.channels.is_empty() && f.worse.is_empty() {
            return String::new();
        }
        let worse = if f.worse.is_empty() {
            paragraph("No group of channels got worse on held-out data.")
        } else {
            let names: Vec<&str> = f.worse.iter().map(|c| c.name.as_str()).collect();
            format!(
                "<p><span class=\"warn\">▲ Got worse:</span> {}.</p>\n",
                escape(&names.join(", "))
            )
        };
        let key = format!(
            "<p class=\"key\">{}{}{}{}</p>\n",
            swatch(&sample_box("after"), "with the effect, 95 % interval"),
            swatch(
                "<path d=\"M12 2L22 12M12 12L22 2\" class=\"line cross\"/>",
                "shuffled inputs"
            ),
            swatch(&sample_box("floor"), "noise floor"),
            swatch(&sample_line("chance"), "without the effect"),
        );
        let picture = plot::groups(&f.channels);
        let picture = if picture.is_empty() {
            String::new()
        } else {
            key + &self.figure(
                &picture,
                "Errors on data that were not fitted. Left is better; right of the dashed line is worse \
                 than without the effect.",
            )
        };
        let all = f.channels.iter().chain(
            f.worse
                .iter()
                .filter(|w| f.channels.iter().all(|c| c.name != w.name)),
        );
        let rows: Vec<Vec<String>> = all
            .map(|c| channel_row(c, f.worse.iter().any(|w| w.name == c.name)))
            .collect();
        let head = [
            "channels",
            "",
            "before",
            "after",
            "95 %",
            "shuffled",
            "noise floor",
            "unit",
        ];
        section(
            "What got better, what got worse",
            &format!(
                "{worse}{picture}{}{}",
                table(&head, &rows, 2),
                shuffled(&f.channels).map_or(String::new(), |t| paragraph(&t))
            ),
        )
    }

    fn located(&self) -> String {
        let rows: Vec<Vec<String>> = self
            .finding
            .located
            .iter()
            .take(LOCATED)
            .map(|l| {
                vec![
                    escape(residual_name(&l.residual)),
                    escape(&l.channel),
                    escape(&l.regressor),
                    percent(l.share),
                ]
            })
            .collect();
        if rows.is_empty() {
            return String::new();
        }
        let words = paragraph(
            "Regressors that the residuals are correlated with, as share of their variance on held-out data. The \
             verdict does not use it.",
        );
        let head = ["residual", "channel", "correlated with", "share"];
        section(
            "Correlations of the residuals",
            &(words + &table(&head, &rows, 3)),
        )
    }

    fn patch(&self, toml: &str) -> String {
        if toml.trim().is_empty() {
            return String::new();
        }
        let words = match self.finding.verdict {
            Verdict::Named => {
                "The patch adds what was found to the model. The robot file stays as it is, and patches \
                 stack."
            }
            Verdict::Indistinguishable => {
                "Choose one of the effects above before you apply the patch."
            }
            _ => "The patch holds this rig's departures from the nominal one; it adds no effect.",
        };
        let data = base64(toml.as_bytes());
        let body = format!(
            "{}<pre># apply\n{APPLY}\n# revert\n{UNDO}</pre>\n\
             <p><a download=\"patch.toml\" href=\"data:application/toml;base64,{data}\">Save the \
             patch</a></p>\n<pre>{}</pre>\n",
            paragraph(words),
            escape(toml)
        );
        section("The patch", &body)
    }

    fn data(&self) -> String {
        let f = self.finding;
        let rows: Vec<Vec<String>> = f
            .data
            .iter()
            .map(|(role, hash)| {
                vec![
                    escape(role),
                    format!("<code class=\"hash\">{}</code>", escape(hash)),
                ]
            })
            .collect();
        let table = if rows.is_empty() {
            paragraph("No hashes: the data came from no file.")
        } else {
            table(&["what", "hash or name"], &rows, 2)
        };
        let took = if f.seconds.is_finite() {
            format!(
                "Made in {} s by springtwin {}.",
                number(f.seconds),
                env!("CARGO_PKG_VERSION")
            )
        } else {
            format!("Made by springtwin {}.", env!("CARGO_PKG_VERSION"))
        };
        section("Data", &(table + &paragraph(&took)))
    }
}

fn found_effect(found: &FoundEffect) -> String {
    let doc = effect_or_term(&found.id).map_or(String::new(), |e| {
        format!("<p class=\"weak\">{}</p>\n", escape(e.doc))
    });
    let rows: Vec<Vec<String>> = found
        .params
        .iter()
        .map(|(name, value)| {
            let q = words::quantity(&found.id, name, value);
            let with_unit = |text: String| escape(format!("{text} {}", q.unit).trim_end());
            vec![
                escape(name),
                with_unit(q.value),
                q.interval.map_or("–".to_owned(), with_unit),
            ]
        })
        .collect();
    let folds = found.chosen_by.map_or(String::new(), |share| {
        format!(
            ", chosen by {} % of the held-out folds",
            fixed(100.0 * share, 0)
        )
    });
    format!(
        "<h3>{} <span class=\"weak\">({}, <code>{}</code>{folds})</span></h3>\n{doc}{}",
        escape(&effect_name(&found.id, found.target)),
        escape(&found.side),
        escape(&found.id),
        table(&["parameter", "value", "95 % interval"], &rows, 1)
    )
}

fn channel_row(c: &ChannelError, worse: bool) -> Vec<String> {
    let maybe = |v: Option<f64>| v.map_or("–".to_owned(), number);
    let mark = if worse {
        "<span class=\"warn\">▲ worse</span>".to_owned()
    } else {
        String::new()
    };
    vec![
        escape(&c.name),
        mark,
        number(c.before),
        number(c.after),
        format!("{} to {}", number(c.after_ci95[0]), number(c.after_ci95[1])),
        maybe(c.shuffled),
        maybe(c.floor),
        escape(&c.unit),
    ]
}
