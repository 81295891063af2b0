use std::f64::consts::PI;

use glam::{DVec3, Vec2, Vec3};
use luxel_scene::{Alpha, LightKind, Material, Scene, Sky, build::Builder};

use super::*;
use crate::{
    geometry::Geometry,
    sampling::{r2, triangle},
};

/// A floor of side 2 about the origin that looks up.
fn floor(albedo: f32) -> Builder {
    let mut b = Builder::new("floor");
    let grey = b.matte(Vec3::splat(albedo));
    b.quad("floor", Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::NEG_Z * 2.0, grey);
    b
}

/// Traces a scene: the deposits with their heights [m] and flux [lm], and the books.
fn traced(scene: &Scene, photons: u32) -> (Vec<(f64, DVec3)>, Ledger) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let emitters = Emitters::new(&geometry);
    let traced = trace::trace(&rays, &emitters, photons, 3, &Silent).unwrap();
    let to_lumen = 1.0 / (emitters.scale * emitters.scale);
    let lumen = |d: &trace::Deposit| (geometry.frame.world(d.light.light.position).y, d.flux.as_dvec3() * to_lumen);
    (traced.deposits.iter().map(lumen).collect(), traced.ledger)
}

fn close(a: f64, b: f64, relative: f64) -> bool {
    (a - b).abs() <= relative * b.abs()
}

fn band_mean(v: DVec3) -> f64 {
    v.element_sum() / 3.0
}

#[test]
fn a_lamp_gives_a_black_floor_its_solid_angle_and_the_books_close() {
    let (height, n) = (0.5f64, 100_000);
    let position = DVec3::new(0.0, height, 0.0);
    for range in [None, Some(1.2)] {
        let mut b = floor(0.0);
        b.light("lamp", LightKind::Point { position, range, radius: 0.0 }, Vec3::new(1.0, 2.0, 3.0));
        let (deposits, ledger) = traced(&b.build(), n);
        // ∫ I cos θ/d² · window dA over the floor, by midpoints.
        let cells = 400;
        let window = |d: f64| range.map_or(1.0, |r: f64| (1.0 - (d / r).powi(4)).clamp(0.0, 1.0));
        let place = |i: i32| (f64::from(i) + 0.5) / f64::from(cells) * 2.0 - 1.0;
        let at = |x: f64, z: f64| {
            let d = (x * x + z * z + height * height).sqrt();
            height / d.powi(3) * window(d) * (2.0 / f64::from(cells)).powi(2)
        };
        let expected: f64 = (0..cells).flat_map(|i| (0..cells).map(move |j| at(place(i), place(j)))).sum::<f64>();
        if range.is_none() {
            let solid_angle = 4.0 * libm::asin(1.0 / (1.0 + height * height));
            assert!(close(expected, solid_angle, 1e-4), "{expected} {solid_angle}");
        }
        let arrived: DVec3 = deposits.iter().map(|d| d.1).sum();
        assert!(close(arrived.x, expected, 0.01), "{arrived} {expected}");
        assert!(close(ledger.emitted.y, 8.0 * PI, 1e-6));
        assert!(ledger.imbalance().abs().max_element() < 1e-6 * ledger.emitted.x, "{ledger:?}");
        assert_eq!(ledger.lost, DVec3::ZERO);
        // The rest left through the sides and above, or was dimmed by the window on its way.
        let dimmed = if range.is_some() { ledger.absorbed.x - arrived.x } else { 0.0 };
        assert!(close(ledger.escaped.x + dimmed, 4.0 * PI - arrived.x, 1e-6));
    }
}

#[test]
fn the_sky_lights_both_sides_of_a_floor_by_its_integral() {
    let skies = [
        (Sky::Constant(Vec3::ONE), PI, PI),
        (
            Sky::Gradient { zenith: Vec3::splat(4.0), horizon: Vec3::ONE, ground: Vec3::splat(0.5) },
            PI * (1.0 / 3.0 + 8.0 / 3.0),
            PI * (1.0 / 3.0 + 1.0 / 3.0),
        ),
    ];
    for (sky, above, below) in skies {
        let mut b = floor(0.0);
        b.scene_mut().sky = sky;
        let (deposits, ledger) = traced(&b.build(), 200_000);
        let arrived: DVec3 = deposits.iter().map(|d| d.1).sum();
        // An area of 4 m²; the back takes its light too, and keeps it.
        assert!(close(arrived.x, 4.0 * above, 0.015), "{arrived} {}", 4.0 * above);
        assert!(close(ledger.absorbed.x, 4.0 * (above + below), 0.015), "{ledger:?}");
        assert!(ledger.imbalance().abs().max_element() < 1e-6 * ledger.emitted.x);
    }
}

