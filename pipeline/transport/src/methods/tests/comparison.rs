//! A scene without a closed form: what methods leave to chance, and how it falls.

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
            let tallies = samples.tallies(&receivers, passes, &Silent).unwrap();
            moments(tallies.iter().map(|t| f64::from(t.error()))).1
        };
        let (few, many) = (spread(4), spread(64));
        println!("random voxels: 16 times the draws leave 1/{:.2} of the error", few / many);
        // Independent draws leave 1/4; points of a sequence do better, at best in proportion to their number.
        assert!((2.8..20.0).contains(&(few / many)), "{few} {many}");
        // Nearer than 3 h to another surface the noise stays as the region shrinks: only points away from all others.
        let all = super::receivers(world.geometry, 600);
        let open: Vec<Receiver> = all.into_iter().filter(|r| is_open(world, r)).take(60).collect();
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

/// Beside walls, where the noise of near rays does not fall, maps are right in the mean, up to the half per cent of bias for
/// the density that near rays see.
#[test]
fn photon_maps_are_right_beside_walls() {
    with(&room(), 8, |world| {
        let (all, lights) = known(world, 150, 1 << 11);
        let beside = all.into_iter().zip(lights).filter(|(r, _)| !is_open(world, r));
        let (receivers, truth): (Vec<Receiver>, Vec<Light>) = beside.unzip();
        assert!(receivers.len() > 60, "{}", receivers.len());
        let expected: Vec<f64> = truth.iter().map(|t| mean(t.total())).collect();
        let (bias, sigma) = of_repeats(&expected, |seed| mapped(world, 5_000, seed, &receivers));
        let sigma = sigma.hypot(noise(&truth) / (truth.len() as f64).sqrt());
        println!("{} points beside walls: photon map {:+.3} % ± {:.3} %", truth.len(), 100.0 * bias, 100.0 * sigma);
        assert!(bias.abs() < SIGMAS * sigma + 0.005, "{bias} ± {sigma}");
    });
}

/// Away from all other surfaces: nothing is nearer than a quarter of the room.
fn is_open(world: &World, r: &Receiver) -> bool {
    let near = world.geometry.frame.length(0.25);
    (0..64).all(|i| {
        let local = sampling::cosine_hemisphere(sampling::r2(i, Vec2::splat(0.4)));
        let direction = (sampling::basis(r.normal) * local).normalize();
        world.rays.closest(r.position + r.normal * OFFSET, direction, near).is_none()
    })
}
