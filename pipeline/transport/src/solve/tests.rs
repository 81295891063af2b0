use glam::{DAffine3, DVec3, Vec3};
use luxel_scene::{
    Scene, Silent,
    build::{Builder, transformed},
};

use super::*;
use crate::{
    geometry::Geometry,
    rays::Rays,
    sweep::tests::{room_with_block, tilted, voxelized},
};

fn closed() -> SolveSettings {
    SolveSettings { closed: true, ..SolveSettings::default() }
}

fn mean(surfels: &Surfels, e: &[Rgb]) -> f64 {
    flux(surfels, |i| e[i]).element_sum() / 3.0 / surfels.area()
}

/// Area-weighted mean and largest relative deviation of E from E₀/(1−ρ), E₀ everywhere the same.
fn furnace(scene: &Scene, rho: f64, settings: &SolveSettings) -> (f64, f64, SolveReport) {
    let geometry = Geometry::new(scene);
    let surfels = voxelized(&geometry, 20);
    let direct = vec![Rgb::splat(10.0); surfels.list.len()];
    let (solution, report) = solve(&surfels, &direct, settings, None, &Silent).unwrap();
    let exact = 10.0 / (1.0 - rho);
    let (mut off, mut worst) = (0.0, 0.0f64);
    for (s, (d, i)) in surfels.list.iter().zip(solution.direct.iter().zip(&solution.indirect)) {
        let error = f64::from((*d + *i).x) / exact - 1.0;
        off += f64::from(s.area) * error / surfels.area();
        worst = worst.max(error.abs());
    }
    (off, worst, report)
}

#[test]
fn a_closed_furnace_has_e_over_one_minus_rho() {
    for rho in [0.5, 0.8, 0.95] {
        let room = room_with_block(Vec3::splat(rho));
        let mut b = Builder::new("sphere");
        let white = b.matte(Vec3::splat(rho));
        b.sphere("ball", Vec3::ZERO, 1.0, 24, white, true);
        let sphere = b.build();
        for scene in [&room, &tilted(room.clone()), &sphere] {
            let (off, _, report) = furnace(scene, f64::from(rho), &closed());
            println!(
                "{} ρ {rho}: {off:+.5}, {} bounces, {} stiff steps",
                scene.name,
                report.bounces.len(),
                report.stiff_steps
            );
            assert!(off.abs() < 5e-3, "{off}");
            assert_eq!(report.bands, 1);
        }
    }
}

#[test]
fn an_almost_white_room_comes_to_rest_quickly() {
    for rho in [0.99f32, 0.999] {
        // The block hangs free: a gap below a voxel would be a second room that is barely connected to the first.
        let mut b = Builder::new("room");
        let white = b.matte(Vec3::splat(rho));
        b.cuboid("room", Vec3::ZERO, Vec3::new(1.0, 0.9, 1.1), white, true);
        b.cuboid("block", Vec3::new(0.3, 0.2, 0.35), Vec3::new(0.55, 0.6, 0.6), white, false);
        let room = b.build();
        // Light on one wall only, so that there is more than the constant mode to solve for.
        for scene in [room.clone(), tilted(room)] {
            let geometry = Geometry::new(&scene);
            let surfels = voxelized(&geometry, 32);
            let lit = |i: usize| geometry.triangles[surfels.list[i].triangle as usize].index < 2;
            let direct: Vec<Rgb> = (0..surfels.list.len()).map(|i| if lit(i) { Rgb::ONE } else { Rgb::ZERO }).collect();
            let settings = SolveSettings { tolerance: 1e-3, ..closed() };
            let (solution, report) = solve(&surfels, &direct, &settings, None, &Silent).unwrap();
            let tight = SolveSettings { tolerance: 1e-6, ..closed() };
            let (exact, _) = solve(&surfels, &direct, &tight, None, &Silent).unwrap();
            let error = mean(&surfels, &solution.indirect) / mean(&surfels, &exact.indirect) - 1.0;
            let applications = report.bounces.len() as u32 + report.stiff_steps;
            println!(
                "ρ {rho}: {applications} applications, error {error:+.5}, mean {}",
                mean(&surfels, &exact.indirect)
            );
            assert!(applications <= 20, "{applications}");
            assert!(error.abs() < 2e-3, "{error}");
        }
    }
}

