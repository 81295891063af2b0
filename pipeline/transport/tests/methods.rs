//! The methods side by side on two scenes that luxel ships, against the reference: a table on the terminal, and limits
//! on what it says.
//!
//! `cargo test -p luxel-transport --test methods -- --nocapture --test-threads 1`

use std::time::Instant;

use glam::Vec2;
use luxel_scene::{Scene, Silent};
use luxel_transport::{
    Rgb,
    direct::{Direct, DirectSettings, Visibility},
    gather::{Field, FinalGather, Lightcuts, Lookup, PhotonMap, Receiver, VoxelSamples, lightcuts, photon_map},
    geometry::Geometry,
    lights::Emitters,
    methods::{Cached, Light, Method, PathTracing, RandomVoxels, Reconstruction, Straight},
    rays::Rays,
    reference::{Options, Reference},
    sampling,
    shoot::exact,
    sky_light::{SkyLight, SkySettings},
    solve::{SolveSettings, is_closed, solve},
    surfel::{AreaRule, Resolution, Surfels, VoxelSettings},
    validity::is_buried,
};

/// Surface points asked for in each scene, and walks of the reference at each.
const POINTS: u32 = 200;
const PATHS: u32 = 1 << 12;

fn mean(rgb: Rgb) -> f64 {
    f64::from(rgb.element_sum()) / 3.0
}

/// Points of all fronts, evenly by area.
fn receivers(geometry: &Geometry) -> Vec<Receiver> {
    let mut sum = 0.0;
    let mut ends = Vec::new();
    for triangle in &geometry.triangles {
        sum += triangle.area();
        ends.push(sum);
    }
    let at = |i: u32| {
        let place = (i as f32 + 0.5) / POINTS as f32 * sum;
        let triangle = ends.partition_point(|end| *end <= place).min(ends.len() - 1) as u32;
        let (u, v) = sampling::triangle(sampling::r2(i, Vec2::splat(0.37)));
        Receiver::on_triangle(geometry, triangle, u, v, 1.0, sampling::mix(u64::from(i)))
    };
    (0..POINTS).map(at).collect()
}

/// Bias and RMSE in per cent of the mean light, the reference's own variance taken out.
fn score(found: &[Light], truth: &[Light]) -> (f64, f64) {
    let n = truth.len() as f64;
    let scale = truth.iter().map(|t| mean(t.total())).sum::<f64>() / n;
    let off = || found.iter().zip(truth).map(|(l, t)| mean(l.total()) - mean(t.total()));
    let noise = truth.iter().map(|t| f64::from(t.error.unwrap_or(0.0)).powi(2)).sum::<f64>() / n;
    let squares = off().map(|d| d * d).sum::<f64>() / n;
    (100.0 * off().sum::<f64>() / n / scale, 100.0 * (squares - noise).max(0.0).sqrt() / scale)
}

/// A name, a method, the seconds that it took to prepare, and the limits of its bias and RMSE in per cent.
type Row<'a> = (&'a str, &'a dyn Method, f64, f64, f64);

fn table(scene: &Scene, rows: &[Row], receivers: &[Receiver], truth: &[Light]) {
    println!("{}: {} points", scene.name, receivers.len());
    println!("| method | bias % | RMSE % | rays a point | seconds before | seconds |");
    let mut failed = Vec::new();
    for &(name, method, before, most_bias, most_rms) in rows {
        let start = Instant::now();
        let found = method.light(receivers, &Silent).unwrap();
        let seconds = start.elapsed().as_secs_f64();
        let (bias, rms) = score(&found, truth);
        let rays = found.iter().map(|l| f64::from(l.rays)).sum::<f64>() / found.len() as f64;
        println!("| {name} | {bias:+.2} | {rms:.2} | {rays:.0} | {before:.2} | {seconds:.3} |");
        if bias.abs() > most_bias || rms > most_rms {
            failed.push(format!("{name}: bias {bias} of {most_bias}, RMSE {rms} of {most_rms}"));
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

/// Limits are those of the voxels' bias and of the noise that these settings have: see the table.
fn compare(scene: &Scene) {
    let geometry = Geometry::new(scene);
    let (rays, emitters) = (Rays::new(&geometry), Emitters::new(&geometry));
    let start = Instant::now();
    let voxels = VoxelSettings { resolution: Resolution::Budget(60_000), area: AreaRule::Clipped };
    let surfels = Surfels::new(&geometry, &voxels, &Silent).unwrap();
    let settings = DirectSettings { visibility: Visibility::Rays, ..DirectSettings::default() };
    let direct = Direct::new(&rays, &emitters, settings);
    let shot = exact(&geometry, &surfels, &direct, 5, &Silent).unwrap();
    let settings = SolveSettings { closed: is_closed(&rays, &surfels, 1 << 16), ..SolveSettings::default() };
    let (solution, _) = solve(&surfels, &shot.irradiance, &settings, None, &Silent).unwrap();
    let solved = start.elapsed().as_secs_f64();
    let field = Field::new(&rays, &surfels, &solution).unwrap();
    let sky = SkyLight::new(&rays, SkySettings::default());
    let straight = Straight { lights: Some(&direct), sky: Some(&sky) };

    let tracer = Reference::new(&rays, Options::default());
    let all = receivers(&geometry);
    let lights = PathTracing::new(&tracer, PATHS).light(&all, &Silent).unwrap();
    // What stands on a floor or in a wall has points that nobody sees.
    let seen = |(r, l): &(Receiver, Light)| !is_buried(&rays, r) && mean(l.indirect) > 0.0;
    let (receivers, truth): (Vec<_>, Vec<_>) = all.into_iter().zip(lights).filter(seen).unzip();
    // Other seeds than those of the truth, with which path tracing would share its walks.
    let receivers: Vec<_> = receivers.into_iter().map(|r| Receiver { seed: r.seed ^ 77, ..r }).collect();

    let start = Instant::now();
    let map = PhotonMap::new(&rays, &emitters, photon_map::Settings::default());
    let mapped = start.elapsed().as_secs_f64();
    println!("{:?}, imbalance {:?}", map.facts(), map.facts().ledger.imbalance());
    let samples = VoxelSamples::new(&field, 16);
    let cuts = Lightcuts::new(&field, lightcuts::Settings::default());
    let (look, gather) = (Lookup::new(&field), FinalGather::new(&field, 256));
    let cached = Cached::new(&field);
    println!("{:?}", cached.count(&receivers));
    let rows: [Row; 7] = [
        ("path tracing, 64 walks", &PathTracing::new(&tracer, 64), 0.0, 4.0, 30.0),
        ("photon map + lightcuts", &Reconstruction { straight, reflected: &map }, mapped, 1.5, 4.0),
        ("random sample voxels", &RandomVoxels { straight, samples: &samples }, solved, 2.0, 6.0),
        ("cached voxels", &cached, solved, 4.0, 25.0),
        ("voxels + lightcuts", &Reconstruction { straight, reflected: &cuts }, solved, 1.5, 3.0),
        ("voxels + final gather", &Reconstruction { straight, reflected: &gather }, solved, 1.5, 3.0),
        (
            "voxels, look-up",
            &Reconstruction { straight: Straight { sky: None, ..straight }, reflected: &look },
            solved,
            2.5,
            6.0,
        ),
    ];
    table(scene, &rows, &receivers, &truth);
}

#[test]
fn cornell() {
    compare(&luxel_assets::cornell());
}

#[test]
fn two_rooms() {
    compare(&luxel_assets::two_rooms());
}
