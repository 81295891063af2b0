//! Discrete rays, continuous rays, and the solve.

use std::hint::black_box;

use glam::Vec3;
use luxel_scene::{Scene, Silent, build::Builder};
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

use crate::{
    Goal, meter, row,
    support::tilted,
    yardstick::{self, Yardstick},
};

/// Runs of everything that is timed; the median counts.
const RUNS: usize = 5;

/// Continuous rays per run.
const RAYS: u64 = 100_000;

/// Directions of the first bounce, which decides the error; fewer with millions of surfels, to save time.
const DIRECTIONS: u32 = 512;
const FEWER: u32 = 256;

pub fn measure() {
    let cornell = luxel_assets::cornell();
    let at_128 = Subject::new(&cornell, Resolution::Side(128));
    let discrete = at_128.discrete(Rule::Surface, DIRECTIONS, false);
    row("discrete rays/s of a core, Cornell n = 128", discrete / 1e6, "M rays/s", least(300.0, 1000.0));
    let yardstick = at_128.yardstick();
    row("  yardstick: the literal exchange alone", yardstick / 1e6, "M rays/s", Goal::Information);
    row("  the same as a share of the yardstick", discrete / yardstick, "", least(300e6 / yardstick::THERE, 0.65));
    row("  surfels", at_128.count() as f64 / 1e3, "k", Goal::Information);
    row("  one band", at_128.discrete(Rule::Surface, DIRECTIONS, true) / 1e6, "M rays/s", Goal::Information);
    row("  literal rule", at_128.discrete(Rule::Literal, DIRECTIONS, false) / 1e6, "M rays/s", Goal::Information);
    let turned = tilted(cornell.clone());
    let turned_128 = Subject::new(&turned, Resolution::Budget(100_000));
    row("  tilted", turned_128.discrete(Rule::Surface, DIRECTIONS, false) / 1e6, "M rays/s", Goal::Information);
    let at_512 = Subject::new(&cornell, Resolution::Budget(1_700_000));
    let fine = at_512.discrete(Rule::Surface, FEWER, false);
    row("discrete rays/s of a core, Cornell N = 1.7 M", fine / 1e6, "M rays/s", least(120.0, 400.0));
    drop(at_512);

    row("discrete / continuous rays, Cornell", at_128.against_continuous(), "", least(60.0, 200.0));
    let hall = hall_of_balls();
    let dense = Subject::new(&hall, Resolution::Budget(100_000));
    let triangles = dense.geometry.triangles.len() as f64 / 1e3;
    row("discrete / continuous rays, 60k triangles", dense.against_continuous(), "", least(100.0, 200.0));
    row("  triangles", triangles, "k", Goal::Information);
    row("  discrete rays/s", dense.discrete(Rule::Surface, DIRECTIONS, false) / 1e6, "M rays/s", Goal::Information);

    drop(dense);
    if let Some(path) = crate::support::scenes().map(|p| p.join("sponza/sponza_dabrovic_area_light.glb")) {
        let scene = luxel_scene::import::load(&path, &luxel_scene::ImportOptions::default()).expect("the scene reads");
        let sponza = Subject::new(&scene, Resolution::Budget(100_000));
        row("discrete / continuous rays, Sponza, 66k triangles", sponza.against_continuous(), "", least(100.0, 200.0));
        row(
            "  discrete rays/s",
            sponza.discrete(Rule::Surface, DIRECTIONS, false) / 1e6,
            "M rays/s",
            Goal::Information,
        );
    }

    row("Cornell solve, n = 128, 512 directions halved", at_128.solve_seconds(), "s", most(1.5, 0.2));
    row("two threads against one, wall clock", at_128.two_threads(), "", least(1.7, 1.95));
    memory(&cornell);
}

fn least(must: f64, aim: f64) -> Goal {
    Goal::AtLeast { must, aim }
}

fn most(must: f64, aim: f64) -> Goal {
    Goal::AtMost { must, aim }
}

/// A closed room full of spheres, 60k triangles.
fn hall_of_balls() -> Scene {
    let mut b = Builder::new("hall of balls");
    let white = b.matte(Vec3::splat(0.7));
    b.cuboid("hall", Vec3::ZERO, Vec3::new(6.0, 4.0, 4.0), white, true);
    for i in 0..24 {
        let at = Vec3::new((i % 6) as f32 + 0.5, 1.2 + 1.6 * ((i / 6) % 2) as f32, 1.0 + 2.0 * (i / 12) as f32);
        b.sphere(&format!("ball {i}"), at, 0.35, 26, white, false);
    }
    b.build()
}

/// A scene that rays are sent through.
struct Subject<'a> {
    geometry: Geometry<'a>,
    surfels: Surfels,
}

impl<'a> Subject<'a> {
    fn new(scene: &'a Scene, resolution: Resolution) -> Self {
        let geometry = Geometry::new(scene);
        let surfels = voxels(&geometry, resolution);
        Self { geometry, surfels }
    }

    fn count(&self) -> usize {
        self.surfels.list.len()
    }

    fn sweep_seconds(&self, sweep: &Sweep, directions: &[Direction], grey: bool) -> f64 {
        let light = vec![Rgb::ONE; self.count()];
        meter::thread_seconds(|| {
            black_box(sweep.apply(directions, light, None, grey, &Silent).expect("nobody cancels"));
        })
    }

