//! A scene made ready for comparisons: any method may look for its light anywhere, and a bake may be tried with one
//! setting or another.
//!
//! The scene is as its file says; methods work with the true strengths of its lights, and share one tree of rays and one
//! cached solution. A [`Trial`] is the chain of a bake from texels to gathered light, with its two parts kept apart and
//! nothing written.

use std::cell::OnceCell;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Instant;

use cpu_time::ProcessTime;
use luxel_atlas::{Atlas, AtlasReport, InProcess};
use luxel_export::report::{Stage as Entry, Table1};
use luxel_scene::{Progress, Scene};
use luxel_transport::{
    Rgb,
    direct::Visibility,
    gather::{Field, FinalGather, Lightcuts, Lookup, PhotonMap, VoxelSamples, photon_map},
    geometry::Geometry,
    lights::Emitters,
    methods::{Cached, Method, PathTracing, RandomVoxels, Reconstruction, Straight},
    rays::Rays,
    reference::{Options, Reference},
    sky_light::{SkyLight, SkySettings},
    surfel::{Solution, Surfels},
};

use super::digest::Digest;
use super::groups::Lighting;
use super::journal::Journal;
use super::keys::Keys;
use super::light::Parts;
use super::receivers::Side;
use super::record::Record;
use super::table::table1;
use super::threads::with_threads;
use super::tracer::Tracer;
use super::transport::{Facts, Transport};
use super::{Baking, atlas, direct, input, parts, texels};
use crate::Error;
use crate::plan::{Plan, Stage};
use crate::settings::{Gatherer, Settings};
use crate::store::{Key, Store};

/// Reads a scene as its file says, with the sky that the settings name.
///
/// # Errors
/// As a bake.
pub fn load(path: &Path, settings: &Settings, progress: &dyn Progress) -> Result<Scene, Error> {
    progress.begin(Stage::Import.name(), 1);
    let scene = input::load(path, settings, progress)?;
    progress.advance(1);
    Ok(scene)
}

/// Digest of everything that the light of a scene at the texels of its atlas follows from, but for how it is computed.
pub fn identity(scene: &Scene, settings: &Settings) -> Key {
    let keys = Unit::of(scene, settings).keys;
    let digest = Digest::new("scene").bytes(&keys.layout);
    keys.parts.values().fold(digest, |digest, part| digest.text(part)).done()
}

/// Works on as many threads as the settings say.
///
/// # Errors
/// Those of the work, and where threads cannot be started; a panic is an internal error.
pub fn on_threads<T: Send>(settings: &Settings, work: impl FnOnce() -> Result<T, Error> + Send) -> Result<T, Error> {
    with_threads(settings, work)
}

/// A method with what it may spend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Technique {
    /// So many walks a receiver.
    PathTracing { paths: u32 },
    /// Photon mapping with so many photons, gathered by lightcuts.
    PhotonMap { photons: u32 },
    /// Random sample voxels of the cached solution: so many passes of two sets.
    SampleVoxels { passes: u32 },
    /// The voxels of the cached solution, shown directly.
    Voxels,
    /// The cached solution, gathered as the settings say.
    Cached(Gatherer),
}

impl Technique {
    /// It reads the cached solution.
    pub fn is_cached(&self) -> bool {
        !matches!(self, Self::PathTracing { .. } | Self::PhotonMap { .. })
    }
}

/// A way to read the cached solution.
#[derive(Clone, Copy)]
enum Reading {
    Voxels,
    Samples(u32),
    Gather(Gatherer),
}

/// The cached solution of all light groups together.
pub struct Cache {
    pub surfels: Rc<Surfels>,
    /// At the true strengths of the lights.
    pub solution: Solution,
    pub record: Option<Record>,
    /// Continuous rays that were traced for it.
    pub rays: u64,
    /// What they took.
    pub cost: Cost,
}

