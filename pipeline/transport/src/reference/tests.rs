use std::f32::consts::{FRAC_PI_2, PI};

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use luxel_scene::{
    Alpha, LightKind, Material, Scene, Silent, Sky, Texture, TextureRef, build::Builder, light::range_window,
    light::spot_falloff, sky::SkyImage,
};

use super::*;
use crate::geometry::Geometry;

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

#[test]
fn an_open_plane_under_a_constant_sky_gets_pi_times_its_radiance() {
    let mut b = floor("open", 0.5);
    b.scene_mut().sky = Sky::Constant(Vec3::new(1.0, 2.0, 6.0));
    let estimate = at_origin(&b.build(), Options::default(), 256);
    assert!(estimate.total.abs_diff_eq(Vec3::new(1.0, 2.0, 6.0) * PI, 1e-5), "{estimate:?}");
    assert_eq!(estimate.direct, Rgb::ZERO, "the sky is indirect light");
}

/// The cosine is the shading normal's, the horizon the geometric one's: under a constant sky π(1 + cos α)/2 is left.
#[test]
fn a_bent_normal_sees_what_is_above_both_horizons() {
    let mut b = floor("bent", 0.0);
    b.scene_mut().sky = Sky::Constant(Vec3::ONE);
    b.light("sun", LightKind::Sun { direction: DVec3::new(0.6, -0.8, 0.0), angle: 0.0 }, Vec3::splat(5.0));
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let mut receiver = Receiver::on_triangle(&geometry, 0, 0.0, 0.5, 1.0, 7);
    receiver.shading_normal = Vec3::new(0.8, 0.6, 0.0);
    let e = Reference::new(&rays, Options::default()).irradiance(&receiver, 1 << 14);
    check(mean(e.indirect), e.indirect_error, PI * (1.0 + 0.6) / 2.0, 0.004);
    assert!(e.direct.abs_diff_eq(Vec3::ZERO, 1e-5), "cos θ = −0.48 + 0.48: {}", e.direct);
}

#[test]
fn an_endless_wall_hides_half_of_the_sky() {
    let mut b = floor("wall", 0.0);
    b.scene_mut().sky = Sky::Constant(Vec3::ONE);
    let black = b.matte(Vec3::ZERO);
    b.quad("wall", Vec3::new(1e-4, -0.0, -1e3), Vec3::Z * 2e3, Vec3::Y * 1e3, black);
    let estimate = at_origin(&b.build(), Options::default(), 1 << 13);
    check(mean(estimate.total), estimate.standard_error, FRAC_PI_2, 0.005);
}

/// E = ∫ L cos θ dω of a gradient h + (z − h) sin e: π(h/3 + 2z/3).
#[test]
fn a_gradient_sky_is_its_integral() {
    let mut b = floor("gradient", 0.0);
    let (zenith, horizon, ground) = (Vec3::splat(4.0), Vec3::splat(1.0), Vec3::splat(50.0));
    b.scene_mut().sky = Sky::Gradient { zenith, horizon, ground };
    let estimate = at_origin(&b.build(), Options::default(), 1 << 12);
    check(mean(estimate.total), estimate.standard_error, 3.0 * PI, 0.002);
}

/// A sky of one bright disc of texels about an elevation of 45°, against the mean of many even directions.
#[test]
fn an_image_sky_with_a_small_sun_is_quiet_and_right() {
    let (width, height) = (64, 32);
    let mut texels = vec![Vec3::splat(0.1); (width * height) as usize];
    texels[(8 * width + 20) as usize] = Vec3::splat(2000.0);
    let sky = Sky::Image(SkyImage { width, height, texels, rotation: 0.7, strength: 1.5 });
    let (mut sum, n) = (0.0f64, 4_000_000);
    for i in 0..n {
        let d = crate::sampling::sphere(crate::sampling::r2(i, Vec2::splat(0.5)));
        sum += f64::from(sky.radiance(d).x) * f64::from(d.y.max(0.0));
    }
    let expected = (sum * 4.0 * std::f64::consts::PI / f64::from(n)) as f32;
    let mut b = floor("sun", 0.0);
    b.scene_mut().sky = sky;
    let scene = b.build();
    let estimate = at_origin(&scene, Options::default(), 1 << 13);
    check(mean(estimate.total), estimate.standard_error + 1e-3 * expected, expected, 0.008);
    let blind = at_origin(&scene, Options { next_event: false, ..Options::default() }, 1 << 13);
    assert!(blind.standard_error > 5.0 * estimate.standard_error, "{blind:?} {estimate:?}");
}

