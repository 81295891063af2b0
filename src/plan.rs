//! What a scene needs, and what it does not: decided once, before any work, and obeyed by the bake.
//!
//! [`Plan::new`] is a pure function of scene and settings. It lists every stage with the reason why it runs or is left
//! out, and estimates the memory that the bake takes beyond the scene. What lies in files is added to it afterwards:
//! stages whose result is stored ([`Plan::reuse`]).

use luxel_atlas::AtlasSettings;
use luxel_export::report::Warning;
use luxel_scene::{LightKind, Material, Scene};
use luxel_transport::solve::SolveSettings;
use serde::Serialize;

use crate::settings::{Gatherer, Only, Settings, Voxels};

/// The chain of a bake, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    Import,
    Unwrap,
    Rays,
    Surfels,
    Shoot,
    Propagate,
    Refresh,
    Cache,
    Clear,
    Direct,
    Sky,
    Gather,
    Finish,
    Preview,
    Export,
}

impl Stage {
    pub const ALL: [Self; 15] = [
        Self::Import,
        Self::Unwrap,
        Self::Rays,
        Self::Surfels,
        Self::Shoot,
        Self::Propagate,
        Self::Refresh,
        Self::Cache,
        Self::Clear,
        Self::Direct,
        Self::Sky,
        Self::Gather,
        Self::Finish,
        Self::Preview,
        Self::Export,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Import => "import",
            Self::Unwrap => "unwrap",
            Self::Rays => "rays",
            Self::Surfels => "surfels",
            Self::Shoot => "shoot",
            Self::Propagate => "propagate",
            Self::Refresh => "refresh",
            Self::Cache => "cache",
            Self::Clear => "clear",
            Self::Direct => "direct",
            Self::Sky => "sky",
            Self::Gather => "gather",
            Self::Finish => "finish",
            Self::Preview => "preview",
            Self::Export => "export",
        }
    }

    /// Version of what the stage makes. Raise it here whenever the stage makes something else of the same input:
    /// stored light of an older version is then made anew instead of being taken for this one's.
    pub fn version(self) -> u32 {
        match self {
            Self::Surfels | Self::Propagate => 4,
            Self::Unwrap | Self::Shoot | Self::Direct | Self::Gather | Self::Finish | Self::Export => 3,
            Self::Refresh | Self::Sky | Self::Preview => 2,
            Self::Import | Self::Rays | Self::Cache | Self::Clear => 1,
        }
    }
}

/// A stage with the decision about it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    pub stage: Stage,
    /// It is needed: the bake runs it, or reuses what it made before.
    pub runs: bool,
    /// What it made before is stored and will serve.
    pub reused: bool,
    /// What it will do, or why it is reused or left out.
    pub reason: String,
}

/// What the plan saw in the scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Facts {
    /// In the world, instances expanded.
    pub triangles: usize,
    pub instances: usize,
    /// Instances that get a place in the lightmap.
    pub receivers: usize,
    /// World area of everything that casts, in squared scene units.
    pub area: f64,
    /// Triangles that emit light.
    pub emissive_triangles: usize,
    pub lamps: usize,
    pub suns: usize,
    pub sky: bool,
    /// No surface reflects any light.
    pub black: bool,
    /// Some surface may reflect so much that bounces do not come to rest by themselves.
    pub bright: bool,
    /// All lights and surfaces are grey.
    pub grey: bool,
    /// Some surface has holes or lets light through.
    pub passable: bool,
    /// Images that were decoded because a surface needs them.
    pub textures: usize,
}

/// Estimated memory beyond the scene itself [bytes].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Memory {
    pub rays: u64,
    pub surfels: u64,
    pub texels: u64,
    pub images: u64,
    /// The scene's own buffers and images, which the export writes again.
    pub files: u64,
}

impl Memory {
    pub fn total(&self) -> u64 {
        [self.rays, self.surfels, self.texels, self.images, self.files].into_iter().fold(0, u64::saturating_add)
    }
}

/// What will be done, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    pub facts: Facts,
    /// Names of the light groups that are baked apart, in their order; none before lights are parted.
    pub light_groups: Vec<String>,
    pub steps: Vec<Step>,
    pub memory: Memory,
    /// What a person should know of the scene.
    pub warnings: Vec<Warning>,
}

