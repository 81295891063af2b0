//! The light of one group at surfels: voxelized, shot, propagated, refreshed; or read back, from any of these on.

use std::rc::Rc;

use luxel_transport::{
    Rgb,
    direct::Visibility,
    directions,
    energy::{sent, shot, sky as sky_flux},
    gather::{Field, Gather, refresh},
    geometry::Geometry,
    lights::Emitters,
    octree::{self, Octree},
    rays::Rays,
    shoot::{self, PhotonSettings},
    solve::{SolveSettings, is_closed, refine, solve},
    surfel::{AreaRule, Resolution, Solution, Surfels, VoxelSettings},
    sweep,
};

use super::Baking;
use super::artefact::{self, head, put_slice, put_value};
use super::direct;
use super::energy::{self, Books, absorbed, reflected};
use super::journal::{Counters, Journal, WRITTEN};
use super::record::Record;
use super::tracer::Tracer;
use crate::Error;
use crate::plan::{Plan, Stage};
use crate::settings::{Area, Closed, DirectionSet, Rule, Settings, Voxels};
use crate::store::{Kind, Reader};

/// Probe rays that decide whether a scene is closed.
const CLOSED_PROBES: u32 = 1 << 16;

/// Points of a surfel at which its direct light is computed, at most.
const POINTS: u32 = 5;

/// Photons that start from one point of a light.
const PHOTONS_PER_POINT: u32 = 256;

/// The stages that a stored octree stands for.
const STORED: [Stage; 4] = [Stage::Surfels, Stage::Shoot, Stage::Propagate, Stage::Refresh];

/// What became of the light, for the report: of all groups together, at the strength of their lights.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    pub surfels: u64,
    /// How the light at surfels came about, in this bake or in those that stored it.
    pub record: Option<Record>,
}

impl Facts {
    /// Adds the record of one group, whose lights are so strong.
    pub fn add(&mut self, record: Record, factor: Rgb) {
        let surfels = record.counters.get(Stage::Surfels.name()).and_then(|counters| counters.get("surfels"));
        self.surfels = self.surfels.max(surfels.copied().unwrap_or_default());
        let record = record.scaled(factor);
        self.record = Some(match self.record.take() {
            None => record,
            Some(sum) => sum.joined(record),
        });
    }
}

impl Facts {
    /// Books the flux through texels [lm] as the last stage of the ledger.
    pub fn gathered(&mut self, through: [f64; 3]) {
        if let Some(record) = &mut self.record {
            energy::gathered(&mut record.energy.stages, &record.flows, through);
        }
    }
}

impl std::ops::AddAssign for Facts {
    fn add_assign(&mut self, other: Self) {
        self.surfels = self.surfels.max(other.surfels);
        self.record = match (self.record.take(), other.record) {
            (Some(own), Some(other)) => Some(own.joined(other)),
            (own, other) => own.or(other),
        };
    }
}

/// What the groups of a scene share on the way to their light at surfels.
#[derive(Default)]
pub struct Transport {
    emitters: Option<Emitters>,
    surfels: Option<Rc<Surfels>>,
    closed: Option<bool>,
    /// The direct light of a surfel is that of one point of it: for drafts, whose light nobody stores.
    is_coarse: bool,
    pub facts: Facts,
}

/// What an artefact of light at surfels holds.
type Stored = (Record, Surfels, Solution);

impl Transport {
    /// All lights of the scene, at their units.
    pub fn emitters(&mut self, geometry: &Geometry) -> &Emitters {
        self.emitters.get_or_insert_with(|| Emitters::new(geometry))
    }

    /// The stages of this room are left out.
    pub fn skip(&self, plan: &Plan, journal: &mut Journal) {
        for stage in STORED.into_iter().chain([Stage::Cache]) {
            journal.left_out_unless_run(plan, stage);
        }
    }

    /// Writes the stages down that stored light stands for, with what they counted when they ran.
    pub fn recall(&self, record: &Record, plan: &Plan, journal: &mut Journal) {
        for stage in STORED.into_iter().chain([Stage::Cache]) {
            match record.counters.get(stage.name()) {
                Some(counters) => journal.reused(plan, stage, counters.clone()),
                None => journal.left_out_unless_run(plan, stage),
            }
        }
    }

