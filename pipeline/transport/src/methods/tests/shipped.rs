//! The methods side by side on two scenes that luxel ships, against the reference: a table on the terminal, and limits
//! on what it says. What draws at random has to be right in the mean of repeats, up to what voxels or densities leave.

use std::time::Instant;

use super::*;
use crate::{
    gather::{FinalGather, Lookup},
    validity::is_buried,
};

/// Surface points asked for in each scene, and walks of the reference at each.
const POINTS: u32 = 200;
const PATHS: u32 = 1 << 12;

/// A method, and the most that voxels may leave of bias and RMSE.
type Row<'a> = (&'a str, &'a dyn Method, f64, f64);

fn table(rows: &[Row], receivers: &[Receiver], truth: &[Light]) {
    println!("| method | bias % | RMSE % | rays a point | seconds |");
    let mut failed = Vec::new();
    let known = noise(truth) / (truth.len() as f64).sqrt();
    for &(name, method, most_bias, most_rms) in rows {
        let start = Instant::now();
        let found = light(method, receivers);
        let seconds = start.elapsed().as_secs_f64();
        let (bias, rms) = score(&found, truth);
        let rays = found.iter().map(|l| f64::from(l.rays)).sum::<f64>() / found.len() as f64;
        println!("| {name} | {:+.2} | {:.2} | {rays:.0} | {seconds:.3} |", 100.0 * bias, 100.0 * rms);
        if bias.abs() > SIGMAS * known + most_bias || rms > most_rms {
            failed.push(format!("{name}: bias {bias} of {most_bias} ± {known}, RMSE {rms} of {most_rms}"));
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

fn compare(scene: &Scene, side: u32) {
    with(scene, side, |world| {
        let all = receivers(world.geometry, POINTS);
        let tracer = Reference::new(world.rays, Options::default());
        let lights = light(&PathTracing::new(&tracer, PATHS), &all);
        // What stands on a floor or in a wall has points that nobody sees.
        let seen = |(r, l): &(Receiver, Light)| !is_buried(world.rays, r) && mean(l.indirect) > 0.0;
        let (receivers, truth): (Vec<_>, Vec<_>) = all.into_iter().zip(lights).filter(seen).unzip();
        println!("{}: {} points", scene.name, receivers.len());
        let straight = world.straight;
        let cuts = Lightcuts::new(world.field, lightcuts::Settings::default());
        let (look, gather) = (Lookup::new(world.field), FinalGather::new(world.field, 256));
        let rows: [Row; 4] = [
            ("cached voxels", &Cached::new(world.field), 0.03, 0.25),
            ("voxels + lightcuts", &Reconstruction { straight, reflected: &cuts }, 0.01, 0.03),
            ("voxels + final gather", &Reconstruction { straight, reflected: &gather }, 0.01, 0.03),
            (
                "voxels, look-up",
                &Reconstruction { straight: Straight { sky: None, ..straight }, reflected: &look },
                0.02,
                0.06,
            ),
        ];
        table(&rows, &receivers, &truth);

        // What is random: the mean of repeats, whose error is theirs and the reference's.
        let expected: Vec<f64> = truth.iter().map(|t| mean(t.total())).collect();
        let known = noise(&truth) / (truth.len() as f64).sqrt();
        let random = |name: &str, left: f64, one: &dyn Fn(u64) -> Vec<Light>| {
            let (bias, sigma) = of_repeats(&expected, one);
            println!("| {name} | {:+.2} ± {:.2} |", 100.0 * bias, 100.0 * sigma);
            assert!(bias.abs() < SIGMAS * sigma.hypot(known) + left, "{name}: {bias} ± {sigma}, known to {known}");
        };
        let walk = |k| light(&PathTracing::new(&tracer, 64), &reseeded(&receivers, k));
        random("path tracing, 64 walks", 0.0, &walk);
        let samples = VoxelSamples::new(world.field, 2);
        random("random sample voxels", 0.01, &|k| sampled(world, &samples, k, &receivers));
        random("photon map + lightcuts", 0.005, &|seed| mapped(world, 20_000, seed, &receivers));
    });
}

#[test]
fn cornell() {
    compare(&luxel_assets::cornell(), 96);
}

#[test]
fn two_rooms() {
    compare(&luxel_assets::two_rooms(), 96);
}
