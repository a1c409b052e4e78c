//! `goto`, `excite`, `follow`, `pick-place`, `reach`.

use std::path::{Path as FilePath, PathBuf};

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use crate::cli::args::{self, InstrumentArgs, Kind, MonitorArgs, RollingArgs};
use crate::cli::outputs::Overwrite;
use crate::cli::{Failed, Report};
use springtwin::control::{ReachConfig, reach};
use springtwin::drive::measures::{self, PathMeasures};
use springtwin::drive::{
    BASKET_M, DEFAULT_RIG, Drive, Driven, LIFT_M, PATH_CENTRE_M, PATH_SIZE_M, Shape, TwinBuilder,
    along, drive, fruit, goal, longest_s, model, objects, of_pick_place, rig_options, stopwatch,
};
use springtwin::lab::session::{self, Excitation};
use springtwin::lab::{drive_log, learning, programmes};
use springtwin::learn::ErrorStats;
use springtwin::rig::hidden::Hidden;
use springtwin::rig::{Object, Obstacle, RigOptions};
use springtwin::robot::RobotSpec;
use springtwin::signal::{Goal, Reach, ReachState};
use springtwin::task::{Item, PATH_WAYPOINTS, Path, Plan, Programme};
use springtwin::twin::Event;

/// What every drive has.
#[derive(Args, Clone)]
pub struct Common {
    /// Where the boards are: `sim` (in this process, simulated time), `pty` (a rig process behind a
    /// pseudo-terminal), or a serial port
    #[arg(long, value_name = "sim|pty|PORT[,PORT]", default_value = DEFAULT_RIG)]
    rig: String,
    /// Which controller steers
    #[arg(long, value_enum, default_value_t = Kind::Ours)]
    controller: Kind,
    /// Mass in the virtual rig's gripper, kg (also declared to the twin)
    #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative)]
    payload: f64,
    /// Stiffness of the virtual rig's arm as a factor; the twin does not know it
    #[arg(long, value_name = "K", default_value = "1", value_parser = args::stiffness)]
    stiffness: f64,
    /// A flat thing that the virtual rig's arm cannot enter: a point on it (mm) and the direction out of it
    #[arg(long, value_name = "X,Y,Z,NX,NY,NZ", value_parser = args::obstacle, allow_hyphen_values = true)]
    obstacle: Option<Obstacle>,
    /// Hide an effect in the virtual rig, as `rig --hide` does; the twin does not know it
    #[arg(long, value_name = "ID[:TARGET][=VALUE,..][@S]")]
    hide: Vec<Hidden>,
    /// Seed of the virtual rig's noise
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// Folder for a log of every tick (CSV) and pictures (SVG)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Record to this file
    #[arg(long, value_name = "F.rrd")]
    record: Option<PathBuf>,
    /// The operator's note on the recording
    #[arg(long, value_name = "TEXT", requires = "record")]
    note: Option<String>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Let boards that are SAFE from before leave it: after an earlier program has ended or was not heard any more, and
    /// for causes that are named (such as `over-pressure`), which must be removed first
    #[arg(long, value_name = "CAUSE,...", num_args = 0..=1, value_delimiter = ',', value_parser = args::cause)]
    reset: Option<Vec<u16>>,
    #[command(flatten)]
    instruments: InstrumentArgs,
    #[command(flatten)]
    monitor: MonitorArgs,
    #[command(flatten)]
    rolling: RollingArgs,
}

impl Common {
    fn options(&self, robot: &RobotSpec) -> Result<RigOptions> {
        args::payload_in_range(robot, self.payload)?;
        args::hides_in_virtual(&self.hide, &self.rig)?;
        let mut options = rig_options(self.payload, self.seed);
        options.hidden.clone_from(&self.hide);
        options.surroundings.stiffness = self.stiffness;
        options.surroundings.obstacle = self.obstacle;
        Ok(options)
    }

    /// Refuses to write over what is there.
    fn check_outputs(&self) -> Result<()> {
        if let Some(out) = &self.out {
            self.overwrite.files(out, &drive_log::FILES)?;
        }
        match &self.record {
            Some(file) => self.overwrite.file(file),
            None => Ok(()),
        }
    }

