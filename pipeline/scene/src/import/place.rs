//! Meshes, lights and cameras of the visited nodes become the scene's.

use std::collections::BTreeMap;

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::buffers::Buffers;
use super::error::{Bound, Checked, Fault};
use super::extras::{Keys, group_name};
use super::materials::Materials;
use super::nodes::{Visit, all_worlds};
use super::notes::Notes;
use super::options::ImportOptions;
use super::transform::{MAX_COORDINATE, is_singular};
use super::{instancing, lights, pose, primitives};
use crate::{Camera, Instance, Mesh, Progress, Scene};

/// Fills a scene node by node.
pub struct Placer<'a> {
    buffers: &'a Buffers,
    options: &'a ImportOptions,
    progress: &'a dyn Progress,
    pub materials: Materials,
    pub scene: Scene,
    /// Scene meshes of each glTF mesh that was read.
    meshes: BTreeMap<usize, Vec<usize>>,
    /// Object-space boxes of the scene's meshes.
    boxes: Vec<(Vec3, Vec3)>,
    /// World transforms of all nodes, once a skin needs them.
    worlds: Option<Vec<DAffine3>>,
    triangles: u64,
}

impl<'a> Placer<'a> {
    pub fn new(buffers: &'a Buffers, options: &'a ImportOptions, progress: &'a dyn Progress) -> Self {
        Self {
            buffers,
            options,
            progress,
            materials: Materials::default(),
            scene: Scene::default(),
            meshes: BTreeMap::new(),
            boxes: Vec::new(),
            worlds: None,
            triangles: 0,
        }
    }

    /// Takes over what a node carries.
    pub fn visit(&mut self, visit: &Visit, notes: &mut Notes) -> Checked<()> {
        let document = self.buffers.document();
        if visit.hidden {
            let place = document.node_place(visit.node);
            notes.add("hidden-left-out", format!("{place}: KHR_node_visibility hides it, so it is left out"));
        }
        if visit.hidden || visit.extras.ignore {
            return Ok(());
        }
        let Some(node) = document.root.nodes.get(visit.node) else { return Ok(()) };
        if let Some(camera) = node.camera {
            self.camera(visit, camera.value(), notes);
        }
        if let Some(light) = lights::on_node(document, visit.node)? {
            if visit.animated && !self.options.bake_animated {
                self.left_out(visit, "its light is animated", notes);
            } else if let Some(light) = lights::read(document, visit, light, self.options, notes)? {
                self.scene.lights.push(light);
            }
        }
        match node.mesh {
            Some(mesh) => self.mesh(visit, node, mesh.value(), notes),
            None => Ok(()),
        }
    }

    fn left_out(&self, visit: &Visit, why: &str, notes: &mut Notes) {
        let place = self.buffers.document().node_place(visit.node);
        notes.add(
            "animated-left-out",
            format!("{place}: {why}, so it is left out; the setting `bake_animated` takes its rest pose"),
        );
    }

    fn mesh(&mut self, visit: &Visit, node: &gltf_json::Node, mesh: usize, notes: &mut Notes) -> Checked<()> {
        let document = self.buffers.document();
        let Some(source) = document.root.meshes.get(mesh) else {
            return Err(Fault::invalid(document.node_place(visit.node), format!("its mesh {mesh} does not exist")));
        };
        let morphed = source.primitives.iter().any(|p| p.targets.as_ref().is_some_and(|t| !t.is_empty()));
        if !self.options.bake_animated && (visit.animated || node.skin.is_some() || morphed) {
            let why = match node.skin {
                Some(_) => "it is skinned",
                None if visit.animated => "it or a node above it is animated",
                None => "it has morph targets",
            };
            self.left_out(visit, why, notes);
            return Ok(());
        }
        let extras = {
            let own = Keys::read(&source.extras, &document.mesh_place(mesh), notes);
            // The node's own keys win over those of its mesh, those over inherited ones.
            visit.extras.clone().with(&own).with(&visit.keys)
        };
        if extras.ignore {
            return Ok(());
        }
        let transforms = match instancing::read(self.buffers, visit.node, &self.options.limits)? {
            Some(all) => all.into_iter().enumerate().map(|(i, t)| (Some(i as u32), visit.world * t)).collect(),
            None => vec![(None, visit.world)],
        };
        let weights = node.weights.as_ref().or(source.weights.as_ref()).map_or(&[][..], Vec::as_slice);
        let posed = node.skin.is_some() || (morphed && weights.iter().any(|w| *w != 0.0));
        let meshes = match posed {
            true => self.posed(mesh, node, weights, notes)?,
            false => self.shared(mesh, notes)?,
        };
        let name = document.node_name(visit.node);
        let group = extras.group.clone().or_else(|| group_name(&name));
        let group = group.unwrap_or_else(|| document.node_place(visit.node).into());
        for (gpu_instance, world) in transforms {
            let world = if node.skin.is_some() { DAffine3::IDENTITY } else { world };
            for &mesh in &meshes {
                let instance = Instance {
                    mesh,
                    transform: world,
                    node: visit.node,
                    gpu_instance,
                    name: gpu_instance.map_or_else(|| name.clone(), |i| format!("{name} #{i}")),
                    receives: extras.receive,
                    casts: extras.cast,
                    texel_scale: extras.scale,
                    group: group.clone(),
                };
                self.place(instance, notes)?;
            }
        }
        Ok(())
    }

