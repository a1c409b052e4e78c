//! The rod model beside the virtual rig's multibody arm.

use anyhow::Result;
use serde_json::json;

use super::Report;
use crate::rig::multibody;
use crate::robot::RobotSpec;
use crate::sim::dataset::{self, Draw};
use crate::sim::{Inputs, Model, State, observe, settle};

/// Poses at which the rod is set beside the rig's multibody arm.
pub const POSES: usize = 50;
/// Seed of their pressures.
const POSES_SEED: u64 = 1;

/// Distance of the rod model from an arm of rigid rings with the same drawing: model inadequacy, reported and not
/// judged. Pressures are drawn uniformly, the payload from 0 to the heaviest.
///
/// # Errors
/// When one of the two arms does not settle.
pub fn beside_multibody(robot: &RobotSpec, poses: usize) -> Result<Report> {
    let model = Model::nominal(robot);
    let (mut mm, mut deg) = (Vec::new(), Vec::new());
    for i in 0..poses {
        let mut rng = dataset::sample_rng(POSES_SEED, i);
        let inputs = Inputs {
            chamber_pa: dataset::pressures(Draw::Uniform(poses), robot, i, &mut rng),
            payload_kg: robot.payload_max_kg * i as f64 / poses as f64,
            ..Inputs::default()
        };
        let mut state = State::rest(&model);
        settle(&model, &mut state, &inputs)?;
        let rod = observe(&model, &state).base_from_tip;
        let rings = multibody::settled_pads(robot, inputs.chamber_pa, inputs.payload_kg)
            .map_err(|e| anyhow::anyhow!("the multibody arm does not settle ({e:?})"))?[1];
        mm.push((rod.translation.vector - rings.translation.vector).norm() * 1e3);
        deg.push(rod.rotation.angle_to(&rings.rotation).to_degrees());
    }
    let spread = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let p95 = values[(values.len() - 1) * 95 / 100];
        [mean, p95, values[values.len() - 1]]
    };
    let (mm, deg) = (spread(&mut mm), spread(&mut deg));
    Ok(Report {
        text: format!(
            "rod beside the rig's multibody arm, {poses} settled poses (simulated, seed {POSES_SEED}): tip apart by \
             {:.1} mm mean, {:.1} P95, {:.1} max; {:.1} deg mean, {:.1} P95, {:.1} max",
            mm[0], mm[1], mm[2], deg[0], deg[1], deg[2]
        ),
        json: json!({"poses": poses, "seed": POSES_SEED, "mm_mean_p95_max": mm, "deg_mean_p95_max": deg}),
    })
}
