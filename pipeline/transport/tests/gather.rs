//! The modes of the gather against closed forms and against each other.

mod common;

use common::{gradient, receivers, room, room_with_block, solution, surfels};
use glam::Vec3;
use luxel_scene::{Alpha, Material, Scene, Silent, build::Builder};
use luxel_transport::{
    Rgb,
    gather::{Field, FieldError, FinalGather, Gather, Gathered, Lightcuts, Lookup, Receiver, lightcuts, refresh},
    geometry::Geometry,
    lights::Emitters,
    lighttree::emitter_samples,
    rays::Rays,
    surfel::{Grid, Solution, Surfel, Surfels},
};

/// Runs `test` with everything that a gather needs.
fn with(scene: &Scene, n: u32, light: impl Fn(Vec3, Vec3) -> Rgb, test: impl FnOnce(&Field, &Geometry, &Surfels)) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let surfels = surfels(&geometry, n);
    let solution = solution(&surfels, light);
    let field = Field::new(&rays, &surfels, &solution).unwrap();
    test(&field, &geometry, &surfels);
}

fn run(gather: &dyn Gather, receivers: &[Receiver]) -> Vec<Gathered> {
    gather.gather(receivers, &Silent).unwrap()
}

/// Root mean square, mean and largest relative difference of the band means.
fn compare(a: &[Gathered], b: &[Gathered]) -> (f32, f32, f32) {
    let mean = |g: &Gathered| g.irradiance.element_sum() / 3.0;
    let scale = b.iter().map(mean).sum::<f32>() / b.len() as f32;
    let d: Vec<f32> = a.iter().zip(b).map(|(a, b)| (mean(a) - mean(b)) / scale).collect();
    let rms = (d.iter().map(|d| d * d).sum::<f32>() / d.len() as f32).sqrt();
    (rms, d.iter().sum::<f32>() / d.len() as f32, d.iter().map(|d| d.abs()).fold(0.0, f32::max))
}

/// A full cut: every surfel for itself.
fn all_lights() -> lightcuts::Settings {
    lightcuts::Settings { threshold: 0.0, limit: u32::MAX, ..Default::default() }
}

#[test]
fn a_furnace_is_constant_at_every_texel_in_every_mode() {
    // E = 10, ρ = 0.5 everywhere: every receiver gets B = 5.
    for scene in [room(0.5), room_with_block(0.5)] {
        with(
            &scene,
            16,
            |_, _| Rgb::splat(10.0),
            |field, geometry, surfels| {
                let receivers = receivers(geometry, surfels, 1);
                let cuts = Lightcuts::new(field, Default::default());
                assert!(cuts.covered());
                for g in run(&cuts, &receivers).iter().chain(&run(&FinalGather::new(field, 64), &receivers)) {
                    assert!((g.irradiance - 5.0).abs().max_element() < 0.005 * 5.0, "{}", g.irradiance);
                }
                for g in run(&Lookup::new(field), &receivers) {
                    assert!((g.irradiance - 10.0).abs().max_element() < 1e-4);
                }
            },
        );
    }
}

#[test]
fn black_walls_reflect_nothing() {
    with(&room(0.0), 12, gradient, |field, geometry, surfels| {
        let receivers = receivers(geometry, surfels, 3);
        let cuts = Lightcuts::new(field, Default::default());
        for g in run(&cuts, &receivers).iter().chain(&run(&FinalGather::new(field, 64), &receivers)) {
            assert_eq!((g.irradiance, g.bound), (Rgb::ZERO, 0.0));
        }
    });
}

/// Irradiance at p (unit normal n) from a polygon of radiosity 1 that lies above p's horizon: Lambert's formula.
fn lambert(p: Vec3, n: Vec3, polygon: &[Vec3]) -> f32 {
    let d: Vec<Vec3> = polygon.iter().map(|q| (*q - p).normalize()).collect();
    let edge = |i: usize| {
        let (a, b) = (d[i], d[(i + 1) % d.len()]);
        a.cross(b).normalize_or_zero().dot(n) * libm::acosf(a.dot(b).clamp(-1.0, 1.0))
    };
    ((0..d.len()).map(edge).sum::<f32>() / std::f32::consts::TAU).abs()
}

