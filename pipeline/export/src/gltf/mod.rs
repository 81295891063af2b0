//! The scene as a .glb that carries its lightmap, and nothing of the input lost.
//!
//! Everything works on the raw JSON, in its order, so that names, extras, animations, cameras and extensions that
//! luxel has never heard of go through untouched. What changes:
//!
//! | what | how | module |
//! |---|---|---|
//! | buffers | one BIN chunk; meshopt decoded, data URIs and files taken in | `original`, `draft` |
//! | images | embedded | `original` |
//! | meshes of lightmapped nodes | one copy per node, triangles, TEXCOORD_1 in atlas space | `nodes`, `vertices` |
//! | EXT_mesh_gpu_instancing | child nodes, where instances are lightmapped | `instances` |
//! | their materials | one copy per picture of a page, with `MOZ_lightmap` | `materials` |
//! | textures and images of the pages | added, or in place of an earlier bake's | `pages`, `exposure`, `bitmap` |
//!
//! No index of the input changes its meaning: copies take the slot of an original that nothing uses any more, or the
//! end of the list (`draft`). Of several buffers only the first one's name and extras can survive.

mod bitmap;
mod draft;
mod exposure;
mod instances;
mod json;
mod materials;
mod nodes;
mod original;
mod pages;
mod references;
#[cfg(test)]
mod tests;
mod vertices;

use luxel_atlas::Atlas;
use luxel_scene::import::{Checked, Fault, FaultKind};
use luxel_scene::{Notice, Progress, Scene};
use rayon::prelude::*;

pub use original::Original;

use self::{draft::Draft, exposure::Pictures, materials::Materials, nodes::Nodes, pages::PageTexture};
use crate::{Effort, ExportError, Lightmap};

/// A finished .glb.
#[derive(Clone, Debug)]
pub struct Glb {
    pub bytes: Vec<u8>,
    /// One per atlas page.
    pub pages: Vec<PageStats>,
    pub notices: Vec<Notice>,
}

/// How a page fared in 8 bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageStats {
    /// E (lux) of a full byte of its brightest picture.
    pub intensity: f32,
    /// Pictures of the page.
    pub pictures: usize,
    /// Texels that were clipped.
    pub clipped: usize,
}

impl Original {
    /// The scene with its lightmap. `lightmaps` holds one image per atlas page, `names` the file names of the images
    /// with the full range. The scene and the atlas must have been made from this very file.
    pub fn lightmapped(
        &self,
        scene: &Scene,
        atlas: &Atlas,
        lightmaps: &[Lightmap],
        names: &[String],
        effort: Effort,
        progress: &dyn Progress,
    ) -> Result<Glb, ExportError> {
        if lightmaps.len() != atlas.pages.len() || names.len() != atlas.pages.len() {
            let fault = format!("{} images for {} pages", lightmaps.len(), atlas.pages.len());
            return Err(ExportError::Image { what: "lightmap".into(), fault });
        }
        let pictures = Pictures::new(atlas, lightmaps, progress)?;
        let texture = |picture: &exposure::Picture| {
            let page = picture.page as usize;
            let png = bitmap::png(&lightmaps[page], picture.intensity, effort, progress)?;
            Ok(PageTexture { picture: *picture, png, file: names[page].clone() })
        };
        let textures = pictures.list.par_iter().map(texture).collect::<Result<_, ExportError>>()?;
        self.check_unchanged(&scene.inputs)?;
        self.write(scene, atlas, &pictures, textures, progress).map_err(|fault| fault.in_file(&self.path).into())
    }

    fn write(
        &self,
        scene: &Scene,
        atlas: &Atlas,
        pictures: &Pictures,
        textures: Vec<PageTexture>,
        progress: &dyn Progress,
    ) -> Checked<Glb> {
        let mut draft = Draft::new(self);
        let nodes = Nodes::new(self, Materials::new(self, textures), atlas.pages.len() > 1);
        let mut notices = self.notices.clone();
        let materials = nodes.place(&mut draft, scene, atlas, pictures, &mut notices, progress)?;
        materials.settle(&mut draft)?;
        Ok(Glb { bytes: draft.finish(progress)?, pages: stats(pictures), notices })
    }
}

fn stats(pictures: &Pictures) -> Vec<PageStats> {
    let page = |(page, clipped): (u32, &usize)| {
        let mine: Vec<f32> = pictures.list.iter().filter(|p| p.page == page).map(|p| p.intensity).collect();
        PageStats { intensity: mine.first().copied().unwrap_or(1.0), pictures: mine.len(), clipped: *clipped }
    };
    (0..).zip(&pictures.clipped).map(page).collect()
}

/// The scene or its atlas is not of this file.
fn mismatch(place: impl Into<String>, what: &str) -> Fault {
    Fault::new(FaultKind::Invalid, place, what, "bake the scene again")
}

/// Bytes that are copied between two looks at the progress: some milliseconds.
const COPIED: usize = 1 << 24;

/// A binary glTF of a JSON text and its buffer.
fn glb_bytes(mut json: Vec<u8>, bin: &[u8], progress: &dyn Progress) -> Checked<Vec<u8>> {
    json.resize(json.len().next_multiple_of(4), b' ');
    let padded = bin.len().next_multiple_of(4);
    let bin_chunk = if bin.is_empty() { 0 } else { 8 + padded };
    let too_large = |_| {
        let hint = "bake the scene in several parts, or with smaller textures";
        Fault::new(FaultKind::Limit, "GLB container", "it would have more than the 4 GiB that it can count", hint)
    };
    let word = |n: usize| u32::try_from(n).map(u32::to_le_bytes).map_err(too_large);
    let total = 12 + 8 + json.len() + bin_chunk;
    let mut bytes = Vec::with_capacity(total);
    bytes.extend_from_slice(b"glTF");
    bytes.extend(word(2)?);
    bytes.extend(word(total)?);
    bytes.extend(word(json.len())?);
    bytes.extend_from_slice(b"JSON");
    bytes.extend(json);
    if !bin.is_empty() {
        bytes.extend(word(padded)?);
        bytes.extend_from_slice(b"BIN\0");
        for piece in bin.chunks(COPIED) {
            progress.check()?;
            bytes.extend_from_slice(piece);
        }
        bytes.resize(total, 0);
    }
    Ok(bytes)
}