#[test]
fn no_light_and_no_albedo_give_exactly_nothing() {
    let scene = room_with_block(Vec3::ZERO);
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 12);
    let lit = vec![Rgb::ONE; surfels.list.len()];
    let (solution, report) = solve(&surfels, &lit, &SolveSettings::default(), None, &Silent).unwrap();
    assert!(solution.indirect.iter().all(|e| *e == Rgb::ZERO));
    assert_eq!((report.bounces.len(), report.discrete_rays, report.bands), (0, 0, 0));
    let scene = room_with_block(Vec3::splat(0.5));
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 12);
    let dark = vec![Rgb::ZERO; surfels.list.len()];
    let (solution, report) = solve(&surfels, &dark, &SolveSettings::default(), None, &Silent).unwrap();
    assert!(solution.indirect.iter().all(|e| *e == Rgb::ZERO));
    assert_eq!(report.discrete_rays, 0);
}

#[test]
fn a_black_floor_under_a_sky_gets_the_sky_in_one_bounce() {
    let mut b = Builder::new("plane");
    let black = b.matte(Vec3::ZERO);
    b.quad("plane", Vec3::ZERO, Vec3::Z, Vec3::X, black);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 12);
    let dark = vec![Rgb::ZERO; surfels.list.len()];
    let l = Rgb::new(1.0, 0.5, 0.25);
    let (solution, report) = solve(&surfels, &dark, &SolveSettings::default(), Some(&|_| l), &Silent).unwrap();
    assert_eq!((report.bounces.len(), report.bands), (1, 3));
    for e in &solution.indirect {
        assert!((*e / (l * std::f32::consts::PI) - 1.0).abs().max_element() < 1e-5);
    }
    let ledger = &report.ledger;
    assert!((ledger.sky / ledger.absorbed - 1.0).abs().max_element() < 1e-6, "{ledger:?}");
}

#[test]
fn one_bounce_brings_no_more_than_all_of_them() {
    let scene = room_with_block(Vec3::splat(0.9));
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 16);
    let direct = vec![Rgb::splat(10.0); surfels.list.len()];
    let after = |max_bounces| {
        let settings = SolveSettings { max_bounces, ..closed() };
        mean(&surfels, &solve(&surfels, &direct, &settings, None, &Silent).unwrap().0.indirect)
    };
    assert_eq!(after(0), 0.0);
    assert!((after(1) / 9.0 - 1.0).abs() < 5e-3, "{}", after(1));
    // From the second bounce on the ratio is known, and the rest of the series is added.
    for bounces in [2, 3, 64] {
        assert!((after(bounces) / 90.0 - 1.0).abs() < 2e-2, "{bounces}: {}", after(bounces));
    }
}

#[test]
fn bad_light_is_refused() {
    let scene = room_with_block(Vec3::splat(0.5));
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 8);
    let settings = SolveSettings::default();
    let mut direct = vec![Rgb::ONE; surfels.list.len()];
    direct[3].y = f32::NAN;
    let bad = solve(&surfels, &direct, &settings, None, &Silent);
    assert!(matches!(bad, Err(SolveError::BadDirect { surfel: 3, .. })));
    assert!(matches!(solve(&surfels, &[], &settings, None, &Silent), Err(SolveError::Length { .. })));
    let dark = vec![Rgb::ZERO; surfels.list.len()];
    let bad = solve(&surfels, &dark, &settings, Some(&|_| Rgb::splat(-1.0)), &Silent);
    assert!(matches!(bad, Err(SolveError::BadSky { .. })));
}

/// Coloured room, coloured light on some surfels.
fn coloured(n: u32) -> (Scene, u32) {
    (tilted(room_with_block(Vec3::new(0.8, 0.5, 0.3))), n)
}