    /// The scene's meshes for a glTF mesh, read when it is first used.
    fn shared(&mut self, mesh: usize, notes: &mut Notes) -> Checked<Vec<usize>> {
        if let Some(known) = self.meshes.get(&mesh) {
            return Ok(known.clone());
        }
        let indices = self.read(mesh, notes)?.into_iter().map(|(_, mesh)| self.add(mesh)).collect::<Vec<_>>();
        self.meshes.insert(mesh, indices.clone());
        Ok(indices)
    }

    /// A copy of a glTF mesh in the rest pose of one node.
    fn posed(
        &mut self,
        mesh: usize,
        node: &gltf_json::Node,
        weights: &[f32],
        notes: &mut Notes,
    ) -> Checked<Vec<usize>> {
        let document = self.buffers.document();
        let joints = match node.skin {
            Some(skin) => {
                if self.worlds.is_none() {
                    self.worlds = Some(all_worlds(document)?);
                }
                Some(pose::joints(self.buffers, skin.value(), self.worlds.as_deref().unwrap_or_default())?)
            }
            None => None,
        };
        let mut indices = Vec::new();
        for (primitive, mut posed) in self.read(mesh, notes)? {
            let source = document.root.meshes.get(mesh).and_then(|m| m.primitives.get(primitive));
            if let Some(source) = source {
                pose::morph(self.buffers, source, weights, &mut posed)?;
                if let Some(joints) = &joints {
                    pose::skin(self.buffers, source, joints, &mut posed)?;
                }
                pose::finish(&mut posed, notes)?;
            }
            indices.push(self.add(posed));
        }
        Ok(indices)
    }

    /// The primitives of a glTF mesh that have triangles, with their numbers.
    fn read(&mut self, mesh: usize, notes: &mut Notes) -> Checked<Vec<(usize, Mesh)>> {
        let mut out = Vec::new();
        let Some(source) = self.buffers.document().root.meshes.get(mesh) else { return Ok(out) };
        for (index, primitive) in source.primitives.iter().enumerate() {
            self.progress.check()?;
            let material = primitive.material.map(|m| m.value());
            // The material is looked up only for what is kept, so that points do not bring textures along.
            if let Some(mut read) = primitives::read(self.buffers, (mesh, index), primitive, 0, notes)?
                && !read.triangles.is_empty()
            {
                read.material = self.materials.index(self.buffers, material, self.options, notes)?;
                out.push((index, read));
            }
        }
        Ok(out)
    }

    fn add(&mut self, mesh: Mesh) -> usize {
        let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        self.boxes.push(mesh.positions.iter().fold(start, |(lo, hi), p| (lo.min(*p), hi.max(*p))));
        self.scene.meshes.push(mesh);
        self.scene.meshes.len() - 1
    }

