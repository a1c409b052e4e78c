//! `import`: a motion-capture file, an MCAP file, or another lab's log, becomes a session.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, Subcommand, ValueEnum};
use serde_json::{Value, json};

use super::outputs::Overwrite;
use super::{Report, args};
use springtwin::lab::import::{Chosen, Imported, Options, import, import_bag};
use springtwin::lab::import_log::{self, ImportedLog, Shift, import_log};
use springtwin::recording::{MarkerBody, MocapRotation, OwnBag, is_mcap};
use springtwin::robot::RobotSpec;

#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct ImportArgs {
    #[command(subcommand)]
    log: Option<ImportCommand>,
    /// Vicon CSV (Trajectories, Segments, Tracker objects), OptiTrack Motive CSV, C3D, or MCAP that springtwin wrote
    #[arg(required = true)]
    file: Option<PathBuf>,
    /// Folder for the session
    #[arg(long, value_name = "SESSION", required = true)]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Which object's pose to take, where the file has several
    #[arg(long, value_name = "NAME", conflicts_with_all = ["markers", "subject"])]
    object: Option<String>,
    /// Take the rigid body of these markers
    #[arg(
        long,
        value_name = "A,B,C",
        value_delimiter = ',',
        conflicts_with = "subject"
    )]
    markers: Option<Vec<String>>,
    /// Take the rigid body of all markers of this subject
    #[arg(long, value_name = "S")]
    subject: Option<String>,
    /// Put the poses into the robot's base by this file of `calibrate mocap`
    #[arg(long, value_name = "F.toml")]
    registration: Option<PathBuf>,
    /// This is the very take that was registered: put it onto the clock of the robot's recording, too
    #[arg(long, requires = "registration")]
    robot_clock: bool,
    /// How a Vicon Tracker file writes three angles, where it does not say
    #[arg(long, value_enum)]
    rotation: Option<Rotation>,
}

#[derive(Subcommand)]
enum ImportCommand {
    /// Make a session of another lab's log or ROS 2 bag, by a map of its columns or topics
    Log(LogArgs),
}

#[derive(Args)]
struct LogArgs {
    /// What the columns hold (assets/logs/asu-arm.toml is one), or the topics (assets/logs/ros2-bag.toml)
    #[arg(value_name = "MAP.toml")]
    map: PathBuf,
    /// The log: text in columns, or a ROS 2 bag (.mcap)
    file: PathBuf,
    /// Folder for the session
    #[arg(long, value_name = "SESSION")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Motion capture, where the map has it in a file of its own
    #[arg(long, value_name = "FILE")]
    mocap: Option<PathBuf>,
    /// What to add to the times of the motion capture, s; `auto` finds it: where pressures change, the arm moves
    #[arg(long, value_name = "S|auto", default_value = "0", value_parser = shift, allow_hyphen_values = true)]
    shift: Shift,
    /// Only this part, in seconds of the log's own clock; of a bag from its first row on
    #[arg(long, value_name = "FROM:TO", value_parser = args::window)]
    window: Option<[f64; 2]>,
}