    /// The surfels and the light of a group at them, stored or made.
    pub fn solution(
        &mut self,
        baking: &Baking,
        tracer: &Tracer,
        number: usize,
        journal: &mut Journal,
    ) -> Result<(Rc<Surfels>, Solution, Record), Error> {
        let Baking { plan, .. } = baking;
        let key = &baking.keys.groups[number].solution;
        let triangles = tracer.geometry.triangles.len();
        let read = |body: &mut Reader| -> Result<Stored, String> {
            let record = head(body)?;
            let (surfels, solution) = octree_of(body, triangles)?;
            Ok((record, surfels, solution))
        };
        if let Some((record, surfels, solution)) = baking.store.and_then(|store| store.get(Kind::Solution, key, read)) {
            baking.found(Kind::Solution, number);
            self.recall(&record, plan, journal);
            let surfels = self.surfels.get_or_insert_with(|| Rc::new(surfels)).clone();
            return Ok((surfels, solution, record));
        }
        let (surfels, solution, mut record) = self.made(baking, tracer, number, journal)?;
        // The tree and its file.
        journal.run(plan, Stage::Cache, Some(2), |progress, counters| {
            let octree = Octree::new(&surfels, &solution);
            counters.insert("nodes".into(), octree.nodes().len() as u64);
            record.counters.insert(Stage::Cache.name().into(), counters.clone());
            progress.advance(1);
            progress.check()?;
            let written = baking.put(Kind::Solution, key, progress, |out| {
                put_value(out, &record)?;
                octree.write(out)
            })?;
            counters.extend(written.map(|bytes| (WRITTEN.into(), bytes)));
            progress.advance(1);
            Ok(())
        })?;
        Ok((surfels, solution, record))
    }

    /// The same for a draft, of which the surfels alone are stored: the next change is a lamp's, most likely.
    pub fn draft(
        &mut self,
        baking: &Baking,
        tracer: &Tracer,
        number: usize,
        journal: &mut Journal,
    ) -> Result<(Rc<Surfels>, Solution, Record), Error> {
        self.is_coarse = true;
        self.voxelize(baking, tracer, journal)?;
        // Nor is a draft judged by its books.
        let kept = Baking { store: None, books: false, ..*baking };
        self.made(&kept, tracer, number, journal)
    }