/// A method that is ready to be asked for light.
#[derive(Clone, Copy)]
pub struct Ready<'m> {
    pub method: &'m dyn Method,
    /// Continuous rays that made it ready: photons, and those of the cached solution.
    pub rays: u64,
}

/// What some work took. Nothing is decided by it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// By the wall clock.
    pub seconds: f64,
    /// Of all processors together.
    pub cpu_seconds: f64,
}

impl Cost {
    /// Does the work and says what it took.
    pub fn of<T>(work: impl FnOnce() -> T) -> (T, Self) {
        let (wall, cpu) = (Instant::now(), ProcessTime::now());
        let done = work();
        (done, Self { seconds: wall.elapsed().as_secs_f64(), cpu_seconds: cpu.elapsed().as_secs_f64() })
    }
}

impl std::ops::Add for Cost {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { seconds: self.seconds + other.seconds, cpu_seconds: self.cpu_seconds + other.cpu_seconds }
    }
}

/// A scene in the laboratory.
#[derive(Clone)]
pub struct Lab<'a> {
    pub rays: &'a Rays<'a>,
    pub settings: &'a Settings,
    /// What the tree of rays took.
    pub rays_cost: Cost,
    store: Option<&'a Store>,
    emitters: Rc<Emitters>,
    cache: Rc<OnceCell<Cache>>,
}

impl<'a> Lab<'a> {
    /// Opens the laboratory. With a store, light that bakes with these settings left there is used again.
    ///
    /// # Errors
    /// When the work is cancelled.
    pub fn with<T>(
        scene: &Scene,
        settings: &Settings,
        store: Option<&Store>,
        progress: &dyn Progress,
        work: impl FnOnce(&Lab) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let geometry = Geometry::new(scene);
        progress.begin(Stage::Rays.name(), 0);
        let (rays, rays_cost) = Cost::of(|| Rays::build(&geometry, progress));
        let rays = rays?;
        let emitters = Rc::new(Emitters::new(&geometry));
        work(&Lab { rays: &rays, settings, rays_cost, store, emitters, cache: Rc::default() })
    }

    /// The same scene and cached solution, gathered with other settings.
    pub fn tuned<'b>(&'b self, settings: &'b Settings) -> Lab<'b> {
        Lab { settings, ..self.clone() }
    }

