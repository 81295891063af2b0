use std::f64::consts::PI;

use glam::{IVec3, Vec3};
use luxel_scene::{Cancelled, LightKind, Material, Progress, Scene, Silent, build::Builder};

use super::*;
use crate::{
    direct::{Direct, DirectSettings},
    gather::{Gather, Gathered, Receiver},
    geometry::Geometry,
    lights::Emitters,
    rays::Rays,
    surfel::{Grid, Patch, Surfel, Surfels},
};

/// A floor of 4 × 4 at y = 0 with its front up, which makes the frame: 1024 units per scene unit.
fn ground() -> Builder {
    let mut b = Builder::new("ground");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0, grey);
    b
}

/// Square surfels over the floor, `n` along each side, one voxel each.
fn tiled(geometry: &Geometry, n: i32) -> Surfels {
    let corner = geometry.frame.point(DVec3::new(-2.0, 0.0, -2.0));
    let edge = geometry.frame.length(4.0) / n as f32;
    let grid = Grid { origin: corner - Vec3::Y * 0.5 * edge, edge, size: IVec3::new(n, 1, n) };
    let mut list = Vec::new();
    for x in 0..n {
        for z in 0..n {
            let centroid = corner + Vec3::new(x as f32 + 0.5, 0.0, z as f32 + 0.5) * edge;
            // Corners of the quad: o, o + a, o + a + b (first triangle); o, o + a + b, o + b (second).
            let (s, t) = ((x as f32 + 0.5) / n as f32, 1.0 - (z as f32 + 0.5) / n as f32);
            let (triangle, u, v) = if s >= t { (0, s - t, t) } else { (1, s, t - s) };
            list.push(Surfel::from(Patch {
                voxel: IVec3::new(x, 0, z),
                centroid,
                normal: Vec3::Y,
                area: edge * edge,
                albedo: Vec3::splat(0.5),
                fill: 1.0,
                triangle,
                u,
                v,
                back: false,
            }));
        }
    }
    Surfels::dark(grid, list)
}

/// Photons and exact values of a scene on `n × n` surfels.
fn run(scene: &Scene, n: i32, settings: PhotonSettings) -> (Shot, Shot, Surfels, DVec3) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let emitters = Emitters::new(&geometry);
    let surfels = tiled(&geometry, n);
    let direct = Direct::new(&rays, &emitters, DirectSettings::default());
    let exact = exact(&geometry, &surfels, &direct, 5, &Silent).unwrap();
    let photons = photons(&rays, &emitters, &surfels, settings, &Silent).unwrap();
    (photons, exact, surfels, emitters.power())
}

/// Means over 4 × 4 blocks of 32 × 32 values.
fn coarse(fine: &[Rgb]) -> Vec<Rgb> {
    let block = |x: usize, z: usize| (0..16).map(|i| fine[(4 * x + i / 4) * 32 + 4 * z + i % 4]).sum::<Rgb>() / 16.0;
    (0..64).map(|i| block(i / 8, i % 8)).collect()
}

fn lit(kind: LightKind, intensity: f32) -> Scene {
    let mut b = ground();
    b.light("lamp", kind, Vec3::new(1.0, 2.0, 0.0) * intensity);
    b.build()
}

fn scenes() -> Vec<(&'static str, Scene)> {
    let position = DVec3::new(0.3, 1.0, -0.2);
    let (range, radius) = (Some(3.0), 0.05);
    let point = LightKind::Point { position, range: None, radius: 0.0 };
    let direction = DVec3::new(0.2, -1.0, 0.1).normalize();
    let spot = LightKind::Spot { position, direction, inner: 0.3, outer: 0.7, range, radius };
    let sun = LightKind::Sun { direction, angle: 0.02 };
    let mut panel = ground();
    let shiny = panel.emitter(Vec3::ZERO, Vec3::new(3.0, 1.0, 2.0));
    panel.quad("panel", Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z, shiny);
    let mut sheet = ground();
    let emission = Vec3::ONE;
    let glowing = sheet.material(Material { emission, double_sided: true, ..Material::default() });
    sheet.quad("sheet", Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z, glowing);
    vec![
        ("point", lit(point, 10.0)),
        ("spot", lit(spot, 10.0)),
        ("sun", lit(sun, 2.0)),
        ("panel", panel.build()),
        ("sheet", sheet.build()),
    ]
}

