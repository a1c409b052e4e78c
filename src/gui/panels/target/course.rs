//! What has become of the target: asked about, on its way, reached, or why not.

use std::collections::VecDeque;

use crate::gui::panels::widgets::number;
use crate::gui::theme::Level;
use crate::signal::{Goal, Mode, Pose, Snapshot, Stamp};
use crate::twin::Event;

/// Two targets closer than this in each coordinate are the same, m: half of what is shown.
const SAME_M: f64 = 5e-5;
/// A refusal within this time of the end of a motion is its reason, s.
const REASON_S: f64 = 0.2;
/// A motion that has not begun after this time does not begin, s.
const SET_OUT_S: f64 = 1.0;
/// The pace of the approach is judged over this time, s.
const PACE_S: f64 = 1.5;
/// A slower approach gives no estimate of its end, m/s.
const PACE_MIN_M_S: f64 = 1e-4;

/// The target that was asked about or gone to last.
#[derive(Clone, Debug, Default)]
pub struct Course {
    /// `None` before there was one.
    goal: Option<Goal>,
    state: State,
    /// The last refusal while the tip was on its way.
    refused: Option<(Stamp, String)>,
    /// Remaining distance over the last seconds: when (s), how far (m).
    left: VecDeque<(f64, f64)>,
    /// When Go was pressed, and how far away the target was, m.
    began: Option<(Stamp, f64)>,
    /// How long the motion took, s, and how far motion capture has the tip from the target then, m, where it sees it.
    result: Option<(f64, Option<f64>)>,
}

#[derive(Clone, Debug, Default, PartialEq)]
enum State {
    #[default]
    Nothing,
    /// No verdict yet.
    Asked,
    /// There will be none.
    NoVerdict(String),
    /// Go was pressed at this instant.
    Sent(Stamp),
    Going,
    /// How far from the target, m.
    Reached(f64),
    /// When, how far from the target (m), and why.
    Ended(Stamp, f64, String),
}

/// What the operator reads about the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Said {
    /// How abnormal it is.
    pub level: Level,
    /// With its glyph.
    pub title: String,
    /// What to know or to do.
    pub detail: String,
    /// Share of the way that is done, while the tip moves.
    pub share: Option<f32>,
}

fn same(a: &[f64; 3], b: &[f64; 3]) -> bool {
    (0..3).all(|i| (a[i] - b[i]).abs() < SAME_M)
}

impl Course {
    /// The twin is asked for a verdict.
    pub fn ask(&mut self, goal: Goal) {
        self.begin(goal, State::Asked);
    }

    /// Go was pressed now.
    pub fn send(&mut self, goal: Goal, now: &Snapshot) {
        self.begin(goal, State::Sent(now.stamp));
        self.began = Some((now.stamp, self.distance_m(now)));
    }

    fn begin(&mut self, goal: Goal, state: State) {
        *self = Self {
            goal: Some(goal),
            state,
            ..Self::default()
        };
    }

    /// Whether it is about this target.
    fn is_of(&self, target_m: &[f64; 3]) -> bool {
        let goal = self.goal.as_ref();
        goal.is_some_and(|g| same(&g.position_m, target_m))
    }

    /// Lets go of the target.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Whether the tip goes or went to `target_m`: there is nothing to place any more.
    pub fn is_settled(&self, target_m: &[f64; 3]) -> bool {
        let settled = matches!(
            self.state,
            State::Sent(_) | State::Going | State::Reached(_)
        );
        settled && self.is_of(target_m)
    }

