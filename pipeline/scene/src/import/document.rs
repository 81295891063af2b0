//! The JSON document: parsed with bounded nesting, checked for versions and extensions, and brought into the model of
//! the `gltf-json` crate.
//!
//! That model is stricter than the specification in a few places and single precision where we want double, so the
//! document passes through a JSON tree first: what the model would refuse although it is legal is put right there
//! ([`repair`]), and node transforms and animation targets are read from it directly.

use gltf_json::Root;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::error::{Bound, Checked, Fault, place, quoted};
use super::options::Limits;
use super::transform::Local;

/// A glTF document whose version and required extensions are understood.
#[derive(Debug)]
pub struct Document {
    pub root: Root,
    /// Local transform of every node, in double precision.
    pub locals: Vec<Local>,
    /// Nodes that some animation channel moves.
    pub animated: Vec<bool>,
}

/// Extensions that a file may require: luxel reads them, or they change nothing that a lightmap could show.
const UNDERSTOOD: &[&str] = &[
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_animation_pointer",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
    "KHR_texture_transform",
    "KHR_xmp_json_ld",
    "MOZ_lightmap",
    // Images in other formats are refused one by one, and only where the bake needs their content.
    "EXT_texture_avif",
    "KHR_texture_basisu",
    "MSFT_texture_dds",
];

impl Document {
    pub fn parse(json: &[u8], limits: &Limits) -> Checked<Self> {
        let length = json.len() as u64;
        if length > limits.json_bytes {
            return Err(Fault::limit("JSON", format!("it has {length} bytes"), Bound::JsonBytes, limits.json_bytes));
        }
        check_depth(json, limits.json_depth.min(120))?;
        let mut value: Value =
            serde_json::from_slice(json).map_err(|e| Fault::invalid("JSON", format!("it does not parse: {e}")))?;
        check_version(&value)?;
        check_extensions(&value)?;
        let nodes = array(&value, "nodes");
        if nodes.len() as u64 > limits.nodes {
            return Err(Fault::limit("JSON", format!("it has {} nodes", nodes.len()), Bound::Nodes, limits.nodes));
        }
        let locals = nodes.iter().enumerate().map(|(i, node)| Local::read(node, &node_place(node, i)));
        let locals = locals.collect::<Checked<Vec<_>>>()?;
        let animated = animated_nodes(&value, nodes.len())?;
        repair(&mut value);
        let root = model(value)?;
        Ok(Self { root, locals, animated })
    }

    /// `node 7 "Lamp"`.
    pub fn node_place(&self, node: usize) -> String {
        place("node", node, self.root.nodes.get(node).and_then(|n| n.name.as_deref()))
    }

    /// The name that the file gives a node.
    pub fn own_node_name(&self, node: usize) -> Option<&str> {
        self.root.nodes.get(node).and_then(|n| n.name.as_deref()).filter(|name| !name.is_empty())
    }

    /// The node's own name, or its place where it has none.
    pub fn node_name(&self, node: usize) -> String {
        self.own_node_name(node).map_or_else(|| self.node_place(node), str::to_owned)
    }

    /// `mesh 3 "Wall"`.
    pub fn mesh_place(&self, mesh: usize) -> String {
        place("mesh", mesh, self.root.meshes.get(mesh).and_then(|m| m.name.as_deref()))
    }

    /// `material 2 "Brick"`.
    pub fn material_place(&self, material: usize) -> String {
        place("material", material, self.root.materials.get(material).and_then(|m| m.name.as_deref()))
    }

    /// `image 4 "wall.png"`.
    pub fn image_place(&self, image: usize) -> String {
        place("image", image, self.root.images.get(image).and_then(|m| m.name.as_deref()))
    }

    /// Does the document use this extension, by its own account?
    pub fn uses(&self, extension: &str) -> bool {
        self.root.extensions_used.iter().chain(&self.root.extensions_required).any(|e| e == extension)
    }
}

fn node_place(node: &Value, index: usize) -> String {
    place("node", index, node.get("name").and_then(Value::as_str))
}

/// The elements of a top-level array; a missing or mistyped one reads as empty, the model complains about the latter.
fn array<'a>(value: &'a Value, key: &str) -> &'a [Value] {
    value.get(key).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// Bounds the nesting before any recursive parser sees the text.
