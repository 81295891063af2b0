//! Microseconds per receiver of every mode of the gather, with what they buy: error against a final gather of 4096 rays
//! that reads the same field. Run with `cargo bench -p luxel-transport --bench gather`; one thread, fixed scenes.

#[path = "../tests/common/mod.rs"]
mod common;

use std::time::Instant;

use common::{charts, receivers, surfels};
use glam::Vec3;
use luxel_scene::{Scene, Silent, build::Builder};
use luxel_transport::{
    Rgb,
    gather::{
        Field, FinalGather, Gather, Gathered, Lightcuts, Lookup, Receiver,
        lightcuts::Settings,
        nodes::{Cell, NodeSettings, interpolate},
        refresh,
    },
    geometry::Geometry,
    lighttree::LightTree,
    rays::Rays,
    surfel::{Solution, Surfels},
};

/// A room with a red and a green wall and a block, lit by a small lamp under the ceiling.
fn colours() -> Scene {
    let mut b = Builder::new("colours");
    let [white, red, green] =
        [Vec3::splat(0.7), Vec3::new(0.6, 0.05, 0.05), Vec3::new(0.1, 0.45, 0.1)].map(|c| b.matte(c));
    walls(&mut b, [red, green, white]);
    b.cuboid("block", Vec3::new(-0.5, -0.99, -0.45), Vec3::new(0.1, 0.2, 0.25), white, false);
    b.build()
}

/// Two rooms with a thin wall between them and a door; the lamp shines in one.
fn two_rooms() -> Scene {
    let mut b = Builder::new("two rooms");
    let white = b.matte(Vec3::splat(0.7));
    walls(&mut b, [white; 3]);
    b.cuboid("wall", Vec3::new(0.195, -0.999, -0.999), Vec3::new(0.205, 0.999, 0.4), white, false);
    b.build()
}

/// The colours without their front wall.
fn open() -> Scene {
    let mut scene = colours();
    scene.name = "open".into();
    scene.instances.retain(|i| i.name != "front");
    scene
}

fn walls(b: &mut Builder, [left, right, rest]: [usize; 3]) {
    let s = 2.0;
    b.quad("left", Vec3::new(-1.0, -1.0, -1.0), Vec3::Y * s, Vec3::Z * s, left);
    b.quad("right", Vec3::new(1.0, -1.0, -1.0), Vec3::Z * s, Vec3::Y * s, right);
    b.quad("floor", Vec3::new(-1.0, -1.0, -1.0), Vec3::Z * s, Vec3::X * s, rest);
    b.quad("ceiling", Vec3::new(-1.0, 1.0, -1.0), Vec3::X * s, Vec3::Z * s, rest);
    b.quad("back", Vec3::new(-1.0, -1.0, -1.0), Vec3::X * s, Vec3::Y * s, rest);
    b.quad("front", Vec3::new(-1.0, -1.0, 1.0), Vec3::Y * s, Vec3::X * s, rest);
}

/// Direct light of a disc-like lamp at the ceiling and eight bounces of refreshes: a field as a solver would leave it.
fn solve(rays: &Rays, surfels: &Surfels) -> Solution {
    let lamp = Vec3::new(-600.0, 1900.0, 0.0);
    let direct = surfels.list.iter().map(|s| {
        let d = lamp - s.centroid;
        let cosines = (s.normal.dot(d) * d.y.max(0.0)).max(0.0) / d.length_squared().powi(2);
        let from = s.centroid + s.normal * 0.01;
        rays.transmittance(from, (lamp - from).normalize(), (lamp - from).length()) * cosines * 2e8
    });
    let direct: Vec<Rgb> = direct.collect();
    let mut solution = Solution { indirect: vec![Rgb::ZERO; direct.len()], direct };
    for _ in 0..8 {
        let field = Field::new(rays, surfels, &solution).unwrap();
        solution = refresh(&field, 64, &|_| Rgb::ZERO, &Silent).unwrap();
    }
    solution
}

struct Row {
    name: String,
    micros: f64,
    result: Vec<Gathered>,
}

fn time(name: &str, gather: &dyn Gather, receivers: &[Receiver]) -> Row {
    let start = Instant::now();
    let result = gather.gather(receivers, &Silent).unwrap();
    Row { name: name.into(), micros: start.elapsed().as_secs_f64() * 1e6 / receivers.len() as f64, result }
}