impl Plan {
    pub fn new(scene: &Scene, settings: &Settings) -> Self {
        let facts = Facts::new(scene);
        let steps = steps(&facts, settings);
        let runs = |stage| steps.iter().any(|s| s.stage == stage && s.runs);
        let memory = memory(&facts, scene, settings, &runs);
        let warnings = scene.notices.iter().map(Warning::from).collect();
        Self { facts, light_groups: Vec::new(), steps, memory, warnings }
    }

    /// The plan of the same scene with settings that take no more memory.
    pub fn with(&self, settings: &Settings) -> Self {
        Self { steps: steps(&self.facts, settings), ..self.clone() }
    }

    pub fn runs(&self, stage: Stage) -> bool {
        self.steps.iter().any(|s| s.stage == stage && s.runs)
    }

    /// A map of stated bounds is wanted and can be had: the gather runs, in a mode that states one.
    pub fn states_bound(&self, settings: &Settings) -> bool {
        settings.bound && settings.states_bound() && self.runs(Stage::Gather)
    }

    /// Takes the names of the light groups that are baked apart: the sum of some is held beside the next.
    pub fn part(&mut self, groups: Vec<String>, settings: &Settings) {
        self.light_groups = groups;
        if self.runs(Stage::Unwrap) {
            self.memory.texels = self.texel_bytes(pixels(&self.facts, settings), settings);
        }
    }

    fn texel_bytes(&self, pixels: u64, settings: &Settings) -> u64 {
        texel_bytes(pixels, settings, self.light_groups.len(), &|stage| self.runs(stage))
    }

    /// Counts the bytes of the files that the export writes again.
    pub fn weigh(&mut self, file_bytes: u64) {
        self.memory.files = file_bytes.saturating_mul(COPIES);
    }

    /// The memory without what an atlas cannot have: no more pages than receivers, and no more than luxel makes. Objects
    /// that a texel density makes larger than a page get less of it.
    pub fn least_memory(&self, settings: &Settings) -> Memory {
        let side = u64::from(settings.size.0);
        let pages = (self.facts.receivers as u64).min(AtlasSettings::default().max_pages.into());
        let pixels = pages.saturating_mul(side * side);
        Memory {
            texels: self.memory.texels.min(self.texel_bytes(pixels, settings)),
            images: self.memory.images.min(image_bytes(pixels)),
            ..self.memory
        }
    }

    /// Leaves out a stage that the scene would need.
    pub fn leave_out(&mut self, stage: Stage, reason: &str) {
        for step in self.steps.iter_mut().filter(|s| s.stage == stage) {
            (step.runs, step.reason) = (false, reason.into());
        }
    }

    /// Marks a stage that the bake needs as one that it will not run anew.
    pub fn reuse(&mut self, stage: Stage, reason: &str) {
        for step in self.steps.iter_mut().filter(|s| s.stage == stage && s.runs) {
            step.reused = true;
            step.reason = reason.into();
        }
    }

    /// Says why a stage runs although it was run before, as far as the bake needs it.
    pub fn explain(&mut self, stage: Stage, why: &str) {
        for step in self.steps.iter_mut().filter(|s| s.stage == stage && s.runs) {
            step.reason += &format!("; {why}");
        }
    }

    pub fn reason(&self, stage: Stage) -> &str {
        self.steps.iter().find(|s| s.stage == stage).map_or("", |s| &s.reason)
    }
}

impl Facts {
    pub fn new(scene: &Scene) -> Self {
        let mut facts = Self {
            triangles: scene.triangle_count(),
            instances: scene.instances.len(),
            receivers: scene.instances.iter().filter(|i| i.receives).count(),
            sky: !scene.sky.is_dark(),
            textures: scene.textures.len(),
            black: true,
            ..Self::default()
        };
        for light in scene.lights.iter().filter(|l| l.intensity.max_element() > 0.0) {
            match light.kind {
                LightKind::Sun { .. } => facts.suns += 1,
                LightKind::Point { .. } | LightKind::Spot { .. } => facts.lamps += 1,
            }
        }
        let mut used = vec![false; scene.materials.len()];
        for instance in scene.instances.iter().filter(|i| i.casts || i.receives) {
            let mesh = &scene.meshes[instance.mesh];
            let material = &scene.materials[mesh.material];
            used[mesh.material] = true;
            if !instance.casts || material.unlit {
                continue;
            }
            if material.emits() {
                facts.emissive_triangles += mesh.triangles.len();
            }
            facts.black &= is_black(material);
            facts.bright |= f64::from(material.base_color.truncate().max_element()) > SolveSettings::default().stiff;
            facts.passable |= !material.is_opaque();
            facts.area += (0..mesh.triangles.len())
                .map(|t| {
                    let [a, b, c] =
                        scene.corners(instance.mesh, t).map(|p| instance.transform.transform_point3(p.as_dvec3()));
                    0.5 * (b - a).cross(c - a).length()
                })
                .sum::<f64>();
        }
        facts.grey = is_grey(scene, &used);
        facts
    }

