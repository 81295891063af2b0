use std::f32::consts::PI;

use glam::{DAffine3, DQuat, DVec3, Vec2, Vec3, Vec4};
use luxel_scene::{
    Alpha, LightKind, Material, Scene, Silent, Texture, TextureRef, Wrap,
    build::{Builder, transformed},
};

use super::*;
use crate::{
    geometry::Geometry,
    lights::Source,
    sampling::{combine, mix, r2, unit},
};

/// A horizontal receiver at a point in scene units.
fn floor(geometry: &Geometry, x: f64, y: f64, z: f64) -> Receiver {
    facing(geometry, DVec3::new(x, y, z), Vec3::Y)
}

fn facing(geometry: &Geometry, at: DVec3, normal: Vec3) -> Receiver {
    Receiver { position: geometry.frame.point(at), normal, shading_normal: normal, footprint: 1.0, seed: 7 }
}

/// Irradiance by shafts, and by rays.
fn both(scene: &Scene, at: impl Fn(&Geometry) -> Vec<Receiver>, samples: u32) -> (Vec<Rgb>, Vec<Rgb>) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let emitters = Emitters::new(&geometry);
    let receivers = at(&geometry);
    let gather = |visibility| {
        let direct = Direct::new(&rays, &emitters, DirectSettings { samples, visibility, ..Default::default() });
        direct.gather(&receivers, &Silent).unwrap().iter().map(|g| g.irradiance).collect()
    };
    (gather(Visibility::Shafts), gather(Visibility::Rays))
}

fn point(x: f64, y: f64, z: f64, radius: f64) -> LightKind {
    LightKind::Point { position: DVec3::new(x, y, z), range: None, radius }
}

/// A floor of 20 × 20 at y = 0 that makes the frame.
fn ground() -> Builder {
    let mut b = Builder::new("ground");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::new(-10.0, 0.0, 10.0), Vec3::X * 20.0, Vec3::NEG_Z * 20.0, grey);
    b
}

/// A downward panel [x0,x1] × [z0,z1] at height y.
fn panel(b: &mut Builder, material: usize, x: [f32; 2], z: [f32; 2], y: f32) {
    let (o, a, c) = (Vec3::new(x[0], y, z[0]), Vec3::X * (x[1] - x[0]), Vec3::Z * (z[1] - z[0]));
    b.quad("panel", o, a, c, material);
}

#[test]
fn a_rectangle_over_a_plane_follows_lambert() {
    // Form factor of a differential element to a parallel rectangle with a corner above it, at height 1.
    let corner = |a: f64, b: f64| {
        let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
        0.5 * (a / p * libm::atan(b / p) + b / q * libm::atan(a / q))
    };
    for height in [0.02f32, 0.5, 2.0, 8.0] {
        let mut b = ground();
        let shiny = b.emitter(Vec3::ZERO, Vec3::new(1.0, 2.0, 4.0));
        panel(&mut b, shiny, [-1.0, 2.0], [-1.5, 0.5], height);
        let scene = b.build();
        let places: Vec<_> = (0..200).map(|i| (r2(i, Vec2::ZERO) * 16.0 - 8.0).as_dvec2()).collect();
        let at = |g: &Geometry| places.iter().map(|p| floor(g, p.x, 0.0, p.y)).collect();
        let (shafts, _) = both(&scene, at, 64);
        for (p, e) in places.iter().zip(shafts) {
            let h = f64::from(height);
            let [x0, x1, z0, z1] = [-1.0 - p.x, 2.0 - p.x, -1.5 - p.y, 0.5 - p.y].map(|x| x / h);
            let exact = corner(x1, z1) - corner(x0, z1) - corner(x1, z0) + corner(x0, z0);
            let relative = (f64::from(e.y) - 2.0 * exact).abs() / (2.0 * exact);
            assert!(relative < 1e-3, "{height} {p}: {e} {exact}");
            assert!((e.z - 4.0 * e.x).abs() <= 1e-5 * e.z);
        }
    }
}

