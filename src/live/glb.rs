//! Whether a .glb shows new light on what a page has loaded already, or something else.
//!
//! Loading a level into a browser takes seconds, its lightmap a fraction of one. So two digests tell a page how much of
//! the last .glb it may keep:
//!
//! - *layout*: the lightmap coordinates of every primitive and the page of its material. While it stays, a new lightmap
//!   fits what is on show.
//! - *content*: everything but the lightmap's own pictures and what their bytes stand for. While it stays, the lightmap
//!   is all that is new.
//!
//! Both are over bytes: a file that is written in another order has other digests, which costs a load and shows nothing
//! wrong.

use blake3::Hasher;
use serde_json::Value;

/// The attribute that holds lightmap coordinates.
const UV: &str = "TEXCOORD_1";
const LIGHTMAP: &str = "MOZ_lightmap";

/// Digests of a .glb, hexadecimal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Digests {
    pub layout: String,
    pub content: String,
}

/// The digests of a .glb; none where it is not one.
pub fn digests(glb: &[u8]) -> Option<Digests> {
    let (json, bin) = chunks(glb)?;
    let mut root: Value = serde_json::from_slice(json).ok()?;
    let layout = layout(&root, bin);
    let content = content(&mut root, bin)?;
    Some(Digests { layout, content })
}

/// JSON and binary chunk (glTF 2.0, §4.4).
fn chunks(glb: &[u8]) -> Option<(&[u8], &[u8])> {
    let rest = glb.strip_prefix(b"glTF")?.strip_prefix(&2u32.to_le_bytes())?.get(4..)?;
    let (json, rest) = chunk(rest, b"JSON")?;
    Some((json, chunk(rest, b"BIN\0").map_or(&[][..], |(bin, _)| bin)))
}

/// A chunk of a kind, and what follows it.
fn chunk<'a>(bytes: &'a [u8], kind: &[u8; 4]) -> Option<(&'a [u8], &'a [u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.strip_prefix(kind)?.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)
}

fn layout(root: &Value, bin: &[u8]) -> String {
    let mut hasher = Hasher::new();
    for mesh in list(root, "meshes") {
        put(&mut hasher, b"mesh");
        for primitive in list(mesh, "primitives") {
            put(&mut hasher, b"primitive");
            let page = at(root, "materials", &primitive["material"]).map(|m| &m["extras"]["luxel"]["page"]);
            put(&mut hasher, page.unwrap_or(&Value::Null).to_string().as_bytes());
            let Some(accessor) = at(root, "accessors", &primitive["attributes"][UV]) else { continue };
            let fields = ["byteOffset", "componentType", "count", "normalized"];
            fields.iter().for_each(|field| put(&mut hasher, accessor[field].to_string().as_bytes()));
            if let Some(view) = at(root, "bufferViews", &accessor["bufferView"]) {
                put(&mut hasher, view["byteStride"].to_string().as_bytes());
                put(&mut hasher, bytes(view, bin));
            }
        }
    }
    hasher.finalize().to_hex().to_string()
}

/// Takes the lightmap's pictures out of a document, and digests what is left of it.
fn content(root: &mut Value, bin: &[u8]) -> Option<String> {
    let pictures: Vec<usize> =
        list(root, "textures").iter().filter(|t| is_marked(t)).filter_map(|t| index(&t["source"])).collect();
    let mut hidden = Vec::new();
    for image in pictures {
        if let Some(image) = root.get_mut("images").and_then(|i| i.get_mut(image)) {
            hidden.extend(index(&image["bufferView"]));
            // Its name tells the range of the light.
            image.as_object_mut()?.retain(|key, _| key == "bufferView");
        }
    }
    for texture in list_mut(root, "textures").filter(|t| is_marked(t)) {
        texture.as_object_mut()?.shift_remove("name");
    }
    for material in list_mut(root, "materials") {
        if let Some(lightmap) = material.get_mut("extensions").and_then(|e| e.get_mut(LIGHTMAP)) {
            lightmap.as_object_mut()?.shift_remove("intensity");
        }
    }
    let document = root.as_object_mut()?;
    document.shift_remove("buffers");
    let views = document.shift_remove("bufferViews").unwrap_or_default();
    let mut hasher = Hasher::new();
    put(&mut hasher, root.to_string().as_bytes());
    for (i, view) in views.as_array().into_iter().flatten().enumerate() {
        // Where it lies, and the alignment that this has, is nothing to the page.
        put(&mut hasher, view["byteStride"].to_string().as_bytes());
        put(&mut hasher, view["extensions"].to_string().as_bytes());
        put(&mut hasher, if hidden.contains(&i) { b"" } else { bytes(view, bin) });
    }
    Some(hasher.finalize().to_hex().to_string())
}

/// A texture that shows a page of the atlas.
fn is_marked(texture: &Value) -> bool {
    texture["extras"]["luxel"]["lightmap"].is_string()
}