    /// Light that is computed as direct: lamps, suns and emissive surfaces.
    fn has_direct(&self) -> bool {
        self.emissive_triangles + self.lamps + self.suns > 0
    }

    fn sources(&self) -> String {
        let count = |n: usize, one: &str, many: &str| match n {
            0 => None,
            1 => Some(format!("1 {one}")),
            n => Some(format!("{n} {many}")),
        };
        let parts: Vec<String> = [
            count(self.emissive_triangles, "emissive triangle", "emissive triangles"),
            count(self.lamps, "lamp", "lamps"),
            count(self.suns, "sun", "suns"),
        ]
        .into_iter()
        .flatten()
        .collect();
        parts.join(", ")
    }
}

/// No texel of the material can reflect anything.
fn is_black(m: &Material) -> bool {
    let diffuse = (1.0 - m.metallic + m.metallic * m.roughness * m.metal_diffuse).max(0.0);
    // A texture can only take the metal or the transmission away again, so it leaves the question open.
    let may_vary = m.metallic_roughness_texture.is_some();
    let passes_all = m.transmission >= 1.0 && m.transmission_texture.is_none();
    m.base_color.truncate().max_element() <= 0.0 || passes_all || (diffuse <= 0.0 && !may_vary)
}

fn is_grey(scene: &Scene, used: &[bool]) -> bool {
    use luxel_scene::Sky;
    let grey = |c: glam::Vec3| c.x == c.y && c.y == c.z;
    let sky = match &scene.sky {
        Sky::None => true,
        Sky::Constant(c) => grey(*c),
        Sky::Gradient { zenith, horizon, ground } => grey(*zenith) && grey(*horizon) && grey(*ground),
        Sky::Image(image) => image.texels.iter().all(|c| grey(*c)),
    };
    let texture = |t: &Option<luxel_scene::TextureRef>| {
        t.as_ref().is_none_or(|t| scene.textures[t.texture].texels.iter().all(|c| c[0] == c[1] && c[1] == c[2]))
    };
    let colored_vertices = scene.meshes.iter().flat_map(|m| &m.colors).any(|c| !grey(c.truncate()));
    sky && !colored_vertices
        && scene.lights.iter().all(|l| grey(l.intensity))
        && scene.materials.iter().zip(used).filter(|(_, used)| **used).all(|(m, _)| {
            grey(m.base_color.truncate())
                && grey(m.emission)
                && texture(&m.base_color_texture)
                && texture(&m.emissive_texture)
        })
}

/// The decision about every stage.
fn steps(facts: &Facts, settings: &Settings) -> Vec<Step> {
    let step = |stage| match decide(stage, facts, settings) {
        Ok(reason) => Step { stage, runs: true, reused: false, reason },
        Err(reason) => Step { stage, runs: false, reused: false, reason },
    };
    Stage::ALL.into_iter().map(step).collect()
}

