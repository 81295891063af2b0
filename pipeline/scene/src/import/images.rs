//! Images: fetched and decoded only when a material needs their content, within limits, and each once.
//!
//! Textures are requested first ([`Images::request`]); [`Images::decode`] then reads and decodes whatever was asked for.
//! A texture that only serves normal or occlusion maps is never requested, so its file is not even opened.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

use image::{ImageFormat, ImageReader};
use rayon::prelude::*;

use super::buffers::Buffers;
use super::error::{Bound, Checked, Fault, FaultKind, place};
use super::files::Files;
use super::options::Limits;
use crate::{AlphaUse, Averages, Cancelled, Progress, Texture, TextureRef, Watched};

/// How an image's bytes read as colours: sRGB, or linear data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Encoding {
    Srgb,
    Linear,
}

/// Textures that materials have asked for.
#[derive(Default)]
pub struct Images {
    requests: BTreeMap<(usize, Encoding), usize>,
    /// Averages that uses of one texture can share: by texture and what its alpha means.
    averages: BTreeMap<(usize, Option<u32>), Arc<Averages>>,
}

impl Images {
    /// A reference, with default coordinates, to a glTF texture.
    pub fn request(
        &mut self,
        buffers: &Buffers,
        texture: usize,
        encoding: Encoding,
        alpha: AlphaUse,
    ) -> Checked<TextureRef> {
        let image = source(buffers, texture)?;
        let next = self.requests.len();
        let index = *self.requests.entry((image, encoding)).or_insert(next);
        let key = match alpha {
            AlphaUse::Ignored => None,
            // No cut-off is below 0, so a test and mere coverage cannot be mixed up.
            AlphaUse::Coverage => Some((-1.0f32).to_bits()),
            AlphaUse::Test(cutoff) => Some(cutoff.to_bits()),
        };
        let averages = Arc::clone(self.averages.entry((index, key)).or_default());
        Ok(TextureRef { averages, ..TextureRef::new(index) })
    }

    /// Reads and decodes everything that was requested.
    pub fn decode(
        self,
        buffers: &Buffers,
        files: &mut Files,
        limits: &Limits,
        progress: &dyn Progress,
    ) -> Checked<Vec<Texture>> {
        // Fetching is serial, since it records what it reads; decoding is the slow part.
        let mut encoded: BTreeMap<usize, Cow<[u8]>> = BTreeMap::new();
        for (image, _) in self.requests.keys() {
            if !encoded.contains_key(image) {
                encoded.insert(*image, fetch(buffers, *image, files, progress)?);
            }
        }
        let places: BTreeMap<usize, String> =
            encoded.keys().map(|&image| (image, buffers.document().image_place(image))).collect();
        let place_of = |image: &usize| places.get(image).map_or("image", String::as_str);
        let mut total = 0u64;
        for (image, _) in self.requests.keys() {
            let bytes = encoded.get(image).map_or(&[][..], |bytes| bytes);
            // Averages take 16 bytes for every fourth texel and its successors, 5⅓ in all.
            total = total.saturating_add(pixels(bytes, place_of(image), limits)?.saturating_mul(4 + 6));
            if total > limits.texture_bytes {
                let what = format!("with it the decoded images take {total} bytes");
                return Err(Fault::limit(place_of(image), what, Bound::TextureBytes, limits.texture_bytes));
            }
        }
        let one = |(image, bytes): (&usize, &Cow<[u8]>)| {
            progress.check()?;
            Ok((*image, decode(bytes, place_of(image), limits, progress)?))
        };
        let decoded: Vec<Checked<(usize, image::RgbaImage)>> = encoded.par_iter().map(one).collect();
        let decoded = decoded.into_iter().collect::<Checked<BTreeMap<_, _>>>()?;
        let mut textures: Vec<Texture> = vec![Texture::default(); self.requests.len()];
        for ((image, encoding), slot) in &self.requests {
            if let (Some(pixels), Some(target)) = (decoded.get(image), textures.get_mut(*slot)) {
                *target = texture(pixels, *encoding, place_of(image), progress)?;
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

/// The bytes of an image, where they lie in a buffer: any number of images may name the same view.
fn fetch<'b>(buffers: &'b Buffers, index: usize, files: &mut Files, progress: &dyn Progress) -> Checked<Cow<'b, [u8]>> {
    let place = buffers.document().image_place(index);
    let image = buffers.document().root.images.get(index);
    let image = image.ok_or_else(|| Fault::invalid(&place, "it does not exist"))?;
    match (&image.buffer_view, &image.uri) {
        (Some(view), _) => Ok(Cow::Borrowed(buffers.view(view.value())?)),
        (None, Some(uri)) => Ok(Cow::Owned(files.fetch_with(uri, &place, progress)?)),
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
            Bound::ImagePixels,
            limits.image_pixels,
        ));
    }
    if pixels == 0 {
        return Err(Fault::invalid(place, "it has no pixels"));
    }
    Ok(pixels)
}

