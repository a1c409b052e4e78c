//! The shipped tasks: two paths, and fruit that goes into a basket.

use anyhow::{Context as _, Result, ensure};
use nalgebra::{Unit, Vector3};

use super::measures;
use super::plan::Driven;
use crate::learn::ErrorStats;
use crate::rig::Object;
use crate::robot::RobotSpec;
use crate::signal::{Goal, OrientationGoal};
use crate::task::{Follow, Item, Leg, Path, Plan, circle, figure_eight};

/// Centre of the shipped paths in the base frame, m.
pub const PATH_CENTRE_M: [f64; 3] = [0.0, 0.0, -0.31];
/// Radius of the circle and half the length of the 8, m.
pub const PATH_SIZE_M: f64 = 0.05;
/// Position of the basket in the base frame: the tip lets go there, m.
pub const BASKET_M: [f64; 3] = [0.09, 0.03, -0.30];
/// How much higher the tip travels with something in the gripper, m.
pub const LIFT_M: f64 = 0.03;
/// A fruit that lands this close to the basket's middle is in it, m.
const BASKET_RADIUS_M: f64 = 0.02;

/// The paper's two paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A level circle.
    Circle,
    /// A level figure 8.
    Eight,
}

impl Shape {
    /// The path of that shape about `centre_m` (base frame); `size_m` is the radius of the circle or half the length of the
    /// 8.
    pub fn path(self, centre_m: [f64; 3], size_m: f64, waypoints: usize) -> Path {
        match self {
            Self::Circle => circle(centre_m, size_m, waypoints),
            Self::Eight => figure_eight(centre_m, size_m, waypoints),
        }
    }
}

/// A goal, and where the gripper shall point there, in the base frame.
///
/// # Errors
/// When a coordinate is not a number, or the direction has no length.
pub fn goal(position_m: [f64; 3], direction: Option<[f64; 3]>) -> Result<Goal> {
    let mut goal = Goal::position(position_m);
    if let Some(direction) = direction {
        let axis = Unit::try_new(Vector3::from(direction), 1e-9);
        let axis = axis.context("the direction has no length: give one such as 0,0,-1")?;
        goal.orientation = OrientationGoal::Direction(axis);
    }
    ensure!(
        goal.position_m.iter().all(|x| x.is_finite()) && goal.orientation.is_finite(),
        "the goal has a value that is not a number: correct it"
    );
    Ok(goal)
}

/// A plan along a path, so many times round.
///
/// # Errors
/// When the speed is none that the tip of this robot may have, or the path has no waypoints.
pub fn along(path: &Path, speed_m_s: f64, laps: u32, robot: &RobotSpec) -> Result<Plan> {
    let fastest = robot.tip_speed_max_m_s;
    ensure!(
        speed_m_s > 0.0 && speed_m_s <= fastest,
        "a speed of {} mm/s is not above 0 and at most the tip's {} mm/s: choose another one",
        speed_m_s * 1e3,
        fastest * 1e3
    );
    ensure!(laps > 0, "0 laps: give 1 or more");
    let follow = Follow {
        path: path.clone(),
        speed_m_s,
        laps,
    };
    Plan::follow(follow).context("a path needs waypoints")
}

/// A time in which a path is followed even if it takes a while to get to it, s.
pub fn longest_s(path: &Path, speed_m_s: f64, laps: u32) -> f64 {
    let waypoints = path.waypoints_m.iter().map(|p| Vector3::from(*p));
    let next = waypoints.clone().cycle().skip(1);
    let length_m: f64 = waypoints.zip(next).map(|(a, b)| (a - b).norm()).sum();
    120.0 + 4.0 * f64::from(laps) * length_m / speed_m_s
}

/// The paper's fruit, where it lies here.
pub fn fruit() -> Vec<Item> {
    [
        ("tomato", [-0.07, -0.05, -0.32], 0.12),
        ("lemon", [-0.08, 0.0, -0.32], 0.21),
        ("guava", [-0.07, 0.05, -0.32], 0.17),
    ]
    .into_iter()
    .map(|(name, grasp_m, mass_kg)| Item {
        name: name.to_owned(),
        grasp_m,
        mass_kg,
    })
    .collect()
}

/// How pick-and-place went.
pub struct PickPlaceMeasures {
    /// Number of objects in the basket; `None` where it is unknown.
    pub in_basket: Option<usize>,
    /// True tip from where it should be when the gripper moves, mm; `None` without ground truth.
    pub at_grips: Option<ErrorStats>,
    /// Share of saturated steps.
    pub saturated_ratio: f64,
}

/// Of the plan's drive; the basket is at `basket_m` in the base frame.
pub fn of_pick_place(
    driven: &Driven,
    plan: &Plan,
    basket_m: [f64; 3],
    robot: &RobotSpec,
) -> PickPlaceMeasures {
    let mut at_grips = Vec::new();
    for (leg, part) in plan.legs.iter().enumerate() {
        let (Leg::Grip { .. }, Some(Leg::Move(goal))) =
            (part, leg.checked_sub(1).map(|k| &plan.legs[k]))
        else {
            continue;
        };
        let row = driven.rows.iter().find(|r| r.legs_done == leg);
        if let Some(truth) = row.and_then(|r| r.truth) {
            let off = truth.translation.vector - Vector3::from(goal.position_m);
            at_grips.push(off.norm() * 1e3);
        }
    }
    let lies_in = |o: &&Object| {
        let off = Vector3::from(o.grasp_m) - Vector3::from(basket_m);
        !o.held && off.xy().norm() <= BASKET_RADIUS_M
    };
    PickPlaceMeasures {
        in_basket: driven
            .objects
            .as_ref()
            .map(|all| all.iter().filter(lies_in).count()),
        at_grips: measures::spread(at_grips),
        saturated_ratio: measures::saturated_ratio(&driven.rows, robot),
    }
}

/// The items as things of the virtual rig.
pub fn objects(items: &[Item]) -> Vec<Object> {
    let object = |i: &Item| Object {
        grasp_m: i.grasp_m,
        mass_kg: i.mass_kg,
        held: false,
    };
    items.iter().map(object).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{ReachConfig, reach};
    use crate::drive::{DEFAULT_RIG, model};
    use crate::signal::ReachState;
    use crate::task::{Follow, PATH_WAYPOINTS};

    #[test]
    fn the_shipped_tasks_fit_the_reference_robot() {
        let robot = RobotSpec::reference();
        let maps = model::maps_for(&robot, DEFAULT_RIG, None).expect("built in");
        let paths = [Shape::Circle, Shape::Eight].map(|s| {
            let path = s.path(PATH_CENTRE_M, PATH_SIZE_M, PATH_WAYPOINTS);
            let follow = Follow {
                path,
                speed_m_s: 3e-3,
                laps: 1,
            };
            Plan::follow(follow).expect("has waypoints")
        });
        let fruit = Plan::pick_and_place(&fruit(), BASKET_M, LIFT_M);
        for plan in paths.into_iter().chain([fruit]) {
            for payload_kg in [0.0, 0.5] {
                for stop in plan.stops(payload_kg) {
                    let config = ReachConfig::default();
                    let (pose, plant) = (maps.pose.as_ref(), maps.plant.as_ref());
                    let found = reach(
                        &stop.goal,
                        &robot,
                        pose,
                        plant,
                        stop.payload_kg,
                        &maps.seeds,
                        &config,
                    )
                    .expect("finite");
                    assert_eq!(
                        found.state,
                        ReachState::Reachable,
                        "{} {}: {found:?}",
                        plan.name,
                        stop.name
                    );
                }
            }
        }
    }
}
