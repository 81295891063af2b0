use glam::DVec3;
use luxel_scene::{Alpha, Material, Scene, Silent, build::Builder, sky::SkyImage};

use super::*;
use crate::geometry::Geometry;

fn ground(sky: Sky) -> Builder {
    let mut b = Builder::new("ground");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::new(-10.0, 0.0, 10.0), Vec3::X * 20.0, Vec3::NEG_Z * 20.0, grey);
    b.scene_mut().sky = sky;
    b
}

/// Sky irradiance of `count` upward receivers at a place, each with a seed of its own.
fn at(scene: &Scene, place: DVec3, normal: Vec3, count: u64) -> Vec<Rgb> {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let position = geometry.frame.point(place);
    let receivers: Vec<_> =
        (0..count).map(|seed| Receiver { position, normal, shading_normal: normal, footprint: 1.0, seed }).collect();
    let light = SkyLight::new(&rays, SkySettings::default());
    light.gather(&receivers, &Silent).unwrap().iter().map(|g| g.irradiance).collect()
}

/// Mean, and RMSE against the exact value, of the first band.
fn statistics(e: &[Rgb], exact: f32) -> (f32, f32) {
    let n = e.len() as f32;
    (e.iter().map(|e| e.x).sum::<f32>() / n, (e.iter().map(|e| (e.x - exact) * (e.x - exact)).sum::<f32>() / n).sqrt())
}

#[test]
fn an_open_plane_under_a_constant_sky_gets_pi_l() {
    let radiance = Vec3::new(1.0, 2.0, 3.0);
    for e in at(&ground(Sky::Constant(radiance)).build(), DVec3::ZERO, Vec3::Y, 16) {
        assert!((e - radiance * PI).abs().max_element() < 1e-4, "{e}");
    }
}

#[test]
fn a_wall_hides_half_of_the_sky_at_its_foot() {
    let mut b = ground(Sky::Constant(Vec3::ONE));
    let grey = b.matte(Vec3::ONE);
    b.quad("wall", Vec3::new(0.0, -1.0, 4000.0), Vec3::Y * 4000.0, Vec3::NEG_Z * 8000.0, grey);
    let scene = b.build();
    for x in [-0.01, 0.01] {
        let e = at(&scene, DVec3::new(x, 0.0, 0.0), Vec3::Y, 256);
        let (mean, rmse) = statistics(&e, 0.5 * PI);
        assert!((mean - 0.5 * PI).abs() < 2e-3 * PI && rmse < 0.01 * 0.5 * PI, "{x}: {mean} {rmse}");
    }
}

#[test]
fn a_wall_of_known_height_hides_its_known_share() {
    // An endless wall of height h at distance d leaves the share ½(1 + d/√(h² + d²)) of a constant sky.
    let mut b = ground(Sky::Constant(Vec3::ONE));
    let grey = b.matte(Vec3::ONE);
    b.quad("wall", Vec3::new(0.0, 0.0, 4000.0), Vec3::Y * 2.0, Vec3::NEG_Z * 8000.0, grey);
    let e = at(&b.build(), DVec3::new(1.5, 0.0, 0.0), Vec3::Y, 256);
    let exact = 0.5 * PI * (1.0 + 1.5 / 2.5);
    let (mean, rmse) = statistics(&e, exact);
    assert!((mean - exact).abs() < 2e-3 * exact && rmse < 0.01 * exact, "{mean} {rmse} {exact}");
}

#[test]
fn a_gradient_sky_gives_its_integral() {
    // L = a + b sin(elevation): E = π a + 2π b/3 on a horizontal plane.
    let (zenith, horizon) = (Vec3::splat(4.0), Vec3::splat(1.0));
    let e = at(&ground(Sky::Gradient { zenith, horizon, ground: Vec3::ZERO }).build(), DVec3::ZERO, Vec3::Y, 64);
    let exact = PI + 2.0 * PI * 3.0 / 3.0;
    let (mean, rmse) = statistics(&e, exact);
    assert!((mean - exact).abs() < 1e-3 * exact && rmse < 0.005 * exact, "{mean} {rmse} {exact}");
}