#[test]
fn light_adds_up_and_scales() {
    let (scene, n) = coloured(20);
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, n);
    // A fixed number of bounces, so that both solutions stop at the same place.
    let settings = SolveSettings { tolerance: 0.0, max_bounces: 5, stiff: 1.0, ..SolveSettings::default() };
    let run = |light: &dyn Fn(usize) -> Rgb| {
        let direct: Vec<Rgb> = (0..surfels.list.len()).map(light).collect();
        // The tail is a function of the light; without it, what is left is linear.
        let (solution, report) = solve(&surfels, &direct, &settings, None, &Silent).unwrap();
        (mean(&surfels, &solution.indirect), report.bounces.iter().map(|b| b.increment).sum::<f64>())
    };
    let red = |i: usize| if i.is_multiple_of(3) { Rgb::new(2.0, 0.1, 0.0) } else { Rgb::ZERO };
    let blue = |i: usize| if i.is_multiple_of(5) { Rgb::new(0.0, 0.3, 5.0) } else { Rgb::ZERO };
    let both = run(&|i| red(i) + blue(i));
    let sum = run(&red).1 + run(&blue).1;
    assert!((both.1 / sum - 1.0).abs() < 1e-5, "{} {sum}", both.1);
    // A factor that is a power of two changes no bit of the mantissas.
    let bright = run(&|i| red(i) * 1024.0);
    assert_eq!(bright.0, 1024.0 * run(&red).0);
}

#[test]
fn threads_do_not_change_the_solution() {
    let (scene, n) = coloured(16);
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, n);
    let direct: Vec<Rgb> = surfels.list.iter().map(|s| s.normal.max(Vec3::ZERO)).collect();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| solve(&surfels, &direct, &SolveSettings::default(), None, &Silent).unwrap())
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(7));
}

#[test]
fn scale_does_not_matter() {
    let (scene, n) = coloured(24);
    let run = |scene: &Scene| {
        let geometry = Geometry::new(scene);
        let surfels = voxelized(&geometry, n);
        let direct: Vec<Rgb> = surfels.list.iter().map(|s| s.normal.max(Vec3::ZERO)).collect();
        let (solution, _) = solve(&surfels, &direct, &SolveSettings::default(), None, &Silent).unwrap();
        mean(&surfels, &solution.indirect)
    };
    let here = run(&scene);
    for scale in [1e-4, 1e4] {
        let there = run(&transformed(scene.clone(), DAffine3::from_scale(DVec3::splat(scale))));
        assert!((there / here - 1.0).abs() < 1e-2, "{scale}: {there} {here}");
    }
}

#[test]
fn the_ledger_balances() {
    let (scene, n) = coloured(32);
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, n);
    let direct: Vec<Rgb> = surfels.list.iter().map(|s| s.normal.max(Vec3::ZERO)).collect();
    let (_, report) = solve(&surfels, &direct, &SolveSettings::default(), None, &Silent).unwrap();
    let l = &report.ledger;
    println!("{l:?}");
    let books = l.absorbed + l.escaped + l.in_flight + l.imbalance - l.shot - l.sky;
    assert!((books / l.shot).abs().max_element() < 1e-12);
    assert!((l.imbalance / l.shot).abs().max_element() < 0.02, "{}", l.imbalance / l.shot);
    assert!((l.escaped / l.shot).max_element() < 0.01);
    assert!((l.in_flight / l.shot).abs().max_element() < 1e-2);
}

#[test]
fn probes_tell_a_closed_room_from_an_open_one() {
    let run = |scene: &Scene| {
        let geometry = Geometry::new(scene);
        is_closed(&Rays::new(&geometry), &voxelized(&geometry, 16), 8192)
    };
    let room = room_with_block(Vec3::splat(0.5));
    assert!(run(&room));
    let mut open = room.clone();
    open.meshes[0].triangles.truncate(11);
    assert!(!run(&open));
    // A room seen from outside has black backs inside and sky outside.
    let mut b = Builder::new("outside");
    let white = b.matte(Vec3::ONE);
    b.cuboid("box", Vec3::ZERO, Vec3::ONE, white, false);
    assert!(!run(&b.build()));
}