    /// Carries out the plan; `objects` lie about the virtual rig.
    fn drive(
        &self,
        robot: &RobotSpec,
        robot_file: Option<&FilePath>,
        plan: Plan,
        seconds: f64,
        objects: Vec<Object>,
    ) -> Result<Driven> {
        self.check_outputs()?;
        let options = RigOptions {
            objects,
            ..self.options(robot)?
        };
        let twin = TwinBuilder::new(robot)
            .robot_file(robot_file)
            .rig(&self.rig, options)
            .gains(self.controller.gains())
            .instruments(self.instruments.of_arm(robot, &self.rig))
            .rolling(crate::cli::user::rolling_folder(), self.rolling.of())
            .watch(self.monitor.watch(robot)?)
            .ends_with(crate::cli::signals::asked_to_end()?);
        let what = Drive {
            plan,
            declared_kg: self.payload,
            seconds,
            after_s: 2.0,
            record: self.record.clone(),
            note: self.note.clone().unwrap_or_default(),
            reset: args::resets(self.reset.as_deref()),
        };
        drive(twin, &what, None)
    }

    fn write(&self, driven: &Driven, path: Option<&Path>, errors_mm: &[f64]) -> Result<()> {
        match &self.out {
            Some(out) => drive_log::write(out, driven, path, errors_mm),
            None => Ok(()),
        }
    }
}

#[derive(Args)]
pub struct GotoArgs {
    /// Where to, mm
    #[arg(value_name = "X,Y,Z", value_parser = args::xyz_mm, allow_hyphen_values = true)]
    target: [f64; 3],
    /// Where the gripper shall point, in the base frame (0,0,-1: straight down)
    #[arg(long, value_name = "X,Y,Z", value_parser = args::direction, allow_hyphen_values = true)]
    direction: Option<[f64; 3]>,
    /// The point that goes to the target
    #[arg(long, value_enum, default_value_t = Steered::Tip)]
    steer: Steered,
    /// Longest time, s
    #[arg(long, value_name = "S", default_value = "60", value_parser = args::not_negative)]
    seconds: f64,
    #[command(flatten)]
    common: Common,
}

/// A point of the end pad that can be steered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Steered {
    /// The tip, in the middle of the end pad
    Tip,
    /// Where the gripper holds its load, below the tip
    Grip,
}

impl Steered {
    fn goal(self, at_m: [f64; 3], direction: Option<[f64; 3]>, robot: &RobotSpec) -> Result<Goal> {
        let goal = goal(at_m, direction)?;
        Ok(match self {
            Self::Tip => goal,
            Self::Grip => Goal {
                point_m: robot.grip_m(),
                ..goal
            },
        })
    }
}

/// The error of a refused or interrupted drive.
pub fn ensure_carried_out(driven: &Driven, seconds: f64) -> Result<()> {
    ensure_no_refusal(driven)?;
    anyhow::ensure!(
        driven.finished_s.is_some(),
        "the plan was not carried out within {seconds:.0} s: the arm is held off it, or too slow for it"
    );
    Ok(())
}