/// The world corners of an instance's quad, in frame units.
fn quad(geometry: &Geometry, instance: usize) -> [Vec3; 4] {
    let t = geometry.first[instance] as usize;
    let [a, b, c] = geometry.triangles[t].corners;
    [a, b, c, geometry.triangles[t + 1].corners[2]]
}

/// A lit quad over a black floor, and receivers on the floor at the given places.
fn over_floor(lit: [Vec3; 3], glows: bool, places: &[(f32, f32)], test: impl FnOnce(&Field, &[Receiver], &[f32])) {
    let mut b = Builder::new("quad over floor");
    let black = b.matte(Vec3::ZERO);
    let bright =
        if glows { b.emitter(Vec3::ZERO, Vec3::ONE / std::f32::consts::PI) } else { b.matte(Vec3::splat(0.5)) };
    b.quad("floor", Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, black);
    b.quad("lit", lit[0], lit[1], lit[2], bright);
    // Radiosity 1 all over: half of an irradiance of 2, or π times a radiance of 1/π.
    with(
        &b.build(),
        64,
        |_, _| Rgb::splat(2.0),
        |field, geometry, _| {
            let receivers: Vec<Receiver> =
                places.iter().map(|&(u, v)| Receiver::on_triangle(geometry, 0, u, v, 1.0, (u * 1e6) as u64)).collect();
            let polygon = quad(geometry, 1);
            let exact: Vec<f32> = receivers.iter().map(|r| lambert(r.position, r.normal, &polygon)).collect();
            test(field, &receivers, &exact);
        },
    );
}

#[test]
fn a_parallel_plate_gives_its_exact_form_factor() {
    let plate = [Vec3::new(-0.8, 0.5, -0.6), Vec3::X * 1.2, Vec3::Z];
    over_floor(plate, false, &[(0.3, 0.4), (0.1, 0.2), (0.05, 0.9), (0.33, 0.6)], |field, receivers, exact| {
        let cuts = Lightcuts::new(field, lightcuts::Settings::default());
        assert!(!cuts.covered());
        let full = run(&Lightcuts::new(field, all_lights()), receivers);
        let rays = run(&FinalGather::new(field, 4096), receivers);
        for (i, g) in run(&cuts, receivers).iter().enumerate() {
            let of = |g: &Gathered| g.irradiance.x / exact[i];
            assert!((of(&full[i]) - 1.0).abs() < 2e-3, "all lights: {}", of(&full[i]));
            // Three standard deviations of independent rays; a lattice is better than that.
            let error = 3.0 * (exact[i] * (1.0 - exact[i]) / 4096.0).sqrt();
            assert!((rays[i].irradiance.x - exact[i]).abs() < error, "rays: {}", of(&rays[i]));
            assert!((of(g) - 1.0).abs() < 3e-2, "cut: {}", of(g));
        }
    });
}

#[test]
fn close_to_a_lit_wall_the_rays_replace_what_the_bounded_kernel_loses() {
    // The wall stands on the floor along x = 0.2; voxels have an edge of 1/32. Receivers 0.1, 0.5 and 2 voxels from it.
    let wall = [Vec3::new(0.2, 0.0, -0.9), Vec3::Z * 1.8, Vec3::Y * 0.9];
    let near = |voxels: f32| (0.5, (1.2 - voxels / 32.0) / 2.0);
    over_floor(wall, false, &[near(0.1), near(0.5), near(2.0)], |field, receivers, exact| {
        let settings = lightcuts::Settings { near_rays: 256, ..all_lights() };
        for (g, exact) in run(&Lightcuts::new(field, settings), receivers).iter().zip(exact) {
            assert!((g.irradiance.x / exact - 1.0).abs() < 0.02, "{} against {exact}", g.irradiance.x);
        }
        // Many receivers with few rays each: no bias.
        let many: Vec<Receiver> = (0..400).map(|seed| Receiver { seed, ..receivers[0] }).collect();
        let mean = run(&Lightcuts::new(field, all_lights()), &many).iter().map(|g| g.irradiance.x).sum::<f32>() / 400.0;
        assert!((mean / exact[0] - 1.0).abs() < 0.01, "{mean} against {}", exact[0]);
    });
}