/// Two rooms side by side with a wall of the given thickness between them; a door where asked for.
fn two_rooms(wall: f32, door: bool) -> Scene {
    let mut b = Builder::new("two rooms");
    let white = b.matte(Vec3::splat(0.7));
    b.cuboid("shell", Vec3::ZERO, Vec3::new(2.0, 0.8, 1.0), white, true);
    let (lo, hi) = (1.0 - 0.5 * wall, 1.0 + 0.5 * wall);
    if door {
        b.cuboid("left of the door", Vec3::new(lo, 0.0, 0.0), Vec3::new(hi, 0.8, 0.4), white, false);
        b.cuboid("right of the door", Vec3::new(lo, 0.0, 0.65), Vec3::new(hi, 0.8, 1.0), white, false);
        b.cuboid("lintel", Vec3::new(lo, 0.55, 0.4), Vec3::new(hi, 0.8, 0.65), white, false);
    } else {
        b.cuboid("wall", Vec3::new(lo, 0.0, 0.0), Vec3::new(hi, 0.8, 1.0), white, false);
    }
    b.build()
}

#[test]
fn a_thin_wall_keeps_the_dark_room_dark() {
    for (scene, bound) in [(two_rooms(0.01, false), 0.02), (tilted(two_rooms(0.01, false)), 0.02)] {
        let geometry = Geometry::new(&scene);
        let surfels = voxelized(&geometry, 64);
        // The left room is lit from its real points; the rest is dark.
        let inverse = if scene.instances[0].transform == DAffine3::IDENTITY {
            DAffine3::IDENTITY
        } else {
            scene.instances[0].transform.inverse()
        };
        let x = |i: usize| {
            let s = &surfels.list[i];
            let t = &geometry.triangles[s.triangle as usize];
            inverse.transform_point3(geometry.frame.world(t.at(s.u(), s.v()))).x
        };
        let direct: Vec<Rgb> = (0..surfels.list.len()).map(|i| if x(i) < 1.0 { Rgb::ONE } else { Rgb::ZERO }).collect();
        let (solution, _) = solve(&surfels, &direct, &closed(), None, &Silent).unwrap();
        let side = |lit: bool| {
            let mine = |i: &usize| (x(*i) < 1.0) == lit && (x(*i) - 1.0).abs() < 0.99;
            let all = (0..surfels.list.len()).filter(mine);
            let (e, a) = all.fold((0.0, 0.0), |(e, a), i| {
                let area = f64::from(surfels.list[i].area);
                (e + area * f64::from(solution.indirect[i].x), a + area)
            });
            e / a
        };
        let leak = side(false) / side(true);
        println!("leak {:.3} %", 100.0 * leak);
        assert!(leak < bound, "{leak}");
    }
}

#[test]
fn an_emitter_may_ride_in_the_sweep() {
    let mut b = Builder::new("glowing room");
    let glow = b.emitter(Vec3::splat(0.5), Vec3::splat(2.0));
    b.cuboid("room", Vec3::ZERO, Vec3::ONE, glow, true);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 16);
    let dark = vec![Rgb::ZERO; surfels.list.len()];
    let settings = SolveSettings { emit_in_sweep: true, ..closed() };
    let (solution, _) = solve(&surfels, &dark, &settings, None, &Silent).unwrap();
    let exact = std::f64::consts::PI * 2.0 / (1.0 - 0.5);
    let all: Vec<Rgb> = solution.direct.iter().zip(&solution.indirect).map(|(d, i)| *d + *i).collect();
    assert!((mean(&surfels, &all) / exact - 1.0).abs() < 2e-3, "{}", mean(&surfels, &all) / exact);
}

