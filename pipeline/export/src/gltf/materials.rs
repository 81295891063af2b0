//! Materials that carry a lightmap: one copy per material and page, with `MOZ_lightmap`.
//!
//! `MOZ_lightmap { index, texCoord, intensity }` on the material; the texel times `intensity` is E in lux, which is
//! what three.js multiplies by albedo / π. `extras.luxel` names the file with the full range.

use std::collections::BTreeMap;

use luxel_scene::import::Checked;
use serde_json::{Value, json};

use super::{
    bitmap::Bitmap,
    draft::{Draft, Target, settle_copies},
    json::{Object, add_extra, declare_extension, item, list_mut, number, object_mut, remove_extension},
    mismatch,
    original::Original,
    references,
};

const EXTENSION: &str = "MOZ_lightmap";
/// The texture coordinate set that holds atlas coordinates.
pub const SET: usize = 1;

/// A page as materials refer to it.
pub struct PageTexture {
    pub bitmap: Bitmap,
    /// Name of the file with the full range.
    pub file: String,
    texture: Option<usize>,
}

impl PageTexture {
    pub fn new(bitmap: Bitmap, file: String) -> Self {
        Self { bitmap, file, texture: None }
    }
}

/// Lightmapped copies of materials.
pub struct Materials {
    pages: Vec<PageTexture>,
    /// (material, page, set to which textures of set 1 moved) → position in `copies`.
    known: BTreeMap<(Option<usize>, u32, Option<usize>), usize>,
    copies: Vec<(Option<usize>, Value)>,
    old: usize,
    sampler: Option<usize>,
}

impl Materials {
    pub fn new(original: &Original, pages: Vec<PageTexture>) -> Self {
        let old = super::json::list(&original.root, "materials").len();
        Self { pages, known: BTreeMap::new(), copies: Vec::new(), old, sampler: None }
    }

    pub fn pages(&self) -> &[PageTexture] {
        &self.pages
    }

    /// Points a primitive, and its variants, at copies of their materials that carry the lightmap of `page`.
    pub fn apply(
        &mut self,
        draft: &mut Draft,
        original: &Original,
        primitive: &mut Object,
        page: u32,
        moved: Option<usize>,
    ) -> Checked<()> {
        if !primitive.contains_key("material") {
            primitive.insert("material".into(), self.copy(draft, original, None, page, moved)?.into());
            return Ok(());
        }
        let mut outcome = Ok(());
        references::primitive_materials(primitive, &mut |reference| {
            let Some(index) = reference.as_u64().and_then(|n| usize::try_from(n).ok()) else { return };
            // Variants are visited after the material, and none of them twice: a provisional index never comes back.
            match self.copy(draft, original, Some(index), page, moved) {
                Ok(copy) => *reference = copy.into(),
                Err(fault) => outcome = Err(fault),
            }
        });
        outcome
    }

    fn copy(
        &mut self,
        draft: &mut Draft,
        original: &Original,
        material: Option<usize>,
        page: u32,
        moved: Option<usize>,
    ) -> Checked<usize> {
        let key = (material, page, moved);
        if let Some(known) = self.known.get(&key) {
            return Ok(self.old + known);
        }
        let mut copy = match material {
            Some(index) => item(&original.root, "materials", index)?.clone(),
            None => plaster(),
        };
        remove_extension(&mut copy, EXTENSION);
        if let Some(set) = moved {
            move_sets(&mut copy, set);
        }
        let texture = self.texture(draft, page)?;
        let intensity = f64::from(self.pages[page as usize].bitmap.intensity);
        let lightmap = json!({ "index": texture, "texCoord": SET, "intensity": intensity });
        object_mut(&mut copy, "extensions")?.insert(EXTENSION.into(), lightmap);
        add_extra(&mut copy, "luxel", self.luxel(page));
        self.copies.push((material, Value::Object(copy)));
        self.known.insert(key, self.copies.len() - 1);
        Ok(self.old + self.copies.len() - 1)
    }

    fn luxel(&self, page: u32) -> Value {
        let file = &self.pages[page as usize].file;
        json!({ "lightmap": file, "page": page, "unit": "lux", "version": env!("CARGO_PKG_VERSION") })
    }