/// Two that overlap by half, one of them in front of a larger one: the light of the union.
#[test]
fn panels_that_overlap_shine_like_one() {
    let from = |panels: &[([f32; 2], [f32; 2])]| {
        let mut b = ground();
        let shiny = b.emitter(Vec3::ZERO, Vec3::new(1.0, 2.0, 4.0));
        panels.iter().for_each(|(x, z)| panel(&mut b, shiny, *x, *z, 2.0));
        let places: Vec<_> = (0..200).map(|i| (r2(i, Vec2::ZERO) * 16.0 - 8.0).as_dvec2()).collect();
        both(&b.build(), |g| places.iter().map(|p| floor(g, p.x, 0.0, p.y)).collect(), 64)
    };
    let whole = from(&[([-1.0, 2.0], [-1.5, 0.5])]);
    for parts in [
        [([-1.0, 1.0], [-1.5, 0.5]), ([0.0, 2.0], [-1.5, 0.5])],
        [([0.25, 1.0], [-1.0, 0.125]), ([-1.0, 2.0], [-1.5, 0.5])],
    ] {
        let found = from(&parts);
        for (one, other) in [(&whole.0, &found.0), (&whole.1, &found.1)] {
            for (a, b) in one.iter().zip(other) {
                assert!((*a - *b).abs().max_element() < 1e-3 * a.max_element(), "{a} {b}");
            }
        }
    }
}

#[test]
fn lamps_and_suns_follow_their_laws() {
    let spot = |radius| LightKind::Spot {
        position: DVec3::new(0.0, 3.0, 0.0),
        direction: DVec3::NEG_Y,
        inner: 0.3,
        outer: 0.9,
        range: Some(6.0),
        radius,
    };
    for radius in [0.0, 0.2] {
        let mut b = ground();
        b.light("point", point(1.0, 2.0, -1.0, radius), Vec3::splat(100.0));
        b.light("spot", spot(radius), Vec3::splat(70.0));
        let direction = DVec3::new(0.3, -0.8, 0.2).normalize();
        b.light("sun", LightKind::Sun { direction, angle: 2.0 * radius }, Vec3::splat(5.0));
        let scene = b.build();
        let places: Vec<_> = (0..200).map(|i| (r2(i, Vec2::ZERO) * 16.0 - 8.0).as_dvec2()).collect();
        let at = |g: &Geometry| places.iter().map(|p| floor(g, p.x, 0.0, p.y)).collect();
        let (shafts, _) = both(&scene, at, 64);
        for (p, e) in places.iter().zip(shafts) {
            let x = DVec3::new(p.x, 0.0, p.y);
            let to = DVec3::new(1.0, 2.0, -1.0) - x;
            let mut exact = 100.0 * to.y / to.length().powi(3);
            let to = DVec3::new(0.0, 3.0, 0.0) - x;
            let cosine = to.y / to.length();
            exact += 70.0
                * cosine
                * luxel_scene::light::spot_falloff(cosine, 0.3, 0.9)
                * luxel_scene::light::range_window(to.length(), Some(6.0))
                / to.length_squared();
            exact -= 5.0 * direction.y;
            assert!((f64::from(e.x) - exact).abs() < 1e-3 * exact, "{radius} {p}: {e} {exact}");
        }
    }
}

#[test]
fn a_room_of_light_gives_pi_times_its_radiance_everywhere() {
    let mut b = Builder::new("furnace");
    let shiny = b.emitter(Vec3::ZERO, Vec3::new(1.0, 3.0, 0.5));
    b.cuboid("room", Vec3::ZERO, Vec3::new(3.0, 2.0, 1.0), shiny, true);
    let turn = DAffine3::from_quat(DQuat::from_rotation_x(0.5) * DQuat::from_rotation_z(0.4));
    for scene in [b.build()].into_iter().flat_map(|s| [s.clone(), transformed(s, turn)]) {
        let geometry = Geometry::new(&scene);
        let receivers: Vec<_> = (0..geometry.triangles.len() as u32)
            .flat_map(|t| (0..50).map(move |i| (t, crate::sampling::triangle(r2(i, Vec2::splat(0.3))))))
            .map(|(t, (u, v))| Receiver::on_triangle(&geometry, t, u, v, 1.0, 1))
            .collect();
        let (shafts, _) = both(&scene, |_| receivers.clone(), 64);
        for e in shafts {
            assert!((e / PI - Vec3::new(1.0, 3.0, 0.5)).abs().max_element() < 3e-4, "{e}");
        }
    }
}