fn lamp_at(kind: LightKind) -> Estimate {
    let mut b = floor("lamp", 0.0);
    b.light("lamp", kind, Vec3::new(30.0, 60.0, 90.0));
    at_origin(&b.build(), Options::default(), 1 << 12)
}

#[test]
fn points_spots_and_suns_follow_their_formulas() {
    let position = DVec3::new(0.3, 2.0, -0.4);
    let squared = position.length_squared();
    let cosine = position.y / squared.sqrt();
    let bare = (60.0 * cosine / squared) as f32;
    let e = lamp_at(LightKind::Point { position, range: None, radius: 0.0 });
    check(mean(e.direct), e.standard_error, bare, 1e-5);
    assert!((e.direct.x * 3.0 - e.direct.z).abs() < 1e-4);
    let e = lamp_at(LightKind::Point { position, range: Some(2.5), radius: 0.0 });
    check(mean(e.direct), e.standard_error, bare * range_window(squared.sqrt(), Some(2.5)) as f32, 1e-5);
    let e = lamp_at(LightKind::Point { position, range: Some(2.0), radius: 0.0 });
    assert_eq!(e.total, Rgb::ZERO, "out of range");
    let spot = LightKind::Spot { position, direction: -DVec3::Y, inner: 0.1, outer: 0.5, range: None, radius: 0.0 };
    let e = lamp_at(spot);
    check(mean(e.direct), e.standard_error, bare * spot_falloff(cosine, 0.1, 0.5) as f32, 1e-5);
    let e = lamp_at(LightKind::Sun { direction: DVec3::new(0.6, -0.8, 0.0), angle: 0.0 });
    check(mean(e.direct), e.standard_error, 60.0 * 0.8, 1e-5);
    let e = lamp_at(LightKind::Sun { direction: DVec3::new(0.0, 1.0, 0.0), angle: 0.0 });
    assert_eq!(e.total, Rgb::ZERO, "light from below the horizon");
}

/// A luminous sphere above the horizon sends what a point does; a sun sends its illuminance whatever its size.
#[test]
fn a_lamp_of_any_size_sends_what_it_has() {
    for (radius, position) in [(1e-5, DVec3::Y), (0.2, DVec3::Y), (0.5, DVec3::new(0.4, 1.0, 0.2))] {
        let squared = position.length_squared();
        let expected = (60.0 * position.y / (squared * squared.sqrt())) as f32;
        let e = lamp_at(LightKind::Point { position, range: None, radius });
        check(mean(e.direct), e.standard_error, expected, 0.002);
    }
    for angle in [1e-4, 0.01, 0.5] {
        let e = lamp_at(LightKind::Sun { direction: DVec3::new(0.6, -0.8, 0.0), angle });
        check(mean(e.direct), e.standard_error, 60.0 * 0.8, 0.002);
    }
    // Around the receiver: E = πL = I/r².
    let e = lamp_at(LightKind::Point { position: DVec3::Y * 1e-3, range: None, radius: 0.5 });
    check(mean(e.direct), e.standard_error, 60.0 / 0.25, 0.02);
}

/// Half of a sphere lamp behind an edge gives half of its light: soft shadows.
#[test]
fn half_of_a_lamp_gives_half_of_its_light() {
    let kind = LightKind::Point { position: DVec3::Y, range: None, radius: 0.1 };
    let mut b = floor("half", 0.0);
    let black = b.matte(Vec3::ZERO);
    b.quad("edge", Vec3::new(0.0, 0.5, -1.0), Vec3::X, Vec3::Z * 2.0, black);
    b.light("lamp", kind, Vec3::splat(60.0));
    let e = at_origin(&b.build(), Options::default(), 1 << 14);
    check(mean(e.direct), e.standard_error, 30.0, 0.004);
}

