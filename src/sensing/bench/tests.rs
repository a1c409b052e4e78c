use super::*;
use crate::rig::circuit::{BenchPlan, Circuit, USUAL_SCATTER, bench};
use crate::robot::RobotSpec;
use proptest::prelude::*;
use rand::SeedableRng;
use rand_pcg::Pcg64;

const RANGE_M: [f64; 2] = [0.070, 0.240];

fn line(reading: impl Fn(f64) -> f64) -> Vec<BenchPoint> {
    let up = (0..35).map(|k| (k, Direction::Up));
    let down = (0..35).rev().map(|k| (k, Direction::Down));
    up.chain(down)
        .map(|(k, direction)| {
            let length_m = 0.070 + 0.005 * f64::from(k);
            BenchPoint {
                length_m,
                reading: reading(length_m),
                direction,
            }
        })
        .collect()
}

/// The log and calibration of the virtual rig's unit 1, as shipped.
fn virtual_rig() -> (BenchLog, Calibration, SpringVerdicts) {
    let spec = RobotSpec::reference();
    let mut circuit = Circuit::new(&spec, 1, USUAL_SCATTER);
    let mut rng = Pcg64::seed_from_u64(100);
    let text = bench(&mut circuit, &BenchPlan::for_robot(&spec), &mut rng);
    let log = parse_bench(&text).expect("own log");
    let (calibration, verdicts) = calibrate(
        &log,
        "virtual-rig unit 1",
        "2024-01-01",
        spec.spring.range_m,
    );
    (log, calibration, verdicts)
}

#[test]
fn shipped_calibration_is_what_the_bench_gives() {
    let (log, fresh, verdicts) = virtual_rig();
    assert_eq!(log.springs.len(), SPRINGS);
    for (spring, verdict) in &verdicts {
        let q = verdict.as_ref().expect("fits");
        assert!(q.held_out_rmse_m < 0.12e-3, "spring {spring}: {q:?}");
        assert!(q.hysteresis_m.expect("both ways") < 0.4e-3, "{q:?}");
    }
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/calibration/virtual-rig.toml"
    );
    if std::env::var_os("SPRINGTWIN_WRITE_ASSETS").is_some() {
        // With the ends of the springs, the IMUs and the tilt of the base of the same unit.
        let (spec, unit) = (RobotSpec::reference(), crate::rig::Unit(1));
        let whole = crate::lab::units::adjusted_with_cameras(&spec, unit, &fresh);
        let whole = whole.expect("calibrates");
        std::fs::write(path, whole.to_toml().expect("writes")).expect("writes");
    }
    let shipped = Calibration::virtual_rig();
    assert!(shipped.uncovered().is_empty());
    for (a, b) in shipped.springs.iter().zip(&fresh.springs) {
        for k in 0..=50 {
            let [low, high] = b.curve.domain;
            let reading = low + (high - low) * (0.01 + 0.98 * f64::from(k) / 50.0);
            let (a, b) = (a.curve.length_m(reading), b.curve.length_m(reading));
            let d = a.expect("inside") - b.expect("inside");
            assert!(d.abs() < 1e-6, "{d}");
        }
    }
}

/// The generator is not the curve: the residual of the fit itself, without noise.
#[test]
fn reciprocal_quartic_follows_the_physics_where_the_direct_one_cannot() {
    let c = Circuit::new(&RobotSpec::reference(), 1, 0.0);
    let uh = |l| inductance_h(c.frequency_hz(0, l), CAPACITANCE_F, COMPENSATION_H) * 1e6;
    let points = line(uh);
    let (curve, quality) = fit(&points, Quantity::InductanceUh, RANGE_M).expect("fits");
    assert_eq!(curve.variable, Variable::Reciprocal);
    assert!(quality.worst_m < 0.03e-3, "{quality:?}");
    let direct = quartic(&points, Quantity::InductanceUh, Variable::Reading).expect("fits");
    let worst = points
        .iter()
        .map(|p| (direct.extended_m(p.reading) - p.length_m).abs())
        .fold(0.0, f64::max);
    assert!(worst > 0.1e-3, "{worst}");
}

