use super::*;
use crate::signal::ypr_from_rotation;

/// Position (mm) and yaw, pitch, roll (deg).
fn tip(model: &MeshModel, state: &MeshState) -> ([f64; 3], [f64; 3]) {
    let p = observe_mesh(model, state).base_from_tip;
    (
        (p.translation.vector * 1e3).into(),
        ypr_from_rotation(&p.rotation).map(f64::to_degrees),
    )
}

#[test]
#[ignore = "measurement"]
fn poses_and_times() {
    let robot = RobotSpec::reference();
    #[expect(clippy::disallowed_methods, reason = "a measurement")]
    let now = std::time::Instant::now;
    let start = now();
    let model = MeshModel::new(&robot).expect("meshes");
    println!(
        "{} tetrahedra, walls {:.4}, built in {:?}",
        model.tetrahedra(),
        model.wall_ratio,
        start.elapsed()
    );
    let rod = Model::nominal(&robot);
    for kpa in [
        [0.0; 6],
        [40.0; 6],
        [-40.0; 6],
        [40.0, -40.0, -40.0, 0.0, 0.0, 0.0],
        [20.0, -20.0, -20.0, 20.0, -20.0, -20.0],
        [40.0, -40.0, -40.0, -40.0, 40.0, 40.0],
        [40.0, 40.0, -40.0, 40.0, 40.0, -40.0],
    ] {
        let inputs = Inputs {
            chamber_pa: kpa.map(|p| p * 1e3),
            ..Inputs::default()
        };
        let mut state = MeshState::rest(&model);
        let start = now();
        let outcome = settle_mesh(&model, &mut state, &inputs);
        let took = start.elapsed();
        let mut exact = state.clone();
        let fine = settle_to(&model, &mut exact, &inputs, 1e-6);
        let mut rod_state = State::rest(&rod);
        settle(&rod, &mut rod_state, &inputs).expect("settles");
        let r = observe_rod(&rod, &rod_state).base_from_tip;
        let o = observe_mesh(&model, &state).base_from_tip;
        let x = observe_mesh(&model, &exact).base_from_tip;
        println!(
            "{kpa:?}: {:.2?} {:.2?}\n  rod {:.2?} {:.2?}\n  apart {:.2} mm {:.2} deg; unfinished {:.4} mm; {outcome:?} {took:?}; {fine:?}",
            tip(&model, &state).0,
            tip(&model, &state).1,
            (r.translation.vector * 1e3).as_slice(),
            ypr_from_rotation(&r.rotation).map(f64::to_degrees),
            (r.translation.vector - o.translation.vector).norm() * 1e3,
            r.rotation.angle_to(&o.rotation).to_degrees(),
            (x.translation.vector - o.translation.vector).norm() * 1e3,
        );
    }
}
