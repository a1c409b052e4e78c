//! The figures as Markdown.

use super::{About, Confusion, Rung, Score, Share, State, Target};

impl Score {
    /// The report; `head` is put below the title.
    pub fn markdown(&self, head: &str) -> String {
        let mut out = format!(
            "# Blind test of the gap finder\n\nAll figures are from simulated sessions of the \
             virtual rig; nothing here was measured on an arm. {head}\n\n{} cases",
            self.cases
        );
        if self.failed > 0 {
            out += &format!(
                ", on {} of which the finder failed: they count as wrong",
                self.failed
            );
        }
        out += ". Brackets: 95 % intervals (Wilson's for shares, order statistics for medians). \
                Strength: RMS change in the most sensitive channel over the noise floor of that channel \
                in a healthy session.\n";
        out += "\n## Against the targets\n\n";
        let rows = self.targets.iter().map(target_row).collect();
        out += &table(&["", "target", "simulated result", "", "cases", ""], rows);
        out += &self.naming();
        out += &self.others();
        out += &self.parameters();
        out += "\n## Confusion matrix\n\nSingle effects from 2 x noise floor on, sessions without an effect \
                and unmodelled effects; one row per truth, `n x` answer.\n\n";
        out += &confusion_table(&self.confusion);
        if !self.confusion_weak.is_empty() {
            out += "\nWeaker single effects:\n\n";
            out += &confusion_table(&self.confusion_weak);
        }
        out += &self.wrong();
        out
    }

    fn naming(&self) -> String {
        let head = [
            "strength",
            "cases",
            "named first",
            "and nothing else",
            "in a set",
            "first or in the set",
        ];
        let mut out = format!(
            "\n## Naming of single effects (simulated)\n\nBy the strength that the effect has; {} \
             of them could not be brought to the requested strength.\n\n",
            self.capped
        );
        out += &table(&head, self.ladder.iter().map(rung_row).collect());
        if self.capped > 0 {
            out += "\nBy the requested strength:\n\n";
            out += &table(&head, self.ladder_asked.iter().map(rung_row).collect());
        }
        out += &format!(
            "\nFrom 2 x noise floor on: channel right in {} of right names, in {} where there is a channel \
             to choose; side right in {} of those that were given a name.\n",
            shown(&self.channel),
            shown(&self.channel_of_choice),
            shown(&self.side)
        );
        out
    }

    fn others(&self) -> String {
        let mut out = "\n## No effect, unmodelled effects, pairs (simulated)\n\n".to_owned();
        let row = |what: &str, s: &Share| vec![what.to_owned(), shown(s)];
        let rows = vec![
            row("no effect: anything claimed", &self.nulls.false_positive),
            row("no effect: effects claimed", &self.nulls.named),
            row("no effect: called unknown", &self.nulls.unknown),
            row("unmodelled: effects claimed", &self.aliens.named_wrongly),
            row("- never in the table", &self.aliens.never_known),
            row("- removed from the table", &self.aliens.left_out),
            row("unmodelled: called unknown", &self.aliens.unknown),
            row("unmodelled: nothing missing", &self.aliens.nothing),
            row("pair: both named", &self.pairs.both),
            row("- both at full strength", &self.pairs.both_full_strength),
            row("pair: one named", &self.pairs.one),
            row("pair: one at least in a set", &self.pairs.in_set),
        ];
        out += &table(&["", "share"], rows);
        out += &self.beginnings();
        out
    }

    fn beginnings(&self) -> String {
        let o = &self.onsets;
        if o.named.of == 0 {
            return format!(
                "\nA beginning within the session is claimed in {} of sessions in which nothing begins.\n",
                shown(&o.claimed)
            );
        }
        let rows = vec![
            vec!["named first".to_owned(), shown(&o.named)],
            vec!["- with a beginning".to_owned(), shown(&o.found)],
            vec![
                "the 95 % interval holds the true one".to_owned(),
                shown(&o.covered),
            ],
            vec![
                "error, median and largest".to_owned(),
                format!("{}, {}", seconds(o.error_s.median), seconds(o.error_s.max)),
            ],
            vec!["claimed where nothing begins".to_owned(), shown(&o.claimed)],
        ];
        let head = "\n## Effects that begin within the session (simulated)\n\n";
        head.to_owned() + &table(&["", ""], rows)
    }

