//! Words in pictures: Noto Sans Mono, rasterised at 16 pixels.

use luxel_export::Image8;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

const WEIGHT: FontWeight = FontWeight::Regular;
const SIZE: RasterHeight = RasterHeight::Size16;

/// Height of a line [pixels].
pub const LINE: u32 = 18;

/// Width of a line [pixels].
pub fn width(text: &str) -> u32 {
    (text.chars().count() * get_raster_width(WEIGHT, SIZE)) as u32
}

/// Writes a line whose upper left corner is at (x, y), in a colour; what lies beyond the image is not written.
pub fn write(image: &mut Image8, (x, y): (u32, u32), text: &str, colour: [u8; 3]) {
    let advance = get_raster_width(WEIGHT, SIZE) as u32;
    for (left, c) in (0..).map(|i| x + i * advance).zip(text.chars()) {
        // A letter that the font lacks is a question mark, so that nothing goes unnoticed.
        let Some(raster) = get_raster(c, WEIGHT, SIZE).or_else(|| get_raster('?', WEIGHT, SIZE)) else { continue };
        for (dy, row) in (0..).zip(raster.rows()) {
            for (dx, ink) in (0..).zip(row) {
                blend(image, left + dx, y + 1 + dy, colour, *ink);
            }
        }
    }
}

fn blend(image: &mut Image8, x: u32, y: u32, colour: [u8; 3], ink: u8) {
    if x >= image.width || y >= image.height {
        return;
    }
    let texel = &mut image.texels[y as usize * image.width as usize + x as usize];
    for (below, colour) in texel.iter_mut().zip(colour) {
        let mixed = u32::from(*below) * (255 - u32::from(ink)) + u32::from(colour) * u32::from(ink);
        *below = (mixed / 255) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(text: &str) -> Image8 {
        let mut image = Image8 { width: 60, height: LINE, texels: vec![[0; 3]; 60 * LINE as usize] };
        write(&mut image, (2, 0), text, [200; 3]);
        image
    }

    #[test]
    fn letters_are_seen_and_differ_and_stay_inside() {
        let ink = |text: &str| written(text).texels.iter().map(|t| u64::from(t[0])).sum::<u64>();
        assert_eq!(ink("   "), 0);
        assert!(ink("a±") > 200);
        assert_ne!(written("rmse"), written("bias"));
        // Longer than the image, and letters that nobody drew.
        assert!(ink("more than fits into it") > ink("more"));
        assert_eq!(written("\u{4e16}"), written("?"));
        assert!(width("12345") == 5 * width("1"));
    }
}