    /// Why Go is off, as far as this target is concerned.
    pub fn refusal(&self, target_m: &[f64; 3]) -> Option<&'static str> {
        match self.state {
            _ if !self.is_of(target_m) => None,
            State::Sent(_) | State::Going => Some("The tip is on its way there."),
            State::Reached(_) => Some("The tip is there: pick another target."),
            _ => None,
        }
    }

    /// Takes an event of the twin.
    pub fn observe(&mut self, event: &Event) {
        match event {
            Event::Refused { stamp, reason } => match &mut self.state {
                State::Asked => self.state = State::NoVerdict(reason.clone()),
                State::Sent(_) => {
                    self.state = State::Ended(*stamp, f64::NAN, reason.clone());
                }
                State::Going => self.refused = Some((*stamp, reason.clone())),
                State::Ended(at, _, why) if stamp.since(*at).abs() < REASON_S => {
                    why.clone_from(reason);
                }
                _ => {}
            },
            Event::Reached { distance_m, .. } if self.state == State::Going => {
                self.state = State::Reached(*distance_m);
            }
            _ => {}
        }
    }

    /// Takes note of where the arm is and what it does.
    pub fn follow(&mut self, live: &Snapshot) {
        let goal = live.goal.as_ref().filter(|g| self.is_of(&g.position_m));
        let at_goal = live.mode == Mode::AtGoal;
        let is_goal = goal.is_some() && (at_goal || live.mode == Mode::Moving);
        let left_m = self.distance_m(live);
        let now = live.stamp;
        if is_goal && at_goal && self.result.is_none() {
            let took_s = self.began.map_or(f64::NAN, |(since, _)| now.since(since));
            let truth = live.fresh_truth().map(|t| t.base_from_tip);
            self.result = Some((took_s, truth.and_then(|t| self.off_m(&t))));
        }
        match &self.state {
            State::Sent(_) | State::Ended(..) if is_goal => self.state = State::Going,
            State::Sent(since)
                if matches!(live.mode, Mode::Safe(_)) || now.since(*since) > SET_OUT_S =>
            {
                self.state = State::Ended(now, left_m, why(&live.mode));
            }
            State::Going if is_goal && at_goal => self.state = State::Reached(left_m),
            State::Going if !is_goal => {
                let said = self.refused.take();
                let said = said.filter(|(at, _)| now.since(*at).abs() < REASON_S);
                let why = said.map_or_else(|| why(&live.mode), |(_, reason)| reason);
                self.state = State::Ended(now, left_m, why);
            }
            _ => {}
        }
        if self.state == State::Going {
            self.left.push_back((now.seconds(), left_m));
            let old = |t: &(f64, f64)| now.seconds() - t.0 > PACE_S;
            while self.left.front().is_some_and(old) {
                self.left.pop_front();
            }
        } else {
            self.left.clear();
        }
    }

    /// Distance of the estimate from the target, m.
    fn distance_m(&self, live: &Snapshot) -> f64 {
        let off_m = live.estimate.as_ref().map(|e| self.off_m(&e.base_from_tip));
        off_m.flatten().unwrap_or(f64::NAN)
    }

    /// Distance of the steered point from the target at a pose of the tip, m.
    fn off_m(&self, base_from_tip: &Pose) -> Option<f64> {
        let error = self.goal.as_ref()?.error(base_from_tip);
        Some(error.fixed_rows::<3>(0).norm())
    }

    /// Time until the tip is there at the pace of the last seconds, s.
    fn time_left_s(&self) -> Option<f64> {
        let ((t0, d0), (t1, d1)) = (self.left.front()?, self.left.back()?);
        let pace_m_s = (d0 - d1) / (t1 - t0);
        (t1 - t0 > 0.5 * PACE_S && pace_m_s > PACE_MIN_M_S).then(|| d1 / pace_m_s)
    }

    fn result_text(&self) -> String {
        let (took_s, truth_m) = self.result.unwrap_or((f64::NAN, None));
        let took = match took_s.is_finite() {
            true => format!(", after {} s", number(took_s, 1)),
            false => String::new(),
        };
        let truth = truth_m.map_or_else(String::new, |m| {
            format!(" Motion capture: {} mm.", number(m * 1e3, 1))
        });
        format!("By the estimate{took}.{truth} Click in the view for another target.")
    }

    /// What there is to read about `target_m`; nothing if it was neither asked about nor gone to.
    pub fn says(&self, target_m: &[f64; 3], live: &Snapshot) -> Option<Said> {
        if !self.is_of(target_m) {
            return None;
        }
        let said = |level, title: String, detail: String| {
            Some(Said {
                level,
                title,
                detail,
                share: None,
            })
        };
        let mm = |m: f64| number(m * 1e3, 1);
        match &self.state {
            State::Nothing => None,
            State::Asked => said(Level::Normal, "Checking…".into(), "Nothing moves.".into()),
            State::NoVerdict(why) => said(Level::Warning, "▲ No verdict".into(), why.clone()),
            State::Sent(_) => said(Level::Normal, "▶ Setting out…".into(), String::new()),
            State::Going => {
                let time = match self.time_left_s() {
                    Some(t) => format!("About {} s left.", number(t.max(1.0), 0)),
                    None => "The time left is not known yet.".into(),
                };
                let left_m = self.distance_m(live);
                let share = self
                    .began
                    .map(|(_, whole_m)| 1.0 - left_m / whole_m.max(1e-6));
                Some(Said {
                    level: Level::Normal,
                    title: format!("▶ Moving: {} mm left", mm(left_m)),
                    detail: time,
                    share: share
                        .filter(|s| s.is_finite())
                        .map(|s| s.clamp(0.0, 1.0) as f32),
                })
            }
            State::Reached(m) => said(
                Level::Normal,
                format!("◎ Reached: {} mm from the target", mm(*m)),
                self.result_text(),
            ),
            State::Ended(_, m, why) => {
                let title = match m.is_finite() {
                    true => format!("▲ Not reached: {} mm from the target", mm(*m)),
                    false => "▲ Not started".into(),
                };
                said(Level::Warning, title, why.clone())
            }
        }
    }
}

