//! Keys of artefacts: the digest of exactly what a stage reads.
//!
//! ```text
//! layout    ← meshes of what receives with their sizes in the world, names, size, density, padding
//! clear     ← layout, shape
//! surfels   ← shape, matter, voxels, area
//! shoot_g   ← surfels, lights of g, shadow samples, photons, and where there are any, the names that seed them
//! solution_g← shoot_g, sky if it is in g, directions, decay, bounces, …, refresh
//! direct_g  ← clear, lights of g, shadow samples
//! sky       ← clear, sky, sky rays, node spacing
//! gather_g  ← clear, solution_g, gather settings
//! finish    ← layout, clear, and of every group the factor, direct_g, gather_g, sky; padding
//! ```
//!
//! *Shape* is all that rays meet: meshes, transforms, what casts, holes and veils. *Matter* is what surfaces reflect.
//! Lights are those at unit power ([`super::groups`]), so a lamp's colour is in the key of `finish` alone; to those of a
//! group belongs what may cover them. Every key
//! also holds the version of its stage and of luxel; those of unwraps are the meshes' own.
//!
//! The structures of a scene are taken apart field by field here: a new field does not compile until it is decided who
//! reads it.

use std::collections::BTreeMap;

use glam::{DAffine3, DVec3, Vec3};
use luxel_atlas::mesh_key;
use luxel_scene::{Alpha, Instance, Light, LightKind, Material, Mesh, Scene, Sky, SkyImage, Texture, TextureRef, Wrap};
use luxel_transport::lights::Source;
use rayon::prelude::*;

use super::covers::Covers;
use super::digest::Digest;
use super::groups::{Group, Lighting};
use crate::plan::{Plan, Stage};
use crate::settings::Settings;
use crate::store::Key;

// What a scene consists of, in words.
pub const GEOMETRY: &str = "geometry";
pub const MATERIALS: &str = "materials";
pub const LIGHTS: &str = "lights";
pub const SKY: &str = "the sky";
pub const RECEIVERS: &str = "what receives light";

// The settings that stages read.
pub const LAYOUT: [&str; 3] = ["size", "texel_density", "padding"];
pub const CLEAR: [&str; 1] = ["double_sided"];
pub const SURFELS: [&str; 2] = ["voxels", "area"];
pub const SHADOWS: [&str; 1] = ["shadow_samples"];
/// Too many emissive surfaces are gathered by cuts, at surfels and at texels.
pub const CROWD: [&str; 3] = ["cut_error", "cut_limit", "near_rays"];
pub const PHOTONS: [&str; 1] = ["photons"];
pub const SOLUTION: [&str; 8] =
    ["directions", "direction_decay", "bounces", "tolerance", "closed", "direction_set", "rule", "refresh"];
pub const SKY_LIGHT: [&str; 2] = ["sky_rays", "node_spacing"];
pub const GATHER: [&str; 5] = ["cut_error", "cut_limit", "near_rays", "gather_rays", "node_spacing"];
/// Read by what they come to, together with others; the last one leaves stages out.
pub const MODE: [&str; 3] = ["gather", "bound", "only"];
pub const FINISH: [&str; 2] = ["double_sided", "padding"];

/// The keys of all artefacts of a scene.
#[derive(Clone, Debug)]
pub struct Keys {
    pub layout: Key,
    pub clear: Key,
    pub surfels: Key,
    pub sky: Key,
    /// What surfels are made of: shape and matter.
    solids: [Key; 2],
    /// By group.
    pub groups: Vec<GroupKeys>,
    pub finish: Key,
    /// Digests of what the scene consists of, by the words for it: so that a later bake can say what has changed.
    pub parts: BTreeMap<String, String>,
}

/// The keys of one light group's artefacts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupKeys {
    pub shoot: Key,
    pub solution: Key,
    pub direct: Key,
    pub gather: Key,
}

/// The key of a mesh's unwrap.
pub fn unwrap(mesh: &Mesh) -> Key {
    Digest::stage(Stage::Unwrap).bytes(&mesh_key(mesh)).done()
}