    pub fn scene(&self) -> &'a Scene {
        self.rays.geometry.scene
    }

    /// The cached solution, made or read when it is first asked for.
    ///
    /// # Errors
    /// As a bake.
    pub fn cache(&self, progress: &dyn Progress) -> Result<&Cache, Error> {
        if let Some(cache) = self.cache.get() {
            return Ok(cache);
        }
        let (cache, cost) = Cost::of(|| solved(self.rays, self.settings, self.store, progress));
        let cache = Cache { cost, ..cache? };
        Ok(self.cache.get_or_init(|| cache))
    }

    /// The fronts of an atlas's texels, at their own points.
    pub fn receivers<'l>(&'l self, atlas: &'l Atlas) -> Side<'l> {
        Side::front(self.rays.geometry, atlas)
    }

    /// Digest of everything that the light of this scene at the texels of its atlas follows from, but for how it is
    /// computed.
    pub fn identity(&self) -> Key {
        identity(self.scene(), self.settings)
    }

    /// Makes a method ready and works with it. Receivers that lie side by side on surfaces share what stands between
    /// them and the lights; `visibility` says whether they do.
    ///
    /// # Errors
    /// As a bake.
    pub fn method<T>(
        &self,
        technique: Technique,
        visibility: Visibility,
        progress: &dyn Progress,
        work: impl FnOnce(Ready) -> Result<T, Error>,
    ) -> Result<T, Error> {
        match technique {
            Technique::PathTracing { paths } => {
                let reference = Reference::new(self.rays, Options::default());
                work(Ready { method: &PathTracing::new(&reference, paths), rays: 0 })
            }
            Technique::PhotonMap { photons } => {
                let reflected = PhotonMap::build(self.rays, &self.emitters, self.photon_map(photons), progress)?;
                self.straight(visibility, progress, |straight| {
                    let method = &Reconstruction { straight, reflected: &reflected };
                    work(Ready { method, rays: reflected.facts().rays })
                })
            }
            Technique::SampleVoxels { passes } => self.of_cache(Reading::Samples(passes), visibility, progress, work),
            Technique::Voxels => self.of_cache(Reading::Voxels, visibility, progress, work),
            Technique::Cached(gatherer) => self.of_cache(Reading::Gather(gatherer), visibility, progress, work),
        }
    }

    fn photon_map(&self, photons: u32) -> photon_map::Settings {
        photon_map::Settings {
            photons,
            threshold: self.settings.cut_error.0,
            limit: self.settings.cut_limit.0,
            near_rays: self.settings.near_rays.0,
            ..photon_map::Settings::default()
        }
    }

    /// A method that reads the cached solution.
    fn of_cache<T>(
        &self,
        reading: Reading,
        visibility: Visibility,
        progress: &dyn Progress,
        work: impl FnOnce(Ready) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let Cache { surfels, solution, rays, .. } = self.cache(progress)?;
        let field = Field::build(self.rays, surfels, solution, progress)?;
        let work = |method: &dyn Method| work(Ready { method, rays: *rays });
        self.straight(visibility, progress, |straight| match reading {
            Reading::Voxels => work(&Cached::new(&field)),
            Reading::Samples(passes) => {
                let samples = VoxelSamples::build(&field, passes, progress)?;
                work(&RandomVoxels { straight, samples: &samples })
            }
            // The cache itself holds the light of the sky.
            Reading::Gather(Gatherer::Lookup) => {
                let straight = Straight { sky: None, ..straight };
                work(&Reconstruction { straight, reflected: &Lookup::new(&field) })
            }
            Reading::Gather(Gatherer::Final) => {
                let reflected = FinalGather::new(&field, self.settings.gather_rays.0);
                work(&Reconstruction { straight, reflected: &reflected })
            }
            Reading::Gather(Gatherer::Lightcuts) => {
                let reflected = Lightcuts::build(&field, texels::lightcut_settings(self.settings), progress)?;
                work(&Reconstruction { straight, reflected: &reflected })
            }
        })
    }

    /// Light that nothing has reflected.
    fn straight<T>(
        &self,
        visibility: Visibility,
        progress: &dyn Progress,
        work: impl FnOnce(Straight) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let settings = SkySettings { rays: self.settings.sky_rays.0, ..SkySettings::default() };
        let sky = (!self.scene().sky.is_dark()).then(|| SkyLight::new(self.rays, settings));
        let sky = sky.as_ref();
        if self.emitters.is_empty() {
            return work(Straight { lights: None, sky });
        }
        direct::with(self.rays, &self.emitters, self.settings, visibility, progress, |lights| {
            work(Straight { lights: Some(lights), sky })
        })
    }
}

/// A scene as a bake sees it: its lights parted and at their units.
struct Unit {
    scene: Scene,
    lighting: Lighting,
    plan: Plan,
    keys: Keys,
}

impl Unit {
    fn of(scene: &Scene, settings: &Settings) -> Self {
        let mut scene = scene.clone();
        let lighting = Lighting::part(&mut scene, settings);
        let plan = Plan::new(&scene, settings);
        let keys = Keys::new(&scene, &lighting, settings, &plan);
        Self { scene, lighting, plan, keys }
    }

    fn baking<'b>(&'b self, settings: &'b Settings, store: Option<&'b Store>) -> Baking<'b> {
        let Self { lighting, plan, keys, .. } = self;
        Baking { settings, plan, lighting, keys, store, kept: None, only_stored: false, books: store.is_some() }
    }
}

