//! A long recording, shown with samples that are farther apart: its full rate around a position that rests.

use super::*;
use crate::analysis::history::Channel;
use crate::recording::part_of;

/// Snapshots of the thinned recording are so many apart: half a second.
const EVERY: usize = 25;

/// 400 s from 100 s on, thinned; or a part of it. Behind 450 s nothing can be read.
pub(super) fn long(path: &Path) -> Result<Loaded, String> {
    let (file, part) = part_of(path).map_err(|e| e.to_string())?;
    let mut trace = fixture::trace("long", 400);
    let thinned = file == path;
    if part.from.is_some_and(|from| from.seconds() > 390.0) {
        return Err("The disk cannot be read.".to_owned());
    }
    let mut n = 0;
    trace.snapshots.retain(|s| {
        n += 1;
        part.contains(s.stamp.0) && (!thinned || (n - 1) % EVERY == 0)
    });
    let about = About {
        path: Some(file),
        apart_s: thinned.then_some(0.5),
        ..About::default()
    };
    Ok(Loaded { trace, about })
}

#[test]
fn a_long_recording_is_shown_at_its_full_rate_around_a_position_that_rests() {
    let asked = Arc::new(Mutex::new(Vec::<String>::new()));
    let mut app = app(Theme::Dark);
    let to = Arc::clone(&asked);
    app.services.load = Box::new(move |path| {
        to.lock()
            .expect("not poisoned")
            .push(path.display().to_string());
        Job::ready(long(path).and_then(indexed))
    });
    app.player = long(Path::new("long.rrd")).and_then(indexed).ok();
    let mut h = harness(app);
    let at = |h: &mut Harness<'_, App>, position_s: f64, playing: bool| {
        let player = h.state_mut().player.as_mut().expect("played");
        (player.position_s, player.playing) = (position_s, playing);
        h.run_steps(4);
        std::mem::take(&mut *asked.lock().expect("not poisoned"))
    };
    let none = Vec::<String>::new();
    assert_eq!(at(&mut h, 200.0, true), none, "it plays");
    h.get_by_label_contains("a sample every 0.5 s.");
    assert_eq!(at(&mut h, 200.0, false), ["long.rrd@210..360"]);
    let shown = "all samples from 1:50 to 4:20, elsewhere one every 0.5 s.";
    h.get_by_label_contains(shown);
    let signals = |h: &Harness<'_, App>, range_s: [f64; 2]| {
        let player = h.state().player.as_ref().expect("played");
        let near = player.near().and_then(|n| n.history(range_s));
        let history = near.unwrap_or(player.history());
        assert!((history.zero_s() - 100.0).abs() < 1e-9);
        let all = history.points(Channel::Spring(0), range_s[0], range_s[1]);
        all.count()
    };
    assert_eq!(signals(&h, [270.0, 300.0]), 1501);
    assert_eq!(signals(&h, [100.0, 130.0]), 61);
    // Beside it and between the samples that were there before: the newest one of all, without reading again.
    assert_eq!(at(&mut h, 219.98, false), none);
    let stamp_s = |h: &Harness<'_, App>| {
        let player = h.state().player.as_ref().expect("played");
        player.snapshot().stamp.seconds()
    };
    assert!((stamp_s(&h) - 319.98).abs() < 1e-6);
    // Elsewhere it is read again, at the beginning too.
    assert_eq!(at(&mut h, 10.26, false).len(), 1);
    h.get_by_label_contains("all samples from 0:00 to 1:10");
    assert!((stamp_s(&h) - 110.26).abs() < 1e-6);
    // What cannot be read is asked for once; the samples that are there are shown.
    assert_eq!(at(&mut h, 390.26, false), ["long.rrd@400.26..550.26"]);
    assert_eq!(at(&mut h, 390.26, false), none);
    assert!((stamp_s(&h) - 490.0).abs() < 1e-6);
    h.get_by_label_contains("a sample every 0.5 s.");
    // While plots show more than a minute nothing is read.
    h.state_mut().window.span_s = 300.0;
    assert_eq!(at(&mut h, 300.0, false), none);
}
