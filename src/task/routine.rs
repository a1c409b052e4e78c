//! A plan under way: which leg, where the tip shall be now, what has happened.

use std::sync::Arc;

use super::goto::{Arrival, Goto, GotoState};
use super::plan::{Follow, GRIP_S, Leg, Plan, Stop};
use super::programme::Programme;
use crate::signal::{CHAMBERS, Estimate, Goal, Gripper, Reach, Stamp, Via};

/// Time in which the point on a path reaches its speed, s.
const RAMP_S: f64 = 1.0;
/// A tip that is this far behind does not slow the point down, m.
const LAG_FREE_M: f64 = 0.4e-3;
/// So much further behind, the point goes at its slowest, m.
const LAG_SLOW_M: f64 = 3e-3;
/// The pace falls to nothing in this time when the tip is twice as far behind as is free, and recovers as fast, s.
const PACE_S: f64 = 4.0;
/// Slowest share of the speed: a tip that is held off its path is not waited for without end.
const PACE_MIN: f64 = 0.1;
/// Time constant of the mean of the lag, s: a single estimate is noisier than what is free.
const LAG_SMOOTHING_S: f64 = 0.2;

/// Something that happened in an update.
#[derive(Clone, Debug, PartialEq)]
pub enum Happening {
    /// The tip has settled at a goal.
    Arrived(Arrival),
    /// The gripper was commanded, and holds so much (kg) from now on.
    Gripped(Gripper, f64),
    /// Nothing is left to do; the last goal is kept.
    Finished,
}

/// What to steer to.
#[derive(Clone, Debug, PartialEq)]
pub enum Target<'a> {
    /// A goal, with its verdict; `None`: there is none.
    Goal(&'a Goal, Option<&'a Reach>),
    /// The next waypoint of a path, and the point that moves along it.
    Along(Goal, Via),
    /// These gauge pressures of chambers 1 to 6, Pa: no controller steers.
    Pressures([f64; CHAMBERS]),
}

/// A point that moves along a path at an even speed, and waits for a tip that falls behind: pumps may be too slow
/// for the speed asked for.
#[derive(Clone, Debug, PartialEq)]
struct Tracker {
    /// Distance along a lap from the first waypoint to each, then to the first again, m.
    length_m: Vec<f64>,
    /// Of one lap.
    waypoints_m: Vec<[f64; 3]>,
    laps: u32,
    speed_m_s: f64,
    /// Laps done, and the way on the present one, m.
    laps_done: u32,
    travelled_m: f64,
    /// Since it set out.
    moving_s: f64,
    /// How far the tip is behind, smoothed, m.
    lag_m: f64,
    /// Share of the speed that the tip can keep.
    pace: f64,
    now: Option<Stamp>,
}

impl Tracker {
    fn new(follow: &Follow) -> Self {
        let waypoints_m = follow.path.waypoints_m.clone();
        let mut length_m = vec![0.0];
        let mut total_m = 0.0;
        for (a, b) in waypoints_m.iter().zip(waypoints_m.iter().cycle().skip(1)) {
            total_m += distance(a, b);
            length_m.push(total_m);
        }
        Self {
            length_m,
            waypoints_m,
            laps: follow.laps.max(1),
            speed_m_s: follow.speed_m_s,
            laps_done: 0,
            travelled_m: 0.0,
            moving_s: 0.0,
            lag_m: 0.0,
            pace: 1.0,
            now: None,
        }
    }

    fn advance(&mut self, now: Stamp, tip_m: &[f64; 3]) {
        let dt_s = since_last(&mut self.now, now);
        let via = self.via();
        let along = nalgebra::Vector3::from(via.velocity_m_s).try_normalize(0.0);
        let behind = nalgebra::Vector3::from(via.position_m) - nalgebra::Vector3::from(*tip_m);
        let lag_m = along.map_or(0.0, |a| a.dot(&behind));
        if lag_m.is_finite() {
            self.lag_m += (lag_m - self.lag_m) * (1.0 - (-dt_s / LAG_SMOOTHING_S).exp());
        }
        self.pace += (1.0 - self.lag_m / LAG_FREE_M) * dt_s / PACE_S;
        self.pace = self.pace.clamp(PACE_MIN, 1.0);
        self.travelled_m += self.speed_now_m_s() * dt_s;
        self.moving_s += dt_s;
        let lap_m = self.length_m[self.waypoints_m.len()];
        if self.travelled_m >= lap_m && self.laps_done + 1 < self.laps {
            self.laps_done += 1;
            self.travelled_m -= lap_m;
        }
    }

