//! The messages of a bag of another lab in the rows of a session.

use std::collections::BTreeSet;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::series::{Collected, Series, Wanted};
use super::tables::{Imus, Several, Single, Source, Tables};
use crate::recording::map_units::{ANGLES, LENGTHS, MASSES, PRESSURES, Units, size};
use crate::recording::{MappedBodies, MappedLog};
use crate::signal::{CHAMBERS, IMUS, Pose, SPRINGS, SensorVec, ypr_from_rotation};

/// How far a message may be from its row, s, where the map does not state it.
const NEAR_S: f64 = 0.03;

/// Puts what was read into rows.
pub(super) struct Rows<'a> {
    pub(super) tables: &'a Tables,
    /// What was read, in the order in which [`Rows::log`] takes it: pressures, commands, springs, IMUs, payload, bodies.
    pub(super) wanted: &'a [Wanted],
    pub(super) read: &'a Collected,
    /// Times of the rows, rising, ns.
    pub(super) stamps_ns: &'a [i64],
    /// The time that becomes 0, ns.
    pub(super) origin: i64,
    /// The next of what was wanted; 0 at first.
    pub(super) next: usize,
}

impl Rows<'_> {
    /// The columns.
    ///
    /// # Errors
    /// A sentence for units that are none, and for a topic of which no row has a message.
    pub(super) fn log(&mut self) -> Result<MappedLog, String> {
        let t = self.tables;
        let gauge_pa = self.several::<CHAMBERS>(&t.pressure, &PRESSURES)?;
        let command = t.command.as_ref();
        let commanded_pa = command
            .map(|c| self.several::<CHAMBERS>(c, &PRESSURES))
            .transpose()?;
        let springs = t.springs.as_ref();
        let springs = springs
            .map(|s| self.several::<SPRINGS>(s, &LENGTHS))
            .transpose()?;
        let imus = t.imus.as_ref().map(|i| self.imus(i)).transpose()?;
        let payload = t.payload.as_ref();
        let payload_kg = payload.map(|p| self.single(p)).transpose()?;
        let sensors = (0..self.stamps_ns.len()).map(|k| SensorVec {
            spring_m: springs.as_ref().map_or([f64::NAN; SPRINGS], |s| s[k]),
            imu_ypr_rad: imus.as_ref().map_or([[f64::NAN; 3]; IMUS], |i| i[k]),
        });
        let sensors = sensors.collect();
        let t_s = self.stamps_ns.iter().map(|ns| self.seconds(*ns)).collect();
        Ok(MappedLog {
            t_s,
            gauge_pa,
            commanded_pa,
            sensors,
            payload_kg,
            bodies: self.bodies(),
            ..MappedLog::default()
        })
    }

    /// From the first row on.
    fn seconds(&self, ns: i64) -> f64 {
        ns.saturating_sub(self.origin) as f64 * 1e-9
    }

    /// The next series, and which of its messages each row has.
    fn next(&mut self, hold: bool) -> Result<(&Series, Vec<Option<usize>>), String> {
        let (wanted, series) = (&self.wanted[self.next], &self.read.series[self.next]);
        self.next += 1;
        let near_ns = (self.tables.near_s.unwrap_or(NEAR_S) * 1e9) as i64;
        let found = match hold {
            true => held(self.stamps_ns, &series.stamps_ns),
            false => nearest(self.stamps_ns, &series.stamps_ns, near_ns),
        };
        if series.len() > 0 && found.iter().all(Option::is_none) {
            let ends = |ns: &[i64]| {
                let end = |ns: Option<&i64>| ns.map_or(f64::NAN, |ns| *ns as f64 * 1e-9);
                format!("from {:.3} to {:.3} s", end(ns.first()), end(ns.last()))
            };
            return Err(format!(
                "no message of {} belongs to a row: its clock runs {}, and that of {} {}",
                wanted.topic,
                ends(&series.stamps_ns),
                self.tables.rows,
                ends(self.stamps_ns)
            ));
        }
        Ok((series, found))
    }

    fn several<const N: usize>(
        &mut self,
        of: &Several,
        units: &Units,
    ) -> Result<Vec<[f64; N]>, String> {
        let size = size(&of.unit, units)?;
        let mut out = vec![[f64::NAN; N]; self.stamps_ns.len()];
        for (i, source) in of.fields.iter().enumerate().take(N) {
            if matches!(source, Source::None(_)) {
                continue;
            }
            let zero = of.zero.as_ref().map_or(0.0, |zero| zero[i]);
            let (series, found) = self.next(of.hold)?;
            for (row, k) in out.iter_mut().zip(found) {
                if let Some(k) = k {
                    row[i] = (series.at(k)[0] - zero) * size;
                }
            }
        }
        Ok(out)
    }

    fn single(&mut self, of: &Single) -> Result<Vec<f64>, String> {
        let several = Several {
            fields: vec![of.field.clone()],
            unit: of.unit.clone(),
            zero: None,
            hold: of.hold,
        };
        let rows = self.several::<1>(&several, &MASSES)?;
        Ok(rows.into_iter().map(|[kg]| kg).collect())
    }

    fn imus(&mut self, of: &Imus) -> Result<Vec<[[f64; 3]; IMUS]>, String> {
        let mut out = vec![[[f64::NAN; 3]; IMUS]; self.stamps_ns.len()];
        if let Some(fields) = &of.fields {
            let several = Several {
                fields: fields.clone(),
                unit: of.unit.clone().unwrap_or_default(),
                zero: None,
                hold: false,
            };
            for (row, angles) in out
                .iter_mut()
                .zip(self.several::<{ 3 * IMUS }>(&several, &ANGLES)?)
            {
                row.as_flattened_mut().copy_from_slice(&angles);
            }
        }
        for (i, source) in of.orientations.iter().flatten().enumerate() {
            if matches!(source, Source::None(_)) {
                continue;
            }
            let (series, found) = self.next(false)?;
            for (row, k) in out.iter_mut().zip(found) {
                if let Some(k) = k {
                    row[i] = ypr_from_rotation(&turn(series.at(k)));
                }
            }
        }
        Ok(out)
    }

    /// The bodies at the times of all of them.
    fn bodies(&mut self) -> MappedBodies {
        let names = &self.tables.bodies;
        let tracked = [&names.base, &names.middle, &names.end].map(Option::is_some);
        let series = tracked.map(|is_tracked| {
            let series = is_tracked.then(|| &self.read.series[self.next]);
            self.next += usize::from(is_tracked);
            series
        });
        let all: BTreeSet<i64> = series
            .iter()
            .flatten()
            .flat_map(|s| s.stamps_ns.iter().copied())
            .collect();
        let poses = series.map(|series| {
            let at = |ns: &i64| {
                let series = series?;
                let k = series.stamps_ns.binary_search(ns).ok()?;
                Some(pose(series.at(k)))
            };
            all.iter().map(at).collect()
        });
        MappedBodies {
            t_s: all.iter().map(|ns| self.seconds(*ns)).collect(),
            poses,
            tracked,
        }
    }
}

