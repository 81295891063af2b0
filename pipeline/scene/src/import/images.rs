//! Images: fetched and decoded only when a material needs their content, within limits, and each once.
//!
//! Roles are requested first ([`Images::request`]); [`Images::decode`] then reads and decodes whatever was asked for.
//! A texture that only serves normal or occlusion maps is never requested, so its file is not even opened.

use std::collections::BTreeMap;
use std::io::Cursor;

use image::{ImageFormat, ImageReader};
use rayon::prelude::*;

use super::buffers::Buffers;
use super::error::{Checked, Fault, FaultKind, place};
use super::files::Files;
use super::options::Limits;
use crate::{LazyPyramid, Texture};

/// What an image is used for decides how its bytes read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Colours in sRGB; alpha has no meaning and is made opaque, so that it weights nothing.
    Color,
    /// Colours in sRGB with coverage in alpha.
    ColorAndAlpha,
    /// The same under an alpha test, with the bits of the cut-off.
    Masked(u32),
    /// Linear data; alpha has no meaning.
    Data,
}

/// Textures that materials have asked for.
#[derive(Default)]
pub struct Images {
    requests: BTreeMap<(usize, Role), usize>,
}

impl Images {
    /// Index, in the scene's list of textures, of a glTF texture in a role.
    pub fn request(&mut self, buffers: &Buffers, texture: usize, role: Role) -> Checked<usize> {
        let image = source(buffers, texture)?;
        let next = self.requests.len();
        Ok(*self.requests.entry((image, role)).or_insert(next))
    }

    /// Reads and decodes everything that was requested.
    pub fn decode(self, buffers: &Buffers, files: &mut Files, limits: &Limits) -> Checked<Vec<Texture>> {
        // Fetching is serial, since it records what it reads; decoding is the slow part.
        let mut encoded: BTreeMap<usize, Vec<u8>> = BTreeMap::new();
        for (image, _) in self.requests.keys() {
            if !encoded.contains_key(image) {
                encoded.insert(*image, fetch(buffers, *image, files)?);
            }
        }
        let places: BTreeMap<usize, String> =
            encoded.keys().map(|&image| (image, buffers.document().image_place(image))).collect();
        let place_of = |image: &usize| places.get(image).map_or("image", String::as_str);
        let mut total = 0u64;
        for (image, _) in self.requests.keys() {
            let bytes = encoded.get(image).map_or(&[][..], Vec::as_slice);
            // The pyramid takes up to 16 bytes for every fourth texel and its successors, 5⅓ in all.
            total = total.saturating_add(pixels(bytes, place_of(image), limits)?.saturating_mul(4 + 6));
            if total > limits.texture_bytes {
                let what = format!("with it the decoded images take {total} bytes");
                return Err(Fault::limit(place_of(image), what, "texture_bytes", limits.texture_bytes));
            }
        }
        let decoded: Vec<Checked<(usize, image::RgbaImage)>> =
            encoded.par_iter().map(|(image, bytes)| Ok((*image, decode(bytes, place_of(image), limits)?))).collect();
        let decoded = decoded.into_iter().collect::<Checked<BTreeMap<_, _>>>()?;
        let mut textures: Vec<Texture> = vec![Texture::default(); self.requests.len()];
        for ((image, role), slot) in &self.requests {
            if let (Some(pixels), Some(texture)) = (decoded.get(image), textures.get_mut(*slot)) {
                *texture = in_role(pixels, *role, place_of(image));
            }
        }
        Ok(textures)
    }
}

