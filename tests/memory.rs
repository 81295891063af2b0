//! What a bake keeps in memory at once, beyond the scene: bytes of the heap a surfel and a texel, at the peak.

#[path = "bench/heap.rs"]
mod heap;
mod support;

use std::sync::{Mutex, MutexGuard};

use glam::Vec3;
use heap::peak_bytes;
use luxel::Request;
use luxel::plan::Plan;
use luxel::settings::{
    Preset, Resolved, Settings,
    value::{Texels, Threads, Voxels},
};
use luxel_export::OutputSet;
use luxel_scene::{Scene, Silent, build::Builder};
use luxel_transport::{
    Rgb,
    geometry::Geometry,
    octree::Octree,
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
        let (bytes, written) = peak_bytes(|| octree.to_bytes().expect("bytes"));
        let (_, read) = peak_bytes(|| Octree::from_bytes(&bytes, bytes.len()).expect("a tree"));
        let [made, written, read] = [made, written, read].map(each);
        println!("octree: {made:.1} bytes each beside the surfels, {written:.1} on disk");
        assert!(made < 160.0 && written < 105.0 && read < 105.0, "{made} {written} {read}");
    });
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
        assert!(report.stiff_steps > 4 && bytes < 275.0, "{bytes} in {} steps", report.stiff_steps);
    });
}

/// Little else than a lightmap of this side.
fn quick(size: u32) -> Settings {
    Settings { size: Texels(size), voxels: Voxels::Side(32), threads: Threads(2), ..Settings::preset(Preset::Draft) }
}

/// What one more texel costs, from the size of the lightmap alone.
#[test]
fn a_texel_of_a_whole_bake() {
    let _alone = alone();
    let scene = luxel_assets::cornell();
    let bytes = |size: u32| {
        let (lit, bytes) = peak_bytes(|| support::bake(&scene, &quick(size)));
        (lit.atlas.texels.len() as f64, bytes as f64)
    };
    let (small, large) = (bytes(256), bytes(512));
    let each = (large.1 - small.1) / (large.0 - small.0);
    println!("{each:.1} bytes a texel");
    assert!(each < 64.0, "{each}");
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

/// A bake from file to files, encoders included, stays within what the plan estimates, and not far below.
#[test]
fn a_whole_bake_and_its_plan() {
    let _alone = alone();
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.glb");
    let scene = luxel_assets::cornell();
    std::fs::write(&path, luxel_assets::glb::write(&scene).expect("a scene")).expect("a file");
    let bake = |size: u32| {
        let settings = quick(size);
        let plan = Plan::new(&scene, &settings);
        let request = Request {
            scene: path.clone(),
            outputs: OutputSet::new(&path, Some(&folder.path().join(size.to_string())), None).expect("a place"),
            settings: Resolved { settings, ..Resolved::default() },
            worker: None,
        };
        let (baked, bytes) = peak_bytes(|| luxel::bake(&request, &Silent).expect("a bake"));
        let pixels = f64::from(size * size);
        (pixels, baked.lit.atlas.texels.len() as f64 / pixels, bytes as f64, plan.memory)
    };
    let (small, large) = (bake(512), bake(1024));
    let each = (large.2 - small.2) / (large.0 - small.0);
    println!("{each:.1} bytes a pixel of a page, of which {:.3} are texels", large.1);
    let (found, stated) = (large.2, large.3.total() as f64);
    println!("{:.1} MiB where the plan estimates {:.1}", found / 1048576.0, stated / 1048576.0);
    assert!(found < stated && stated < 1.25 * found, "{found} and {stated}");
}
