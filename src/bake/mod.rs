//! The bake of one scene: the whole chain, stage by stage, from a file to files.

pub(crate) mod artefact;
mod atlas;
mod baking;
mod cause;
mod covers;
pub(crate) mod digest;
mod direct;
mod draft;
pub(crate) mod energy;
mod export;
mod finish;
mod foresee;
mod groups;
mod input;
pub mod journal;
mod kept;
mod keys;
pub mod lab;
mod light;
pub(crate) mod memory;
pub mod mix;
pub(crate) mod needs;
mod outgoing;
pub(crate) mod receivers;
mod record;
mod report;
mod shown;
mod table;
mod texels;
mod threads;
mod tracer;
mod transport;
mod turns;
mod upstream;
mod verify;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use luxel_atlas::{Atlas, AtlasReport, InProcess, Worker};
use luxel_export::{BoundMap, Effort, Lightmap, OutputSet, Report, report::Warning};
use luxel_scene::{InputFile, Progress, Scene};
use luxel_transport::geometry::Geometry;

use crate::Error;
use crate::plan::{Plan, Stage};
use crate::settings::{DoubleSided, Only, Resolved, Settings};
use crate::store::StoreOptions;
use crate::verify::{Verified, Verify};
use baking::{Baking, Tidy, light_of, not_stored};
pub(crate) use direct::with as direct_light;
use finish::Seams;
use groups::Lighting;
use journal::Journal;
pub use kept::Kept;
use keys::Keys;
pub use light::{Parts, TexelLight};
use mix::Mix;
use outgoing::Outgoing;
use receivers::Receivers;
pub(crate) use report::{json_form, versions};
pub use shown::lightmaps;
use threads::on_threads;
pub(crate) use threads::{guarded, with_threads};
use tracer::Tracer;
use transport::Transport;
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
    /// Where artefacts of its stages are kept for later bakes.
    pub store: StoreOptions,
    /// What is kept in memory for later bakes by whoever bakes again and again: a clone of one and the same.
    pub kept: Kept,
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
    pub atlas: Arc<Atlas>,
    pub atlas_report: AtlasReport,
    /// By texel of the atlas, before dilation and stitching; empty where images are all that is kept.
    pub texels: TexelLight,
    /// By page of the atlas.
    pub lightmaps: Vec<Lightmap>,
    /// By page, where the settings ask for it.
    pub bounds: Vec<BoundMap>,
    pub(crate) sums: light::Sums,
    pub(crate) transport: transport::Facts,
    /// Its error, where that was asked for.
    pub(crate) verified: Option<Verified>,
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
    begin(request, Order::default(), gate, progress)
}

/// [`bake_in_turn`] that compares its lightmap with the reference before it replaces anything, and puts what it finds into
/// the report. The lightmap has the bytes of a bake that does not.
///
/// # Errors
/// As a bake; [`Error::NotGoodEnough`] where there is a limit and the lightmap does not keep it.
pub fn bake_verified(
    request: &Request,
    verify: &Verify,
    gate: &dyn Gate,
    progress: &dyn Progress,
) -> Result<Baked, Error> {
    begin(request, Order { verify: Some(*verify), ..Order::default() }, gate, progress)
}

/// [`bake`] with a draft first where light has to be gathered at texels: the same files from the same unwrap, lit
/// coarsely within a moment, and replaced when the bake ends. `drafted` is told when they are in place; what then fails
/// or is cancelled leaves them there, and their report says what they are. The bake's own files are those of [`bake`].
pub fn bake_drafted(
    request: &Request,
    progress: &dyn Progress,
    drafted: &mut (dyn FnMut(Baked) + Send),
) -> Result<Baked, Error> {
    let order = Order { drafted: Some(drafted), ..Order::default() };
    begin(request, order, &Alone(request.settings.settings.threads.0), progress)
}