#[test]
fn a_half_plane_hides_exactly_its_share_of_an_emitter() {
    // A wide plate over x < 0 at half height hides, from the receiver at x = 0, the left half of the panel.
    let mut b = ground();
    let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
    let grey = b.matte(Vec3::ONE);
    panel(&mut b, shiny, [-1.0, 1.0], [-1.0, 1.0], 4.0);
    panel(&mut b, grey, [-9.0, 0.0], [-9.0, 9.0], 2.0);
    let scene = b.build();
    let mut open = ground();
    let shiny = open.emitter(Vec3::ZERO, Vec3::ONE);
    panel(&mut open, shiny, [-1.0, 1.0], [-1.0, 1.0], 4.0);
    let at = |g: &Geometry| (-20..=20).map(|i| floor(g, f64::from(i) * 0.06, 0.0, 0.0)).collect();
    let open = both(&open.build(), at, 64).0;
    for (samples, tolerance) in [(64, 0.02), (256, 0.008)] {
        let (shafts, rays) = both(&scene, at, samples);
        for (i, (&e, &whole)) in shafts.iter().zip(&open).enumerate() {
            let x = (i as f64 - 20.0) * 0.06;
            // Seen: points with x' > −x at the panel; Lambert over the clipped panel.
            let mut part = ground();
            let shiny = part.emitter(Vec3::ZERO, Vec3::ONE);
            let edge = (-x as f32).clamp(-1.0, 1.0);
            let exact = if edge < 1.0 {
                panel(&mut part, shiny, [edge, 1.0], [-1.0, 1.0], 4.0);
                both(&part.build(), |g| vec![floor(g, x, 0.0, 0.0)], 64).0[0].x
            } else {
                0.0
            };
            assert!((e.x - exact).abs() < tolerance * whole.x, "{x}: {e} {exact}");
            assert!((e.x - rays[i].x).abs() <= 0.02 * whole.x, "{x}");
        }
        assert_eq!((shafts[0].x, shafts[40].x), (0.0, open[40].x));
    }
}

#[test]
fn a_thin_bar_is_never_missed() {
    let mut b = ground();
    let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
    let grey = b.matte(Vec3::ONE);
    panel(&mut b, shiny, [-1.0, 1.0], [-1.0, 1.0], 5.0);
    let mut open = ground();
    let glow = open.emitter(Vec3::ZERO, Vec3::ONE);
    panel(&mut open, glow, [-1.0, 1.0], [-1.0, 1.0], 5.0);
    // 0.01 wide, 0.05 above the floor: it hides 0.2/√… of the panel's width wherever the panel is above it.
    b.cuboid("bar", Vec3::new(-0.02, 0.05, -4.0), Vec3::new(0.02, 0.07, 4.0), grey, false);
    let at = |g: &Geometry| {
        (0..400).map(|i| floor(g, f64::from(i % 20) * 2e-3 - 0.02, 0.0, f64::from(i / 20) * 0.05)).collect()
    };
    let (shafts, rays) = both(&b.build(), at, 64);
    let (open, _) = both(&open.build(), at, 64);
    for ((e, r), o) in shafts.iter().zip(&rays).zip(&open) {
        // From below its middle the bar fills about 0.8/0.4 of the panel's angle: everything or a good part of it.
        assert!(e.x < 0.75 * o.x, "{e} {o}");
        assert!((e.x - r.x).abs() < 0.035 * o.x, "{e} {r} {o}");
    }
}

fn random(seed: u64, k: u64) -> Vec3 {
    let h = combine(seed, k);
    Vec3::new(unit(h), unit(mix(h)), unit(mix(mix(h))))
}