/// Looks at the progress wherever the decoder asks for bytes: PNG's does all the way, the others take all bytes first.
fn decode(bytes: &[u8], place: &str, limits: &Limits, progress: &dyn Progress) -> Checked<image::RgbaImage> {
    let mut reader = ImageReader::with_format(Watched::new(Cursor::new(bytes), progress), format(bytes, place)?);
    let mut bounds = image::Limits::no_limits();
    // 16-bit RGBA and as much again for the decoder's own use.
    bounds.max_alloc = Some(limits.image_pixels.saturating_mul(16));
    reader.limits(bounds);
    let decoded = reader.decode();
    // What was cancelled is not broken.
    progress.check()?;
    Ok(decoded.map_err(|e| broken(place, &e))?.into_rgba8())
}

fn texture(
    pixels: &image::RgbaImage,
    encoding: Encoding,
    name: &str,
    progress: &dyn Progress,
) -> Result<Texture, Cancelled> {
    let mut texels = Vec::with_capacity(pixels.pixels().len());
    for row in pixels.rows() {
        progress.check()?;
        texels.extend(row.map(|p| p.0));
    }
    Ok(Texture {
        name: name.to_owned(),
        width: pixels.width(),
        height: pixels.height(),
        srgb: encoding == Encoding::Srgb,
        texels,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encoded(image: image::DynamicImage, format: ImageFormat) -> Vec<u8> {
        let mut out = Vec::new();
        image.write_to(&mut Cursor::new(&mut out), format).unwrap();
        out
    }

    fn read(bytes: &[u8]) -> Checked<image::RgbaImage> {
        let limits = Limits { image_pixels: 100, ..Limits::default() };
        pixels(bytes, "image 0", &limits)?;
        decode(bytes, "image 0", &limits, &crate::Silent)
    }

    #[test]
    fn png_jpeg_and_webp_are_read_whatever_their_depth() {
        let deep = image::ImageBuffer::from_pixel(5, 3, image::Rgba([65535u16, 32896, 0, 257]));
        let deep = encoded(image::DynamicImage::ImageRgba16(deep), ImageFormat::Png);
        assert_eq!(read(&deep).unwrap().get_pixel(4, 2).0, [255, 128, 0, 1]);
        let grey =
            encoded(image::DynamicImage::ImageLuma8(image::GrayImage::from_pixel(4, 4, [7].into())), ImageFormat::Png);
        assert_eq!(read(&grey).unwrap().get_pixel(0, 0).0, [7, 7, 7, 255]);
        let color = image::DynamicImage::ImageRgb8(image::RgbImage::from_pixel(8, 8, [200, 100, 50].into()));
        assert_eq!(read(&encoded(color.clone(), ImageFormat::WebP)).unwrap().get_pixel(3, 3).0, [200, 100, 50, 255]);
        let jpeg = read(&encoded(color, ImageFormat::Jpeg)).unwrap();
        assert!(jpeg.get_pixel(3, 3).0.iter().zip([200u8, 100, 50, 255]).all(|(a, b)| a.abs_diff(b) < 5));
    }

    #[test]
    fn large_damaged_and_foreign_images_are_refused() {
        let large = encoded(image::DynamicImage::new_rgb8(11, 10), ImageFormat::Png);
        assert_eq!(read(&large).unwrap_err().kind, FaultKind::Limit);
        let small = encoded(image::DynamicImage::new_rgb8(4, 4), ImageFormat::Png);
        for n in 0..small.len() - 16 {
            assert!(read(&small[..n]).is_err(), "{n}");
        }
        let ktx = read(b"\xabKTX 20\xbb\r\n\x1a\n").unwrap_err();
        assert!(ktx.kind == FaultKind::Unsupported && ktx.what.contains("Basis"), "{ktx}");
        assert!(read(b"GIF89a").unwrap_err().what.contains("Gif"));
    }
}
