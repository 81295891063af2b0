//! A [`Scene`] as a binary glTF file: the same scene gives the same bytes.
//!
//! Nodes come in the order instances, lights, cameras. Settings that a scene needs (its sky) go into the extras of
//! the glTF scene as `luxel: { sky: … }`, what an instance needs into the extras of its node.

use anyhow::Context;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use luxel_scene::{Alpha, Light, LightKind, Material, Mesh, Scene, Sky, Texture, TextureRef};
use serde_json::{Map, Value as Json, json};

/// Byte targets of buffer views: vertex attributes and indices.
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;

pub fn write(scene: &Scene) -> anyhow::Result<Vec<u8>> {
    let mut writer = Writer::default();
    let meshes: Vec<Json> = scene.meshes.iter().map(|m| writer.mesh(m)).collect();
    let mut images = Vec::new();
    for texture in &scene.textures {
        images.push(writer.image(texture).with_context(|| format!("texture {}", texture.name))?);
    }
    let materials: Vec<Json> = scene.materials.iter().map(|m| writer.material(m)).collect();
    let lights: Vec<Json> = scene.lights.iter().map(light).collect();
    if !lights.is_empty() {
        writer.uses("KHR_lights_punctual");
    }
    let nodes = nodes(scene);

    let mut root = Map::new();
    let mut put = |key: &str, value: Json| {
        if value.as_array().is_none_or(|list| !list.is_empty()) {
            root.insert(key.into(), value);
        }
    };
    put("asset", json!({ "version": "2.0", "generator": "luxel assets" }));
    put("extensionsUsed", json!(writer.extensions));
    put("scene", json!(0));
    put("scenes", json!([scene_entry(scene, nodes.len())]));
    put("nodes", json!(nodes));
    put("meshes", json!(meshes));
    put("materials", json!(materials));
    put("textures", json!((0..images.len()).map(|i| json!({ "source": i, "sampler": 0 })).collect::<Vec<_>>()));
    if !images.is_empty() {
        put("samplers", json!([{ "magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497 }]));
    }
    put("images", json!(images));
    let cameras = scene.cameras.iter().map(|c| {
        let mut lens = json!({ "yfov": c.yfov, "znear": 0.01 });
        if let Some(aspect) = c.aspect {
            lens["aspectRatio"] = json!(aspect);
        }
        json!({ "name": c.name, "type": "perspective", "perspective": lens })
    });
    put("cameras", json!(cameras.collect::<Vec<_>>()));
    if !lights.is_empty() {
        put("extensions", json!({ "KHR_lights_punctual": { "lights": lights } }));
    }
    put("accessors", json!(writer.accessors));
    put("bufferViews", json!(writer.views));
    put("buffers", json!([{ "byteLength": writer.bytes.len() }]));
    container(&serde_json::to_vec(&root)?, &writer.bytes)
}

/// Header and two chunks, each padded to four bytes.
fn container(json: &[u8], binary: &[u8]) -> anyhow::Result<Vec<u8>> {
    let mut out = Vec::new();
    let padded = |n: usize| n.next_multiple_of(4);
    let total = 12 + 8 + padded(json.len()) + 8 + padded(binary.len());
    out.extend(b"glTF");
    out.extend(2u32.to_le_bytes());
    out.extend(u32::try_from(total).context("the file would exceed 4 GiB")?.to_le_bytes());
    for (kind, bytes, pad) in [(b"JSON", json, b' '), (b"BIN\0", binary, 0)] {
        out.extend((padded(bytes.len()) as u32).to_le_bytes());
        out.extend(kind);
        out.extend(bytes);
        out.resize(out.len().next_multiple_of(4), pad);
    }
    Ok(out)
}

/// A JSON number with as few digits as an f32 needs.
fn number(x: f32) -> Json {
    json!(x.to_string().parse::<f64>().unwrap_or(f64::from(x)) + 0.0)
}

fn vec3(v: Vec3) -> Json {
    json!(v.to_array().map(number))
}

fn scene_entry(scene: &Scene, nodes: usize) -> Json {
    let mut entry = json!({ "name": scene.name, "nodes": (0..nodes).collect::<Vec<_>>() });
    match &scene.sky {
        Sky::Constant(radiance) => entry["extras"] = json!({ "luxel": { "sky": vec3(*radiance) } }),
        Sky::Gradient { zenith, horizon, ground } => {
            let text = [zenith, horizon, ground].map(|c| format!("{},{},{}", c.x, c.y, c.z)).join("/");
            entry["extras"] = json!({ "luxel": { "sky": text } });
        }
        Sky::None | Sky::Image(_) => {}
    }
    entry
}

fn nodes(scene: &Scene) -> Vec<Json> {
    let mut nodes = Vec::new();
    for instance in &scene.instances {
        let mut n = node(&instance.name, instance.transform);
        n["mesh"] = json!(instance.mesh);
        let mut extras = Map::new();
        if !instance.receives {
            extras.insert("luxel_receive".into(), json!(false));
        }
        if !instance.casts {
            extras.insert("luxel_cast".into(), json!(false));
        }
        if instance.texel_scale != 1.0 {
            extras.insert("luxel_scale".into(), number(instance.texel_scale));
        }
        if *instance.group != *instance.name {
            extras.insert("luxel_group".into(), json!(*instance.group));
        }
        if !extras.is_empty() {
            n["extras"] = Json::Object(extras);
        }
        nodes.push(n);
    }
    for (i, light) in scene.lights.iter().enumerate() {
        let (place, extra) = match light.kind {
            LightKind::Point { position, radius, .. } => {
                (DAffine3::from_translation(position), ("luxel_radius", radius))
            }
            LightKind::Spot { position, direction, radius, .. } => (aim(position, direction), ("luxel_radius", radius)),
            LightKind::Sun { direction, angle } => (aim(DVec3::ZERO, direction), ("luxel_angle", angle.to_degrees())),
        };
        let mut n = node(&light.name, place);
        n["extensions"] = json!({ "KHR_lights_punctual": { "light": i } });
        let mut extras = Map::new();
        if extra.1 > 0.0 {
            // Twelve digits hide the rounding of the conversion to degrees.
            extras.insert(extra.0.into(), json!((extra.1 * 1e12).round() / 1e12));
        }
        if *light.group != *light.name {
            extras.insert("luxel_group".into(), json!(*light.group));
        }
        if !extras.is_empty() {
            n["extras"] = Json::Object(extras);
        }
        nodes.push(n);
    }
    for (i, camera) in scene.cameras.iter().enumerate() {
        let mut n = node(&camera.name, camera.transform);
        n["camera"] = json!(i);
        nodes.push(n);
    }
    nodes
}

fn node(name: &str, transform: DAffine3) -> Json {
    let mut node = json!({ "name": name });
    if transform != DAffine3::IDENTITY {
        let m = transform.matrix3;
        let t = transform.translation;
        let column = |c: DVec3, w: f64| [c.x + 0.0, c.y + 0.0, c.z + 0.0, w];
        let matrix = [column(m.x_axis, 0.0), column(m.y_axis, 0.0), column(m.z_axis, 0.0), column(t, 1.0)];
        node["matrix"] = json!(matrix.concat());
    }
    node
}

/// A node whose −Z looks along `direction`.
fn aim(position: DVec3, direction: DVec3) -> DAffine3 {
    let back = -direction;
    let side = if back.y.abs() < 0.99 { DVec3::Y } else { DVec3::X };
    let right = side.cross(back).normalize();
    DAffine3::from_mat3_translation(DMat3::from_cols(right, back.cross(right), back), position)
}

fn light(light: &Light) -> Json {
    let strength = light.intensity.max_element();
    let color = if strength > 0.0 { light.intensity / strength } else { Vec3::ONE };
    let mut out = json!({ "name": light.name, "color": vec3(color), "intensity": number(strength) });
    let range = match light.kind {
        LightKind::Point { range, .. } => {
            out["type"] = json!("point");
            range
        }
        LightKind::Spot { inner, outer, range, .. } => {
            out["type"] = json!("spot");
            out["spot"] = json!({ "innerConeAngle": inner, "outerConeAngle": outer });
            range
        }
        LightKind::Sun { .. } => {
            out["type"] = json!("directional");
            None
        }
    };
    if let Some(range) = range {
        out["range"] = json!(range);
    }
    out
}

#[derive(Default)]
struct Writer {
    bytes: Vec<u8>,
    views: Vec<Json>,
    accessors: Vec<Json>,
    extensions: Vec<&'static str>,
}

impl Writer {
    fn uses(&mut self, extension: &'static str) {
        if !self.extensions.contains(&extension) {
            self.extensions.push(extension);
        }
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.extend(bytes);
        self.views.push(view);
        self.views.len() - 1
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]], bounds: bool) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let view = self.view(&bytes, Some(ARRAY_BUFFER));
        let mut accessor = json!({ "bufferView": view, "componentType": FLOAT, "count": values.len() });
        accessor["type"] = json!(["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1]);
        if bounds {
            let fold = |f: fn(f32, f32) -> f32, start: f32| {
                let mut out = [start; N];
                for v in values {
                    for i in 0..N {
                        out[i] = f(out[i], v[i]);
                    }
                }
                json!(out.map(number).to_vec())
            };
            accessor["min"] = fold(f32::min, f32::INFINITY);
            accessor["max"] = fold(f32::max, f32::NEG_INFINITY);
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn indices(&mut self, triangles: &[[u32; 3]], vertices: usize) -> usize {
        let small = vertices <= usize::from(u16::MAX);
        let flat = triangles.iter().flatten();
        let bytes: Vec<u8> = if small {
            flat.flat_map(|i| (*i as u16).to_le_bytes()).collect()
        } else {
            flat.flat_map(|i| i.to_le_bytes()).collect()
        };
        let view = self.view(&bytes, Some(ELEMENT_ARRAY_BUFFER));
        let kind = if small { UNSIGNED_SHORT } else { UNSIGNED_INT };
        self.accessors
            .push(json!({ "bufferView": view, "componentType": kind, "count": 3 * triangles.len(), "type": "SCALAR" }));
        self.accessors.len() - 1
    }

    fn mesh(&mut self, mesh: &Mesh) -> Json {
        let mut attributes = Map::new();
        let positions: Vec<_> = mesh.positions.iter().map(|p| p.to_array()).collect();
        attributes.insert("POSITION".into(), json!(self.floats(&positions, true)));
        if !mesh.normals.is_empty() {
            let normals: Vec<_> = mesh.normals.iter().map(|p| p.to_array()).collect();
            attributes.insert("NORMAL".into(), json!(self.floats(&normals, false)));
        }
        for (set, uvs) in mesh.uvs.iter().enumerate().filter(|(_, uvs)| !uvs.is_empty()) {
            let uvs: Vec<_> = uvs.iter().map(|p| p.to_array()).collect();
            attributes.insert(format!("TEXCOORD_{set}"), json!(self.floats(&uvs, false)));
        }
        let indices = self.indices(&mesh.triangles, mesh.positions.len());
        let primitive = json!({ "attributes": attributes, "indices": indices, "material": mesh.material });
        json!({ "name": mesh.name, "primitives": [primitive] })
    }

    fn image(&mut self, texture: &Texture) -> anyhow::Result<Json> {
        let mut png = Vec::new();
        let opaque = texture.texels.iter().all(|t| t[3] == 255);
        let encoder = PngEncoder::new(&mut png);
        if opaque {
            let rgb: Vec<u8> = texture.texels.iter().flat_map(|t| [t[0], t[1], t[2]]).collect();
            encoder.write_image(&rgb, texture.width, texture.height, ExtendedColorType::Rgb8)?;
        } else {
            let rgba = texture.texels.as_flattened();
            encoder.write_image(rgba, texture.width, texture.height, ExtendedColorType::Rgba8)?;
        }
        let view = self.view(&png, None);
        Ok(json!({ "name": texture.name, "bufferView": view, "mimeType": "image/png" }))
    }

    fn material(&mut self, m: &Material) -> Json {
        let texture = |t: &TextureRef| json!({ "index": t.texture, "texCoord": t.tex_coord });
        let mut pbr = json!({
            "baseColorFactor": m.base_color.to_array().map(number),
            "metallicFactor": number(m.metallic),
            "roughnessFactor": number(m.roughness),
        });
        if let Some(t) = &m.base_color_texture {
            pbr["baseColorTexture"] = texture(t);
        }
        let mut out = json!({ "name": m.name, "pbrMetallicRoughness": pbr });
        let strength = m.emission.max_element();
        if strength > 0.0 {
            out["emissiveFactor"] = vec3(m.emission / strength);
            out["extensions"] = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": number(strength) } });
            self.uses("KHR_materials_emissive_strength");
        }
        if let Some(t) = &m.emissive_texture {
            out["emissiveTexture"] = texture(t);
        }
        match m.alpha {
            Alpha::Opaque => {}
            Alpha::Mask(cutoff) => {
                out["alphaMode"] = json!("MASK");
                out["alphaCutoff"] = number(cutoff);
            }
            Alpha::Blend => out["alphaMode"] = json!("BLEND"),
        }
        if m.double_sided {
            out["doubleSided"] = json!(true);
        }
        out
    }
}