/// Random lights of all kinds and random triangles, some of them holes and veils, over the ground.
fn clutter(seed: u64, triangles: u64) -> Scene {
    let mut b = ground();
    let shiny = b.emitter(Vec3::ZERO, random(seed, 1) + 0.1);
    let grey = b.matte(Vec3::ONE);
    let base_color = random(seed, 2).extend(0.4);
    let veil = b.material(Material { base_color, alpha: Alpha::Blend, ..Material::default() });
    for k in 0..3 {
        let at = random(seed, 10 + k) * Vec3::new(10.0, 5.0, 10.0) + Vec3::new(-5.0, 0.5, -5.0);
        b.quad("light", at, random(seed, 20 + k) * 2.0 - 1.0, random(seed, 30 + k) * 2.0 - 1.0, shiny);
    }
    b.light("ball", point(1.0, 4.0, 0.5, 0.4), Vec3::splat(9.0));
    b.light("point", point(-2.0, 3.0, -1.5, 0.0), Vec3::splat(9.0));
    let direction = DVec3::new(0.4, -0.7, 0.1).normalize();
    b.light("sun", LightKind::Sun { direction, angle: 0.05 }, Vec3::splat(0.7));
    for k in 0..triangles {
        let at = random(seed, 100 + k) * Vec3::new(12.0, 5.0, 12.0) - Vec3::new(6.0, 0.5, 6.0);
        let corners = vec![at, at + random(seed, 300 + k) * 2.0 - 1.0, at + random(seed, 500 + k) * 2.0 - 1.0];
        b.mesh("clutter", corners, vec![[0, 1, 2]], if k % 7 == 3 { veil } else { grey });
    }
    b.build()
}

fn scattered(g: &Geometry, count: u32) -> Vec<Receiver> {
    let places = (0..count).map(|i| r2(i, Vec2::splat(0.1)) * 12.0 - 6.0);
    places.map(|p| floor(g, f64::from(p.x), 0.0, f64::from(p.y))).collect()
}

#[test]
fn shafts_and_rays_agree_in_clutter() {
    for seed in 0..6 {
        let scene = clutter(seed, 40);
        let (shafts, rays) = both(&scene, |g| scattered(g, 300), 64);
        let mean = rays.iter().map(|e| e.element_sum()).sum::<f32>() / rays.len() as f32;
        let mut differ = 0;
        for (a, b) in shafts.iter().zip(&rays) {
            assert!((a.element_sum() - b.element_sum()).abs() < 0.05 * mean, "{seed}: {a} {b}");
            differ += u32::from((*a - *b).abs().max_element() > 1e-4 * mean);
        }
        // The same points are asked; only those within rounding of an edge may differ.
        assert!(differ < 15, "{seed}: {differ}");
    }
}

#[test]
fn tiles_lists_and_thread_counts_do_not_change_a_bit() {
    let scene = clutter(11, 60);
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let emitters = Emitters::new(&geometry);
    let receivers = scattered(&geometry, 5000);
    let bits = |candidates: usize, threads: usize, receivers: &[Receiver]| -> Vec<[u32; 3]> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let direct = Direct::new(&rays, &emitters, DirectSettings { candidates, ..Default::default() });
        let gathered = pool.install(|| direct.gather(receivers, &Silent)).unwrap();
        gathered.iter().map(|g| g.irradiance.to_array().map(f32::to_bits)).collect()
    };
    let expected = bits(48, 1, &receivers);
    assert_eq!(expected, bits(48, 2, &receivers));
    assert_eq!(expected, bits(48, 7, &receivers));
    assert_eq!(expected[..1000], bits(0, 2, &receivers[..1000]), "segments instead of lists");
    assert_eq!(expected[..1000], bits(10_000, 2, &receivers[..1000]), "lists instead of segments");
    let alone: Vec<_> = receivers[..200].chunks(1).flat_map(|r| bits(48, 1, r)).collect();
    assert_eq!(expected[..200], alone, "each receiver alone");
}

#[test]
fn contributions_of_subsets_add_up() {
    let scene = clutter(3, 20);
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let all = Emitters::new(&geometry);
    let receivers = scattered(&geometry, 100);
    let gather = |e: &Emitters| -> Vec<Rgb> {
        let direct = Direct::new(&rays, e, DirectSettings::default());
        direct.gather(&receivers, &Silent).unwrap().iter().map(|g| g.irradiance).collect()
    };
    let (lamps, rest) = (all.only(|s| matches!(s, Source::Light(_))), all.only(|s| matches!(s, Source::Instance(_))));
    assert_eq!(lamps.len() + rest.len(), all.len());
    for ((a, b), c) in gather(&lamps).iter().zip(gather(&rest)).zip(gather(&all)) {
        assert!((*a + b - c).abs().max_element() <= 1e-5 * c.max_element());
    }
}

