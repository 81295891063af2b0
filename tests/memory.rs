//! What a bake keeps in memory at once, beyond the scene: bytes of the heap a surfel and a texel, at the peak.

#[path = "bench/heap.rs"]
mod heap;
mod support;

use std::sync::{Mutex, MutexGuard};

use glam::{DVec3, Vec3};
use heap::peak_bytes;
use luxel::Request;
use luxel::settings::{
    GatherMode, Preset, Resolved, Settings,
    value::{Samples, Texels, Threads, Voxels},
};
use luxel_export::{OutputSet, report::StageState};
use luxel_scene::{Light, LightKind, Progress, Scene, Silent, build::Builder};
use luxel_transport::{
    Rgb,
    gather::{Field, Lightcuts, PhotonMap, lightcuts, photon_map},
    geometry::Geometry,
    lights::Emitters,
    octree::{self, Octree},
    rays::Rays,
    solve::{SolveReport, SolveSettings, solve},
    surfel::{AreaRule, Resolution, Solution, Surfels, VoxelSettings},
};

#[global_allocator]
static ALLOCATOR: heap::Counting = heap::Counting;

/// The heap is one for all tests.
fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(|e| e.into_inner())
}

fn on_two_threads<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("a pool").install(work)
}

/// A stage, and the most bytes in use during it.
type Lap = (&'static str, usize);

/// The stages of a bake.
#[derive(Default)]
struct Laps(Mutex<Vec<Lap>>);

impl Laps {
    /// Ends the stage that runs.
    fn end(&self) {
        let peak = heap::lap().1;
        if let Some(last) = self.0.lock().expect("laps").last_mut() {
            last.1 = peak;
        }
    }
}

impl Progress for Laps {
    fn begin(&self, stage: &'static str, _: u64) {
        self.end();
        self.0.lock().expect("laps").push((stage, 0));
    }
    fn advance(&self, _: u64) {}
}

/// Runs a bake that reports to `laps`.
fn with_laps<T>(laps: &Laps, work: impl FnOnce() -> T) -> T {
    heap::lap();
    let result = work();
    laps.end();
    result
}

/// By stage, how many bytes more the second of two bakes holds for each thing that it has more.
fn costs(small: (f64, &Laps), large: (f64, &Laps)) -> Vec<(&'static str, f64)> {
    let [few, many] = [small.1, large.1].map(|laps| laps.0.lock().expect("laps").clone());
    assert!(few.iter().map(|lap| lap.0).eq(many.iter().map(|lap| lap.0)), "the same stages");
    let each = |(few, many): (&Lap, &Lap)| (few.0, (many.1 as f64 - few.1 as f64) / (large.0 - small.0));
    few.iter().zip(&many).map(each).collect()
}

/// Prints [`costs`] a texel; returns the stage that costs most.
fn dearest(what: &str, small: (f64, &Laps), large: (f64, &Laps)) -> (&'static str, f64) {
    let costs = costs(small, large);
    costs.iter().for_each(|(stage, bytes)| println!("{what}: {bytes:.1} bytes a texel in {stage}"));
    costs.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("a stage")
}

fn voxels(geometry: &Geometry, n: u32) -> Surfels {
    let settings = VoxelSettings { resolution: Resolution::Side(n), area: AreaRule::Clipped };
    Surfels::new(geometry, &settings, &Silent).expect("voxels")
}

fn lit_from_above(surfels: &Surfels) -> Vec<Rgb> {
    surfels.list.iter().map(|s| Rgb::new(1.0, 0.8, 0.6) * s.normal.y.max(0.0)).collect()
}

/// From surfels to their solution: bytes a surfel at the peak, surfels and direct light included.
fn solved(surfels: &Surfels, settings: &SolveSettings) -> (f64, Solution, SolveReport) {
    let count = surfels.list.len() as f64;
    let ((solution, report), bytes) = peak_bytes(|| {
        let direct = lit_from_above(surfels);
        solve(surfels, &direct, settings, None, &Silent).expect("a solution")
    });
    (bytes as f64 / count + size_of_val(&surfels.list[0]) as f64, solution, report)
}

#[test]
fn an_arrival_of_a_photon() {
    let _alone = alone();
    let scene = luxel_assets::cornell();
    let geometry = Geometry::new(&scene);
    let (rays, emitters) = (Rays::new(&geometry), Emitters::new(&geometry));
    on_two_threads(|| {
        // Lists double as they grow, so that it depends on their length how much of them is empty.
        let each = |photons| {
            let settings = photon_map::Settings { photons, ..photon_map::Settings::default() };
            let (map, bytes) = peak_bytes(|| PhotonMap::new(&rays, &emitters, settings));
            bytes as f64 / map.facts().arrivals as f64
        };
        let each = [18_000, 22_000, 26_000, 30_000].map(each);
        println!("an arrival of a photon: {each:.1?} bytes");
        assert!(each.iter().all(|each| *each < 320.0), "{each:?}");
    });
}

#[test]
fn a_surfel_and_its_light() {
    let _alone = alone();
    let scene = luxel_assets::cornell();
    let geometry = Geometry::new(&scene);
    on_two_threads(|| {
        let (surfels, bytes) = peak_bytes(|| voxels(&geometry, 128));
        let count = surfels.list.len() as f64;
        let each = |bytes: usize| bytes as f64 / count;
        let voxelized = each(bytes);
        // The list, and the slabs that it was copied from.
        assert!(voxelized < 110.0, "{voxelized}");
        let (solved, solution, _) = solved(&surfels, &SolveSettings::default());
        println!("{count} surfels: {voxelized:.1} bytes each when voxelized, {solved:.1} when solved");
        assert!(solved < 150.0, "{solved}");
        let (octree, made) = peak_bytes(|| Octree::new(&surfels, &solution));
        let (length, written) = peak_bytes(|| {
            let mut counted = Counted(0);
            octree.write(&mut counted).expect("bytes");
            counted.0
        });
        let mut bytes = Vec::with_capacity(length);
        octree.write(&mut bytes).expect("bytes");
        let (_, read) = peak_bytes(|| octree::read(&mut &bytes[..], bytes.len() as u64).expect("a tree"));
        let [made, written, read, length] = [made, written, read, length].map(each);
        println!(
            "octree: {made:.1} bytes each beside the surfels, {written:.1} to write, {read:.1} to read, {length:.1} on disk"
        );
        assert!(made < 35.0 && written < 5.0 && read < 100.0 && length < 105.0, "{made} {written} {read} {length}");
        drop((octree, bytes));
        let rays = Rays::new(&geometry);
        let (_, cuts) = peak_bytes(|| {
            let field = Field::new(&rays, &surfels, &solution).expect("a field");
            Lightcuts::new(&field, lightcuts::Settings::default()).covered()
        });
        let cuts = each(cuts);
        println!("light tree and index: {cuts:.1} bytes each beside surfels and solution");
        assert!(cuts < 74.0, "{cuts}");
    });
}

/// Takes bytes and keeps their number.
struct Counted(usize);

impl std::io::Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0 += bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A room so white that plain bounces would take hundreds.
fn white_room() -> Scene {
    let mut b = Builder::new("white room");
    let white = b.matte(Vec3::splat(0.99));
    b.cuboid("room", Vec3::ZERO, Vec3::new(1.0, 0.9, 1.1), white, true);
    b.cuboid("block", Vec3::new(0.3, 0.2, 0.35), Vec3::new(0.55, 0.6, 0.6), white, false);
    b.build()
}

#[test]
fn a_surfel_of_a_white_room() {
    let _alone = alone();
    let scene = white_room();
    let geometry = Geometry::new(&scene);
    on_two_threads(|| {
        let surfels = voxels(&geometry, 64);
        let (bytes, _, report) = solved(&surfels, &SolveSettings { closed: true, ..SolveSettings::default() });
        println!("stiff: {bytes:.1} bytes a surfel in {} steps", report.stiff_steps);
        assert!(report.stiff_steps > 3 && bytes < 275.0, "{bytes} in {} steps", report.stiff_steps);
    });
}

/// Seen from above, a terrain has as many lines as surfels; with many threads fewer directions are swept at once.
#[test]
fn a_surfel_of_a_terrain_on_many_threads() {
    let _alone = alone();
    let mut b = Builder::new("terrain");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("ground", Vec3::ZERO, Vec3::Z, Vec3::X, grey);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let surfels = voxels(&geometry, 300);
    for (threads, most) in [(2, 177.0), (16, 209.0)] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let (bytes, ..) = pool.install(|| solved(&surfels, &SolveSettings::default()));
        println!("{} surfels of a terrain, {threads} threads: {bytes:.1} bytes each", surfels.list.len());
        assert!(bytes < most, "{bytes}");
    }
}

