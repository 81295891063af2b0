//! A small level that can be edited in every way that a bake may notice, written as `level.gltf` with its files.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

/// The name of the scene's file.
pub const SCENE: &str = "level.gltf";

/// A glTF mesh: a box seen from outside, or one quad in its plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    pub size: [f32; 3],
    pub is_quad: bool,
    /// Of its primitives, of which a box has one or two.
    pub materials: Vec<usize>,
    pub normals: bool,
    /// Seed of vertex colours.
    pub colors: Option<u32>,
    /// It brings a lightmap layout of its own.
    pub has_layout: bool,
    /// Only this one of its primitives is there.
    pub part: Option<usize>,
}

impl Shape {
    pub fn cuboid(size: [f32; 3], materials: &[usize]) -> Self {
        let materials = materials.to_vec();
        Self { size, is_quad: false, materials, normals: true, colors: None, has_layout: false, part: None }
    }

    /// A quad about its origin that looks along +Z.
    pub fn quad(size: [f32; 2], material: usize) -> Self {
        Self { is_quad: true, ..Self::cuboid([size[0], size[1], 0.0], &[material]) }
    }
}

/// The level. What has no form of its own here is glTF as it is written.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    pub shapes: Vec<Shape>,
    pub nodes: Vec<Value>,
    pub materials: Vec<Value>,
    pub lights: Vec<Value>,
    /// Seeds of images of 4×4 texels. Texture 3·i + w is image i, wrapped in the way w.
    pub images: Vec<u32>,
    /// Seed of the sky's image.
    pub sky: u32,
    pub camera: Option<Value>,
    /// The name of a node that moves, if there is one of it.
    pub animated: &'static str,
    /// Lines of `luxel.toml`.
    pub settings: BTreeMap<&'static str, String>,
}

