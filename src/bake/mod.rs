//! The bake of one scene: the whole chain, stage by stage, from a file to files.

mod direct;
mod export;
mod finish;
mod input;
pub mod journal;
mod light;
mod memory;
mod record;
mod report;
mod texels;
mod transport;
mod turns;

use std::borrow::Cow;
use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};
use std::time::Instant;

use luxel_atlas::{Atlas, AtlasReport, InProcess, Unwrapper, Worker};
use luxel_export::{BoundMap, Lightmap, Original, OutputSet, Report, report::Warning};
use luxel_scene::{InputFile, Progress, Scene};
use luxel_transport::{geometry::Geometry, rays::Rays};

use crate::Error;
use crate::plan::{Plan, Stage};
use crate::settings::{Resolved, Settings};
use journal::Journal;
use light::Parts;
pub use light::TexelLight;
pub(crate) use report::{json_form, versions};
pub use turns::{Alone, Gate, Leave, Turn, Turns};

/// What to bake, where to, and how.
#[derive(Clone, Debug)]
pub struct Request {
    /// A .gltf or .glb file.
    pub scene: PathBuf,
    /// Where its files go.
    pub outputs: OutputSet,
    pub settings: Resolved,
    /// The `luxel` binary, as whose child meshes are unwrapped, so that a crash of the unwrapper costs a chart and not
    /// the bake. Without it they are unwrapped within this process.
    pub worker: Option<PathBuf>,
}

/// A finished bake. Its light lies in its files; [`bake_scene`] hands it over instead.
#[derive(Debug)]
pub struct Baked {
    pub report: Report,
    /// The files that were written, the report last.
    pub files: Vec<PathBuf>,
    /// Every file that was read, with the digest of its bytes: by the import, and by the export, which embeds images
    /// that the light does not depend on. Each once.
    pub inputs: Vec<InputFile>,
    /// Wall-clock time.
    pub seconds: f64,
}

/// A scene's light at its texels.
#[derive(Debug, Default)]
pub struct Lit {
    pub atlas: Atlas,
    pub atlas_report: AtlasReport,
    /// By texel of the atlas, before dilation and stitching; empty where images are all that is kept.
    pub texels: TexelLight,
    /// By page of the atlas.
    pub lightmaps: Vec<Lightmap>,
    /// By page, where the settings ask for it.
    pub bounds: Vec<BoundMap>,
    pub(crate) sums: light::Sums,
    pub(crate) transport: transport::Facts,
}

/// What of the light at texels outlives the images that are made of it.
#[derive(Clone, Copy, PartialEq)]
enum Keep {
    Texels,
    Images,
}

/// Bakes a scene file to files (the chain is shown in the crate's documentation). When it fails or is cancelled, the
/// files of an earlier bake are untouched.
pub fn bake(request: &Request, progress: &dyn Progress) -> Result<Baked, Error> {
    bake_in_turn(request, &Alone(request.settings.settings.threads.0), progress)
}

/// [`bake`] among others: once the scene is open it waits at a gate, which also says on how many threads it goes on.
/// How many makes no difference to any byte but those of the times in the report.
pub fn bake_in_turn(request: &Request, gate: &dyn Gate, progress: &dyn Progress) -> Result<Baked, Error> {
    let start = Instant::now();
    let settings = &request.settings.settings;
    let mut journal = Journal::new(progress);
    let (scene, original, mut plan) = on_threads(gate.opening(), || {
        journal.always(Stage::Import, "", Some(input::STEPS), |progress, counters| {
            let (scene, original, plan) = input::open(&request.scene, settings, progress)?;
            counters.insert("triangles".into(), scene.triangle_count() as u64);
            counters.insert("files".into(), scene.inputs.len() as u64);
            Ok((scene, original, plan))
        })
    })?;
    journal.explain(Stage::Import, plan.reason(Stage::Import));
    let leave = gate.enter(&plan.least_memory(settings), progress)?;
    plan.warnings.extend(leave.warning);
    on_threads(leave.threads, move || run(request, scene, original, plan, journal, start))
}