fn shift(text: &str) -> Result<Shift, String> {
    match (text, text.parse::<f64>()) {
        ("auto", _) => Ok(Shift::Correlated),
        (_, Ok(s)) if s.is_finite() => Ok(Shift::Known(s)),
        _ => Err("is neither a number of seconds nor auto".to_owned()),
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Rotation {
    /// The axis times the angle
    Helical,
    /// Angles about the object's own axes: x, the new y, the new z
    EulerXyz,
}

impl From<Rotation> for MocapRotation {
    fn from(rotation: Rotation) -> Self {
        match rotation {
            Rotation::Helical => Self::Helical,
            Rotation::EulerXyz => Self::EULER_XYZ,
        }
    }
}

impl ImportArgs {
    /// Whether nothing of the file is chosen.
    fn takes_whole(&self) -> bool {
        self.object.is_none()
            && self.markers.is_none()
            && self.subject.is_none()
            && self.registration.is_none()
            && self.rotation.is_none()
    }
}

/// `import`.
pub fn run(a: &ImportArgs, robot: &RobotSpec) -> Result<Report> {
    if let Some(ImportCommand::Log(a)) = &a.log {
        return log(a, robot);
    }
    let (Some(file), Some(out)) = (&a.file, &a.out) else {
        anyhow::bail!("name the file, and the session's folder with --out");
    };
    a.overwrite.folder(out)?;
    if is_mcap(file) {
        anyhow::ensure!(
            a.takes_whole(),
            "--object, --markers, --subject, --registration, --robot-clock and --rotation are for files of motion capture: leave \
             them out for {}",
            file.display()
        );
        return Ok(bag_report(&import_bag(file, out)?, file, out));
    }
    let imported = import(&Options {
        file: file.clone(),
        out: out.clone(),
        object: a.object.clone(),
        markers: a.markers.clone(),
        subject: a.subject.clone(),
        registration: a.registration.clone(),
        robot_clock: a.robot_clock,
        rotation: a.rotation.map(MocapRotation::from),
    })?;
    Ok(report(&imported, out))
}

/// `import log`.
fn log(a: &LogArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.folder(&a.out)?;
    let mocap = a.mocap.clone().map(|path| (path, a.shift));
    let imported = import_log(
        &import_log::Options {
            map: a.map.clone(),
            file: a.file.clone(),
            mocap,
            window: a.window,
            out: a.out.clone(),
        },
        robot,
    )?;
    Ok(log_report(&imported, a))
}

fn bag_report(bag: &OwnBag, file: &Path, out: &Path) -> Report {
    let log = &bag.log;
    let seen = log.truth.iter().flatten().count();
    let [from_s, to_s] = [log.t_s.first(), log.t_s.last()].map(|t| t.copied().unwrap_or_default());
    let kind = match log.simulated {
        Some(true) => ", simulated",
        _ => "",
    };
    let mut text = format!(
        "{}: {} samples at {:.0} Hz from {from_s:.2} to {to_s:.2} s, {seen} with a pose of the tip{kind}",
        file.display(),
        log.len(),
        log.rate_hz
    );
    if log.cut {
        text += "\nnote: the file ends within a record: what is before it was read";
    }
    text += &format!("\nsession in {}", out.display());
    Report {
        json: json!({
            "samples": log.len(), "rate_hz": log.rate_hz, "from_s": from_s, "to_s": to_s, "poses": seen,
            "simulated": log.simulated, "begun": bag.begun, "cut": log.cut,
        }),
        text,
    }
}

fn log_report(imported: &ImportedLog, a: &LogArgs) -> Report {
    let log = &imported.log;
    let seen = log.truth.iter().flatten().count();
    let (first, last) = (log.t_s.first(), log.t_s.last());
    let [from_s, to_s] = [first, last].map(|t| t.copied().unwrap_or_default());
    let mut text = format!(
        "{}: {} samples at {:.0} Hz from {from_s:.2} to {to_s:.2} s, {seen} with a pose of the end",
        a.file.display(),
        log.len(),
        log.rate_hz
    );
    let [[base, base_flips], [end, end_flips]] = imported.left_out;
    if base + end > 0 {
        text += &format!(
            "\nposes that the cameras repeat count once: {base} of the base and {end} of the end left out"
        );
    }
    if let Some(r) = imported.correlation {
        text += &format!(
            "\nclocks: {:.2} s are added to the times of the motion capture; motion and changes of pressure then correlate by {r:.2}",
            imported.shift_s
        );
    }
    for note in &imported.notes {
        text += &format!("\nnote: {note}");
    }
    text += &format!("\nsession in {}", a.out.display());
    Report {
        json: json!({
            "samples": log.len(), "rate_hz": log.rate_hz, "from_s": from_s, "to_s": to_s, "poses": seen,
            "shift_s": imported.shift_s, "correlation": imported.correlation,
            "repeated": {"base": base, "end": end}, "flipped": {"base": base_flips, "end": end_flips},
            "notes": imported.notes,
        }),
        text,
    }
}

fn report(imported: &Imported, out: &Path) -> Report {
    let Imported {
        file,
        chosen,
        log,
        world,
    } = imported;
    let object = chosen.object();
    let gaps = file.gaps(object);
    let mut notes = file.notes.clone();
    notes.push(world.clone());
    let rotation = file.rotation.map(MocapRotation::name);
    let (first, last) = (
        file.first_frame,
        file.frames.last().copied().unwrap_or_default(),
    );
    let mut text = format!(
        "{}: {}, {} Hz, {} frames ({first} to {last}), units {}{}{}",
        file.path.display(),
        file.format.name(),
        file.rate_hz,
        file.frames.len(),
        file.units,
        rotation
            .as_ref()
            .map_or(String::new(), |r| format!("; rotations {r}")),
        file.up.map_or(String::new(), |up| format!("; up: {up}")),
    );
    let list = |names: &[&str]| match names.len() {
        0..=8 => names.join(", "),
        n => format!("{}, ... ({n} in all)", names[..6].join(", ")),
    };
    let objects: Vec<&str> = file.objects.iter().map(|o| o.name.as_str()).collect();
    let markers: Vec<&str> = file.markers.iter().map(|m| m.name.as_str()).collect();
    for (what, names) in [("objects", &objects), ("markers", &markers)] {
        if !names.is_empty() {
            text.push_str(&format!("\n{what}: {}", list(names)));
        }
    }
    text.push_str(&format!("\n{}: missing in {gaps} frames", object.name));
    let mut json = json!({
        "format": file.format.name(), "rate_hz": file.rate_hz, "objects": objects, "markers": markers,
        "object": object.name, "frames": file.frames.len(), "first_frame": first, "seconds": log.t_s.last(),
        "gaps": gaps, "units": file.units, "rotation": rotation, "up": file.up, "notes": notes,
    });
    if let Chosen::Body(body) = chosen {
        text.push_str(&body_text(body));
        json["residual_mm"] = json!(body.residual_m * 1e3);
        json["reference_frame"] = json!(body.reference_frame);
        json["marker_residuals_mm"] = body
            .markers
            .iter()
            .map(|m| (m.name.clone(), json!(m.residual_m * 1e3)))
            .collect::<serde_json::Map<String, Value>>()
            .into();
    }
    for note in &notes {
        text.push_str(&format!("\nnote: {note}"));
    }
    text.push_str(&format!("\n{} samples in {}", log.len(), out.display()));
    Report { text, json }
}

fn body_text(body: &MarkerBody) -> String {
    let worst = body
        .markers
        .iter()
        .max_by(|a, b| a.residual_m.total_cmp(&b.residual_m));
    format!(
        "\nfitted to {} markers, shape of frame {}: residual {:.3} mm (root mean square){}",
        body.markers.len(),
        body.reference_frame,
        body.residual_m * 1e3,
        worst.map_or(String::new(), |w| format!(
            ", most at {} ({:.3} mm)",
            w.name,
            w.residual_m * 1e3
        ))
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use springtwin::recording::{inspect, read_session};

    /// A folder of one test alone.
    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let dir =
                std::env::temp_dir().join(format!("springtwin-{name}-{}", std::process::id()));
            let _ = std::fs::remove_dir_all(&dir);
            std::fs::create_dir_all(&dir).expect("scratch folder");
            Self(dir)
        }

        fn args(&self, text: &str, out: &str) -> ImportArgs {
            let file = self.0.join("capture.csv");
            std::fs::write(&file, text).expect("writes");
            ImportArgs {
                log: None,
                overwrite: Overwrite::default(),
                file: Some(file),
                out: Some(self.0.join(out)),
                object: None,
                markers: None,
                subject: None,
                registration: None,
                robot_clock: false,
                rotation: None,
            }
        }

        fn names(&self) -> Vec<String> {
            let mut names: Vec<String> = std::fs::read_dir(&self.0)
                .expect("there")
                .map(|e| e.expect("entry").file_name().to_string_lossy().into_owned())
                .collect();
            names.sort();
            names
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    const TWO: &str = "Segments\n50\n,,arm:pad,,,,,,arm:base,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ,RX,RY,RZ,TX,TY,TZ\n\
        ,,deg,deg,deg,mm,mm,mm,deg,deg,deg,mm,mm,mm\n\
        11,0,0,0,90,100,200,-300,0,0,0,1,2,3\n12,0,,,,,,,0,0,0,1,2,3\n15,0,0,0,-30,100,200,-310,0,0,0,1,2,3\n";

    #[test]
    fn one_object_becomes_a_session_that_the_program_reads() {
        let s = Scratch::new("import");
        let mut a = s.args(TWO, "deep/session");
        let refused = run(&a, &RobotSpec::reference())
            .expect_err("two objects")
            .to_string();
        assert!(refused.contains("--object") && refused.contains("arm:pad, arm:base"));
        a.object = Some("pad".to_owned());
        let report = run(&a, &RobotSpec::reference()).expect("imports");
        let v = &report.json;
        assert_eq!(v["format"], "vicon-segments");
        assert_eq!(v["rate_hz"], 50.0);
        assert_eq!(v["frames"], 3);
        // One empty, two left out.
        assert_eq!(v["gaps"], 3);
        assert_eq!(v["rotation"], "helical");
        assert_eq!(v["units"], "mm, deg");
        assert_eq!(v["objects"], json!(["arm:pad", "arm:base"]));
        assert!(v.get("residual_mm").is_none());

        let log = read_session(a.out.as_ref().expect("a folder")).expect("reads");
        assert_eq!(log.t_s, [0.0, 0.02, 0.08]);
        assert_eq!(log.rate_hz, 50.0);
        assert_eq!(log.name, "session");
        assert!(log.truth[1].is_none());
        let pose = log.truth[0].expect("seen");
        assert!((pose.translation.vector.z + 0.3).abs() < 1e-9);
        assert!((pose.rotation.angle().to_degrees() - 90.0).abs() < 1e-4);
        assert!(log.chamber_pa.iter().flatten().all(|p| p.is_nan()));
        let inspected = inspect(a.out.as_ref().expect("a folder")).expect("inspects");
        let x = inspected.channels.iter().find(|c| c.name == "vicon_x_mm");
        assert_eq!(x.expect("there").rows, 2);

        let again = run(&a, &RobotSpec::reference())
            .expect_err("exists")
            .to_string();
        assert!(again.contains("exists already"), "{again}");
        a.out = Some(s.0.join("other"));
        a.object = Some("hand".to_owned());
        let none = run(&a, &RobotSpec::reference())
            .expect_err("no such object")
            .to_string();
        assert!(none.contains("'hand'") && none.contains("arm:base"));
        assert_eq!(s.names(), ["capture.csv", "deep"]);
    }

    #[test]
    fn markers_become_a_body_only_when_asked() {
        let s = Scratch::new("import-markers");
        let text = "Trajectories\n100\n,,b:p,,,b:q,,,b:r,,,c:s,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z,X,Y,Z,X,Y,Z\n\
            ,,mm,mm,mm,mm,mm,mm,mm,mm,mm,mm,mm,mm\n\
            1,0,0,0,0,100,0,0,0,100,0,7,7,7\n2,0,0,0,10,100,0,10,0,100,10,7,7,7\n3,0,0,0,10,,,,0,100,10,7,7,7\n";
        let mut a = s.args(text, "body");
        let refused = run(&a, &RobotSpec::reference())
            .expect_err("markers only")
            .to_string();
        assert!(
            refused.contains("--subject") && refused.contains("b, c"),
            "{refused}"
        );
        a.subject = Some("c".to_owned());
        let few = run(&a, &RobotSpec::reference())
            .expect_err("one marker")
            .to_string();
        assert!(few.contains("three"), "{few}");
        a.subject = Some("b".to_owned());
        let v = run(&a, &RobotSpec::reference()).expect("imports").json;
        assert!(v["residual_mm"].as_f64().expect("number") < 1e-9, "{v}");
        assert_eq!(v["gaps"], 1);
        assert_eq!(v["rotation"], Value::Null);
        let log = read_session(a.out.as_ref().expect("a folder")).expect("reads");
        let step = log.truth[1].expect("seen").translation.vector
            - log.truth[0].expect("seen").translation.vector;
        assert!((step.z - 0.01).abs() < 1e-9 && step.x.abs() < 1e-9);
        a.out = Some(s.0.join("named"));
        a.subject = None;
        a.markers = Some(["p", "q", "s"].map(str::to_owned).to_vec());
        assert_eq!(
            run(&a, &RobotSpec::reference()).expect("imports").json["object"],
            "markers p q s"
        );
    }

    #[test]
    fn a_refusal_leaves_nothing_behind() {
        let s = Scratch::new("import-refused");
        let far = TWO.replace("-310", "-31000");
        for (text, said) in [
            ("t_s,p1_kpa\n0,1\n".to_owned(), "expected a Vicon CSV"),
            (TWO.replace("-310", "x"), "line 8, column 8"),
            (far, "frame 15"),
        ] {
            let mut a = s.args(&text, "out");
            a.object = Some("arm:pad".to_owned());
            let e = format!("{:#}", run(&a, &RobotSpec::reference()).expect_err(said));
            assert!(e.contains(said), "{e}");
            assert_eq!(s.names(), ["capture.csv"]);
        }
    }
}
