use glam::{DAffine3, DQuat, Vec3};
use luxel_scene::{
    Scene, Silent,
    build::{Builder, transformed},
};

use super::*;
use crate::{
    directions::DirectionSet,
    geometry::Geometry,
    rays::{OFFSET, Rays},
    sampling,
    surfel::{AreaRule, Resolution, VoxelSettings},
};

/// A closed room with a block on its floor.
pub fn room_with_block(albedo: Vec3) -> Scene {
    let mut b = Builder::new("room");
    let white = b.matte(albedo);
    b.cuboid("room", Vec3::ZERO, Vec3::new(1.0, 0.9, 1.1), white, true);
    b.cuboid("block", Vec3::new(0.3, 0.001, 0.35), Vec3::new(0.55, 0.4, 0.6), white, false);
    b.build()
}

pub fn tilted(scene: Scene) -> Scene {
    let turn = DQuat::from_rotation_y(30f64.to_radians()) * DQuat::from_rotation_x(30f64.to_radians());
    transformed(scene, DAffine3::from_quat(turn))
}

pub fn voxelized(geometry: &Geometry, n: u32) -> Surfels {
    let settings = VoxelSettings { resolution: Resolution::Side(n), area: AreaRule::Clipped };
    Surfels::new(geometry, &settings, &Silent).unwrap()
}

/// Area-weighted mean and minimum of T·1.
fn rows(scene: &Scene, n: u32, count: u32, rule: Rule, closed: bool) -> (f64, f32) {
    let geometry = Geometry::new(scene);
    let surfels = voxelized(&geometry, n);
    let sweep = Sweep::new(&surfels, rule, closed);
    let ones = vec![Rgb::ONE; surfels.list.len()];
    let directions = DirectionSet::Fibonacci.directions(count, 0);
    let rows = sweep.apply(&directions, ones.clone(), None, true, &Silent).unwrap();
    let sum: f64 = surfels.list.iter().zip(&rows).map(|(s, r)| f64::from(s.area * r.x)).sum();
    // No row above 1, so the spectral radius of ρT is at most the largest albedo and bounces cannot diverge.
    assert!(rows.iter().all(|r| r.x <= 1.0 + 1e-5), "a row gains light");
    (sum / surfels.area(), rows.iter().fold(f32::INFINITY, |m, r| m.min(r.x)))
}

#[test]
fn a_furnace_keeps_its_light() {
    let straight = room_with_block(Vec3::ONE);
    let turned = tilted(straight.clone());
    // The turned room keeps 0.9990; which lines partial surfels stop is drawn, so the last digit is chance.
    for (scene, n, least) in [(&straight, 48, 0.999), (&turned, 64, 0.9985)] {
        let (mean, min) = rows(scene, n, 256, Rule::Surface, false);
        println!("n {n}: mean row {mean:.5}, least {min:.3}");
        assert!(mean > least && mean <= 1.0 + 1e-6, "{mean}");
        assert!(min > 0.5);
    }
}

#[test]
fn a_furnace_that_is_closed_keeps_it_to_rounding() {
    for scene in [room_with_block(Vec3::ONE), tilted(room_with_block(Vec3::ONE))] {
        let geometry = Geometry::new(&scene);
        let surfels = voxelized(&geometry, 32);
        let sweep = Sweep::new(&surfels, Rule::Surface, true);
        let ones = vec![Rgb::ONE; surfels.list.len()];
        let directions = DirectionSet::Fibonacci.directions(128, 0);
        let rows = sweep.apply(&directions, ones.clone(), None, true, &Silent).unwrap();
        let (mut off, mut all) = (0.0, 0.0);
        for (s, r) in surfels.list.iter().zip(&rows) {
            all += s.area;
            off += if (r.x - 1.0).abs() > 1e-5 { s.area } else { 0.0 };
            assert!(r.x <= 1.0 + 1e-6);
        }
        assert!(off / all < 2e-3, "{}", off / all);
    }
}

#[test]
fn the_literal_rule_loses_a_third_to_a_half() {
    let (straight, _) = rows(&room_with_block(Vec3::ONE), 48, 256, Rule::Literal, false);
    let (turned, _) = rows(&tilted(room_with_block(Vec3::ONE)), 48, 256, Rule::Literal, false);
    println!("literal rows {straight:.3} {turned:.3}");
    assert!(straight > 0.6 && straight < 0.85, "{straight}");
    assert!(turned > 0.45 && turned < 0.7, "{turned}");
}

