use std::f32::consts::PI;

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use luxel_scene::{
    Alpha, LightKind, Material, Scene, Silent, Sky, Texture, TextureRef, build::Builder, light::range_window,
    light::spot_falloff, sky::SkyImage,
};

use super::*;
use crate::geometry::Geometry;

mod sources;
mod surfaces;

/// A horizontal floor quad of side 2 about the origin, looking up; instance 0.
fn floor(name: &str, albedo: f32) -> Builder {
    let mut b = Builder::new(name);
    let grey = b.matte(Vec3::splat(albedo));
    b.quad("floor", Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0, grey);
    b
}

/// Estimates at the middle of the floor of [`floor`].
fn at_origin(scene: &Scene, options: Options, samples: u32) -> Estimate {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    Reference::new(&rays, options).irradiance(&Receiver::on_triangle(&geometry, 0, 0.0, 0.5, 1.0, 7), samples)
}

/// The estimate agrees with the closed form, and says so with the wanted accuracy (of the expected value).
#[track_caller]
fn check(estimate: f32, error: f32, expected: f32, accuracy: f32) {
    assert!(error <= accuracy * expected, "standard error {error} is more than {accuracy} of {expected}");
    let off = (estimate - expected).abs();
    // What f32 geometry does to a closed form is far below the noise, but not below no noise at all.
    assert!(off <= 3.5 * error + 3e-5 * expected, "{estimate} ± {error}, expected {expected}");
}

fn mean(v: Rgb) -> f32 {
    v.element_sum() / 3.0
}

/// Above a plane a walk is one ray up, and another to each lamp.
#[test]
fn rays_are_counted() {
    for lamps in 0..3u64 {
        let mut b = floor("plane", 0.5);
        b.scene_mut().sky = Sky::Constant(Vec3::ONE);
        for lamp in 0..lamps {
            let kind = LightKind::Point { position: DVec3::Y * (1.0 + lamp as f64), range: None, radius: 0.0 };
            b.light("lamp", kind, Vec3::ONE);
        }
        assert_eq!(at_origin(&b.build(), Options::default(), 100).rays, 100 * (1 + lamps));
    }
}

#[test]
fn a_furnace_has_the_irradiance_of_its_geometric_series() {
    for (i, albedo) in [0.0f32, 0.5, 0.8].into_iter().enumerate() {
        let mut b = Builder::new("furnace");
        let hot = b.emitter(Vec3::splat(albedo), Vec3::new(1.0, 2.0, 3.0));
        match i % 2 {
            0 => b.cuboid("box", Vec3::ZERO, Vec3::new(1.0, 2.0, 0.5), hot, true),
            _ => b.sphere("ball", Vec3::ZERO, 1.0, 12, hot, true),
        };
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        for triangle in [0, 3] {
            let receiver = Receiver::on_triangle(&geometry, triangle, 0.3, 0.3, 1.0, 1);
            let all = Reference::new(&rays, Options::default()).irradiance(&receiver, 1 << 14);
            check(mean(all.direct), all.direct_error, 2.0 * PI, 0.004);
            check(mean(all.total), all.standard_error, 2.0 * PI / (1.0 - albedo), 0.008);
            for band in 0..3 {
                let expected = (band + 1) as f32 * PI / (1.0 - albedo);
                check(all.total[band], all.band_error[band], expected, 0.008);
            }
            let twice = Options { bounces: Some(2), ..Options::default() };
            let twice = Reference::new(&rays, twice).irradiance(&receiver, 1 << 13);
            let expected = 2.0 * PI * (1.0 + albedo + albedo * albedo);
            check(mean(twice.total), twice.standard_error, expected, 0.008);
        }
    }
}

/// Lambert's formula for a polygon seen from a plane at the origin with normal +Y, radiance 1.
fn lambert(corners: &[Vec3]) -> f32 {
    let corners: Vec<DVec3> = corners.iter().map(|c| c.as_dvec3().normalize()).collect();
    let mut sum = 0.0;
    for (i, a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % corners.len()];
        let edge = a.cross(b);
        sum += libm::atan2(edge.length(), a.dot(b)) * edge.normalize().y;
    }
    (0.5 * sum.abs()) as f32
}