#[test]
fn samples_of_an_emitter_light_like_the_emitter() {
    let lamp = [Vec3::new(-0.3, 0.4, -0.2), Vec3::X * 0.5, Vec3::Z * 0.4];
    over_floor(lamp, true, &[(0.4, 0.45), (0.1, 0.2), (0.05, 0.9)], |field, receivers, exact| {
        let emitters = Emitters::new(field.rays.geometry);
        let cuts = |indirect| {
            let settings = lightcuts::Settings { indirect, ..Default::default() };
            Lightcuts::with_emitters(field, settings, emitter_samples(&emitters.areas, 1000), &Silent).unwrap()
        };
        for (g, exact) in run(&cuts(false), receivers).iter().zip(exact) {
            assert!((g.irradiance.x / exact - 1.0).abs() < 0.02, "{} against {exact}", g.irradiance.x);
        }
        // Reflected and emitted light under one root.
        for (g, exact) in run(&cuts(true), receivers).iter().zip(exact) {
            assert!((g.irradiance.x / exact - 1.0).abs() < 0.02, "{} against {exact}", g.irradiance.x);
        }
    });
}

#[test]
fn a_finer_threshold_converges_to_all_lights_within_the_stated_bound() {
    with(&room_with_block(0.5), 16, gradient, |field, geometry, surfels| {
        let receivers = receivers(geometry, surfels, 7);
        let full = run(&Lightcuts::new(field, all_lights()), &receivers);
        assert!(full.iter().all(|g| g.bound == 0.0));
        let mut last = f32::INFINITY;
        for threshold in [0.1, 0.02, 0.004] {
            let settings = lightcuts::Settings { threshold, limit: u32::MAX, ..Default::default() };
            let cut = run(&Lightcuts::new(field, settings), &receivers);
            for (a, b) in cut.iter().zip(&full) {
                let off = (a.irradiance - b.irradiance).element_sum().abs() / 3.0;
                assert!(off <= a.bound + 1e-4, "{off} above the bound {}", a.bound);
            }
            let (rms, _, _) = compare(&cut, &full);
            assert!(rms < 0.7 * last && rms < threshold, "{rms} at {threshold} after {last}");
            last = rms;
        }
        // A limit ends the cut early, and the bound says so.
        let short = lightcuts::Settings { limit: 40, ..Default::default() };
        let (short, long) = (
            run(&Lightcuts::new(field, short), &receivers),
            run(&Lightcuts::new(field, Default::default()), &receivers),
        );
        assert!(short.iter().all(|g| g.cut <= 40));
        let bound = |g: &[Gathered]| g.iter().map(|g| g.bound).sum::<f32>();
        assert!(bound(&short) > bound(&long));
    });
}

#[test]
fn lightcuts_agree_with_a_final_gather() {
    for scene in [room(0.5), room_with_block(0.5)] {
        with(&scene, 24, gradient, |field, geometry, surfels| {
            let receivers = receivers(geometry, surfels, 23);
            let rays = run(&FinalGather::new(field, 2048), &receivers);
            let cuts = run(&Lightcuts::new(field, Default::default()), &receivers);
            let (rms, bias, worst) = compare(&cuts, &rays);
            assert!(rms < 0.02 && bias.abs() < 0.005 && worst < 0.1, "{rms} {bias} {worst}");
            let (rms, bias, _) = compare(&run(&FinalGather::new(field, 256), &receivers), &rays);
            assert!(rms < 0.015 && bias.abs() < 0.002, "{rms} {bias}");
        });
    }
}

