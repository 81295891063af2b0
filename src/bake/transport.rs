//! The light at surfels: voxelized, shot, propagated, refreshed; or read back from the octree cache of the last bake.

use std::path::{Path, PathBuf};

use luxel_export::OutputSet;
use luxel_export::report::StageState;
use luxel_scene::{Progress, Scene, Silent, Sky, Watched};
use luxel_transport::{
    Rgb, directions,
    gather::{Field, refresh},
    geometry::Geometry,
    lights::Emitters,
    octree::{self, Octree},
    rays::Rays,
    shoot::{self, PhotonSettings},
    solve::{SolveSettings, is_closed, solve},
    surfel::{AreaRule, Resolution, Solution, Surfels, VoxelSettings},
    sweep,
};

use super::journal::Journal;
use super::record::Record;
use super::{direct, export, input};
use crate::Error;
use crate::plan::{Plan, Stage};
use crate::settings::{Area, Closed, DirectionSet, Rule, Settings, Voxels};
use crate::store::{self, Key, Miss};

/// Probe rays that decide whether a scene is closed.
const CLOSED_PROBES: u32 = 1 << 16;

/// Points of a surfel at which its direct light is computed, at most.
const POINTS: u32 = 5;

/// Photons that start from one point of a light.
const PHOTONS_PER_POINT: u32 = 256;

/// The settings that the light at surfels depends on.
const KEY_SETTINGS: [&str; 23] = [
    "sky",
    "sky_rotation",
    "sky_strength",
    "light_scale",
    "emissive_scale",
    "lamp_radius",
    "sun_angle",
    "metal_diffuse",
    "bake_animated",
    "voxels",
    "directions",
    "bounces",
    "tolerance",
    "refresh",
    "closed",
    "photons",
    "direction_set",
    "rule",
    "area",
    "shadow_samples",
    // Where emissive surfaces are too many, cuts gather their light at surfels too.
    "cut_error",
    "cut_limit",
    "near_rays",
];

/// The stages that a stored octree stands for.
const STORED: [Stage; 4] = [Stage::Surfels, Stage::Shoot, Stage::Propagate, Stage::Refresh];

/// The stages whose versions the light at surfels depends on: a later one may change without costing it.
const KEY_STAGES: [Stage; 7] =
    [Stage::Import, Stage::Rays, Stage::Surfels, Stage::Shoot, Stage::Propagate, Stage::Refresh, Stage::Cache];

/// Why they need not run where their octree is there.
const REUSED: &str = "the stored light was made from the same input and settings";

/// Everything that the gather reads.
pub struct Transport {
    pub emitters: Emitters,
    /// Surfels and the light at them, where light bounces.
    pub surfels: Option<(Surfels, Solution)>,
    pub facts: Facts,
}

/// What became of the light, for the report.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    pub surfels: u64,
    /// How the light at surfels came about, in this bake or in the one that stored it.
    pub record: Option<Record>,
    /// Why a stored cache was of no use, if one was there.
    pub miss: Option<String>,
}

/// The octree irradiance cache on disk.
#[derive(Clone, Debug)]
pub struct Store {
    path: PathBuf,
    key: Key,
}

impl Store {
    pub fn new(outputs: &OutputSet, scene: &Scene, settings: &Settings) -> Self {
        let path = outputs.folder().join(".luxel").join(format!("{}.octree", outputs.stem()));
        Self { path, key: input::key(scene, settings, &KEY_STAGES, |name| KEY_SETTINGS.contains(&name)) }
    }

    /// Sees that the light can be stored, before it is made.
    pub fn probe(&self) -> Result<(), Error> {
        let failed = |path: &Path, what: &str| {
            let source = std::io::Error::other(what.to_owned());
            Err(Error::Store { path: path.into(), source })
        };
        let folder = self.path.parent().unwrap_or(Path::new(""));
        if folder.exists() && !folder.is_dir() {
            return failed(folder, "a file lies where its folder would");
        }
        if self.path.is_dir() {
            return failed(&self.path, "a folder lies where its file would");
        }
        let writable = if folder.is_dir() { export::can_write(folder) } else { Ok(()) };
        writable.map_err(|source| Error::Store { path: folder.into(), source })
    }

