use super::*;

#[test]
fn points_are_added_drawn_reordered_and_deleted() {
    let mut s = PlanState {
        kind: PlanKind::Points,
        ..PlanState::default()
    };
    let spec = RobotSpec::reference();
    assert!(s.plan(&spec).is_err_and(|e| e.contains("no waypoints")));
    for x in [0.0, 0.01, 0.02] {
        s.add([x, 0.0, -0.3]);
    }
    // Two millimetres further is no waypoint, eight are.
    s.draw_to([0.022, 0.0, -0.3]);
    assert_eq!(s.points_m.len(), 3);
    s.draw_to([0.028, 0.0, -0.3]);
    assert_eq!((s.points_m.len(), s.selected), (4, Some(3)));
    s.reorder(true);
    assert_eq!((s.points_m[2][0], s.selected), (0.028, Some(2)));
    s.selected = Some(0);
    s.reorder(true);
    assert_eq!(s.selected, Some(0), "nothing is before the first");
    s.delete_selected();
    assert_eq!((s.points_m.len(), s.points_m[0][0]), (3, 0.01));
    let plan = s.plan(&spec).expect("a plan");
    assert_eq!((plan.name.as_str(), plan.legs.len()), ("3 points", 3));
    s.passing = Passing::Follow;
    let plan = s.plan(&spec).expect("a plan");
    assert_eq!(plan.legs.len(), 2);
    s.delete_selected();
    assert!(s.plan(&spec).is_err_and(|e| e.contains("three waypoints")));
    for _ in 0..300 {
        s.add([0.0; 3]);
    }
    assert_eq!(s.points_m.len(), POINTS_MAX);
}

#[test]
fn a_track_is_where_the_plan_leads() {
    let mut s = PlanState::default();
    let spec = RobotSpec::reference();
    let track = Track::of(&s.plan(&spec).expect("a plan"));
    assert_eq!((track.waypoints_m.len(), track.closed), (60, true));
    // 60 chords of a circle of 50 mm.
    let length_m = 60.0 * 2.0 * 0.05 * (std::f64::consts::PI / 60.0).sin();
    assert!((track.length_m() - length_m).abs() < 1e-9);
    s.kind = PlanKind::PickPlace;
    let track = Track::of(&s.plan(&spec).expect("a plan"));
    let z: Vec<f64> = track.waypoints_m.iter().map(|p| p[2]).collect();
    assert_eq!(z.len(), 4);
    assert!((z[0] + 0.29).abs() < 1e-12 && z[1] == -0.32, "{z:?}");
    s.kind = PlanKind::Circle;
    s.speed_mm_s = 1e3;
    assert!(s.plan(&spec).is_err_and(|e| e.contains("lower speed")));
}
