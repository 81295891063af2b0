//! Error maps: the atlas as it is baked, as the reference has it, and the difference, side by side.
//!
//! The difference is signed and relative to the mean irradiance: white where there is none, red where the bake is too
//! bright, blue where it is too dark, full colour at ten per cent. Texels that do not count, as those inside other
//! geometry, are grey.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use luxel_atlas::Atlas;
use luxel_export::png::{Image8, encode_png};
use luxel_export::tonemap::ToneMap;
use luxel_scene::{Progress, Scene};

use super::keys;
use super::small::{self, Small};
use super::truth::{self, Exactness};
use crate::Error;
use crate::bake::{
    artefact,
    digest::Digest,
    lab::{self, Lab},
};
use crate::settings::Settings;
use crate::store::{Kind, Reader, Store};

/// Side of a mapped atlas: every texel takes paths.
const SIDE: u32 = 96;

/// Pixels along the side of a page, about.
const SHOWN: u32 = 384;

/// Share of the mean at which the difference has its full colour.
pub const FULL: f64 = 0.1;

/// Pixels between the pictures.
const GAP: u32 = 8;

/// A third of a percent of a picture is not seen, and costs much.
const TRUTH: Exactness = Exactness { texels: usize::MAX, noise: 0.01, paths: 8192 };

/// Paths of all texels together, at most.
const WALKS: usize = 1 << 26;

const NOTHING: [u8; 3] = [96, 96, 96];

/// Side of the atlas that is mapped, if it holds the scene. Who asks for a larger one than the report's usual one has it.
pub fn side(base: &Settings) -> u32 {
    if base.size.0 > super::budget::SIDE { base.size.0 } else { SIDE }
}

/// The place of the texels of the bake that is mapped.
///
/// # Errors
/// As a bake.
pub fn lay_out(scene: &Scene, base: &Settings, store: &Store, progress: &dyn Progress) -> Result<Small, Error> {
    small::lay_out(scene, base, (side(base), base.size.0.max(side(base))), Some(store), progress)
}

/// The picture as PNG: baked, reference, difference. The laboratory's settings are those with which the atlas was laid out.
///
/// # Errors
/// As a bake.
pub fn draw(
    lab: &Lab,
    atlas: &Arc<Atlas>,
    most: &Exactness,
    store: Option<&Store>,
    progress: &dyn Progress,
) -> Result<Vec<u8>, Error> {
    let paths = TRUTH.paths.min(most.paths).min((WALKS / atlas.texels.len().max(1)) as u32).max(1);
    let how = Exactness { noise: TRUTH.noise.max(most.noise), paths, ..TRUTH };
    let texels = truth::texels(lab, atlas, TRUTH.texels);
    let truth = truth::truth(lab, texels, (&how, "maps"), store, progress)?;
    let baked = baked(lab, atlas, store, progress)?;
    let expected: BTreeMap<usize, Vec3> = truth.points.iter().map(|p| (p.texel, p.light.total)).collect();
    let counts = |i: usize| expected.contains_key(&i);
    let found = |i: usize| baked[i];
    let known = |i: usize| expected[&i];
    let lit: Vec<Vec3> = expected.values().copied().collect();
    let tone = ToneMap::auto(&lit, progress)?;
    let mean = truth.mean().max(f64::MIN_POSITIVE);
    let difference = |i: usize| {
        let d = f64::from((found(i) - known(i)).element_sum()) / 3.0 / mean;
        signed(d / FULL)
    };
    let encode = |light: Vec3| tone.encode(light);
    let panels: [&dyn Fn(usize) -> [u8; 3]; 3] = [&|i| encode(found(i)), &|i| encode(known(i)), &difference];
    Ok(encode_png(&sheet(atlas, lab.settings.size.0, &panels, &counts))?)
}

/// What a bake finds at all texels [lux], made or read.
fn baked(lab: &Lab, atlas: &Arc<Atlas>, store: Option<&Store>, progress: &dyn Progress) -> Result<Vec<Vec3>, Error> {
    let digest = keys::versions(Digest::new("map")).bytes(&lab.identity());
    let key = keys::lasting(digest, lab.settings).done();
    let read = |body: &mut Reader| artefact::light(body, atlas.texels.len());
    if let Some(stored) = store.and_then(|store| store.get(Kind::Map, &key, read)) {
        return Ok(stored);
    }
    let parts = lab::attempt(lab.scene(), lab.settings, atlas, progress)?.parts;
    let light: Vec<Vec3> = (0..atlas.texels.len()).map(|i| parts.total(i)).collect();
    if let Some(store) = store {
        store.put(Kind::Map, &key, |out| artefact::put_slice(out, &light));
    }
    Ok(light)
}

/// White at 0, red at 1, blue at −1.
fn signed(share: f64) -> [u8; 3] {
    let fade = |full: f64| (255.0 * (1.0 - full.clamp(0.0, 1.0))) as u8;
    if share >= 0.0 { [255, fade(share), fade(share)] } else { [fade(-share), fade(-share), 255] }
}

/// All pages of so many texels along a side, each in three pictures side by side.
fn sheet(
    atlas: &Arc<Atlas>,
    texels: u32,
    panels: &[&dyn Fn(usize) -> [u8; 3]; 3],
    counts: &dyn Fn(usize) -> bool,
) -> Image8 {
    let zoom = (SHOWN / texels).max(1);
    let side = texels * zoom;
    let pages = atlas.pages.len().max(1) as u32;
    let (width, height) = (3 * side + 2 * GAP, pages * side + (pages - 1) * GAP);
    let mut image = Image8 { width, height, texels: vec![[255; 3]; (width * height) as usize] };
    for (column, colour) in panels.iter().enumerate() {
        let left = column as u32 * (side + GAP);
        for page in 0..pages {
            fill(&mut image, (left, page * (side + GAP), side, side), [40, 40, 40]);
        }
        for (i, texel) in atlas.texels.iter().enumerate() {
            let colour = if counts(i) { colour(i) } else { NOTHING };
            let top = atlas.chart(texel).page * (side + GAP);
            let at = (left + u32::from(texel.x) * zoom, top + u32::from(texel.y) * zoom, zoom, zoom);
            fill(&mut image, at, colour);
        }
    }
    image
}

fn fill(image: &mut Image8, (x, y, width, height): (u32, u32, u32, u32), colour: [u8; 3]) {
    for row in y..(y + height).min(image.height) {
        let start = (row * image.width + x) as usize;
        image.texels[start..start + width as usize].fill(colour);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_is_red_above_and_blue_below() {
        assert_eq!([0.0, 1.0, 7.0, -1.0].map(signed), [[255; 3], [255, 0, 0], [255, 0, 0], [0, 0, 255]]);
        assert_eq!(signed(0.5), [255, 127, 127]);
    }
}