#[test]
fn photons_bring_the_energy_of_the_lights_and_the_exact_irradiance() {
    let settings = PhotonSettings { primary: 2000, directions: 64 };
    for (name, scene) in scenes() {
        let (photons, _, surfels, power) = run(&scene, 8, settings);
        // The mean over sixteen times finer surfels is the exact value over the area of one.
        let exact = coarse(&run(&scene, 32, PhotonSettings { primary: 1, directions: 1 }).1.irradiance);
        let flux = photons.ledger;
        if name != "sun" {
            let relative = (flux.emitted - power).abs().max_element() / power.max_element();
            // The spot's falloff is sampled; all else carries its power exactly.
            assert!(relative < if name == "spot" { 0.01 } else { 1e-5 }, "{name}: {flux:?} {power}");
        }
        assert!(flux.imbalance().abs().max_element() < 1e-9 * flux.emitted.max_element(), "{name}: {flux:?}");
        assert_eq!(flux.lost, DVec3::ZERO, "{name}");
        assert_eq!(photons.rays, photons.primary_photons * 64, "{name}");
        // Poisson statistics of independent photons bound the error of stratified ones.
        let count = photons.arrived_photons as f64 / surfels.list.len() as f64;
        let mean = photons.irradiance.iter().map(|e| f64::from(e.x)).sum::<f64>() / surfels.list.len() as f64;
        for (i, (p, e)) in photons.irradiance.iter().zip(&exact).enumerate() {
            let expected = f64::from(e.x) / mean;
            let sigma = (expected / count).sqrt();
            let slack = 0.01 * expected + 0.01;
            let error = (f64::from(p.x) / mean - expected).abs();
            assert!(error < 3.0 * sigma + slack, "{name} {i}: {p} {e}");
            assert!(p.is_finite() && p.min_element() >= 0.0);
        }
        let total = |e: &[Rgb]| e.iter().map(|e| f64::from(e.x)).sum::<f64>();
        let (a, b) = (total(&photons.irradiance), total(&exact));
        assert!((a - b).abs() < 0.01 * b, "{name}: {a} {b}");
    }
}

#[test]
fn under_a_lamp_the_irradiance_is_that_of_the_law() {
    let kind = LightKind::Point { position: DVec3::new(0.0, 1.0, 0.0), range: None, radius: 0.0 };
    let settings = PhotonSettings { primary: 4000, directions: 256 };
    let (photons, exact, surfels, _) = run(&lit(kind, 10.0), 40, settings);
    let at = |e: &[Rgb]| {
        let near =
            surfels.list.iter().zip(e).filter(|(s, _)| (s.voxel().x - 20).abs() < 2 && (s.voxel().z - 20).abs() < 2);
        let values: Vec<_> = near.map(|(_, e)| f64::from(e.x)).collect();
        (values.iter().sum::<f64>() / values.len() as f64, values.len())
    };
    let (mean, n) = at(&photons.irradiance);
    // 10 cd at one metre; solid angle of n surfels of 0.01 m² over 4π gives the number of photons.
    let expected_photons = n as f64 * 0.01 / (4.0 * PI) * 4000.0 * 256.0;
    let law = at(&exact.irradiance).0;
    assert!((law - 10.0).abs() < 0.3, "{law}");
    assert!((mean - law).abs() < 3.0 * law / expected_photons.sqrt() + 0.002 * law, "{mean} {law}");
}