/// `Ok(what it does)`, or `Err(why it is left out)`.
fn decide(stage: Stage, facts: &Facts, settings: &Settings) -> Result<String, String> {
    let lit = facts.has_direct() || facts.sky;
    let yes = |reason: &str| Ok(reason.to_owned());
    let no = |reason: &str| Err(reason.to_owned());
    if stage == Stage::Import {
        return Ok(format!("{} triangles in {} instances", facts.triangles, facts.instances));
    }
    if facts.receivers == 0 && stage != Stage::Export {
        return no("nothing in the scene receives a lightmap");
    }
    match stage {
        Stage::Import | Stage::Export => yes("images, glTF and report"),
        Stage::Unwrap => Ok(format!("{} instances receive light", facts.receivers)),
        Stage::Finish => yes("fills buried and unused texels, stitches seams"),
        Stage::Preview => yes("a picture of the result"),
        _ if !lit => no("the scene has no light"),
        Stage::Rays if facts.passable => yes("some surfaces have holes or let light through"),
        Stage::Clear => yes("moves texels out of the geometry that buries them, or marks them"),
        Stage::Rays => yes("every surface is solid: no material is looked up along a ray"),
        Stage::Direct if settings.only == Only::Indirect => no("only indirect light is wanted"),
        Stage::Direct if !facts.has_direct() => no("the sky is the only light"),
        Stage::Direct => Ok(facts.sources()),
        Stage::Sky if !facts.sky => no("there is no sky"),
        Stage::Sky if settings.only == Only::Direct => no("only direct light is wanted"),
        Stage::Sky if settings.gatherer() == Gatherer::Lookup && !facts.black => {
            no("the cache that is looked up holds the sky's light")
        }
        Stage::Sky => Ok(format!("{} rays per texel", settings.sky_rays.0)),
        _ if settings.only == Only::Direct => no("only direct light is wanted"),
        _ if facts.black => no("no surface reflects light"),
        Stage::Surfels => Ok(match settings.voxels {
            Voxels::Budget(n) => format!("about {n} surfels"),
            Voxels::Side(n) => format!("{n} voxels along the longest side"),
            Voxels::Edge(e) => format!("voxels of {e} scene units"),
        }),
        Stage::Shoot if !facts.has_direct() => no("the sky is the only light, and it arrives with the sweep"),
        Stage::Shoot if settings.photons.0 > 0 => Ok(format!("{} photons", settings.photons.0)),
        Stage::Shoot => Ok(format!("light of {} at every surfel", facts.sources())),
        Stage::Propagate => Ok(format!(
            "{} directions, halved at every bounce, {}",
            settings.directions.0,
            if facts.grey { "one band: everything is grey" } else { "three bands" }
        )),
        Stage::Refresh if settings.refresh.0 == 0 => no("switched off"),
        Stage::Refresh => Ok(format!("{} rays per surfel", settings.refresh.0)),
        Stage::Cache => yes("octree of the light at surfels"),
        Stage::Gather => Ok(match settings.gatherer() {
            Gatherer::Lookup => "looked up in the cache".into(),
            Gatherer::Final => format!("{} rays per texel", settings.gather_rays.0),
            Gatherer::Lightcuts => {
                format!("lightcuts to {} % of a texel's light", settings.cut_error.0 * 100.0)
            }
        }),
    }
}

// Bytes of the heap at the peak, as `cargo test --test memory -- --nocapture` measures them on two threads.
/// Per triangle: its geometry and the trees of rays, at the peak of their making.
const RAY_TRIANGLE: u64 = 410;
/// Per surfel: the surfel and its light while it is propagated.
const SURFEL: u64 = 145;
/// Per surfel and thread: the lines of a direction, where a slice of voxels may have as many as the scene has surfels;
/// a sweep has at most so many directions in flight that they stay below the second figure.
const LINES: u64 = 16;
const MOST_LINES: u64 = 64;
/// Per surfel, where a surface is so bright that bounces may not come to rest by themselves: the solver's history.
const STIFF: u64 = 125;
/// Per texel: where it is and its light, beside which its pages are made. While light is found its parts are still apart;
/// then there are no pages yet, and together they are less than this and [`PIXEL`].
const TEXEL: u64 = 38;
/// Per texel where light is interpolated between nodes, chart by chart: what a chart holds beside, for charts of up to a
/// sixth of all texels. Larger ones are rare and take more.
const CHARTED: u64 = 16;
/// Per texel: the stated bound, and its page.
const BOUND: u64 = 8;
/// Per texel while the light of one group of several is found: the sum of those before, which is gone when pages are
/// made; so it counts beside them only where light is interpolated, which takes as much as they do.
const GROUPS: u64 = 30;
/// Per pixel of a page: what is beside the texels while it is finished.
const PIXEL: u64 = 15;
/// Times that the bytes of the scene's files exist when they are written again: as read, laid out, and as a .glb.
const COPIES: u64 = 3;
/// The picture and what else does not grow with the scene.
const FIXED: u64 = 16 << 20;

/// Figures beyond all measure saturate: what asks for that much is refused by its stage, not by the estimate.
fn memory(facts: &Facts, scene: &Scene, settings: &Settings, runs: &dyn Fn(Stage) -> bool) -> Memory {
    let pixels = pixels(facts, settings);
    let surfels = match settings.voxels {
        Voxels::Budget(n) => u64::from(n),
        Voxels::Side(n) => patches(facts, longest_side(scene) / f64::from(n)),
        Voxels::Edge(edge) => patches(facts, f64::from(edge)),
    };
    let when = |stage, bytes| if runs(stage) { bytes } else { 0 };
    Memory {
        rays: when(Stage::Rays, (facts.triangles as u64).saturating_mul(RAY_TRIANGLE)),
        surfels: when(Stage::Surfels, surfels.saturating_mul(surfel_bytes(facts, settings))),
        texels: when(Stage::Unwrap, texel_bytes(pixels, settings, 1, runs)),
        images: when(Stage::Finish, image_bytes(pixels)),
        files: 0,
    }
}