/// Little else than a lightmap of this side.
fn quick(size: u32) -> Settings {
    Settings { size: Texels(size), voxels: Voxels::Side(32), threads: Threads(2), ..Settings::preset(Preset::Draft) }
}

/// What one more texel costs, from the size of the lightmap alone, by stage: the light at texels is handed over.
#[test]
fn a_texel_of_a_whole_bake() {
    let _alone = alone();
    let scene = luxel_assets::cornell();
    let bake = |size: u32| {
        let laps = Laps::default();
        let lit = with_laps(&laps, || luxel::bake_scene(&scene, &quick(size), &laps).expect("a bake"));
        (lit.atlas.texels.len() as f64, laps)
    };
    let (small, large) = (bake(512), bake(1024));
    let most = dearest("in memory", (small.0, &small.1), (large.0, &large.1));
    assert!(most.1 < 64.0, "{most:?}");
}

/// What rays need beside the scene, the making of their trees included.
#[test]
fn a_triangle_and_its_rays() {
    let _alone = alone();
    let mut b = Builder::new("blocks");
    let grey = b.matte(Vec3::splat(0.5));
    for i in 0..4000u16 {
        let at = Vec3::new(f32::from(i % 20), f32::from(i / 20 % 20), f32::from(i / 400)) * 2.0;
        b.cuboid("block", at, at + Vec3::ONE, grey, false);
    }
    let scene = b.build();
    let (triangles, bytes) = on_two_threads(|| {
        peak_bytes(|| {
            let geometry = Geometry::new(&scene);
            let rays = Rays::new(&geometry);
            rays.geometry.triangles.len()
        })
    });
    let each = bytes as f64 / triangles as f64;
    println!("{triangles} triangles: {each:.1} bytes each with their rays");
    assert!(each < 420.0, "{each}");
}