#[test]
fn a_veil_takes_its_share_once_and_a_back_takes_all() {
    let base_color = Vec3::new(1.0, 0.5, 0.0).extend(0.5);
    let mut b = floor(0.0);
    let veil = b.material(Material { base_color, alpha: Alpha::Blend, ..Material::default() });
    b.quad("veil", Vec3::new(-1.0, 0.5, 1.0), Vec3::X * 2.0, Vec3::NEG_Z * 2.0, veil);
    b.light("sun", LightKind::Sun { direction: DVec3::NEG_Y, angle: 0.0 }, Vec3::splat(3.0));
    let (deposits, ledger) = traced(&b.build(), 200_000);
    let at = |height: f64| deposits.iter().filter(|d| (d.0 - height).abs() < 1e-3).map(|d| d.1).sum::<DVec3>();
    // 3 lux on 4 m²: the veil is met by all, the floor by what it passes.
    assert!(close(at(0.5).x, 12.0, 0.02), "{}", at(0.5));
    let tint = 0.5 * Vec3::ONE.lerp(base_color.truncate(), 0.5).as_dvec3();
    assert!((at(0.0) - 12.0 * tint).abs().max_element() < 0.25, "{} {}", at(0.0), 12.0 * tint);
    assert!(band_mean(ledger.imbalance()).abs() < 1e-6 * ledger.emitted.x, "{ledger:?}");
    assert!(ledger.imbalance().abs().max_element() < 0.02 * 12.0, "{ledger:?}");
    // From below the floor is a back.
    let mut b = floor(0.9);
    b.light("sun", LightKind::Sun { direction: DVec3::Y, angle: 0.0 }, Vec3::splat(3.0));
    let (deposits, ledger) = traced(&b.build(), 50_000);
    assert!(deposits.is_empty() && close(ledger.absorbed.x, 12.0, 0.02), "{ledger:?}");
}

/// In a closed box of albedo ρ every photon ends on a wall, after 1/(1 − ρ) arrivals in the mean.
#[test]
fn roulette_ends_photons_as_albedo_says() {
    for albedo in [Vec3::splat(0.75), Vec3::new(0.9, 0.6, 0.75)] {
        let mut b = Builder::new("box");
        let hot = b.emitter(albedo, Vec3::ONE);
        b.cuboid("box", Vec3::ZERO, Vec3::ONE, hot, true);
        let (deposits, ledger) = traced(&b.build(), 40_000);
        let arrived: DVec3 = deposits.iter().map(|d| d.1).sum();
        let expected = ledger.emitted / (DVec3::ONE - albedo.as_dvec3());
        // √((1 + ρ)/n)/… for geometric lengths: a per cent for 40 000 photons, three for the band of few.
        assert!(((arrived - expected) / expected).abs().max_element() < 0.03, "{arrived} {expected}");
        assert_eq!((ledger.escaped, ledger.lost), (DVec3::ZERO, DVec3::ZERO));
        assert!(band_mean(ledger.imbalance()).abs() < 1e-6 * ledger.emitted.x, "{ledger:?}");
        assert!(ledger.imbalance().abs().max_element() < 0.03 * ledger.emitted.x, "{ledger:?}");
    }
}

