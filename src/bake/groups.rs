//! Light groups: the lights of a scene at unit power, parted into what is shot, propagated and gathered together.
//!
//! Transport is linear in the lights, band by band, so the light of a scene is a sum over groups:
//!
//! ```text
//! E = Σ_g f_g ⊙ E_g      f_g  factor of the group: per band the largest coefficient of its sources
//!                        E_g  its light when every source s shines with the weight c_s / f_g times its unit
//! ```
//!
//! The unit of a source is one in every band: a lamp of 1 cd, a sun of 1 lx, a surface whose emissive texture is not
//! scaled, a sky of unit radiance; its coefficient c_s is what the file says. A group with one source has the weight one
//! to the bit, so another colour or strength of it is another factor and nothing else. The bake works with the unit
//! lights from the import on, whether anything is stored or not, so that what is put together from stored groups has
//! the bytes of a clean bake.
//!
//! A source belongs to the group that the extra `luxel_group` names, else to that of its node's name; the sky is the
//! group `sky`. Above [`MOST`] groups all are one: every group costs its own propagation and gather. So they are where
//! emissive surfaces are too many to be told apart (see [`super::direct`]); these keep the strengths of the file.

use std::collections::BTreeMap;

use luxel_scene::{Scene, Sky};
use luxel_transport::{
    Rgb,
    geometry::Geometry,
    lights::{Emitters, Source, sane},
};

use super::direct;
use crate::settings::{LightGroups, Settings};

/// Most groups that are kept apart.
pub const MOST: usize = 8;

/// The group of the sky.
pub const SKY: &str = "sky";

/// The only group, where lights are not kept apart.
pub const ALL: &str = "all";

/// Lights that are baked together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    pub name: String,
    /// f_g, by band.
    pub factor: Rgb,
    /// Weights of the lamps, suns and emissive instances in it.
    pub sources: BTreeMap<Source, Rgb>,
    /// Weight of the sky, where it belongs to the group.
    pub sky: Option<Rgb>,
}

/// How the lights of a scene are parted, and what their unit stands for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lighting {
    /// By name.
    pub groups: Vec<Group>,
    /// Coefficient of every material's emission, and of the sky's radiance: what the scene says, over its unit.
    pub emission: Vec<Rgb>,
    pub sky: Rgb,
    /// Emissive surfaces are gathered by clusters, and all lights keep the strengths of the file.
    pub is_crowd: bool,
    /// Why there is one group where names would make more.
    pub joined: Option<String>,
}

impl Lighting {
    /// Parts the lights of a scene and sets them to their units.
    pub fn part(scene: &mut Scene, settings: &Settings) -> Self {
        if is_crowded(scene) {
            let mut all = Self { emission: vec![Rgb::ONE; scene.materials.len()], sky: Rgb::ONE, ..Self::default() };
            all.is_crowd = true;
            let ones = sources(scene).into_iter().map(|(source, _)| (source, Rgb::ONE)).collect();
            let sky = (!scene.sky.is_dark()).then_some(Rgb::ONE);
            if !all.push(ALL, ones, sky).sources.is_empty() {
                all.joined = Some("the emissive surfaces are too many to be told apart".into());
            }
            return all;
        }
        let mut named: BTreeMap<String, BTreeMap<Source, Rgb>> = BTreeMap::new();
        for (source, group) in sources(scene) {
            named.entry(group).or_default().insert(source, coefficient(scene, source));
        }
        let mut lighting = Self {
            emission: scene.materials.iter().map(|m| if m.emits() { sane(m.emission) } else { Rgb::ONE }).collect(),
            ..Self::default()
        };
        normalise(scene);
        lighting.sky = normalise_sky(&mut scene.sky);
        let sky = (!scene.sky.is_dark()).then_some(lighting.sky);
        let count = named.len() + usize::from(sky.is_some() && !named.contains_key(SKY));
        if settings.light_groups == LightGroups::One || count > MOST {
            if count > MOST {
                lighting.joined = Some(format!("{count} light groups are more than {MOST}"));
            }
            if count > 0 {
                lighting.push(ALL, named.into_values().flatten().collect(), sky);
            }
            return lighting;
        }
        if sky.is_some() {
            named.entry(SKY.into()).or_default();
        }
        for (name, coefficients) in named {
            let sky = sky.filter(|_| name == SKY);
            lighting.push(&name, coefficients, sky);
        }
        lighting
    }

