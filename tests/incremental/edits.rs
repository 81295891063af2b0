//! Random edits of a level, each told in words, from a seed and nothing else.

use serde_json::{Value, json};

use crate::level::{Level, Shape, lamp, object};

/// SplitMix64.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Evenly in 0..n.
    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    pub fn one<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        &of[self.below(of.len())]
    }

    /// Between two numbers, in hundredths of their distance.
    fn number(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.below(101) as f64 / 100.0
    }

    fn color(&mut self) -> [f32; 3] {
        [0; 3].map(|_| self.number(0.0, 0.9) as f32)
    }

    fn place(&mut self) -> [f64; 3] {
        [self.number(-1.6, 1.6), self.number(0.2, 1.7), self.number(-1.6, 1.6)]
    }

    /// A unit quaternion of a turn about an axis of the world, with three digits.
    fn rotation(&mut self) -> [f64; 4] {
        let half = self.number(-1.5, 1.5);
        let mut q = [0.0, 0.0, 0.0, libm::cos(half)];
        q[self.below(3)] = libm::sin(half);
        q
    }
}

/// Names that nodes are given: some twice, so that lights meet in groups and are told apart by their order.
const NAMES: [&str; 6] = ["bulb", "spot", "lamp", "lamp.001", "sky", "crate"];

/// Changes one thing; says what.
pub fn edit(level: &mut Level, random: &mut Random) -> String {
    match random.below(10) {
        0 => add(level, random),
        1 => remove(level, random),
        2 | 3 => change_node(level, random),
        4 => change_shape(level, random),
        5 | 6 => change_material(level, random),
        7 => change_light(level, random),
        8 => change_image(level, random),
        _ => change_setting(level, random),
    }
}

fn add(level: &mut Level, random: &mut Random) -> String {
    let name = *random.one(&NAMES);
    if random.below(2) == 0 {
        let kinds = [
            json!({ "type": "point", "intensity": 30.0 }),
            json!({ "type": "spot", "intensity": 50.0, "spot": { "outerConeAngle": 0.6 } }),
            json!({ "type": "directional", "intensity": 3.0 }),
        ];
        level.lights.push(random.one(&kinds).clone());
        let mut node = lamp(name, level.lights.len() - 1, random.place());
        node["rotation"] = json!(random.rotation());
        level.nodes.push(node);
        return format!("adds a light {name}");
    }
    if random.below(2) == 0 {
        let size = [0; 3].map(|_| random.number(0.2, 0.7) as f32);
        let mut shape =
            Shape::cuboid(size, &[random.below(level.materials.len()), random.below(level.materials.len())]);
        shape.materials.truncate(1 + random.below(2));
        shape.is_quad = random.below(3) == 0;
        shape.has_layout = random.below(2) == 0;
        level.shapes.push(shape);
    }
    let mesh = random.below(level.shapes.len());
    let mut node = object(name, mesh, random.place());
    node["rotation"] = json!(random.rotation());
    match random.below(3) {
        0 => level.nodes.insert(0, node),
        _ => level.nodes.push(node),
    }
    let is_first = level.nodes[0]["name"] == name;
    if is_first {
        // Children are named by their numbers.
        for node in &mut level.nodes {
            if let Some(children) = node["children"].as_array_mut() {
                children.iter_mut().for_each(|c| *c = json!(c.as_u64().unwrap() + 1));
            }
        }
    }
    format!("adds mesh {mesh} as {name}")
}

fn remove(level: &mut Level, random: &mut Random) -> String {
    // The floor stays.
    let at = 1 + random.below(level.nodes.len() - 1);
    let is_tree = level.nodes.iter().any(|n| n.get("children").is_some());
    if is_tree || level.nodes.len() < 5 {
        level.nodes[at]["extras"] = json!({ "luxel_ignore": true });
        return format!("ignores {}", level.nodes[at]["name"]);
    }
    let gone = level.nodes.remove(at);
    format!("removes {}", gone["name"])
}

