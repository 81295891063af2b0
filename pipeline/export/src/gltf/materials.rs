//! Materials that carry a lightmap: one copy per material and picture of a page, with `MOZ_lightmap`.
//!
//! `MOZ_lightmap { index, texCoord, intensity }` on the material; the texel times `intensity` is E in lux, which is
//! what three.js multiplies by albedo / π. `extras.luxel` names the file with the full range.

use std::collections::BTreeMap;

use luxel_scene::import::Checked;
use serde_json::{Value, json};

use super::{
    draft::{Draft, settle_copies},
    json::{Object, add_extra, declare_extension, item, number, object_mut, remove_extension},
    original::Original,
    pages::{PageTexture, Pages},
    references,
};

/// The texture coordinate set that holds atlas coordinates.
pub const SET: usize = 1;

/// Lightmapped copies of materials.
pub struct Materials {
    pages: Pages,
    /// (material, picture, set to which textures of set 1 moved) → position in `copies`.
    known: BTreeMap<(Option<usize>, usize, Option<usize>), usize>,
    copies: Vec<(Option<usize>, Value)>,
    old: usize,
}

impl Materials {
    pub fn new(original: &Original, pages: Vec<PageTexture>) -> Self {
        let old = super::json::list(&original.root, "materials").len();
        Self { pages: Pages::new(original, pages), known: BTreeMap::new(), copies: Vec::new(), old }
    }

    /// Points a primitive, and its variants, at copies of their materials that carry the lightmap's `picture`.
    pub fn apply(
        &mut self,
        original: &Original,
        primitive: &mut Object,
        picture: usize,
        moved: Option<usize>,
    ) -> Checked<()> {
        if !primitive.contains_key("material") {
            primitive.insert("material".into(), self.copy(original, None, picture, moved)?.into());
            return Ok(());
        }
        let mut outcome = Ok(());
        references::primitive_materials(primitive, &mut |reference| {
            let Some(index) = super::json::index(reference) else { return };
            // Variants are visited after the material, and none of them twice: a provisional index never comes back.
            match self.copy(original, Some(index), picture, moved) {
                Ok(copy) => *reference = copy.into(),
                Err(fault) => outcome = Err(fault),
            }
        });
        outcome
    }

    fn copy(
        &mut self,
        original: &Original,
        material: Option<usize>,
        picture: usize,
        moved: Option<usize>,
    ) -> Checked<usize> {
        let key = (material, picture, moved);
        if let Some(known) = self.known.get(&key) {
            return Ok(self.old + known);
        }
        let mut copy = match material {
            Some(index) => item(&original.root, "materials", index)?.clone(),
            None => plaster(),
        };
        remove_extension(&mut copy, references::LIGHTMAP);
        if let Some(set) = moved {
            move_sets(&mut copy, set);
        }
        let (texture, intensity, mark) = self.pages.texture(picture)?;
        let lightmap = json!({ "index": texture, "texCoord": SET, "intensity": intensity });
        object_mut(&mut copy, "extensions")?.insert(references::LIGHTMAP.into(), lightmap);
        add_extra(&mut copy, "luxel", mark);
        self.copies.push((material, Value::Object(copy)));
        self.known.insert(key, self.copies.len() - 1);
        Ok(self.old + self.copies.len() - 1)
    }

    /// Gives the copies and the textures of the pages their places.
    pub fn settle(self, draft: &mut Draft) -> Checked<()> {
        if !self.copies.is_empty() {
            declare_extension(&mut draft.root, references::LIGHTMAP)?;
        }
        // A stranger that means the old material must not get somebody's lightmap with it.
        let possible = references::possible(&draft.root);
        settle_copies(&mut draft.root, "materials", references::materials, self.copies, possible)?;
        self.pages.settle(draft)
    }
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
        let index = super::json::index(reference).unwrap_or(usize::MAX);
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
    remove_extension(&mut material, references::LIGHTMAP);
    references::texture_infos(&mut material, &mut |info| {
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
    references::texture_infos(material, &mut |info| {
        shift(info);
        let transform = info.get_mut("extensions").and_then(|e| e.get_mut("KHR_texture_transform"));
        transform.and_then(Value::as_object_mut).into_iter().for_each(shift);
    });
}