/// The cached solution of the scene that `rays` are of: the sum over its light groups.
fn solved(rays: &Rays, settings: &Settings, store: Option<&Store>, progress: &dyn Progress) -> Result<Cache, Error> {
    let unit = Unit::of(rays.geometry.scene, settings);
    let geometry = Geometry::new(&unit.scene);
    // Lights at their units have no other shape.
    let tracer = Tracer::with(&geometry, Rays::with(&geometry, rays.tree().clone()));
    let plan = Plan::of_all_light(&unit.scene, settings);
    let baking = Baking { plan: &plan, ..unit.baking(settings, store) };
    let (mut transport, mut journal) = (Transport::default(), Journal::new(progress));
    let mut sum: Option<(Rc<Surfels>, Solution)> = None;
    for (number, group) in unit.lighting.groups.iter().enumerate() {
        let (surfels, mut solution, record) = transport.solution(&baking, &tracer, number, &mut journal)?;
        transport.facts.add(record, group.factor);
        solution.direct.iter_mut().chain(&mut solution.indirect).for_each(|e| *e *= group.factor);
        match &mut sum {
            None => sum = Some((surfels, solution)),
            Some((_, sum)) => {
                sum.direct.iter_mut().zip(&solution.direct).for_each(|(sum, e)| *sum += *e);
                sum.indirect.iter_mut().zip(&solution.indirect).for_each(|(sum, e)| *sum += *e);
            }
        }
    }
    let (surfels, solution) = match sum {
        Some(sum) => sum,
        None => {
            let surfels = transport.surfels(&baking, &tracer, &mut journal)?;
            let dark = vec![Rgb::ZERO; surfels.list.len()];
            (surfels, Solution { direct: dark.clone(), indirect: dark })
        }
    };
    let record = transport.facts.record;
    Ok(Cache { surfels, solution, record, rays: traced(&journal.close()), cost: Cost::default() })
}

/// A bake's light at texels, with its parts apart.
pub struct Trial {
    pub parts: Parts,
    pub facts: Facts,
    pub table1: Table1,
    /// The stages that ran, with their times.
    pub stages: Vec<Entry>,
    pub cost: Cost,
}

impl Trial {
    /// Wall-clock time of some stages [s].
    pub fn seconds(&self, stages: &[Stage]) -> f64 {
        let wanted = |entry: &&Entry| stages.iter().any(|stage| stage.name() == entry.name);
        self.stages.iter().filter(wanted).map(|entry| entry.seconds).sum()
    }
}

/// Continuous rays of all stages, of stored ones too.
pub(super) fn traced(stages: &[Entry]) -> u64 {
    stages.iter().filter_map(|stage| stage.counters.get("continuous_rays")).sum()
}

/// The place of a scene's texels. With a store, what bakes left there is used again.
///
/// # Errors
/// As a bake.
pub fn lay_out(
    scene: &Scene,
    settings: &Settings,
    store: Option<&Store>,
    progress: &dyn Progress,
) -> Result<(Arc<Atlas>, AtlasReport), Error> {
    let unit = Unit::of(scene, settings);
    atlas::run(&unit.baking(settings, store), &unit.scene, &InProcess, &mut Journal::new(progress))
}

/// Bakes the light of a scene at the texels of an atlas that [`lay_out`] made of it, in memory.
///
/// # Errors
/// As a bake.
pub fn attempt(
    scene: &Scene,
    settings: &Settings,
    atlas: &Arc<Atlas>,
    progress: &dyn Progress,
) -> Result<Trial, Error> {
    let unit = Unit::of(scene, settings);
    let geometry = Geometry::new(&unit.scene);
    let mut journal = Journal::new(progress);
    let tracer = Tracer::new(&geometry, None);
    let (found, cost) = Cost::of(|| parts(&unit.baking(settings, None), &tracer, atlas, &mut journal));
    let (parts, facts) = found?;
    let table1 = table1(scene.triangle_count(), &facts, &journal, cost.seconds);
    Ok(Trial { parts, facts, table1, stages: journal.close(), cost })
}