/// Many lamps are chosen one at a time, and still add up.
#[test]
fn many_lamps_add_up() {
    let mut b = floor("many", 0.0);
    let mut expected = 0.0;
    for i in 0..40 {
        let p = crate::sampling::r2(i, Vec2::ZERO);
        let position = DVec3::new(f64::from(p.x) - 0.5, 0.3 + 0.02 * f64::from(i), f64::from(p.y) - 0.5);
        b.light("lamp", LightKind::Point { position, range: None, radius: 0.0 }, Vec3::splat(i as f32));
        expected += f64::from(i) * position.y / (position.length_squared() * position.length());
    }
    let e = at_origin(&b.build(), Options::default(), 1 << 12);
    check(mean(e.direct), e.standard_error, expected as f32, 0.001);
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

/// A veil over the floor, under a lamp, an emitter or a sky: light times its transmittance.
#[test]
fn a_veil_colours_what_it_lets_through() {
    let tint = Vec3::new(1.0, 0.5, 0.1);
    let glass = Material { base_color: tint.extend(1.0), transmission: 0.5, ..Material::default() };
    let smoke =
        Material { base_color: Vec3::ZERO.extend(0.5), alpha: Alpha::Blend, double_sided: true, ..Material::default() };
    // α = ½ black: (1 − α) · lerp(1, 0, α) = ¼.
    for (material, pass) in [(glass, tint * 0.5), (smoke, Vec3::splat(0.25))] {
        for source in 0..4 {
            let mut b = floor("veil", 0.0);
            match source {
                0 => b.light("p", LightKind::Point { position: DVec3::Y, range: None, radius: 0.0 }, Vec3::splat(2.0)),
                1 => b.light("s", LightKind::Sun { direction: -DVec3::Y, angle: 0.1 }, Vec3::splat(2.0)),
                2 => b.scene_mut().sky = Sky::Constant(Vec3::splat(2.0)),
                _ => {
                    let light = b.emitter(Vec3::ZERO, Vec3::splat(2.0));
                    b.quad("light", Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z, light);
                }
            }
            let open = at_origin(&b.scene_mut().clone(), Options { bounces: Some(0), ..Options::default() }, 1 << 12);
            let veil = b.material(material.clone());
            b.quad("veil", Vec3::new(-50.0, 0.3, -50.0), Vec3::X * 100.0, Vec3::Z * 100.0, veil);
            let e = at_origin(&b.build(), Options { bounces: Some(0), ..Options::default() }, 1 << 12);
            let error = e.standard_error.max(open.standard_error);
            for band in 0..3 {
                let expected = open.total[band] * pass[band];
                assert!(
                    (e.total[band] - expected).abs() <= 4.0 * error + 1e-3 * expected,
                    "source {source}: {e:?}, open {open:?}"
                );
            }
        }
    }
}

/// Above a veil of coverage ½ and albedo ρ under a constant sky, in front of nothing: the veil reflects its share.
#[test]
fn a_veil_reflects_its_covered_share() {
    let mut b = Builder::new("reflecting veil");
    let grey = b.matte(Vec3::ZERO);
    let side = 1000.0;
    b.quad("ceiling", Vec3::new(-1.0, 1.0, -1.0), Vec3::X * 2.0, Vec3::Z * 2.0, grey);
    let veil = Material { base_color: Vec3::splat(0.6).extend(0.5), alpha: Alpha::Blend, ..Material::default() };
    let veil = b.material(veil);
    b.quad("veil", Vec3::new(-side, 0.0, side), Vec3::X * 2.0 * side, Vec3::Z * -2.0 * side, veil);
    b.light("sun", LightKind::Sun { direction: DVec3::new(0.6, -0.8, 0.0), angle: 0.0 }, Vec3::splat(10.0));
    // The receiver is the small ceiling; its shadow falls at 0.75 beside the point below it and covers little.
    let e = at_origin(&b.build(), Options::default(), 1 << 14);
    let open = 0.5 * 0.6 * 8.0;
    // The shadow of the ceiling on the veil takes the share of its form factor.
    let corners = [(-0.25, -1.0), (1.75, -1.0), (1.75, 1.0), (-0.25, 1.0)].map(|(x, z)| Vec3::new(x, 1.0, z));
    check(mean(e.indirect), e.standard_error, open * (1.0 - lambert(&corners) / PI), 0.01);
}

/// A checker of holes over a sun: the texels decide.
#[test]
fn holes_are_holes() {
    let texels = vec![[255, 255, 255, 0], [255; 4]];
    let mask = Material {
        base_color_texture: Some(TextureRef::new(0)),
        alpha: Alpha::Mask(0.5),
        double_sided: true,
        ..Material::default()
    };
    for (shift, expected) in [(0.3, 10.0), (-0.3, 0.0)] {
        let mut b = floor("mask", 0.0);
        b.scene_mut().textures.push(Texture {
            name: "mask".into(),
            width: 2,
            height: 1,
            srgb: false,
            texels: texels.clone(),
        });
        let mask = b.material(mask.clone());
        b.quad("leaf", Vec3::new(shift - 0.5, 0.5, -0.5), Vec3::X, Vec3::Z, mask);
        b.light("sun", LightKind::Sun { direction: -DVec3::Y, angle: 0.0 }, Vec3::splat(10.0));
        assert_eq!(at_origin(&b.build(), Options::default(), 64).direct, Rgb::splat(expected), "{shift}");
    }
}

/// A single-sided back blocks, absorbs and emits nothing; a double-sided one emits and reflects like the front.
#[test]
fn backs_are_black_unless_double_sided() {
    for double_sided in [false, true] {
        let mut b = floor("back", 0.0);
        let light = b.material(Material {
            base_color: Vec3::splat(0.5).extend(1.0),
            emission: Vec3::ONE,
            double_sided,
            ..Material::default()
        });
        b.scene_mut().sky = Sky::Constant(Vec3::ONE);
        // Looks up, so the floor sees its back.
        b.quad("sheet", Vec3::new(-900.0, 0.1, 900.0), Vec3::X * 1800.0, Vec3::Z * -1800.0, light);
        let e = at_origin(&b.build(), Options::default(), 1 << 12);
        check(mean(e.direct) + 1.0, e.direct_error, if double_sided { PI } else { 0.0 } + 1.0, 0.005);
        assert!(double_sided || mean(e.total) < 0.01, "{e:?}");
    }
}

/// An emissive texture, half of it dark, on a lamp that only the dark half would reach.
#[test]
fn textured_emitters_shine_where_they_shine() {
    let mut b = floor("textured", 0.0);
    let texels = (0..64 * 64).map(|i| if i % 64 < 32 { [0, 0, 0, 255] } else { [255; 4] }).collect();
    b.scene_mut().textures.push(Texture { name: "half".into(), width: 64, height: 64, srgb: false, texels });
    let light = b.material(Material {
        base_color: Vec3::ZERO.extend(1.0),
        emission: Vec3::ONE,
        emissive_texture: Some(TextureRef::new(0)),
        ..Material::default()
    });
    b.quad("light", Vec3::new(-1.0, 0.7, -1.0), Vec3::X * 2.0, Vec3::Z * 2.0, light);
    let corners = [(0.0, -1.0), (1.0, -1.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, z)| Vec3::new(x, 0.7, z));
    let e = at_origin(&b.build(), Options::default(), 1 << 14);
    check(mean(e.direct), e.standard_error, lambert(&corners), 0.004);
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
    assert_eq!(at_origin(&scene, Options::default(), 64), Estimate::default());
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let mut receiver = Receiver::on_triangle(&geometry, 0, 0.3, 0.3, 1.0, 0);
    receiver.normal = Vec3::ZERO;
    assert_eq!(Reference::new(&rays, Options::default()).irradiance(&receiver, 64), Estimate::default());
}