#[test]
fn two_white_rooms_with_a_door_have_two_slow_modes() {
    let mut scene = two_rooms(0.2, true);
    scene.materials[0].base_color = Vec3::splat(0.99).extend(1.0);
    let scene = tilted(scene);
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 48);
    // Only the far wall of one room is lit.
    let lowest = surfels.list.iter().map(|s| s.centroid.x).fold(f32::INFINITY, f32::min);
    let lit = |s: &Surfel| if s.centroid.x < lowest + 400.0 { Rgb::ONE } else { Rgb::ZERO };
    let direct: Vec<Rgb> = surfels.list.iter().map(lit).collect();
    let settings = SolveSettings { tolerance: 1e-3, ..closed() };
    let (solution, report) = solve(&surfels, &direct, &settings, None, &Silent).unwrap();
    let tight = SolveSettings { tolerance: 1e-6, ..closed() };
    let (exact, _) = solve(&surfels, &direct, &tight, None, &Silent).unwrap();
    let error = mean(&surfels, &solution.indirect) / mean(&surfels, &exact.indirect) - 1.0;
    println!("{} stiff steps, error {error:+.5}", report.stiff_steps);
    assert!(report.stiff_steps <= 16, "{}", report.stiff_steps);
    assert!(error.abs() < 2e-3, "{error}");
}

#[test]
fn the_correction_takes_a_leak_away_and_leaves_a_furnace_alone() {
    // With T̃ as the exact operator too, a solution that is wrong by a leak is mended: E = (1 + T̃ρ + …) of the defect.
    let scene = room_with_block(Vec3::splat(0.5));
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 16);
    let n = surfels.list.len();
    let settings = closed();
    // A closed room with E₀ = 1 everywhere has E = 1 of indirect light at ρ = 0.5; one bounce of 1.2 brings 1.1.
    let mut refreshed = vec![Rgb::splat(1.1); n];
    refine(&surfels, vec![Rgb::splat(1.2); n], &mut refreshed, &settings, &Silent).unwrap();
    assert!((mean(&surfels, &refreshed) - 1.0).abs() < 1e-3, "{}", mean(&surfels, &refreshed));
    let mut right = vec![Rgb::ONE; n];
    let rays = refine(&surfels, right.clone(), &mut right, &settings, &Silent).unwrap();
    assert!(rays == 0 && right.iter().all(|e| *e == Rgb::ONE));
}

#[test]
fn outer_walls_of_a_closed_white_room_stay_dark() {
    let mut b = Builder::new("house");
    let white = b.matte(Vec3::splat(0.95));
    b.cuboid("inside", Vec3::ZERO, Vec3::ONE, white, true);
    b.cuboid("outside", Vec3::splat(-0.25), Vec3::splat(1.25), white, false);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 20);
    let is_inside = |i: usize| geometry.triangles[surfels.list[i].triangle as usize].instance == 0;
    let direct: Vec<Rgb> = (0..surfels.list.len()).map(|i| if is_inside(i) { Rgb::ONE } else { Rgb::ZERO }).collect();
    let (solution, report) = solve(&surfels, &direct, &closed(), None, &Silent).unwrap();
    assert!(report.stiff_steps > 0);
    for (i, e) in solution.indirect.iter().enumerate() {
        // E = E₀ρ/(1 − ρ) of indirect light.
        let expected = if is_inside(i) { 19.0 } else { 0.0 };
        assert!((e.x - expected).abs() < 0.02 * 19.0, "surfel {i}: {e}, not {expected}");
    }
}

#[test]
fn the_literal_rule_is_solved_for_with_the_light_that_it_loses() {
    let scene = room_with_block(Vec3::splat(0.95));
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 20);
    let lit = |s: &Surfel| if s.normal.y > 0.5 { Rgb::ONE } else { Rgb::ZERO };
    let direct: Vec<Rgb> = surfels.list.iter().map(lit).collect();
    let run = |stiff| {
        // Bounces of as many directions as the solver's steps.
        let settings =
            SolveSettings { rule: Rule::Literal, stiff, directions: 128, decay: 1.0, tolerance: 1e-4, ..closed() };
        let (solution, report) = solve(&surfels, &direct, &settings, None, &Silent).unwrap();
        (mean(&surfels, &solution.indirect), report.stiff_steps)
    };
    let ((bounced, none), (solved, some)) = (run(1.0), run(0.2));
    assert!(none == 0 && some > 0 && (solved / bounced - 1.0).abs() < 0.01, "{solved} {bounced}");
}