    fn speed_now_m_s(&self) -> f64 {
        let ramp = ((self.moving_s + 0.01) / RAMP_S).min(1.0);
        let wait = 1.0 - ((self.lag_m - LAG_FREE_M) / LAG_SLOW_M).clamp(0.0, 1.0);
        self.speed_m_s * ramp * (self.pace * wait).max(PACE_MIN)
    }

    /// Index of the waypoint it travels to on this lap: the number of waypoints stands for the first again.
    fn next(&self) -> usize {
        let passed = self.length_m.partition_point(|l| *l <= self.travelled_m);
        passed.clamp(1, self.waypoints_m.len())
    }

    fn waypoint(&self, k: usize) -> [f64; 3] {
        self.waypoints_m[k % self.waypoints_m.len()]
    }

    /// Of all laps: the waypoint it travels to, and the last one.
    fn count(&self) -> (usize, usize) {
        let n = self.waypoints_m.len();
        (
            self.laps_done as usize * n + self.next(),
            self.laps as usize * n,
        )
    }

    fn has_ended(&self) -> bool {
        self.laps_done + 1 >= self.laps
            && self.length_m.last().is_none_or(|l| self.travelled_m >= *l)
    }

    fn via(&self) -> Via {
        let next = self.next();
        let (b, a) = (self.waypoint(next), self.waypoint(next - 1));
        let from_m = self.length_m[next - 1];
        let span_m = (self.length_m[next] - from_m).max(1e-9);
        let share = ((self.travelled_m - from_m) / span_m).clamp(0.0, 1.0);
        let speed = self.speed_now_m_s();
        Via {
            position_m: std::array::from_fn(|i| a[i] + share * (b[i] - a[i])),
            velocity_m_s: std::array::from_fn(|i| speed * (b[i] - a[i]) / span_m),
        }
    }
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (nalgebra::Vector3::from(*a) - nalgebra::Vector3::from(*b)).norm()
}

#[derive(Clone, Debug, PartialEq)]
enum Doing {
    /// Going to a goal, or keeping it.
    Going(Goto),
    /// On a path.
    Following(Box<Tracker>),
    /// The gripper moves, and has since then; the arm keeps its last goal.
    Gripping(Option<Stamp>),
    /// In a programme of pressures, so many seconds after its beginning; the last ones are kept.
    Exciting {
        programme: Arc<Programme>,
        t_s: f64,
        now: Option<Stamp>,
    },
}

/// Time since the last update; a pause of the program is none.
fn since_last(last: &mut Option<Stamp>, now: Stamp) -> f64 {
    let since_s = last.replace(now).map_or(0.0, |t| now.since(t));
    if (0.0..=0.1).contains(&since_s) {
        since_s
    } else {
        0.0
    }
}

/// A plan under way.
#[derive(Clone, Debug, PartialEq)]
pub struct Routine {
    plan: Plan,
    /// The verdict on the goal of each leg that has one.
    reaches: Vec<Option<Reach>>,
    /// In the gripper when the plan began, kg.
    base_kg: f64,
    leg: usize,
    doing: Doing,
    /// When the arm settled at the goal of this leg, while it rests there before the next one.
    settled: Option<Stamp>,
    /// The goal of the present leg, or of the last one that had one.
    kept: Option<(Goal, Option<Reach>)>,
}

impl Routine {
    /// A plan from its first leg on. `reaches` holds, per leg, the verdict on its goal: `None` for legs
    /// without one (paths, grips). `base_kg` is in the gripper at the start.
    pub fn new(plan: Plan, reaches: Vec<Option<Reach>>, base_kg: f64, now: Stamp) -> Self {
        let mut routine = Self {
            doing: Doing::Gripping(None),
            plan,
            reaches,
            base_kg,
            leg: 0,
            settled: None,
            kept: None,
        };
        routine.begin(now);
        routine
    }

    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// A new verdict on the goal of a leg that is not done; legs without one (paths, grips) stay without.
    pub fn judge(&mut self, leg: usize, reach: Reach) {
        let is_move = matches!(self.plan.legs.get(leg), Some(Leg::Move(_)));
        if let (true, Some(slot)) = (is_move, self.reaches.get_mut(leg)) {
            if let (true, Some((_, kept))) = (leg == self.leg, &mut self.kept) {
                *kept = Some(reach.clone());
            }
            *slot = Some(reach);
        }
    }

