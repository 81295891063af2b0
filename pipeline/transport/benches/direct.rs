//! Direct light per texel: shafts against shadow rays, on one thread.
//!
//! `cargo bench -p luxel-transport --bench direct` times both ways; the error of every way against 1024 rays per light
//! is printed first, in per cent of the mean direct light.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::Vec3;
use luxel_scene::{Scene, Silent, build::Builder};
use luxel_transport::{
    direct::{Direct, DirectSettings, Visibility},
    gather::{Gather, Receiver},
    geometry::Geometry,
    lights::Emitters,
    rays::Rays,
};

/// A box with a panel lamp and two blocks.
fn cornell() -> Scene {
    let mut b = Builder::new("cornell");
    let white = b.matte(Vec3::splat(0.73));
    let lamp = b.emitter(Vec3::splat(0.5), Vec3::splat(10.0));
    b.cuboid("room", Vec3::ZERO, Vec3::ONE, white, true);
    b.quad("lamp", Vec3::new(0.35, 0.99, 0.35), Vec3::X * 0.3, Vec3::Z * 0.3, lamp);
    b.cuboid("tall", Vec3::new(0.15, 0.0, 0.2), Vec3::new(0.42, 0.6, 0.48), white, false);
    b.cuboid("short", Vec3::new(0.55, 0.0, 0.5), Vec3::new(0.85, 0.3, 0.8), white, false);
    b.build()
}

/// A hall with two hundred small lamps under its ceiling.
fn hall() -> Scene {
    let mut b = Builder::new("hall");
    let white = b.matte(Vec3::splat(0.7));
    let lamp = b.emitter(Vec3::ZERO, Vec3::splat(50.0));
    b.cuboid("hall", Vec3::ZERO, Vec3::new(4.0, 1.0, 2.0), white, true);
    for i in 0..20 {
        for j in 0..10 {
            let o = Vec3::new(0.1 + 0.2 * i as f32, 0.985, 0.1 + 0.2 * j as f32) - Vec3::new(0.025, 0.0, 0.025);
            b.quad("lamp", o, Vec3::X * 0.05, Vec3::Z * 0.05, lamp);
        }
    }
    for i in 0..12 {
        let o = Vec3::new(0.3 + 0.3 * i as f32, 0.0, 0.5 + 0.4 * (i % 3) as f32);
        b.cuboid("crate", o, o + Vec3::new(0.1, 0.25, 0.12), white, false);
    }
    b.build()
}

/// Rows of spheres of many triangles under a long lamp.
fn colonnade() -> Scene {
    let mut b = Builder::new("colonnade");
    let white = b.matte(Vec3::splat(0.7));
    let lamp = b.emitter(Vec3::ZERO, Vec3::splat(10.0));
    b.cuboid("hall", Vec3::ZERO, Vec3::new(5.0, 1.5, 2.0), white, true);
    b.quad("lamp", Vec3::new(0.5, 1.48, 0.7), Vec3::X * 4.0, Vec3::Z * 0.6, lamp);
    for i in 0..10 {
        for z in [0.4, 1.6] {
            b.sphere("column", Vec3::new(0.4 + 0.47 * i as f32, 0.6, z), 0.15, 28, white, false);
        }
    }
    b.build()
}

/// Texel centres on quads (pairs of triangles), row by row, as charts give them.
fn texels(geometry: &Geometry, per_side: u32) -> Vec<Receiver> {
    let mut receivers = Vec::new();
    let quads = geometry.triangles.len().min(12) as u32 / 2;
    for quad in 0..quads {
        for y in 0..per_side {
            for x in 0..per_side {
                let (s, t) = ((x as f32 + 0.5) / per_side as f32, (y as f32 + 0.5) / per_side as f32);
                let (triangle, u, v) = if s >= t { (0, s - t, t) } else { (1, s, t - s) };
                let seed = u64::from((quad * per_side + y) * per_side + x);
                receivers.push(Receiver::on_triangle(geometry, 2 * quad + triangle, u, v, 1.0, seed));
            }
        }
    }
    receivers
}

fn run(rays: &Rays, emitters: &Emitters, receivers: &[Receiver], samples: u32, visibility: Visibility) -> Vec<f32> {
    let direct = Direct::new(rays, emitters, DirectSettings { samples, visibility, ..Default::default() });
    let gathered = direct.gather(receivers, &Silent).expect("nobody cancels");
    gathered.iter().map(|g| g.irradiance.x).collect()
}

fn report(name: &str, rays: &Rays, emitters: &Emitters, receivers: &[Receiver]) {
    let few: Vec<_> = receivers.iter().step_by(receivers.len() / 60 + 1).copied().collect();
    let exact = run(rays, emitters, &few, 1024, Visibility::Rays);
    let mean = exact.iter().sum::<f32>() / exact.len() as f32;
    for (what, samples, visibility) in [
        ("shafts 64", 64, Visibility::Shafts),
        ("shafts 256", 256, Visibility::Shafts),
        ("rays 64", 64, Visibility::Rays),
    ] {
        let e = run(rays, emitters, &few, samples, visibility);
        let square = e.iter().zip(&exact).map(|(a, b)| (a - b) * (a - b)).sum::<f32>() / e.len() as f32;
        println!("{name}: {what}: RMSE {:.2} % of mean direct light", 100.0 * square.sqrt() / mean);
    }
}

fn benchmark(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("one thread");
    for (name, scene, side) in [("cornell", cornell(), 160), ("hall", hall(), 64), ("colonnade", colonnade(), 64)] {
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let emitters = Emitters::new(&geometry);
        let receivers = texels(&geometry, side);
        report(name, &rays, &emitters, &receivers);
        let mut group = c.benchmark_group(name);
        group.sample_size(10).warm_up_time(std::time::Duration::from_millis(300));
        group.measurement_time(std::time::Duration::from_secs(2));
        for (what, visibility, step) in [("shafts", Visibility::Shafts, 1), ("rays", Visibility::Rays, 64)] {
            let direct = Direct::new(&rays, &emitters, DirectSettings { visibility, ..Default::default() });
            let some: Vec<_> = receivers.iter().step_by(step).copied().collect();
            group.throughput(Throughput::Elements(some.len() as u64));
            group.bench_function(BenchmarkId::from_parameter(what), |b| {
                b.iter(|| pool.install(|| direct.gather(&some, &Silent)));
            });
        }
        group.finish();
    }
}

criterion_group!(benches, benchmark);
criterion_main!(benches);
