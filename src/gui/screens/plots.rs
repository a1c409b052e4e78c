//! Actions on plots, for the screens that have them.

use crate::gui::panels::operate::{OperateState, Pane};
use crate::gui::panels::plot::Format;
use crate::gui::panels::sensors::SensorsState;
use crate::gui::panels::strips::StripChoice;
use crate::gui::screen::List;

const EXPORT: &str = "write save file table picture drawing csv png svg visible range plots";
const SMOOTH: &str = "Smooth the plots, or show the signals alone";

/// Those on the signals of Operate.
pub(super) fn operate(list: &mut List<OperateState>) {
    let words = "plots strips channel list checklist names";
    list.act("Choose the signals to plot", words, Ok(()), |o, _| {
        o.show(Pane::Strips);
        o.strips.choice = StripChoice::Chosen;
        o.strips.wants_list = true;
    });
    list.act(SMOOTH, "moving average noise filter", Ok(()), |o, ctx| {
        o.show(Pane::Strips);
        ctx.window.smooth = !ctx.window.smooth;
    });
    for format in Format::ALL {
        let name = format!("Export the signals of Operate as {}", format.name());
        list.act(name, EXPORT, Ok(()), move |o, _| {
            o.show(Pane::Strips);
            o.strips.export.wanted = Some(format);
        });
    }
}

/// Those on the plots of Sensors.
pub(super) fn sensors(list: &mut List<SensorsState>) {
    for format in Format::ALL {
        let name = format!("Export the plots of Sensors as {}", format.name());
        list.act(name, EXPORT, Ok(()), move |s, _| {
            s.export.wanted = Some(format);
        });
    }
}
