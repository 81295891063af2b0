//! Small glTF files, a stand-in for the importer, and two ways to unwrap: shared by the tests.

use std::path::Path;

use glam::{DAffine3, Vec2, Vec3};
use luxel_atlas::{Atlas, Page, Placed};
use luxel_scene::{Instance, Mesh, Scene};
use serde_json::{Value, json};

use super::super::{
    instances,
    json::{extension, list, number},
    original::Original,
};
use crate::{Effort, Glb, Lightmap};

/// A glTF file in the making.
pub struct File {
    pub root: Value,
    pub bin: Vec<u8>,
}

impl File {
    pub fn new() -> Self {
        let root = json!({
            "asset": {"version": "2.0", "generator": "hand"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [],
            "meshes": [], "materials": [], "accessors": [], "bufferViews": []
        });
        Self { root, bin: Vec::new() }
    }

    pub fn push(&mut self, key: &str, value: Value) -> usize {
        if self.root.get(key).is_none() {
            self.root[key] = json!([]);
        }
        let items = self.root[key].as_array_mut().unwrap();
        items.push(value);
        items.len() - 1
    }

    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let at = self.bin.len();
        self.bin.extend(bytes);
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": at, "byteLength": bytes.len()}))
    }

    pub fn floats(&mut self, kind: &str, values: &[f32]) -> usize {
        let components = ["SCALAR", "VEC2", "VEC3", "VEC4"].iter().position(|k| *k == kind).unwrap() + 1;
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let mut accessor =
            json!({"bufferView": view, "componentType": 5126, "count": values.len() / components, "type": kind});
        if kind == "VEC3" {
            let column = |c: usize| values.iter().skip(c).step_by(3).copied();
            accessor["min"] = (0..3).map(|c| column(c).fold(f32::INFINITY, f32::min)).collect::<Vec<_>>().into();
            accessor["max"] = (0..3).map(|c| column(c).fold(f32::NEG_INFINITY, f32::max)).collect::<Vec<_>>().into();
        }
        self.push("accessors", accessor)
    }