    /// The stops that are not passed yet.
    pub fn stops_ahead(&self) -> Vec<Stop> {
        let mut stops = self.plan.stops(self.base_kg);
        let mut of_leg = 0;
        stops.retain(|s| {
            if s.leg != self.leg {
                return s.leg > self.leg;
            }
            of_leg += 1;
            match &self.doing {
                Doing::Following(t) => {
                    let n = t.waypoints_m.len();
                    let (k, last) = t.count();
                    // On the last lap, from the waypoint that it travels to.
                    k + n <= last || of_leg > k + n - last
                }
                // At the end of a path, or on the way to a goal.
                Doing::Going(_) => matches!(self.plan.legs.get(self.leg), Some(Leg::Move(_))),
                Doing::Gripping(_) | Doing::Exciting { .. } => true,
            }
        });
        stops
    }

    /// How many legs are done.
    pub fn legs_done(&self) -> usize {
        self.leg
    }

    /// Along a path: index of the waypoint travelled to, counted over all laps, and of the last one; `None` off a path.
    pub fn waypoint(&self) -> Option<(usize, usize)> {
        match &self.doing {
            Doing::Following(t) => Some(t.count()),
            Doing::Going(_) | Doing::Gripping(_) | Doing::Exciting { .. } => None,
        }
    }

    /// Whether every leg is done and the last goal is kept.
    pub fn is_at_end(&self) -> bool {
        let kept = match &self.doing {
            Doing::Going(goto) => matches!(goto.state(), GotoState::AtGoal),
            Doing::Following(_) | Doing::Gripping(_) | Doing::Exciting { .. } => true,
        };
        self.is_over() && kept
    }

