//! How often the window is painted: fluently while something moves, seldom while nothing does.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use egui_wgpu::wgpu;

use crate::signal::{Mode, Snapshot};

/// Pictures per second while something moves.
pub const LIVELY_HZ: u32 = 50;
/// The same on a software adapter: a picture costs it most of a core, which is left to the control loop.
pub const SOFTWARE_HZ: u32 = 10;
/// Pictures per second while nothing moves.
pub const IDLE_HZ: u32 = 2;
/// Pictures per second of a window that nobody sees; its plots go on.
pub const HIDDEN_HZ: u32 = 1;
/// The tip moves when it is further than this from where it rested, m: more than the estimate's noise.
const STILL_M: f64 = 1e-3;
/// How long after the last movement the window stays fluent, s.
const LINGER_S: f64 = 1.0;

/// Rate of pictures that [`Pace`] allows, shared with whoever requests them.
#[derive(Clone, Debug)]
pub struct Wanted(Arc<AtomicU32>);

impl Wanted {
    /// The most pictures per second that are of use.
    pub fn at_most_hz(&self) -> u32 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Watches whether anything moves.
#[derive(Debug)]
pub struct Pace {
    wanted: Arc<AtomicU32>,
    lively_hz: u32,
    rested_m: Option<[f64; 3]>,
    moved_s: Option<f64>,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            wanted: Arc::new(AtomicU32::new(SOFTWARE_HZ)),
            lively_hz: SOFTWARE_HZ,
            rested_m: None,
            moved_s: None,
        }
    }
}

impl Pace {
    /// Heeds what the window is drawn with from now on.
    pub fn drawn_by(&mut self, render_state: Option<&egui_wgpu::RenderState>) {
        let software = render_state
            .is_none_or(|rs| rs.adapter.get_info().device_type == wgpu::DeviceType::Cpu);
        self.lively_hz = if software { SOFTWARE_HZ } else { LIVELY_HZ };
    }

    /// For whoever asks for pictures.
    pub fn wanted(&self) -> Wanted {
        Wanted(Arc::clone(&self.wanted))
    }

    /// How long the window waits for the twin's next picture before it looks by itself.
    pub fn patience(&self) -> Duration {
        let hz = f64::from(self.wanted.load(Ordering::Relaxed));
        Duration::from_secs_f64((1.4 / hz).max(0.5))
    }

    /// Takes what is known at `now_s` of the window's time.
    pub fn update(&mut self, snapshot: &Snapshot, now_s: f64, hidden: bool) {
        let tip_m: Option<[f64; 3]> = snapshot
            .estimate
            .as_ref()
            .map(|e| e.base_from_tip.translation.vector.into());
        let far = |a: [f64; 3], b: [f64; 3]| (0..3).any(|i| (a[i] - b[i]).abs() > STILL_M);
        let moved = match (tip_m, self.rested_m) {
            (Some(now), Some(rested)) => far(now, rested),
            (now, rested) => now.is_some() != rested.is_some(),
        };
        if moved || snapshot.mode == Mode::Moving {
            self.rested_m = tip_m;
            self.moved_s = Some(now_s);
        }
        let lively = self.moved_s.is_some_and(|t| now_s - t < LINGER_S);
        let hz = match (hidden, lively) {
            (true, _) => HIDDEN_HZ,
            (false, true) => self.lively_hz,
            (false, false) => IDLE_HZ,
        };
        self.wanted.store(hz, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;

    fn at_rest(x_m: f64) -> Snapshot {
        let mut s = fixture::snapshot(1.0);
        s.mode = Mode::Hold;
        if let Some(e) = &mut s.estimate {
            e.base_from_tip.translation.x = x_m;
        }
        s
    }

    #[test]
    fn what_moves_is_painted_fluently_what_rests_seldom() {
        let mut pace = Pace::default();
        let wanted = pace.wanted();
        pace.update(&fixture::snapshot(1.0), 0.0, false);
        assert_eq!(wanted.at_most_hz(), SOFTWARE_HZ, "it moves");
        pace.update(&at_rest(0.1), 0.1, false);
        pace.update(&at_rest(0.1003), 1.05, false);
        assert_eq!(wanted.at_most_hz(), SOFTWARE_HZ, "it has just come to rest");
        pace.update(&at_rest(0.0998), 1.2, false);
        assert_eq!(wanted.at_most_hz(), IDLE_HZ, "noise is no movement");
        // Bent by hand, a little at a time.
        for i in 0..8 {
            pace.update(
                &at_rest(0.1 + 4e-4 * f64::from(i)),
                1.3 + 0.2 * f64::from(i),
                false,
            );
        }
        assert_eq!(wanted.at_most_hz(), SOFTWARE_HZ);
        pace.update(&at_rest(0.1028), 2.8, true);
        assert_eq!(wanted.at_most_hz(), HIDDEN_HZ, "nobody looks");
        pace.update(&at_rest(0.1028), 4.0, false);
        assert_eq!(wanted.at_most_hz(), IDLE_HZ);
        // The link is lost: that is to be seen at once.
        let mut lost = at_rest(0.1028);
        lost.estimate = None;
        pace.update(&lost, 4.2, false);
        assert_eq!(wanted.at_most_hz(), SOFTWARE_HZ);
    }
}