/// Everything after the import.
fn run(
    request: &Request,
    scene: Scene,
    original: Original,
    plan: Plan,
    mut journal: Journal,
    start: Instant,
) -> Result<Baked, Error> {
    let progress = journal.progress;
    let settings = &request.settings.settings;
    progress.check()?;
    let inputs = input::Inputs::new(&request.scene, &scene, &original);
    progress.check()?;
    let key = input::key(&scene, settings, &Stage::ALL, matters);
    let geometry = Geometry::new(&scene);
    progress.check()?;
    export::probe(&request.outputs)?;
    let store = transport::Store::new(&request.outputs, &scene, settings);
    if plan.runs(Stage::Cache) {
        store.probe()?;
    }
    let (lit, rays) = match &request.worker {
        Some(path) => light(&geometry, settings, &plan, &worker(path), Some(&store), Keep::Images, &mut journal)?,
        None => light(&geometry, settings, &plan, &InProcess, Some(&store), Keep::Images, &mut journal)?,
    };
    let picture = export::preview(&geometry, rays.as_ref(), &plan, &lit, &mut journal)?;
    drop(rays);
    let mut report = report::start(&scene, &inputs, &plan, &request.settings);
    let glb = export::glb(request, &original, &scene, &plan, &lit, &mut report, &mut journal)?;
    report::fill(&mut report, &scene, settings, &plan, &lit, &journal, start.elapsed().as_secs_f64());
    // Beside the encoders lives what they read.
    let Lit { lightmaps, bounds, .. } = lit;
    let images = (&lightmaps[..], &bounds[..]);
    let files = export::write(&request.outputs, images, picture.as_deref(), &glb, &key, &mut report, progress)?;
    Ok(Baked { report, files, inputs: inputs.read, seconds: start.elapsed().as_secs_f64() })
}

/// Whether the result depends on the setting of this name: the number of threads changes no byte.
pub(crate) fn matters(setting: &str) -> bool {
    setting != "threads"
}

/// Bakes a scene in memory: atlas, light at texels, finished images; no file is read or written.
pub fn bake_scene(scene: &Scene, settings: &Settings, progress: &dyn Progress) -> Result<Lit, Error> {
    with_threads(settings, || {
        let plan = Plan::new(scene, settings);
        let geometry = Geometry::new(scene);
        Ok(light(&geometry, settings, &plan, &InProcess, None, Keep::Texels, &mut Journal::new(progress))?.0)
    })
}

/// What a bake of the file would do.
///
/// With the place of its outputs, it looks there for stored light and marks the stages that would reuse it.
pub fn plan_file(
    path: &Path,
    outputs: Option<&OutputSet>,
    settings: &Settings,
    progress: &dyn Progress,
) -> Result<Plan, Error> {
    guarded(|| {
        progress.begin(Stage::Import.name(), input::STEPS);
        let (scene, _, mut plan) = input::open(path, settings, progress)?;
        match memory::check(&plan.least_memory(settings)) {
            Ok(warning) => plan.warnings.extend(warning),
            // A plan is what one asks for in order to find out.
            Err(refusal) => plan.warnings.push(Warning { code: "memory".into(), message: refusal.to_string() }),
        }
        if let Some(outputs) = outputs {
            transport::foresee(&mut plan, &transport::Store::new(outputs, &scene, settings), &scene);
        }
        Ok(plan)
    })
}

/// The middle of the chain: from the scene to finished images.
fn light<'g>(
    geometry: &'g Geometry<'g>,
    settings: &Settings,
    plan: &Plan,
    unwrapper: &dyn Unwrapper,
    store: Option<&transport::Store>,
    keep: Keep,
    journal: &mut Journal,
) -> Result<(Lit, Option<Rays<'g>>), Error> {
    let scene = geometry.scene;
    let unwrapped = journal.run(plan, Stage::Unwrap, None, |progress, counters| {
        let (atlas, report) = luxel_atlas::build(scene, &input::atlas_settings(settings), unwrapper, progress)?;
        counters.insert("pages".into(), atlas.pages.len() as u64);
        counters.insert("charts".into(), atlas.charts.len() as u64);
        counters.insert("texels".into(), atlas.texels.len() as u64);
        counters.insert("unwrapped_meshes".into(), u64::from(report.unwrapped));
        counters.insert("shared_unwraps".into(), u64::from(report.shared));
        counters.insert("kept_layouts".into(), report.kept.len() as u64);
        Ok((atlas, report))
    })?;
    if let Some((_, report)) = &unwrapped {
        journal.explain(Stage::Unwrap, &format!("{}; {}", plan.reason(Stage::Unwrap), report::layouts(report)));
    }
    // Without an unwrap no instance has a place, and the atlas still says so of every one of them.
    let nowhere = || (Atlas { placed: vec![None; scene.instances.len()], ..Atlas::default() }, AtlasReport::default());
    let (atlas, atlas_report) = unwrapped.unwrap_or_else(nowhere);
    let rays = journal.run(plan, Stage::Rays, Some(0), |progress, _| Ok(Rays::build(geometry, progress)?))?;
    let ((mut texels, sums), transport) = match &rays {
        Some(rays) => {
            let transport = transport::run(rays, settings, plan, store, journal)?;
            let texels = texels::run(rays, &atlas, &transport, settings, plan, journal)?;
            (texels, transport.facts)
        }
        None => {
            transport::skip(plan, journal);
            texels::skip(plan, journal);
            (Parts::dark(atlas.texels.len(), plan.states_bound(settings)).merged(&atlas), transport::Facts::default())
        }
    };
    let images = journal.run(plan, Stage::Finish, Some(finish::STEPS), |progress, counters| {
        let light = match keep {
            Keep::Texels => Cow::Borrowed(&texels),
            Keep::Images => Cow::Owned(std::mem::take(&mut texels)),
        };
        let (lightmaps, bounds, report) = finish::run(scene, &atlas, light, settings, plan, progress)?;
        counters.insert("filled_texels".into(), report.filled.into());
        counters.insert("lost_texels".into(), report.lost.into());
        counters.insert("seam_samples".into(), report.seam_samples.into());
        Ok((lightmaps, bounds))
    })?;
    let (lightmaps, bounds) = images.unwrap_or_default();
    Ok((Lit { atlas, atlas_report, texels, lightmaps, bounds, sums, transport }, rays))
}

