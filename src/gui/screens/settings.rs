//! Settings and small steps of the screens as actions: whatever a button or a tab does can be found by typing.

use crate::analysis::player::{AtEnd, SPEEDS, Transport};
use crate::analysis::score::By;
use crate::calibrate::Step;
use crate::gui::panels::accuracy::{AccuracyState, Below};
use crate::gui::panels::calibrate::CalibrateState;
use crate::gui::panels::gap::{GapState, Step as GapStep};
use crate::gui::panels::operate::{OperateState, Pane};
use crate::gui::panels::plans::{Passing, PlanKind};
use crate::gui::panels::recordings::{Compared, Detail, Library, Quantity, Side};
use crate::gui::panels::sensors::{Reading, SensorsState, axes};
use crate::gui::panels::strips::StripChoice;
use crate::gui::panels::target::preview_of;
use crate::gui::panels::view3d::LAYERS;
use crate::gui::scene::Controls;
use crate::gui::screen::{Ctx, Known, List, Task, check};
use crate::gui::services::gap::Part;
use crate::gui::view::Gate;
use crate::signal::{SPRINGS, spring_name};

/// What the 3D view draws, what the strips show, and the steps of a plan's form.
pub fn operate(state: &OperateState, known: &Known<'_>, list: &mut List<OperateState>) {
    let scene = check(
        state.view3d.scene.is_some(),
        "There is no graphics adapter: the side view draws the arm alone.",
    );
    for (of, name, _) in LAYERS {
        let name = format!("Show or hide the {}", name.to_lowercase());
        let words = "3d view draw reachable path preview walls";
        list.act(name, words, scene.clone(), move |o, _| {
            let shown = of(&mut o.view3d.shown);
            *shown = !*shown;
        });
    }
    let words = "blender buttons drag 3d view";
    list.act("Switch the CAD mouse on or off", words, scene, |o, _| {
        let controls = &mut o.view3d.shown.controls;
        *controls = match *controls {
            Controls::Cad => Controls::Blender,
            Controls::Blender => Controls::Cad,
        };
    });
    for (name, choice) in [
        ("Plot the position of the tip", StripChoice::Position),
        ("Plot the orientation of the tip", StripChoice::Orientation),
        ("Plot the pressures", StripChoice::Pressure),
        ("Plot the chosen signals", StripChoice::Chosen),
    ] {
        let words = "strips signals x y z yaw pitch roll chambers";
        list.act(name, words, Ok(()), move |o, _| {
            o.show(Pane::Strips);
            o.strips.choice = choice;
        });
    }
    let target_m = state.draft.parse().ok();
    let goal = state.draft.goal().ok();
    let nearest = goal
        .and_then(|goal| preview_of(&known.live, &goal))
        .filter(|r| r.distance_m > 0.0)
        .map(|r| r.nearest_m);
    let gate = known.shown.live().and(check(
        nearest.is_some(),
        "Preview a target that is out of reach first.",
    ));
    let words = "target reachable goal";
    list.act(
        "Use the nearest reachable point",
        words,
        gate,
        move |o, ctx| {
            if let Some(nearest_m) = nearest {
                o.draft.set(nearest_m, ctx.commands);
            }
        },
    );
    plan(state, target_m, list);
}

/// The steps of the form of waypoints.
fn plan(state: &OperateState, target_m: Option<[f64; 3]>, list: &mut List<OperateState>) {
    let show = |o: &mut OperateState| {
        o.show(Pane::Plan);
        o.plans.kind = PlanKind::Points;
    };
    let gate = check(target_m.is_some(), "There is no target to add.");
    let words = "plan point path";
    list.act("Add the target as a waypoint", words, gate, move |o, _| {
        show(o);
        if let Some(m) = target_m {
            o.plans.add(m);
        }
    });
    let some = check(!state.plans.points_m.is_empty(), "There are no waypoints.");
    let words = "plan points clear remove";
    list.act("Delete every waypoint", words, some, move |o, _| {
        show(o);
        o.plans.points_m.clear();
        o.plans.selected = None;
    });
    let chosen = check(state.plans.selected.is_some(), "Select a waypoint first.");
    let words = "plan point remove";
    list.act("Delete the waypoint", words, chosen.clone(), move |o, _| {
        show(o);
        o.plans.delete_selected();
    });
    for (name, earlier) in [
        ("Move the waypoint up", true),
        ("Move the waypoint down", false),
    ] {
        list.act(name, "plan order", chosen.clone(), move |o, _| {
            show(o);
            o.plans.reorder(earlier);
        });
    }
    for (name, passing) in [
        ("Stop at each waypoint", Passing::Stop),
        ("Follow the waypoints as a closed line", Passing::Follow),
    ] {
        list.act(name, "plan points path", Ok(()), move |o, _| {
            show(o);
            o.plans.passing = passing;
        });
    }
}