/// `goto`.
pub fn goto(a: &GotoArgs, robot_file: Option<&FilePath>, robot: &RobotSpec) -> Result<Report> {
    let goal = a.steer.goal(a.target, a.direction, robot)?;
    let plan = Plan::goto(goal.clone());
    let driven = a
        .common
        .drive(robot, robot_file, plan, a.seconds, Vec::new())?;
    ensure_no_refusal(&driven)?;
    let m = measures::of_move(&driven.rows, &goal, robot).context("there was no motion")?;
    let reached = driven.finished_s.is_some();
    let steps = driven.events.iter().find_map(|e| match e {
        Event::Reached { steps, .. } => Some(*steps),
        _ => None,
    });
    let predicted = measures::tip_error_mm(&driven);
    let solve = measures::solve_micros(&driven.rows);
    a.common.write(&driven, None, &[])?;
    let [ticks, missed] = [driven.pace.ticks, driven.pace.missed];
    let json = json!({
        "ticks": ticks, "missed_ticks": missed, "frames": driven.frames[0], "frames_lost": driven.frames[1],
        "tip_error_mm": predicted, "target_error_mm": m.final_mm.map(|e| e.mean),
        "mean_mm": m.final_mm.map(|e| e.mean), "rmse_mm": m.final_mm.map(|e| e.rmse),
        "p95_mm": m.final_mm.map(|e| e.p95), "max_mm": m.final_mm.map(|e| e.max), "rotation_error_deg": m.final_deg,
        "reached": reached, "steps": steps, "settled_steps": m.steps, "settled_s": m.settled_s,
        "saturated_ratio": m.saturated_ratio, "solve_micros": solve_json(solve), "success": reached,
        "seconds": driven.rows.last().map(|r| r.t_s), "simulated": driven.simulated,
    });
    let text = format!(
        "{}\n{}{}\n{:.0} % of the steps saturated{}",
        match steps {
            Some(steps) => format!("reached after {steps} steps{}", label(&driven)),
            None => format!("not reached within {} s{}", a.seconds, label(&driven)),
        },
        match m.final_mm {
            None => "no ground truth".to_owned(),
            Some(e) => format!(
                "true tip {:.2} mm from the target, {}",
                e.mean,
                m.settled_s
                    .map_or("does not stay within 1 mm of it".to_owned(), |s| format!(
                        "stays within 1 mm after {s:.1} s"
                    )),
            ),
        },
        m.final_deg.map_or(String::new(), |deg| format!(
            ", {deg:.2} deg from the direction"
        )),
        m.saturated_ratio * 100.0,
        solve_text(solve),
    );
    answer(&driven, Report { text, json })
}

fn ensure_no_refusal(driven: &Driven) -> Result<()> {
    match (&driven.refused, &driven.safe) {
        (Some(reason), _) => anyhow::bail!("{reason}"),
        (None, Some(reason)) => anyhow::bail!("the arm went SAFE: {reason}"),
        (None, None) => Ok(()),
    }
}

/// The report of a drive; an error with it where the recording of the drive has failed.
fn answer(driven: &Driven, mut report: Report) -> Result<Report> {
    let why = driven.events.iter().find_map(|e| match e {
        Event::RecordingFailed { reason, .. } => Some(reason.clone()),
        _ => None,
    });
    report.json["recording_failed"] = json!(why);
    match why {
        None => Ok(report),
        Some(why) => Err(Failed { report, why }.into()),
    }
}

fn label(driven: &Driven) -> &'static str {
    if driven.simulated {
        " (simulated rig)"
    } else {
        ""
    }
}

fn solve_json(solve: Option<[f64; 2]>) -> Value {
    solve.map_or(
        Value::Null,
        |[median, p95]| json!({"median": median, "p95": p95}),
    )
}

fn solve_text(solve: Option<[f64; 2]>) -> String {
    solve.map_or(String::new(), |[median, p95]| {
        format!("\ncontroller: {median:.0} us median, {p95:.0} us 95 %")
    })
}

/// The paper's two paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ShapeName {
    /// A level circle
    Circle,
    /// A level figure 8
    Eight,
}

impl ShapeName {
    fn shape(self) -> Shape {
        match self {
            Self::Circle => Shape::Circle,
            Self::Eight => Shape::Eight,
        }
    }
}

#[derive(Args)]
pub struct ExciteArgs {
    /// How: mixed, holds, steps, loads, reversals, sines, single, axial or still
    #[arg(long, value_name = "NAME", default_value = "mixed", value_parser = crate::cli::session::excitation)]
    kind: Excitation,
    /// How long, s
    #[arg(long, value_name = "S", default_value = "90", value_parser = args::not_negative)]
    seconds: f64,
    /// For what, in the place of a kind: `commission` (for `gap commission`), `learn` (for `learn --from`), or a CSV file with the
    /// columns t_s, p1_kpa to p6_kpa
    #[arg(long, value_name = "commission|learn|F.csv", conflicts_with_all = ["kind", "seconds"])]
    plan: Option<PathBuf>,
    /// How long a plan takes, about, min; without it 3.5 for `commission`, 10 for `learn`
    #[arg(long, value_name = "MIN", requires = "plan", value_parser = args::not_negative)]
    minutes: Option<f64>,
    #[command(flatten)]
    common: Common,
}

/// Time that the boards have to introduce themselves and the gauges to be checked, s.
pub const EXCITE_BEGIN_S: f64 = 120.0;