/// Writes the outputs of a bake with other weights of its light groups, from their stored light alone.
///
/// # Errors
/// As a bake; a group that the scene does not have, or that would become too bright; anything that is not stored, which
/// is seen before anything is computed or written; a bake that lies where the outputs go.
pub fn export(request: &Request, mix: &Mix, progress: &dyn Progress) -> Result<Baked, Error> {
    export::spare_bake(&request.outputs)?;
    let order = Order { mix: Some(mix), ..Order::default() };
    begin(request, order, &Alone(request.settings.settings.threads.0), progress)
}

/// What is wanted besides a plain bake.
#[derive(Default)]
struct Order<'a> {
    /// Other weights of the light groups, from stored light alone.
    mix: Option<&'a Mix>,
    /// A draft first, and who is told of it.
    drafted: Option<&'a mut (dyn FnMut(Baked) + Send)>,
    /// The lightmap's error, before files are replaced.
    verify: Option<Verify>,
}

fn begin(request: &Request, order: Order, gate: &dyn Gate, progress: &dyn Progress) -> Result<Baked, Error> {
    let start = Instant::now();
    let settings = &request.settings.settings;
    let mut journal = Journal::new(progress);
    let mut opened = on_threads(gate.opening(), || {
        journal.always(Stage::Import, "", Some(input::STEPS), |progress, counters| {
            let opened = input::open(&request.scene, settings, progress)?;
            counters.insert("triangles".into(), opened.scene.triangle_count() as u64);
            counters.insert("files".into(), opened.scene.inputs.len() as u64);
            Ok(opened)
        })
    })?;
    journal.explain(Stage::Import, opened.plan.reason(Stage::Import));
    let leave = gate.enter(&opened.plan.least_memory(settings), progress)?;
    opened.plan.warnings.extend(leave.warning);
    on_threads(leave.threads, move || run(request, opened, order, journal, start))
}

/// Everything after the import.
fn run(
    request: &Request,
    opened: input::Opened,
    Order { mix, drafted, verify }: Order,
    mut journal: Journal,
    start: Instant,
) -> Result<Baked, Error> {
    let progress = journal.progress;
    let settings = &request.settings.settings;
    let input::Opened { scene, mut lighting, original, plan } = opened;
    let weights = mix.map_or(Ok(BTreeMap::new()), |mix| mix.weigh(&mut lighting))?;
    progress.check()?;
    let inputs = input::Inputs::new(&request.scene, &scene, &original);
    progress.check()?;
    let key = input::key(&scene, settings);
    let keys = Keys::new(&scene, &lighting, settings, &plan);
    journal.cause = cause::of(&request.outputs, &keys, &request.settings);
    progress.check()?;
    let store = request.store.open(request.outputs.folder());
    if mix.is_some() {
        let missing = foresee::missing(&plan, &store, &scene, &lighting, &keys, progress)?;
        missing.map_or(Ok(()), |what| Err(not_stored(&store, what)))?;
    }
    let geometry = Geometry::new(&scene);
    progress.check()?;
    export::probe(&request.outputs)?;
    store.keep_cap_or_note();
    let _tidied = Tidy { store: &store, folder: request.outputs.folder() };
    let baking = Baking {
        settings,
        plan: &plan,
        lighting: &lighting,
        keys: &keys,
        store: Some(&store),
        kept: Some(&request.kept),
        only_stored: mix.is_some(),
        books: true,
    };
    let tracer = Tracer::new(&geometry, Some((&request.kept, keys.shape())));
    let (atlas, atlas_report) = match &request.worker {
        Some(path) => atlas::run(&baking, &scene, &worker(path), &mut journal)?,
        None => atlas::run(&baking, &scene, &InProcess, &mut journal)?,
    };
    let outgoing = Outgoing { request, tracer: &tracer, original: &original, inputs: &inputs, key, weights, start };
    let mut besides = 0.0;
    if let Some(drafted) = drafted.filter(|_| foresee::gathers(&plan, &store, &lighting, &keys)) {
        let begun = start.elapsed();
        drafted(draft::bake(&outgoing, &baking, (atlas.clone(), atlas_report.clone()), &mut journal)?);
        besides = (start.elapsed() - begun).as_secs_f64();
    }
    let mut lit = light(&baking, &tracer, (atlas, atlas_report), Keep::Images, &mut journal)?;
    let mut verifying = 0.0;
    if let Some(ask) = verify {
        let begun = start.elapsed();
        lit.verified = Some(verify::judge(&baking, &tracer, &lit, &ask, &mut journal)?);
        verifying = (start.elapsed() - begun).as_secs_f64();
    }
    let picture = export::preview(&baking, &tracer, &lit, &mut journal)?;
    let figures = (store.take_notes(), start.elapsed().as_secs_f64() - besides - verifying);
    let mut baked = outgoing.write(&baking, &lit, picture.as_deref(), Effort::Small, figures, journal)?;
    baked.seconds -= besides;
    Ok(baked)
}