    /// The stored light, if it is this bake's; else a warning, if that is cause for one.
    fn read(&self, triangles: usize, progress: &dyn Progress) -> Result<(Surfels, Solution, Record), Option<String>> {
        let foreign = |why: String| Some(format!("{}: the stored light is made anew: {why}", self.path.display()));
        let decoded = store::read(&self.path, store::OCTREE, &self.key, |body| {
            let record = Record::read(body)?;
            let length = body.left();
            let mut body = Watched::new(body, progress);
            let (surfels, solution) = octree::read(&mut body, length).map_err(|e| e.to_string())?;
            Ok((surfels, solution, record))
        });
        let stored = decoded.map_err(|miss| match miss {
            // An ordinary change of input or settings.
            Miss::Absent | Miss::OtherKey => None,
            miss => foreign(miss.to_string()),
        })?;
        // A stored tree says nothing about the scene it meets.
        if !stored.0.list.iter().all(|s| (s.triangle as usize) < triangles) {
            return Err(foreign("it belongs to another scene".into()));
        }
        Ok(stored)
    }

    fn write(&self, octree: &Octree, record: &Record, progress: &dyn Progress) -> Result<u64, Error> {
        let written = store::write(&self.path, store::OCTREE, &self.key, |out| {
            let mut out = Watched::new(out, progress);
            record.write(&mut out)?;
            octree.write(&mut out)
        });
        // What was cancelled is no fault of the disk.
        progress.check()?;
        written.map_err(|source| Error::Store { path: self.path.clone(), source })
    }
}

/// All transport stages are left out.
pub fn skip(plan: &Plan, journal: &mut Journal) {
    for stage in STORED {
        journal.left_out(plan, stage);
    }
    journal.left_out(plan, Stage::Cache);
}

/// Runs the stages that the plan wants, or reads what they left in `store`.
pub fn run(
    rays: &Rays,
    settings: &Settings,
    plan: &Plan,
    store: Option<&Store>,
    journal: &mut Journal,
) -> Result<Transport, Error> {
    let emitters = Emitters::new(rays.geometry);
    let mut facts = Facts::default();
    if !plan.runs(Stage::Surfels) {
        skip(plan, journal);
        return Ok(Transport { emitters, surfels: None, facts });
    }
    if let Some(store) = store {
        let stored = store.read(rays.geometry.triangles.len(), journal.progress);
        // What was cancelled says nothing of what is stored.
        journal.progress.check()?;
        match stored {
            Ok((surfels, solution, record)) => {
                reuse(&record, plan, journal);
                facts.surfels = surfels.list.len() as u64;
                facts.record = Some(record);
                return Ok(Transport { emitters, surfels: Some((surfels, solution)), facts });
            }
            Err(miss) => facts.miss = miss,
        }
    }
    let (surfels, solution, mut record) = made(rays, &emitters, settings, plan, journal)?;
    facts.surfels = surfels.list.len() as u64;
    record.counters = STORED.map(|stage| (stage.name().to_owned(), journal.counters(stage))).into_iter().collect();
    // The tree and its file.
    journal.run(plan, Stage::Cache, Some(2), |progress, counters| {
        let octree = Octree::new(&surfels, &solution);
        counters.insert("nodes".into(), octree.nodes().len() as u64);
        progress.advance(1);
        progress.check()?;
        if let Some(store) = store {
            counters.insert("bytes".into(), store.write(&octree, &record, progress)?);
        }
        progress.advance(1);
        Ok(())
    })?;
    facts.record = Some(record);
    Ok(Transport { emitters, surfels: Some((surfels, solution)), facts })
}

/// Marks the stages in a plan that stored light will stand for, by the very test that the bake applies.
pub fn foresee(plan: &mut Plan, store: &Store, scene: &Scene) {
    if plan.runs(Stage::Surfels) && store.read(Geometry::new(scene).triangles.len(), &Silent).is_ok() {
        for stage in STORED.into_iter().chain([Stage::Cache]) {
            plan.reuse(stage, REUSED);
        }
    }
}