/// The tool's own binary as a child that unwraps.
fn worker(path: &Path) -> Worker {
    Worker::new(path, ["unwrap-worker"])
}

/// Runs `work` on as many threads as the settings say.
fn with_threads<T: Send>(settings: &Settings, work: impl FnOnce() -> Result<T, Error> + Send) -> Result<T, Error> {
    on_threads(settings.threads.0, work)
}

/// Runs `work` on a pool of its own, so that an embedding program keeps its threads.
fn on_threads<T: Send>(threads: u32, work: impl FnOnce() -> Result<T, Error> + Send) -> Result<T, Error> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build();
    let pool = pool.map_err(|source| Error::Threads { threads, source })?;
    guarded(|| pool.install(work))
}

/// The boundary of one scene: a panic within it, be it in a decoder that a file has upset, is that scene's error. What
/// `work` was about to make is lost; files are only ever replaced whole, so none is left half written.
pub(crate) fn guarded<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    std::panic::catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<&str>().copied().or(panic.downcast_ref::<String>().map(String::as_str));
        Err(Error::Internal { what: text.unwrap_or("a panic without a message").into() })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{
        Preset, Voxels,
        value::{Texels, Threads},
    };
    use luxel_scene::Silent;
    use rayon::prelude::*;

    /// Breaks down at a stage, as a decoder may over a file.
    struct Broken(&'static str);

    impl Progress for Broken {
        fn begin(&self, stage: &'static str, _: u64) {
            assert!(stage != self.0, "the seam of {stage} burst");
        }
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            false
        }
    }

    fn request(folder: &Path) -> Request {
        let scene = folder.join("level.glb");
        std::fs::write(&scene, luxel_assets::glb::write(&luxel_assets::cornell()).unwrap()).unwrap();
        let outputs = OutputSet::new(&scene, None, None).unwrap();
        let mut settings = Resolved { settings: Settings::preset(Preset::Draft), ..Resolved::default() };
        settings.settings.size = Texels(32);
        settings.settings.voxels = Voxels::Budget(500);
        Request { scene, outputs, settings, worker: None }
    }

    #[test]
    fn a_panic_is_the_error_of_its_scene_and_leaves_the_last_bake_alone() {
        let folder = tempfile::tempdir().unwrap();
        let request = request(folder.path());
        bake(&request, &Silent).unwrap();
        let report = || std::fs::read(request.outputs.report()).unwrap();
        let before = report();
        for stage in ["import", "texels", "direct", "export"] {
            let error = bake(&request, &Broken(stage)).unwrap_err();
            assert!(matches!(&error, Error::Internal { what } if what.contains(stage)), "{stage}: {error}");
            assert!(error.to_string().contains("a bug in luxel"));
        }
        assert_eq!(report(), before);
        let planned = plan_file(&request.scene, None, &Settings::default(), &Broken("import"));
        assert!(matches!(planned, Err(Error::Internal { .. })));
        bake(&request, &Silent).unwrap();
    }

    /// Saves another level over the scene when a stage begins.
    struct Saving<'a>(&'a Path);

    impl Progress for Saving<'_> {
        fn begin(&self, stage: &'static str, _: u64) {
            if stage == "unwrap" {
                std::fs::write(self.0, b"another level").unwrap();
            }
        }
        fn advance(&self, _: u64) {}
    }

    #[test]
    fn a_level_that_is_saved_while_it_is_baked_does_not_cost_the_bake() {
        let folder = tempfile::tempdir().unwrap();
        let request = request(folder.path());
        let baked = bake(&request, &Saving(&request.scene)).unwrap();
        assert_eq!(std::fs::read(&request.scene).unwrap(), b"another level");
        assert!(baked.files.iter().all(|file| file.exists()) && baked.report.counters["texels"] > 0);
    }

    #[test]
    fn a_panic_on_a_worker_thread_is_caught_too() {
        let settings = Settings { threads: Threads(2), ..Settings::default() };
        let all = || -> Result<Vec<u32>, Error> {
            Ok((0..1000u32).into_par_iter().map(|i| if i == 637 { panic!("number {i}") } else { i }).collect())
        };
        assert!(matches!(with_threads(&settings, all), Err(Error::Internal { what }) if what == "number 637"));
    }
}