#[derive(Args)]
pub struct FollowArgs {
    /// Which path
    #[arg(long, value_enum)]
    path: ShapeName,
    /// Waypoints, evenly spread
    #[arg(long, value_name = "N", default_value_t = PATH_WAYPOINTS, value_parser = args::waypoints)]
    waypoints: usize,
    /// Middle of the path, mm
    #[arg(long, value_name = "X,Y,Z", value_parser = args::xyz_mm, allow_hyphen_values = true)]
    centre: Option<[f64; 3]>,
    /// Radius of the circle, or half the length of the 8, mm
    #[arg(long, value_name = "MM", default_value_t = PATH_SIZE_M * 1e3, value_parser = args::size_mm)]
    size: f64,
    /// Speed along the path, mm/s
    #[arg(long, value_name = "MM/S", default_value = "3", value_parser = args::speed_mm_s)]
    speed: f64,
    /// How many times round
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..=1000))]
    laps: u32,
    #[command(flatten)]
    common: Common,
}

impl ExciteArgs {
    fn programme(&self, robot: &RobotSpec) -> Result<Programme> {
        let minutes = |usual: f64| self.minutes.unwrap_or(usual);
        let seed = self.common.seed;
        let Some(plan) = &self.plan else {
            let excitation = session::Drive::new(self.kind, robot, seed, self.seconds);
            return Ok(excitation.programme().clone());
        };
        Ok(match plan.to_str() {
            Some("commission") => {
                programmes::commission(robot, minutes(programmes::COMMISSION_MIN), seed)
            }
            Some("learn") => programmes::learn(robot, minutes(learning::MINUTES), seed),
            _ => {
                anyhow::ensure!(
                    self.minutes.is_none(),
                    "a file states its own time: leave --minutes out"
                );
                programmes::of_file(plan, robot)?
            }
        })
    }
}

/// `excite`.
pub fn excite(a: &ExciteArgs, robot_file: Option<&FilePath>, robot: &RobotSpec) -> Result<Report> {
    a.common.check_outputs()?;
    let programme = a.programme(robot)?;
    let (name, takes_s) = (programme.name.clone(), programme.seconds);
    crate::cli::stdio::complain(&format!("'{name}' takes {:.1} min", takes_s / 60.0));
    let plan = Plan::excite(programme);
    let seconds = takes_s + EXCITE_BEGIN_S;
    let driven = a
        .common
        .drive(robot, robot_file, plan, seconds, Vec::new())?;
    ensure_carried_out(&driven, seconds)?;
    a.common.write(&driven, None, &[])?;
    let set = |pick: fn(f64, f64) -> f64, from: f64| {
        let all = driven.rows.iter().flat_map(|r| r.chamber_pa);
        all.filter(|p| p.is_finite()).fold(from, pick) * 1e-3
    };
    let [low, high] = [
        set(f64::min, f64::INFINITY),
        set(f64::max, f64::NEG_INFINITY),
    ];
    let json = json!({
        "excitation": name, "seconds": takes_s, "ticks": driven.pace.ticks, "missed_ticks": driven.pace.missed,
        "frames": driven.frames[0], "frames_lost": driven.frames[1], "pressures_kpa": [low, high],
        "simulated": driven.simulated,
    });
    let text = format!(
        "'{name}' driven for {takes_s:.0} s{}: pressures from {low:+.1} to {high:+.1} kPa",
        label(&driven)
    );
    answer(&driven, Report { text, json })
}

/// `follow`.
pub fn follow(a: &FollowArgs, robot_file: Option<&FilePath>, robot: &RobotSpec) -> Result<Report> {
    let speed_m_s = a.speed * 1e-3;
    let path = a.path.shape().path(
        a.centre.unwrap_or(PATH_CENTRE_M),
        a.size * 1e-3,
        a.waypoints,
    );
    let plan = along(&path, speed_m_s, a.laps, robot)?;
    let seconds = longest_s(&path, speed_m_s, a.laps);
    let driven = a
        .common
        .drive(robot, robot_file, plan, seconds, Vec::new())?;
    ensure_carried_out(&driven, seconds)?;
    let m = measures::of_path(&driven, &path.waypoints_m, robot);
    a.common.write(&driven, Some(&path), &m.at_waypoints_mm)?;
    follow_report(&path, &driven, &m, robot)
}

