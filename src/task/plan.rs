//! What the arm shall do, part by part: go there, follow a path, grip.

use std::sync::Arc;

use super::path::Path;
use super::programme::Programme;
use crate::signal::{Goal, Gripper};

/// How long the gripper takes to close or to open, s.
pub const GRIP_S: f64 = 1.0;

/// One part of a plan.
#[derive(Clone, Debug, PartialEq)]
pub enum Leg {
    /// Go to a goal and settle there.
    Move(Goal),
    /// Follow a path from where the tip is, its first waypoint, and settle at its end.
    Follow(Follow),
    /// Move the gripper and wait for it.
    Grip {
        /// Where to.
        gripper: Gripper,
        /// What it holds from then on besides what it held when the plan began, kg.
        payload_kg: f64,
    },
    /// Set the pressures of a programme one after the other.
    Excite(Arc<Programme>),
}

/// A path with a speed.
#[derive(Clone, Debug, PartialEq)]
pub struct Follow {
    /// Where along.
    pub path: Path,
    /// Speed along the path, m/s.
    pub speed_m_s: f64,
    /// How many times round.
    pub laps: u32,
}

/// Something to pick up.
#[derive(Clone, Debug, PartialEq)]
pub struct Item {
    /// Name for the operator.
    pub name: String,
    /// Where the tip must be to grasp it, base frame, m.
    pub grasp_m: [f64; 3],
    /// Its mass, kg.
    pub mass_kg: f64,
}

/// Legs one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Name for the operator.
    pub name: String,
    /// In order.
    pub legs: Vec<Leg>,
    /// How long the arm rests at a goal once it has settled there, before the next leg begins, s.
    pub rest_s: f64,
}

impl Plan {
    /// Legs without a rest between them.
    pub fn new(name: impl Into<String>, legs: Vec<Leg>) -> Self {
        Self {
            name: name.into(),
            legs,
            rest_s: 0.0,
        }
    }

    /// To one goal.
    pub fn goto(goal: Goal) -> Self {
        Self::new("point to point", vec![Leg::Move(goal)])
    }

    /// Through a programme of pressures.
    pub fn excite(programme: Programme) -> Self {
        let name = programme.name.clone();
        Self::new(name, vec![Leg::Excite(Arc::new(programme))])
    }

    /// To the first waypoint of a path, then along it (paper, section V-C). `None` for a path without waypoints.
    pub fn follow(follow: Follow) -> Option<Self> {
        let start = follow.path.waypoints_m.first()?;
        let start = Leg::Move(Goal::position(*start));
        let name = follow.path.name.clone();
        Some(Self::new(name, vec![start, Leg::Follow(follow)]))
    }

    /// Opens the gripper, then every item in turn into the basket (paper, section V-B): over the item, down, grip, up, over
    /// the basket, down, let go, up. `drop_m` is where the tip is when it lets go, in the base frame, `lift_m` how much
    /// higher it travels.
    pub fn pick_and_place(items: &[Item], drop_m: [f64; 3], lift_m: f64) -> Self {
        let over = |[x, y, z]: [f64; 3]| Leg::Move(Goal::position([x, y, z + lift_m]));
        let at = |p: [f64; 3]| Leg::Move(Goal::position(p));
        let grip = |gripper, payload_kg| Leg::Grip {
            gripper,
            payload_kg,
        };
        let legs = items.iter().flat_map(|item| {
            [
                over(item.grasp_m),
                at(item.grasp_m),
                grip(Gripper::Closed, item.mass_kg),
                over(item.grasp_m),
                over(drop_m),
                at(drop_m),
                grip(Gripper::Open, 0.0),
                over(drop_m),
            ]
        });
        let names: Vec<&str> = items.iter().map(|i| i.name.as_str()).collect();
        Self::new(
            format!("pick and place: {}", names.join(", ")),
            std::iter::once(grip(Gripper::Open, 0.0))
                .chain(legs)
                .collect(),
        )
    }

    /// Every programme of pressures in it.
    pub fn programmes(&self) -> impl Iterator<Item = &Programme> {
        self.legs.iter().filter_map(|leg| match leg {
            Leg::Excite(programme) => Some(&**programme),
            _ => None,
        })
    }

    /// Every goal on the way with the leg it belongs to and what the gripper holds then, kg: all of them must be
    /// reachable before anything moves. `base_kg` is held at the start.
    pub fn stops(&self, base_kg: f64) -> Vec<Stop> {
        let mut out = Vec::new();
        let mut payload_kg = base_kg;
        for (leg, part) in self.legs.iter().enumerate() {
            let mut stop = |goal: Goal, name: String| {
                out.push(Stop {
                    leg,
                    goal,
                    payload_kg,
                    name,
                });
            };
            match part {
                Leg::Move(goal) if self.legs.len() == 1 => stop(goal.clone(), "the target".into()),
                Leg::Move(goal) => stop(goal.clone(), format!("stop {} of the plan", leg + 1)),
                Leg::Follow(follow) => {
                    let n = follow.path.waypoints_m.len();
                    for (k, goal) in follow.path.goals().take(n).enumerate() {
                        stop(goal, format!("waypoint {} of {n}", k + 1));
                    }
                }
                Leg::Grip { payload_kg: kg, .. } => payload_kg = base_kg + kg,
                Leg::Excite(_) => {}
            }
        }
        out
    }
}

/// A goal of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    /// Index of its leg.
    pub leg: usize,
    /// Where, in the base frame.
    pub goal: Goal,
    /// What the gripper holds there, kg.
    pub payload_kg: f64,
    /// What to call it.
    pub name: String,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::circle;

    #[test]
    fn stops_carry_what_has_been_gripped() {
        let item = Item {
            name: "lemon".to_owned(),
            grasp_m: [-0.09, 0.0, -0.33],
            mass_kg: 0.21,
        };
        let plan = Plan::pick_and_place(&[item], [0.09, 0.0, -0.30], 0.04);
        let stops = plan.stops(0.1);
        let held: Vec<f64> = stops.iter().map(|s| s.payload_kg).collect();
        assert_eq!(held, [0.1, 0.1, 0.31, 0.31, 0.31, 0.1]);
        assert_eq!(stops[1].goal.position_m, [-0.09, 0.0, -0.33]);
        assert!((stops[3].goal.position_m[2] + 0.26).abs() < 1e-12);
        assert_eq!(stops[5].leg, 8);
    }

    #[test]
    fn every_waypoint_is_a_stop_once() {
        let follow = Follow {
            path: circle([0.0, 0.0, -0.3], 0.05, 60),
            speed_m_s: 3e-3,
            laps: 2,
        };
        let plan = Plan::follow(follow).expect("has waypoints");
        let stops = plan.stops(0.1);
        assert_eq!(stops.len(), 61);
        assert_eq!(stops[60].name, "waypoint 60 of 60");
    }
}