/// A grey or coloured material.
pub fn matte(color: [f32; 3]) -> Value {
    let [r, g, b] = color;
    json!({ "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0 } })
}

/// A node with a mesh.
pub fn object(name: &str, mesh: usize, at: [f64; 3]) -> Value {
    json!({ "name": name, "mesh": mesh, "translation": at })
}

/// A node with a light.
pub fn lamp(name: &str, light: usize, at: [f64; 3]) -> Value {
    json!({ "name": name, "translation": at, "extensions": { "KHR_lights_punctual": { "light": light } } })
}

const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A rotation that turns a quad up and a light down.
const LYING: [f64; 4] = [-HALF, 0.0, 0.0, HALF];

/// A rotation that turns a quad down.
const HANGING: [f64; 4] = [HALF, 0.0, 0.0, HALF];

impl Level {
    /// A corner of a room with two crates of one mesh, a glowing panel, a bulb and a spot, each a light group.
    pub fn new() -> Self {
        let mut panel = object("panel", 2, [0.9, 1.9, 0.2]);
        panel["rotation"] = json!(HANGING);
        let mut floor = object("floor", 0, [0.0, 0.0, 0.0]);
        floor["rotation"] = json!(LYING);
        let mut spot = lamp("spot", 1, [-0.8, 1.8, 0.6]);
        spot["rotation"] = json!(LYING);
        let settings: BTreeMap<&'static str, String> = [
            ("preset", "\"draft\""),
            ("size", "32"),
            ("voxels", "300"),
            // Enough for later bounces to have fewer.
            ("directions", "64"),
            ("shadow_samples", "4"),
            ("sky_rays", "16"),
            ("gather_rays", "16"),
            ("near_rays", "4"),
            ("cut_limit", "40"),
            ("sky", "\"none\""),
        ]
        .map(|(name, value)| (name, value.to_owned()))
        .into();
        let mut glow = matte([0.5, 0.5, 0.5]);
        glow["emissiveFactor"] = json!([1.0, 0.8, 0.5]);
        glow["extensions"] = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": 12.0 } });
        let mut painted = matte([0.9, 0.8, 0.7]);
        painted["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
        Self {
            shapes: vec![
                Shape::quad([4.0, 4.0], 0),
                Shape::quad([4.0, 2.0], 1),
                Shape::quad([0.6, 0.4], 2),
                Shape::cuboid([0.5, 0.6, 0.5], &[3]),
            ],
            nodes: vec![
                floor,
                object("wall", 1, [0.0, 1.0, -2.0]),
                panel,
                object("crate", 3, [-0.7, 0.3, -0.5]),
                object("crate.001", 3, [0.4, 0.31, -0.9]),
                lamp("bulb", 0, [0.3, 1.2, 0.8]),
                spot,
            ],
            materials: vec![matte([0.7, 0.7, 0.65]), painted, glow, matte([0.6, 0.3, 0.2])],
            lights: vec![
                json!({ "name": "bulb", "type": "point", "color": [1.0, 0.9, 0.7], "intensity": 40.0 }),
                json!({
                    "name": "spot", "type": "spot", "intensity": 60.0,
                    "spot": { "innerConeAngle": 0.3, "outerConeAngle": 0.7 },
                }),
            ],
            images: vec![1, 2],
            sky: 1,
            // A wide strip from afar: else the picture would be the larger part of such a bake.
            camera: Some(json!({ "at": [0.0, 1.0, 9.0], "aspect": 10.0 })),
            animated: "fan",
            settings,
        }
    }

    /// The same with nearly everything that a bake can read: noise that depends on names, groups of several lights, a
    /// sky that shares one, holes, veils, textures in all their uses, layouts of its own.
    pub fn rich() -> Self {
        let mut level = Self::new();
        for (setting, value) in [
            ("gather", "\"final\""),
            ("node_spacing", "1"),
            ("refresh", "4"),
            ("double_sided", "\"average\""),
            ("sky", "\"sky.exr\""),
            ("lamp_radius", "0.1"),
            ("sun_angle", "3"),
        ] {
            level.set(setting, value);
        }
        let reference = |index: usize| json!({ "index": index });
        let mut leaves = matte([0.4, 0.8, 0.3]);
        leaves["pbrMetallicRoughness"]["baseColorTexture"] = reference(4);
        leaves["alphaMode"] = json!("MASK");
        leaves["doubleSided"] = json!(true);
        let mut glass = matte([0.9, 0.6, 0.6]);
        glass["extensions"] = json!({ "KHR_materials_transmission": { "transmissionFactor": 0.6 } });
        let mut screen = matte([0.1, 0.1, 0.1]);
        screen["emissiveFactor"] = json!([3.0, 3.0, 3.0].map(|x| x / 3.0));
        screen["emissiveTexture"] = reference(5);
        let mut metal = matte([0.8, 0.8, 0.3]);
        metal["pbrMetallicRoughness"]["metallicFactor"] = json!(0.7);
        metal["pbrMetallicRoughness"]["metallicRoughnessTexture"] = reference(1);
        level.materials.extend([leaves, glass, screen, metal]);
        let turned = json!({ "offset": [0.25, 0.125], "rotation": 0.5, "scale": [1.5, 0.5] });
        level.materials[1]["pbrMetallicRoughness"]["baseColorTexture"] =
            json!({ "index": 1, "extensions": { "KHR_texture_transform": turned } });
        let chest = |part| Shape { has_layout: true, part, ..Shape::cuboid([0.4, 0.3, 0.3], &[3, 7]) };
        let colored = Shape { colors: Some(3), ..Shape::cuboid([0.3, 0.3, 0.3], &[0]) };
        level.shapes.extend([
            Shape::quad([0.8, 0.8], 4),
            Shape::quad([0.7, 0.7], 5),
            Shape::quad([0.5, 0.5], 6),
            chest(None),
            colored,
            chest(Some(0)),
            chest(Some(1)),
        ]);
        level.lights.push(json!({ "name": "bulb", "type": "point", "intensity": 11.0 }));
        level.lights.push(json!({ "name": "sun", "type": "directional", "intensity": 2.0 }));
        let in_group = |mut node: Value, group: &str| {
            node["extras"] = json!({ "luxel_group": group });
            node
        };
        let mut sun = in_group(lamp("sun", 3, [0.0, 3.0, 0.0]), "sky");
        sun["rotation"] = json!(LYING);
        level.nodes.extend([
            object("leaves", 4, [0.2, 0.9, 0.1]),
            object("glass", 5, [-0.3, 0.8, 0.7]),
            object("screen", 6, [1.1, 0.6, -1.4]),
            object("chest", 7, [1.0, 0.2, 0.4]),
            object("ball", 8, [-1.3, 0.2, 0.9]),
            lamp("second", 2, [-1.0, 1.1, -1.0]),
            sun,
            object("fan", 3, [0.3, 1.3, 0.4]),
        ]);
        for name in ["bulb", "spot"] {
            level.node(name)["extras"] = json!({ "luxel_group": "lamps" });
        }
        level
    }

    /// The node of this name.
    pub fn node(&mut self, name: &str) -> &mut Value {
        self.nodes.iter_mut().find(|n| n["name"] == name).expect("there is such a node")
    }

    pub fn set(&mut self, setting: &'static str, value: &str) {
        self.settings.insert(setting, value.into());
    }

    /// Writes all files of the level; those that are the same keep their time.
    pub fn write(&self, folder: &Path) -> PathBuf {
        let mut bin = Bin::default();
        let meshes: Vec<Value> = self.shapes.iter().map(|shape| bin.mesh(shape)).collect();
        let mut nodes = self.nodes.clone();
        let mut document = json!({
            "asset": { "version": "2.0" },
            "extensionsUsed": [
                "KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_materials_transmission",
                "KHR_materials_unlit", "KHR_texture_transform",
            ],
            "scene": 0,
            "meshes": meshes,
            "materials": self.materials,
        });
        if let Some(camera) = &self.camera {
            nodes.push(json!({ "name": "eye", "translation": camera["at"], "camera": 0 }));
            let lens = json!({ "yfov": 0.4, "znear": 0.01, "aspectRatio": camera["aspect"] });
            document["cameras"] = json!([{ "type": "perspective", "perspective": lens }]);
        }
        // Children are found by their parents alone.
        let is_root =
            |i: &usize| !nodes.iter().any(|n| n["children"].as_array().is_some_and(|c| c.contains(&json!(i))));
        let roots: Vec<usize> = (0..nodes.len()).filter(is_root).collect();
        document["scenes"] = json!([{ "nodes": roots }]);
        if let Some(node) = nodes.iter().position(|n| n["name"] == self.animated) {
            let [input, output] =
                [vec![vec![0.0], vec![1.0]], vec![vec![0.0; 3], vec![1.0; 3]]].map(|v| bin.floats(&v));
            let target = json!({ "node": node, "path": "translation" });
            document["animations"] = json!([{
                "samplers": [{ "input": input, "output": output }],
                "channels": [{ "sampler": 0, "target": target }],
            }]);
        }
        document["nodes"] = json!(nodes);
        if !self.lights.is_empty() {
            document["extensions"] = json!({ "KHR_lights_punctual": { "lights": self.lights } });
        }
        let texture = |i: usize| json!({ "source": i / 3, "sampler": i % 3 });
        document["textures"] = json!((0..3 * self.images.len()).map(texture).collect::<Vec<_>>());
        document["samplers"] = json!([10497, 33648, 33071].map(|wrap| json!({ "wrapS": wrap, "wrapT": wrap })));
        document["images"] =
            json!((0..self.images.len()).map(|i| json!({ "uri": format!("image{i}.png") })).collect::<Vec<_>>());
        document["accessors"] = json!(bin.accessors);
        document["bufferViews"] = json!(bin.views);
        document["buffers"] = json!([{ "uri": "level.bin", "byteLength": bin.bytes.len() }]);

        fs::create_dir_all(folder).unwrap();
        for (i, seed) in self.images.iter().enumerate() {
            put(&folder.join(format!("image{i}.png")), &picture(*seed));
        }
        if self.settings.get("sky").is_some_and(|sky| sky.contains(".exr")) {
            let path = folder.join("sky.exr");
            let seed = self.sky;
            let texel = move |x: usize, y: usize| {
                let value = |i: u32| f32::from(noise(seed, (y * 8 + x) as u32 * 3 + i)) / 64.0;
                (value(0), value(1), value(2))
            };
            exr::prelude::write_rgb_file(path, 8, 4, texel).unwrap();
        }
        let lines: String = self.settings.iter().map(|(name, value)| format!("{name} = {value}\n")).collect();
        put(&folder.join("luxel.toml"), lines.as_bytes());
        put(&folder.join("level.bin"), &bin.bytes);
        let path = folder.join(SCENE);
        put(&path, document.to_string().as_bytes());
        path
    }
}

fn put(path: &Path, bytes: &[u8]) {
    if fs::read(path).ok().as_deref() != Some(bytes) {
        fs::write(path, bytes).unwrap();
    }
}

/// A stable byte.
fn noise(seed: u32, at: u32) -> u8 {
    let mut x = u64::from(seed) << 32 | u64::from(at);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (x >> 40) as u8
}

/// An image with colours and holes.
fn picture(seed: u32) -> Vec<u8> {
    let texel = |x: u32, y: u32| image::Rgba([0, 1, 2, 3].map(|band| noise(seed, (y * 4 + x) * 4 + band)));
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_fn(4, 4, texel).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// The buffer of a level while it is put together.
#[derive(Default)]
struct Bin {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Bin {
    fn mesh(&mut self, shape: &Shape) -> Value {
        let sides: Vec<usize> = if shape.is_quad { vec![0] } else { (0..6).collect() };
        let count = shape.materials.len().min(sides.len());
        let parts = sides.chunks(sides.len().div_ceil(count)).zip(&shape.materials).enumerate();
        let parts = parts.filter(|(number, _)| shape.part.is_none_or(|part| part == *number));
        let primitives: Vec<Value> =
            parts.map(|(_, (sides, material))| self.primitive(shape, sides, *material)).collect();
        json!({ "primitives": primitives })
    }

    fn primitive(&mut self, shape: &Shape, sides: &[usize], material: usize) -> Value {
        let (mut positions, mut normals, mut uvs, mut layout) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut triangles: Vec<u16> = Vec::new();
        for &side in sides {
            let first = positions.len() as u16;
            for [u, v] in [[0.0f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
                let (p, n) = corner(shape, side, u, v);
                positions.push(p.to_vec());
                normals.push(n.to_vec());
                uvs.push(vec![u, v]);
                let cell = [(side % 3) as f32, (side / 3) as f32];
                layout.push(vec![(cell[0] + 0.1 + 0.8 * u) / 3.0, (cell[1] + 0.1 + 0.8 * v) / 2.0]);
            }
            triangles.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
        }
        let count = positions.len();
        let mut attributes = json!({ "POSITION": self.floats(&positions), "TEXCOORD_0": self.floats(&uvs) });
        if shape.normals {
            attributes["NORMAL"] = self.floats(&normals);
        }
        if shape.has_layout {
            attributes["TEXCOORD_1"] = self.floats(&layout);
        }
        if let Some(seed) = shape.colors {
            let band = |at: usize| f32::from(noise(seed, at as u32)) / 255.0;
            let colors: Vec<Vec<f32>> = (0..count).map(|i| (0..4).map(|b| band(4 * i + b)).collect()).collect();
            attributes["COLOR_0"] = self.floats(&colors);
        }
        let bytes: Vec<u8> = triangles.iter().flat_map(|i| i.to_le_bytes()).collect();
        let view = self.view(&bytes);
        self.accessors
            .push(json!({ "bufferView": view, "componentType": 5123, "count": triangles.len(), "type": "SCALAR" }));
        json!({ "attributes": attributes, "indices": self.accessors.len() - 1, "material": material })
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() }));
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }

    /// An accessor of vectors.
    fn floats(&mut self, items: &[Vec<f32>]) -> Value {
        let bytes: Vec<u8> = items.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let width = items[0].len();
        let kind = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][width];
        let edge = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
            (0..width).map(|k| items.iter().map(|item| item[k]).reduce(pick).unwrap()).collect()
        };
        self.accessors.push(json!({
            "bufferView": view, "componentType": 5126, "count": items.len(), "type": kind,
            "min": edge(f32::min), "max": edge(f32::max),
        }));
        json!(self.accessors.len() - 1)
    }
}

/// A corner of a side of a shape, and the normal there.
fn corner(shape: &Shape, side: usize, u: f32, v: f32) -> ([f32; 3], [f32; 3]) {
    let [x, y, z] = shape.size;
    if shape.is_quad {
        return ([(u - 0.5) * x, (v - 0.5) * y, 0.0], [0.0, 0.0, 1.0]);
    }
    let (axis, sign) = (side / 2, if side.is_multiple_of(2) { 1.0f32 } else { -1.0 });
    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
    let size = [x, y, z];
    let (mut p, mut n) = ([0.0; 3], [0.0; 3]);
    p[axis] = sign * 0.5 * size[axis];
    p[j] = sign * (u - 0.5) * size[j];
    p[k] = (v - 0.5) * size[k];
    n[axis] = sign;
    (p, n)
}