    fn push(&mut self, name: &str, coefficients: BTreeMap<Source, Rgb>, sky: Option<Rgb>) -> &Group {
        let factor = coefficients.values().chain(&sky).fold(Rgb::ZERO, |most, c| most.max(*c));
        let weight = |c: Rgb| {
            let band = |i: usize| if factor[i] > 0.0 { c[i] / factor[i] } else { 1.0 };
            Rgb::new(band(0), band(1), band(2))
        };
        let sources = coefficients.into_iter().map(|(source, c)| (source, weight(c))).collect();
        self.groups.push(Group { name: name.into(), factor, sources, sky: sky.map(weight) });
        &self.groups[self.groups.len() - 1]
    }
}

impl Group {
    /// The group's lights among all of a scene.
    pub fn emitters(&self, all: &Emitters) -> Emitters {
        all.weighted(|source| self.sources.get(&source).copied())
    }
}

/// Emissive surfaces are so many that their light is gathered by clusters, which know no groups.
fn is_crowded(scene: &Scene) -> bool {
    let emits = |m: usize| scene.materials[m].emits() && !scene.materials[m].unlit;
    let meshes = scene.instances.iter().filter(|i| i.casts).map(|i| &scene.meshes[i.mesh]);
    let triangles: usize = meshes.filter(|m| emits(m.material)).map(|m| m.triangles.len()).sum();
    // What is few before triangles are joined stays few.
    if triangles <= direct::LEAST_CROWD {
        return false;
    }
    let geometry = Geometry::new(scene);
    direct::is_crowded(&geometry, &Emitters::new(&geometry))
}

/// Everything that shines, but the sky, with the name of its group.
fn sources(scene: &Scene) -> Vec<(Source, String)> {
    let surface = |(i, instance): (usize, &luxel_scene::Instance)| {
        let material = &scene.materials[scene.meshes[instance.mesh].material];
        let shines = instance.casts && material.emits() && !material.unlit;
        shines.then(|| (Source::Instance(i as u32), instance.group.to_string()))
    };
    let lamp = |(i, light): (usize, &luxel_scene::Light)| {
        (sane(light.intensity) != Rgb::ZERO).then(|| (Source::Light(i as u32), light.group.to_string()))
    };
    let surfaces = scene.instances.iter().enumerate().filter_map(surface);
    surfaces.chain(scene.lights.iter().enumerate().filter_map(lamp)).collect()
}

fn coefficient(scene: &Scene, source: Source) -> Rgb {
    sane(match source {
        Source::Instance(i) => scene.materials[scene.meshes[scene.instances[i as usize].mesh].material].emission,
        Source::Light(i) => scene.lights[i as usize].intensity,
    })
}

/// Sets surfaces and lamps to their units.
fn normalise(scene: &mut Scene) {
    for material in scene.materials.iter_mut().filter(|m| m.emits()) {
        material.emission = Rgb::ONE;
    }
    for light in scene.lights.iter_mut() {
        light.intensity = if sane(light.intensity) == Rgb::ZERO { Rgb::ZERO } else { Rgb::ONE };
    }
}