fn follow_report(
    path: &Path,
    driven: &Driven,
    m: &PathMeasures,
    robot: &RobotSpec,
) -> Result<Report> {
    let s = m
        .spread
        .context("there is no ground truth: errors cannot be measured")?;
    let solve = measures::solve_micros(&driven.rows);
    let off_manifold = measures::off_manifold_mm(driven, robot);
    let text = format!(
        "{}{}: {} waypoints in {:.0} s\ntrue tip from each waypoint: mean {:.2} mm, RMSE {:.2}, 95 % {:.2}, largest {:.2}\n\
         true tip from the path: mean {:.2} mm\n{:.1} % of {} steps saturated, {} ticks missed{}",
        path.name,
        label(driven),
        m.at_waypoints_mm.len(),
        m.seconds,
        s.mean,
        s.rmse,
        s.p95,
        s.max,
        m.off_path.map_or(f64::NAN, |o| o.mean),
        m.saturated_ratio * 100.0,
        m.steps,
        driven.pace.missed,
        solve_text(solve),
    );
    let laps = m.at_waypoints_mm.chunks(path.waypoints_m.len());
    let json = json!({
        "path": path.name, "laps_mm": laps.map(|l| ErrorStats::of(l.to_vec())).collect::<Vec<_>>(), "waypoints": m.at_waypoints_mm.len(),
        "mean_mm": s.mean, "rmse_mm": s.rmse, "p95_mm": s.p95, "max_mm": s.max,
        "off_path_mm": m.off_path, "tip_error_mm": measures::tip_error_mm(driven),
        "steps": m.steps, "saturated_ratio": m.saturated_ratio, "solve_micros": solve_json(solve),
        "off_manifold_mm": off_manifold, "success": driven.finished_s.is_some(),
        "ticks": driven.pace.ticks, "missed_ticks": driven.pace.missed,
        "frames": driven.frames[0], "frames_lost": driven.frames[1],
        "seconds": driven.rows.last().map(|r| r.t_s), "simulated": driven.simulated,
    });
    answer(driven, Report { text, json })
}

#[derive(Args)]
pub struct PickPlaceArgs {
    /// Something to pick up: where the tip grasps it (mm) and its mass (kg). May be given several times; without it,
    /// the paper's tomato, lemon and guava
    #[arg(long, value_name = "X,Y,Z,KG", value_parser = args::item, allow_hyphen_values = true)]
    item: Vec<Item>,
    /// Where the tip lets go, mm
    #[arg(long, value_name = "X,Y,Z", value_parser = args::xyz_mm, allow_hyphen_values = true)]
    basket: Option<[f64; 3]>,
    /// Longest time, s
    #[arg(long, value_name = "S", default_value = "900", value_parser = args::not_negative)]
    seconds: f64,
    #[command(flatten)]
    common: Common,
}

/// `pick-place`.
pub fn pick_place(
    a: &PickPlaceArgs,
    robot_file: Option<&FilePath>,
    robot: &RobotSpec,
) -> Result<Report> {
    let items = if a.item.is_empty() {
        fruit()
    } else {
        a.item.clone()
    };
    let basket_m = a.basket.unwrap_or(BASKET_M);
    let plan = Plan::pick_and_place(&items, basket_m, LIFT_M);
    let driven = a
        .common
        .drive(robot, robot_file, plan.clone(), a.seconds, objects(&items))?;
    ensure_carried_out(&driven, a.seconds)?;
    a.common.write(&driven, None, &[])?;
    let p = of_pick_place(&driven, &plan, basket_m, robot);
    let at_grips = p
        .at_grips
        .context("there is no ground truth: errors cannot be measured")?;
    let solve = measures::solve_micros(&driven.rows);
    let in_basket = match p.in_basket {
        Some(n) => format!("{n} of {} in the basket", items.len()),
        None => "what is in the basket is not known here".to_owned(),
    };
    let text = format!(
        "{}{}: {in_basket}, {} steps, {:.0} s\ntrue tip when it grips and lets go: mean {:.2} mm, largest {:.2}\n\
         {:.1} % of the steps saturated{}",
        plan.name,
        label(&driven),
        driven.rows.len(),
        driven.finished_s.unwrap_or(f64::NAN),
        at_grips.mean,
        at_grips.max,
        p.saturated_ratio * 100.0,
        solve_text(solve),
    );
    let json = json!({
        "items": items.len(), "in_basket": p.in_basket, "success": p.in_basket.map(|n| n == items.len()),
        "mean_mm": at_grips.mean, "rmse_mm": at_grips.rmse, "p95_mm": at_grips.p95, "max_mm": at_grips.max,
        "steps": driven.rows.len(), "saturated_ratio": p.saturated_ratio, "solve_micros": solve_json(solve),
        "seconds": driven.finished_s, "ticks": driven.pace.ticks, "missed_ticks": driven.pace.missed,
        "simulated": driven.simulated,
    });
    answer(&driven, Report { text, json })
}