    fn parameters(&self) -> String {
        let mut out = format!(
            "\n## Parameters (simulated)\n\nWhere the effect was named on the right channel, relative \
             to the departure from no effect (shapes: to their value): median error {}; the 95 % \
             interval holds the true value in {}.\n\n",
            percent(self.param_error.median),
            shown(&self.param_covered)
        );
        let rows = self.params.iter().map(|p| {
            vec![
                p.name.clone(),
                p.cases.to_string(),
                percent(p.error_median),
                shown(&p.covered),
            ]
        });
        out += &table(
            &["parameter", "cases", "median error", "covered"],
            rows.collect(),
        );
        out += &format!(
            "\nGap closed: median {} of {} cases. Seconds of the finder: median {}, longest {}.\n",
            percent(self.gap_closed.median),
            self.gap_closed.of,
            seconds(self.seconds.median),
            seconds(self.seconds.max)
        );
        out
    }

    fn wrong(&self) -> String {
        let missed: Vec<_> = self.lines.iter().filter(|l| !l.right).collect();
        let mut out = format!("\n## The {} cases that are not right\n\n", missed.len());
        let rows = missed.iter().map(|l| {
            vec![
                l.name.clone(),
                match l.kind {
                    About::Alien => "unmodelled".to_owned(),
                    kind => format!("{kind:?}").to_lowercase(),
                },
                l.truth.clone(),
                l.reached.map_or("-".to_owned(), |r| format!("{r:.2}")),
                match &l.error {
                    Some(why) => format!("{}: {}", l.said, first_line(why)),
                    None => l.said.clone(),
                },
            ]
        });
        out += &table(
            &["case", "kind", "hidden", "strength", "answer"],
            rows.collect(),
        );
        out
    }
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().replace('|', "/")
}

fn rung_row(r: &Rung) -> Vec<String> {
    vec![
        if r.strength > 0.0 {
            format!("{} x", r.strength)
        } else {
            "less".to_owned()
        },
        r.top1.of.to_string(),
        shown(&r.top1),
        shown(&r.exact),
        shown(&r.in_set),
        shown(&r.right_or_in_set),
    ]
}

fn target_row(t: &Target) -> Vec<String> {
    let number = |x: f64| match t.unit.as_str() {
        "%" => percent(Some(x)),
        _ => seconds(Some(x)),
    };
    let wanted = match t.wanted {
        [Some(a), Some(b)] => format!("{} to {}", number(a), number(b)),
        [Some(a), None] => format!("at least {}", number(a)),
        [None, Some(b)] => format!("at most {}", number(b)),
        [None, None] => String::new(),
    };
    let ci95 = t
        .ci95
        .map(|[a, b]| format!("[{}, {}]", number(a), number(b)));
    let state = match t.state {
        State::Met => "met",
        State::Missed => "**missed**",
        State::NoData => "no data",
    };
    vec![
        t.what.clone(),
        wanted,
        t.measured.map_or("-".to_owned(), number),
        ci95.unwrap_or_default(),
        t.of.to_string(),
        state.to_owned(),
    ]
}

fn confusion_table(confusion: &Confusion) -> String {
    let rows = confusion.iter().map(|(truth, said)| {
        let right = |name: &str| {
            name == truth
                || (name == "nothing missing" && truth == "nothing")
                || (name == "unknown"
                    && (truth.starts_with("unmodelled:") || truth.starts_with("left out:")))
        };
        let list = |keep: bool| {
            let mut some: Vec<_> = said
                .iter()
                .filter(|(name, _)| right(name) == keep)
                .collect();
            some.sort_by_key(|(name, n)| (std::cmp::Reverse(**n), name.as_str()));
            let each = some.iter().map(|(name, n)| format!("{n} x {name}"));
            each.collect::<Vec<_>>().join(", ")
        };
        let count: usize = said.values().sum();
        let rightly: usize = said.iter().filter(|(n, _)| right(n)).map(|(_, n)| n).sum();
        vec![
            truth.clone(),
            count.to_string(),
            rightly.to_string(),
            list(false),
        ]
    });
    table(
        &["hidden", "cases", "right", "other answers"],
        rows.collect(),
    )
}

fn percent(x: Option<f64>) -> String {
    x.map_or("-".to_owned(), |x| format!("{:.1} %", 100.0 * x))
}

fn seconds(x: Option<f64>) -> String {
    x.map_or("-".to_owned(), |x| format!("{x:.1} s"))
}

/// `8/10 = 80.0 % [49.0, 94.3]`.
fn shown(s: &Share) -> String {
    match (s.share, s.ci95) {
        (Some(share), Some([a, b])) => format!(
            "{}/{} = {:.1} % [{:.1}, {:.1}]",
            s.hits,
            s.of,
            100.0 * share,
            100.0 * a,
            100.0 * b
        ),
        _ => "no cases".to_owned(),
    }
}

/// A Markdown table.
fn table(head: &[&str], rows: Vec<Vec<String>>) -> String {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let mut out = line(head.iter().map(|h| (*h).to_owned()).collect());
    out += &line(head.iter().map(|_| "---".to_owned()).collect());
    rows.into_iter().for_each(|r| out += &line(r));
    out
}