impl Keys {
    /// `scene` has its lights at their units.
    pub fn new(scene: &Scene, lighting: &Lighting, settings: &Settings, plan: &Plan) -> Self {
        let parts = Parts::new(scene);
        let layout = parts.layout(settings);
        let (shape, matter, sky_digest) = (parts.shape(), parts.matter(), sky(&scene.sky));
        let setting = |digest: Digest, names: &[&str]| names.iter().fold(digest, |d, name| d.setting(settings, name));
        let clear = Digest::stage(Stage::Clear).bytes(&layout).bytes(&shape);
        let clear = setting(clear.version(Stage::Rays), &CLEAR).done();
        let solids = [shape, matter];
        let surfels = surfels_of(&solids, settings);
        let crowd = if lighting.is_crowd { &CROWD[..] } else { &[] };
        let lit = |digest: Digest| setting(setting(digest, &SHADOWS), crowd);
        let has_photons = settings.photons.0 > 0;
        let sky_key = Digest::stage(Stage::Sky).bytes(&clear).bytes(&sky_digest);
        let sky_key = setting(sky_key, &SKY_LIGHT).done();
        let group = |group: &Group| {
            let own = parts.lights(group);
            let shoot = Digest::stage(Stage::Shoot).bytes(&surfels).bytes(&own);
            let shoot = if has_photons { shoot.bytes(&parts.names(group)) } else { shoot };
            let shoot = setting(lit(shoot), &PHOTONS).done();
            let solution = Digest::stage(Stage::Propagate).version(Stage::Refresh).version(Stage::Cache).bytes(&shoot);
            let solution = match group.sky {
                Some(weight) => solution.bytes(&sky_digest).vec3(weight),
                None => solution.text("no sky"),
            };
            let solution = setting(solution, &SOLUTION).done();
            let direct = lit(Digest::stage(Stage::Direct).bytes(&clear).bytes(&own)).done();
            let gather = Digest::stage(Stage::Gather).bytes(&clear).bytes(&solution).text(settings.gatherer().name());
            let gather = setting(gather, &GATHER).flag(plan.states_bound(settings)).done();
            GroupKeys { shoot, solution, direct, gather }
        };
        let groups: Vec<GroupKeys> = lighting.groups.par_iter().map(group).collect();
        let mut finish = Digest::stage(Stage::Finish).bytes(&layout).bytes(&clear);
        for (group, keys) in lighting.groups.iter().zip(&groups) {
            let parts = [(Stage::Direct, keys.direct), (Stage::Gather, keys.gather), (Stage::Sky, sky_key)];
            finish = finish.vec3(group.factor).vec3(group.sky.unwrap_or(Vec3::ZERO));
            for (stage, key) in parts.into_iter().filter(|(stage, _)| plan.runs(*stage)) {
                finish = finish.text(stage.name()).bytes(&key);
            }
        }
        let finish = setting(finish, &FINISH).done();
        let lights = lighting.groups.iter().fold(Digest::new("all lights"), |digest, group| {
            let digest = digest.text(&group.name).bytes(&parts.lights(group));
            let digest = if has_photons { digest.bytes(&parts.names(group)) } else { digest };
            digest.vec3(if group.sky.is_some() { Vec3::ZERO } else { group.factor })
        });
        let strength = lighting.groups.iter().find_map(|g| Some([g.sky?, g.factor])).unwrap_or_default();
        let sky = strength.into_iter().fold(Digest::new("sky").bytes(&sky_digest), Digest::vec3).done();
        let named = [(GEOMETRY, shape), (MATERIALS, matter), (LIGHTS, lights.done()), (SKY, sky)];
        let named = named.into_iter().chain([(RECEIVERS, parts.receivers(true))]);
        let hex = |key: Key| blake3::Hash::from(key).to_hex().to_string();
        let parts = named.map(|(name, key)| (name.to_owned(), hex(key))).collect();
        Self { layout, clear, surfels, sky: sky_key, solids, groups, finish, parts }
    }

    /// The digest of all that rays meet.
    pub fn shape(&self) -> Key {
        self.solids[0]
    }

    /// The key of the scene's surfels with other settings.
    pub fn surfels(&self, settings: &Settings) -> Key {
        surfels_of(&self.solids, settings)
    }
}

fn surfels_of([shape, matter]: &[Key; 2], settings: &Settings) -> Key {
    let digest = Digest::stage(Stage::Surfels).version(Stage::Rays).bytes(shape).bytes(matter);
    SURFELS.iter().fold(digest, |digest, name| digest.setting(settings, name)).done()
}

/// What a scene is made of, by content.
struct Parts<'a> {
    scene: &'a Scene,
    meshes: Vec<Key>,
    textures: Vec<Key>,
    covers: Covers,
}

impl<'a> Parts<'a> {
    fn new(scene: &'a Scene) -> Self {
        let meshes = scene.meshes.par_iter().map(mesh).collect();
        let textures = scene.textures.par_iter().map(texture).collect();
        Self { scene, meshes, textures, covers: Covers::new(scene) }
    }

    /// What texels are made of: what receives, with its size in the world, on pages as the settings have them.
    fn layout(&self, settings: &Settings) -> Key {
        let digest = Digest::stage(Stage::Unwrap).bytes(&self.receivers(false));
        LAYOUT.iter().fold(digest, |d, name| d.setting(settings, name)).done()
    }

