//! The geometric simulator behind the drawn arm. It takes tens of milliseconds, so a thread of its own
//! settles it; the twin asks and continues.

use nalgebra::Vector3;

use super::newest::Newest;
use crate::robot::RobotSpec;
use crate::signal::{MeshShape, Skin, Stamp};
use crate::sim::mesh::{MeshModel, MeshState, observe_mesh, settle_mesh, skin};
use crate::sim::{Inputs, Model, SimError, State, observe, settle};

/// Pressures that moved less than this since the last settling change nothing one could see, Pa.
const QUIET_PA: f64 = 50.0;

/// What to settle.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshQuestion {
    /// When it was asked.
    pub stamp: Stamp,
    /// Pressures and loads.
    pub inputs: Inputs,
}

/// The settled shape, or why there is none.
pub type MeshAnswer = Result<MeshShape, String>;

/// Starts the thread that settles the mesh of `robot`.
///
/// # Errors
/// When the thread cannot be started.
pub fn mesh_worker(robot: &RobotSpec) -> std::io::Result<Newest<MeshQuestion, MeshAnswer>> {
    let mut solver = MeshSolver::new(robot);
    Newest::spawn("mesh", move |question: MeshQuestion| {
        solver.solve(&question).map_err(|e| e.to_string())
    })
}

/// The geometric simulator with its last state; built when the first question comes.
pub struct MeshSolver {
    robot: RobotSpec,
    built: Option<Built>,
}

struct Built {
    mesh: MeshModel,
    state: MeshState,
    rod: Model,
    rod_state: State,
    last: Option<(Inputs, MeshShape)>,
}

impl MeshSolver {
    /// A solver for a robot.
    pub fn new(robot: &RobotSpec) -> Self {
        Self {
            robot: robot.clone(),
            built: None,
        }
    }

    /// Settles the mesh, starting from where it was, and compares its tip with the rod model's.
    ///
    /// # Errors
    /// [`SimError`] when the robot cannot be meshed or the mesh does not come to rest.
    pub fn solve(&mut self, question: &MeshQuestion) -> Result<MeshShape, SimError> {
        let built = match &mut self.built {
            Some(built) => built,
            empty => empty.insert(Built::new(&self.robot)?),
        };
        built.solve(question)
    }
}

impl Built {
    fn new(robot: &RobotSpec) -> Result<Self, SimError> {
        let mesh = MeshModel::new(robot)?;
        let rod = Model::nominal(robot);
        Ok(Self {
            state: MeshState::rest(&mesh),
            rod_state: State::rest(&rod),
            mesh,
            rod,
            last: None,
        })
    }

    fn solve(&mut self, question: &MeshQuestion) -> Result<MeshShape, SimError> {
        if let Some((inputs, shape)) = &self.last
            && is_near(inputs, &question.inputs)
        {
            return Ok(MeshShape {
                stamp: question.stamp,
                ..shape.clone()
            });
        }
        let inputs = &question.inputs;
        if let Err(first) = settle_mesh(&self.mesh, &mut self.state, inputs) {
            // A far start can be the reason.
            let mut fresh = MeshState::rest(&self.mesh);
            settle_mesh(&self.mesh, &mut fresh, inputs).map_err(|_| first)?;
            self.state = fresh;
        }
        let seen = observe_mesh(&self.mesh, &self.state);
        let tip_m = seen.base_from_tip.translation.vector;
        let apart_m = settle(&self.rod, &mut self.rod_state, inputs)
            .ok()
            .map(|_| {
                let rod = observe(&self.rod, &self.rod_state).base_from_tip;
                (tip_m - rod.translation.vector).norm()
            });
        let shape = MeshShape {
            stamp: question.stamp,
            shape: seen.shape,
            skin: lit(&self.mesh, &self.state),
            apart_m,
        };
        self.last = Some((inputs.clone(), shape.clone()));
        Ok(shape)
    }
}

/// Whether the shape would look the same.
fn is_near(a: &Inputs, b: &Inputs) -> bool {
    let mut pairs = a.chamber_pa.iter().zip(&b.chamber_pa);
    let quiet = pairs.all(|(p, q)| (p - q).abs() < QUIET_PA);
    let rest = |i: &Inputs| Inputs {
        chamber_pa: Default::default(),
        ..i.clone()
    };
    quiet && rest(a) == rest(b)
}

