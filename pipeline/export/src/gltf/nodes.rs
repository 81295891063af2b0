//! Which node gets which lightmapped mesh.

use std::collections::{BTreeMap, BTreeSet};

use luxel_atlas::{Atlas, Placed};
use luxel_scene::import::Checked;
use luxel_scene::{Notice, Progress, Scene};
use serde_json::Value;

use super::{
    draft::{Draft, settle_copies},
    exposure::Pictures,
    instances,
    json::{Object, add_extra, forget_extension, item, item_mut, list, number, objects_mut, place},
    materials::{Materials, new_set},
    mismatch,
    original::Original,
    references,
    vertices::{Vertices, source_primitive},
};

/// A placed primitive, and the picture of its page that shows it.
struct Shown<'a> {
    placed: &'a Placed,
    picture: usize,
}

/// Placed primitives of one mesh in one place.
type Primitives<'a> = BTreeMap<usize, Shown<'a>>;
/// What was baked of one node: the glTF meshes that the scene says it has (one, or the file has changed), and by GPU
/// instance the primitives.
#[derive(Default)]
struct Baked<'a> {
    meshes: BTreeSet<usize>,
    by_instance: BTreeMap<Option<u32>, Primitives<'a>>,
}

/// Gives every node that holds lightmapped instances a mesh of its own.
pub struct Nodes<'a> {
    original: &'a Original,
    materials: Materials,
    several_pages: bool,
    vertices: Vertices,
    copies: Vec<(Option<usize>, Value)>,
    old_meshes: usize,
    /// Nodes whose extras are no object and could not take the page.
    unnumbered: Vec<String>,
}

impl<'a> Nodes<'a> {
    pub fn new(original: &'a Original, materials: Materials, several_pages: bool) -> Self {
        let old_meshes = list(&original.root, "meshes").len();
        Self {
            original,
            materials,
            several_pages,
            vertices: Vertices::default(),
            copies: Vec::new(),
            old_meshes,
            unnumbered: Vec::new(),
        }
    }

    /// Works through the whole scene; returns the materials for settling.
    pub fn place(
        mut self,
        draft: &mut Draft,
        scene: &Scene,
        atlas: &Atlas,
        pictures: &Pictures,
        notices: &mut Vec<Notice>,
        progress: &dyn Progress,
    ) -> Checked<Materials> {
        for (node, baked) in plan(scene, atlas, pictures)? {
            progress.check()?;
            self.place_node(draft, node, baked)?;
        }
        progress.check()?;
        // A stranger that means the old mesh may as well have the first copy: it is the same shape.
        settle_copies(&mut draft.root, "meshes", references::meshes, self.copies, BTreeSet::new())?;
        let instanced = |n: &mut Object| super::json::extension(n, instances::EXTENSION).is_some();
        if !objects_mut(&mut draft.root, "nodes").any(instanced) {
            forget_extension(&mut draft.root, instances::EXTENSION);
        }
        forget_draco(&mut draft.root);
        if !self.unnumbered.is_empty() {
            let which = self.unnumbered.join(", ");
            let message = format!("the extras of {which} are no object: extras.lightmap is missing there");
            notices.push(Notice { code: "extras-not-an-object", message });
        }
        Ok(self.materials)
    }

