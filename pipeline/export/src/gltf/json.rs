//! Reading and changing glTF JSON without believing it.

use serde_json::{Map, Value};

use luxel_scene::import::{self, Checked, Fault};

pub type Object = Map<String, Value>;

/// The items of a list property; a missing or malformed list is empty.
pub fn list<'a>(object: &'a Object, key: &str) -> &'a [Value] {
    object.get(key).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// The objects of a list property, for changing; items that are no objects are passed over.
pub fn objects_mut<'a>(object: &'a mut Object, key: &str) -> impl Iterator<Item = &'a mut Object> {
    object.get_mut(key).and_then(Value::as_array_mut).into_iter().flatten().filter_map(Value::as_object_mut)
}

/// The list behind `key`, created when missing.
pub fn list_mut<'a>(object: &'a mut Object, key: &str) -> Checked<&'a mut Vec<Value>> {
    let value = object.entry(key).or_insert_with(|| Value::Array(Vec::new()));
    value.as_array_mut().ok_or_else(|| Fault::invalid(key, "it is not a list"))
}

/// The object behind `key`, created when missing.
pub fn object_mut<'a>(object: &'a mut Object, key: &str) -> Checked<&'a mut Object> {
    let value = object.entry(key).or_insert_with(|| Value::Object(Map::new()));
    value.as_object_mut().ok_or_else(|| Fault::invalid(key, "it is not an object"))
}

/// Item `i` of a top-level list, as an object.
pub fn item<'a>(root: &'a Object, key: &str, i: usize) -> Checked<&'a Object> {
    let value = list(root, key).get(i).and_then(Value::as_object);
    value.ok_or_else(|| Fault::invalid(place(root, key, i), "it is missing or not an object"))
}

/// Item `i` of a top-level list, for changing.
pub fn item_mut<'a>(root: &'a mut Object, key: &str, i: usize) -> Checked<&'a mut Object> {
    let name = place(root, key, i);
    let value = root.get_mut(key).and_then(|l| l.get_mut(i)).and_then(Value::as_object_mut);
    value.ok_or_else(|| Fault::invalid(name, "it is missing or not an object"))
}

/// A count, index or offset.
pub fn index(value: &Value) -> Option<usize> {
    value.as_u64().and_then(|n| usize::try_from(n).ok())
}

/// An optional count, index or offset.
pub fn number(object: &Object, key: &str) -> Option<usize> {
    object.get(key).and_then(index)
}

/// The object of an extension.
pub fn extension<'a>(object: &'a Object, name: &str) -> Option<&'a Object> {
    object.get("extensions")?.get(name)?.as_object()
}

/// Takes an extension away, and the `extensions` object when nothing is left in it.
pub fn remove_extension(object: &mut Object, name: &str) {
    let Some(extensions) = object.get_mut("extensions").and_then(Value::as_object_mut) else { return };
    extensions.shift_remove(name);
    if extensions.is_empty() {
        object.shift_remove("extensions");
    }
}

/// Strikes an extension off the lists of those used and required.
pub fn forget_extension(root: &mut Object, name: &str) {
    for key in ["extensionsUsed", "extensionsRequired"] {
        let Some(names) = root.get_mut(key).and_then(Value::as_array_mut) else { continue };
        names.retain(|n| n.as_str() != Some(name));
        if names.is_empty() {
            root.shift_remove(key);
        }
    }
}

/// Puts an extension on the list of those used.
pub fn declare_extension(root: &mut Object, name: &str) -> Checked<()> {
    let used = list_mut(root, "extensionsUsed")?;
    if !used.iter().any(|n| n.as_str() == Some(name)) {
        used.push(name.into());
    }
    Ok(())
}

/// Adds a key to an object's `extras`; false where the extras are something else than an object and stay as they are.
pub fn add_extra(object: &mut Object, key: &str, value: Value) -> bool {
    let extras = object.entry("extras").or_insert_with(|| Value::Object(Map::new()));
    match extras.as_object_mut() {
        Some(extras) => {
            extras.insert(key.into(), value);
            true
        }
        None => false,
    }
}

/// What to call an item of a top-level list in messages: `node 3 "Lamp"`, as the importer does.
pub fn place(root: &Object, key: &str, i: usize) -> String {
    let kind = match key {
        "nodes" => "node",
        "meshes" => "mesh",
        "materials" => "material",
        "images" => "image",
        "bufferViews" => "bufferView",
        other => other,
    };
    import::place(kind, i, list(root, key).get(i).and_then(|v| v.get("name")).and_then(Value::as_str))
}