/// Writes the stages down that stored light stands for, with what they counted when they ran.
fn reuse(record: &Record, plan: &Plan, journal: &mut Journal) {
    for stage in STORED.into_iter().chain([Stage::Cache]) {
        if plan.runs(stage) {
            let counters = record.counters.get(stage.name()).cloned().unwrap_or_default();
            journal.note(stage, StageState::Reused, REUSED, 0.0, counters);
        } else {
            journal.left_out(plan, stage);
        }
    }
}

/// Surfels and the light at them, from scratch.
fn made(
    rays: &Rays,
    emitters: &Emitters,
    settings: &Settings,
    plan: &Plan,
    journal: &mut Journal,
) -> Result<(Surfels, Solution, Record), Error> {
    let geometry = rays.geometry;
    let surfels = journal.always(Stage::Surfels, plan.reason(Stage::Surfels), None, |progress, counters| {
        let surfels = Surfels::new(geometry, &voxel_settings(settings), progress)?;
        counters.insert("surfels".into(), surfels.list.len() as u64);
        Ok(surfels)
    })?;
    let count = surfels.list.len() as u64;
    let points = if direct::is_crowded(geometry, emitters) { 1 } else { POINTS };
    // How many groups the photons make is known to the shooting alone.
    let work = if settings.photons.0 > 0 { 0 } else { count * u64::from(points) };
    let direct = journal.run(plan, Stage::Shoot, Some(work), |progress, counters| {
        let shot = if settings.photons.0 > 0 {
            let primary = settings.photons.0.div_ceil(PHOTONS_PER_POINT);
            let how = PhotonSettings { primary, directions: PHOTONS_PER_POINT };
            shoot::photons(rays, emitters, &surfels, how, progress)?
        } else {
            direct::with(rays, emitters, settings, progress, |direct| {
                Ok(shoot::exact(geometry, &surfels, direct, points, progress)?)
            })?
        };
        counters.insert("primary_photons".into(), shot.primary_photons);
        counters.insert("direct_photons".into(), shot.direct_photons);
        counters.insert("continuous_rays".into(), shot.rays);
        Ok(shot.irradiance)
    })?;
    let direct = direct.unwrap_or_else(|| vec![Rgb::ZERO; surfels.list.len()]);

    let sky = &geometry.scene.sky;
    let radiance = |direction| sky.radiance(direction);
    let (mut solution, record) =
        journal.always(Stage::Propagate, plan.reason(Stage::Propagate), None, |progress, counters| {
            let how = solve_settings(rays, &surfels, settings);
            let (solution, report) = solve(&surfels, &direct, &how, is_lit(sky).then_some(&radiance), progress)?;
            counters.insert("bounces".into(), report.bounces.len() as u64);
            counters.insert("stiff_steps".into(), u64::from(report.stiff_steps));
            counters.insert("discrete_rays".into(), report.discrete_rays);
            counters.insert("closed".into(), u64::from(how.closed));
            Ok((solution, Record::new(&report, geometry.frame.scale)))
        })?;
    let refreshed = journal.run(plan, Stage::Refresh, Some(count), |progress, counters| {
        let field = Field::build(rays, &surfels, &solution, progress)?;
        counters.insert("continuous_rays".into(), count * u64::from(settings.refresh.0));
        Ok(refresh(&field, settings.refresh.0, &radiance, progress)?)
    })?;
    if let Some(refreshed) = refreshed {
        solution = refreshed;
    }
    Ok((surfels, solution, record))
}

fn is_lit(sky: &Sky) -> bool {
    !sky.is_dark()
}