#[test]
fn backs_absorb_and_walls_shadow() {
    let mut b = ground();
    let grey = b.matte(Vec3::ONE);
    let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
    b.quad("panel", Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z, shiny);
    // Between panel and floor, front down: photons meet its back.
    b.quad("board", Vec3::new(-2.0, 0.5, -2.0), Vec3::X * 4.0, Vec3::Z * 4.0, grey);
    let (photons, exact, _, power) = run(&b.build(), 4, PhotonSettings { primary: 500, directions: 16 });
    assert_eq!(photons.arrived_photons, 0);
    assert!(photons.ledger.absorbed.x > 0.8 * power.x);
    assert!(exact.irradiance.iter().all(|e| *e == Rgb::ZERO), "{:?}", exact.irradiance);
}

#[test]
fn a_coloured_veil_passes_its_share_to_the_floor() {
    let base_color = Vec3::new(1.0, 0.5, 0.0).extend(0.5);
    let panel = |veiled: bool| {
        let mut b = ground();
        let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
        b.quad("panel", Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z, shiny);
        if veiled {
            let veil = b.material(Material { base_color, alpha: luxel_scene::Alpha::Blend, ..Material::default() });
            b.quad("veil", Vec3::new(-2.0, 0.5, -2.0), Vec3::X * 4.0, Vec3::Z * 4.0, veil);
        }
        run(&b.build(), 4, PhotonSettings { primary: 1000, directions: 16 })
    };
    let ((veiled, exact, ..), (open, ..)) = (panel(true), panel(false));
    let tint = 0.5 * Vec3::ONE.lerp(base_color.truncate(), 0.5);
    let total = |e: &[Rgb]| e.iter().sum::<Rgb>();
    let expected = total(&open.irradiance) * tint;
    // Light that leaves sideways between veil and floor is the same with and without it.
    assert!((total(&veiled.irradiance) - expected).abs().max_element() < 0.03 * expected.x);
    assert!((total(&exact.irradiance) - expected).abs().max_element() < 0.03 * expected.x);
    assert!(veiled.ledger.imbalance().abs().max_element() < 1e-9);
}

#[test]
fn thread_counts_do_not_change_a_bit_and_no_light_gives_nothing() {
    let (_, scene) = scenes().swap_remove(1);
    let settings = PhotonSettings { primary: 3000, directions: 8 };
    let run_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&scene, 16, settings).0)
    };
    let one = run_with(1);
    for threads in [2, 7] {
        let other = run_with(threads);
        assert!(one.irradiance == other.irradiance && one.ledger == other.ledger);
    }
    let dark = run(&ground().build(), 4, settings).0;
    assert_eq!((dark.rays, dark.irradiance), (0, vec![Rgb::ZERO; 16]));
}

/// Returns its receivers' seeds as light.
struct Seeds;

impl Gather for Seeds {
    fn gather(&self, receivers: &[Receiver], _: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        let light = |r: &Receiver| Gathered { irradiance: Rgb::splat((r.seed >> 40) as f32), ..Gathered::default() };
        Ok(receivers.iter().map(light).collect())
    }
}

#[test]
fn seeds_do_not_change_with_what_stands_before_in_the_scene() {
    let seeds = |others: u32| {
        let mut b = Builder::new("ground");
        let grey = b.matte(Vec3::splat(0.5));
        for i in 0..others {
            b.quad(&format!("tile {i}"), Vec3::new(i as f32, 0.0, 0.0), Vec3::X * 0.5, Vec3::NEG_Z * 0.5, grey);
        }
        b.quad("floor", Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0, grey);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let mut surfels = tiled(&geometry, 8);
        surfels.list.iter_mut().for_each(|s| s.triangle += 2 * others);
        exact(&geometry, &surfels, &Seeds, 1, &Silent).unwrap().irradiance
    };
    let alone = seeds(0);
    assert_eq!(alone, seeds(2));
    let mut values: Vec<u32> = alone.iter().map(|e| e.x as u32).collect();
    values.sort_unstable();
    values.dedup();
    assert!(values.len() > 60, "64 surfels have {} seeds", values.len());
}