    /// What receives light; without the places, what decides its layout.
    fn receivers(&self, places: bool) -> Key {
        let mut digest = Digest::new("receivers");
        let mut nodes: BTreeMap<(usize, usize, Option<u32>), u64> = BTreeMap::new();
        for instance in &self.scene.instances {
            let Instance { mesh, transform, node, gpu_instance, name, receives, texel_scale, casts: _, group: _ } =
                instance;
            // Which primitives are of one node matters, not which number it has.
            let next = nodes.len() as u64;
            let node = *nodes.entry((*node, self.scene.meshes[*mesh].gltf_mesh, *gpu_instance)).or_insert(next);
            digest = digest.flag(*receives);
            if *receives {
                let place = if places { transform.translation } else { DVec3::ZERO };
                let placed = DAffine3 { translation: place, ..*transform };
                let placed = digest.bytes(&self.meshes[*mesh]).affine(&placed);
                digest = placed.number(node).text(name).float(*texel_scale);
            }
        }
        digest.done()
    }

    /// What rays meet.
    fn shape(&self) -> Key {
        let mut digest = Digest::new("shape");
        for instance in &self.scene.instances {
            let Instance { mesh, transform, casts, receives: _, texel_scale: _, name: _, node: _, .. } = instance;
            let material = &self.scene.materials[self.scene.meshes[*mesh].material];
            digest = digest.bytes(&self.meshes[*mesh]).affine(transform).flag(*casts);
            digest = digest.flag(material.double_sided).flag(material.unlit).flag(material.is_opaque());
            if !material.is_opaque() {
                digest = self.surface(digest, material);
            }
        }
        digest.done()
    }

    /// What surfaces reflect. What they emit is a matter of lights: surfels are made without regard to it.
    fn matter(&self) -> Key {
        let mut digest = Digest::new("matter");
        for instance in &self.scene.instances {
            let material = &self.scene.materials[self.scene.meshes[instance.mesh].material];
            digest = self.surface(digest, material);
        }
        digest.done()
    }

    /// A material without its emission.
    fn surface(&self, digest: Digest, material: &Material) -> Digest {
        let Material {
            name: _,
            base_color,
            base_color_texture,
            metallic,
            roughness,
            metallic_roughness_texture,
            emission: _,
            emissive_texture: _,
            alpha,
            transmission,
            transmission_texture,
            double_sided,
            unlit,
            metal_diffuse,
        } = material;
        let digest = digest.vec3(base_color.truncate()).float(base_color.w).float(*metallic).float(*roughness);
        let digest = match alpha {
            Alpha::Opaque => digest.text("opaque"),
            Alpha::Mask(cutoff) => digest.text("mask").float(*cutoff),
            Alpha::Blend => digest.text("blend"),
        };
        let digest = digest.float(*transmission).flag(*double_sided).flag(*unlit).float(*metal_diffuse);
        [base_color_texture, metallic_roughness_texture, transmission_texture]
            .into_iter()
            .fold(digest, |digest, texture| self.reference(digest, texture.as_ref()))
    }

    fn reference(&self, digest: Digest, reference: Option<&TextureRef>) -> Digest {
        // The averages follow from the texture.
        let Some(TextureRef { texture, tex_coord, wrap, matrix, offset, averages: _ }) = reference else {
            return digest.text("none");
        };
        let wrap = wrap.map(|wrap| match wrap {
            Wrap::Repeat => "repeat",
            Wrap::Mirror => "mirror",
            Wrap::Clamp => "clamp",
        });
        let digest = digest.bytes(&self.textures[*texture]).number(*tex_coord as u64).text(wrap[0]).text(wrap[1]);
        [matrix[0], matrix[1], *offset].into_iter().fold(digest, |digest, v| digest.float(v.x).float(v.y))
    }

    /// The sources of a group, with their weights. Where a surface is, the shape tells.
    fn lights(&self, group: &Group) -> Key {
        let mut digest = Digest::new("lights");
        let scene = self.scene;
        for (source, weight) in &group.sources {
            digest = digest.vec3(*weight);
            match *source {
                Source::Instance(i) => {
                    let emission = self.material(i).emission;
                    digest = self.shining(digest.text("surface"), i).vec3(emission);
                }
                Source::Light(i) => {
                    let Light { name: _, node: _, group: _, kind, intensity } = &scene.lights[i as usize];
                    digest = light(digest.text("light"), kind).vec3(*intensity);
                }
            }
        }
        self.covers.of(group).fold(digest.text("covers"), |digest, i| self.shining(digest, i)).done()
    }

