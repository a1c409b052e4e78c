//! What an effect of the sensors means for their readings, in one plain sentence.

use crate::signal::{SPRINGS, spring_name};

/// A percentage or a length below this is not worth a word, % or mm.
const LEAST: f64 = 0.05;

/// Spring `n` (1-based) as it is named on screen; `None`: every spring.
fn spring(n: Option<usize>) -> String {
    match n {
        Some(n) if (1..=SPRINGS).contains(&n) => format!("Spring {n} ({})", spring_name(n - 1)),
        Some(n) => format!("Spring {n}"),
        None => "Every spring".to_owned(),
    }
}

/// The other spring of an X pair (1-based).
fn partner(n: usize) -> usize {
    if n.is_multiple_of(2) { n - 1 } else { n + 1 }
}

/// What an effect with this id means for the readings of its channel (1-based; `None`: all of them), one sentence as
/// `Spring 7 (4A) reads 0.7 % short and 0.6 mm low.` `value` has its parameters, SI. `None` for effects that are not of the
/// sensors, and where parameters are missing.
pub fn plain(
    id: &str,
    target: Option<usize>,
    value: &dyn Fn(&str) -> Option<f64>,
) -> Option<String> {
    let imu = || target.map_or("Every IMU".to_owned(), |n| format!("IMU {n}"));
    match id {
        "spring-calibration" => {
            let percent = 100.0 * (value("gain")? - 1.0);
            let offset_mm = 1e3 * value("offset")?;
            let mut parts = Vec::new();
            if percent.abs() >= LEAST {
                let way = if percent < 0.0 { "short" } else { "long" };
                parts.push(format!("{:.1} % {way}", percent.abs()));
            }
            if offset_mm.abs() >= LEAST {
                let way = if offset_mm < 0.0 { "low" } else { "high" };
                parts.push(format!("{:.1} mm {way}", offset_mm.abs()));
            }
            let what = parts.join(" and ");
            (!parts.is_empty()).then(|| format!("{} reads {what}.", spring(target)))
        }
        "spring-lag" => {
            let ms = 1e3 * value("time")?;
            Some(format!("{} reads {ms:.0} ms late.", spring(target)))
        }
        "spring-crosstalk" => {
            let percent = 100.0 * value("share")?;
            let other = match target {
                Some(n) if (1..=SPRINGS).contains(&n) => {
                    format!("spring {} ({})", partner(n), spring_name(partner(n) - 1))
                }
                _ => "the other spring of its pair".to_owned(),
            };
            Some(format!(
                "{} also reads {percent:.1} % of what {other} changes by.",
                spring(target)
            ))
        }
        "spring-drift" => {
            let mm = 6e4 * value("rate")?;
            Some(format!("{} drifts by {mm:.2} mm/min.", spring(target)))
        }
        "spring-stuck" => {
            let from_s = value("from")?;
            Some(format!(
                "{} repeats its reading from {from_s:.1} s on.",
                spring(target)
            ))
        }
        "imu-drift" => {
            let deg = 60.0 * value("rate")?.to_degrees();
            Some(format!("{} turns its heading by {deg:.2} deg/min.", imu()))
        }
        "imu-misalignment" => {
            let [x, y, z] = [value("x")?, value("y")?, value("z")?];
            let deg = (x * x + y * y + z * z).sqrt().to_degrees();
            Some(format!("{} sits turned by {deg:.1} deg on its pad.", imu()))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::effects::{EFFECTS, Side, Target};

    #[test]
    fn a_spring_reads_short_and_low() {
        let of = |gain: f64, offset_m: f64| {
            let value = move |name: &str| match name {
                "gain" => Some(gain),
                "offset" => Some(offset_m),
                _ => None,
            };
            plain("spring-calibration", Some(7), &value)
        };
        let both = of(0.993, -0.6e-3);
        assert_eq!(
            both.as_deref(),
            Some("Spring 7 (4A) reads 0.7 % short and 0.6 mm low.")
        );
        let longer = of(1.02, 0.0);
        assert_eq!(longer.as_deref(), Some("Spring 7 (4A) reads 2.0 % long."));
        assert_eq!(of(1.0, 0.0), None);
    }

    #[test]
    fn every_effect_of_a_spring_or_an_imu_has_its_sentence_and_no_other_has() {
        for e in EFFECTS {
            let value = |name: &str| {
                let known = e.parameters.iter().find(|p| p.name == name);
                known.map(|p| {
                    if p.nominal == 0.0 {
                        0.01
                    } else {
                        1.1 * p.nominal
                    }
                })
            };
            let sensor =
                e.side == Side::Sensing && matches!(e.target, Target::Spring | Target::Imu);
            let text = plain(e.id, Some(2), &value);
            assert_eq!(text.is_some(), sensor, "{}: {text:?}", e.id);
        }
    }
}