    pub fn indices(&mut self, values: &[u16]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&bytes);
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": 5123, "count": values.len(), "type": "SCALAR"}),
        )
    }

    /// A primitive of two triangles that share an edge, with normals and TEXCOORD_0.
    pub fn quad(&mut self, x: f32) -> Value {
        let position = self.floats("VEC3", &[x, 0., 0., x + 1., 0., 0., x + 1., 1., 0., x, 1., 0.]);
        let normal = self.floats("VEC3", &[0., 0., 1.].repeat(4));
        let uv = self.floats("VEC2", &[0., 0., 1., 0., 1., 1., 0., 1.]);
        let indices = self.indices(&[0, 1, 2, 0, 2, 3]);
        json!({"attributes": {"POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv}, "indices": indices})
    }

    pub fn node(&mut self, node: Value) -> usize {
        let index = self.push("nodes", node);
        self.root["scenes"][0]["nodes"].as_array_mut().unwrap().push(index.into());
        index
    }

    pub fn write_glb(&self, path: &Path) {
        let mut root = self.root.clone();
        root["buffers"] = json!([{"byteLength": self.bin.len()}]);
        let bytes =
            super::super::glb_bytes(serde_json::to_vec(&root).unwrap(), &self.bin, &luxel_scene::Silent).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    /// Writes it as .glb into a folder of its own and reads it.
    pub fn read(&self) -> Original {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("level.glb");
        self.write_glb(&path);
        Original::read(&path).unwrap()
    }
}

/// Reads a finished .glb back.
pub fn reread(glb: &Glb) -> Original {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("out.glb");
    std::fs::write(&path, &glb.bytes).unwrap();
    Original::read(&path).unwrap()
}

/// Vertex indices of a primitive's triangles, strips and fans unrolled; empty for points and lines.
pub fn triangles(original: &Original, primitive: &Value) -> Vec<[u32; 3]> {
    let primitive = primitive.as_object().unwrap();
    let Some(position) = primitive.get("attributes").and_then(|a| number(a.as_object()?, "POSITION")) else {
        return Vec::new();
    };
    let list: Vec<u32> = match number(primitive, "indices") {
        Some(indices) => {
            let e = original.elements(indices).unwrap();
            (0..e.count).map(|i| e.number(i, 0).unwrap() as u32).collect()
        }
        None => (0..original.elements(position).unwrap().count as u32).collect(),
    };
    match number(primitive, "mode").unwrap_or(4) {
        4 => list.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        5 => (2..list.len())
            .map(|i| if i % 2 == 0 { [i - 2, i - 1, i] } else { [i - 1, i - 2, i] })
            .map(|t| t.map(|k| list[k]))
            .collect(),
        6 => (2..list.len()).map(|i| [list[0], list[i - 1], list[i]]).collect(),
        _ => Vec::new(),
    }
}

/// What a bake would know of the file: one instance per node and primitive, no transforms, no materials.
pub fn import(original: &Original) -> Scene {
    let mut scene = Scene::default();
    for (m, mesh) in list(&original.root, "meshes").iter().enumerate() {
        for (p, primitive) in mesh["primitives"].as_array().unwrap().iter().enumerate() {
            let triangles = triangles(original, primitive);
            let mesh = Mesh { gltf_mesh: m, gltf_primitive: p, triangles, ..Mesh::default() };
            scene.meshes.push(mesh);
        }
    }
    for (n, node) in list(&original.root, "nodes").iter().enumerate() {
        let Some(mesh) = node.get("mesh").and_then(Value::as_u64) else { continue };
        let attributes = extension(node.as_object().unwrap(), instances::EXTENSION).map(|e| e["attributes"].clone());
        let copies = attributes.map(|a| {
            let first = a.as_object().unwrap().values().next().unwrap().as_u64().unwrap() as usize;
            original.elements(first).unwrap().count as u32
        });
        for k in copies.map_or(vec![None], |n| (0..n).map(Some).collect()) {
            for i in 0..scene.meshes.len() {
                if scene.meshes[i].gltf_mesh == mesh as usize {
                    let name = format!("node {n} instance {k:?} primitive {i}");
                    scene.instances.push(Instance {
                        mesh: i,
                        transform: DAffine3::IDENTITY,
                        node: n,
                        gpu_instance: k,
                        name,
                        receives: true,
                        casts: true,
                        texel_scale: 1.0,
                        group: "group".into(),
                    });
                }
            }
        }
    }
    scene
}

/// Every triangle becomes a chart of its own; instance i lies on page i mod `pages`.
pub fn split(scene: &Scene, pages: u32) -> Atlas {
    unwrap(scene, pages, |mesh| {
        let source: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
        let triangles = (0..mesh.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        (source, triangles)
    })
}

/// No vertex is split.
pub fn whole(scene: &Scene, pages: u32) -> Atlas {
    unwrap(scene, pages, |mesh| {
        let count = mesh.triangles.iter().flatten().max().map_or(0, |m| m + 1);
        ((0..count).collect(), mesh.triangles.clone())
    })
}

fn unwrap(scene: &Scene, pages: u32, seams: impl Fn(&Mesh) -> (Vec<u32>, Vec<[u32; 3]>)) -> Atlas {
    let placed = scene.instances.iter().enumerate().map(|(i, instance)| {
        let mesh = &scene.meshes[instance.mesh];
        let (source, triangles) = seams(mesh);
        let n = source.len();
        let uvs = (0..n).map(|k| Vec2::new(k as f32 / n as f32, (i % 7) as f32 / 7.0)).collect();
        let placed = Placed { page: i as u32 % pages, source, uvs, triangles };
        (instance.receives && !placed.triangles.is_empty()).then_some(placed)
    });
    let placed = placed.collect();
    Atlas { pages: vec![Page { width: 4, height: 4 }; pages as usize], placed, ..Atlas::default() }
}

pub fn lightmaps(pages: u32) -> Vec<Lightmap> {
    let page = |p: u32| {
        let e = (0..16).map(|i| Vec3::new(i as f32, 1.0, p as f32)).collect();
        Lightmap::new(4, 4, e, vec![1.0; 16]).unwrap()
    };
    (0..pages).map(page).collect()
}

pub fn names(pages: u32) -> Vec<String> {
    (0..pages).map(|p| format!("level.lightmap.{p}.exr")).collect()
}

/// Bakes the file with a given atlas.
pub fn bake(original: &Original, scene: &Scene, atlas: &Atlas) -> Glb {
    let pages = atlas.pages.len() as u32;
    original.lightmapped(scene, atlas, &lightmaps(pages), &names(pages), Effort::Small, &luxel_scene::Silent).unwrap()
}

/// Raw elements of an accessor.
pub fn raw(original: &Original, accessor: usize) -> Vec<Vec<u8>> {
    let e = original.elements(accessor).unwrap();
    (0..e.count).map(|i| e.get(i).unwrap().to_vec()).collect()
}