fn change_node(level: &mut Level, random: &mut Random) -> String {
    let at = random.below(level.nodes.len());
    let other = random.below(level.nodes.len());
    let what = match random.below(9) {
        0 | 1 => {
            level.nodes[at]["translation"] = json!(random.place());
            "moves".to_owned()
        }
        2 => {
            level.nodes[at]["rotation"] = json!(random.rotation());
            "turns".into()
        }
        3 => {
            let scale =
                *random.one(&[[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [0.5, 1.0, 1.5], [2.0, 2.0, 2.0], [1.0, 0.0, 1.0]]);
            level.nodes[at]["scale"] = json!(scale);
            format!("scales by {scale:?}")
        }
        4 => {
            let name = *random.one(&NAMES);
            level.nodes[at]["name"] = json!(name);
            format!("calls {name}")
        }
        5 if level.nodes.iter().all(|n| n.get("children").is_none()) => {
            level.nodes.swap(at, other);
            format!("swaps with node {other}")
        }
        6 if at != other && level.nodes.iter().all(|n| n.get("children").is_none()) => {
            level.nodes[other]["children"] = json!([at]);
            format!("puts below node {other}")
        }
        _ => {
            let choice = [
                json!({ "luxel_receive": false }),
                json!({ "luxel_cast": false }),
                json!({ "luxel_scale": 2.0 }),
                json!({ "luxel_ignore": true }),
                json!({ "luxel_group": "lamps" }),
                json!({ "luxel_group": "lamps" }),
                json!({ "luxel_group": "sky" }),
                json!({ "luxel_radius": 0.1, "luxel_angle": 4 }),
                json!({}),
                json!({}),
            ];
            let extras = random.one(&choice);
            level.nodes[at]["extras"] = extras.clone();
            format!("gives {extras} to")
        }
    };
    format!("{what} node {at} {}", level.nodes[at]["name"])
}

fn change_shape(level: &mut Level, random: &mut Random) -> String {
    let at = random.below(level.shapes.len());
    let material = random.below(level.materials.len());
    let shape = &mut level.shapes[at];
    match random.below(6) {
        0 => {
            let axis = random.below(2);
            shape.size[axis] = random.number(0.3, 2.0) as f32;
            format!("another size of mesh {at}")
        }
        1 => {
            shape.normals = !shape.normals;
            format!("normals of mesh {at}")
        }
        2 => {
            shape.colors = (random.below(3) > 0).then(|| random.below(5) as u32);
            format!("vertex colours {:?} of mesh {at}", shape.colors)
        }
        3 => {
            shape.has_layout = !shape.has_layout;
            format!("lightmap layout of mesh {at}")
        }
        4 => {
            let part = random.below(shape.materials.len());
            shape.materials[part] = material;
            format!("material {material} for part {part} of mesh {at}")
        }
        _ => {
            shape.materials =
                if shape.materials.len() == 1 { vec![shape.materials[0], material] } else { vec![material] };
            format!("materials {:?} for mesh {at}", shape.materials)
        }
    }
}

/// A reference to one of the textures.
fn texture(level: &Level, random: &mut Random) -> Value {
    let mut reference = json!({ "index": random.below(3 * level.images.len()) });
    if random.below(4) == 0 {
        reference["texCoord"] = json!(1);
    }
    if random.below(2) == 0 {
        let transform = json!({ "offset": [random.number(0.0, 1.0), 0.25], "rotation": random.number(0.0, 3.0), "scale": [2.0, 0.5] });
        reference["extensions"] = json!({ "KHR_texture_transform": transform });
    }
    reference
}

fn change_material(level: &mut Level, random: &mut Random) -> String {
    let at = random.below(level.materials.len());
    let (reference, color) = (texture(level, random), random.color());
    let is_on = random.below(3) > 0;
    let material = &mut level.materials[at];
    let what = match random.below(12) {
        0 => {
            let [r, g, b] = color;
            material["pbrMetallicRoughness"]["baseColorFactor"] = json!([r, g, b, random.number(0.2, 1.0)]);
            "colour".to_owned()
        }
        1 => {
            let pbr = material["pbrMetallicRoughness"].as_object_mut().unwrap();
            pbr.remove("baseColorTexture");
            if is_on {
                pbr.insert("baseColorTexture".into(), reference.clone());
            }
            format!("texture {is_on} {reference}")
        }
        2 => {
            material["pbrMetallicRoughness"]["metallicFactor"] = json!(random.number(0.0, 1.0));
            material["pbrMetallicRoughness"]["roughnessFactor"] = json!(random.number(0.0, 1.0));
            "metal".into()
        }
        3 => {
            material["pbrMetallicRoughness"]["metallicRoughnessTexture"] = reference.clone();
            format!("texture of metal {reference}")
        }
        4 => {
            let mode = *random.one(&["OPAQUE", "MASK", "BLEND"]);
            material["alphaMode"] = json!(mode);
            mode.into()
        }
        5 => {
            material["alphaMode"] = json!("MASK");
            material["alphaCutoff"] = json!(random.number(0.1, 0.9));
            "cut-off".into()
        }
        6 => {
            material["doubleSided"] = json!(is_on);
            format!("double-sided {is_on}")
        }
        7 | 8 => {
            material["emissiveFactor"] = json!(if is_on { color } else { [0.0; 3] });
            let strength = random.number(1.0, 20.0);
            material["extensions"] = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": strength } });
            format!("shines {is_on}")
        }
        9 => {
            material["emissiveTexture"] = reference.clone();
            format!("texture of light {reference}")
        }
        10 => {
            material["extensions"] = if is_on {
                json!({ "KHR_materials_transmission": { "transmissionFactor": random.number(0.0, 1.0), "transmissionTexture": reference } })
            } else {
                json!({})
            };
            format!("transmission {is_on}")
        }
        _ => {
            let is_unlit = random.below(2) == 0;
            material["extensions"] = if is_unlit { json!({ "KHR_materials_unlit": {} }) } else { json!({}) };
            format!("unlit {is_unlit}")
        }
    };
    format!("material {at}: {what}")
}

fn change_light(level: &mut Level, random: &mut Random) -> String {
    let at = random.below(level.lights.len());
    let color = random.color();
    let light = &mut level.lights[at];
    let what = match random.below(6) {
        0 => {
            light["color"] = json!(color);
            "colour"
        }
        1 => {
            light["intensity"] = json!(*random.one(&[0.0, 3.0, 17.5, 80.0]));
            "strength"
        }
        2 => {
            light["range"] = json!(random.number(0.5, 6.0));
            "range"
        }
        3 if light["type"] == "spot" => {
            light["spot"] =
                json!({ "innerConeAngle": random.number(0.0, 0.2), "outerConeAngle": random.number(0.3, 1.2) });
            "cone"
        }
        4 => {
            light["extras"] =
                json!({ "luxel_radius": random.number(0.0, 0.2), "luxel_angle": random.number(0.0, 9.0) });
            "softness"
        }
        _ => {
            light["extras"] = json!({ "luxel_group": *random.one(&["lamps", "sky", "panel"]) });
            "group"
        }
    };
    format!("light {at}: {what}")
}

fn change_image(level: &mut Level, random: &mut Random) -> String {
    match random.below(4) {
        0 => {
            level.sky = random.below(9) as u32;
            format!("sky image {}", level.sky)
        }
        1 => {
            level.camera = Some(json!({ "at": [random.number(-1.0, 1.0), 1.0, 9.0], "aspect": 10.0 }));
            "another view".into()
        }
        2 => {
            level.images.swap(0, 1);
            "swaps the images".into()
        }
        _ => {
            let at = random.below(level.images.len());
            level.images[at] = random.below(9) as u32;
            format!("image {at} is {}", level.images[at])
        }
    }
}

/// Settings with values, all cheap.
pub const SETTINGS: [(&str, &[&str]); 37] = [
    ("preset", &["\"draft\"", "\"medium\""]),
    ("size", &["32", "48"]),
    ("texel_density", &["\"auto\"", "6"]),
    ("padding", &["2", "3", "4"]),
    ("only", &["\"all\"", "\"direct\"", "\"indirect\""]),
    ("double_sided", &["\"front\"", "\"average\"", "\"max\""]),
    ("bound", &["true", "false"]),
    ("sky", &["\"none\"", "\"1,1,2\"", "\"2,2,3/1,1,1/0.2,0.1,0\"", "\"sky.exr\"", "\"sky.exr\""]),
    ("sky", &["\"none\"", "\"0,1,0\"", "\"0,0,3/1,1,1/0.2,0.1,0\"", "\"sky.exr\"", "\"sky.exr\""]),
    ("sky_rotation", &["0", "90"]),
    ("sky_strength", &["1", "3", "0"]),
    ("light_scale", &["1", "0.5"]),
    ("emissive_scale", &["1", "2", "0"]),
    ("lamp_radius", &["0", "0.05"]),
    ("sun_angle", &["0", "2"]),
    ("light_groups", &["\"auto\"", "\"one\""]),
    ("metal_diffuse", &["0.5", "1"]),
    ("voxels", &["300", "\"side:8\"", "\"edge:0.4\""]),
    ("directions", &["16", "32"]),
    ("bounces", &["64", "2"]),
    ("direction_decay", &["2", "1.5", "4"]),
    ("tolerance", &["0.003", "0.1"]),
    ("refresh", &["0", "8"]),
    ("closed", &["\"auto\"", "\"no\"", "\"yes\""]),
    ("photons", &["0", "2000"]),
    ("direction_set", &["\"fibonacci\"", "\"integer\""]),
    ("rule", &["\"surface\"", "\"literal\""]),
    ("area", &["\"clipped\"", "\"faces\""]),
    ("gather", &["\"auto\"", "\"lightcuts\"", "\"final\"", "\"lookup\""]),
    ("cut_error", &["0.05", "0.2"]),
    ("node_spacing", &["4", "1"]),
    // Points come by the 64.
    ("shadow_samples", &["4", "65"]),
    ("bake_animated", &["false", "true"]),
    ("cut_limit", &["40", "5"]),
    ("near_rays", &["4", "6"]),
    ("gather_rays", &["16", "24"]),
    ("sky_rays", &["16", "64"]),
];

fn change_setting(level: &mut Level, random: &mut Random) -> String {
    let (name, values) = *random.one(&SETTINGS);
    let value = *random.one(values);
    level.set(name, value);
    format!("{name} = {value}")
}