    /// Discrete rays a second on one thread: surfels × directions, where σ and −σ are two.
    fn discrete(&self, rule: Rule, directions: u32, grey: bool) -> f64 {
        let directions = DirectionSet::Fibonacci.directions(directions, 0);
        let sweep = Sweep::new(&self.surfels, rule, false);
        let seconds = pool(1).install(|| runs(|| self.sweep_seconds(&sweep, &directions, grey)));
        (self.count() * directions.len()) as f64 / seconds
    }

    /// Discrete rays a second of the literal exchange alone.
    fn yardstick(&self) -> f64 {
        let mut yardstick = Yardstick::new(&self.surfels);
        let mut directions = DirectionSet::Fibonacci.directions(DIRECTIONS, 0);
        directions.retain(|d| d.sigma.abs().max_element() == d.sigma.x.abs());
        let mut table = Vec::new();
        let seconds = runs(|| meter::thread_seconds(|| yardstick.sweep(&directions, &mut table)));
        yardstick.rays(&directions) / seconds
    }

    /// Discrete over continuous rays (incoherent closest hits), timed in turns.
    fn against_continuous(&self) -> f64 {
        let rays = Rays::new(&self.geometry);
        let starts: Vec<(Vec3, Vec3)> = (0..RAYS).map(|k| self.start(k)).collect();
        let directions = DirectionSet::Fibonacci.directions(DIRECTIONS, 0);
        let sweep = Sweep::new(&self.surfels, Rule::Surface, false);
        let ratio = || {
            let seconds = meter::thread_seconds(|| {
                starts.iter().for_each(|&(o, d)| {
                    black_box(rays.closest(o, d, f32::INFINITY));
                });
            });
            let continuous = RAYS as f64 / seconds;
            let discrete = (self.count() * directions.len()) as f64 / self.sweep_seconds(&sweep, &directions, false);
            discrete / continuous
        };
        pool(1).install(|| runs(ratio))
    }

    /// A cosine-distributed ray from a random surfel.
    fn start(&self, k: u64) -> (Vec3, Vec3) {
        let s = &self.surfels.list[(sampling::mix(k) % self.count() as u64) as usize];
        let (point, normal) = s.place(&self.geometry);
        let direction = sampling::cosine_hemisphere(sampling::unit2(sampling::mix(!k)));
        (point + normal * OFFSET, sampling::basis(normal) * direction)
    }

    fn solve_seconds(&self) -> f64 {
        let settings = SolveSettings::default();
        let direct = lit_from_above(&self.surfels);
        let run = || {
            meter::thread_seconds(|| {
                black_box(solve(&self.surfels, &direct, &settings, None, &Silent).expect("a solution"));
            })
        };
        pool(1).install(|| runs(run))
    }

    /// The best of several runs on each side: a machine that does something else can only make a run slower.
    fn two_threads(&self) -> f64 {
        let directions = DirectionSet::Fibonacci.directions(DIRECTIONS, 0);
        let sweep = Sweep::new(&self.surfels, Rule::Surface, false);
        let light = vec![Rgb::ONE; self.count()];
        let (one, two) = (pool(1), pool(2));
        let wall = |pool: &rayon::ThreadPool| {
            meter::wall_seconds(|| {
                pool.install(|| {
                    black_box(sweep.apply(&directions, light.clone(), None, false, &Silent).expect("no cancel"))
                });
            })
        };
        let times: Vec<(f64, f64)> = (0..2 * RUNS).map(|_| (wall(&one), wall(&two))).collect();
        let alone = times.iter().fold(f64::INFINITY, |m, t| m.min(t.0));
        let both = times.iter().fold(f64::INFINITY, |m, t| m.min(t.1));
        alone / both
    }
}

fn voxels(geometry: &Geometry, resolution: Resolution) -> Surfels {
    Surfels::new(geometry, &VoxelSettings { resolution, area: AreaRule::Clipped }, &Silent).expect("voxels")
}

fn lit_from_above(surfels: &Surfels) -> Vec<Rgb> {
    surfels.list.iter().map(|s| Rgb::new(1.0, 0.8, 0.6) * s.normal.y.max(0.0)).collect()
}

/// From a scene to its solution on two threads: surfels, direct light, solver.
fn memory(scene: &Scene) {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let ((surfels, voxelized), solved) = meter::peak_bytes(|| {
        pool(2).install(|| {
            let (surfels, voxelized) = meter::peak_bytes(|| voxels(&geometry, Resolution::Side(256)));
            let direct = lit_from_above(&surfels);
            let settings = SolveSettings { closed: is_closed(&rays, &surfels, 1 << 12), ..SolveSettings::default() };
            black_box(solve(&surfels, &direct, &settings, None, &Silent).expect("a solution"));
            (surfels.list.len(), voxelized)
        })
    });
    row("memory a surfel, surfels and solve, two threads", solved as f64 / surfels as f64, "bytes", most(150.0, 75.0));
    row("  voxelization alone", voxelized as f64 / surfels as f64, "bytes", Goal::Information);
}

fn runs(run: impl FnMut() -> f64) -> f64 {
    meter::median(std::iter::repeat_with(run).take(RUNS).collect())
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool")
}
