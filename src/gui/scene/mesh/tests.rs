use std::collections::BTreeMap;

use super::*;

/// What the vertex shader makes of a mesh for a straight segment of length 0.145 m.
fn straight(part: Part, mesh: &Mesh) -> Vec<Vec3> {
    mesh.vertices
        .iter()
        .map(|v| {
            let [a, b, c] = v.position;
            match part.motion() {
                Motion::Rigid => Vec3::new(a, b, c),
                Motion::Swept => (Vec2::from_angle(b) * a).extend(-0.145 * c),
                Motion::Coiled => Vec3::new(a, b, c),
            }
        })
        .collect()
}

/// Edges by welded ends with the sum of their directions and their count.
fn edges(points: &[Vec3], indices: &[u32]) -> BTreeMap<([i32; 3], [i32; 3]), (i32, u32)> {
    let key = |i: u32| {
        points[i as usize]
            .to_array()
            .map(|x| (x * 1e6).round() as i32)
    };
    let mut edges = BTreeMap::new();
    for t in indices.chunks_exact(3) {
        let k = [key(t[0]), key(t[1]), key(t[2])];
        if k[0] == k[1] || k[1] == k[2] || k[2] == k[0] {
            continue;
        }
        for (a, b) in [(k[0], k[1]), (k[1], k[2]), (k[2], k[0])] {
            let (edge, sign) = if a < b { ((a, b), 1) } else { ((b, a), -1) };
            let e = edges.entry(edge).or_insert((0, 0));
            e.0 += sign;
            e.1 += 1;
        }
    }
    edges
}

#[test]
fn solid_parts_are_closed_and_wound_one_way() {
    let robot = RobotSpec::reference();
    for part in Part::ALL {
        if matches!(
            part,
            Part::Tube | Part::Spring | Part::FingerOpen | Part::FingerClosed
        ) {
            continue; // open at ends that other parts cover
        }
        let mesh = part_mesh(part, &robot);
        let points = straight(part, &mesh);
        for (edge, (sum, count)) in edges(&points, &mesh.indices) {
            assert_eq!((sum, count), (0, 2), "{part:?} edge {edge:?}");
        }
    }
}

#[test]
fn volumes_are_positive_and_right() {
    let robot = RobotSpec::reference();
    let volume = |part| {
        let mesh = part_mesh(part, &robot);
        let p = straight(part, &mesh);
        // V = Σ a · (b × c) / 6
        mesh.indices
            .chunks_exact(3)
            .map(|t| {
                let [a, b, c] = [t[0], t[1], t[2]].map(|i| p[i as usize].as_dvec3());
                a.dot(b.cross(c)) / 6.0
            })
            .sum::<f64>()
    };
    let sphere = volume(Part::Sphere);
    assert!(
        (sphere / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 0.03,
        "{sphere}"
    );
    // Between the cylinders of the inner and the outer diameter.
    let v = volume(Part::Bellows);
    let cylinder = |d: f64| std::f64::consts::FRAC_PI_4 * d * d * 0.145;
    assert!(v > cylinder(0.065) && v < cylinder(0.100), "{v}");
    for part in [
        Part::TopPad,
        Part::MiddlePad,
        Part::EndPad,
        Part::FingerOpen,
        Part::FingerClosed,
    ] {
        assert!(volume(part) > 0.0, "{part:?}");
    }
}

#[test]
fn numbers_are_finite_and_normals_have_unit_length() {
    let robot = RobotSpec::reference();
    let (mesh, ranges) = build(&robot);
    assert_eq!(ranges.len(), Part::ALL.len());
    for (part, range) in Part::ALL.iter().zip(&ranges) {
        assert!(!range.is_empty(), "{part:?}");
        for i in &mesh.indices[range.start as usize..range.end as usize] {
            let v = mesh.vertices[*i as usize];
            assert!(v.position.iter().chain(&v.normal).all(|x| x.is_finite()));
            assert!((0.0..=1.0).contains(&v.shade), "{part:?} {}", v.shade);
            let length = Vec3::from(v.normal).length();
            match part.motion() {
                Motion::Rigid => assert!((length - 1.0).abs() < 1e-4, "{part:?} {length}"),
                Motion::Swept | Motion::Coiled => assert!(length > 0.5, "{part:?} {length}"),
            }
        }
    }
}

#[test]
fn bellows_reach_the_diameters_of_the_robot_file() {
    let robot = RobotSpec::reference();
    let mesh = part_mesh(Part::Bellows, &robot);
    let widest = mesh
        .vertices
        .iter()
        .map(|v| v.position[0])
        .fold(0.0, f32::max);
    assert!((2.0 * widest - 0.100).abs() < 1e-4);
    let maxima = (0..1000)
        .map(|k| [k - 1, k, k + 1].map(|i| fold(i as f32 / 1000.0, 0.0325, 0.05)))
        .filter(|[a, b, c]| b > a && b >= c)
        .count();
    assert_eq!(maxima, CONVOLUTIONS);
}