#[test]
fn a_bent_shading_normal_sees_its_share_of_the_furnace() {
    with(
        &room(0.5),
        16,
        |_, _| Rgb::splat(10.0),
        |field, geometry, surfels| {
            let mut receivers = receivers(geometry, surfels, 11);
            for r in &mut receivers {
                let tangent = r.normal.any_orthonormal_vector();
                r.shading_normal = (r.normal + tangent).normalize();
            }
            let exact = 5.0 * 0.5 * (1.0 + std::f32::consts::FRAC_1_SQRT_2);
            for g in run(&Lightcuts::new(field, Default::default()), &receivers) {
                assert!((g.irradiance.x / exact - 1.0).abs() < 0.005, "{} against {exact}", g.irradiance.x);
            }
            for g in run(&FinalGather::new(field, 4096), &receivers) {
                assert!((g.irradiance.x / exact - 1.0).abs() < 0.005, "{} against {exact}", g.irradiance.x);
            }
        },
    );
}

#[test]
fn a_symmetric_room_lights_symmetric_places_alike() {
    // Only the ceiling shines; the middles of the four walls see the same.
    let light = |_: Vec3, n: Vec3| if n.y < -0.5 { Rgb::splat(10.0) } else { Rgb::ZERO };
    with(&room(0.5), 24, light, |field, geometry, _| {
        let walls = geometry.triangles.iter().enumerate().filter(|(_, t)| t.normal.y.abs() < 0.5 && t.index % 2 == 0);
        // The middle of the diagonal is the middle of the wall.
        let receivers: Vec<Receiver> = walls
            .map(|(i, _)| {
                let [a, b, c] = geometry.triangles[i].corners;
                let (u, v) = if (b - a).length() > (c - a).length() { (0.5, 0.0) } else { (0.0, 0.5) };
                Receiver::on_triangle(geometry, i as u32, u, v, 1.0, 3)
            })
            .collect();
        assert_eq!(receivers.len(), 4);
        // A unit square at right angles to the wall's normal, seen from the wall's middle.
        let ceiling = [Vec3::new(-1.0, 1.0, -1.0), Vec3::new(1.0, 1.0, -1.0), Vec3::ONE, Vec3::new(-1.0, 1.0, 1.0)];
        let exact = 5.0 * lambert(Vec3::new(-1.0, 0.0, 0.0), Vec3::X, &ceiling);
        let fine = lightcuts::Settings { threshold: 0.002, ..Default::default() };
        for gather in [&Lightcuts::new(field, fine) as &dyn Gather, &FinalGather::new(field, 4096)] {
            for g in run(gather, &receivers) {
                assert!((g.irradiance.x / exact - 1.0).abs() < 0.01, "{} against {exact}", g.irradiance.x);
            }
        }
    });
}

