//! The screens of the window.

mod accuracy;
mod calibrate;
mod gap;
mod operate;
mod plots;
mod recordings;
mod sensors;
mod settings;

use egui::{Key, Ui, Vec2};
use serde::{Deserialize, Serialize};

use super::panels::accuracy::AccuracyState;
use super::panels::calibrate::CalibrateState;
use super::panels::gap::GapState;
use super::panels::operate::OperateState;
use super::panels::recordings::Library;
use super::panels::sensors::SensorsState;
use super::screen::{Action, Ctx, Known, List, Screen, Task};
use crate::robot::RobotSpec;
use crate::signal::Snapshot;
use crate::twin::{Command, Event};

/// Makes [`ScreenId`] and [`Screens`] of the list of screens.
macro_rules! screens {
    ($($(#[$doc:meta])* $id:ident => $field:ident: $state:ty,)+) => {
        /// Which screen. Settings keep it by name.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        pub enum ScreenId {
            $($(#[$doc])* $id,)+
        }

        impl ScreenId {
            /// All screens, in the order of the rail and of their shortcuts.
            pub const ALL: [Self; [$(stringify!($id)),+].len()] = [$(Self::$id),+];

            /// Name on screen.
            pub fn name(self) -> &'static str {
                match self { $(Self::$id => <$state>::NAME,)+ }
            }

            /// Its purpose, one sentence.
            pub fn purpose(self) -> &'static str {
                match self { $(Self::$id => <$state>::PURPOSE,)+ }
            }

            /// Width and height that its panels need at least, points.
            pub fn least_points(self) -> Vec2 {
                match self { $(Self::$id => <$state>::LEAST_POINTS,)+ }
            }

            /// Whether it shows or handles recordings.
            pub fn replays(self) -> bool {
                match self { $(Self::$id => <$state>::REPLAYS,)+ }
            }
        }

        /// What the screens keep.
        #[derive(Default)]
        pub struct Screens {
            $($(#[$doc])* pub $field: $state,)+
        }

        impl Screens {
            /// Shows a screen.
            pub fn ui(&mut self, id: ScreenId, ui: &mut Ui, ctx: &mut Ctx<'_>) {
                match id { $(ScreenId::$id => Screen::ui(&mut self.$field, ui, ctx),)+ }
            }

            /// Whether one of them awaits an answer.
            pub fn busy(&self) -> bool {
                false $(|| Screen::busy(&self.$field))+
            }

            /// Takes answers that have come.
            pub fn poll(&mut self, ctx: &mut Ctx<'_>) {
                $(Screen::poll(&mut self.$field, ctx);)+
            }

            /// Takes a snapshot of the live twin.
            pub fn observe(&mut self, snapshot: &Snapshot, robot: &RobotSpec) {
                $(Screen::observe(&mut self.$field, snapshot, robot);)+
            }

            /// Takes the newest state of the live twin and its events since the last frame.
            pub fn follow(&mut self, live: &Snapshot, events: &[Event]) {
                $(Screen::follow(&mut self.$field, live, events);)+
            }

            /// Forgets the twin that was connected before.
            pub fn reconnect(&mut self) {
                $(Screen::reconnect(&mut self.$field);)+
            }

            /// Forgets what was computed of another session or recording.
            pub fn forget(&mut self) {
                $(Screen::forget(&mut self.$field);)+
            }

            /// Cancels what Esc cancels; whether there was anything.
            pub fn cancel(&mut self, live: &Snapshot, typed: bool, commands: &mut Vec<Command>) -> bool {
                false $(|| Screen::cancel(&mut self.$field, live, typed, commands))+
            }

            /// The actions of all screens.
            pub fn actions(&self, known: &Known<'_>) -> Vec<Action<(ScreenId, Task<Self>)>> {
                let mut all = Vec::new();
                $(
                    let mut list = List::default();
                    Screen::actions(&self.$field, known, &mut list);
                    all.extend(list.0.into_iter().map(|action| action.map(|task| {
                        let task: Task<Self> = match task {
                            Task::Twin(command) => Task::Twin(command),
                            Task::Shown(act) => Task::Shown(Box::new(
                                move |screens: &mut Self, ctx: &mut Ctx<'_>| act(&mut screens.$field, ctx),
                            )),
                            Task::Behind(act) => Task::Behind(Box::new(
                                move |screens: &mut Self, ctx: &mut Ctx<'_>| act(&mut screens.$field, ctx),
                            )),
                        };
                        (ScreenId::$id, task)
                    })));
                )+
                all
            }
        }
    };
}

// The one list of screens: a screen is added by one line here and its file.
screens! {
    /// Moves the arm.
    Operate => operate: OperateState,
    /// Springs, IMUs and boards.
    Sensors => sensors: SensorsState,
    /// Predicted against measured pose.
    Accuracy => accuracy: AccuracyState,
    /// The wizard that calibrates springs, IMUs and motion capture.
    Calibrate => calibrate: CalibrateState,
    /// The library of recordings and the player.
    Recordings => library: Library,
    /// The search for what the model lacks.
    Gap => gap: GapState,
}

/// The digits that go with Ctrl, and their names in lists.
const KEYS: [(Key, &str); 9] = [
    (Key::Num1, "Ctrl+1"),
    (Key::Num2, "Ctrl+2"),
    (Key::Num3, "Ctrl+3"),
    (Key::Num4, "Ctrl+4"),
    (Key::Num5, "Ctrl+5"),
    (Key::Num6, "Ctrl+6"),
    (Key::Num7, "Ctrl+7"),
    (Key::Num8, "Ctrl+8"),
    (Key::Num9, "Ctrl+9"),
];

impl Default for ScreenId {
    fn default() -> Self {
        Self::ALL[0]
    }
}

impl ScreenId {
    /// The digit that goes with Ctrl.
    pub fn key(self) -> Key {
        KEYS[self as usize].0
    }

    /// Its shortcut in words.
    pub fn shortcut(self) -> &'static str {
        KEYS[self as usize].1
    }
}