/// Why the tip is no longer on its way, without any other reason.
fn why(mode: &Mode) -> String {
    match mode {
        Mode::Hold => "The arm holds: RESUME goes on, Preview asks again.".into(),
        Mode::Safe(reason) => format!("SAFE: {reason}."),
        Mode::Disarmed => "The arm is disarmed.".into(),
        Mode::Moving | Mode::AtGoal => "Another motion has begun.".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;

    const AT_M: [f64; 3] = [0.06, 0.04, -0.30];

    /// At `t_s`, `off_m` beside the target in x.
    fn live(t_s: f64, mode: Mode, off_m: f64) -> Snapshot {
        let mut s = fixture::snapshot(t_s);
        s.goal = matches!(mode, Mode::Moving | Mode::AtGoal).then(|| Goal::position(AT_M));
        s.mode = mode;
        if let Some(e) = &mut s.estimate {
            e.base_from_tip.translation.vector = nalgebra::Vector3::from(AT_M);
            e.base_from_tip.translation.vector.x += off_m;
        }
        s
    }

    fn refusal(t_s: f64, reason: &str) -> Event {
        Event::Refused {
            stamp: Stamp::from_seconds(t_s),
            reason: reason.into(),
        }
    }

    fn read(course: &Course, s: &Snapshot) -> String {
        let said = course.says(&AT_M, s).expect("of this target");
        format!("{} | {}", said.title, said.detail)
    }

    /// Under way since 10 s at 5 mm/s, 20 mm left at 12 s.
    fn going() -> Course {
        let mut course = Course::default();
        course.ask(Goal::position(AT_M));
        course.send(Goal::position(AT_M), &live(10.0, Mode::Hold, 0.03));
        for k in 0..=20 {
            let t_s = 10.0 + 0.1 * f64::from(k);
            course.follow(&live(t_s, Mode::Moving, 0.03 - 5e-3 * (t_s - 10.0)));
        }
        course
    }

    #[test]
    fn it_moves_with_distance_and_time_left_and_then_it_is_reached() {
        let mut course = going();
        let s = live(12.0, Mode::Moving, 0.02);
        assert_eq!(
            read(&course, &s),
            "▶ Moving: 20.0 mm left | About 4 s left."
        );
        assert!(course.is_settled(&AT_M) && course.refusal(&AT_M).is_some());
        assert_eq!(course.says(&[0.0; 3], &s), None, "another target");
        let s = live(16.0, Mode::AtGoal, 4e-4);
        course.follow(&s);
        assert!(read(&course, &s).starts_with("◎ Reached: 0.4 mm from the target"));
        // It stays so when the arm is held there.
        let s = live(17.0, Mode::Hold, 5e-4);
        course.follow(&s);
        assert!(read(&course, &s).starts_with("◎ Reached: 0.4 mm"));
    }

    #[test]
    fn what_ended_it_is_told_whether_it_comes_before_or_after_the_mode() {
        let reason = "The tip does not come nearer than 6 mm: chamber 3 is at +40 kPa. Holding.";
        let held = live(12.1, Mode::Hold, 0.006);
        let mut before = going();
        before.observe(&refusal(12.1, reason));
        before.follow(&held);
        let mut after = going();
        after.follow(&held);
        assert!(read(&after, &held).contains("The arm holds"));
        after.observe(&refusal(12.1, reason));
        for course in [before, after] {
            let text = read(&course, &held);
            assert_eq!(
                text,
                format!("▲ Not reached: 6.0 mm from the target | {reason}")
            );
            assert!(!course.is_settled(&AT_M) && course.refusal(&AT_M).is_none());
        }
        // Another refusal, later or long before, is of something else.
        let mut course = going();
        course.observe(&refusal(11.0, "Another matter."));
        course.follow(&held);
        course.observe(&refusal(13.0, "Another matter."));
        assert!(read(&course, &held).contains("The arm holds"));
        // And resumed it goes on.
        course.follow(&live(14.0, Mode::Moving, 0.006));
        assert!(read(&course, &held).starts_with("▶ Moving"));
        let safe = live(14.1, Mode::Safe("over-pressure".into()), 0.006);
        course.follow(&safe);
        assert!(read(&course, &safe).ends_with("SAFE: over-pressure."));
    }

    #[test]
    fn a_go_that_is_refused_and_a_question_without_an_answer_say_so() {
        let mut course = Course::default();
        course.ask(Goal::position(AT_M));
        let s = live(1.0, Mode::Hold, 0.02);
        assert!(read(&course, &s).starts_with("Checking…"));
        course.observe(&refusal(1.0, "Load other networks."));
        assert_eq!(read(&course, &s), "▲ No verdict | Load other networks.");
        course.send(Goal::position(AT_M), &live(2.0, Mode::Hold, 0.02));
        course.follow(&live(2.1, Mode::Hold, 0.02));
        assert!(read(&course, &s).starts_with("▶ Setting out"));
        course.observe(&refusal(2.1, "Too old."));
        assert_eq!(read(&course, &s), "▲ Not started | Too old.");
        // Nor does it wait without end where nobody answers.
        course.send(Goal::position(AT_M), &live(3.0, Mode::Hold, 0.02));
        course.follow(&live(4.5, Mode::Hold, 0.02));
        assert!(read(&course, &s).starts_with("▲ Not reached"));
    }
}
