//! Scenes without a closed form: every method against the reference.

use super::*;
use crate::rays::OFFSET;

/// An open box with a lamp in its ceiling, coloured walls and a block: 1 m wide, like Cornell's.
pub fn room() -> Scene {
    let mut b = Builder::new("room");
    let (white, red, green) =
        (b.matte(Vec3::splat(0.7)), b.matte(Vec3::new(0.6, 0.1, 0.1)), b.matte(Vec3::new(0.1, 0.5, 0.1)));
    let lamp = b.emitter(Vec3::splat(0.7), Vec3::new(17.0, 12.0, 4.0));
    b.quad("floor", Vec3::new(0.0, 0.0, 1.0), Vec3::X, Vec3::NEG_Z, white);
    b.quad("ceiling", Vec3::new(0.0, 1.0, 0.0), Vec3::X, Vec3::Z, white);
    b.quad("back", Vec3::ZERO, Vec3::X, Vec3::Y, white);
    b.quad("left", Vec3::Z, Vec3::NEG_Z, Vec3::Y, red);
    b.quad("right", Vec3::X, Vec3::Z, Vec3::Y, green);
    b.quad("lamp", Vec3::new(0.35, 0.99, 0.35), Vec3::X * 0.3, Vec3::Z * 0.3, lamp);
    b.cuboid("block", Vec3::new(0.2, -0.01, 0.25), Vec3::new(0.5, 0.45, 0.6), white, false);
    b.build()
}

/// Points that see into the room, and their light by the reference.
fn known(world: &World, count: u32, paths: u32) -> (Vec<Receiver>, Vec<Light>) {
    let tracer = Reference::new(world.rays, Options::default());
    let all = receivers(world.geometry, count);
    let lights = light(&PathTracing::new(&tracer, paths), &all);
    // What is under the block or behind the lamp is dark, and no method has anything to say there.
    let lit = all.into_iter().zip(lights).filter(|(_, l)| mean(l.indirect) > 0.0);
    lit.unzip()
}

/// Bias and RMSE over the mean light, the reference's own variance taken out.
fn score(found: &[Light], truth: &[Light]) -> (f64, f64) {
    let scale = truth.iter().map(|t| mean(t.total())).sum::<f64>() / truth.len() as f64;
    let (bias, rms) = moments(found.iter().zip(truth).map(|(l, t)| (mean(l.total()) - mean(t.total())) / scale));
    let (_, noise) = moments(truth.iter().map(|t| f64::from(t.error.unwrap()) / scale));
    (bias, (rms * rms - noise * noise).max(0.0).sqrt())
}

#[test]
fn every_method_finds_the_light_of_the_reference() {
    with(&room(), 48, |world| {
        let (receivers, truth) = known(world, 100, 1 << 11);
        let straight = world.straight;
        let map =
            PhotonMap::new(world.rays, world.emitters, photon_map::Settings { photons: 20_000, ..Default::default() });
        let samples = VoxelSamples::new(world.field, 16);
        let cuts = Lightcuts::new(world.field, lightcuts::Settings::default());
        // Bias and RMSE: 48 voxels a side leave about a per cent of bias, the cache shown directly whatever shadows and
        // gradients do within a voxel.
        let methods: [(&str, &dyn Method, f64, f64); 4] = [
            ("photon map", &Reconstruction { straight, reflected: &map }, 0.01, 0.03),
            ("random voxels", &RandomVoxels { straight, samples: &samples }, 0.015, 0.03),
            ("lightcuts", &Reconstruction { straight, reflected: &cuts }, 0.015, 0.03),
            ("cached", &Cached::new(world.field), 0.03, 0.15),
        ];
        for (name, method, most_bias, most_rms) in methods {
            let (bias, rms) = score(&light(method, &receivers), &truth);
            println!("room: {name} {:+.2} %, rmse {:.2} %", 100.0 * bias, 100.0 * rms);
            assert!(bias.abs() < most_bias && rms < most_rms, "{name}: {bias} {rms}");
        }
    });
}

