//! 8-bit PNG: no colour profile, no gamma chunk, no date; what the bytes mean is said by whoever refers to them.

use image::{
    ExtendedColorType, ImageEncoder,
    codecs::png::{CompressionType, FilterType, PngEncoder},
};

use crate::ExportError;

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
pub fn encode_png(image: &Image8, effort: Effort) -> Result<Vec<u8>, ExportError> {
    if u64::from(image.width) * u64::from(image.height) != image.texels.len() as u64 {
        let fault = format!("{} texels do not make {} × {}", image.texels.len(), image.width, image.height);
        return Err(ExportError::Image { what: "PNG".into(), fault });
    }
    let (compression, filter) = match effort {
        Effort::Small => (CompressionType::Default, FilterType::Adaptive),
        Effort::Fast => (CompressionType::Fast, FilterType::Sub),
    };
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, compression, filter)
        .write_image(bytemuck::cast_slice(&image.texels), image.width, image.height, ExtendedColorType::Rgb8)
        .map_err(|e| ExportError::encode("PNG", e))?;
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
            let bytes = encode_png(&picture, effort).unwrap();
            assert_eq!(bytes, encode_png(&picture, effort).unwrap());
            let back = image::load_from_memory(&bytes).unwrap().to_rgb8();
            assert_eq!(back.dimensions(), (3, 2));
            assert_eq!(back.as_raw().as_slice(), bytemuck::cast_slice::<_, u8>(&picture.texels));
            for chunk in [b"gAMA", b"sRGB", b"iCCP", b"tIME", b"tEXt"] {
                assert!(!bytes.windows(4).any(|w| w == chunk));
            }
        }
    }

    #[test]
    fn a_wrong_size_is_refused() {
        let short = Image8 { width: 2, height: 2, texels: vec![[0; 3]; 3] };
        assert!(encode_png(&short, Effort::Small).is_err());
    }
}