/// A parallelogram that looks down, and what it sends to the origin.
fn ceiling_lamp(o: Vec3, a: Vec3, b: Vec3) -> (Builder, f32) {
    let mut scene = floor("polygon", 0.0);
    let light = scene.emitter(Vec3::ZERO, Vec3::splat(10.0));
    scene.quad("light", o, a, b, light);
    (scene, 10.0 * lambert(&[o, o + a, o + a + b, o + b]))
}

#[test]
fn a_polygon_over_a_plane_is_lamberts() {
    let lamps = [
        (Vec3::new(-0.2, 1.0, -0.3), Vec3::X * 0.5, Vec3::Z * 0.5),
        // Close and large: the solid angle is nearly the hemisphere.
        (Vec3::new(-1.0, 0.02, -0.7), Vec3::X * 2.0, Vec3::Z * 2.0),
        // A small one far away.
        (Vec3::new(0.5, 3.0, 0.0), Vec3::X * 0.01, Vec3::Z * 0.01),
        // Upright, from the floor on.
        (Vec3::new(0.1, 1e-3, -0.5), Vec3::Z, Vec3::Y),
    ];
    for (o, a, b) in lamps {
        let (scene, expected) = ceiling_lamp(o, a, b);
        let scene = scene.build();
        let both = at_origin(&scene, Options::default(), 1 << 14);
        check(mean(both.direct), both.standard_error, expected, 0.004);
        assert_eq!(both.indirect, Rgb::ZERO);
    }
}

/// A lamp that shares an edge with the receiver's plane, the receiver next to it: neither technique alone is any good.
#[test]
fn the_power_heuristic_is_calm_where_emitter_and_receiver_touch() {
    for gap in [1e-2, 1e-3] {
        let mut b = floor("touch", 0.0);
        let light = b.emitter(Vec3::ZERO, Vec3::ONE);
        b.quad("light", Vec3::new(gap, 0.0, 1.0), Vec3::Z * -2.0, Vec3::Y * 0.5, light);
        // An infinitesimal patch and an upright rectangle from its plane on: the polygon formula's limit.
        let corners = [
            Vec3::new(gap, 1e-7, 1.0),
            Vec3::new(gap, 1e-7, -1.0),
            Vec3::new(gap, 0.5, -1.0),
            Vec3::new(gap, 0.5, 1.0),
        ];
        // The quad's front looks along (−Z) × Y = +X, away from the receiver at x < gap: turn it.
        let mut scene = b.build();
        scene.meshes[1].triangles.iter_mut().for_each(|t| t.swap(1, 2));
        let estimate = at_origin(&scene, Options::default(), 1 << 14);
        check(mean(estimate.direct), estimate.standard_error, lambert(&corners), 0.004);
    }
}

/// Two endless parallel plates, the upper one emitting: E_floor = πLₑ/(1 − ρ_floor ρ_ceiling), E_ceiling = ρ_floor
/// E_floor.
#[test]
fn two_parallel_plates_exchange_their_light() {
    let (low, high) = (0.5, 0.4);
    let mut b = Builder::new("plates");
    let cold = b.matte(Vec3::splat(low));
    let hot = b.emitter(Vec3::splat(high), Vec3::ONE);
    let side = 1000.0;
    b.quad("floor", Vec3::new(-side, 0.0, side), Vec3::X * 2.0 * side, Vec3::Z * -2.0 * side, cold);
    b.quad("ceiling", Vec3::new(-side, 0.5, -side), Vec3::X * 2.0 * side, Vec3::Z * 2.0 * side, hot);
    let scene = b.build();
    let e = at_origin(&scene, Options::default(), 1 << 13);
    check(mean(e.total), e.standard_error, PI / (1.0 - low * high), 0.01);
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let up = Receiver::on_triangle(&geometry, 2, 0.0, 0.5, 1.0, 3);
    let e = Reference::new(&rays, Options::default()).irradiance(&up, 1 << 13);
    check(mean(e.total), e.standard_error, low * PI / (1.0 - low * high), 0.01);
    assert_eq!(e.direct, Rgb::ZERO);
}