/// The surface with its normals and its columns.
fn lit(model: &MeshModel, state: &MeshState) -> Skin {
    let surface = skin(model, state);
    let normals = normals(&surface.positions_m, &surface.triangles);
    // Vertices come column by column: the outer ones, half of the nodes.
    let mut columns = Vec::with_capacity(state.nodes_m.len());
    let (mut vertices, mut first) = (0, 0);
    for nodes in &state.nodes_m {
        vertices += nodes.len() / 2;
        let last = surface
            .triangles
            .partition_point(|t| (t[0] as usize) < vertices);
        columns.push(first..last);
        first = last;
    }
    Skin {
        positions_m: surface.positions_m,
        normals,
        triangles: surface.triangles,
        columns,
    }
}

/// Unit normals of a surface's vertices: the mean of the triangles around, weighted by area.
fn normals(positions_m: &[[f64; 3]], triangles: &[[u32; 3]]) -> Vec<[f64; 3]> {
    let mut sums = vec![Vector3::zeros(); positions_m.len()];
    for t in triangles {
        let [a, b, c] = t.map(|i| Vector3::from(positions_m[i as usize]));
        let twice_area = (b - a).cross(&(c - a));
        for i in t {
            sums[*i as usize] += twice_area;
        }
    }
    sums.into_iter()
        .map(|n| n.try_normalize(0.0).unwrap_or_else(Vector3::z).into())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn question(chamber_kpa: [f64; 6]) -> MeshQuestion {
        MeshQuestion {
            stamp: Stamp::from_seconds(1.0),
            inputs: Inputs {
                chamber_pa: chamber_kpa.map(|p| p * 1e3),
                ..Inputs::default()
            },
        }
    }

    #[test]
    fn the_skin_is_lit_from_outside_and_follows_the_pressures() {
        let robot = RobotSpec::reference();
        let mut solver = MeshSolver::new(&robot);
        let rest = solver.solve(&question([0.0; 6])).expect("settles");
        let skin = &rest.skin;
        assert_eq!(skin.columns.len(), 8);
        assert_eq!(skin.columns[7].end, skin.triangles.len());
        assert_eq!(skin.normals.len(), skin.positions_m.len());
        for (chamber, centre) in robot.bellows_m.iter().enumerate() {
            for t in &skin.triangles[skin.columns[chamber].clone()] {
                for i in t.map(|i| i as usize) {
                    // The arm hangs nearly straight: a bellows' normals point away from its axis.
                    let from_axis = (Vector3::from(skin.positions_m[i]) - centre).xy();
                    let n = Vector3::from(skin.normals[i]);
                    assert!((n.norm() - 1.0).abs() < 1e-12);
                    assert!(n.xy().dot(&from_axis) > 0.9 * from_axis.norm());
                }
            }
        }
        let bent = solver
            .solve(&question([25.0, -15.0, -15.0, 0.0, 0.0, 0.0]))
            .expect("settles");
        assert_eq!(bent.skin.triangles, skin.triangles);
        let furthest = |a: &MeshShape, b: &MeshShape| {
            let pairs = a.skin.positions_m.iter().zip(&b.skin.positions_m);
            pairs
                .map(|(p, q)| (Vector3::from(*p) - Vector3::from(*q)).norm())
                .fold(0.0, f64::max)
        };
        assert!(furthest(&rest, &bent) > 0.05);
        // Calibrated on a bend of the first segment: the tips agree to some millimetres.
        let apart_m = bent.apart_m.expect("the rod settles");
        assert!((1e-5..6e-3).contains(&apart_m), "{apart_m}");
        // Noise of the gauges moves nothing; its answer is fresh all the same.
        let mut noisy = question([25.02, -15.0, -15.01, 0.0, 0.0, 0.0]);
        noisy.stamp = Stamp::from_seconds(2.0);
        let again = solver.solve(&noisy).expect("settles");
        assert_eq!((again.stamp, &again.skin), (noisy.stamp, &bent.skin));
        noisy.inputs.payload_kg = 0.3;
        let loaded = solver.solve(&noisy).expect("settles");
        assert!(furthest(&loaded, &bent) > 1e-3);
    }

    #[test]
    fn a_load_beyond_the_arm_is_reported_and_the_last_state_serves_on() {
        let mut solver = MeshSolver::new(&RobotSpec::reference());
        let before = solver.solve(&question([10.0; 6])).expect("settles");
        let mut bad = question([f64::NAN; 6]);
        assert!(solver.solve(&bad).is_err());
        bad.inputs.chamber_pa = [10e3; 6];
        assert_eq!(solver.solve(&bad).expect("settles"), before);
    }
}