fn solve_settings(rays: &Rays, surfels: &Surfels, settings: &Settings) -> SolveSettings {
    let closed = match settings.closed {
        Closed::Yes => true,
        Closed::No => false,
        Closed::Auto => is_closed(rays, surfels, CLOSED_PROBES),
    };
    SolveSettings {
        directions: settings.directions.0,
        max_bounces: settings.bounces.0,
        tolerance: f64::from(settings.tolerance.0),
        closed,
        set: match settings.direction_set {
            DirectionSet::Fibonacci => directions::DirectionSet::Fibonacci,
            DirectionSet::Integer => directions::DirectionSet::Integer,
        },
        rule: match settings.rule {
            Rule::Surface => sweep::Rule::Surface,
            Rule::Literal => sweep::Rule::Literal,
        },
        ..SolveSettings::default()
    }
}

fn voxel_settings(settings: &Settings) -> VoxelSettings {
    let resolution = match settings.voxels {
        Voxels::Budget(n) => Resolution::Budget(n),
        Voxels::Side(n) => Resolution::Side(n),
        Voxels::Edge(e) => Resolution::Edge(f64::from(e)),
    };
    let area = match settings.area {
        Area::Clipped => AreaRule::Clipped,
        Area::Faces => AreaRule::FaceCount,
    };
    VoxelSettings { resolution, area }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::value::Samples;
    use crate::settings::{Field as Setting, Preset};
    use glam::Vec3;
    use luxel_scene::build::Builder;

    /// What a stored octree is believed to be must not change under an unchanged key.
    #[test]
    fn the_light_at_surfels_is_that_of_its_stages_versions() {
        let mut b = Builder::new("room");
        let (wall, lamp) = (b.matte(Vec3::new(0.7, 0.5, 0.3)), b.emitter(Vec3::splat(0.5), Vec3::splat(10.0)));
        b.cuboid("shell", Vec3::ZERO, Vec3::new(1.0, 0.8, 1.2), wall, true);
        b.quad("lamp", Vec3::new(0.4, 0.7, 0.4), Vec3::X * 0.2, Vec3::Z * 0.2, lamp);
        let scene = b.build();
        let settings =
            Settings { voxels: Voxels::Side(8), directions: Samples(64), ..Settings::preset(Preset::Medium) };
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let plan = Plan::new(&scene, &settings);
        let light = run(&rays, &settings, &plan, None, &mut Journal::new(&Silent)).unwrap();
        let (surfels, solution) = light.surfels.unwrap();
        let mut hasher = blake3::Hasher::new();
        Octree::new(&surfels, &solution).write(&mut hasher).unwrap();
        let hash = hasher.finalize().to_hex();
        let versions = STORED.map(|stage| format!("{} {}", stage.name(), stage.version())).join(", ");
        let known = (
            "surfels 2, shoot 2, propagate 3, refresh 1",
            "49598e72558a7fb756670905b12e456bdb0ce2d184e572fa151a3b3acac6b844",
        );
        assert_eq!(
            (versions.as_str(), hash.as_str()),
            known,
            "the light at surfels has changed: raise the version of the stage that changed it in Stage::version, \
             then write versions and hash here"
        );
    }

    #[test]
    fn stored_light_depends_on_no_stage_that_comes_after_it() {
        assert!(STORED.iter().all(|stage| KEY_STAGES.contains(stage)));
        assert!(KEY_STAGES.iter().all(|stage| *stage <= Stage::Cache && *stage != Stage::Unwrap), "{KEY_STAGES:?}");
        let (scene, settings) = (Builder::new("empty").build(), Settings::default());
        let of = |stages: &[Stage]| input::key(&scene, &settings, stages, |_| true);
        assert_ne!(of(&KEY_STAGES), of(&Stage::ALL));
        let outputs = OutputSet::new("empty.glb".as_ref(), None, None).unwrap();
        let stored = input::key(&scene, &settings, &KEY_STAGES, |name| KEY_SETTINGS.contains(&name));
        assert_eq!(Store::new(&outputs, &scene, &settings).key, stored);
    }

    #[test]
    fn the_key_names_settings_that_exist() {
        for name in KEY_SETTINGS {
            assert!(Setting::find(name).is_some(), "{name}");
        }
    }
}