/// The rotation of x, y, z, w, whose length was checked.
pub(super) fn turn(q: &[f64]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]))
}

/// The pose of a position and x, y, z, w.
pub(super) fn pose(of: &[f64]) -> Pose {
    Pose::from_parts(Vector3::new(of[0], of[1], of[2]).into(), turn(&of[3..]))
}

/// The message of each row: one belongs to the row that is nearest to it, if that is near, and of several the nearest counts.
pub(super) fn nearest(rows_ns: &[i64], stamps_ns: &[i64], near_ns: i64) -> Vec<Option<usize>> {
    let mut out: Vec<Option<usize>> = vec![None; rows_ns.len()];
    let off = |row: usize, k: usize| rows_ns[row].abs_diff(stamps_ns[k]);
    for (k, stamp) in stamps_ns.iter().enumerate() {
        let next = rows_ns.partition_point(|t| t < stamp);
        let near = [next.checked_sub(1), Some(next)].into_iter().flatten();
        let near = near.filter(|row| *row < rows_ns.len());
        let Some(row) = near.min_by_key(|row| off(*row, k)) else {
            continue;
        };
        let is_nearer = out[row].is_none_or(|other| off(row, k) < off(row, other));
        if off(row, k) <= near_ns.unsigned_abs() && is_nearer {
            out[row] = Some(k);
        }
    }
    out
}

/// The message of each row: the last one until then.
pub(super) fn held(rows_ns: &[i64], stamps_ns: &[i64]) -> Vec<Option<usize>> {
    let last = |row: &i64| stamps_ns.partition_point(|t| t <= row).checked_sub(1);
    rows_ns.iter().map(last).collect()
}