/// Pixels of whole pages, of which charts cover about three quarters.
fn pixels(facts: &Facts, settings: &Settings) -> u64 {
    let side = u64::from(settings.size.0);
    match settings.texel_density.0 {
        Some(density) => {
            let texels = facts.area * f64::from(density) * f64::from(density) / 0.75;
            (texels as u64).div_ceil(side * side).max(1).saturating_mul(side * side)
        }
        None => side * side,
    }
}

fn surfel_bytes(facts: &Facts, settings: &Settings) -> u64 {
    let threads = match settings.threads.0 {
        0 => std::thread::available_parallelism().map_or(1, std::num::NonZero::get) as u64,
        n => u64::from(n),
    };
    SURFEL + (LINES * threads).min(MOST_LINES) + if facts.bright { STIFF } else { 0 }
}

/// Nine tenths of the pixels of a page are texels, partly covered ones included.
fn texel_bytes(pixels: u64, settings: &Settings, groups: usize, runs: &dyn Fn(Stage) -> bool) -> u64 {
    let charted = runs(Stage::Sky) || runs(Stage::Gather) && settings.gatherer() != Gatherer::Lookup;
    let bound = settings.bound && settings.states_bound() && runs(Stage::Gather);
    let parted = groups > 1 && (runs(Stage::Direct) || runs(Stage::Sky) || runs(Stage::Gather));
    let sum = if charted { GROUPS } else { GROUPS - PIXEL };
    let extras = [(charted, CHARTED), (bound, BOUND), (parted, sum)];
    let each = TEXEL + extras.into_iter().filter_map(|(is, bytes)| is.then_some(bytes)).sum::<u64>();
    (pixels / 10 * 9).saturating_mul(each)
}

fn image_bytes(pixels: u64) -> u64 {
    pixels.saturating_mul(PIXEL).saturating_add(FIXED)
}

/// Surfels of edge `edge` on the scene's area; a plane cuts about 1.5 times as many voxels as its area would fill.
fn patches(facts: &Facts, edge: f64) -> u64 {
    if edge > 0.0 { (1.5 * facts.area / (edge * edge)) as u64 } else { 0 }
}

