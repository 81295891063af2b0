//! Who refers to which accessor, bufferView, mesh, material and texture.
//!
//! The glTF specification and the extensions that luxel knows refer from the places listed here. Any other extension
//! may hold an index of anything anywhere: every integer inside one counts as a possible reference, so that whatever it
//! may mean, of these and of images, stays where it is.

use std::collections::BTreeSet;

use serde_json::Value;

use super::json::{Object, index, number, objects_mut};

/// The extension by which a material carries its lightmap.
pub const LIGHTMAP: &str = "MOZ_lightmap";

/// The extension of compressed primitives.
pub const DRACO: &str = "KHR_draco_mesh_compression";

/// Extensions of which it is known that they hold no index that is not visited here (or by `pages`, which knows the
/// images of textures), besides all those that begin with `KHR_materials_`, `KHR_texture_`, `EXT_texture_` or
/// `KHR_lights_`.
const HARMLESS: [&str; 7] = [
    "EXT_mesh_gpu_instancing",
    DRACO,
    "KHR_mesh_quantization",
    "KHR_animation_pointer",
    "KHR_node_visibility",
    "KHR_xmp_json_ld",
    LIGHTMAP,
];

/// One of the walks below: calls a function on every reference to one kind of item.
pub type Each = fn(&mut Object, &mut dyn FnMut(&mut Value));

/// Calls `f` on every reference to an accessor.
pub fn accessors(root: &mut Object, f: &mut dyn FnMut(&mut Value)) {
    for mesh in objects_mut(root, "meshes") {
        for primitive in objects_mut(mesh, "primitives") {
            values(primitive.get_mut("attributes"), f);
            primitive.get_mut("indices").into_iter().for_each(&mut *f);
            for target in primitive.get_mut("targets").and_then(Value::as_array_mut).into_iter().flatten() {
                values(Some(target), f);
            }
        }
    }
    objects_mut(root, "skins").filter_map(|s| s.get_mut("inverseBindMatrices")).for_each(&mut *f);
    for animation in objects_mut(root, "animations") {
        for sampler in objects_mut(animation, "samplers") {
            ["input", "output"].iter().for_each(|k| sampler.get_mut(*k).into_iter().for_each(&mut *f));
        }
    }
    for node in objects_mut(root, "nodes") {
        let instancing = node.get_mut("extensions").and_then(|e| e.get_mut("EXT_mesh_gpu_instancing"));
        values(instancing.and_then(|e| e.get_mut("attributes")), f);
    }
}

/// Calls `f` on every reference to a bufferView.
pub fn views(root: &mut Object, f: &mut dyn FnMut(&mut Value)) {
    for accessor in objects_mut(root, "accessors") {
        accessor.get_mut("bufferView").into_iter().for_each(&mut *f);
        let Some(sparse) = accessor.get_mut("sparse") else { continue };
        for part in ["indices", "values"] {
            sparse.get_mut(part).and_then(|p| p.get_mut("bufferView")).into_iter().for_each(&mut *f);
        }
    }
    objects_mut(root, "images").filter_map(|i| i.get_mut("bufferView")).for_each(&mut *f);
    for mesh in objects_mut(root, "meshes") {
        for primitive in objects_mut(mesh, "primitives") {
            let draco = primitive.get_mut("extensions").and_then(|e| e.get_mut(DRACO));
            draco.and_then(|d| d.get_mut("bufferView")).into_iter().for_each(&mut *f);
        }
    }
}

/// Calls `f` on every reference to a mesh.
pub fn meshes(root: &mut Object, f: &mut dyn FnMut(&mut Value)) {
    objects_mut(root, "nodes").filter_map(|n| n.get_mut("mesh")).for_each(f);
}

/// Calls `f` on every reference to a material.
pub fn materials(root: &mut Object, f: &mut dyn FnMut(&mut Value)) {
    for mesh in objects_mut(root, "meshes") {
        objects_mut(mesh, "primitives").for_each(|p| primitive_materials(p, f));
    }
}

/// Calls `f` on the references of a primitive to its material and to those of its variants.
pub fn primitive_materials(primitive: &mut Object, f: &mut dyn FnMut(&mut Value)) {
    primitive.get_mut("material").into_iter().for_each(&mut *f);
    let variants = primitive.get_mut("extensions").and_then(|e| e.get_mut("KHR_materials_variants"));
    let mappings = variants.and_then(|v| v.get_mut("mappings")).and_then(Value::as_array_mut);
    mappings.into_iter().flatten().filter_map(|m| m.get_mut("material")).for_each(f);
}

/// Calls `f` on everything in a material that may refer to a texture.
pub fn textures(root: &mut Object, f: &mut dyn FnMut(&mut Value)) {
    objects_mut(root, "materials")
        .for_each(|m| texture_infos(m, &mut |info| info.get_mut("index").into_iter().for_each(&mut *f)));
}