#[derive(Args)]
pub struct ReachArgs {
    /// Where to, mm
    #[arg(value_name = "X,Y,Z", value_parser = args::xyz_mm, allow_hyphen_values = true)]
    target: [f64; 3],
    /// Where the gripper shall point, in the base frame (0,0,-1: straight down)
    #[arg(long, value_name = "X,Y,Z", value_parser = args::direction, allow_hyphen_values = true)]
    direction: Option<[f64; 3]>,
    /// The point that goes to the target
    #[arg(long, value_enum, default_value_t = Steered::Tip)]
    steer: Steered,
    /// Mass in the gripper, kg
    #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative)]
    payload: f64,
    /// Networks from `train`; the virtual rig's without it
    #[arg(long, value_name = "F.safetensors")]
    networks: Option<PathBuf>,
}

/// `reach`.
pub fn reach_command(a: &ReachArgs, robot: &RobotSpec) -> Result<Report> {
    args::payload_in_range(robot, a.payload)?;
    let maps = model::maps_for(robot, DEFAULT_RIG, a.networks.as_deref())?;
    let goal = a.steer.goal(a.target, a.direction, robot)?;
    // What the robot's patches hang on the gripper is carried too, as far as the plant knows such loads.
    let carried_kg = springtwin::sim::Model::nominal(robot).carried_kg(a.payload);
    let ask = || {
        let config = ReachConfig::default();
        let (pose, plant) = (maps.pose.as_ref(), maps.plant.as_ref());
        reach(&goal, robot, pose, plant, carried_kg, &maps.seeds, &config)
    };
    ask()?;
    // The first answer fetches everything into the caches.
    let before = stopwatch();
    let found = ask()?;
    let micros = (stopwatch() - before).as_secs_f64() * 1e6;
    let state = serde_json::to_value(found.state)?;
    let chamber = found.limiting_chamber;
    let json = json!({
        "state": state, "distance_mm": found.distance_m * 1e3, "nearest_mm": found.nearest_m.map(|x| x * 1e3),
        "limiting_chamber": chamber.map(|(i, pa)| json!({"chamber": i, "kpa": pa * 1e-3})),
        "chamber_kpa": found.chamber_pa.map(|p| p * 1e-3), "micros": micros,
    });
    Ok(Report {
        text: reach_text(&found, micros),
        json,
    })
}

fn reach_text(found: &Reach, micros: f64) -> String {
    let kpa = found
        .chamber_pa
        .map(|p| format!("{:+.1}", p * 1e-3))
        .join(", ");
    let chamber = found.limiting_chamber.map_or(String::new(), |(i, pa)| {
        format!(", chamber {i} at {:+.0} kPa", pa * 1e-3)
    });
    let verdict = match found.state {
        ReachState::Reachable => "reachable".to_owned(),
        ReachState::Marginal if found.distance_m < 1e-4 => {
            format!("reachable with little pressure to spare{chamber}")
        }
        ReachState::Marginal => {
            format!("marginal: {:.1} mm short{chamber}", found.distance_m * 1e3)
        }
        ReachState::Unreachable => {
            let [x, y, z] = found.nearest_mm();
            let short_mm = found.distance_m * 1e3;
            format!(
                "unreachable: {short_mm:.0} mm short{chamber}; the nearest point with pressure to spare is {x:.0}, {y:.0}, {z:.0} mm"
            )
        }
        ReachState::OutsideData => {
            "outside of what the model was trained on: no verdict".to_owned()
        }
    };
    format!("{verdict}\npressures {kpa} kPa, found in {micros:.0} us")
}