/// Sets the sky to its unit and returns what that stands for.
fn normalise_sky(sky: &mut Sky) -> Rgb {
    if sky.is_dark() {
        return Rgb::ONE;
    }
    match sky {
        Sky::None => Rgb::ONE,
        Sky::Constant(radiance) => std::mem::replace(radiance, Rgb::ONE),
        Sky::Gradient { zenith, horizon, ground } => {
            let most = zenith.max(*horizon).max(*ground);
            for end in [zenith, horizon, ground] {
                *end = Rgb::from_array([0, 1, 2].map(|i| if most[i] > 0.0 { end[i] / most[i] } else { 0.0 }));
            }
            most
        }
        Sky::Image(image) => Rgb::splat(std::mem::replace(&mut image.strength, 1.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};
    use luxel_scene::{LightKind, build::Builder};

    fn scene(lamps: usize) -> Scene {
        let mut b = Builder::new("room");
        let wall = b.matte(Vec3::splat(0.5));
        let glow = b.emitter(Vec3::ZERO, Vec3::new(8.0, 4.0, 2.0));
        b.quad("floor", Vec3::ZERO, Vec3::X, Vec3::Z, wall);
        b.quad("panel", Vec3::Y, Vec3::X, Vec3::Z, glow);
        for i in 0..lamps {
            let kind = LightKind::Point { position: DVec3::ONE, range: None, radius: 0.0 };
            b.light(&format!("lamp {i}"), kind, Vec3::splat(1.0 + i as f32));
        }
        b.build()
    }

    fn part(scene: &Scene, settings: &Settings) -> (Scene, Lighting) {
        let mut unit = scene.clone();
        let lighting = Lighting::part(&mut unit, settings);
        (unit, lighting)
    }

    fn names(lighting: &Lighting) -> Vec<&str> {
        lighting.groups.iter().map(|g| g.name.as_str()).collect()
    }

    #[test]
    fn every_node_is_a_group_and_the_sky_is_one() {
        let mut scene = scene(2);
        scene.sky = Sky::Constant(Vec3::new(3.0, 0.0, 5.0));
        let (unit, lighting) = part(&scene, &Settings::default());
        assert_eq!(names(&lighting), ["lamp 0", "lamp 1", "panel", "sky"]);
        assert_eq!(lighting.groups[2].factor, Vec3::new(8.0, 4.0, 2.0));
        assert_eq!(lighting.groups[2].sources, BTreeMap::from([(Source::Instance(1), Vec3::ONE)]));
        assert_eq!((lighting.groups[3].factor, lighting.groups[3].sky), (Vec3::new(3.0, 0.0, 5.0), Some(Vec3::ONE)));
        assert_eq!(unit.materials[scene.meshes[1].material].emission, Vec3::ONE);
        assert!(unit.lights.iter().all(|l| l.intensity == Vec3::ONE));
        assert!(matches!(unit.sky, Sky::Constant(c) if c == Vec3::ONE));
    }

    #[test]
    fn another_colour_is_another_factor_and_nothing_else() {
        let one = scene(1);
        let mut other = one.clone();
        other.lights[0].intensity = Vec3::new(0.1, 0.0, 7.0);
        let ((unit, a), (unit_too, mut b)) = (part(&one, &Settings::default()), part(&other, &Settings::default()));
        assert_ne!(a, b);
        b.groups[0].factor = a.groups[0].factor;
        assert_eq!(a, b);
        assert_eq!(format!("{unit:?}"), format!("{unit_too:?}"));
    }

    #[test]
    fn sources_of_one_group_keep_their_proportions() {
        let mut scene = scene(2);
        scene.lights.iter_mut().for_each(|l| l.group = "lamps".into());
        let (_, lighting) = part(&scene, &Settings::default());
        assert_eq!(names(&lighting), ["lamps", "panel"]);
        let weights: Vec<_> = lighting.groups[0].sources.values().copied().collect();
        assert_eq!((lighting.groups[0].factor, weights), (Vec3::splat(2.0), vec![Vec3::splat(0.5), Vec3::ONE]));
    }

    #[test]
    fn too_many_groups_are_one_and_so_are_those_that_are_not_wanted() {
        let (_, lighting) = part(&scene(MOST - 1), &Settings::default());
        assert_eq!((lighting.groups.len(), &lighting.joined), (MOST, &None));
        let (_, lighting) = part(&scene(MOST), &Settings::default());
        assert_eq!(names(&lighting), [ALL]);
        assert!(lighting.joined.is_some_and(|why| why.contains("9 light groups")));
        let one = Settings { light_groups: LightGroups::One, ..Settings::default() };
        let (_, lighting) = part(&scene(1), &one);
        assert_eq!((names(&lighting), &lighting.joined), (vec![ALL], &None));
        assert_eq!(lighting.groups[0].factor, Vec3::new(8.0, 4.0, 2.0));
    }

    #[test]
    fn what_is_dark_is_in_no_group() {
        let mut scene = scene(1);
        scene.lights[0].intensity = Vec3::new(f32::NAN, -1.0, 0.0);
        scene.instances[1].casts = false;
        let (unit, lighting) = part(&scene, &Settings::default());
        assert!(lighting.groups.is_empty() && unit.lights[0].intensity == Vec3::ZERO);
    }

    #[test]
    fn a_crowd_keeps_its_strengths() {
        let mut b = Builder::new("crowd");
        let glow = b.emitter(Vec3::ZERO, Vec3::splat(3.0));
        let lamp = b.quad("lamp", Vec3::ZERO, Vec3::X, Vec3::Z, glow);
        let mesh = b.scene_mut().instances[lamp].mesh;
        for i in 0..1100 {
            let at = glam::DAffine3::from_translation(DVec3::new(3.0 * f64::from(i), 0.0, 0.0));
            b.place(mesh, at, "lamp");
        }
        let scene = b.build();
        let (unit, lighting) = part(&scene, &Settings::default());
        assert_eq!((names(&lighting), lighting.groups[0].factor), (vec![ALL], Vec3::ONE));
        assert_eq!(unit.materials[glow].emission, Vec3::splat(3.0));
        assert!(lighting.joined.is_some());
    }
}
