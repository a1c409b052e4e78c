use super::*;

/// A second of a recording on the virtual rig, small.
fn sample() -> (RobotSpec, Loaded, Look) {
    let robot = RobotSpec::reference();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/point-to-point.rrd");
    let part = [Some(5.0), Some(6.0)];
    let loaded = loading::load_part(&robot, &file, part, &mut |_| true).expect("the sample");
    let look = Look {
        size: [640, 360],
        fps: 5,
        ..Look::default()
    };
    (robot, loaded, look)
}

fn scratch(name: &str) -> PathBuf {
    let name = format!("springtwin-video-{name}-{}", std::process::id());
    let folder = std::env::temp_dir().join(name);
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// Pixels of a part of a picture (shares of its sides) that are about of a colour.
fn count(picture: &image::RgbImage, [x0, y0, x1, y1]: [f64; 4], colour: [u8; 3]) -> usize {
    let (w, h) = (f64::from(picture.width()), f64::from(picture.height()));
    let within = |x: u32, y: u32| {
        let (x, y) = (f64::from(x) / w, f64::from(y) / h);
        (x0..x1).contains(&x) && (y0..y1).contains(&y)
    };
    let near = |p: &image::Rgb<u8>| (0..3).all(|k| p.0[k].abs_diff(colour[k]) < 14);
    { picture.enumerate_pixels() }
        .filter(|(x, y, p)| within(*x, *y) && near(p))
        .count()
}

#[test]
fn without_ffmpeg_there_are_frames_with_the_arm_its_label_and_a_cursor_that_moves() {
    let (robot, loaded, look) = sample();
    let home = scratch("frames");
    let wanted = Wanted::of(&home.join("a.mp4")).expect("a film");
    let mut steps = Vec::new();
    let mut step = |done, all| {
        steps.push((done, all));
        true
    };
    let film = make_with(None, &robot, loaded.clone(), look, &wanted, &mut step).expect("frames");
    assert_eq!(film.path, home.join("a-frames"));
    assert_eq!((film.frames, film.encoder), (6, None));
    assert!(
        film.why_frames
            .is_some_and(|why| why.contains("ffmpeg was not found"))
    );
    assert_eq!((steps[0], steps[6]), ((0, 6), (6, 6)));
    let read = |k: usize| {
        let name = film.path.join(format!("frame-{k:06}.png"));
        image::open(name).expect("a frame").into_rgb8()
    };
    let (first, last) = (read(1), read(6));
    assert_eq!(first.dimensions(), (640, 360));
    // The plate of the label, and the bellows in the middle.
    let plate = [0xff, 0xe6, 0xb8];
    assert!(count(&first, [0.0, 0.0, 0.3, 0.3], plate) > 200);
    let middle = [0.35, 0.1, 0.65, 0.7];
    let backdrop = *first.get_pixel(200, 240);
    let arm = 640 * 360 * 18 / 100 - count(&first, middle, backdrop.0);
    assert!(arm > 5000, "{arm} pixels differ from the backdrop");
    // The cursor: the darkest column of the plot.
    let cursor = |p: &image::RgbImage| {
        let light =
            |x: &u32| -> u32 { (290..342).map(|y| u32::from(p.get_pixel(*x, y).0[1])).sum() };
        (26..596).min_by_key(light).expect("columns")
    };
    let places = [cursor(&first), cursor(&last)];
    assert!(places[0] < 60 && places[1] > 540, "{places:?}");
    // Equal recordings give equal frames.
    let again = Wanted::Folder(home.join("again"));
    make_with(None, &robot, loaded, look, &again, &mut |_, _| true).expect("frames");
    let bytes = |folder: &Path| std::fs::read(folder.join("frame-000004.png")).expect("a frame");
    assert_eq!(bytes(&film.path), bytes(&home.join("again")));
    std::fs::remove_dir_all(&home).expect("removed");
}

#[test]
fn motion_capture_that_is_far_off_is_a_ghost_beside_the_arm() {
    let (robot, mut loaded, look) = sample();
    let home = scratch("ghost");
    let reddish = |loaded: Loaded, name: &str| {
        let wanted = Wanted::Folder(home.join(name));
        make(&robot, loaded, look, &wanted, &mut |_, _| true).expect("frames");
        let frame = image::open(home.join(name).join("frame-000001.png"));
        let frame = frame.expect("a frame").into_rgb8();
        let is_reddish = |p: &&image::Rgb<u8>| p.0[0] > p.0[2].saturating_add(20);
        frame.pixels().filter(is_reddish).count()
    };
    let near = reddish(loaded.clone(), "near");
    let truths = loaded.trace.snapshots.iter_mut();
    for truth in truths.filter_map(|s| s.truth.as_mut()) {
        truth.base_from_tip.translation.x += 0.12;
    }
    let far = reddish(loaded, "far");
    std::fs::remove_dir_all(&home).expect("removed");
    assert!(far > near + 1000, "{near} and {far} pixels");
}

#[test]
fn a_video_that_is_stopped_leaves_nothing() {
    let (robot, loaded, look) = sample();
    let home = scratch("stopped");
    for out in ["a.mp4", "frames"] {
        let wanted = Wanted::of(&home.join(out)).expect("a place");
        let made = make(&robot, loaded.clone(), look, &wanted, &mut |done, _| {
            done < 2
        });
        let stopped = made.err().expect("stopped").to_string();
        assert!(stopped.contains("no video was made"), "{stopped}");
        assert_eq!(std::fs::read_dir(&home).expect("is there").count(), 0);
    }
    std::fs::remove_dir_all(&home).expect("removed");
}

#[test]
fn the_ending_decides_what_is_made() {
    let of = |text: &str| Wanted::of(Path::new(text));
    let film = Wanted::File("a/b.mp4".into(), "a/b-frames".into());
    assert_eq!(of("a/b.mp4").expect("a film"), film);
    assert_eq!(of("a/b").expect("a folder"), Wanted::Folder("a/b".into()));
    let refused = of("a/b.avi").expect_err("no film").to_string();
    assert!(refused.contains(".mp4, .mov, .mkv or .webm"), "{refused}");
}

#[test]
fn signals_that_a_recording_lacks_are_refused() {
    let (robot, mut loaded, look) = sample();
    loaded
        .trace
        .snapshots
        .iter_mut()
        .for_each(|s| s.truth = None);
    let home = scratch("lacking");
    let look = Look {
        strip: Some(Signals::Error),
        ..look
    };
    let wanted = Wanted::Folder(home.join("frames"));
    let made = make(&robot, loaded, look, &wanted, &mut |_, _| true);
    let refused = made.err().expect("no error is known").to_string();
    assert!(refused.contains("choose another --strip"), "{refused}");
    std::fs::remove_dir_all(&home).expect("removed");
}