fn print(row: &Row, truth: &[Gathered]) {
    let mean = |g: &Gathered| g.irradiance.element_sum() / 3.0;
    let n = truth.len() as f32;
    let scale = truth.iter().map(mean).sum::<f32>() / n;
    let differences = || row.result.iter().zip(truth).map(|(a, b)| mean(a) - mean(b));
    let rmse = (differences().map(|d| d * d).sum::<f32>() / n).sqrt() / scale;
    let bias = differences().sum::<f32>() / n / scale;
    let mut relative: Vec<f32> = differences().zip(truth).map(|(d, t)| d.abs() / mean(t).max(0.01 * scale)).collect();
    relative.sort_by(f32::total_cmp);
    let quantile = |q: f32| relative[((n - 1.0) * q) as usize] * 100.0;
    let average = |f: fn(&Gathered) -> f32| row.result.iter().map(f).sum::<f32>() / n;
    println!(
        "{:28} {:8.1} {:7.0} {:6.0} {:7.2} {:+7.2} {:7.2} {:7.2} {:9.0}",
        row.name,
        row.micros,
        average(|g| g.rays as f32),
        average(|g| g.cut as f32),
        rmse * 100.0,
        bias * 100.0,
        quantile(0.5),
        quantile(0.95),
        average(|g| g.bound) / scale * 100.0,
    );
}

fn report(scene: &Scene, n: u32) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let surfels = surfels(&geometry, n);
    let solution = solve(&rays, &surfels);
    let field = Field::new(&rays, &surfels, &solution).unwrap();
    let start = Instant::now();
    let tree = LightTree::indirect(&geometry, &surfels, &solution, 0.0, &Silent).expect("nobody cancels");
    let build = start.elapsed().as_secs_f64() * 1e3;
    println!("\n{}: {} surfels, light tree of {} lights in {build:.1} ms", scene.name, surfels.list.len(), tree.len());
    println!(
        "{:28} {:>8} {:>7} {:>6} {:>7} {:>7} {:>7} {:>7} {:>9}",
        "mode", "us", "rays", "cut", "rmse %", "bias %", "p50 %", "p95 %", "bound %"
    );
    let receivers = receivers(&geometry, &surfels, (surfels.list.len() / 1500).max(1));
    let truth = time("final gather 4096", &FinalGather::new(&field, 4096), &receivers);
    let cuts = |threshold: f32, near_rays: u32| {
        let settings = Settings { threshold, near_rays, ..Settings::default() };
        time(
            &format!("lightcuts {} %, {near_rays} rays", threshold * 100.0),
            &Lightcuts::new(&field, settings),
            &receivers,
        )
    };
    print(&time("look-up (8 bounces)", &Lookup::new(&field), &receivers), &truth.result);
    for count in [64, 256, 1024] {
        print(&time(&format!("final gather {count}"), &FinalGather::new(&field, count), &receivers), &truth.result);
    }
    for (threshold, near) in [(0.1, 16), (0.05, 16), (0.02, 16), (0.02, 64), (0.01, 16)] {
        print(&cuts(threshold, near), &truth.result);
    }
    print(&truth, &truth.result);
    for (name, gather) in [
        ("final gather 256", &FinalGather::new(&field, 256) as &dyn Gather),
        ("lightcuts", &Lightcuts::new(&field, Settings::default())),
    ] {
        nodes(name, gather, &FinalGather::new(&field, 4096), &charts(&geometry, 5, 96));
    }
}

/// A mode at nodes only, over charts of the walls: time a texel, and the error at some of all texels.
fn nodes(name: &str, gather: &dyn Gather, truth: &dyn Gather, (receivers, cells): &(Vec<Receiver>, Vec<Cell>)) {
    let start = Instant::now();
    let found = interpolate(gather, NodeSettings::default(), receivers, cells, &Silent).unwrap();
    let micros = start.elapsed().as_secs_f64() * 1e6 / receivers.len() as f64;
    let some = |i: &usize| i.is_multiple_of(37);
    let result = (0..receivers.len()).filter(some).map(|i| found.light[i]).collect();
    let tested: Vec<Receiver> = (0..receivers.len()).filter(some).map(|i| receivers[i]).collect();
    let share = 100 * found.nodes / receivers.len();
    let row = Row { name: format!("{name}, {share} % nodes"), micros, result };
    print(&row, &truth.gather(&tested, &Silent).unwrap());
}

fn main() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        for scene in [colours(), two_rooms(), open()] {
            report(&scene, 64);
        }
    });
}
