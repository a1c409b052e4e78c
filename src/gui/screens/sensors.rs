//! The screen of springs, IMUs and boards.

use egui::{Ui, Vec2, vec2};

use super::{plots, settings};
use crate::gui::panels::sensors::{self, Reading, SensorsState};
use crate::gui::screen::{Ctx, Known, List, Screen};

impl Screen for SensorsState {
    const NAME: &'static str = "Sensors";
    const PURPOSE: &'static str = "The twelve springs, the four IMUs and the boards.";
    const LEAST_POINTS: Vec2 = vec2(880.0, 564.0);

    fn ui(&mut self, ui: &mut Ui, ctx: &mut Ctx<'_>) {
        self.selected_spring = *ctx.selected_spring;
        sensors::ui(ui, &ctx.shown, self, ctx.window);
        self.export.ui(ui, ctx.services);
        *ctx.selected_spring = self.selected_spring;
    }

    fn busy(&self) -> bool {
        self.export.is_busy()
    }

    fn actions(&self, _known: &Known<'_>, list: &mut List<Self>) {
        let words = "a b difference measure plots sensors";
        list.act("Show or hide cursors A and B", words, Ok(()), |_, ctx| {
            ctx.window.toggle_cursors(&ctx.shown);
        });
        plots::sensors(list);
        for (name, reading) in [
            ("Show calibrated readings", Reading::Calibrated),
            ("Show raw readings", Reading::Raw),
            ("Show residuals of the readings", Reading::Residual),
        ] {
            let words = "sensors springs imu lengths angles frequency";
            list.act(name, words, Ok(()), move |s, _| s.reading = reading);
        }
        settings::sensors(self, list);
    }
}