/// A room with everything in it: emitter, textured albedo, veil, sky through a hole, a tilted mirrored block.
fn room() -> Scene {
    let mut b = Builder::new("room");
    let white = b.matte(Vec3::new(0.7, 0.6, 0.5));
    let lamp = b.emitter(Vec3::splat(0.3), Vec3::new(8.0, 6.0, 3.0));
    let glass = b.material(Material {
        base_color: Vec3::new(0.9, 0.5, 0.5).extend(0.6),
        alpha: Alpha::Blend,
        double_sided: true,
        ..Material::default()
    });
    b.cuboid("walls", Vec3::ZERO, Vec3::ONE, white, true);
    b.quad("lamp", Vec3::new(0.4, 0.999, 0.4), Vec3::X * 0.2, Vec3::Z * 0.3, lamp);
    b.quad("curtain", Vec3::new(0.3, 0.0, 0.1), Vec3::Y * 0.9, Vec3::Z * 0.8, glass);
    let block = b.cuboid("block", Vec3::new(0.6, 0.0, 0.6), Vec3::new(0.8, 0.5, 0.8), white, false);
    b.scene_mut().instances[block].transform = DAffine3 {
        matrix3: DMat3::from_rotation_y(0.3) * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)),
        translation: DVec3::new(-0.1, 0.0, 1.3),
    };
    let mut scene = b.build();
    // Open the wall x = 0 to the sky.
    scene.meshes[0].triangles.drain(0..2);
    scene.sky = Sky::Gradient { zenith: Vec3::splat(2.0), horizon: Vec3::splat(0.5), ground: Vec3::splat(0.1) };
    scene
}

#[test]
fn next_events_and_blind_walks_agree() {
    let scene = room();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let (aimed, blind) = (
        Reference::new(&rays, Options::default()),
        Reference::new(&rays, Options { next_event: false, ..Options::default() }),
    );
    let mut chi = 0.0;
    let mut count = 0.0;
    for triangle in 0..geometry.triangles.len() as u32 {
        let receiver = Receiver::on_triangle(&geometry, triangle, 0.3, 0.4, 1.0, u64::from(triangle));
        let (a, b) = (aimed.irradiance(&receiver, 1 << 10), blind.irradiance(&receiver, 1 << 12));
        let variance = a.standard_error * a.standard_error + b.standard_error * b.standard_error;
        if variance > 0.0 {
            let z = (mean(a.total) - mean(b.total)) / variance.sqrt();
            assert!(z.abs() < 4.0, "triangle {triangle}: {a:?} {b:?}");
            chi += z * z;
            count += 1.0;
        }
    }
    // The sum of z² is χ² with `count` degrees of freedom: three of its standard deviations above the mean.
    assert!(count > 20.0 && chi < count + 3.0 * libm::sqrtf(2.0 * count), "χ² {chi} of {count}");
}

/// The stated error is the real one: 95 % intervals hold the truth in about 95 % of 200 independent runs.
#[test]
fn ninety_five_percent_intervals_hold_ninety_five_percent() {
    let (scene, expected) = ceiling_lamp(Vec3::new(-0.6, 0.4, -0.3), Vec3::X * 0.5, Vec3::Z * 0.5);
    let scene = scene.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let reference = Reference::new(&rays, Options::default());
    // Student's t, 31 degrees of freedom.
    let quantile = 2.0395;
    let held = (0..200).filter(|&seed| {
        let e = reference.irradiance(&Receiver::on_triangle(&geometry, 0, 0.0, 0.5, 1.0, seed), 256);
        (mean(e.total) - expected).abs() <= quantile * e.standard_error
    });
    // 190 ± 3.1: three standard deviations.
    let held = held.count();
    assert!((181..=199).contains(&held), "{held} of 200");
}