/// The figure of the IMUs that is plotted, and the spring that is highlighted.
pub fn sensors(state: &SensorsState, list: &mut List<SensorsState>) {
    for (k, axis) in axes(state.reading).into_iter().enumerate() {
        let words = match state.reading {
            Reading::Raw => "imus rates gyroscope angular",
            Reading::Calibrated | Reading::Residual => "imus angle orientation",
        };
        let name = format!("Plot the {axis} of the IMUs");
        list.act(name, words, Ok(()), move |s, _| s.angle = k);
    }
    for i in 0..SPRINGS {
        let name = format!("Highlight spring {}", spring_name(i));
        let words = "select emphasis plots 3d";
        list.act(name, words, Ok(()), move |_, ctx| {
            *ctx.selected_spring = Some(i);
        });
    }
    let words = "show all springs remove not only";
    list.act("Highlight no spring", words, Ok(()), |_, ctx| {
        *ctx.selected_spring = None;
    });
}

/// By what the errors are split.
pub fn accuracy(list: &mut List<AccuracyState>) {
    for by in By::ALL {
        let name = format!("Split the errors by {}", by.name().to_lowercase());
        let words = "accuracy bins workspace payload";
        list.act(name, words, Ok(()), move |a, _| {
            a.below = Below::Bins;
            a.by = by;
        });
    }
}

/// One step on and back.
pub fn calibrate(state: &CalibrateState, list: &mut List<CalibrateState>) {
    let now = state.wizard().map_or(Step::ALL[0], |w| w.step);
    for (name, to, none) in [
        ("Calibrate: next step", now.next(), "This is the last step."),
        ("Calibrate: back", now.back(), "This is the first step."),
    ] {
        let may = |step| state.wizard().map_or(Ok(()), |w| w.may_enter(step));
        let gate = to.map_or(Err(none.to_owned()), may);
        list.act(
            name,
            "calibration wizard previous go on",
            gate,
            move |c, ctx| {
                if let Some(step) = to {
                    let mode = &ctx.live.snapshot.mode;
                    ctx.commands.extend(c.go_to(step, mode, ctx.services));
                }
            },
        );
    }
    let begun = state.wizard().is_some_and(|w| w.has_begun());
    let begun = check(
        begun,
        "Nothing has been captured: there is nothing to cancel.",
    );
    let words = "discard captures restore";
    list.act("Cancel the calibration…", words, begun, |c, _| {
        c.ask_to_cancel();
    });
}

/// One step on and back, and the sessions.
pub fn gap(state: &GapState, list: &mut List<GapState>) {
    let (back, next) = (state.step.back(), state.step.next());
    for (name, to, none) in [
        ("Gap: next step", next, "This is the last step."),
        ("Gap: back", back, "This is the first step."),
    ] {
        let gate = to.map_or(Err(none.to_owned()), |step| state.gate(step));
        list.act(name, "finder previous go on", gate, move |g, _| {
            if let Some(step) = to {
                g.step = step;
            }
        });
    }
    for part in Part::ALL {
        let name = format!("Browse for the {} session", part.name());
        let words = "gap choose file open";
        list.act(name, words, Ok(()), move |g, ctx| {
            g.step = GapStep::Select;
            g.browse_for(part, ctx.services);
        });
        let name = format!("Clear the {} session", part.name());
        let words = "gap choose none remove";
        list.act(name, words, Ok(()), move |g, _| {
            g.step = GapStep::Select;
            g.clear(part);
        });
    }
    finding(state, list);
}

/// What is done with a finding.
fn finding(state: &GapState, list: &mut List<GapState>) {
    let words = "gap equation terms library discover explain";
    list.act("Search for a law", words, state.law_gate(), |g, ctx| {
        g.find_law(ctx.services);
    });
    let words = "gap answer example hidden effect explain";
    let gate = state.reveal_gate();
    list.act("Reveal what was hidden", words, gate, |g, ctx| {
        g.step = GapStep::Explain;
        g.reveal(ctx.services);
    });
    let words = "gap model leave decision";
    list.act("Reject the patch", words, state.reject_gate(), |g, _| {
        g.step = GapStep::Patch;
        g.reject();
    });
    let words = "gap revert robot file remove";
    list.act("Undo the last patch", words, state.undo_gate(), |g, ctx| {
        g.step = GapStep::Patch;
        g.undo(ctx.services);
    });
    let words = "gap revert robot file remove changed hand";
    let gate = state.undo_edited_gate();
    let name = "Undo the last patch, edits set aside";
    list.act(name, words, gate, |g, ctx| {
        g.step = GapStep::Patch;
        g.undo_edited(ctx.services);
    });
    let gate = state.report_gate();
    let words = "gap finding browser page html write";
    list.act(
        "Open the report of the finding",
        words,
        gate.clone(),
        |g, ctx| {
            g.step = GapStep::Prove;
            g.open_report(ctx.services);
        },
    );
    let words = "gap finding page html write export";
    list.act(
        "Save the report of the finding…",
        words,
        gate,
        |g, ctx| {
            g.step = GapStep::Prove;
            g.ask_for_report(ctx.services);
        },
    );
}