/// Calls `f` on every texture reference of a material, those of extensions included: an object with an integer
/// `index`, wherever it is. The JSON reader has bounded the depth.
pub fn texture_infos(object: &mut Object, f: &mut dyn FnMut(&mut Object)) {
    if number(object, "index").is_some() {
        f(object);
    }
    for (key, value) in object.iter_mut() {
        match value {
            _ if key == "extras" => {}
            Value::Object(inner) => texture_infos(inner, f),
            Value::Array(items) => items.iter_mut().filter_map(Value::as_object_mut).for_each(|o| texture_infos(o, f)),
            _ => {}
        }
    }
}

/// Calls `f` on every reference of a material to its lightmap.
pub fn lightmaps(root: &mut Object, f: &mut dyn FnMut(&mut Value)) {
    for material in objects_mut(root, "materials") {
        let lightmap = material.get_mut("extensions").and_then(|e| e.get_mut(LIGHTMAP));
        lightmap.and_then(|l| l.get_mut("index")).into_iter().for_each(&mut *f);
    }
}

/// Every integer inside an extension that luxel does not know.
pub fn possible(root: &Object) -> BTreeSet<usize> {
    let mut found = BTreeSet::new();
    let mut open: Vec<&Value> = root.values().collect();
    // An explicit stack: the depth of a document is not ours to choose.
    while let Some(value) = open.pop() {
        match value {
            Value::Array(items) => open.extend(items),
            Value::Object(object) => {
                for (key, inner) in object {
                    match (key.as_str(), inner) {
                        ("extras", _) => {}
                        ("extensions", Value::Object(extensions)) => by_extension(extensions, &mut open, &mut found),
                        _ => open.push(inner),
                    }
                }
            }
            _ => {}
        }
    }
    if let Some(Value::Object(extensions)) = root.get("extensions") {
        let mut nested = Vec::new();
        by_extension(extensions, &mut nested, &mut found);
    }
    found
}

fn by_extension<'a>(extensions: &'a Object, open: &mut Vec<&'a Value>, found: &mut BTreeSet<usize>) {
    for (name, value) in extensions {
        if is_harmless(name) { open.push(value) } else { integers(value, found) }
    }
}

fn is_harmless(name: &str) -> bool {
    let prefixes = ["KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_"];
    HARMLESS.contains(&name) || prefixes.iter().any(|p| name.starts_with(p))
}

fn integers(value: &Value, found: &mut BTreeSet<usize>) {
    let mut open = vec![value];
    while let Some(value) = open.pop() {
        match value {
            Value::Number(_) => found.extend(index(value)),
            Value::Array(items) => open.extend(items),
            Value::Object(object) => open.extend(object.values()),
            _ => {}
        }
    }
}

fn values(object: Option<&mut Value>, f: &mut dyn FnMut(&mut Value)) {
    object.and_then(Value::as_object_mut).into_iter().flat_map(|o| o.values_mut()).for_each(f);
}

/// Indices that `each` meets.
pub fn used(root: &mut Object, each: Each) -> BTreeSet<usize> {
    let mut found = BTreeSet::new();
    each(root, &mut |v| found.extend(index(v)));
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn integers_of_unknown_extensions_count_and_known_places_do_not() {
        let root = json!({
            "extensions": {"VENDOR_top": {"a": 11}, "KHR_lights_punctual": {"lights": [{"intensity": 12}]}},
            "nodes": [{"mesh": 1, "extras": {"n": 2}, "extensions": {"VENDOR_x": {"deep": [{"view": 3}], "f": 1.5}}}],
            "materials": [{"extensions": {"KHR_materials_clearcoat": {
                "clearcoatTexture": {"index": 4, "extensions": {"VENDOR_y": [5]}}}}}]
        });
        let found = possible(root.as_object().unwrap());
        assert_eq!(found.into_iter().collect::<Vec<_>>(), [3, 5, 11]);
    }

    #[test]
    fn all_places_are_visited() {
        let mut root = json!({
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "_X": 1}, "indices": 2,
                "targets": [{"POSITION": 3}],
                "extensions": {"KHR_draco_mesh_compression": {"bufferView": 9, "attributes": {"POSITION": 77}}}}]}],
            "skins": [{"inverseBindMatrices": 4}],
            "animations": [{"samplers": [{"input": 5, "output": 6}]}],
            "nodes": [{"extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": 7}}}}],
            "accessors": [{"bufferView": 0, "sparse": {"indices": {"bufferView": 1}, "values": {"bufferView": 2}}}],
            "images": [{"bufferView": 3}, {"uri": "x"}]
        });
        let root = root.as_object_mut().unwrap();
        assert_eq!(used(root, accessors).into_iter().collect::<Vec<_>>(), (0..8).collect::<Vec<_>>());
        assert_eq!(used(root, views).into_iter().collect::<Vec<_>>(), [0, 1, 2, 3, 9]);
    }
}