#[test]
fn a_constant_sky_lights_an_open_plane_with_pi_l() {
    let mut b = Builder::new("plane");
    let white = b.matte(Vec3::splat(0.5));
    b.quad("plane", Vec3::ZERO, Vec3::Z, Vec3::X, white);
    for scene in [b.build()] {
        for scene in [scene.clone(), tilted(scene)] {
            let geometry = Geometry::new(&scene);
            let surfels = voxelized(&geometry, 32);
            let sweep = Sweep::new(&surfels, Rule::Surface, false);
            let dark = vec![Rgb::ZERO; surfels.list.len()];
            let l = Rgb::new(1.0, 2.0, 3.0);
            let directions = DirectionSet::Fibonacci.directions(64, 0);
            let e = sweep.apply(&directions, dark, Some(&|_| l), false, &Silent).unwrap();
            for e in e {
                assert!((e / (l * std::f32::consts::PI) - 1.0).abs().max_element() < 1e-5, "{e}");
            }
        }
    }
}

#[test]
fn the_sky_is_seen_where_it_is() {
    let mut b = Builder::new("plane");
    let white = b.matte(Vec3::splat(0.5));
    b.quad("plane", Vec3::ZERO, Vec3::Z, Vec3::X, white);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 16);
    let sweep = Sweep::new(&surfels, Rule::Surface, false);
    let dark = vec![Rgb::ZERO; surfels.list.len()];
    let directions = DirectionSet::Fibonacci.directions(1024, 0);
    // L = 3 y above the horizon has E = 3 ∫ cos² = 2π on a floor.
    let sky = |d: Vec3| Rgb::splat(3.0 * d.y.max(0.0));
    let e = sweep.apply(&directions, dark, Some(&sky), true, &Silent).unwrap();
    assert!(e.iter().all(|e| (e.x / (2.0 * std::f32::consts::PI) - 1.0).abs() < 5e-3), "{}", e[0]);
}

#[test]
fn a_single_sided_wall_blocks_from_behind_and_is_black() {
    // A floor under a wall that looks away from it: the sky is behind the wall on one side.
    let mut b = Builder::new("wall");
    let white = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::new(-4.0, 0.0, -4.0), Vec3::Z * 8.0, Vec3::X * 8.0, white);
    // The front looks along +Y, away from the floor: the floor sees its back.
    b.quad("lid", Vec3::new(-4.0, 1.0, -4.0), Vec3::Z * 8.0, Vec3::X * 8.0, white);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 64);
    let sweep = Sweep::new(&surfels, Rule::Surface, false);
    let ones = vec![Rgb::ONE; surfels.list.len()];
    let directions = DirectionSet::Fibonacci.directions(256, 0);
    let e = sweep.apply(&directions, ones.clone(), None, true, &Silent).unwrap();
    let sky = sweep.apply(&directions, vec![Rgb::ZERO; ones.len()], Some(&|_| Rgb::ONE), true, &Silent).unwrap();
    for (i, s) in surfels.list.iter().enumerate() {
        let world = geometry.frame.world(s.centroid);
        let middle = world.x.abs() < 1.0 && world.z.abs() < 1.0;
        if middle && world.y < 0.5 {
            // No light comes from the back of the lid, and a disc of radius 3 over distance 1 hides 90 % of the sky.
            assert!(e[i].x < 1e-6, "{}", e[i]);
            assert!(sky[i].x < 0.12 * std::f32::consts::PI, "{}", sky[i].x / std::f32::consts::PI);
        }
    }
}

/// Irradiance at a surfel's real point by continuous rays: what the sweep approximates in one bounce.
fn by_rays(rays: &Rays, surfels: &Surfels, i: usize, radiosity: &dyn Fn(usize) -> f32, count: u32) -> f64 {
    let s = &surfels.list[i];
    let (point, normal) = s.place(rays.geometry);
    let origin = point + normal * OFFSET;
    let basis = sampling::basis(normal);
    let shift = sampling::unit2(sampling::mix(i as u64));
    let mut sum = 0.0;
    for k in 0..count {
        let direction = basis * sampling::cosine_hemisphere(sampling::r2(k, shift));
        if let Some(hit) = rays.closest(origin, direction, f32::INFINITY) {
            let n = rays.geometry.triangles[hit.triangle as usize].normal;
            let n = if hit.back { -n } else { n };
            let p = origin + direction * hit.distance;
            sum += surfels.find(p, n).map_or(0.0, |j| f64::from(radiosity(j)));
        }
    }
    sum / f64::from(count)
}

