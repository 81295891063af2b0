//! Incoherent rays per second on one core: closest hits, shadow rays and walks, in a box and in a tessellated sphere.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::{Vec2, Vec3};
use luxel_scene::{Scene, build::Builder};
use luxel_transport::{geometry::Geometry, rays::Rays, sampling};

const RAYS: u32 = 1 << 14;

fn cuboid() -> Scene {
    let mut b = Builder::new("box");
    let white = b.matte(Vec3::splat(0.5));
    b.cuboid("room", Vec3::ZERO, Vec3::ONE, white, true);
    b.build()
}

/// 60 thousand triangles.
fn sphere() -> Scene {
    let mut b = Builder::new("sphere");
    let white = b.matte(Vec3::splat(0.5));
    b.sphere("room", Vec3::ZERO, 1.0, 123, white, true);
    b.build()
}

/// Origins and directions that share nothing, inside the largest ball of either room.
fn incoherent() -> Vec<(Vec3, Vec3)> {
    let ray = |i: u32| {
        let seed = sampling::mix(u64::from(i));
        let origin = sampling::sphere(sampling::unit2(seed)) * 1900.0 * sampling::unit(sampling::mix(seed));
        (origin, sampling::sphere(sampling::r2(i, Vec2::ZERO)))
    };
    (0..RAYS).map(ray).collect()
}

fn rays(c: &mut Criterion) {
    let list = incoherent();
    for scene in [cuboid(), sphere()] {
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        println!("{}: {} triangles, {} bytes", scene.name, geometry.triangles.len(), rays.tree().bytes());
        let mut group = c.benchmark_group("rays");
        group.throughput(Throughput::Elements(u64::from(RAYS)));
        group.bench_function(BenchmarkId::new("closest", &scene.name), |b| {
            b.iter(|| list.iter().filter(|(o, d)| rays.closest(black_box(*o), *d, f32::INFINITY).is_some()).count())
        });
        // Half of these end before the wall.
        group.bench_function(BenchmarkId::new("shadow", &scene.name), |b| {
            b.iter(|| list.iter().filter(|(o, d)| rays.transmittance(black_box(*o), *d, 1500.0) == Vec3::ONE).count())
        });
        group.finish();
    }
}

criterion_group!(benches, rays);
criterion_main!(benches);