    fn material(&self, instance: u32) -> &Material {
        &self.scene.materials[self.scene.meshes[self.scene.instances[instance as usize].mesh].material]
    }

    /// An instance that shines, without its strength.
    fn shining(&self, digest: Digest, instance: u32) -> Digest {
        self.reference(digest.number(instance.into()), self.material(instance).emissive_texture.as_ref())
    }

    /// What the sources of a group are called: the seeds of their photons, and of nothing else.
    fn names(&self, group: &Group) -> Key {
        let scene = self.scene;
        let digest = Digest::new("names");
        let name = |digest: Digest, source: &Source| match *source {
            Source::Instance(i) => digest.text(&scene.instances[i as usize].name),
            Source::Light(i) => {
                let name = &scene.lights[i as usize].name;
                // Lights of one name are told apart by their order.
                let others = scene.lights[..i as usize].iter().filter(|l| l.name == *name).count();
                digest.text(name).number(others as u64)
            }
        };
        group.sources.keys().fold(digest, name).done()
    }
}

fn mesh(mesh: &Mesh) -> Key {
    let Mesh { name: _, gltf_mesh: _, gltf_primitive: _, positions, normals, uvs, colors, triangles, material: _ } =
        mesh;
    let digest = Digest::new("mesh").slice(positions).slice(normals).slice(colors).slice(triangles);
    uvs.iter().fold(digest.number(uvs.len() as u64), |digest, set| digest.slice(set)).done()
}

fn texture(texture: &Texture) -> Key {
    let Texture { name: _, width, height, srgb, texels } = texture;
    Digest::new("texture").number((*width).into()).number((*height).into()).flag(*srgb).slice(texels).done()
}

fn light(digest: Digest, kind: &LightKind) -> Digest {
    let optional = |digest: Digest, x: &Option<f64>| match x {
        Some(x) => digest.double(*x),
        None => digest.text("none"),
    };
    let place = |digest: Digest, p: glam::DVec3| digest.double(p.x).double(p.y).double(p.z);
    match kind {
        LightKind::Point { position, range, radius } => {
            optional(place(digest.text("point"), *position), range).double(*radius)
        }
        LightKind::Spot { position, direction, inner, outer, range, radius } => {
            let digest = place(place(digest.text("spot"), *position), *direction).double(*inner).double(*outer);
            optional(digest, range).double(*radius)
        }
        LightKind::Sun { direction, angle } => place(digest.text("sun"), *direction).double(*angle),
    }
}

fn sky(sky: &Sky) -> Key {
    let digest = Digest::new("sky");
    match sky {
        Sky::None => digest.text("none"),
        Sky::Constant(radiance) => digest.text("constant").vec3(*radiance),
        Sky::Gradient { zenith, horizon, ground } => digest.text("gradient").vec3(*zenith).vec3(*horizon).vec3(*ground),
        Sky::Image(SkyImage { width, height, texels, rotation, strength }) => {
            let digest = digest.text("image").number((*width).into()).number((*height).into());
            digest.slice(texels).float(*rotation).float(*strength)
        }
    }
    .done()
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::build::Builder;

    /// A group's light depends on whether what covers it shines, not on how brightly, and not on what is elsewhere.
    #[test]
    fn what_covers_a_group_is_in_its_keys() {
        let keys = |first: f32, at: f32| {
            let mut b = Builder::new("panels");
            let (one, other) = (b.emitter(Vec3::ZERO, Vec3::splat(first)), b.emitter(Vec3::ZERO, Vec3::ONE));
            b.quad("first", Vec3::new(at, 0.0, 0.0), Vec3::X, Vec3::Y, one);
            b.quad("second", Vec3::new(0.5, 0.5, 0.0), Vec3::X, Vec3::Y, other);
            let mut scene = b.build();
            let settings = Settings::default();
            let lighting = Lighting::part(&mut scene, &settings);
            let keys = Keys::new(&scene, &lighting, &settings, &Plan::new(&scene, &settings));
            lighting.groups.iter().map(|g| g.name.clone()).zip(keys.groups).collect::<BTreeMap<_, _>>()
        };
        for (at, covers) in [(0.0, true), (1.5, true), (1.6, false)] {
            let (bright, dim, dark) = (keys(8.0, at), keys(2.0, at), keys(0.0, at));
            assert_eq!((bright.len(), dark.len()), (2, 1));
            assert_eq!(bright, dim);
            let pairs = [bright["second"], dark["second"]];
            assert_eq!(pairs[0].direct != pairs[1].direct, covers, "at {at}");
            assert_eq!(pairs[0].shoot != pairs[1].shoot, covers, "at {at}");
        }
    }
}