/// The image of a glTF texture in a format that luxel decodes.
fn source(buffers: &Buffers, texture: usize) -> Checked<usize> {
    let root = &buffers.document().root;
    let at = |name: Option<&str>| place("texture", texture, name);
    let found = root.textures.get(texture).ok_or_else(|| Fault::invalid(at(None), "it does not exist"))?;
    let name = found.name.as_deref();
    let others = found.extensions.as_ref().map(|e| &e.others);
    let image = if found.source.value() != u32::MAX as usize {
        found.source.value()
    } else {
        let webp = others.and_then(|o| o.get("EXT_texture_webp")?.get("source")?.as_u64());
        let Some(image) = webp else {
            let formats: Vec<&str> = others.iter().flat_map(|o| o.keys()).map(String::as_str).collect();
            if formats.is_empty() {
                return Err(Fault::invalid(at(name), "it has no image"));
            }
            let what = format!("it has an image only by {}, which luxel does not read", formats.join(", "));
            let hint = "export the scene with PNG, JPEG or WebP textures (at least as a fallback)";
            return Err(Fault::unsupported(at(name), what, hint));
        };
        usize::try_from(image).unwrap_or(usize::MAX)
    };
    let count = root.images.len();
    if image >= count {
        return Err(Fault::invalid(at(name), format!("it refers to image {image}, but there are {count}")));
    }
    Ok(image)
}

fn fetch(buffers: &Buffers, index: usize, files: &mut Files) -> Checked<Vec<u8>> {
    let place = buffers.document().image_place(index);
    let image = buffers.document().root.images.get(index);
    let image = image.ok_or_else(|| Fault::invalid(&place, "it does not exist"))?;
    match (&image.buffer_view, &image.uri) {
        (Some(view), _) => Ok(buffers.view(view.value())?.to_vec()),
        (None, Some(uri)) => files.fetch(uri, &place),
        (None, None) => Err(Fault::invalid(place, "it has neither a URI nor a bufferView")),
    }
}

/// The format by content; the declared MIME type is often wrong.
fn format(bytes: &[u8], place: &str) -> Checked<ImageFormat> {
    let known = image::guess_format(bytes).ok();
    match known {
        Some(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP)) => Ok(format),
        _ => {
            let name = match bytes {
                [0xab, b'K', b'T', b'X', b' ', ..] => "a KTX (Basis) texture".to_owned(),
                [b'D', b'D', b'S', b' ', ..] => "a DDS texture".to_owned(),
                _ => known.map_or("of an unknown format".to_owned(), |f| format!("of the format {f:?}")),
            };
            let hint = "export the scene with PNG, JPEG or WebP textures";
            Err(Fault::unsupported(place, format!("it is {name}, which luxel does not read"), hint))
        }
    }
}

fn broken(place: &str, error: &image::ImageError) -> Fault {
    let hint = "open it in an image editor and save it again";
    Fault::new(FaultKind::Invalid, place, format!("it cannot be decoded: {error}"), hint)
}

/// Number of pixels by the header, within the limit.
fn pixels(bytes: &[u8], place: &str, limits: &Limits) -> Checked<u64> {
    let reader = ImageReader::with_format(Cursor::new(bytes), format(bytes, place)?);
    let (width, height) = reader.into_dimensions().map_err(|e| broken(place, &e))?;
    let pixels = u64::from(width) * u64::from(height);
    if pixels > limits.image_pixels {
        return Err(Fault::limit(
            place,
            format!("it has {width} × {height} pixels"),
            "image_pixels",
            limits.image_pixels,
        ));
    }
    if pixels == 0 {
        return Err(Fault::invalid(place, "it has no pixels"));
    }
    Ok(pixels)
}

fn decode(bytes: &[u8], place: &str, limits: &Limits) -> Checked<image::RgbaImage> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format(bytes, place)?);
    let mut bounds = image::Limits::no_limits();
    // 16-bit RGBA and as much again for the decoder's own use.
    bounds.max_alloc = Some(limits.image_pixels.saturating_mul(16));
    reader.limits(bounds);
    Ok(reader.decode().map_err(|e| broken(place, &e))?.into_rgba8())
}

fn in_role(pixels: &image::RgbaImage, role: Role, name: &str) -> Texture {
    let opaque = matches!(role, Role::Color | Role::Data);
    let texel = |p: &image::Rgba<u8>| if opaque { [p[0], p[1], p[2], 255] } else { p.0 };
    Texture {
        name: name.to_owned(),
        width: pixels.width(),
        height: pixels.height(),
        srgb: role != Role::Data,
        texels: pixels.pixels().map(texel).collect(),
        cutoff: if let Role::Masked(bits) = role { Some(f32::from_bits(bits)) } else { None },
        pyramid: LazyPyramid::default(),
    }
}