#[test]
fn veils_tint_and_holes_let_pass() {
    // A veil of α = 0.5 and a checkered mask, each alone between a panel and the floor.
    let red = Vec4::new(1.0, 0.2, 0.0, 0.5);
    let cases: [(Material, Vec3); 2] = [
        (Material { base_color: red, alpha: Alpha::Blend, ..Material::default() }, {
            0.5 * Vec3::ONE.lerp(red.truncate(), 0.5)
        }),
        (
            Material {
                base_color_texture: Some(TextureRef { wrap: [Wrap::Repeat; 2], ..TextureRef::new(0) }),
                alpha: Alpha::Mask(0.5),
                ..Material::default()
            },
            Vec3::splat(0.5),
        ),
    ];
    for (i, (material, expected)) in cases.into_iter().enumerate() {
        let mut b = ground();
        let texels = vec![[255, 255, 255, 255], [255, 255, 255, 0], [255, 255, 255, 0], [255, 255, 255, 255]];
        b.scene_mut().textures.push(Texture { name: "check".into(), width: 2, height: 2, srgb: false, texels });
        let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
        panel(&mut b, shiny, [-2.0, 2.0], [-2.0, 2.0], 4.0);
        let at = |g: &Geometry| scattered(g, 64);
        let open = both(&b.scene_mut().clone(), at, 64).0;
        let material = b.material(material);
        // Forty by forty checks over the whole floor.
        let sheet = b.quad("sheet", Vec3::new(-9.9, 1.0, -9.9), Vec3::X * 19.8, Vec3::Z * 19.8, material);
        for uv in &mut b.scene_mut().meshes[sheet].uvs[0] {
            *uv *= 40.0;
        }
        let (shafts, rays) = both(&b.build(), at, 256);
        let ratio = |e: &[Rgb]| e.iter().sum::<Vec3>() / open.iter().sum::<Vec3>();
        assert!((ratio(&shafts) - expected).abs().max_element() < 0.01, "{i}: {}", ratio(&shafts));
        assert!((ratio(&rays) - expected).abs().max_element() < 0.01, "{i}: {}", ratio(&rays));
    }
}

#[test]
fn a_textured_emitter_equals_its_parts() {
    // Left half dark, right half bright, against a panel of the right half alone.
    let mut b = ground();
    let texels: Vec<_> = (0..64).map(|i| if i < 32 { [0, 0, 0, 255] } else { [255, 255, 255, 255] }).collect();
    b.scene_mut().textures.push(Texture { name: "half".into(), width: 64, height: 1, srgb: false, texels });
    let emissive_texture = Some(TextureRef { wrap: [Wrap::Clamp; 2], ..TextureRef::new(0) });
    let screen = b.material(Material { emission: Vec3::ONE, emissive_texture, ..Material::default() });
    panel(&mut b, screen, [-1.0, 1.0], [-1.0, 1.0], 1.0);
    let mut parts = ground();
    let shiny = parts.emitter(Vec3::ZERO, Vec3::ONE);
    panel(&mut parts, shiny, [0.0, 1.0], [-1.0, 1.0], 1.0);
    let at = |g: &Geometry| scattered(g, 200);
    let (textured, exact) = (both(&b.build(), at, 256).0, both(&parts.build(), at, 64).0);
    for (a, b) in textured.iter().zip(&exact) {
        assert!((*a - *b).abs().max_element() < 0.03 * b.x + 1e-4, "{a} {b}");
    }
}

