use super::*;

#[test]
fn the_shipped_tasks_fit_the_reference_robot() {
    let maps = model::maps(None).expect("built in");
    let robot = RobotSpec::reference();
    let paths = [Shape::Circle, Shape::Eight].map(|s| {
        let path = s.path(PATH_CENTRE_M, PATH_SIZE_M, PATH_WAYPOINTS);
        let follow = Follow {
            path,
            speed_m_s: 3e-3,
            laps: 1,
        };
        Plan::follow(follow).expect("has waypoints")
    });
    let fruit = Plan::pick_and_place(&fruit(), BASKET_M, LIFT_M);
    for plan in paths.into_iter().chain([fruit]) {
        for payload_kg in [0.0, 0.5] {
            for stop in plan.stops(payload_kg) {
                let config = ReachConfig::default();
                let (pose, plant) = (maps.pose.as_ref(), maps.plant.as_ref());
                let found = reach(
                    &stop.goal,
                    &robot,
                    pose,
                    plant,
                    stop.payload_kg,
                    &maps.seeds,
                    &config,
                )
                .expect("finite");
                assert_eq!(
                    found.state,
                    ReachState::Reachable,
                    "{} {}: {found:?}",
                    plan.name,
                    stop.name
                );
            }
        }
    }
}