#[test]
fn exact_quartic_is_found_and_hysteresis_is_measured() {
    // length = 70 + 170 u + 10 u (u − 1) mm over u ∈ [0, 1]; the reading is u.
    let inverse = |length_m: f64| {
        let l = length_m * 1e3;
        let (a, b, c): (f64, f64, f64) = (10.0, 160.0, 70.0 - l);
        (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a)
    };
    let mut points = line(inverse);
    let (curve, quality) = fit(&points, Quantity::CircuitReading, RANGE_M).expect("fits");
    assert_eq!(curve.variable, Variable::Reading);
    assert!(quality.worst_m < 1e-9, "{quality:?}");
    assert!(quality.hysteresis_m.expect("both ways") < 1e-9);
    for p in &mut points {
        if p.direction == Direction::Down {
            p.reading = inverse(p.length_m + 0.2e-3);
        }
    }
    let (_, quality) = fit(&points, Quantity::CircuitReading, RANGE_M).expect("fits");
    let hysteresis_m = quality.hysteresis_m.expect("both ways");
    assert!((hysteresis_m - 0.2e-3).abs() < 0.01e-3, "{hysteresis_m}");
    points.retain(|p| p.direction == Direction::Up);
    let (_, quality) = fit(&points, Quantity::CircuitReading, RANGE_M).expect("fits");
    assert_eq!(quality.hysteresis_m, None);
}

#[test]
fn what_would_mislead_is_refused() {
    let fit = |p: &[BenchPoint]| fit(p, Quantity::CircuitReading, RANGE_M);
    let good = line(|l| 1e3 * l);
    assert!(fit(&good).is_ok());
    assert!(matches!(fit(&[]), Err(FitError::TooFew { lengths: 0 })));
    assert!(matches!(
        fit(&good[..5]),
        Err(FitError::TooFew { lengths: 5 })
    ));
    let short: Vec<_> = good.iter().copied().filter(|p| p.length_m < 0.23).collect();
    let e = fit(&short).expect_err("short");
    assert!(e.to_string().contains("extrapolated"), "{e}");
    let flat = line(|_| 3.0);
    assert_eq!(fit(&flat).expect_err("flat"), FitError::Degenerate);
    // Noise of 2 mm.
    let noisy = line(|l| 1e3 * l + 2.0 * (l * 1e5).sin());
    assert!(matches!(fit(&noisy), Err(FitError::Inaccurate { .. })));
    // u³ − u/100 turns back by a hair about its middle: accurate, but not monotone.
    let turning: Vec<_> = (0..=40)
        .map(|k| {
            let u = f64::from(k) / 20.0 - 1.0;
            BenchPoint {
                length_m: 0.155 + 0.085 * (u.powi(3) - 0.01 * u) / 0.99,
                reading: u,
                direction: Direction::Up,
            }
        })
        .collect();
    assert!(matches!(fit(&turning), Err(FitError::NotMonotone { .. })));
}

#[test]
fn log_is_read_in_its_forms_and_errors_have_a_place() {
    let log = parse_bench(
            "\u{feff}# motor\r\nSpring, length_mm, Reading, note\r\n2,70,122.3,a\r\n2,80,130,\r\n\r\n2,75,126,\r\n1,70,122,\r\n",
        )
        .expect("reads");
    assert_eq!(log.quantity, Quantity::CircuitReading);
    assert_eq!(log.springs[0].0, 1);
    let ways: Vec<_> = log.springs[1].1.iter().map(|p| p.direction).collect();
    assert_eq!(ways, [Direction::Up, Direction::Up, Direction::Down]);
    let mhz = parse_bench("spring,length_mm,frequency_mhz\n1,70,1.34513\n").expect("reads");
    assert!((mhz.springs[0].1[0].reading - 4.0).abs() < 1e-3);

    let at = |text: &str| {
        let e = parse_bench(text).expect_err(text);
        (e.line, e.column)
    };
    assert_eq!(at(""), (1, 1));
    assert_eq!(at("spring,length,reading\n"), (1, 3));
    assert_eq!(at("spring,length_mm,reading\n1,70,1\n13,70,1\n"), (3, 1));
    assert_eq!(at("spring,length_mm,reading\n1,x,1\n"), (2, 2));
    // Metres, centimetres and inches.
    for length in ["0.07", "24", "9.4"] {
        let text = format!("spring,length_mm,reading\n1,{length},1\n");
        assert_eq!(at(&text), (2, 2));
    }
    assert_eq!(at("spring,length_mm,reading\n1,70,inf\n"), (2, 3));
    assert_eq!(at("spring,length_mm,reading\n1,70\n"), (2, 3));
    assert_eq!(at("spring,length_mm,frequency_hz\n1,70,-3\n"), (2, 3));
    assert_eq!(
        at("spring,length_mm,reading,direction\n1,70,1,left\n"),
        (2, 4)
    );
}

/// A coil as an LCR meter reads it, H.
fn coil_h(length_m: f64) -> f64 {
    0.25e-6 / length_m + 2.0e-6
}

/// Resonance of the coil on a channel with these parts, Hz.
fn channel_hz(length_m: f64, channel: &Channel) -> f64 {
    let total_h = coil_h(length_m) + channel.compensation_h;
    1.0 / (std::f64::consts::TAU * (total_h * channel.capacitance_f).sqrt())
}