/// A bake from file to files, encoders included, costs no more than that a texel, and stays within what the plan
/// estimates, not far below.
#[test]
fn a_whole_bake_and_its_plan() {
    let _alone = alone();
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.glb");
    let save = |scene: &Scene| {
        std::fs::write(&path, luxel_assets::glb::write(scene).expect("a scene")).expect("a file");
    };
    let bake = |settings: Settings| {
        let resolved = Resolved { settings, ..Resolved::default() };
        let plan = luxel::plan_file(&path, None, &resolved, &Silent).expect("a plan");
        // None finds another's stored light.
        let folder = tempfile::tempdir_in(folder.path()).expect("a folder");
        let request = Request {
            scene: path.clone(),
            outputs: OutputSet::new(&path, Some(folder.path()), None).expect("a place"),
            settings: resolved,
            worker: None,
            store: Default::default(),
            kept: Default::default(),
        };
        let laps = Laps::default();
        let before = heap::lap().0;
        let baked = with_laps(&laps, || luxel::bake(&request, &laps).expect("a bake"));
        let peak = laps.0.lock().expect("laps").iter().map(|lap| lap.1).max().unwrap_or_default();
        for lap in laps.0.lock().expect("laps").iter().filter(|lap| 10 * lap.1 > 8 * peak) {
            println!("{}: {:.1} MiB, near the peak", lap.0, (lap.1 - before) as f64 / 1048576.0);
        }
        (baked.report.counters["texels"] as f64, laps, (peak - before) as f64, plan.memory.total() as f64)
    };
    let mut scene = luxel_assets::cornell();
    save(&scene);
    let (small, large) = (bake(quick(512)), bake(quick(1024)));
    let most = dearest("file to files", (small.0, &small.1), (large.0, &large.1));
    assert!(most.1 < 64.0, "{most:?}");
    let pixels = 1024.0 * 1024.0;
    println!("{:.3} texels a pixel, {:.1} bytes a pixel of a page", large.0 / pixels, most.1 * large.0 / pixels);
    for (_, _, found, stated) in [&small, &large] {
        println!("{:.1} MiB where the plan estimates {:.1}", found / 1048576.0, stated / 1048576.0);
        assert!(found < stated && *stated < 1.25 * found, "{found} and {stated}");
    }

    // Interpolation between nodes holds whole charts, here of up to a sixth of all texels; larger atlases have larger ones.
    let cuts = |bound, size| Settings { bound, gather: GatherMode::Lightcuts, directions: Samples(16), ..quick(size) };
    for (what, bound) in [("cuts", false), ("cuts with bounds", true)] {
        let cuts = |size| cuts(bound, size);
        let (small, large) = (bake(cuts(256)), bake(cuts(512)));
        let most = dearest(what, (small.0, &small.1), (large.0, &large.1));
        let (found, stated) = (large.2, large.3);
        println!("{:.1} MiB where the plan estimates {:.1}", found / 1048576.0, stated / 1048576.0);
        assert!(most.1 < 72.0 && found < stated, "{most:?}, {found} and {stated}");
    }

    let position = DVec3::new(0.2, 0.3, 0.2);
    let kind = LightKind::Point { position, range: None, radius: 0.0 };
    scene.lights.push(Light { name: "bulb".into(), node: 90, group: "bulb".into(), kind, intensity: Vec3::ONE });
    save(&scene);
    for (what, make) in
        [("two groups", &quick as &dyn Fn(u32) -> Settings), ("with cuts and bounds", &|size| cuts(true, size))]
    {
        let (small, large) = (bake(make(512)), bake(make(1024)));
        let most = dearest(what, (small.0, &small.1), (large.0, &large.1));
        let (found, stated) = (large.2, large.3);
        println!("{:.1} MiB where the plan estimates {:.1}", found / 1048576.0, stated / 1048576.0);
        assert!(most.1 > 64.0 && found < stated && stated < 1.25 * found, "{most:?}, {found} and {stated}");
    }
}

