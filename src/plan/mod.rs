//! What a scene needs, and what it does not: decided once, before any work, and obeyed by the bake.
//!
//! [`Plan::new`] is a pure function of scene and settings. It lists every stage with the reason why it runs or is left
//! out, and estimates the memory that the bake takes beyond the scene. What lies in files is added to it afterwards:
//! stages whose result is stored ([`Plan::reuse`]).

mod memory;

use luxel_export::report::Warning;
use luxel_scene::{Instance, LightKind, Material, Scene};
use luxel_transport::solve::SolveSettings;
use serde::Serialize;

use crate::settings::{Gatherer, Only, Settings, Voxels};
pub use memory::Memory;

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
            Self::Propagate => 7,
            Self::Surfels | Self::Shoot | Self::Direct => 6,
            Self::Refresh => 5,
            Self::Unwrap | Self::Preview => 4,
            Self::Gather | Self::Finish | Self::Export => 3,
            Self::Sky => 2,
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
        let memory = memory::estimate(&facts, scene, settings, &runs);
        let warnings = scene.notices.iter().map(Warning::from).collect();
        Self { facts, light_groups: Vec::new(), steps, memory, warnings }
    }

    /// The plan of whoever looks at surfaces themselves: all light at surfels, whatever a lightmap would hold of it and
    /// whether or not there would be one.
    pub fn of_all_light(scene: &Scene, settings: &Settings) -> Self {
        let plan = Self::new(scene, settings);
        let facts = Facts { receivers: plan.facts.receivers.max(1), ..plan.facts.clone() };
        Self { steps: steps(&facts, &Settings { only: Only::All, ..settings.clone() }), ..plan }
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
            facts.area += area(scene, instance);
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

/// World area of an instance's triangles, in squared scene units.
pub fn area(scene: &Scene, instance: &Instance) -> f64 {
    let triangle = |t| {
        let [a, b, c] = scene.corners(instance.mesh, t).map(|p| instance.transform.transform_point3(p.as_dvec3()));
        0.5 * (b - a).cross(c - a).length()
    };
    (0..scene.meshes[instance.mesh].triangles.len()).map(triangle).sum()
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_scene::{Sky, TextureRef, build::Builder};

    pub fn room(albedo: Vec3, radiance: Vec3) -> Scene {
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
