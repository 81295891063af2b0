//! Atlas pages as textures of the document.
//!
//! While materials are copied, the pages in use have provisional texture indices past the end of the list. When all
//! materials have their places, the pages take the slots of textures and images that an earlier bake left (they carry
//! `extras.luxel`) and that nobody uses any more, and only then go to the end: so a scene that is baked again and again
//! does not grow.

use std::collections::BTreeSet;

use luxel_scene::import::Checked;
use serde_json::{Value, json};

use super::{
    bitmap::Bitmap,
    draft::{Draft, Target, follow, put_item},
    json::{self, Object, list, list_mut},
    mismatch,
    original::Original,
    references,
};

/// A page as materials refer to it.
pub struct PageTexture {
    pub bitmap: Bitmap,
    /// Name of the file with the full range.
    pub file: String,
}

/// All pages of the atlas, and which of them the document shows.
pub struct Pages {
    pub list: Vec<PageTexture>,
    /// Pages in the order in which materials first asked for them; the position is that of the provisional index.
    shown: Vec<u32>,
    old: usize,
}

impl Pages {
    pub fn new(original: &Original, list: Vec<PageTexture>) -> Self {
        Self { list, shown: Vec::new(), old: json::list(&original.root, "textures").len() }
    }

    /// The provisional texture index of a page, and the intensity of its bytes.
    pub fn texture(&mut self, page: u32) -> Checked<(usize, f64)> {
        let missing = || mismatch("atlas", &format!("it has no page {page}"));
        let intensity = self.list.get(page as usize).ok_or_else(missing)?.bitmap.intensity;
        let position = self.shown.iter().position(|p| *p == page).unwrap_or_else(|| {
            self.shown.push(page);
            self.shown.len() - 1
        });
        Ok((self.old + position, intensity.into()))
    }

    /// `extras.luxel` of what shows a page.
    pub fn mark(&self, page: u32) -> Value {
        let file = &self.list[page as usize].file;
        json!({ "lightmap": file, "page": page, "unit": "lux", "version": env!("CARGO_PKG_VERSION") })
    }

    /// Gives the textures and images their places. All materials must have theirs.
    pub fn settle(self, draft: &mut Draft) -> Checked<Vec<PageTexture>> {
        if self.shown.is_empty() {
            return Ok(self.list);
        }
        let possible = references::possible(&draft.root);
        let textures = list(&draft.root, "textures");
        let marked = |i: &usize| textures[*i]["extras"]["luxel"]["lightmap"].is_string();
        let ours: BTreeSet<usize> = (0..textures.len()).filter(marked).collect();
        let our_images: BTreeSet<usize> = ours.iter().flat_map(|i| sources(&textures[*i])).collect();
        let used = references::used(&mut draft.root, references::textures);
        let slots = free(&ours, &used, &possible, self.old, self.shown.len());
        let textures = list(&draft.root, "textures");
        let stay = |(i, texture): (usize, &Value)| if slots.contains(&i) { Vec::new() } else { sources(texture) };
        let used: BTreeSet<usize> = textures.iter().enumerate().flat_map(stay).collect();
        let old_images = list(&draft.root, "images").len();
        let image_slots = free(&our_images, &used, &possible, old_images, self.shown.len());
        follow(&mut draft.root, references::lightmaps, self.old, &slots);
        let sampler = sampler(&mut draft.root)?;
        for ((page, slot), image) in self.shown.iter().zip(slots).zip(image_slots) {
            let name = format!("lightmap {page}");
            let extras = json!({ "luxel": self.mark(*page) });
            let view = draft.add_view(self.list[*page as usize].bitmap.png.clone(), Target::Other);
            let picture = json!({ "name": name, "bufferView": view, "mimeType": "image/png" });
            put_item(&mut draft.root, "images", image, picture)?;
            let texture = json!({ "name": name, "sampler": sampler, "source": image, "extras": extras });
            put_item(&mut draft.root, "textures", slot, texture)?;
        }
        Ok(self.list)
    }
}

/// Indices for `count` new items: of `ours` those that are neither used nor possibly so, then from the end on.
fn free(
    ours: &BTreeSet<usize>,
    used: &BTreeSet<usize>,
    possible: &BTreeSet<usize>,
    end: usize,
    count: usize,
) -> Vec<usize> {
    let free = ours.iter().copied().filter(|i| *i < end && !used.contains(i) && !possible.contains(i));
    free.chain(end..).take(count).collect()
}

/// The images of a texture, those by extensions included.
fn sources(texture: &Value) -> Vec<usize> {
    let extensions = texture["extensions"].as_object().into_iter().flat_map(Object::values);
    let all = [texture].into_iter().chain(extensions).filter_map(|t| json::index(&t["source"]));
    all.collect()
}

/// A sampler for lightmaps: linear, no mipmaps (charts would bleed into each other), clamped. One that is there
/// already does as well.
fn sampler(root: &mut Object) -> Checked<usize> {
    let linear = json!({ "magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071 });
    let samplers = list_mut(root, "samplers")?;
    Ok(samplers.iter().position(|s| *s == linear).unwrap_or_else(|| {
        samplers.push(linear);
        samplers.len() - 1
    }))
}