    /// Adds an instance within the limits; a flattening transform gets a mesh of its own.
    fn place(&mut self, mut instance: Instance, notes: &mut Notes) -> Checked<()> {
        let limits = &self.options.limits;
        let document = self.buffers.document();
        let place = || document.node_place(instance.node);
        if self.scene.instances.len() as u64 >= limits.instances {
            let what = "with it there are more placed meshes";
            return Err(Fault::limit(place(), what, Bound::Instances, limits.instances));
        }
        let known = self.scene.meshes.get(instance.mesh).zip(self.boxes.get(instance.mesh));
        let Some((mesh, bounds)) = known else { return Ok(()) };
        if let Some(corner) = outside(*bounds, &instance.transform) {
            let what = format!("it reaches to {corner:.3e}, beyond the ±{MAX_COORDINATE:e} that can be computed with");
            return Err(Fault::invalid(place(), what));
        }
        if is_singular(&instance.transform.matrix3) {
            let Some(flat) = flattened(mesh, &instance.transform.matrix3) else {
                notes.add("flat-transform", format!("{}: its transform leaves it no area; it is left out", place()));
                return Ok(());
            };
            notes.add("flat-transform", format!("{}: its transform flattens it; it is shaded flat", place()));
            self.buffers.spend((flat.positions.len() as u64).checked_mul(64), &place())?;
            instance.mesh = self.add(flat);
            instance.transform = DAffine3::from_translation(instance.transform.translation);
        }
        self.triangles += self.scene.meshes.get(instance.mesh).map_or(0, |m| m.triangles.len() as u64);
        if self.triangles > limits.triangles {
            let what = format!("with it there are {} triangles", self.triangles);
            return Err(Fault::limit(document.node_place(instance.node), what, Bound::Triangles, limits.triangles));
        }
        self.scene.instances.push(instance);
        Ok(())
    }

    fn camera(&mut self, visit: &Visit, index: usize, notes: &mut Notes) {
        let document = self.buffers.document();
        let Some(camera) = document.root.cameras.get(index) else { return };
        let place = super::error::place("camera", index, camera.name.as_deref());
        let lens = camera.perspective.as_ref().map(|p| (f64::from(p.yfov), p.aspect_ratio.map(f64::from)));
        let Some((yfov, aspect)) = lens.filter(|(yfov, _)| *yfov > 0.0 && *yfov < std::f64::consts::PI) else {
            notes
                .add("camera-left-out", format!("{place}: it has no perspective with a field of view; it is left out"));
            return;
        };
        let world = &visit.world;
        let axes = [world.matrix3.x_axis, world.matrix3.y_axis, world.matrix3.z_axis].map(DVec3::try_normalize);
        let [Some(x), Some(y), Some(z)] = axes else {
            notes.add("camera-left-out", format!("{place}: its node's transform is flat; it is left out"));
            return;
        };
        let node = document.root.nodes.get(visit.node).and_then(|n| n.name.clone());
        self.scene.cameras.push(Camera {
            name: camera.name.clone().or(node).unwrap_or(place),
            transform: DAffine3 { matrix3: DMat3::from_cols(x, y, z), translation: world.translation },
            yfov,
            aspect: aspect.filter(|a| *a > 0.0 && a.is_finite()),
        });
    }
}

/// A coordinate that cannot be computed with, if there is one: of a box's corners, before and after a transform.
fn outside((lo, hi): (Vec3, Vec3), transform: &DAffine3) -> Option<f64> {
    let worst = |p: DVec3| p.abs().max_element();
    (0..8)
        .map(|i| DVec3::from_array(std::array::from_fn(|k| f64::from(if i >> k & 1 == 0 { lo[k] } else { hi[k] }))))
        .flat_map(|corner| [worst(corner), worst(transform.transform_point3(corner))])
        .find(|w| w.is_nan() || *w > MAX_COORDINATE)
}

/// The mesh with a singular linear transform applied, without the triangles that lose their area; None if none is left.
/// Normals have no meaning any more.
fn flattened(mesh: &Mesh, matrix: &DMat3) -> Option<Mesh> {
    let positions: Vec<Vec3> = mesh.positions.iter().map(|p| (*matrix * p.as_dvec3()).as_vec3()).collect();
    let corner = |i: u32| positions.get(i as usize).map_or(DVec3::ZERO, |p| p.as_dvec3());
    // Relative to the mesh, so that rounding does not count as area.
    let size = positions.iter().fold(0.0f64, |m, p| m.max(p.as_dvec3().abs().max_element()));
    let has_area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(corner);
        !primitives::is_degenerate([a, b, c]) && (b - a).cross(c - a).length() > 1e-12 * size * size
    };
    let triangles: Vec<[u32; 3]> = mesh.triangles.iter().copied().filter(has_area).collect();
    (!triangles.is_empty()).then(|| Mesh {
        positions: positions.clone(),
        normals: Vec::new(),
        triangles,
        ..mesh.clone()
    })
}
