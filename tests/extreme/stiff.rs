//! Nearly white rooms. In a closed room in which every wall has the albedo ρ and the direct irradiance E₀, E = E₀/(1 − ρ)
//! everywhere, whatever its shape, and the sum of the first n bounces is E₀ (1 − ρⁿ⁺¹)/(1 − ρ).

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use luxel_scene::{Scene, Silent, build::Builder};
use luxel_transport::{
    Rgb,
    directions::DirectionSet,
    geometry::Geometry,
    rays::Rays,
    solve::{SolveReport, SolveSettings, is_closed, row_sums, solve},
    surfel::{Solution, Surfels},
    sweep::{Rule, Sweep},
};

use crate::kit::*;
use crate::support::*;

const ALBEDOS: [f32; 5] = [0.5, 0.8, 0.9, 0.99, 0.999];

fn box_room(b: &mut Builder, wall: usize) {
    b.cuboid("room", Vec3::new(-0.5, 0.0, -0.7), Vec3::new(0.8, 0.9, 0.4), wall, true);
}

fn round_room(b: &mut Builder, wall: usize) {
    b.sphere("room", Vec3::new(0.1, 0.2, -0.3), 0.7, 8, wall, true);
}

/// An L of two arms, 1 wide, 2 long and 0.8 high: a prism over six corners, seen from inside.
fn l_room(b: &mut Builder, wall: usize) {
    let outline = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]];
    let at = |i: usize, y: f32| Vec3::new(outline[i % 6][0], y, outline[i % 6][1]);
    for i in 0..6 {
        let (o, along) = (at(i, 0.0), at(i + 1, 0.0) - at(i, 0.0));
        b.quad("wall", o, along, Vec3::Y * 0.8, wall);
    }
    for (y, order) in [(0.0, [0, 2, 1]), (0.8, [0, 1, 2])] {
        let corners = [0, 1, 2, 3, 4, 5].map(|i| at(i, y));
        // Floor and ceiling in two rectangles each that share the inner corner's diagonal.
        let fan = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]].map(|t| order.map(|k: usize| t[k] as u32));
        b.mesh("lid", corners.to_vec(), fan.to_vec(), wall);
    }
}

/// The solver alone, with E₀ = 1 everywhere: its report, and the largest relative error of any surfel.
fn solver_of_constant(scene: &Scene, rho: f64) -> (SolveReport, f64) {
    let geometry = Geometry::new(scene);
    let surfels = voxelized(&geometry, 12_000);
    let closed = is_closed(&Rays::new(&geometry), &surfels, 1 << 14);
    assert!(closed, "{} is closed", scene.name);
    let direct = vec![Rgb::ONE; surfels.list.len()];
    let (solution, report) =
        solve(&surfels, &direct, &SolveSettings { closed, ..SolveSettings::default() }, None, &Silent).expect("light");
    let exact = 1.0 / (1.0 - rho);
    let off = |i: usize| (f64::from(solution.total(i).x) / exact - 1.0).abs();
    let worst = (0..surfels.list.len()).map(off).fold(0.0, f64::max);
    (report, worst)
}

fn assert_furnaces(name: &str, shape: impl Fn(&mut Builder, usize)) {
    for albedo in ALBEDOS {
        let (scene, exact) = furnace(name, albedo, &shape);
        let (report, worst) = solver_of_constant(&scene, f64::from(albedo));
        let steps = report.bounces.len() as u32 + report.stiff_steps;
        let rows = report.rows.expect("rows are measured");
        println!(
            "{name} ρ {albedo}: {steps} steps, solver off by {:.4} %, row-sum defect before closing {:.2e}",
            100.0 * worst,
            rows.defect() + rows.sky
        );
        assert!(steps <= 20, "{name} {albedo}: {steps} steps");
        let lit = bake(&scene, &coarse());
        assert_within(&format!("{name} furnace, ρ {albedo}"), &scene, &lit, 0.005, |_| exact);
    }
}

#[test]
fn box_furnaces() {
    assert_furnaces("box", box_room);
}

#[test]
fn sphere_furnaces() {
    assert_furnaces("sphere", round_room);
}

#[test]
fn l_shaped_furnaces() {
    assert_furnaces("L", l_room);
}
