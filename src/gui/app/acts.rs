//! What is chosen in the list of everything that can be done, done.

use super::App;
use crate::gui::panels::operate::Pane;
use crate::gui::panels::palette::Act;
use crate::gui::panels::plans::PlanKind;
use crate::gui::panels::plot::TimeWindow;
use crate::gui::panels::{Screen, View, sensors, target};
use crate::robot::RobotSpec;
use crate::twin::Command;

/// Where the tip is without pressure and load, straight below the base, m.
pub fn home_m(spec: &RobotSpec) -> [f64; 3] {
    [0.0, 0.0, -(2.0 * spec.rest_length_m + spec.pad_thickness_m)]
}

impl App {
    /// Does what was chosen, on its screen.
    pub(super) fn do_act(&mut self, act: Act, commands: &mut Vec<Command>) {
        if let Some(screen) = screen_of(&act) {
            self.screen = screen;
        }
        match act {
            Act::Record => self.library.record(&mut self.services),
            Act::Pane(_)
            | Act::Plan(_)
            | Act::Draw
            | Act::Home
            | Act::Preview
            | Act::Go
            | Act::Look(_)
            | Act::Projection
            | Act::Frame => self.on_operate(act, commands),
            Act::Freeze => {
                let now_s = self.shown().now_s;
                self.window.frozen_end_s = match self.window.frozen_end_s {
                    Some(_) => None,
                    None => Some(now_s),
                };
            }
            Act::Cursors => {
                let mut window: TimeWindow = self.window;
                sensors::toggle_cursors(&self.shown(), &mut window);
                self.window = window;
            }
            Act::Reading(reading) => self.sensors.reading = reading,
            Act::Plots(plots) => self.accuracy.plots = plots,
            Act::Below(below) => self.accuracy.below = below,
            Act::Score(scope) => self.accuracy.scope = scope,
            Act::Peak(forward) => self.accuracy.want_peak(forward),
            Act::Export(kind) => self.accuracy.export.wanted = Some(kind),
            Act::Calibrate(step) => {
                let mode = self.live.mode.clone();
                commands.extend(self.calibrate.go_to(step, &mode, &mut self.services));
            }
            Act::Refresh => self.library.rescan(&mut self.services),
            Act::Browse => self.library.browse(&mut self.services),
            Act::Play(path) => self.library.play(path, &mut self.services),
            Act::PlayPause => {
                if let Some(player) = &mut self.player {
                    player.toggle();
                }
            }
            Act::LiveInRerun => self.library.viewer.start(&mut self.services),
            Act::Example => self.gap.make_example(&mut self.services),
            Act::Find => self.gap.find(&mut self.services),
            Act::Gap(step) => self.gap.step = step,
            Act::Connect(rig) => self.connect(rig),
            Act::ConnectMenu => self.connection.wanted = true,
        }
    }

    fn on_operate(&mut self, act: Act, commands: &mut Vec<Command>) {
        let live = std::sync::Arc::clone(&self.live);
        let operate = &mut self.operate;
        match act {
            Act::Pane(pane) => operate.show(pane),
            Act::Plan(kind) => {
                operate.show(Pane::Plan);
                operate.plans.kind = kind;
                operate.plans.drawing &= kind == PlanKind::Points;
            }
            Act::Draw => {
                operate.show(Pane::Plan);
                operate.plans.kind = PlanKind::Points;
                operate.plans.drawing = true;
            }
            Act::Home => {
                operate.show(Pane::Target);
                operate.draft.set(home_m(&self.spec), commands);
            }
            Act::Preview => {
                if let Ok(target_m) = operate.draft.parse() {
                    operate.draft.set(target_m, commands);
                }
            }
            Act::Go => {
                let view = View {
                    snapshot: &live,
                    history: &self.live_history,
                    now_s: live.stamp.seconds(),
                    replay: None,
                    spec: &self.spec,
                    simulated: Some(live.link.simulated),
                };
                target::arm_simulated(&view, commands);
                commands.push(Command::Go);
            }
            Act::Look(side) => {
                if let Some(scene) = &mut operate.view3d.scene {
                    scene.camera.look(side);
                }
            }
            Act::Projection => {
                if let Some(scene) = &mut operate.view3d.scene {
                    scene.camera.toggle_projection();
                }
            }
            Act::Frame => {
                if let Some(scene) = &mut operate.view3d.scene {
                    scene.frame(&live);
                }
            }
            _ => {}
        }
    }

    /// What the screens of values look at: the recording that is shown, else the live twin.
    fn shown(&self) -> View<'_> {
        match &self.player {
            Some(player) => View {
                snapshot: player.snapshot(),
                history: player.history(),
                now_s: player.now_s(),
                replay: Some(&player.trace().name),
                spec: &self.spec,
                simulated: player.trace().simulated,
            },
            None => View {
                snapshot: &self.live,
                history: &self.live_history,
                now_s: self.live.stamp.seconds(),
                replay: None,
                spec: &self.spec,
                simulated: Some(self.live.link.simulated),
            },
        }
    }
}

/// The screen on which it is done; none when it is done on every one.
fn screen_of(act: &Act) -> Option<Screen> {
    Some(match act {
        Act::Record | Act::LiveInRerun | Act::PlayPause => return None,
        Act::Freeze | Act::Connect(_) | Act::ConnectMenu => return None,
        Act::Pane(_) | Act::Plan(_) | Act::Draw | Act::Home | Act::Preview | Act::Go => {
            Screen::Operate
        }
        Act::Look(_) | Act::Projection | Act::Frame => Screen::Operate,
        Act::Cursors | Act::Reading(_) => Screen::Sensors,
        Act::Plots(_) | Act::Below(_) | Act::Score(_) | Act::Peak(_) | Act::Export(_) => {
            Screen::Accuracy
        }
        Act::Calibrate(_) => Screen::Calibrate,
        Act::Refresh | Act::Browse | Act::Play(_) => Screen::Recordings,
        Act::Example | Act::Find | Act::Gap(_) => Screen::Gap,
    })
}