#[test]
fn a_sun_in_an_image_is_seen_without_noise_and_throws_a_shadow() {
    let (width, height) = (256, 128);
    let mut texels = vec![Vec3::ONE; width * height];
    // A single texel of a million, 60° above the horizon towards −Z.
    let (sun_x, sun_y) = (128, 21);
    texels[sun_y * width + sun_x] = Vec3::splat(1e6);
    let image = SkyImage { width: 256, height: 128, texels, rotation: 0.0, strength: 1.0 };
    let sky = Sky::Image(image);
    // The bilinear image, integrated on a fine grid around the sun; the rest is π.
    let mut sun = 0.0f64;
    let fine = 64;
    for j in 0..3 * fine {
        for i in 0..3 * fine {
            let uv = Vec2::new(
                (sun_x as f32 - 1.0 + (i as f32 + 0.5) / fine as f32) / width as f32,
                (sun_y as f32 - 1.0 + (j as f32 + 0.5) / fine as f32) / height as f32,
            );
            let d = image_direction(uv, 0.0);
            let pixel = std::f64::consts::PI / height as f64 * std::f64::consts::TAU / width as f64;
            let solid = pixel * libm::sin(f64::from(uv.y) * std::f64::consts::PI) / f64::from(fine * fine);
            sun += f64::from((sky.radiance(d).x - 1.0) * d.y.max(0.0)) * solid;
        }
    }
    let exact = sun as f32 + PI;
    let open = at(&ground(sky.clone()).build(), DVec3::ZERO, Vec3::Y, 128);
    let (mean, rmse) = statistics(&open, exact);
    assert!((mean - exact).abs() < 0.004 * exact && rmse < 0.02 * exact, "{mean} {rmse} {exact}");
    let mut b = ground(sky);
    let grey = b.matte(Vec3::ONE);
    b.quad("board", Vec3::new(-1.0, 0.5, -3.0), Vec3::X * 2.0, Vec3::Y * 8.0, grey);
    let shaded = at(&b.build(), DVec3::ZERO, Vec3::Y, 128);
    assert!(shaded.iter().all(|e| e.x < PI), "{shaded:?}");
}

#[test]
fn veils_dim_the_sky_and_the_dark_sky_costs_nothing() {
    let mut b = ground(Sky::Constant(Vec3::ONE));
    let base_color = Vec3::ONE.extend(0.25);
    let veil = b.material(Material { base_color, alpha: Alpha::Blend, ..Material::default() });
    b.quad("veil", Vec3::new(-900.0, 0.1, -900.0), Vec3::X * 1800.0, Vec3::Z * 1800.0, veil);
    for e in at(&b.build(), DVec3::new(5.0, 0.0, -3.0), Vec3::Y, 8) {
        assert!((e.x - 0.75 * PI).abs() < 2e-3, "{e}");
    }
    let scene = ground(Sky::None).build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let receiver = Receiver::on_triangle(&geometry, 0, 0.3, 0.3, 1.0, 5);
    assert_eq!(SkyLight::new(&rays, SkySettings::default()).irradiance(&receiver), (Rgb::ZERO, 0));
}

#[test]
fn thread_counts_do_not_change_a_bit() {
    let mut b = ground(Sky::Gradient { zenith: Vec3::ONE, horizon: Vec3::X, ground: Vec3::Y });
    let grey = b.matte(Vec3::ONE);
    b.cuboid("box", Vec3::new(1.0, 0.0, 1.0), Vec3::new(2.0, 3.0, 2.0), grey, false);
    let scene = b.build();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| at(&scene, DVec3::ZERO, Vec3::Y, 500))
    };
    let one = run(1);
    assert!(one == run(2) && one == run(7));
    assert!(one.iter().any(|e| *e != one[0]), "seeds differ");
}