#[test]
fn the_spot_of_a_lamp_that_almost_touches_the_floor_is_not_missed() {
    // Half of all light goes down: Φ = 2πI, but for the sliver that leaves past the borders of the floor. One surfel gets
    // what its square fills of the sphere, Ω = 4 asin(sin²α), α the angle to the middle of its side.
    let (height, n) = (2e-3, 16);
    let mut b = ground();
    let position = DVec3::new(0.125, height, 0.125);
    b.light("lamp", LightKind::Point { position, range: None, radius: 0.0 }, Vec3::ONE);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let emitters = Emitters::new(&geometry);
    let surfels = tiled(&geometry, n);
    let direct = Direct::new(&rays, &emitters, DirectSettings::default());
    let mut light = exact(&geometry, &surfels, &direct, 5, &Silent).unwrap().irradiance;
    let area = (4.0 / f64::from(n)).powi(2);
    let flux = |light: &[Rgb]| light.iter().map(|e| f64::from(e.x)).sum::<f64>() * area;
    let before = flux(&light);
    let spent = close(&rays, &emitters, &surfels, 5, &mut light, &Silent).unwrap();
    let after = flux(&light);
    println!("{before:.3} lm by points, {after:.3} lm with the spot, 2π = {:.3}", 2.0 * PI);
    assert!(spent > 0 && (after / (2.0 * PI) - 1.0).abs() < 0.01 && (before / after - 1.0).abs() > 0.1);
    let below = surfels.find(geometry.frame.point(DVec3::new(0.125, 0.0, 0.125)), Vec3::Y).unwrap();
    let half = 2.0 / f64::from(n);
    let alpha = (half / half.hypot(height)).asin();
    let exact = 4.0 * (alpha.sin().powi(2)).asin() / area;
    assert!((f64::from(light[below].x) / exact - 1.0).abs() < 0.01, "{} {exact}", light[below].x);
    // Far from everything there is nothing to mend.
    let mut b = ground();
    b.light("lamp", LightKind::Point { position: DVec3::Y, range: None, radius: 0.0 }, Vec3::ONE);
    let far = b.build();
    let geometry = Geometry::new(&far);
    let rays = Rays::new(&geometry);
    let mut none = vec![Rgb::ZERO; surfels.list.len()];
    assert_eq!(close(&rays, &Emitters::new(&geometry), &surfels, 5, &mut none, &Silent), Ok(0));
    assert!(none.iter().all(|e| *e == Rgb::ZERO));
}

/// The light of a lamp over the ground at 16 × 16 surfels, by points and then mended, and the surfels.
fn touched(scene: &Scene, shape: impl Fn(&mut Surfels)) -> (Vec<Rgb>, Surfels) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let emitters = Emitters::new(&geometry);
    let mut surfels = tiled(&geometry, 16);
    shape(&mut surfels);
    let direct = Direct::new(&rays, &emitters, DirectSettings::default());
    let mut light = exact(&geometry, &surfels, &direct, 5, &Silent).unwrap().irradiance;
    assert!(close(&rays, &emitters, &surfels, 5, &mut light, &Silent).unwrap() > 0);
    (light, surfels)
}

/// Flux through surfels of the ground [lm].
fn through(light: &[Rgb]) -> DVec3 {
    light.iter().map(|e| e.as_dvec3()).sum::<DVec3>() * (4.0f64 / 16.0).powi(2)
}

#[test]
fn a_lamp_beside_surfels_without_area_gives_finite_light() {
    let position = DVec3::new(0.125, 2e-3, 0.125);
    let scene = lit(LightKind::Point { position, range: None, radius: 0.0 }, 1.0);
    let (light, _) = touched(&scene, |surfels| {
        surfels.list.iter_mut().filter(|s| s.centroid.x > 0.0).for_each(|s| s.area = 0.0);
    });
    assert!(light.iter().all(|e| e.is_finite() && e.min_element() >= 0.0));
}