/// Path tracing with few walks against itself with many: errors beyond three standard deviations are as rare as Student
/// says, and stated errors fall with the root of the walks.
#[test]
fn path_tracing_knows_its_error() {
    with(&room(), 8, |world| {
        let (receivers, truth) = known(world, 150, 1 << 12);
        let tracer = Reference::new(world.rays, Options::default());
        // Other seeds: the same walks would agree with themselves.
        let others: Vec<Receiver> = receivers.iter().map(|r| Receiver { seed: r.seed ^ 77, ..*r }).collect();
        let found = light(&PathTracing::new(&tracer, 1024), &others);
        let z = |l: &Light, t: &Light| {
            let (a, b) = (f64::from(l.error.unwrap()), f64::from(t.error.unwrap()));
            (mean(l.total()) - mean(t.total())) / (a * a + b * b).sqrt()
        };
        let beyond = found.iter().zip(&truth).filter(|(l, t)| z(l, t).abs() > 3.0).count();
        let (mean_z, rms) = moments(found.iter().zip(&truth).map(|(l, t)| z(l, t)));
        println!("path tracing: {beyond} of {} beyond 3 sigma, z {mean_z:+.3}, rms {rms:.3}", truth.len());
        assert!(beyond <= 5 && mean_z.abs() < 3.0 / (truth.len() as f64).sqrt() && (0.85..1.2).contains(&rms));
        let error = |lights: &[Light]| moments(lights.iter().map(|l| f64::from(l.error.unwrap()))).1;
        let ratio = error(&found) / error(&truth);
        assert!((1.6..2.6).contains(&ratio), "4 times the walks leave 1/{ratio} of the error");
    });
}

/// A quarter of the photons or of the draws makes about twice the error.
#[test]
fn errors_fall_with_the_root_of_the_work() {
    with(&room(), 24, |world| {
        let receivers = receivers(world.geometry, 60);
        let samples = VoxelSamples::new(world.field, 1);
        let spread = |passes: u32| {
            let mut tallies = vec![voxel_samples::Tally::default(); receivers.len()];
            samples.add(&receivers, &mut tallies, passes, &Silent).unwrap();
            let errors = moments(tallies.iter().map(|t| f64::from(t.error()))).1;
            (errors, tallies)
        };
        let ((few, _), (many, tallies)) = (spread(4), spread(64));
        println!("random voxels: 16 times the draws leave 1/{:.2} of the error", few / many);
        // Independent draws leave 1/4; points of a sequence do better, at best in proportion to their number.
        assert!((2.8..20.0).contains(&(few / many)), "{few} {many}");
        // Passes only add: in two goes or in one, bit by bit.
        let mut again = vec![voxel_samples::Tally::default(); receivers.len()];
        for passes in [10, 54] {
            samples.add(&receivers, &mut again, passes, &Silent).unwrap();
        }
        assert_eq!(again, tallies);
        // Nearer than 3 h to another surface the noise stays as the region shrinks: only points away from all others.
        let near = world.geometry.frame.length(0.25);
        let is_open = |r: &Receiver| {
            (0..64).all(|i| {
                let local = sampling::cosine_hemisphere(sampling::r2(i, Vec2::splat(0.4)));
                let direction = (sampling::basis(r.normal) * local).normalize();
                world.rays.closest(r.position + r.normal * OFFSET, direction, near).is_none()
            })
        };
        let open: Vec<Receiver> = super::receivers(world.geometry, 600).into_iter().filter(is_open).take(60).collect();
        assert!(open.len() >= 30, "{}", open.len());
        // Every photon for itself: a cut's own error does not fall with their number.
        let map = |photons, seed| {
            let settings = photon_map::Settings { photons, seed, threshold: 0.0, limit: u32::MAX, near_rays: 32 };
            let map = PhotonMap::new(world.rays, world.emitters, settings);
            map.gather(&open, &Silent).unwrap()
        };
        // The difference of two independent maps is √2 times the noise of one.
        let noise = |photons| {
            let pairs = [[1, 2], [3, 4]].map(|seeds| seeds.map(|seed| map(photons, seed)));
            let off = pairs.iter().flat_map(|[a, b]| a.iter().zip(b)).map(|(a, b)| mean(a.irradiance - b.irradiance));
            moments(off).1
        };
        let ratio = noise(1_000) / noise(16_000);
        println!("photon map: 16 times the photons leave 1/{ratio:.2} of the noise");
        assert!((2.8..5.7).contains(&ratio), "{ratio}");
    });
}