/// A log of spring 1 with these further columns.
fn inductances(columns: &str, cells: &str) -> String {
    let rows = line(|l| coil_h(l) * 1e6);
    let rows = rows
        .iter()
        .map(|p| format!("1,{},{}{cells}\n", p.length_m * 1e3, p.reading));
    format!("spring,length_mm,inductance_uh{columns}\n") + &rows.collect::<String>()
}

/// How far the lengths that this calibration reads from a channel are off, m.
fn off_m(calibration: &Calibration, channel: &Channel) -> f64 {
    let spring = calibration.spring(0).expect("spring 1 is calibrated");
    let off = (8..=23).map(|k| {
        let length_m = 0.01 * f64::from(k);
        let reading = spring
            .reading(channel_hz(length_m, channel))
            .expect("over inductance");
        (spring.curve.extended_m(reading) - length_m).abs()
    });
    off.fold(0.0, f64::max)
}

#[test]
fn a_log_of_inductances_needs_the_parts_of_the_channel_and_keeps_them() {
    let built = Channel {
        capacitance_f: 1010.0e-12,
        compensation_h: 10.05e-6,
    };
    for (columns, missing) in [
        ("", "capacitance_pf and compensation_uh"),
        (",capacitance_pf", "the missing compensation_uh with"),
        (",compensation_uh", "the missing capacitance_pf with"),
    ] {
        let e = parse_bench(&inductances(columns, ",1")).expect_err(missing);
        assert_eq!((e.line, e.column), (1, 3));
        assert!(
            e.what.contains(missing) && e.what.contains("log frequency_hz"),
            "{e}"
        );
    }
    let log = parse_bench(&inductances(
        ",capacitance_pf,compensation_uh",
        ",1010,10.05",
    ))
    .expect("it has the channel's parts");
    let (calibration, verdicts) = calibrate(&log, "lcr", "2026-03-01", RANGE_M);
    assert!(verdicts[0].1.is_ok(), "{verdicts:?}");
    let read = Calibration::from_toml(&calibration.to_toml().expect("writes")).expect("reads");
    assert!(off_m(&read, &built) < 0.1e-3, "{}", off_m(&read, &built));
    // What the nominal parts would have made of it.
    let mut nominal = calibration;
    nominal.springs[0].capacitance_f = CAPACITANCE_F;
    nominal.springs[0].compensation_h = COMPENSATION_H;
    assert!(
        off_m(&nominal, &built) > 5e-3,
        "{}",
        off_m(&nominal, &built)
    );
}

#[test]
fn the_parts_of_a_channel_are_numbers_of_their_unit_and_the_same_in_every_row() {
    let head = "spring,length_mm,inductance_uh,capacitance_pf,compensation_uh\n";
    let at = |rows: &str| {
        let e = parse_bench(&format!("{head}{rows}")).expect_err(rows);
        (e.line, e.column)
    };
    assert_eq!(at("1,70,4,1e-9,10\n"), (2, 4));
    assert_eq!(at("1,70,4,1000,1e-5\n"), (2, 5));
    assert_eq!(at("1,70,4,1000\n"), (2, 5));
    assert_eq!(at("1,70,4,x,10\n"), (2, 4));
    assert_eq!(
        at("1,70,4,1000,10\n2,70,4,990,10\n1,75,4,1001,10\n"),
        (4, 4)
    );
    let text = format!("{head}2,70,4,990,10.1\n");
    let log = parse_bench(&text).expect("reads");
    assert!((log.channels[1].capacitance_f - 990e-12).abs() < 1e-18);
    assert!((log.channels[1].compensation_h - 10.1e-6).abs() < 1e-15);
    assert_eq!(log.channels[0], Channel::NOMINAL);
    // A frequency is one of the channel itself: its parts are of no account.
    let text = "spring,length_mm,frequency_hz,capacitance_pf\n1,70,1.34e6,990\n";
    let log = parse_bench(text).expect("reads");
    assert_eq!(log.channels, [Channel::NOMINAL; SPRINGS]);
}

proptest! {
    #[test]
    fn parser_and_fitter_never_panic(
        rows in prop::collection::vec("[0-9a-z,.+\\-\" eE]{0,24}", 0..40),
        numbers in prop::collection::vec((1.0f64..400.0, -1e3f64..1e3), 0..60),
    ) {
        let text = format!("spring,length_mm,reading,direction\n{}", rows.join("\n"));
        let _ = parse_bench(&text);
        let points: Vec<_> = numbers
            .iter()
            .map(|(l, reading)| BenchPoint {
                length_m: l * 1e-3,
                reading: *reading,
                direction: Direction::Up,
            })
            .collect();
        let _ = fit(&points, Quantity::InductanceUh, RANGE_M);
    }
}
