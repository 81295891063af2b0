//! Pictures of atlas pages as textures of the document.
//!
//! While materials are copied, the pictures in use have provisional texture indices past the end of the list. When all
//! materials have their places, the pictures take the slots of textures and images that an earlier bake left (they carry
//! `extras.luxel`) and that nobody uses any more, and only then go to the end: so a scene that is baked again and again
//! does not grow.

use std::collections::BTreeSet;

use luxel_scene::import::Checked;
use serde_json::{Value, json};

use super::{
    draft::{Draft, Target, follow, put_item},
    exposure::Picture,
    json::{self, Object, list, list_mut},
    mismatch,
    original::Original,
    references,
};

/// A picture of a page as materials refer to it.
pub struct PageTexture {
    pub picture: Picture,
    pub png: Vec<u8>,
    /// Name of the file with the full range.
    pub file: String,
}

/// All pictures of the atlas, and which of them the document shows.
pub struct Pages {
    list: Vec<PageTexture>,
    /// Pictures in the order in which materials first asked for them; the position is that of the provisional index.
    shown: Vec<usize>,
    old: usize,
}

impl Pages {
    pub fn new(original: &Original, list: Vec<PageTexture>) -> Self {
        Self { list, shown: Vec::new(), old: json::list(&original.root, "textures").len() }
    }

    /// The provisional texture index of a picture, the intensity of its bytes, and [`mark`].
    pub fn texture(&mut self, picture: usize) -> Checked<(usize, f64, Value)> {
        let missing = || mismatch("atlas", &format!("it has no picture {picture}"));
        let texture = self.list.get(picture).ok_or_else(missing)?;
        let position = self.shown.iter().position(|p| *p == picture).unwrap_or_else(|| {
            self.shown.push(picture);
            self.shown.len() - 1
        });
        Ok((self.old + position, texture.picture.intensity.into(), mark(texture)))
    }

    /// Gives the textures and images their places. All materials must have theirs.
    pub fn settle(mut self, draft: &mut Draft) -> Checked<()> {
        if self.shown.is_empty() {
            return Ok(());
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
        for ((picture, slot), image) in self.shown.iter().zip(slots).zip(image_slots) {
            let shown = &mut self.list[*picture];
            let name = format!("lightmap {} to {} lux", shown.picture.page, shown.picture.intensity);
            let extras = json!({ "luxel": mark(shown) });
            let view = draft.add_view(std::mem::take(&mut shown.png), Target::Other);
            let picture = json!({ "name": name, "bufferView": view, "mimeType": "image/png" });
            put_item(&mut draft.root, "images", image, picture)?;
            let texture = json!({ "name": name, "sampler": sampler, "source": image, "extras": extras });
            put_item(&mut draft.root, "textures", slot, texture)?;
        }
        Ok(())
    }
}

/// `extras.luxel` of what shows a page.
fn mark(texture: &PageTexture) -> Value {
    let page = texture.picture.page;
    json!({ "lightmap": texture.file, "page": page, "unit": "lux", "version": env!("CARGO_PKG_VERSION") })
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