/// Adds a part whose end cannot be mistaken.
fn put(hasher: &mut Hasher, part: &[u8]) {
    hasher.update(&(part.len() as u64).to_le_bytes()).update(part);
}

fn index(value: &Value) -> Option<usize> {
    value.as_u64().and_then(|n| usize::try_from(n).ok())
}

fn list<'a>(object: &'a Value, key: &str) -> &'a [Value] {
    object[key].as_array().map_or(&[], Vec::as_slice)
}

fn list_mut<'a>(object: &'a mut Value, key: &str) -> impl Iterator<Item = &'a mut Value> {
    object.get_mut(key).and_then(Value::as_array_mut).into_iter().flatten()
}

/// The item of a top-level list that an index means.
fn at<'a>(root: &'a Value, key: &str, place: &Value) -> Option<&'a Value> {
    list(root, key).get(index(place)?)
}

/// The bytes of a bufferView; none of a view that is not in order.
fn bytes<'a>(view: &Value, bin: &'a [u8]) -> &'a [u8] {
    let range = || {
        let start = index(view.get("byteOffset").unwrap_or(&Value::from(0)))?;
        bin.get(start..start.checked_add(index(&view["byteLength"])?)?)
    };
    range().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn glb(json: &Value, bin: &[u8]) -> Vec<u8> {
        let json = json.to_string().into_bytes();
        let chunk = |kind: &[u8], bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes(), kind, bytes].concat();
        [&b"glTF"[..], &2u32.to_le_bytes(), &[0; 4], &chunk(b"JSON", &json), &chunk(b"BIN\0", bin)].concat()
    }

    /// A triangle's lightmap coordinates in view 0, the lightmap in view 1, positions in view 2.
    fn level() -> (Value, Vec<u8>) {
        let view = |start: usize, length: usize| json!({ "buffer": 0, "byteOffset": start, "byteLength": length });
        let json = json!({
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 1, "TEXCOORD_1": 0 }, "material": 0 }] }],
            "accessors": [{ "bufferView": 0, "count": 3 }, { "bufferView": 2, "count": 3 }],
            "materials": [{
                "extensions": { "MOZ_lightmap": { "index": 0, "texCoord": 1, "intensity": 3.0 } },
                "extras": { "luxel": { "page": 0 } },
            }],
            "textures": [{ "name": "lightmap 0 to 3 lux", "source": 0, "extras": { "luxel": { "lightmap": "a.exr" } } }],
            "images": [{ "name": "lightmap 0 to 3 lux", "bufferView": 1 }],
            "buffers": [{ "byteLength": 12 }],
            "bufferViews": [view(0, 4), view(4, 4), view(8, 4)],
        });
        (json, b"uv01png0pos0".to_vec())
    }

    #[test]
    fn digests_tell_light_from_layout_and_the_rest() {
        let (json, bin) = level();
        let first = digests(&glb(&json, &bin)).unwrap();
        let after = |edit: &dyn Fn(&mut Value, &mut Vec<u8>)| {
            let (mut json, mut bin) = level();
            edit(&mut json, &mut bin);
            let now = digests(&glb(&json, &bin)).unwrap();
            (now.layout == first.layout, now.content == first.content)
        };
        let brighter = after(&|json, bin| {
            bin.splice(4..8, *b"other png");
            json["bufferViews"][1]["byteLength"] = 9.into();
            json["bufferViews"][2]["byteOffset"] = 13.into();
            json["buffers"][0]["byteLength"] = bin.len().into();
            json["materials"][0]["extensions"]["MOZ_lightmap"]["intensity"] = 4.0.into();
            json["textures"][0]["name"] = "lightmap 0 to 4 lux".into();
            json["images"][0]["name"] = "lightmap 0 to 4 lux".into();
        });
        assert_eq!(brighter, (true, true));
        assert_eq!(after(&|_, bin| bin[11] = b'1'), (true, false), "something has moved");
        assert_eq!(after(&|json, _| json["materials"][0]["name"] = "red".into()), (true, false));
        assert_eq!(after(&|_, bin| bin[1] = b'w'), (false, false), "unwrapped anew");
        assert_eq!(after(&|json, _| json["materials"][0]["extras"]["luxel"]["page"] = 1.into()), (false, false));
    }

    #[test]
    fn what_is_no_glb_has_none_and_damage_is_survived() {
        let (json, bin) = level();
        let whole = glb(&json, &bin);
        let end_of_json = whole.len() - bin.len() - 8;
        for cut in 0..whole.len() {
            assert_eq!(digests(&whole[..cut]).is_some(), cut >= end_of_json, "{cut}");
        }
        for broken in [json!([]), json!(1), json!({ "meshes": 1, "images": [1], "bufferViews": {} }), json!({})] {
            digests(&glb(&broken, &bin));
        }
        let (mut json, bin) = level();
        json["bufferViews"][2] = json!({ "byteOffset": u64::MAX, "byteLength": u64::MAX });
        assert!(digests(&glb(&json, &bin)).is_some());
    }
}