/// What one more surfel costs in each stage from file to files, made anew or read back: the voxels alone grow.
#[test]
fn a_surfel_of_a_whole_bake() {
    let _alone = alone();
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.glb");
    std::fs::write(&path, luxel_assets::glb::write(&luxel_assets::cornell()).expect("a scene")).expect("a file");
    let bake = |side: u32, state: StageState| {
        let settings = Settings {
            size: Texels(64),
            voxels: Voxels::Side(side),
            threads: Threads(2),
            ..Settings::preset(Preset::Medium)
        };
        let request = Request {
            scene: path.clone(),
            outputs: OutputSet::new(&path, Some(&folder.path().join(side.to_string())), None).expect("a place"),
            settings: Resolved { settings, ..Resolved::default() },
            worker: None,
            store: Default::default(),
            kept: Default::default(),
        };
        let laps = Laps::default();
        let baked = with_laps(&laps, || luxel::bake(&request, &laps).expect("a bake"));
        let cache = baked.report.stages.iter().find(|s| s.name == "cache").expect("the cache");
        assert_eq!(cache.state, state);
        (baked.report.counters["surfels"] as f64, laps)
    };
    let [fresh, again] = [StageState::Ran, StageState::Reused].map(|state| {
        let (few, many) = (bake(80, state), bake(160, state));
        let costs = costs((few.0, &few.1), (many.0, &many.1));
        costs.iter().for_each(|(stage, bytes)| println!("{state:?}: {bytes:.1} bytes a surfel in {stage}"));
        costs.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("a stage")
    });
    assert!(fresh.1 < 150.0 && again.1 < 150.0, "{fresh:?} and {again:?}");
}