fn check_depth(json: &[u8], limit: u32) -> Checked<()> {
    let (mut depth, mut in_string, mut escaped) = (0u32, false, false);
    for &byte in json {
        if in_string {
            match byte {
                _ if escaped => escaped = false,
                b'\\' => escaped = true,
                b'"' => in_string = false,
                _ => {}
            }
            continue;
        }
        match byte {
            b'"' => in_string = true,
            b'[' | b'{' => {
                depth += 1;
                if depth > limit {
                    return Err(Fault::limit("JSON", "it is nested more deeply", Bound::JsonDepth, u64::from(limit)));
                }
            }
            b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    Ok(())
}

/// glTF 2.x, as long as nothing newer than 2.0 is the minimum (§3.2: minor versions are compatible).
fn check_version(value: &Value) -> Checked<()> {
    let asset = value.get("asset").ok_or_else(|| Fault::invalid("asset", "it is missing, so this is not glTF 2.0"))?;
    let number = |key: &str| -> Checked<Option<(u32, u32)>> {
        let Some(text) = asset.get(key) else { return Ok(None) };
        let parsed = text.as_str().and_then(|text| {
            let (major, minor) = text.split_once('.')?;
            Some((major.parse().ok()?, minor.parse().ok()?))
        });
        parsed
            .map(Some)
            .ok_or_else(|| Fault::invalid("asset", format!("its {key} is {text}, not a version like \"2.0\"")))
    };
    let hint = "export the scene as glTF 2.0";
    match number("version")? {
        None => Err(Fault::invalid("asset", "it has no version")),
        Some((2, _)) => match number("minVersion")? {
            Some(least) if least > (2, 0) => {
                Err(Fault::unsupported("asset", format!("it needs at least glTF {}.{}", least.0, least.1), hint))
            }
            _ => Ok(()),
        },
        Some((major, minor)) => Err(Fault::unsupported("asset", format!("it is glTF {major}.{minor}"), hint)),
    }
}

/// Refuses, by name, what a file requires and luxel does not read.
fn check_extensions(value: &Value) -> Checked<()> {
    for name in array(value, "extensionsRequired") {
        let Some(name) = name.as_str() else {
            return Err(Fault::invalid("extensionsRequired", format!("{name} is not a name")));
        };
        if !UNDERSTOOD.contains(&name) {
            let (what, hint) = refusal(name);
            return Err(Fault::unsupported("extensionsRequired", what, hint));
        }
    }
    Ok(())
}

/// What to say about an extension that luxel does not read: the fault and the remedy.
pub fn refusal(extension: &str) -> (String, &'static str) {
    let what = format!("the scene requires the extension {}, which luxel does not read", quoted(extension));
    let hint = match extension {
        "KHR_draco_mesh_compression" => {
            "export it without Draco mesh compression (meshopt compression and quantization are read)"
        }
        _ => "export it without that extension",
    };
    (what, hint)
}

/// Which nodes are the target of an animation channel, KHR_animation_pointer included.
fn animated_nodes(value: &Value, nodes: usize) -> Checked<Vec<bool>> {
    let mut animated = vec![false; nodes];
    for (i, animation) in array(value, "animations").iter().enumerate() {
        let place = place("animation", i, animation.get("name").and_then(Value::as_str));
        for channel in array(animation, "channels") {
            let Some(target) = channel.get("target") else { continue };
            let node = match target.get("node") {
                Some(node) => Some(
                    node.as_u64().or_else(|| node.as_f64().filter(|f| f.fract() == 0.0).map(|f| f as u64)).ok_or_else(
                        || Fault::invalid(&place, format!("a channel targets the node {node}, which is not an index")),
                    )?,
                ),
                None => pointed_node(target),
            };
            let Some(node) = node else { continue };
            let slot = usize::try_from(node).ok().and_then(|node| animated.get_mut(node));
            let what = || format!("a channel targets node {node}, but there are {nodes} nodes");
            *slot.ok_or_else(|| Fault::invalid(&place, what()))? = true;
        }
    }
    Ok(animated)
}

/// The node of a pointer such as `/nodes/3/rotation`, when it points at something that moves the node.
fn pointed_node(target: &Value) -> Option<u64> {
    let pointer = target.pointer("/extensions/KHR_animation_pointer/pointer")?.as_str()?;
    let (index, property) = pointer.strip_prefix("/nodes/")?.split_once('/')?;
    let moves = ["translation", "rotation", "scale", "weights"].iter().any(|p| property.starts_with(p));
    moves.then(|| index.parse().ok())?
}

/// Puts right what is legal and the model would refuse: a scene without nodes, an integer written as `3.0`, channels
/// without a node. Animations are not needed any more at this point.
fn repair(value: &mut Value) {
    if let Some(root) = value.as_object_mut() {
        root.remove("animations");
        for scene in root.get_mut("scenes").and_then(Value::as_array_mut).into_iter().flatten() {
            if let Some(scene) = scene.as_object_mut() {
                scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
            }
        }
    }
    integers(value);
}

/// Integral numbers become integers; the recursion is as deep as `check_depth` allows.
fn integers(value: &mut Value) {
    const EXACT: f64 = 9_007_199_254_740_992.0;
    match value {
        Value::Array(values) => values.iter_mut().for_each(integers),
        Value::Object(map) => map.values_mut().for_each(integers),
        Value::Number(number) if number.is_f64() => {
            let Some(f) = number.as_f64() else { return };
            if f.fract() == 0.0 && f.abs() < EXACT && (f != 0.0 || f.is_sign_positive()) {
                *value = Value::from(f as i64);
            }
        }
        _ => {}
    }
}

/// The typed model; when it refuses, the elements are tried one by one so that the message can name one.
fn model(value: Value) -> Checked<Root> {
    Root::deserialize(&value).map_err(|e| culprit(&value).unwrap_or_else(|| Fault::invalid("JSON", e.to_string())))
}

/// The first element of a top-level array that its type refuses.
fn culprit(value: &Value) -> Option<Fault> {
    fn first<T: DeserializeOwned>(value: &Value, key: &str, kind: &str) -> Option<Fault> {
        let elements = value.get(key)?;
        let Some(elements) = elements.as_array() else {
            return Some(Fault::invalid("JSON", format!("\"{key}\" is not an array")));
        };
        elements.iter().enumerate().find_map(|(i, element)| {
            let error = T::deserialize(element).err()?;
            let name = element.get("name").and_then(Value::as_str);
            Some(Fault::invalid(place(kind, i, name), error.to_string()))
        })
    }
    first::<gltf_json::Buffer>(value, "buffers", "buffer")
        .or_else(|| first::<gltf_json::buffer::View>(value, "bufferViews", "bufferView"))
        .or_else(|| first::<gltf_json::Accessor>(value, "accessors", "accessor"))
        .or_else(|| first::<gltf_json::Mesh>(value, "meshes", "mesh"))
        .or_else(|| first::<gltf_json::Node>(value, "nodes", "node"))
        .or_else(|| first::<gltf_json::Scene>(value, "scenes", "scene"))
        .or_else(|| first::<gltf_json::Material>(value, "materials", "material"))
        .or_else(|| first::<gltf_json::Texture>(value, "textures", "texture"))
        .or_else(|| first::<gltf_json::Image>(value, "images", "image"))
        .or_else(|| first::<gltf_json::texture::Sampler>(value, "samplers", "sampler"))
        .or_else(|| first::<gltf_json::Camera>(value, "cameras", "camera"))
        .or_else(|| first::<gltf_json::Skin>(value, "skins", "skin"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::FaultKind;

    fn parse(json: &str) -> Checked<Document> {
        Document::parse(json.as_bytes(), &Limits::default())
    }

    fn fault(json: &str) -> Fault {
        parse(json).unwrap_err()
    }

    #[test]
    fn what_the_specification_allows_is_read() {
        let document = parse(
            r#"{"asset":{"version":"2.1"},"scene":0.0,"scenes":[{"name":"empty"}],
                "accessors":[{"componentType":5126.0,"count":3.0,"type":"VEC3"}],
                "nodes":[{"translation":[0.1,2,3.0]},{}],
                "animations":[{"channels":[{"sampler":0,"target":{"path":"pointer","extensions":
                    {"KHR_animation_pointer":{"pointer":"/nodes/1/scale"}}}}],"samplers":[]}]}"#,
        )
        .unwrap();
        assert_eq!(document.root.accessors[0].count.0, 3);
        assert_eq!(document.animated, [false, true]);
        assert_eq!(document.locals[0].affine().translation.x, 0.1, "not rounded to single precision");
    }

    #[test]
    fn versions() {
        assert!(parse(r#"{"asset":{"version":"2.0"}}"#).is_ok());
        assert_eq!(fault(r#"{"asset":{"version":"1.0"}}"#).kind, FaultKind::Unsupported);
        assert_eq!(fault(r#"{"asset":{"version":"2.1","minVersion":"2.1"}}"#).kind, FaultKind::Unsupported);
        for json in [r#"{"asset":{"version":""}}"#, r#"{"asset":{}}"#, "{}", r#"{"asset":{"version":2}}"#] {
            assert_eq!(fault(json).kind, FaultKind::Invalid, "{json}");
        }
    }

    #[test]
    fn required_extensions_are_refused_by_name() {
        let json = |name: &str| format!(r#"{{"asset":{{"version":"2.0"}},"extensionsRequired":["{name}"]}}"#);
        assert!(parse(&json("KHR_mesh_quantization")).is_ok());
        let draco = fault(&json("KHR_draco_mesh_compression")).to_string();
        assert!(draco.contains("KHR_draco_mesh_compression") && draco.contains("without Draco"), "{draco}");
        assert!(fault(&json("EXT_unheard_of")).to_string().contains("EXT_unheard_of"));
    }

    #[test]
    fn a_mistyped_element_is_named() {
        let text = fault(r#"{"asset":{"version":"2.0"},"meshes":[{"primitives":[]},{"name":"W","primitives":7}]}"#);
        assert!(text.place == "mesh 1 \"W\"" && text.what.contains("sequence"), "{text}");
    }

    #[test]
    fn nesting_is_bounded() {
        let deep = format!(r#"{{"asset":{{"version":"2.0"}},"extras":{}{}}}"#, "[".repeat(5000), "]".repeat(5000));
        let fault = fault(&deep);
        assert!(fault.kind == FaultKind::Limit && fault.what.contains("json_depth"), "{fault}");
        assert!(parse(r#"{"asset":{"version":"2.0","generator":"[[[[\"[[["}}"#).is_ok(), "brackets in strings");
    }
}
