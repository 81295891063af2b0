//! Whole bakes: errors, texels, start-up, and times of the stages.

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Stdio},
    sync::Mutex,
    time::Instant,
};

use cpu_time::ProcessTime;
use luxel::{
    Lit, bake_scene,
    settings::{Only, Preset, Settings, value::Texels},
};
use luxel_scene::{ImportOptions, Progress, Scene};

use crate::{Goal, meter, row, support};

/// Texels per scene; `tests/accuracy.rs` looks at more.
const TEXELS: usize = 100;

/// What Cycles with its denoiser needed for Cornell at 512²: RMSE over the mean, and processor seconds.
const CYCLES: [(f64, f64); 3] = [(0.035, 3.2), (0.025, 8.6), (0.017, 35.0)];

/// What tells its progress while texels are laid out.
const UNWRAP: [&str; 3] = ["unwrap", "pack", "texels"];

/// From the start of the program to its first line of progress.
pub fn start_up() {
    let seconds = || {
        let out = tempfile::tempdir().expect("a folder");
        let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/cornell.glb");
        let start = Instant::now();
        let mut child = Command::new(env!("CARGO_BIN_EXE_luxel"))
            .args(["bake", "--json", "--out"])
            .args([out.path(), &scene])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("luxel starts");
        let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
        // The first line of all says that nothing was baked there yet.
        assert!(lines.any(|line| line.expect("a line").contains("\"started\"")), "no stage begins");
        let seconds = start.elapsed().as_secs_f64();
        child.kill().and_then(|()| child.wait()).expect("luxel stops");
        seconds
    };
    let times = std::iter::repeat_with(seconds).take(9).collect();
    row("start-up to the first line of progress", 1e3 * meter::median(times), "ms", most(100.0, 100.0));
}

/// Errors at the default preset, bytes and processor time per texel, the paper's Sponza.
pub fn measure() {
    let scenes = [
        ("Cornell", luxel_assets::cornell(), 8192),
        ("two rooms", luxel_assets::two_rooms(), 32_768),
        ("textured room", luxel_assets::textured_room(), 32_768),
        ("colonnade", luxel_assets::colonnade(), 4096),
    ];
    let settings = support::medium_512();
    // As many paths of the reference as its noise asks for.
    for (name, scene, paths) in &scenes {
        let (lit, stages) = timed(scene, &settings);
        let texels = support::some_texels(&lit, TEXELS, |_| true);
        let score = support::score_texels(scene, &lit, &texels, *paths);
        row(&format!("RMSE / mean E, {name}, 512²"), 100.0 * score.rmse, "%", most(3.0, 1.5));
        row("  bias", 100.0 * score.bias, "%", Goal::Information);
        row("  noise of the reference", 100.0 * score.noise, "%", Goal::Information);
        if *name == "Cornell" {
            times(&lit, &stages, score.rmse);
        }
    }
    memory(&scenes[0].1);
    sponza();
}

fn most(must: f64, aim: f64) -> Goal {
    Goal::AtMost { must, aim }
}

fn times(lit: &Lit, stages: &Stages, rmse: f64) {
    let texels = lit.atlas.texels.len() as f64;
    let gather = stages.seconds(&["clear", "direct", "sky", "gather"]) / texels;
    row("gather of a texel, indirect and direct, Cornell", 1e6 * gather, "µs", Goal::Information);
    let bake = stages.total() - stages.seconds(&UNWRAP);
    row("  whole bake without unwrap", bake, "s of CPU", Goal::Information);
    // The cheapest path-traced bake that is at least as good; where none is, the best.
    let cycles = CYCLES.iter().find(|c| c.0 <= rmse).unwrap_or(&CYCLES[2]).1;
    row("CPU time over that of Cycles at equal RMSE, Cornell", bake / cycles, "", Goal::Information);
}

/// Bytes that one more texel costs: two bakes that differ in the size of the lightmap alone.
fn memory(scene: &Scene) {
    let bytes = |size: u32| {
        let settings = Settings { size: Texels(size), ..Settings::preset(Preset::Medium) };
        let (lit, bytes) = meter::peak_bytes(|| support::bake(scene, &settings));
        (lit.atlas.texels.len() as f64, bytes as f64)
    };
    let (small, large) = (bytes(512), bytes(1024));
    let each = (large.1 - small.1) / (large.0 - small.0);
    row("memory a texel, whole bake, from 512² to 1024²", each, "bytes", most(64.0, 32.0));
}

fn sponza() {
    let Some(path) = support::scenes().map(|p| p.join("sponza/sponza_dabrovic_area_light.glb")) else { return };
    let scene = luxel_scene::import::load(&path, &ImportOptions::default()).expect("the scene reads");
    let settings = Settings { size: Texels(1024), ..Settings::preset(Preset::Medium) };
    let (lit, stages) = timed(&scene, &settings);
    assert!(lit.texels.irradiance.iter().any(|e| e.max_element() > 0.0), "the atrium is lit");
    let bounced = Settings { size: Texels(64), only: Only::Indirect, ..Settings::preset(Preset::Draft) };
    let bounced = support::bake(&scene, &bounced);
    assert!(bounced.texels.irradiance.iter().any(|e| e.max_element() > 0.0), "light bounces in the atrium");
    let seconds = stages.total() - stages.seconds(&UNWRAP);
    row("Sponza, 1024², medium, without unwrap", seconds, "s of CPU", Goal::Information);
}

fn timed(scene: &Scene, settings: &Settings) -> (Lit, Stages) {
    let stages = Stages::default();
    let lit = bake_scene(scene, settings, &stages).expect("a bake");
    stages.begin("end", 0);
    (lit, stages)
}

/// Processor time at which each stage began.
#[derive(Default)]
struct Stages(Mutex<Vec<(&'static str, ProcessTime)>>);

impl Stages {
    fn parts(&self) -> Vec<(&'static str, f64)> {
        let begun = self.0.lock().expect("no panic");
        begun.windows(2).map(|w| (w[0].0, w[1].1.duration_since(w[0].1).as_secs_f64())).collect()
    }

    fn total(&self) -> f64 {
        self.parts().iter().map(|p| p.1).sum()
    }

    fn seconds(&self, of: &[&str]) -> f64 {
        self.parts().iter().filter(|p| of.contains(&p.0)).map(|p| p.1).sum()
    }
}

impl Progress for Stages {
    fn begin(&self, stage: &'static str, _: u64) {
        self.0.lock().expect("no panic").push((stage, ProcessTime::now()));
    }

    fn advance(&self, _: u64) {}
}