/// (bias, mean absolute error) of one sweep against continuous rays, relative to the mean; light comes from one wall.
fn one_bounce(scene: &Scene, n: u32) -> (f64, f64) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let surfels = voxelized(&geometry, n);
    let mean = surfels.list.iter().map(|s| s.centroid).sum::<Vec3>() / surfels.list.len() as f32;
    // A smooth pattern, bright on one side of the room.
    let light = |i: usize| (1.0 + (surfels.list[i].centroid - mean).x / 1500.0).max(0.0);
    let radiosity: Vec<Rgb> = (0..surfels.list.len()).map(|i| Rgb::splat(light(i))).collect();
    let sweep = Sweep::new(&surfels, Rule::Surface, false);
    let directions = DirectionSet::Fibonacci.directions(512, 0);
    let e = sweep.apply(&directions, radiosity, None, true, &Silent).unwrap();
    let (mut bias, mut error, mut total) = (0.0, 0.0, 0.0);
    for i in (0..surfels.list.len()).step_by(17) {
        let exact = by_rays(&rays, &surfels, i, &light, 256);
        let area = f64::from(surfels.list[i].area);
        bias += area * (f64::from(e[i].x) - exact);
        error += area * (f64::from(e[i].x) - exact).abs();
        total += area * exact;
    }
    (bias / total, error / total)
}

#[test]
fn one_bounce_agrees_with_continuous_rays() {
    let mut b = Builder::new("open box");
    let white = b.matte(Vec3::splat(0.7));
    b.cuboid("room", Vec3::ZERO, Vec3::ONE, white, true);
    b.cuboid("block", Vec3::new(0.3, 0.001, 0.35), Vec3::new(0.6, 0.5, 0.65), white, false);
    // Without its front wall, the box is open.
    let open = b.scene_mut();
    open.meshes[0].triangles.truncate(10);
    let scene = b.build();
    for (scene, bound) in [(scene.clone(), 0.01), (tilted(scene), 0.015)] {
        let (bias, error) = one_bounce(&scene, 64);
        println!("one bounce: bias {:+.2} %, mean error {:.2} %", 100.0 * bias, 100.0 * error);
        assert!(bias.abs() < bound, "{bias}");
        assert!(error < 0.06, "{error}");
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    let scene = tilted(room_with_block(Vec3::ONE));
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 24);
    let sweep = Sweep::new(&surfels, Rule::Surface, false);
    let light: Vec<Rgb> = surfels.list.iter().map(|s| s.normal.abs()).collect();
    let directions = DirectionSet::Fibonacci.directions(256, 1);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| sweep.apply(&directions, light.clone(), Some(&|d| d.abs()), false, &Silent).unwrap())
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(7));
    // And one band is the first of three.
    let grey: Vec<Rgb> = light.iter().map(|l| Rgb::splat(l.x)).collect();
    let three = sweep.apply(&directions, grey.clone(), None, false, &Silent).unwrap();
    assert_eq!(three, sweep.apply(&directions, grey, None, true, &Silent).unwrap());
}

#[test]
fn orders_go_slice_by_slice_and_keep_voxels_together() {
    let scene = tilted(room_with_block(Vec3::ONE));
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 16);
    let planes = Planes::new(&surfels);
    for axis in 0..3 {
        let order = axis::order(&surfels, &planes, axis);
        let voxel = |i: &u32| surfels.list[*i as usize].voxel();
        assert!(order.is_sorted_by_key(|i| voxel(i)[axis]));
        let mut runs: Vec<_> = order.chunk_by(|a, b| voxel(a) == voxel(b)).map(|run| voxel(&run[0])).collect();
        let count = runs.len();
        runs.sort_by_key(|v| v.to_array());
        runs.dedup();
        assert_eq!(runs.len(), count, "a voxel is in two places");
        let copy = AxisCopy::new(&surfels, &planes, &[], axis, &order);
        let lone = copy.parts.windows(2).map(|p| p[0].shared - p[0].start).sum::<u32>() as usize;
        assert!(copy.parts.windows(2).all(|p| p[0].shared >= p[0].start && p[0].shared <= p[1].start));
        assert!(lone > surfels.list.len() / 2, "{lone} of {}", surfels.list.len());
        assert!(copy.patches.len() < lone / 3, "{} patches of {lone} surfels", copy.patches.len());
    }
}

