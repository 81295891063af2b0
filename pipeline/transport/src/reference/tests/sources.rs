//! Skies, lamps, suns and textured emitters over a plane.

use std::f32::consts::FRAC_PI_2;

use super::*;

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
