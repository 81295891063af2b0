//! Every method against closed forms, against the reference and against each other.
//!
//! What a method leaves to chance is judged by its own spread: path tracing by the errors that it states, random voxels
//! and photon maps by the spread of independent repeats. What voxels do to light has no spread; it is bounded in numbers.
//!
//! `cargo test -p luxel-transport --lib methods::tests::shipped -- --nocapture` prints the methods side by side.

use std::f32::consts::PI;

use glam::{DVec3, Vec2, Vec3};
use luxel_scene::{LightKind, Scene, Silent, Sky, build::Builder};

use super::*;
use crate::{
    direct::{Direct, DirectSettings, Visibility},
    gather::{Field, Gather, Lightcuts, PhotonMap, VoxelSamples, lightcuts, photon_map},
    geometry::Geometry,
    lights::Emitters,
    rays::Rays,
    reference::{Options, Reference},
    sampling,
    shoot::exact,
    sky_light::{SkyLight, SkySettings},
    solve::{SolveSettings, is_closed, solve},
    surfel::{AreaRule, Resolution, Surfels, VoxelSettings},
};

mod closed_forms;
mod comparison;
mod shipped;

/// A scene with all that methods read.
struct World<'a> {
    geometry: &'a Geometry<'a>,
    rays: &'a Rays<'a>,
    emitters: &'a Emitters,
    field: &'a Field<'a>,
    straight: Straight<'a>,
}

/// Solves a scene with `side` voxels along its longest side and shows it.
fn with(scene: &Scene, side: u32, test: impl FnOnce(&World)) {
    let geometry = Geometry::new(scene);
    let (rays, emitters) = (Rays::new(&geometry), Emitters::new(&geometry));
    let voxels = VoxelSettings { resolution: Resolution::Side(side), area: AreaRule::Clipped };
    let surfels = Surfels::new(&geometry, &voxels, &Silent).unwrap();
    let direct =
        Direct::new(&rays, &emitters, DirectSettings { visibility: Visibility::Rays, ..DirectSettings::default() });
    let shot = exact(&geometry, &surfels, &direct, 5, &Silent).unwrap();
    let settings = SolveSettings { closed: is_closed(&rays, &surfels, 1 << 14), ..SolveSettings::default() };
    let radiance = |direction| scene.sky.radiance(direction);
    let sky = (!scene.sky.is_dark()).then_some(&radiance as crate::sweep::SkyFn);
    let (solution, _) = solve(&surfels, &shot.irradiance, &settings, sky, &Silent).unwrap();
    let field = Field::new(&rays, &surfels, &solution).unwrap();
    let sky = SkyLight::new(&rays, SkySettings::default());
    let straight = Straight { lights: Some(&direct), sky: Some(&sky) };
    test(&World { geometry: &geometry, rays: &rays, emitters: &emitters, field: &field, straight });
}

/// Points of all fronts, evenly by area.
fn receivers(geometry: &Geometry, count: u32) -> Vec<Receiver> {
    let mut sum = 0.0;
    let areas: Vec<f32> = geometry
        .triangles
        .iter()
        .map(|t| {
            sum += t.area();
            sum
        })
        .collect();
    let at = |i: u32| {
        let place = (i as f32 + 0.5) / count as f32 * sum;
        let triangle = areas.partition_point(|a| *a <= place).min(areas.len() - 1) as u32;
        let (u, v) = sampling::triangle(sampling::r2(i, Vec2::splat(0.37)));
        Receiver::on_triangle(geometry, triangle, u, v, 1.0, sampling::mix(u64::from(i)))
    };
    (0..count).map(at).collect()
}

fn light(method: &dyn Method, receivers: &[Receiver]) -> Vec<Light> {
    method.light(receivers, &Silent).unwrap()
}

fn mean(rgb: Rgb) -> f64 {
    f64::from(rgb.element_sum()) / 3.0
}

/// Mean and root mean square of values.
fn moments(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for value in values {
        (n, sum, squares) = (n + 1.0, sum + value, squares + value * value);
    }
    (sum / n, f64::sqrt(squares / n))
}

/// Repeats of what draws at random, and the standard errors within which their mean has to be: Student's t with 7 degrees
/// of freedom exceeds 4 once in 190.
const REPEATS: u64 = 8;
const SIGMAS: f64 = 4.0;

