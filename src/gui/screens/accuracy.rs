//! The screen that compares predicted and measured poses.

use egui::{Ui, Vec2, vec2};

use super::settings;
use crate::gui::panels::accuracy::{self, AccuracyState, Below, Kind, Plots, Scope};
use crate::gui::screen::{Ctx, Known, List, Screen, check};

impl Screen for AccuracyState {
    const NAME: &'static str = "Accuracy";
    const PURPOSE: &'static str = "The predicted pose against motion capture.";
    const LEAST_POINTS: Vec2 = vec2(880.0, 520.0);

    fn ui(&mut self, ui: &mut Ui, ctx: &mut Ctx<'_>) {
        accuracy::ui(ui, &ctx.shown, self, ctx.window, ctx.services);
    }

    fn busy(&self) -> bool {
        self.export.is_busy()
    }

    fn forget(&mut self) {
        Self::forget(self);
    }

    fn actions(&self, known: &Known<'_>, list: &mut List<Self>) {
        let words = "accuracy workspace load speed overlay all vicon";
        for (name, plots) in [
            ("Plot the errors", Plots::Errors),
            ("Plot prediction and Vicon overlaid", Plots::Overlay),
        ] {
            list.act(name, words, Ok(()), move |a, _| a.plots = plots);
        }
        for (name, below) in [
            ("Show errors over time", Below::Time),
            ("Show errors in space", Below::Space),
            ("Show errors by bins", Below::Bins),
            ("Show frames and clocks", Below::Frames),
        ] {
            list.act(name, words, Ok(()), move |a, _| a.below = below);
        }
        for (name, scope) in [
            ("Score everything", Scope::All),
            ("Score the window", Scope::Window),
        ] {
            list.act(name, words, Ok(()), move |a, _| a.scope = scope);
        }
        let scored = check(
            accuracy::is_scored(known.shown.history, known.shown.now_s),
            "Nothing is scored yet: there are no errors.",
        );
        for (name, keys, forward) in [
            ("Go to the next peak of the error", "]", true),
            ("Go to the previous peak of the error", "[", false),
        ] {
            let words = "accuracy worst";
            list.act(name, words, scored.clone(), move |a, _| {
                a.want_peak(forward);
            });
            list.by(keys);
        }
        for (name, kind) in [
            ("Export the errors as a table (CSV)", Kind::Csv),
            ("Export a picture of Accuracy (PNG)", Kind::Png),
            ("Export the report of Accuracy (HTML)", Kind::Report),
        ] {
            let words = "write save file accuracy scores";
            list.act(name, words, scored.clone(), move |a, _| {
                a.export.wanted = Some(kind);
            });
        }
        settings::accuracy(list);
    }
}