#[test]
fn a_veil_lets_its_share_through() {
    // Black glass of α = ½: what passes is (1 − α)·(1 − α) of the light.
    let scene = |veiled: bool| {
        let mut b = Builder::new("veil");
        let (black, lit) = (b.matte(Vec3::ZERO), b.matte(Vec3::splat(0.5)));
        let glass = b.material(Material {
            base_color: Vec3::ZERO.extend(0.5),
            alpha: Alpha::Blend,
            double_sided: true,
            ..Material::default()
        });
        b.quad("floor", Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, black);
        b.quad("lit", Vec3::new(-0.8, 0.5, -0.6), Vec3::X * 1.2, Vec3::Z, lit);
        if veiled {
            b.quad("veil", Vec3::new(-1.0, 0.25, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, glass);
        }
        b.build()
    };
    let gathered = |veiled: bool| {
        let mut found = Vec::new();
        with(
            &scene(veiled),
            32,
            |_, _| Rgb::splat(2.0),
            |field, geometry, _| {
                let receivers = [Receiver::on_triangle(geometry, 0, 0.3, 0.4, 1.0, 1)];
                found.extend(run(&Lightcuts::new(field, all_lights()), &receivers));
                found.extend(run(&FinalGather::new(field, 1024), &receivers));
            },
        );
        found
    };
    for (veiled, free) in gathered(true).iter().zip(gathered(false)) {
        let share = veiled.irradiance.x / free.irradiance.x;
        assert!((share - 0.25).abs() < 1e-3, "{share}");
    }
}

#[test]
fn a_back_shines_only_where_it_is_a_side_of_its_own() {
    // A sheet over the floor that turns its back to it: E is 2 on its front and 6 on its back, ρ = ½.
    let gathered = |double_sided: bool| {
        let mut b = Builder::new("sheet");
        let black = b.matte(Vec3::ZERO);
        let base_color = Vec3::splat(0.5).extend(1.0);
        let sheet = b.material(Material { base_color, double_sided, ..Material::default() });
        b.quad("floor", Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, black);
        b.quad("sheet", Vec3::new(-0.8, 0.5, -0.6), Vec3::Z, Vec3::X * 1.2, sheet);
        let mut found = Vec::new();
        let light = |_: Vec3, n: Vec3| Rgb::splat(if n.y > 0.0 { 2.0 } else { 6.0 });
        with(&b.build(), 32, light, |field, geometry, _| {
            let receivers = [Receiver::on_triangle(geometry, 0, 0.3, 0.4, 1.0, 1)];
            let exact = 3.0 * lambert(receivers[0].position, receivers[0].normal, &quad(geometry, 1));
            for gather in [&Lightcuts::new(field, all_lights()) as &dyn Gather, &FinalGather::new(field, 4096)] {
                found.push(run(gather, &receivers)[0].irradiance.x / exact);
            }
        });
        found
    };
    assert!(gathered(true).iter().all(|share| (share - 1.0).abs() < 0.02), "{:?}", gathered(true));
    assert_eq!(gathered(false), [0.0, 0.0]);
}

#[test]
fn a_look_up_does_not_reach_through_a_thin_wall() {
    // A wall a tenth of a voxel thick between a bright and a dark half of the floor.
    let mut b = Builder::new("divided");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0, grey);
    b.cuboid("wall", Vec3::new(0.2, -0.1, -1.1), Vec3::new(0.203, 0.9, 1.1), grey, false);
    // The frame of a scene that is 2.2 long has 1024 units to one.
    let light = |p: Vec3, _: Vec3| if p.x < 0.2015 * 1024.0 { Rgb::ONE } else { Rgb::ZERO };
    with(&b.build(), 32, light, |field, geometry, surfels| {
        let receivers: Vec<Receiver> = receivers(geometry, surfels, 1)
            .into_iter()
            .filter(|r| r.normal.y > 0.5 && r.position.y < 0.0)
            // One voxel is split by the wall: its surfel is both bright and dark.
            .filter(|r| (r.position.x - 0.2015 * 1024.0).abs() > 1.1 * surfels.grid.edge)
            .collect();
        assert!(receivers.len() > 500);
        for (r, g) in receivers.iter().zip(run(&Lookup::new(field), &receivers)) {
            let expected = light(r.position, r.normal);
            assert!((g.irradiance - expected).abs().max_element() < 1e-5, "{} at {}", g.irradiance, r.position);
        }
    });
}

#[test]
fn a_refresh_applies_the_operator_once() {
    // A closed furnace: E = 10 becomes ρE = 5 everywhere. Under an open sky an empty floor gets πL.
    with(
        &room_with_block(0.5),
        16,
        |_, _| Rgb::splat(10.0),
        |field, _, _| {
            let next = refresh(field, 64, &|_| Rgb::splat(1e6), &Silent).unwrap();
            assert!(next.indirect.iter().all(|e| (*e - 5.0).abs().max_element() < 1e-4));
            assert_eq!(next.direct, field.solution.direct);
        },
    );
    let mut b = Builder::new("floor");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::ZERO, Vec3::Z, Vec3::X, grey);
    with(
        &b.build(),
        8,
        |_, _| Rgb::ZERO,
        |field, _, _| {
            let next = refresh(field, 64, &|_| Rgb::splat(2.0), &Silent).unwrap();
            let exact = std::f32::consts::TAU;
            assert!(next.indirect.iter().all(|e| (*e - exact).abs().max_element() < 1e-4));
        },
    );
}

