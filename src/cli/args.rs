//! Parsers for command-line values. A refusal says what was given and what is wanted.

use springtwin::robot::RobotSpec;
use springtwin::signal::CHAMBERS;

fn numbers<const N: usize>(text: &str, what: &str) -> Result<[f64; N], String> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    if parts.len() != N {
        return Err(format!(
            "{what} needs {N} numbers separated by commas, but got {}",
            parts.len()
        ));
    }
    let mut out = [0.0; N];
    for (slot, part) in out.iter_mut().zip(parts) {
        let value: f64 = part
            .parse()
            .map_err(|_| format!("{what}: '{part}' is not a number"))?;
        if !value.is_finite() {
            return Err(format!("{what}: '{part}' is not a finite number"));
        }
        *slot = value;
    }
    Ok(out)
}

/// `X,Y,Z` in mm, to m.
pub fn xyz_mm(text: &str) -> Result<[f64; 3], String> {
    numbers::<3>(text, "a position (x,y,z in mm)").map(|v| v.map(|x| x * 1e-3))
}

/// `X,Y,Z` in N.
pub fn xyz_n(text: &str) -> Result<[f64; 3], String> {
    numbers::<3>(text, "a force (x,y,z in N)")
}

/// Six pressures in kPa, to Pa.
pub fn six_kpa(text: &str) -> Result<[f64; CHAMBERS], String> {
    numbers::<CHAMBERS>(text, "pressures (six values in kPa)").map(|v| v.map(|x| x * 1e3))
}

/// A number that is finite and not negative.
pub fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v >= 0.0 => Ok(v),
        Ok(v) => Err(format!("{v} must be a finite number, 0 or more")),
        Err(_) => Err(format!("'{text}' is not a number")),
    }
}

/// A number greater than 0, at most 8.
#[cfg(feature = "gui")]
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v > 0.0 && v <= 8.0 => Ok(v),
        _ => Err(format!(
            "'{text}' must be a number greater than 0 and at most 8"
        )),
    }
}

/// `WxH`, both from 64 to 8192.
#[cfg(feature = "gui")]
pub fn size(text: &str) -> Result<[u32; 2], String> {
    let parse = |s: &str| s.parse().ok().filter(|v| (64..=8192).contains(v));
    text.split_once('x')
        .and_then(|(w, h)| Some([parse(w)?, parse(h)?]))
        .ok_or_else(|| {
            format!("'{text}' is not a size: write WxH, for example 1280x720 (64 to 8192)")
        })
}

/// `i/n`, 1-based.
pub fn shard(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("'{text}' is not a shard: write i/n with 1 <= i <= n, for example 3/16");
    let (i, n) = text.split_once('/').ok_or_else(wrong)?;
    let (i, n): (usize, usize) = (
        i.parse().map_err(|_| wrong())?,
        n.parse().map_err(|_| wrong())?,
    );
    if i == 0 || i > n {
        Err(wrong())
    } else {
        Ok((i, n))
    }
}

/// Refuses a payload that the arm cannot carry.
pub fn payload_in_range(robot: &RobotSpec, payload_kg: f64) -> anyhow::Result<()> {
    anyhow::ensure!(
        payload_kg <= robot.payload_max_kg,
        "a payload of {payload_kg} kg is more than robot '{}' carries ({} kg): take off mass or change the robot file",
        robot.name,
        robot.payload_max_kg
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_say_what_is_wrong() {
        assert_eq!(xyz_mm("60, 40,-300").map(|v| v[2]), Ok(-0.3));
        assert!(
            xyz_mm("nan,0,0")
                .unwrap_err()
                .contains("'nan' is not a finite number")
        );
        assert!(xyz_mm("1,2").unwrap_err().contains("3 numbers"));
        assert!(
            six_kpa("1,2,3,4,5,x")
                .unwrap_err()
                .contains("'x' is not a number")
        );
        assert!(shard("0/4").is_err() && shard("5/4").is_err() && shard("2/4") == Ok((2, 4)));
        assert!(not_negative("-1").is_err() && not_negative("inf").is_err());
    }
}