#[test]
fn a_cell_of_the_ring_belongs_to_one_line_from_its_entry_to_its_exit() {
    let mut b = Builder::new("slab");
    let white = b.matte(Vec3::ONE);
    b.cuboid("slab", Vec3::ZERO, Vec3::new(1.0, 0.3, 0.6), white, true);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 20);
    let planes = Planes::new(&surfels);
    for axis in 0..3 {
        let order = axis::order(&surfels, &planes, axis);
        let copy = AxisCopy::new(&surfels, &planes, &[], axis, &order);
        let [slices, rows, columns] = copy.size;
        for direction in DirectionSet::Fibonacci.directions(60, 3) {
            if lines::dominant(direction.sigma) != axis {
                continue;
            }
            let lines = Lines::new(&copy, &direction);
            let slope = |k: usize| f64::from(direction.sigma[(axis + k) % 3]) / f64::from(direction.sigma[axis]);
            let floor = |k: usize, x: i32| (slope(k) * f64::from(x) + direction.phase[k - 1]).floor() as i32;
            let mut table = vec![None; lines.cells as usize];
            let mut before: Vec<(i32, i32)> = Vec::new();
            let along = (0..slices).map(|x| if lines.forward { x } else { slices - 1 - x });
            for x in along {
                let slice = &lines.slices[x as usize];
                if !before.is_empty() {
                    lines.enter(slice, &mut table, None);
                }
                let mut here = Vec::new();
                for (y, z) in (0..rows).flat_map(|y| (0..columns).map(move |z| (y, z))) {
                    let line = (y - floor(1, x), z - floor(2, x));
                    let cell = &mut table[lines.cell(y as u32 * copy.stride + z as u32, slice) as usize];
                    let known = before.contains(&line).then_some(line);
                    assert_eq!(*cell, known, "axis {axis}, slice {x}, voxel {y}, {z}");
                    *cell = Some(line);
                    here.push(line);
                }
                before = here;
            }
        }
    }
}

#[test]
fn the_way_between_surfels_of_a_line_is_that_of_their_centroids() {
    let scene = tilted(room_with_block(Vec3::ONE));
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 24);
    let planes = Planes::new(&surfels);
    for axis in 0..3 {
        let order = axis::order(&surfels, &planes, axis);
        let copy = AxisCopy::new(&surfels, &planes, &[], axis, &order);
        let place = |k: usize| {
            let s = &surfels.list[order[k] as usize];
            let local = surfels.grid.local(s.centroid);
            (s.voxel()[axis], Vec3::from([0, 1, 2].map(|turned| local[(axis + turned) % 3])))
        };
        let mut checked = 0;
        for direction in DirectionSet::Fibonacci.directions(60, 3) {
            if lines::dominant(direction.sigma) != axis {
                continue;
            }
            let lines = Lines::new(&copy, &direction);
            let mut table = vec![None; lines.cells as usize];
            for (part, first) in lines.order(&copy) {
                let range = copy.parts[part].start as usize..copy.parts[part + 1].start as usize;
                let slice = &lines.slices[copy.parts[part].slice as usize];
                if first {
                    lines.enter(slice, &mut table, None);
                }
                for k in range {
                    let before = table[lines.cell(copy.key(k), slice) as usize].replace(k);
                    let Some(before) = before.filter(|&j| (place(j).0 - place(k).0).abs() <= 3) else { continue };
                    let way = Vec3::from(copy.between(before, k, slice.apart(before as u32, lines.forward)));
                    let exact = place(k).1 - place(before).1;
                    assert!((way - exact).length() < 1e-4, "axis {axis}: {way} is {exact}");
                    checked += 1;
                }
            }
        }
        assert!(checked > 1000, "{checked}");
    }
}

#[test]
fn a_lamp_smaller_than_a_voxel_hides_its_share_and_no_more() {
    let mut b = Builder::new("lamp");
    let black = b.matte(Vec3::ZERO);
    b.quad("floor", Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, black);
    let n = 32;
    // A quarter of a voxel edge in size, at a height of an eighth of the floor.
    let h = 2.0 / n as f32;
    b.cuboid("lamp", Vec3::new(0.0, 0.25, 0.0), Vec3::new(0.25 * h, 0.25 + 0.25 * h, 0.25 * h), black, false);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, n);
    let sweep = Sweep::new(&surfels, Rule::Surface, false);
    let dark = vec![Rgb::ZERO; surfels.list.len()];
    let directions = DirectionSet::Fibonacci.directions(512, 0);
    let e = sweep.apply(&directions, dark, Some(&|_| Rgb::ONE), true, &Silent).unwrap();
    let hidden: f64 = surfels
        .list
        .iter()
        .zip(&e)
        .filter(|(s, _)| geometry.triangles[s.triangle as usize].instance == 0)
        .map(|(s, e)| f64::from(s.area) * (1.0 - f64::from(e.x) / std::f64::consts::PI))
        .sum();
    // The lamp intercepts at most the light that would fall on its six faces from above and around: area/2 at most.
    let frame = geometry.frame.scale;
    let lamp = 6.0 * f64::from(0.25 * h).powi(2) * frame * frame;
    println!("hidden {:.3} of the lamp's area", hidden / lamp);
    assert!(hidden < 1.5 * lamp && hidden > 0.1 * lamp, "{}", hidden / lamp);
}