/// Whether the result depends on the setting of this name: the number of threads changes no byte.
pub(crate) fn matters(setting: &str) -> bool {
    setting != "threads"
}

/// Bakes a scene in memory: atlas, light at texels, finished images; no file is read or written.
pub fn bake_scene(scene: &Scene, settings: &Settings, progress: &dyn Progress) -> Result<Lit, Error> {
    with_threads(settings, || {
        let mut scene = scene.clone();
        let lighting = Lighting::part(&mut scene, settings);
        let plan = Plan::new(&scene, settings);
        let keys = Keys::new(&scene, &lighting, settings, &plan);
        let geometry = Geometry::new(&scene);
        let baking = Baking {
            settings,
            plan: &plan,
            lighting: &lighting,
            keys: &keys,
            store: None,
            kept: None,
            only_stored: false,
            books: true,
        };
        let mut journal = Journal::new(progress);
        let laid_out = atlas::run(&baking, &scene, &InProcess, &mut journal)?;
        light(&baking, &Tracer::new(&geometry, None), laid_out, Keep::Texels, &mut journal)
    })
}

/// What a bake of the file would do.
///
/// With the place of its outputs, it looks into the store there, or into the one that is named, and marks the stages
/// that would be reused.
pub fn plan_file(
    path: &Path,
    outputs: Option<(&OutputSet, &StoreOptions)>,
    settings: &Resolved,
    progress: &dyn Progress,
) -> Result<Plan, Error> {
    guarded(|| {
        progress.begin(Stage::Import.name(), input::STEPS);
        let resolved = settings;
        let settings = &settings.settings;
        let input::Opened { scene, lighting, mut plan, .. } = input::open(path, settings, progress)?;
        match memory::check(&plan.least_memory(settings)) {
            Ok(warning) => plan.warnings.extend(warning),
            // A plan is what one asks for in order to find out.
            Err(refusal) => plan.warnings.push(Warning { code: "memory".into(), message: refusal.to_string() }),
        }
        if let Some((outputs, store)) = outputs {
            let keys = Keys::new(&scene, &lighting, settings, &plan);
            let why = cause::of(outputs, &keys, resolved);
            foresee::mark(&mut plan, &store.open(outputs.folder()), &scene, &lighting, &keys, &why);
        }
        Ok(plan)
    })
}

/// The middle of the chain: from the atlas to finished images.
fn light(
    baking: &Baking,
    tracer: &Tracer,
    (atlas, atlas_report): (Arc<Atlas>, AtlasReport),
    keep: Keep,
    journal: &mut Journal,
) -> Result<Lit, Error> {
    let scene = tracer.geometry.scene;
    if let Some(finished) = finish::stored(baking, &atlas, journal) {
        return Ok(finished.lit(atlas, atlas_report));
    }
    let (mut texels, sums, facts) = texel_light(baking, tracer, &atlas, journal)?;
    let (lightmaps, bounds) = {
        let light = match keep {
            Keep::Texels => Cow::Borrowed(&texels),
            Keep::Images => Cow::Owned(std::mem::take(&mut texels)),
        };
        finish::run(baking, scene, &atlas, light, (&sums, &facts), Seams::Stitched, journal)?
    };
    Ok(Lit { atlas, atlas_report, texels, lightmaps, bounds, sums, transport: facts, verified: None })
}

