//! 8-bit PNG: no colour profile, no gamma chunk, no date; what the bytes mean is said by whoever refers to them.

use std::io::Write;

use luxel_scene::{Progress, Silent};

use crate::ExportError;

/// Longest chunk of compressed pixels [bytes].
const CHUNK: usize = 1 << 16;

/// An 8-bit RGB image, row-major from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image8 {
    pub width: u32,
    pub height: u32,
    pub texels: Vec<[u8; 3]>,
}

/// What an encoder spends its time on. The values in the file are the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// Small files.
    #[default]
    Small,
    /// Files that are written soon: for drafts.
    Fast,
}

/// The bytes of a PNG file; the same image gives the same bytes.
pub fn encode_png(image: &Image8) -> Result<Vec<u8>, ExportError> {
    encode_png_with(image, Effort::Small, &Silent)
}

/// [`encode_png`] with less effort if need be, that can be cancelled at every row.
pub fn encode_png_with(image: &Image8, effort: Effort, progress: &dyn Progress) -> Result<Vec<u8>, ExportError> {
    if u64::from(image.width) * u64::from(image.height) != image.texels.len() as u64 {
        let fault = format!("{} texels do not make {} × {}", image.texels.len(), image.width, image.height);
        return Err(ExportError::Image { what: "PNG".into(), fault });
    }
    let refused = |fault: png::EncodingError| ExportError::encode("PNG", fault);
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width, image.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let (compression, filter) = match effort {
        Effort::Small => (png::Compression::Balanced, png::Filter::Adaptive),
        Effort::Fast => (png::Compression::Fast, png::Filter::Sub),
    };
    encoder.set_compression(compression);
    encoder.set_filter(filter);
    let mut writer = encoder.write_header().map_err(refused)?;
    let raw: &[u8] = bytemuck::cast_slice(&image.texels);
    let mut rows = writer.stream_writer_with_size(CHUNK).map_err(refused)?;
    for row in raw.chunks(3 * image.width as usize) {
        progress.check()?;
        rows.write_all(row).map_err(|e| ExportError::encode("PNG", e))?;
    }
    rows.finish().map_err(refused)?;
    writer.finish().map_err(refused)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_png_comes_back_and_carries_no_gamma() {
        let texels = (0..6).map(|i| [i * 40, 255 - i, i]).collect::<Vec<_>>();
        let picture = Image8 { width: 3, height: 2, texels };
        for effort in [Effort::Small, Effort::Fast] {
            let bytes = encode_png_with(&picture, effort, &Silent).unwrap();
            assert_eq!(bytes, encode_png_with(&picture, effort, &Silent).unwrap());
            let back = image::load_from_memory(&bytes).unwrap().to_rgb8();
            assert_eq!(back.dimensions(), (3, 2));
            assert_eq!(back.as_raw().as_slice(), bytemuck::cast_slice::<_, u8>(&picture.texels));
            for chunk in [b"gAMA", b"sRGB", b"iCCP", b"tIME", b"tEXt"] {
                assert!(!bytes.windows(4).any(|w| w == chunk));
            }
        }
    }

    #[test]
    fn images_of_any_size_come_back_from_chunks() {
        let noise = |i: u32| [(i * 37) as u8, (i.wrapping_mul(2_654_435_761) >> 24) as u8, (i / 251) as u8];
        for (width, height) in [(1, 1), (3, 2), (257, 63), (300, 200)] {
            for texels in [(0..width * height).map(noise).collect(), vec![[7; 3]; (width * height) as usize]] {
                let picture = Image8 { width, height, texels };
                let back = image::load_from_memory(&encode_png(&picture).unwrap()).unwrap().to_rgb8();
                assert_eq!(back.dimensions(), (width, height));
                assert_eq!(back.as_raw().as_slice(), bytemuck::cast_slice::<_, u8>(&picture.texels));
            }
        }
    }

    #[test]
    fn a_wrong_size_is_refused() {
        let short = Image8 { width: 2, height: 2, texels: vec![[0; 3]; 3] };
        assert!(encode_png(&short).is_err());
    }
}
