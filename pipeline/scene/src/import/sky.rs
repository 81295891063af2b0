//! Equirectangular skies from .hdr (Radiance RGBE) and .exr files.

use std::io::Cursor;
use std::path::Path;

use exr::prelude::{ReadChannels, ReadLayers, f16};
use glam::Vec3;
use image::ImageDecoder;

use super::error::{Bound, Checked, Fault, FaultKind, ImportError};
use super::files::Files;
use super::options::Limits;
use crate::sky::SkyImage;
use crate::{InputFile, Notice, Progress, Watched};

/// A sky image with what a report should know about it.
#[derive(Clone, Debug)]
pub struct LoadedSky {
    /// Radiance as stored, strength 1, not rotated.
    pub image: SkyImage,
    /// What was repaired.
    pub notices: Vec<Notice>,
    pub input: InputFile,
}

const PLACE: &str = "the sky of --sky or [sky]";

/// Reads a sky; the container is told apart by its content.
pub fn load(path: &Path, limits: &Limits, progress: &dyn Progress) -> Result<LoadedSky, ImportError> {
    // Paths of skies come from the command line and from settings files: what concerns the file as a whole says so.
    let origin = |fault: Fault| if fault.place.is_empty() { Fault { place: PLACE.into(), ..fault } } else { fault };
    read(path, limits, progress).map_err(|fault| origin(fault).in_file(path))
}

fn read(path: &Path, limits: &Limits, progress: &dyn Progress) -> Checked<LoadedSky> {
    let mut files = Files::beside(path, limits);
    let bytes = files.read_with(path, "", progress)?;
    let decoded = if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        read_exr(&bytes, limits, progress)
    } else if bytes.starts_with(b"#?") {
        read_hdr(&bytes, limits, progress)
    } else {
        let what = "it is neither a Radiance .hdr nor an OpenEXR file";
        return Err(Fault::unsupported("", what, "convert the sky to .hdr or .exr"));
    };
    // What was cancelled is not broken.
    progress.check()?;
    let (width, height, texels) = decoded?;
    if texels.is_empty() || texels.len() as u64 != u64::from(width) * u64::from(height) {
        return Err(Fault::invalid("", "it has no pixels"));
    }
    let mut image = SkyImage { width, height, texels, rotation: 0.0, strength: 1.0 };
    let notices = repair(&mut image.texels).into_iter().collect();
    let input = files.into_inputs().pop();
    let input = input.ok_or_else(|| Fault::invalid("", "it was not read"))?;
    Ok(LoadedSky { image, notices, input })
}

fn broken(error: impl std::fmt::Display) -> Fault {
    Fault::new(FaultKind::Invalid, "", format!("it cannot be decoded: {error}"), "save the image again")
}

fn check_size(width: u64, height: u64, limits: &Limits) -> Checked<()> {
    match width.checked_mul(height) {
        Some(pixels) if pixels <= limits.image_pixels => Ok(()),
        _ => {
            Err(Fault::limit("", format!("it has {width} × {height} pixels"), Bound::ImagePixels, limits.image_pixels))
        }
    }
}

fn read_hdr(bytes: &[u8], limits: &Limits, progress: &dyn Progress) -> Checked<(u32, u32, Vec<Vec3>)> {
    let decoder = image::codecs::hdr::HdrDecoder::new(Watched::new(Cursor::new(bytes), progress)).map_err(broken)?;
    let (width, height) = decoder.dimensions();
    check_size(u64::from(width), u64::from(height), limits)?;
    let image = image::DynamicImage::from_decoder(decoder).map_err(broken)?.into_rgb32f();
    Ok((width, height, image.pixels().map(|p| Vec3::from_array(p.0)).collect()))
}

fn read_exr(bytes: &[u8], limits: &Limits, progress: &dyn Progress) -> Checked<(u32, u32, Vec<Vec3>)> {
    // The headers come first, so that a claimed size is refused before anything of it is allocated.
    let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(broken)?;
    for header in &meta.headers {
        check_size(header.layer_size.width() as u64, header.layer_size.height() as u64, limits)?;
    }
    struct Pixels {
        width: usize,
        texels: Vec<Vec3>,
    }
    let create = |size: exr::math::Vec2<usize>, _: &_| Pixels {
        width: size.width(),
        texels: vec![Vec3::ZERO; size.width().saturating_mul(size.height())],
    };
    let set = |pixels: &mut Pixels, at: exr::math::Vec2<usize>, (r, g, b, _): (f32, f32, f32, f32)| {
        if let Some(texel) = pixels.texels.get_mut(at.y().saturating_mul(pixels.width).saturating_add(at.x())) {
            *texel = Vec3::new(r, g, b);
        }
    };
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgba_channels(create, set)
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Watched::new(Cursor::new(bytes), progress))
        .map_err(broken)?;
    let size = image.layer_data.size;
    let narrow = |n: usize| u32::try_from(n).map_err(broken);
    Ok((narrow(size.width())?, narrow(size.height())?, image.layer_data.channel_data.pixels.texels))
}