    /// The same, from the surfels on.
    fn made(
        &mut self,
        baking: &Baking,
        tracer: &Tracer,
        number: usize,
        journal: &mut Journal,
    ) -> Result<(Rc<Surfels>, Solution, Record), Error> {
        let Baking { settings, plan, lighting, .. } = baking;
        let rays = tracer.rays(plan, journal)?;
        let (surfels, counters) = self.voxelize(baking, tracer, journal)?;
        let mut counted = vec![(Stage::Surfels, counters)];
        let count = surfels.list.len() as u64;
        let direct = match self.shoot(baking, rays, &surfels, number, journal)? {
            Some((direct, counters)) => {
                counted.push((Stage::Shoot, counters));
                direct
            }
            None => vec![Rgb::ZERO; surfels.list.len()],
        };

        let sky = &rays.geometry.scene.sky;
        let group = &lighting.groups[number];
        let weight = group.sky;
        let has_lights = baking.books && plan.runs(Stage::Shoot) && !group.sources.is_empty();
        let emitters = if has_lights { Some(group.emitters(self.emitters(rays.geometry))) } else { None };
        let radiance = |direction| weight.map_or(Rgb::ZERO, |weight| weight * sky.radiance(direction));
        let closed = &mut self.closed;
        let area = 1.0 / (rays.geometry.frame.scale * rays.geometry.frame.scale);
        let (mut solution, mut record, sweeps, solved) =
            journal.always(Stage::Propagate, plan.reason(Stage::Propagate), None, |progress, counters| {
                let closed = *closed.get_or_insert_with(|| is_known_closed(rays, &surfels, settings));
                let how = SolveSettings { closed, ..solve_settings(settings) };
                let (solution, report) =
                    solve(&surfels, &direct, &how, weight.is_some().then_some(&radiance), progress)?;
                counters.insert("bounces".into(), report.bounces.len() as u64);
                counters.insert("stiff_steps".into(), u64::from(report.stiff_steps));
                counters.insert("discrete_rays".into(), report.discrete_rays);
                counters.insert("closed".into(), u64::from(how.closed));
                let sweeps = report.ledger.scaled(area).stages;
                let solved = (report.bounces.len(), report.stiff_steps > 0);
                Ok((solution, Record::new(&report, rays.geometry.frame.scale), sweeps, solved))
            })?;
        let mut books = None;
        if baking.books {
            // The rays of the books are no part of the method and of its times.
            let progress = journal.progress;
            let shot = emitters.as_ref().map(|emitters| shot(rays, emitters, &surfels, &direct, progress));
            let sky = weight.map(|_| sky_flux(rays, &surfels, &radiance, progress));
            let radiosity = |i: usize| surfels.list[i].albedo() * solution.total(i);
            let is_last = !plan.runs(Stage::Refresh);
            let gone = is_last.then(|| sent(rays, &surfels, &radiosity, progress)).transpose()?;
            let own = books.insert(Books::open(shot.transpose()?));
            own.propagate(&sweeps, solved, sky.transpose()?, gone.as_ref());
        }
        counted.push((Stage::Propagate, journal.last(Stage::Propagate)));
        drop(direct);
        let is_single = settings.bounces.0 == 1;
        let refreshed = journal.run(plan, Stage::Refresh, Some(count), |progress, counters| {
            let kept = absorbed(&surfels, &solution.indirect) * area;
            // One bounce is gathered from direct light alone, and nothing is added to it.
            if is_single {
                solution.indirect.fill(Rgb::ZERO);
            }
            let mut refreshed = {
                let field = Field::build(rays, &surfels, &solution, progress)?;
                refresh(&field, settings.refresh.0, &radiance, progress)?
            };
            let closed = *closed.get_or_insert_with(|| is_known_closed(rays, &surfels, settings));
            let how = SolveSettings { closed, ..solve_settings(settings) };
            // What was refreshed has its own copy of the direct light.
            let before = std::mem::take(&mut solution).indirect;
            let discrete =
                if is_single { 0 } else { refine(&surfels, before, &mut refreshed.indirect, &how, progress)? };
            counters.insert("continuous_rays".into(), count * u64::from(settings.refresh.0));
            counters.insert("discrete_rays".into(), discrete);
            Ok((refreshed, kept))
        })?;
        if let Some((refreshed, before)) = refreshed {
            if let Some(books) = &mut books {
                let all = |i: usize| if is_single { refreshed.direct[i] } else { refreshed.total(i) };
                let radiosity = |i: usize| surfels.list[i].albedo() * all(i);
                let gone = sent(rays, &surfels, &radiosity, journal.progress)?;
                let after = absorbed(&surfels, &refreshed.indirect) * area;
                let unsent = reflected(&surfels, |i| refreshed.total(i) - all(i)) * area;
                books.refresh((before, after), unsent, &gone);
            }
            solution = refreshed;
            counted.push((Stage::Refresh, journal.last(Stage::Refresh)));
        }
        if let Some(books) = books {
            (record.energy.stages, record.flows) = (books.stages, books.flows);
        }
        record.counters = counted.into_iter().map(|(stage, counters)| (stage.name().to_owned(), counters)).collect();
        Ok((surfels, solution, record))
    }

    /// The surfels of a scene that nothing lights.
    pub fn surfels(&mut self, baking: &Baking, tracer: &Tracer, journal: &mut Journal) -> Result<Rc<Surfels>, Error> {
        Ok(self.voxelize(baking, tracer, journal)?.0)
    }