/// The player, and what is shown of the recordings.
pub fn recordings(state: &Library, known: &Known<'_>, list: &mut List<Library>) {
    let some = check(known.shown.replay.is_some(), "No recording is shown.");
    for (name, keys, by) in [
        ("Play or pause the recording", "P", Transport::Toggle),
        ("Play forwards, or faster", "L", Transport::Forwards),
        ("Play backwards, or faster", "J", Transport::Backwards),
        ("Pause the recording", "K", Transport::Pause),
        ("Step back by one sample", ",", Transport::Previous),
        ("Step forward by one sample", ".", Transport::Next),
        (
            "Go back to the start of the recording",
            "Home",
            Transport::Start,
        ),
        ("Go to the end of the recording", "End", Transport::End),
    ] {
        let task = behind(move |_, ctx| {
            if let Some(player) = ctx.player {
                player.drive(by);
            }
        });
        list.add(
            name,
            "replay player reverse rewind frame",
            some.clone(),
            task,
        );
        list.by(keys);
    }
    for speed in SPEEDS {
        let task = behind(move |_, ctx| {
            if let Some(player) = ctx.player {
                player.speed = speed.copysign(player.speed);
            }
        });
        let words = "speed replay player slow fast motion";
        list.add(format!("Play at {speed}×"), words, some.clone(), task);
    }
    let task = behind(|_, ctx| {
        if let Some(player) = ctx.player {
            player.at_end = match player.at_end {
                AtEnd::Loop => AtEnd::Stop,
                AtEnd::Stop => AtEnd::Loop,
            };
        }
    });
    let words = "replay repeat again restart end";
    list.add(
        "Loop the recording, or play it once",
        words,
        some.clone(),
        task,
    );
    let selected = state.selected.is_some();
    let selected = check(selected, "Select a recording first.");
    let words = "as a replay open";
    list.act(
        "Load and play the selected recording",
        words,
        selected,
        |l, ctx| {
            if let Some(path) = l.selected.clone() {
                l.play(path, ctx.services);
            }
        },
    );
    let words = "directory saved default";
    list.act(
        "Change the folder of recordings…",
        words,
        Ok(()),
        |l, ctx| {
            l.change_folder(ctx.services);
        },
    );
    details(&some, list);
    let two = check(
        state.pair.other.is_some() && known.shown.replay.is_some(),
        "Nothing is loaded as B: select a recording and load it as B.",
    );
    compared(&two, list);
}

fn details(some: &Gate, list: &mut List<Library>) {
    for (name, detail) in [
        ("Show the events of the recording", Detail::Events),
        ("Show the contents of the recording", Detail::Contents),
        ("Show note and marks of the recording", Detail::Notes),
    ] {
        let words = "log channels gaps missing details";
        list.act(name, words, some.clone(), move |l, _| l.detail = detail);
    }
    for quantity in Quantity::ALL {
        let name = format!("Plot of recordings: {}", quantity.name().to_lowercase());
        let words = "plotted quantity compare signals";
        list.act(name, words, some.clone(), move |l, _| {
            l.pair.quantity = quantity;
        });
    }
}

fn compared(two: &Gate, list: &mut List<Library>) {
    for (name, side) in [("Compare: show A", Side::A), ("Compare: show B", Side::B)] {
        list.act(
            name,
            "recordings replay swap",
            two.clone(),
            move |l, ctx| {
                if l.pair.played != side {
                    l.pair.swap(ctx.player);
                }
                l.pair.compared = Compared::One;
            },
        );
    }
    for (name, compared) in [
        ("Compare: show A and B", Compared::Both),
        ("Compare: show A − B", Compared::Difference),
    ] {
        list.act(
            name,
            "recordings difference both",
            two.clone(),
            move |l, _| {
                l.pair.compared = compared;
            },
        );
    }
    let words = "compare shift time correlation";
    list.act("Align recordings A and B", words, two.clone(), |l, ctx| {
        l.pair.align(ctx.player, ctx.services);
    });
}

/// Acts whatever screen is shown.
fn behind(act: impl FnOnce(&mut Library, &mut Ctx<'_>) + 'static) -> Task<Library> {
    Task::Behind(Box::new(act))
}