/// Makes every value finite and not negative: an overflown sun becomes as bright as half precision can say, or as the
/// brightest finite value of the image if that is more; what is no number becomes black.
fn repair(texels: &mut [Vec3]) -> Option<Notice> {
    let finite = texels.iter().flat_map(|t| t.to_array()).filter(|c| c.is_finite());
    let brightest = finite.fold(f16::MAX.to_f32(), f32::max);
    let mut repaired = 0;
    for texel in texels.iter_mut() {
        let fixed = texel.to_array().map(|c| if c == f32::INFINITY { brightest } else { c.max(0.0) });
        let fixed = Vec3::from_array(fixed);
        if fixed != *texel {
            *texel = fixed;
            repaired += 1;
        }
    }
    (repaired > 0).then(|| Notice {
        code: "sky-repaired",
        message: format!("{repaired} pixels of the sky were negative or not finite; they were made black or bright"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::load_sky as load;

    fn file(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> std::path::PathBuf {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn hdr(width: usize, height: usize, texel: impl Fn(usize) -> [f32; 3]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let pixels: Vec<_> = (0..width * height).map(|i| image::Rgb(texel(i))).collect();
        image::codecs::hdr::HdrEncoder::new(&mut bytes).encode(&pixels, width, height).unwrap();
        bytes
    }

    #[test]
    fn radiance_and_exr_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = file(&folder, "a.hdr", &hdr(16, 8, |i| [i as f32, 0.5, 8.0]));
        let sky = load(&path, &Limits::default()).unwrap();
        assert_eq!((sky.image.width, sky.image.height, sky.notices.len()), (16, 8, 0));
        assert_eq!(sky.image.texels[64], Vec3::new(64.0, 0.5, 8.0));
        assert_eq!(sky.input.digest, *blake3::hash(&std::fs::read(&path).unwrap()).as_bytes());

        let path = file(&folder, "b.exr", &[]);
        exr::prelude::write_rgb_file(&path, 6, 3, |x, y| (x as f32, y as f32, 0.25f32)).unwrap();
        let sky = load(&path, &Limits::default()).unwrap();
        assert_eq!((sky.image.width, sky.image.height), (6, 3));
        assert_eq!(sky.image.texels[2 * 6 + 5], Vec3::new(5.0, 2.0, 0.25));
        let bytes = std::fs::read(&path).unwrap();
        for n in (0..bytes.len()).step_by(7) {
            assert!(load(&file(&folder, "cut.exr", &bytes[..n]), &Limits::default()).is_err(), "{n}");
        }
    }

    #[test]
    fn limits_and_formats() {
        let folder = tempfile::tempdir().unwrap();
        let path = file(&folder, "c.hdr", &hdr(16, 8, |_| [1.0; 3]));
        let fault = load(&path, &Limits { image_pixels: 100, ..Limits::default() }).unwrap_err();
        assert_eq!(fault.fault.kind, FaultKind::Limit, "{fault}");
        let text = load(&file(&folder, "d.hdr", b"GIF89a"), &Limits::default()).unwrap_err().to_string();
        assert!(text.contains(".hdr") && text.contains("convert"), "{text}");
        let text = load(Path::new("nowhere/noon.hdr"), &Limits::default()).unwrap_err().to_string();
        assert!(text.starts_with("nowhere/noon.hdr: the sky of --sky or [sky]: it cannot be read ("), "{text}");
        assert_eq!(text.matches("noon.hdr").count(), 1, "{text}");
    }

    #[test]
    fn what_is_not_light_is_repaired() {
        let mut texels = [Vec3::new(f32::NAN, -1.0, f32::INFINITY), Vec3::splat(1e5), Vec3::NEG_INFINITY];
        assert!(repair(&mut texels).is_some());
        assert_eq!(texels, [Vec3::new(0.0, 0.0, 1e5), Vec3::splat(1e5), Vec3::ZERO]);
        assert!(repair(&mut texels).is_none());
    }
}
