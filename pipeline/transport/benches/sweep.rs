//! Discrete rays per second (N·D counting) of the sweep, as ratios in one run: surface rule against the paper's
//! literal rule, one thread against two, discrete against continuous rays.
//!
//! `cargo bench -p luxel-transport --bench sweep`; with `-- small` only N ≈ 100k.

use std::{hint::black_box, time::Instant};

use glam::{DAffine3, DQuat, Vec3};
use luxel_scene::{
    Scene, Silent,
    build::{Builder, transformed},
};
use luxel_transport::{
    Rgb,
    directions::{Direction, DirectionSet},
    geometry::Geometry,
    rays::{OFFSET, Rays},
    sampling,
    solve::{SolveSettings, is_closed, solve},
    surfel::{AreaRule, Resolution, Surfels, VoxelSettings},
    sweep::{Rule, Sweep},
};

fn cornell() -> Scene {
    let mut b = Builder::new("cornell");
    let white = b.matte(Vec3::splat(0.7));
    b.cuboid("room", Vec3::ZERO, Vec3::ONE, white, true);
    b.cuboid("tall", Vec3::new(0.2, 0.001, 0.2), Vec3::new(0.5, 0.6, 0.5), white, false);
    b.cuboid("short", Vec3::new(0.6, 0.001, 0.5), Vec3::new(0.85, 0.3, 0.8), white, false);
    b.scene_mut().meshes[0].triangles.truncate(10);
    b.build()
}

/// Processor seconds of this process where Linux tells them (in ticks of 10 ms), else wall-clock time since `start`:
/// rates of one thread should not depend on what else the machine does.
fn cpu_seconds(start: Instant) -> f64 {
    let ticks = || {
        let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
        let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
        Some(fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?)
    };
    ticks().map_or_else(|| start.elapsed().as_secs_f64(), |t| t / 100.0)
}

/// Best of three runs, processor seconds.
fn best(mut work: impl FnMut()) -> f64 {
    let start = Instant::now();
    let mut run = || {
        let before = cpu_seconds(start);
        work();
        cpu_seconds(start) - before
    };
    (0..3).map(|_| run()).fold(f64::INFINITY, f64::min)
}

/// Best of three runs, wall-clock seconds.
fn best_wall(mut work: impl FnMut()) -> f64 {
    let mut run = || {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    (0..3).map(|_| run()).fold(f64::INFINITY, f64::min)
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool")
}

/// Discrete rays per second.
fn rate(
    surfels: &Surfels,
    rule: Rule,
    grey: bool,
    directions: &[Direction],
    run: impl Fn(&mut (dyn FnMut() + Send)) -> f64,
) -> f64 {
    let sweep = Sweep::new(surfels, rule, false);
    let light = vec![Rgb::ONE; surfels.list.len()];
    let seconds = run(&mut || {
        black_box(sweep.apply(directions, &light, None, grey, &Silent).expect("nobody cancels"));
    });
    (surfels.list.len() * directions.len()) as f64 / seconds
}

/// Incoherent closest hits per second on one thread.
fn continuous(rays: &Rays, surfels: &Surfels) -> f64 {
    let count = 200_000;
    let origin = |k: u64| {
        let s = &surfels.list[(sampling::mix(k) % surfels.list.len() as u64) as usize];
        let t = &rays.geometry.triangles[s.triangle as usize];
        let direction = sampling::cosine_hemisphere(sampling::unit2(sampling::mix(!k)));
        (t.at(s.u(), s.v()) + t.normal * OFFSET, sampling::basis(t.normal) * direction)
    };
    let starts: Vec<_> = (0..count).map(origin).collect();
    let seconds = best(|| {
        for &(o, d) in &starts {
            black_box(rays.closest(o, d, f32::INFINITY));
        }
    });
    count as f64 / seconds
}

fn measure(name: &str, scene: &Scene, budget: u32, count: u32) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let start = Instant::now();
    let settings = VoxelSettings { resolution: Resolution::Budget(budget), area: AreaRule::Clipped };
    let surfels = Surfels::new(&geometry, &settings, &Silent).expect("voxels");
    let voxelized = start.elapsed().as_secs_f64();
    let directions = DirectionSet::Fibonacci.directions(count, 0);
    let (one, two) = (pool(1), pool(2));
    let cpu = |work: &mut (dyn FnMut() + Send)| best(|| one.install(&mut *work));
    let wall = |pool: &rayon::ThreadPool, work: &mut (dyn FnMut() + Send)| best_wall(|| pool.install(&mut *work));
    let surface = rate(&surfels, Rule::Surface, false, &directions, cpu);
    let grey = rate(&surfels, Rule::Surface, true, &directions, cpu);
    let literal = rate(&surfels, Rule::Literal, false, &directions, cpu);
    let alone = rate(&surfels, Rule::Surface, false, &directions, |work| wall(&one, work));
    let both = rate(&surfels, Rule::Surface, false, &directions, |work| wall(&two, work));
    let closest = continuous(&rays, &surfels);
    println!(
        "{name}: {} surfels, {} voxels a side, voxelized in {voxelized:.2} s",
        surfels.list.len(),
        surfels.grid.size.max_element()
    );
    println!("  surface rule   {:7.0} M rays/s, {:.2} ns a ray", surface / 1e6, 1e9 / surface);
    println!("  one band       {:7.0} M rays/s, {:.2} times", grey / 1e6, grey / surface);
    println!("  literal rule   {:7.0} M rays/s, {:.2} times", literal / 1e6, literal / surface);
    println!("  two threads    {:7.0} M rays/s, {:.2} times one by the wall clock", both / 1e6, both / alone);
    println!("  closest hits   {:7.2} M rays/s, discrete / continuous {:.0}", closest / 1e6, surface / closest);
}

fn whole_solve(scene: &Scene) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let settings = VoxelSettings { resolution: Resolution::Side(128), area: AreaRule::Clipped };
    let surfels = Surfels::new(&geometry, &settings, &Silent).expect("voxels");
    let direct: Vec<Rgb> = surfels.list.iter().map(|s| Rgb::new(1.0, 0.8, 0.6) * s.normal.y.max(0.0)).collect();
    let closed = is_closed(&rays, &surfels, 1 << 15);
    let settings = SolveSettings { closed, ..SolveSettings::default() };
    let mut bounces = 0;
    let seconds = pool(1).install(|| {
        best(|| bounces = solve(&surfels, &direct, &settings, None, &Silent).expect("a solution").1.bounces.len())
    });
    println!("solve at 128 voxels: {} surfels, {bounces} bounces, {seconds:.2} s of one core", surfels.list.len());
}

fn main() {
    let tilt = DAffine3::from_quat(DQuat::from_rotation_y(0.5) * DQuat::from_rotation_x(0.5));
    measure("box", &cornell(), 100_000, 256);
    measure("box, tilted", &transformed(cornell(), tilt), 100_000, 256);
    whole_solve(&cornell());
    if !std::env::args().any(|a| a == "small") {
        measure("box", &cornell(), 1_700_000, 96);
        measure("box, tilted", &transformed(cornell(), tilt), 1_700_000, 96);
    }
}