    /// Makes or reads the surfels, unless they are there; returns what was counted over it.
    fn voxelize(
        &mut self,
        baking: &Baking,
        tracer: &Tracer,
        journal: &mut Journal,
    ) -> Result<(Rc<Surfels>, Counters), Error> {
        let Baking { settings, plan, keys, .. } = baking;
        let geometry = tracer.geometry;
        if let Some(surfels) = &self.surfels {
            let counters = Counters::from([("surfels".to_owned(), surfels.list.len() as u64)]);
            return Ok((surfels.clone(), counters));
        }
        let read = |body: &mut Reader| Ok((head::<Counters>(body)?, octree_of(body, geometry.triangles.len())?.0));
        if let Some((counters, surfels)) = baking.store.and_then(|store| store.get(Kind::Surfels, &keys.surfels, read))
        {
            journal.reused(plan, Stage::Surfels, counters.clone());
            return Ok((self.surfels.insert(Rc::new(surfels)).clone(), counters));
        }
        let surfels = journal.always(Stage::Surfels, plan.reason(Stage::Surfels), None, |progress, counters| {
            let mut surfels = Surfels::new(geometry, &voxel_settings(settings), progress)?;
            // The light of emissive surfaces is shot: what surfels emit is asked by nobody.
            surfels.emission = Vec::new();
            counters.insert("surfels".into(), surfels.list.len() as u64);
            if baking.store.is_some() {
                let dark = vec![Rgb::ZERO; surfels.list.len()];
                let dark = Solution { direct: dark.clone(), indirect: dark };
                baking.put(Kind::Surfels, &keys.surfels, progress, |out| {
                    put_value(out, counters)?;
                    Octree::new(&surfels, &dark).write(out)
                })?;
            }
            Ok(surfels)
        })?;
        Ok((self.surfels.insert(Rc::new(surfels)).clone(), journal.last(Stage::Surfels)))
    }

    /// Direct irradiance at surfels; None where the group has no lights but the sky.
    fn shoot(
        &mut self,
        baking: &Baking,
        rays: &Rays,
        surfels: &Surfels,
        number: usize,
        journal: &mut Journal,
    ) -> Result<Option<(Vec<Rgb>, Counters)>, Error> {
        let Baking { settings, plan, lighting, .. } = baking;
        let (group, key) = (&lighting.groups[number], &baking.keys.groups[number].shoot);
        if group.sources.is_empty() || !plan.runs(Stage::Shoot) {
            journal.left_out_unless_run(plan, Stage::Shoot);
            return Ok(None);
        }
        let emitters = group.emitters(self.emitters(rays.geometry));
        let count = surfels.list.len();
        let read = |body: &mut Reader| Ok((head::<Counters>(body)?, artefact::light(body, count)?));
        if let Some((counters, light)) = baking.store.and_then(|store| store.get(Kind::Shoot, key, read)) {
            baking.found(Kind::Shoot, number);
            journal.reused(plan, Stage::Shoot, counters.clone());
            return Ok(Some((light, counters)));
        }
        let geometry = rays.geometry;
        let points = if self.is_coarse || direct::is_crowded(geometry, &emitters) { 1 } else { POINTS };
        // How many groups the photons make is known to the shooting alone.
        let work = if settings.photons.0 > 0 { 0 } else { count as u64 * u64::from(points) };
        let light = journal.always(Stage::Shoot, plan.reason(Stage::Shoot), Some(work), |progress, counters| {
            let shot = if settings.photons.0 > 0 {
                let primary = settings.photons.0.div_ceil(PHOTONS_PER_POINT);
                let how = PhotonSettings { primary, directions: PHOTONS_PER_POINT };
                shoot::photons(rays, &emitters, surfels, how, progress)?
            } else {
                let exact = |direct: &dyn Gather| Ok(shoot::exact(geometry, surfels, direct, points, progress)?);
                let visibility = if self.is_coarse { Visibility::Rays } else { Visibility::Shafts };
                let mut shot = direct::with(rays, &emitters, settings, visibility, progress, exact)?;
                shot.rays += shoot::close(rays, &emitters, surfels, points, &mut shot.irradiance, progress)?;
                shot
            };
            counters.insert("primary_photons".into(), shot.primary_photons);
            counters.insert("sent_photons".into(), shot.primary_photons * u64::from(PHOTONS_PER_POINT));
            counters.insert("arrived_photons".into(), shot.arrived_photons);
            counters.insert("continuous_rays".into(), shot.rays);
            baking.put(Kind::Shoot, key, progress, |out| {
                put_value(out, counters)?;
                put_slice(out, &shot.irradiance)
            })?;
            Ok(shot.irradiance)
        })?;
        Ok(Some((light, journal.last(Stage::Shoot))))
    }
}