#[test]
fn every_mode_gives_the_same_bytes_on_any_number_of_threads() {
    with(&room_with_block(0.5), 16, gradient, |field, geometry, surfels| {
        let receivers = receivers(geometry, surfels, 5);
        let all = || {
            let mut found = run(&Lightcuts::new(field, Default::default()), &receivers);
            found.extend(run(&FinalGather::new(field, 64), &receivers));
            found.extend(run(&Lookup::new(field), &receivers));
            let refreshed = refresh(field, 16, &|_| Rgb::ZERO, &Silent).unwrap();
            let bits = |v: Rgb| v.to_array().map(f32::to_bits);
            let mut bytes: Vec<[u32; 3]> = refreshed.indirect.into_iter().map(bits).collect();
            bytes.extend(found.iter().map(|g| bits(g.irradiance)));
            bytes.extend(found.iter().map(|g| [g.bound.to_bits(), g.rays, g.cut]));
            bytes
        };
        let on = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(all);
        let one = on(1);
        assert!(one == on(2) && one == on(7));
    });
}

#[test]
fn receivers_in_awkward_places_get_finite_light() {
    with(&room_with_block(0.5), 12, gradient, |field, geometry, surfels| {
        let mut receivers = Vec::new();
        // Corners and edges of every triangle, and exactly on every surfel.
        for t in 0..geometry.triangles.len() as u32 {
            for (u, v) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5)] {
                receivers.push(Receiver::on_triangle(geometry, t, u, v, 1.0, u64::from(t)));
            }
        }
        let first = receivers[0];
        let on = |s: &Surfel| Receiver { position: s.centroid, normal: s.normal, shading_normal: s.normal, ..first };
        receivers.extend(surfels.list.iter().map(on));
        // Inside the block, and outside the room.
        receivers.push(Receiver { position: Vec3::new(-200.0, -200.0, 0.0), ..first });
        receivers.push(Receiver { position: Vec3::splat(9000.0), ..first });
        let modes: [&dyn Gather; 3] =
            [&Lightcuts::new(field, Default::default()), &FinalGather::new(field, 16), &Lookup::new(field)];
        for mode in modes {
            for g in run(mode, &receivers) {
                assert!(g.irradiance.is_finite() && g.irradiance.min_element() >= 0.0 && g.bound.is_finite());
            }
        }
    });
}

#[test]
fn nothing_lights_nothing() {
    let scene = room(0.5);
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let surfels = Surfels::dark(Grid { origin: Vec3::ZERO, edge: 1.0, size: glam::IVec3::ONE }, Vec::new());
    let solution = Solution::default();
    let field = Field::new(&rays, &surfels, &solution).unwrap();
    let receivers = [Receiver::on_triangle(&geometry, 0, 0.3, 0.3, 1.0, 1)];
    let modes: [&dyn Gather; 3] =
        [&Lightcuts::new(&field, Default::default()), &FinalGather::new(&field, 16), &Lookup::new(&field)];
    for mode in modes {
        assert_eq!(run(mode, &receivers)[0].irradiance, Rgb::ZERO);
        assert!(run(mode, &[]).is_empty());
    }
    assert!(refresh(&field, 16, &|_| Rgb::ONE, &Silent).unwrap().indirect.is_empty());
}

#[test]
fn a_field_of_parts_that_do_not_belong_together_is_refused() {
    let scene = room(0.5);
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let good = surfels(&geometry, 4);
    let light = solution(&good, |_, _| Rgb::ONE);
    assert!(Field::new(&rays, &good, &light).is_ok());
    assert!(matches!(Field::new(&rays, &good, &Solution::default()), Err(FieldError::Lengths { .. })));
    let mut bad = good.clone();
    bad.list[3].triangle = 12;
    assert!(matches!(Field::new(&rays, &bad, &light), Err(FieldError::Triangle { surfel: 3, triangle: 12, .. })));
    let mut bad = light.clone();
    bad.indirect[5].y = f32::NAN;
    assert!(matches!(Field::new(&rays, &good, &bad), Err(FieldError::Value { surfel: 5 })));
    bad.indirect[5].y = -1.0;
    assert!(matches!(Field::new(&rays, &good, &bad), Err(FieldError::Value { surfel: 5 })));
    let mut bad = good.clone();
    bad.grid.edge = 0.0;
    assert!(matches!(Field::new(&rays, &bad, &light), Err(FieldError::Edge)));
}