    /// What to steer to now; `None` before the first goal.
    pub fn target(&self) -> Option<Target<'_>> {
        if let Doing::Following(t) = &self.doing {
            let goal = Goal::position(t.waypoint(t.next()));
            return Some(Target::Along(goal, t.via()));
        }
        if let Doing::Exciting { programme, t_s, .. } = &self.doing {
            return Some(Target::Pressures(programme.at(*t_s)));
        }
        let (goal, reach) = self.kept.as_ref()?;
        Some(Target::Goal(goal, reach.as_ref()))
    }

    /// Takes note of the time and of an estimate; what has happened, in order.
    pub fn update(&mut self, now: Stamp, estimate: &Estimate) -> Vec<Happening> {
        let mut happened = Vec::new();
        let over = self.is_over();
        match &mut self.doing {
            Doing::Going(goto) => {
                if let Some(arrival) = goto.update(estimate) {
                    happened.push(Happening::Arrived(arrival));
                    self.settled.get_or_insert(now);
                }
                if let Some(since) = self.settled
                    && now.since(since) >= self.plan.rest_s
                {
                    self.proceed(now);
                }
            }
            Doing::Following(tracker) => {
                tracker.advance(now, &estimate.base_from_tip.translation.vector.into());
                if tracker.has_ended() {
                    // It settles at the end of the path before anything else.
                    let end = Goal::position(tracker.waypoint(0));
                    self.doing = Doing::Going(Goto::new(end.clone(), now));
                    self.kept = Some((end, None));
                }
            }
            Doing::Exciting {
                programme,
                t_s,
                now: last,
            } => {
                *t_s = (*t_s + since_last(last, now)).min(programme.seconds);
                if *t_s >= programme.seconds {
                    self.proceed(now);
                }
            }
            Doing::Gripping(since) => {
                let first = since.is_none();
                let since = *since.get_or_insert(now);
                if first
                    && let Some(Leg::Grip {
                        gripper,
                        payload_kg,
                    }) = self.plan.legs.get(self.leg)
                {
                    happened.push(Happening::Gripped(*gripper, self.base_kg + payload_kg));
                }
                if now.since(since) >= GRIP_S {
                    self.proceed(now);
                }
            }
        }
        if self.is_over() && !over {
            happened.push(Happening::Finished);
        }
        happened
    }

    fn is_over(&self) -> bool {
        self.leg >= self.plan.legs.len()
    }

    /// On to the next leg, if there is one; at the end the last goal is kept.
    fn proceed(&mut self, now: Stamp) {
        self.settled = None;
        if !self.is_over() {
            self.leg += 1;
            self.begin(now);
        }
    }

    fn begin(&mut self, now: Stamp) {
        match self.plan.legs.get(self.leg) {
            Some(Leg::Move(goal)) => {
                let reach = self.reaches.get(self.leg).cloned().flatten();
                self.doing = Doing::Going(Goto::new(goal.clone(), now));
                self.kept = Some((goal.clone(), reach));
            }
            Some(Leg::Follow(follow)) if follow.path.waypoints_m.is_empty() => self.proceed(now),
            Some(Leg::Follow(follow)) => {
                self.doing = Doing::Following(Box::new(Tracker::new(follow)));
            }
            Some(Leg::Grip { .. }) => self.doing = Doing::Gripping(None),
            Some(Leg::Excite(programme)) => {
                self.doing = Doing::Exciting {
                    programme: Arc::clone(programme),
                    t_s: 0.0,
                    now: None,
                };
            }
            None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{Matrix6, pose_from_ypr};
    use crate::task::Item;
    use crate::task::circle;

    /// Runs a plan with a tip that is always where it shall be; what happened, with times and tip positions.
    fn run(plan: Plan, seconds: f64) -> (Routine, Vec<(f64, Happening)>, Vec<[f64; 3]>) {
        let legs = plan.legs.len();
        let mut routine = Routine::new(plan, vec![None; legs], 0.0, Stamp::ZERO);
        let (mut log, mut way) = (Vec::new(), Vec::new());
        let mut tip_m = [0.0, 0.0, -0.3];
        for k in 0..(seconds * 100.0) as u32 {
            let t_s = f64::from(k) * 0.01;
            let now = Stamp::from_seconds(t_s);
            match routine.target() {
                Some(Target::Goal(goal, _)) => tip_m = goal.position_m,
                Some(Target::Along(_, via)) => {
                    tip_m = via.position_m;
                    way.push(tip_m);
                }
                Some(Target::Pressures(pa)) => tip_m = [pa[0], pa[1], pa[2]],
                None => {}
            }
            let estimate = Estimate {
                stamp: now,
                base_from_tip: pose_from_ypr(tip_m, [0.0; 3]),
                covariance: Matrix6::zeros(),
                training_distance: 1.0,
            };
            let happened = routine.update(now, &estimate);
            log.extend(happened.into_iter().map(|h| (t_s, h)));
        }
        (routine, log, way)
    }

    #[test]
    fn a_path_is_followed_at_its_speed_and_ends_where_it_began() {
        let path = circle([0.0, 0.0, -0.3], 0.05, 60);
        let length_m = 60.0 * 2.0 * 0.05 * (std::f64::consts::PI / 60.0).sin();
        let plan = Plan::follow(Follow {
            path: path.clone(),
            speed_m_s: 5e-3,
            laps: 1,
        });
        let (routine, log, way) = run(plan.expect("has waypoints"), 80.0);
        assert!(routine.is_at_end() && routine.waypoint().is_none());
        let on_path_s = way.len() as f64 * 0.01;
        // Half of the ramp is lost.
        assert!(
            (on_path_s - (length_m / 5e-3 + 0.5)).abs() < 0.05,
            "{on_path_s}"
        );
        for pair in way.windows(2) {
            assert!(distance(&pair[0], &pair[1]) <= 5e-3 * 0.01 + 1e-9);
        }
        let end = way[way.len() - 1];
        assert!(distance(&end, &path.waypoints_m[0]) < 1e-4, "{end:?}");
        for p in &way {
            let off_m = ((p[0].hypot(p[1])) - 0.05).abs();
            assert!(
                off_m < 0.08e-3,
                "chords of 6 degrees leave the circle by 0.07 mm: {off_m}"
            );
        }
        let words: Vec<&Happening> = log.iter().map(|(_, h)| h).collect();
        assert!(
            matches!(
                words[..],
                [
                    Happening::Arrived(_),
                    Happening::Arrived(_),
                    Happening::Finished
                ]
            ),
            "{words:?}"
        );
    }

    #[test]
    fn the_arm_rests_at_each_goal_for_as_long_as_the_plan_says() {
        let legs = [0.0, 0.01].map(|x_m| Leg::Move(Goal::position([x_m, 0.0, -0.3])));
        let arrivals = |rest_s: f64| {
            let plan = Plan {
                rest_s,
                ..Plan::new("two poses", legs.to_vec())
            };
            run(plan, 20.0).1.into_iter().map(|(t_s, _)| t_s).collect()
        };
        // First arrival, second arrival, end.
        let [without, with]: [Vec<f64>; 2] = [arrivals(0.0), arrivals(1.5)];
        assert_eq!((without.len(), with.len()), (3, 3));
        assert_eq!(without[1], without[2]);
        for (k, rests) in [0.0, 1.5, 3.0].into_iter().enumerate() {
            let later_s = with[k] - without[k];
            assert!((later_s - rests).abs() < 0.015, "{k}: {later_s} s");
        }
    }

    #[test]
    fn the_point_waits_for_a_tip_that_cannot_keep_up() {
        let mut tracker = Tracker::new(&Follow {
            path: circle([0.0, 0.0, -0.3], 0.05, 60),
            speed_m_s: 4e-3,
            laps: 1,
        });
        let mut tip = nalgebra::Vector3::from(tracker.via().position_m);
        let mut lags = Vec::new();
        for k in 0..6000 {
            // This tip makes 2.5 mm/s.
            let way = nalgebra::Vector3::from(tracker.via().position_m) - tip;
            tip += way * (25e-6 / way.norm()).min(1.0);
            tracker.advance(Stamp::from_seconds(f64::from(k) * 0.01), &tip.into());
            lags.push(way.norm());
        }
        let late = &lags[3000..];
        let mean_m = late.iter().sum::<f64>() / late.len() as f64;
        assert!(
            mean_m < 0.6e-3 && lags.iter().all(|l| *l < 4e-3),
            "{mean_m}"
        );
        let passed_m = tracker.travelled_m;
        assert!((0.12..0.155).contains(&passed_m), "{passed_m} m in 60 s");
        // Held fast, it is not waited for without end.
        for k in 6000..12_000 {
            tracker.advance(Stamp::from_seconds(f64::from(k) * 0.01), &tip.into());
        }
        assert!(tracker.travelled_m > passed_m + 1e-3);
    }

    #[test]
    fn the_velocity_is_that_of_the_point() {
        let mut tracker = Tracker::new(&Follow {
            path: circle([0.0, 0.0, -0.3], 0.05, 60),
            speed_m_s: 4e-3,
            laps: 3,
        });
        for k in 0..2000 {
            let tip_m = tracker.via().position_m;
            tracker.advance(Stamp::from_seconds(f64::from(k) * 0.01), &tip_m);
        }
        let before = tracker.via();
        tracker.advance(Stamp::from_seconds(20.0), &before.position_m);
        let after = tracker.via();
        for i in 0..3 {
            let rate = (after.position_m[i] - before.position_m[i]) / 0.01;
            assert!((rate - after.velocity_m_s[i]).abs() < 5e-4, "{rate}");
        }
        let speed = nalgebra::Vector3::from(after.velocity_m_s).norm();
        assert!((speed - 4e-3).abs() < 1e-12);
        assert_eq!(tracker.count().1, 180);
    }

    #[test]
    fn what_is_passed_is_no_stop_ahead() {
        let path = circle([0.0, 0.0, -0.3], 0.05, 60);
        let follow = Follow {
            path,
            speed_m_s: 5e-3,
            laps: 2,
        };
        let plan = Plan::follow(follow).expect("has waypoints");
        let ahead_after = |seconds: f64| run(plan.clone(), seconds).0.stops_ahead().len();
        assert_eq!(ahead_after(0.1), 61);
        // On the first lap all of them come again.
        assert_eq!(ahead_after(40.0), 60);
        let half = ahead_after(0.6 + 62.8 + 31.4);
        assert!((28..=31).contains(&half), "{half}");
        assert_eq!(ahead_after(140.0), 0);
    }

    #[test]
    fn pick_and_place_grips_where_it_should_and_waits() {
        let item = Item {
            name: "tomato".to_owned(),
            grasp_m: [-0.08, 0.0, -0.33],
            mass_kg: 0.12,
        };
        let plan = Plan::pick_and_place(&[item], [0.08, 0.0, -0.31], 0.04);
        let (routine, log, _) = run(plan, 30.0);
        assert!(routine.is_at_end());
        let grips: Vec<(f64, &Happening)> = log
            .iter()
            .filter(|(_, h)| matches!(h, Happening::Gripped(..)))
            .map(|(t, h)| (*t, h))
            .collect();
        // It opens before it begins.
        assert_eq!(grips[0].1, &Happening::Gripped(Gripper::Open, 0.0));
        let grips = &grips[1..];
        assert_eq!(grips[0].1, &Happening::Gripped(Gripper::Closed, 0.12));
        assert_eq!(grips[1].1, &Happening::Gripped(Gripper::Open, 0.0));
        let next = log
            .iter()
            .find(|(t, h)| *t > grips[0].0 && matches!(h, Happening::Arrived(_)))
            .expect("goes on");
        assert!(next.0 - grips[0].0 > GRIP_S, "did not wait for the gripper");
        assert_eq!(log.last().map(|(_, h)| h), Some(&Happening::Finished));
    }
}