/// Surfels and their light, if they can be of a scene with so many triangles: a stored tree says nothing about the scene
/// it meets.
fn octree_of(body: &mut Reader, triangles: usize) -> Result<(Surfels, Solution), String> {
    let length = body.left();
    let (surfels, solution) = octree::read(body, length).map_err(|e| e.to_string())?;
    let is_own = surfels.list.iter().all(|s| (s.triangle as usize) < triangles);
    if is_own { Ok((surfels, solution)) } else { Err("it belongs to another scene".into()) }
}

fn is_known_closed(rays: &Rays, surfels: &Surfels, settings: &Settings) -> bool {
    match settings.closed {
        Closed::Yes => true,
        Closed::No => false,
        Closed::Auto => is_closed(rays, surfels, CLOSED_PROBES),
    }
}

fn solve_settings(settings: &Settings) -> SolveSettings {
    SolveSettings {
        directions: settings.directions.0,
        decay: settings.direction_decay.0,
        max_bounces: settings.bounces.0,
        tolerance: f64::from(settings.tolerance.0),
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
    use crate::bake::groups::Lighting;
    use crate::bake::keys::Keys;
    use crate::settings::Preset;
    use crate::settings::value::Samples;
    use glam::Vec3;
    use luxel_scene::{Silent, build::Builder};

    /// What a stored octree is believed to be must not change under an unchanged key.
    #[test]
    fn the_light_at_surfels_is_that_of_its_stages_versions() {
        let mut b = Builder::new("room");
        let (wall, lamp) = (b.matte(Vec3::new(0.7, 0.5, 0.3)), b.emitter(Vec3::splat(0.5), Vec3::splat(10.0)));
        b.cuboid("shell", Vec3::ZERO, Vec3::new(1.0, 0.8, 1.2), wall, true);
        b.quad("lamp", Vec3::new(0.4, 0.7, 0.4), Vec3::X * 0.2, Vec3::Z * 0.2, lamp);
        let mut scene = b.build();
        let settings =
            Settings { voxels: Voxels::Side(8), directions: Samples(64), ..Settings::preset(Preset::Medium) };
        let lighting = Lighting::part(&mut scene, &settings);
        let geometry = Geometry::new(&scene);
        let plan = Plan::new(&scene, &settings);
        let keys = Keys::new(&scene, &lighting, &settings, &plan);
        let baking = Baking {
            settings: &settings,
            plan: &plan,
            lighting: &lighting,
            keys: &keys,
            store: None,
            kept: None,
            only_stored: false,
            books: true,
        };
        let mut transport = Transport::default();
        let tracer = Tracer::new(&geometry, None);
        let (surfels, solution, _) = transport.solution(&baking, &tracer, 0, &mut Journal::new(&Silent)).unwrap();
        let mut hasher = blake3::Hasher::new();
        Octree::new(&surfels, &solution).write(&mut hasher).unwrap();
        let hash = hasher.finalize().to_hex();
        let versions = STORED.map(|stage| format!("{} {}", stage.name(), stage.version())).join(", ");
        let known = (
            "surfels 6, shoot 6, propagate 7, refresh 5",
            "fca28b186b2d5657c258e19e336d734d92df34b46629d4b2da8d649340c8fbbe",
        );
        assert_eq!(
            (versions.as_str(), hash.as_str()),
            known,
            "the light at surfels has changed: raise the version of the stage that changed it in Stage::version, \
             then write versions and hash here"
        );
    }
}