#[test]
fn the_same_receivers_give_the_same_bits_in_any_order_on_any_threads() {
    let scene = room();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let reference = Reference::new(&rays, Options::default());
    let mut receivers: Vec<_> = (0..20)
        .map(|i| Receiver::on_triangle(&geometry, i % geometry.triangles.len() as u32, 0.2, 0.5, 1.0, u64::from(i)))
        .collect();
    let on = |threads: usize, receivers: &[Receiver]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| reference.irradiances(receivers, 100, &Silent)).unwrap()
    };
    let (one, mut two) = (on(1, &receivers), on(2, &receivers));
    assert_eq!(one, two);
    receivers.reverse();
    two.reverse();
    assert_eq!(on(2, &receivers), two);
}

#[test]
fn a_scene_without_light_and_a_receiver_without_a_normal_get_nothing() {
    let scene = floor("dark", 0.8).build();
    let nothing = Estimate { rays: 64, ..Estimate::default() };
    assert_eq!(at_origin(&scene, Options::default(), 64), nothing, "a ray up from every walk");
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let mut receiver = Receiver::on_triangle(&geometry, 0, 0.3, 0.3, 1.0, 0);
    receiver.normal = Vec3::ZERO;
    assert_eq!(Reference::new(&rays, Options::default()).irradiance(&receiver, 64), Estimate::default());
}

/// With and without roulette, both to the twelfth reflection: the same light, and the roulette's walks are shorter.
#[test]
fn russian_roulette_changes_noise_and_nothing_else() {
    let scene = room();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let bounces = Some(12);
    let with = Reference::new(&rays, Options { bounces, ..Options::default() });
    let without = Reference::new(&rays, Options { bounces, roulette: false, ..Options::default() });
    let (mut chi, mut sum, mut count) = (0.0, 0.0, 0.0f32);
    for triangle in 0..geometry.triangles.len() as u32 {
        let at = |seed: u32| Receiver::on_triangle(&geometry, triangle, 0.3, 0.4, 1.0, u64::from(seed));
        let (a, b) = (with.irradiance(&at(triangle), 1 << 10), without.irradiance(&at(triangle + 1000), 1 << 10));
        assert_ne!(a.indirect, b.indirect);
        let variance = a.standard_error * a.standard_error + b.standard_error * b.standard_error;
        if variance > 0.0 {
            let z = (mean(a.total) - mean(b.total)) / variance.sqrt();
            chi += z * z;
            sum += z;
            count += 1.0;
        }
    }
    assert!(count > 20.0 && chi < count + 3.0 * libm::sqrtf(2.0 * count), "χ² {chi} of {count}");
    assert!(sum.abs() < 3.0 * count.sqrt(), "mean z {} of {count}", sum / count);
}

/// A furnace of albedo 0.9, whose light is mostly that of walks that roulette may end.
#[test]
fn roulette_keeps_the_light_of_long_walks() {
    let mut b = Builder::new("furnace");
    let hot = b.emitter(Vec3::splat(0.9), Vec3::ONE);
    b.cuboid("box", Vec3::ZERO, Vec3::ONE, hot, true);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let receiver = Receiver::on_triangle(&geometry, 0, 0.3, 0.3, 1.0, 1);
    let on = Reference::new(&rays, Options::default()).irradiance(&receiver, 1 << 14);
    check(mean(on.total), on.standard_error, 10.0 * PI, 0.01);
    let off = Reference::new(&rays, Options { roulette: false, bounces: Some(150), ..Options::default() });
    let off = off.irradiance(&receiver, 1 << 7);
    // 0.9¹⁵¹ is what the last reflections would bring. Every walk but for next events brings the same.
    let expected = 10.0 * PI * (1.0 - libm::powf(0.9, 151.0));
    check(mean(off.total), off.standard_error, expected, 0.01);
}