fn longest_side(scene: &Scene) -> f64 {
    scene.bounds().map_or(0.0, |(lo, hi)| (hi - lo).max_element())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::value::OrAuto;
    use glam::Vec3;
    use luxel_scene::{Sky, TextureRef, build::Builder};

    fn room(albedo: Vec3, radiance: Vec3) -> Scene {
        let mut b = Builder::new("room");
        let wall = b.matte(albedo);
        let lamp = b.emitter(Vec3::splat(0.5), radiance);
        b.cuboid("shell", Vec3::ZERO, Vec3::ONE, wall, true);
        b.quad("lamp", Vec3::new(0.4, 0.9, 0.4), Vec3::X * 0.2, Vec3::Z * 0.2, lamp);
        b.build()
    }

    fn left_out(plan: &Plan) -> Vec<Stage> {
        plan.steps.iter().filter(|s| !s.runs).map(|s| s.stage).collect()
    }

    #[test]
    fn a_lit_room_needs_everything_but_a_sky() {
        let plan = Plan::new(&room(Vec3::splat(0.5), Vec3::ONE), &Settings::default());
        assert_eq!(left_out(&plan), [Stage::Sky]);
        assert!(plan.facts.grey && !plan.facts.black && !plan.facts.passable);
        assert!((plan.facts.area - 6.04).abs() < 1e-5, "{}", plan.facts.area);
        assert!(plan.reason(Stage::Propagate).contains("one band"));
        assert!(plan.memory.total() > plan.memory.texels && plan.memory.texels > 0);
    }

    #[test]
    fn without_light_nothing_is_transported() {
        let plan = Plan::new(&room(Vec3::splat(0.5), Vec3::ZERO), &Settings::default());
        use Stage::*;
        assert_eq!(left_out(&plan), [Rays, Surfels, Shoot, Propagate, Refresh, Cache, Clear, Direct, Sky, Gather]);
        assert!(plan.runs(Unwrap) && plan.runs(Export), "a dark scene still gets its black lightmap");
        assert_eq!(plan.memory.surfels, 0);
    }

    #[test]
    fn a_scene_under_the_sky_alone_has_no_direct_light() {
        let mut scene = room(Vec3::splat(0.5), Vec3::ZERO);
        scene.sky = Sky::Constant(Vec3::new(1.0, 1.0, 2.0));
        let plan = Plan::new(&scene, &Settings::default());
        assert_eq!(left_out(&plan), [Stage::Shoot, Stage::Direct]);
        assert!(!plan.facts.grey);
    }

    #[test]
    fn black_walls_do_not_bounce() {
        let mut scene = room(Vec3::ZERO, Vec3::ONE);
        scene.materials[1].base_color = Vec3::ZERO.extend(1.0);
        let plan = Plan::new(&scene, &Settings::default());
        use Stage::*;
        assert_eq!(left_out(&plan), [Surfels, Shoot, Propagate, Refresh, Cache, Sky, Gather]);
        assert!(plan.reason(Propagate).contains("reflects"));
    }

    #[test]
    fn a_texture_may_take_the_transmission_away() {
        let mut scene = room(Vec3::splat(0.5), Vec3::ONE);
        for material in &mut scene.materials {
            material.transmission = 1.0;
        }
        assert!(Plan::new(&scene, &Settings::default()).facts.black, "clear glass alone reflects nothing");
        scene.materials[1].transmission_texture = Some(TextureRef::new(0));
        let plan = Plan::new(&scene, &Settings::default());
        assert!(!plan.facts.black && plan.runs(Stage::Gather));
    }

    #[test]
    fn an_estimate_beyond_all_measure_is_still_a_number() {
        let scene = room(Vec3::splat(0.5), Vec3::ONE);
        let total = |settings| Plan::new(&scene, &settings).memory.total();
        let texel_density = OrAuto(Some(1e30));
        assert_eq!(total(Settings { texel_density, ..Settings::default() }), u64::MAX);
        assert_eq!(total(Settings { voxels: Voxels::Edge(1e-30), ..Settings::default() }), u64::MAX);
        assert!(total(Settings { voxels: Voxels::Edge(1e30), ..Settings::default() }) < u64::MAX);
        let texel_density = OrAuto(Some(f32::MAX));
        assert_eq!(
            total(Settings { texel_density, voxels: Voxels::Edge(f32::MIN_POSITIVE), ..Settings::default() }),
            u64::MAX
        );
    }

    #[test]
    fn an_atlas_has_no_more_pages_than_receivers() {
        let scene = room(Vec3::splat(0.5), Vec3::ONE);
        let of = |density| {
            let settings = Settings { texel_density: OrAuto(Some(density)), ..Settings::default() };
            let plan = Plan::new(&scene, &settings);
            let pages = plan.texel_bytes(2 << 20, &settings);
            (plan.least_memory(&settings), plan.memory, pages)
        };
        let (least, estimate, _) = of(1.0);
        assert_eq!(least, estimate);
        // Two objects on a page each, whatever their density.
        let (least, estimate, pages) = of(1e9);
        assert!(least.texels < estimate.texels && least.texels == pages);
        assert_eq!(least.images, image_bytes(2 << 20));
    }

    #[test]
    fn what_is_not_wanted_is_not_computed() {
        let scene = room(Vec3::splat(0.5), Vec3::ONE);
        let only = |only| Plan::new(&scene, &Settings { only, ..Settings::default() });
        use Stage::*;
        assert_eq!(left_out(&only(Only::Direct)), [Surfels, Shoot, Propagate, Refresh, Cache, Sky, Gather]);
        assert_eq!(left_out(&only(Only::Indirect)), [Direct, Sky]);
    }

    #[test]
    fn an_empty_scene_exports_and_nothing_else() {
        let plan = Plan::new(&Scene::default(), &Settings::default());
        let runs: Vec<Stage> = plan.steps.iter().filter(|s| s.runs).map(|s| s.stage).collect();
        assert_eq!(runs, [Stage::Import, Stage::Export]);
    }

    #[test]
    fn unlit_and_unused_things_do_not_count() {
        let mut scene = room(Vec3::splat(0.5), Vec3::ONE);
        scene.materials[1].unlit = true;
        assert_eq!(Plan::new(&scene, &Settings::default()).facts.emissive_triangles, 0);
        scene.materials[1].unlit = false;
        scene.instances[1].casts = false;
        scene.instances[1].receives = false;
        scene.materials[1].base_color.x = 0.9;
        let facts = Plan::new(&scene, &Settings::default()).facts;
        assert!(facts.emissive_triangles == 0 && facts.grey);
    }
}