#[test]
fn a_bulb_in_a_shade_lights_the_floor_through_it() {
    let base_color = Vec3::new(1.0, 0.5, 0.0).extend(0.5);
    let floor = |shaded: bool| {
        let mut b = ground();
        let position = DVec3::new(0.125, 0.1, 0.125);
        b.light("bulb", LightKind::Point { position, range: None, radius: 0.0 }, Vec3::ONE);
        if shaded {
            let veil = b.material(Material { base_color, alpha: luxel_scene::Alpha::Blend, ..Material::default() });
            b.quad("shade", Vec3::new(-2.0, 0.05, -2.0), Vec3::X * 4.0, Vec3::Z * 4.0, veil);
        }
        through(&touched(&b.build(), |_| {}).0)
    };
    let passes = 0.5 * Vec3::ONE.lerp(base_color.truncate(), 0.5).as_dvec3();
    let (shaded, open) = (floor(true), floor(false));
    assert!((shaded / open - passes).abs().max_element() < 1e-3, "{shaded} {open}, not {passes}");
}

#[test]
fn all_of_a_narrow_spot_close_to_the_floor_arrives() {
    for degrees in [1.0f64, 5.0] {
        let (position, direction) = (DVec3::new(0.125, 0.1, 0.125), DVec3::NEG_Y);
        let outer = degrees.to_radians();
        let scene =
            lit(LightKind::Spot { position, direction, inner: 0.5 * outer, outer, range: None, radius: 0.0 }, 1.0);
        let power = Emitters::new(&Geometry::new(&scene)).power();
        let found = through(&touched(&scene, |_| {}).0);
        assert!((found.x / power.x - 1.0).abs() < 0.005, "{degrees}°: {found} of {power}");
    }
}

#[test]
fn thread_counts_do_not_change_the_light_of_lamps_that_touch() {
    let position = DVec3::new(0.125, 2e-3, 0.125);
    let scene = lit(LightKind::Point { position, range: None, radius: 0.0 }, 1.0);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| touched(&scene, |_| {}).0)
    };
    assert_eq!(with(1), with(7));
}

/// Lamps of these intensities in a row.
fn row(intensities: impl Iterator<Item = f32>) -> Emitters {
    let mut b = ground();
    for (i, intensity) in intensities.enumerate() {
        let kind = LightKind::Point { position: DVec3::new(i as f64, 1.0, 0.0), range: None, radius: 0.0 };
        b.light(&format!("lamp {i}"), kind, Vec3::splat(intensity));
    }
    Emitters::new(&Geometry::new(&b.build()))
}

#[test]
fn photons_are_dealt_by_power_and_are_no_more_for_many_lights() {
    let two = row([3.0, 1.0].into_iter());
    assert_eq!(emission::dealt(&emission::near(&two), 100, 0.3), [(0, 75), (1, 25)]);
    let strength = |i: u32| 1.0 + (i % 7) as f32;
    let many = row((0..1000).map(strength));
    let beams = emission::near(&many);
    let mut sums = vec![0.0; beams.len()];
    let draws = 1000;
    for k in 0..draws {
        let dealt = emission::dealt(&beams, 100, (k as f32 + 0.5) / draws as f32);
        assert_eq!(dealt.iter().map(|d| d.1).sum::<u32>(), 100);
        dealt.iter().for_each(|&(number, photons)| sums[number] += f64::from(photons));
    }
    // In the mean everybody has his share.
    let total: f64 = (0..1000).map(|i| f64::from(strength(i))).sum();
    for (i, sum) in (0..1000).zip(&sums) {
        let expected = 100.0 * f64::from(strength(i)) / total;
        assert!((sum / f64::from(draws) - expected).abs() < 2e-3, "{i}: {sum} {expected}");
    }
}