    fn place_node(&mut self, draft: &mut Draft, node: usize, baked: Baked) -> Checked<()> {
        let mut by_instance = baked.by_instance;
        let object = item(&self.original.root, "nodes", node)?;
        let name = place(&self.original.root, "nodes", node);
        let stranger = || mismatch(&name, "it does not hold what was baked");
        let mesh = number(object, "mesh").ok_or_else(stranger)?;
        if baked.meshes.iter().any(|m| *m != mesh) {
            return Err(stranger());
        }
        if super::json::extension(object, instances::EXTENSION).is_none() {
            let primitives = by_instance.remove(&None).filter(|_| by_instance.is_empty()).ok_or_else(stranger)?;
            return self.give(draft, node, mesh, &primitives);
        }
        let children = instances::expand(&mut draft.root, self.original, node)?;
        for (i, child) in children.into_iter().enumerate() {
            let primitives = u32::try_from(i).ok().and_then(|i| by_instance.remove(&Some(i)));
            match primitives {
                Some(primitives) => self.give(draft, child, mesh, &primitives)?,
                None => drop(item_mut(&mut draft.root, "nodes", child)?.insert("mesh".into(), mesh.into())),
            }
        }
        if by_instance.is_empty() { Ok(()) } else { Err(stranger()) }
    }

    /// Puts a copy of the mesh with lightmapped primitives into a node.
    fn give(&mut self, draft: &mut Draft, node: usize, mesh: usize, primitives: &Primitives) -> Checked<()> {
        let mut copy = item(&self.original.root, "meshes", mesh)?.clone();
        for (&index, Shown { placed, picture }) in primitives {
            let old = source_primitive(self.original, mesh, index)?;
            let moved = new_set(self.original, old)?;
            let mut new = self.vertices.primitive(draft, self.original, (mesh, index), placed, moved)?;
            self.materials.apply(self.original, &mut new, *picture, moved)?;
            if let Some(slot) = copy.get_mut("primitives").and_then(|p| p.get_mut(index)) {
                *slot = Value::Object(new);
            }
        }
        let count = copy.get("primitives").and_then(Value::as_array).map_or(0, Vec::len);
        self.copies.push((Some(mesh), Value::Object(copy)));
        let object = item_mut(&mut draft.root, "nodes", node)?;
        object.insert("mesh".into(), (self.old_meshes + self.copies.len() - 1).into());
        if self.several_pages && !add_extra(object, "lightmap", pages(primitives, count)) {
            self.unnumbered.push(place(&self.original.root, "nodes", node));
        }
        Ok(())
    }
}

/// The page of a node, or the list of its primitives' pages (null without) where they differ.
fn pages(primitives: &Primitives, count: usize) -> Value {
    let first = primitives.values().next().map(|p| p.placed.page);
    if primitives.values().all(|p| Some(p.placed.page) == first) {
        return first.into();
    }
    (0..count).map(|i| Value::from(primitives.get(&i).map(|p| p.placed.page))).collect()
}

fn plan<'a>(scene: &Scene, atlas: &'a Atlas, pictures: &Pictures) -> Checked<BTreeMap<usize, Baked<'a>>> {
    if scene.instances.len() != atlas.placed.len() {
        return Err(mismatch("atlas", "it does not belong to this scene"));
    }
    let mut plan: BTreeMap<usize, Baked> = BTreeMap::new();
    for ((instance, placed), picture) in scene.instances.iter().zip(&atlas.placed).zip(&pictures.of) {
        let Some(placed) = placed.as_ref().filter(|p| !p.triangles.is_empty()) else { continue };
        let no_page = || mismatch("atlas", &format!("it has no page {}", placed.page));
        let shown = Shown { placed, picture: picture.ok_or_else(no_page)? };
        let mesh = &scene.meshes[instance.mesh];
        let baked = plan.entry(instance.node).or_default();
        baked.meshes.insert(mesh.gltf_mesh);
        let primitives = baked.by_instance.entry(instance.gpu_instance).or_default();
        if primitives.insert(mesh.gltf_primitive, shown).is_some() {
            return Err(mismatch(&instance.name, "it is there twice"));
        }
    }
    Ok(plan)
}

/// Draco goes off the lists when no primitive uses it any more.
fn forget_draco(root: &mut Object) {
    let uses =
        |m: &mut Object| objects_mut(m, "primitives").any(|p| super::json::extension(p, references::DRACO).is_some());
    if !objects_mut(root, "meshes").any(uses) {
        forget_extension(root, references::DRACO);
    }
}