/// In a bright closed room a photon arrives a thousand times, and every light sends some: what is kept is bounded all the
/// same, and adds up to what arrives.
#[test]
fn arrivals_are_bounded_and_those_that_are_kept_stand_for_all() {
    let albedo = 0.995f32;
    let mut b = Builder::new("box");
    let hot = b.emitter(Vec3::splat(albedo), Vec3::ONE);
    b.cuboid("box", Vec3::ZERO, Vec3::ONE, hot, true);
    let room = b.build();
    for (photons, kept) in [(4000, 64_000), (1, 16_384)] {
        let (deposits, ledger) = traced(&room, photons);
        let arrived: DVec3 = deposits.iter().map(|d| d.1).sum();
        let expected = ledger.emitted.x / (1.0 - f64::from(albedo));
        println!("{} of {} arrivals: {}", deposits.len(), photons, arrived.x / expected);
        assert!(deposits.len() <= kept && deposits.len() > kept / 3, "{}", deposits.len());
        assert_eq!(most_arrivals(photons), kept as u64);
        // Lengths of walks are geometric: their mean spreads as the root of their number, 96 of a single one.
        let spread = 4.0 / f64::from(photons.max(96)).sqrt();
        assert!((arrived.x / expected - 1.0).abs() < spread, "{arrived} {expected}");
        assert!(ledger.imbalance().abs().max_element() < 1e-6 * ledger.emitted.x, "{ledger:?}");
    }
    // Four thousand lamps instead of one photon.
    let mut b = floor(0.5);
    for i in 0..4000 {
        let position = DVec3::new(f64::from(i) * 5e-4 - 1.0, 0.2, 0.0);
        b.light("lamp", LightKind::Point { position, range: None, radius: 0.0 }, Vec3::ONE);
    }
    let (deposits, ledger) = traced(&b.build(), 1);
    assert!(deposits.len() <= 16_384 && deposits.len() > 5_000, "{}", deposits.len());
    let arrived: DVec3 = deposits.iter().map(|d| d.1).sum();
    assert!(close(arrived.x, 2.0 * ledger.absorbed.x, 0.05), "{arrived} {ledger:?}");
}

/// The bias of the density, in an evenly lit box: in the middle of walls and within a twentieth of an edge.
#[test]
fn the_density_of_photons_is_the_irradiance_up_to_edges_and_corners() {
    let mut b = Builder::new("furnace");
    let hot = b.emitter(Vec3::splat(0.5), Vec3::ONE);
    b.cuboid("box", Vec3::ZERO, Vec3::ONE, hot, true);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let map = PhotonMap::new(&rays, &Emitters::new(&geometry), Settings { photons: 20_000, ..Settings::default() });
    let expected = 2.0 * PI;
    let (mut inner, mut outer, mut corner) = ((0.0, 0u32), (0.0, 0u32), (0.0, 0u32));
    let mut found = Vec::new();
    for i in 0..30_000 {
        let t = i % geometry.triangles.len() as u32;
        let (u, v) = triangle(r2(i, Vec2::ZERO));
        let point = geometry.triangles[t as usize].at(u, v);
        // Distances from the edges of the wall, in its sides.
        let world = geometry.frame.world(point);
        let mut near: Vec<f64> = world.to_array().iter().map(|c| c.min(1.0 - c).abs()).collect();
        near.sort_by(f64::total_cmp);
        let e =
            map.density.at(point, geometry.triangles[t as usize].normal, &mut found).map_or(0.0, |e| f64::from(e.x));
        let class = if near[2] < 0.05 {
            &mut corner
        } else if near[1] < 0.05 {
            &mut outer
        } else if near[1] > 0.15 {
            &mut inner
        } else {
            continue;
        };
        *class = (class.0 + e / expected, class.1 + 1);
    }
    let [inner, outer, corner] = [inner, outer, corner].map(|(sum, n)| sum / f64::from(n) - 1.0);
    println!(
        "density: {:+.2} % inside, {:+.2} % at edges, {:+.2} % in corners",
        100.0 * inner,
        100.0 * outer,
        100.0 * corner
    );
    assert!(inner.abs() < 0.015 && outer.abs() < 0.05 && corner.abs() < 0.10, "{inner} {outer} {corner}");
}

#[test]
fn a_scene_without_light_has_an_empty_map() {
    let scene = floor(0.5).build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let map = PhotonMap::new(&rays, &Emitters::new(&geometry), Settings::default());
    assert_eq!(*map.facts(), Facts::default());
    let receiver = Receiver::on_triangle(&geometry, 0, 0.3, 0.3, 1.0, 0);
    assert_eq!(map.gather(&[receiver], &Silent).unwrap()[0].irradiance, Rgb::ZERO);
}