    /// The texture of a page, added when first asked for.
    fn texture(&mut self, draft: &mut Draft, page: u32) -> Checked<usize> {
        let place = || mismatch("atlas", &format!("it has no page {page}"));
        if let Some(texture) = self.pages.get(page as usize).ok_or_else(place)?.texture {
            return Ok(texture);
        }
        let sampler = match self.sampler {
            Some(sampler) => sampler,
            // Linear, no mipmaps (charts would bleed into each other), clamped.
            None => {
                let linear = json!({ "magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071 });
                push(draft, "samplers", linear)?
            }
        };
        self.sampler = Some(sampler);
        let (extra, slot) = (self.luxel(page), &mut self.pages[page as usize]);
        let view = draft.add_view(slot.bitmap.png.clone(), Target::Other);
        let name = format!("lightmap {page}");
        let image = push(draft, "images", json!({ "name": name, "bufferView": view, "mimeType": "image/png" }))?;
        let texture = json!({ "name": name, "sampler": sampler, "source": image, "extras": { "luxel": extra } });
        let texture = push(draft, "textures", texture)?;
        slot.texture = Some(texture);
        Ok(texture)
    }

    /// Gives the copies their places.
    pub fn settle(self, draft: &mut Draft) -> Checked<Vec<PageTexture>> {
        if !self.copies.is_empty() {
            declare_extension(&mut draft.root, EXTENSION)?;
        }
        // A stranger that means the old material must not get somebody's lightmap with it.
        let possible = references::possible(&draft.root);
        settle_copies(&mut draft.root, "materials", references::materials, self.copies, possible)?;
        Ok(self.pages)
    }
}

fn push(draft: &mut Draft, key: &str, value: Value) -> Checked<usize> {
    let items = list_mut(&mut draft.root, key)?;
    items.push(value);
    Ok(items.len() - 1)
}

/// What a primitive without a material was baked with.
fn plaster() -> Object {
    let base = luxel_scene::Material::default().base_color.to_array().map(decimal);
    let pbr = json!({ "baseColorFactor": base, "metallicFactor": 0.0, "roughnessFactor": 1.0 });
    Object::from_iter([("name".into(), "default".into()), ("pbrMetallicRoughness".into(), pbr)])
}

/// The shortest decimal that means the same f32, so that 0.8 stays 0.8.
fn decimal(x: f32) -> f64 {
    x.to_string().parse().unwrap_or(f64::from(x))
}

/// The set to which textures that use set 1 must move, if any does: the first that is neither an attribute of the
/// primitive nor named by its materials.
pub fn new_set(original: &Original, primitive: &Object) -> Checked<Option<usize>> {
    let mut sets = Vec::new();
    let mut primitive = primitive.clone();
    let mut outcome = Ok(());
    references::primitive_materials(&mut primitive, &mut |reference| {
        let index = reference.as_u64().and_then(|n| usize::try_from(n).ok()).unwrap_or(usize::MAX);
        match item(&original.root, "materials", index) {
            Ok(material) => collect_sets(material.clone(), &mut sets),
            Err(fault) => outcome = Err(fault),
        }
    });
    outcome?;
    if !sets.contains(&SET) {
        return Ok(None);
    }
    let attributes = primitive.get("attributes").and_then(Value::as_object);
    let taken =
        |set: &usize| sets.contains(set) || attributes.is_some_and(|a| a.contains_key(&format!("TEXCOORD_{set}")));
    Ok((SET + 1..).find(|set| !taken(set)))
}

fn collect_sets(mut material: Object, sets: &mut Vec<usize>) {
    remove_extension(&mut material, EXTENSION);
    texture_infos(&mut material, &mut |info| {
        sets.push(number(info, "texCoord").unwrap_or(0));
        sets.extend(super::json::extension(info, "KHR_texture_transform").and_then(|t| number(t, "texCoord")));
    });
}

fn move_sets(material: &mut Object, to: usize) {
    let shift = |object: &mut Object| {
        if number(object, "texCoord") == Some(SET) {
            object.insert("texCoord".into(), to.into());
        }
    };
    texture_infos(material, &mut |info| {
        shift(info);
        let transform = info.get_mut("extensions").and_then(|e| e.get_mut("KHR_texture_transform"));
        transform.and_then(Value::as_object_mut).into_iter().for_each(shift);
    });
}

/// Calls `f` on every texture reference of a material, those of extensions included: an object with an integer
/// `index`, wherever it is. The JSON reader has bounded the depth.
fn texture_infos(object: &mut Object, f: &mut dyn FnMut(&mut Object)) {
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