#[test]
fn awkward_places_stay_finite_and_dark_sides_dark() {
    let mut b = ground();
    let shiny = b.emitter(Vec3::ZERO, Vec3::splat(1e6));
    panel(&mut b, shiny, [-1.0, 1.0], [-1.0, 1.0], 2.0);
    b.quad("lying", Vec3::new(3.0, 0.0, 1.0), Vec3::X, Vec3::NEG_Z, shiny);
    b.light("point", point(0.0, 0.0, 0.0, 0.0), Vec3::splat(100.0));
    b.light("ball", point(0.0, 1.0, 0.0, 0.5), Vec3::splat(100.0));
    let scene = b.build();
    let at = |g: &Geometry| {
        let up = [DVec3::ZERO, DVec3::Y, DVec3::new(0.0, 0.6, 0.0), DVec3::new(1.0, 2.0, 0.0), DVec3::Y * 2.0];
        let on = [DVec3::new(3.5, 0.0, 0.5), DVec3::new(3.0, 0.0, 0.5), DVec3::new(2.9, 0.0, 0.5)];
        let receivers = up.iter().chain(&on).flat_map(|&p| [facing(g, p, Vec3::Y), facing(g, p, Vec3::NEG_Y)]);
        receivers.collect()
    };
    for e in [both(&scene, at, 64)].into_iter().flat_map(|(a, b)| [a, b]).flatten() {
        assert!(e.is_finite() && e.min_element() >= 0.0, "{e}");
    }
    let mut b = ground();
    b.light("absurd", point(0.0, 1.0, 0.0, 0.0), Vec3::splat(f32::MAX));
    for e in both(&b.build(), |g| vec![floor(g, 0.0, 0.0, 0.0), floor(g, 0.0, 1.0, 0.0)], 64).0 {
        assert!(e.is_finite(), "{e}");
    }
    // A panel lights nothing behind it.
    let mut b = ground();
    let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
    panel(&mut b, shiny, [-1.0, 1.0], [-1.0, 1.0], 2.0);
    let above = |g: &Geometry| vec![facing(g, DVec3::new(0.0, 3.0, 0.0), Vec3::NEG_Y), floor(g, 0.0, 3.0, 0.0)];
    assert_eq!(both(&b.build(), above, 64).0, vec![Rgb::ZERO; 2]);
}

#[test]
fn double_sided_panels_light_both_sides_alike() {
    let mut b = ground();
    let emission = Vec3::ONE;
    let sheet = b.material(Material { emission, double_sided: true, ..Material::default() });
    panel(&mut b, sheet, [-1.0, 1.0], [-1.0, 1.0], 3.0);
    let at = |g: &Geometry| vec![floor(g, 0.4, 0.0, 0.3), facing(g, DVec3::new(0.4, 6.0, 0.3), Vec3::NEG_Y)];
    let (e, _) = both(&b.build(), at, 64);
    assert!(e[0].x > 0.1 && (e[0].x - e[1].x).abs() < 1e-5, "{e:?}");
}

#[test]
fn a_light_flush_with_a_wall_is_not_hidden_by_it() {
    // The panel lies exactly in the plane of a ceiling that has no hole for it.
    let mut b = ground();
    let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
    let grey = b.matte(Vec3::ONE);
    panel(&mut b, shiny, [-1.0, 1.0], [-1.0, 1.0], 3.0);
    let at = |g: &Geometry| scattered(g, 100);
    let open = both(&b.scene_mut().clone(), at, 64).0;
    panel(&mut b, grey, [-10.0, 10.0], [-10.0, 10.0], 3.0);
    let (shafts, rays) = both(&b.build(), at, 64);
    assert_eq!(shafts, open);
    for (a, b) in rays.iter().zip(&open) {
        assert!((*a - *b).abs().max_element() < 1e-3 * b.x, "{a} {b}");
    }
}

#[test]
fn a_scene_without_light_or_without_receivers_is_fine() {
    let scene = ground().build();
    assert_eq!(both(&scene, |g| scattered(g, 3), 64).0, vec![Rgb::ZERO; 3]);
    assert!(both(&clutter(1, 5), |_| Vec::new(), 64).0.is_empty());
    assert!(both(&Scene::default(), |_| Vec::new(), 64).0.is_empty());
}

#[test]
fn light_by_shadow_rays_builds_no_tree() {
    let mut b = ground();
    b.light("lamp", point(0.0, 1.0, 0.0, 0.0), Vec3::ONE);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let emitters = Emitters::new(&geometry);
    // Whoever is not wanted any more stops as soon as there is something to do.
    let build = |visibility| {
        let how = DirectSettings { visibility, ..DirectSettings::default() };
        Direct::build(&rays, &emitters, how, &luxel_scene::Unwanted).is_ok()
    };
    assert!(build(Visibility::Rays) && !build(Visibility::Shafts));
}