/// The light of all groups at texels, summed in their order.
fn texel_light(
    baking: &Baking,
    tracer: &Tracer,
    atlas: &Atlas,
    journal: &mut Journal,
) -> Result<(TexelLight, light::Sums, transport::Facts), Error> {
    let (parts, facts) = parts(baking, tracer, atlas, journal)?;
    let (light, sums) = parts.merged(atlas);
    Ok((light, sums, facts))
}

/// The same with direct and indirect light apart.
fn parts(
    baking: &Baking,
    tracer: &Tracer,
    atlas: &Atlas,
    journal: &mut Journal,
) -> Result<(Parts, transport::Facts), Error> {
    let Baking { settings, plan, lighting, .. } = baking;
    let mut transport = Transport::default();
    let mut sum: Option<Parts> = None;
    let mut displaced = Vec::new();
    if plan.runs(Stage::Clear) && !lighting.groups.is_empty() {
        let key = &baking.keys.clear;
        let store = baking.store.map(|store| (store, key));
        let receivers = match store.filter(|_| baking.only_stored) {
            Some((store, key)) => Receivers::stored(tracer, atlas, settings, plan, (store, key), journal)
                .ok_or_else(|| not_stored(store, foresee::CLEARED.into()))?,
            None => Receivers::new(tracer, atlas, settings, plan, store, journal)?,
        };
        for (number, group) in lighting.groups.iter().enumerate() {
            journal.group = (lighting.groups.len() > 1).then(|| group.name.clone());
            let parts =
                texels::group(baking, tracer, &receivers, &mut transport, number, journal)?.scaled(group.factor);
            match &mut sum {
                Some(sum) => sum.add(&parts),
                None => sum = Some(parts),
            }
            // A scene's own strengths are bounded by the import, those of a mix by nothing.
            if baking.only_stored && !sum.as_ref().is_some_and(Parts::is_finite) {
                return Err(Error::TooBright { name: group.name.clone() });
            }
        }
        journal.group = None;
        displaced.extend(receivers.sides[0].displaced().map(|(i, _)| i));
    }
    for stage in Stage::ALL.into_iter().filter(|stage| (Stage::Rays..=Stage::Gather).contains(stage)) {
        journal.left_out_unless_run(plan, stage);
    }
    let parts = sum.unwrap_or_else(|| Parts::dark(atlas.texels.len(), plan.states_bound(settings)));
    // Where a texel holds the light of two sides, or a part of it, surfels have nothing to compare it with.
    if baking.books && settings.double_sided == DoubleSided::Front && settings.only == Only::All {
        transport.facts.gathered(energy::through_texels(tracer.geometry.scene, atlas, &parts, &displaced));
    }
    Ok((parts, transport.facts))
}

/// The tool's own binary as a child that unwraps.
fn worker(path: &Path) -> Worker {
    Worker::new(path, ["unwrap-worker"])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Preset, Voxels, value::Texels};
    use luxel_scene::Silent;

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
        Request { scene, outputs, settings, worker: None, store: StoreOptions::default(), kept: Default::default() }
    }

    #[test]
    fn a_panic_is_the_error_of_its_scene_and_leaves_the_last_bake_alone() {
        let folder = tempfile::tempdir().unwrap();
        let request = request(folder.path());
        bake(&request, &Silent).unwrap();
        let report = || std::fs::read(request.outputs.report()).unwrap();
        let before = report();
        for stage in ["import", "texels", "direct", "export"] {
            // What is stored is not made.
            drop(std::fs::remove_dir_all(request.outputs.folder().join(".luxel")));
            let error = bake(&request, &Broken(stage)).unwrap_err();
            assert!(matches!(&error, Error::Internal { what } if what.contains(stage)), "{stage}: {error}");
            assert!(error.to_string().contains("a bug in luxel"));
        }
        assert_eq!(report(), before);
        let planned = plan_file(&request.scene, None, &Resolved::default(), &Broken("import"));
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
}