/// Mean error over all receivers of independent repeats, relative to the mean expected light, and its standard error.
fn of_repeats(expected: &[f64], one: impl Fn(u64) -> Vec<Light>) -> (f64, f64) {
    let scale = expected.iter().sum::<f64>();
    let error = |repeat| one(repeat).iter().zip(expected).map(|(l, e)| mean(l.total()) - e).sum::<f64>() / scale;
    let errors: Vec<f64> = (0..REPEATS).map(error).collect();
    let (bias, _) = moments(errors.iter().copied());
    let (_, spread) = moments(errors.iter().map(|e| e - bias));
    (bias, spread / f64::sqrt(REPEATS as f64 - 1.0))
}

/// The light by a photon map of its own.
fn mapped(world: &World, photons: u32, seed: u64, receivers: &[Receiver]) -> Vec<Light> {
    let settings = photon_map::Settings { photons, seed, ..photon_map::Settings::default() };
    let map = PhotonMap::new(world.rays, world.emitters, settings);
    light(&Reconstruction { straight: world.straight, reflected: &map }, receivers)
}

/// The same receivers with other seeds, whose draws are independent.
fn reseeded(receivers: &[Receiver], repeat: u64) -> Vec<Receiver> {
    let other = |r: &Receiver| Receiver { seed: sampling::combine(r.seed, 77 + repeat), ..*r };
    receivers.iter().map(other).collect()
}

/// The light by random sample voxels with draws of its own.
fn sampled(world: &World, samples: &VoxelSamples, repeat: u64, receivers: &[Receiver]) -> Vec<Light> {
    light(&RandomVoxels { straight: world.straight, samples }, &reseeded(receivers, repeat))
}

/// Bias and RMSE over the mean light, the reference's own variance taken out.
fn score(found: &[Light], truth: &[Light]) -> (f64, f64) {
    let scale = truth.iter().map(|t| mean(t.total())).sum::<f64>() / truth.len() as f64;
    let (bias, rms) = moments(found.iter().zip(truth).map(|(l, t)| (mean(l.total()) - mean(t.total())) / scale));
    (bias, (rms * rms - noise(truth).powi(2)).max(0.0).sqrt())
}

/// Root mean square of stated errors over the mean light.
fn noise(lights: &[Light]) -> f64 {
    let scale = lights.iter().map(|t| mean(t.total())).sum::<f64>() / lights.len() as f64;
    moments(lights.iter().map(|l| f64::from(l.error.unwrap()) / scale)).1
}

#[test]
fn the_same_receivers_give_the_same_bits_on_any_number_of_threads() {
    let scene = comparison::room();
    with(&scene, 16, |world| {
        let receivers = receivers(world.geometry, 40);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let settings = photon_map::Settings { photons: 3000, ..photon_map::Settings::default() };
                let map = PhotonMap::new(world.rays, world.emitters, settings);
                let samples = VoxelSamples::new(world.field, 2);
                let tracer = Reference::new(world.rays, Options::default());
                let straight = world.straight;
                let methods: [&dyn Method; 4] = [
                    &Reconstruction { straight, reflected: &map },
                    &RandomVoxels { straight, samples: &samples },
                    &Cached::new(world.field),
                    &PathTracing::new(&tracer, 64),
                ];
                (methods.map(|method| light(method, &receivers)), *map.facts())
            })
        };
        let one = on(1);
        assert!(one == on(2) && one == on(5));
        assert!(one.0.iter().flatten().all(|l| l.total().is_finite() && l.total().min_element() >= 0.0));
    });
}

#[test]
fn work_that_nobody_wants_is_not_done() {
    use luxel_scene::Unwanted;
    let scene = comparison::room();
    with(&scene, 12, |world| {
        let receivers = receivers(world.geometry, 40);
        let settings = photon_map::Settings { photons: 1000, ..photon_map::Settings::default() };
        assert!(PhotonMap::build(world.rays, world.emitters, settings, &Unwanted).is_err());
        let (map, samples) = (PhotonMap::new(world.rays, world.emitters, settings), VoxelSamples::new(world.field, 1));
        let straight = world.straight;
        assert!(Reconstruction { straight, reflected: &map }.light(&receivers, &Unwanted).is_err());
        assert!(RandomVoxels { straight, samples: &samples }.light(&receivers, &Unwanted).is_err());
        assert!(Cached::new(world.field).light(&receivers, &Unwanted).is_err());
    });
}
