//! How long a bake goes on after it is no longer wanted: the longest time without a look at it, stage by stage, in
//! processor time, so that nothing else on the machine counts. Waiting for the disk is not in it, nor the unwrap worker,
//! which is waited for in steps of 20 ms.

use std::{
    path::Path,
    sync::{Mutex, PoisonError},
};

use cpu_time::ProcessTime;
use luxel::{
    Request, bake,
    settings::{
        Preset, Resolved, Settings,
        value::{Texels, Threads},
    },
};
use luxel_export::OutputSet;
use luxel_scene::Progress;

use crate::{Goal, row, support};

/// A bake has to stop within this time [ms].
const STOP: f64 = 100.0;

/// Bakes Sponza from file to files, on one thread: with more of them, looks come at least as often.
pub fn measure() {
    let Some(path) = support::scenes().map(|p| p.join("sponza/sponza_dabrovic_area_light.glb")) else { return };
    let is_medium = std::env::args().any(|a| a == "medium");
    let (preset, size) = if is_medium { (Preset::Medium, 1024) } else { (Preset::Draft, 512) };
    println!("longest time between two looks at whether the bake is still wanted: Sponza, {preset:?}, {size}²");
    of(&path, Settings { size: Texels(size), threads: Threads(1), ..Settings::preset(preset) });
}

fn of(scene: &Path, settings: Settings) {
    let out = tempfile::tempdir().expect("a folder");
    let outputs = OutputSet::new(scene, Some(out.path()), None).expect("a place");
    let settings = Resolved { settings, ..Resolved::default() };
    let worker = Some(env!("CARGO_BIN_EXE_luxel").into());
    let request =
        Request { scene: scene.into(), outputs, settings, worker, store: Default::default(), kept: Default::default() };
    let looks = Looks::new();
    bake(&request, &looks).expect("a bake");
    for stage in looks.ended() {
        let what = format!("  {}, {} looks", stage.name, stage.count);
        row(&what, stage.longest, "ms", Goal::AtMost { must: STOP, aim: STOP / 2.0 });
    }
}

/// What was seen of a stage.
struct Stage {
    name: &'static str,
    /// Number of looks.
    count: u64,
    /// Longest time without one [ms].
    longest: f64,
}

/// Every look ends a time without one.
struct Looks(Mutex<(ProcessTime, Vec<Stage>)>);

impl Looks {
    fn new() -> Self {
        let first = Stage { name: "(before the first stage)", count: 0, longest: 0.0 };
        Self(Mutex::new((ProcessTime::now(), vec![first])))
    }

    fn look(&self) {
        let mut seen = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = ProcessTime::now();
        let without = 1e3 * now.duration_since(std::mem::replace(&mut seen.0, now)).as_secs_f64();
        if let Some(stage) = seen.1.last_mut() {
            stage.count += 1;
            stage.longest = stage.longest.max(without);
        }
    }

    /// All stages; what follows the last look is one too.
    fn ended(self) -> Vec<Stage> {
        self.look();
        self.0.into_inner().unwrap_or_else(PoisonError::into_inner).1
    }
}

impl Progress for Looks {
    fn begin(&self, name: &'static str, _: u64) {
        let mut seen = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.1.last().is_none_or(|stage| stage.name != name) {
            seen.1.push(Stage { name, count: 0, longest: 0.0 });
        }
    }

    fn advance(&self, _: u64) {}

    fn is_cancelled(&self) -> bool {
        self.look();
        false
    }
}
