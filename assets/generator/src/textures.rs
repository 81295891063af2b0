//! Small procedural textures.

use luxel_scene::Texture;

fn paint(name: &str, size: [u32; 2], srgb: bool, texel: impl Fn(u32, u32) -> [u8; 4]) -> Texture {
    let [width, height] = size;
    let texels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| texel(x, y)).collect();
    Texture { name: name.into(), width, height, srgb, texels }
}

/// A grain that depends on the texel alone, in [0, `depth`).
fn grain(x: u32, y: u32, depth: u8) -> u8 {
    let mut h = x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    ((h >> 16) % u32::from(depth)) as u8
}

/// Four tiles, dark and light.
pub fn checker() -> Texture {
    paint("checker", [64, 64], true, |x, y| {
        let base = if (x / 32 + y / 32) % 2 == 0 { [205, 200, 190] } else { [88, 70, 62] };
        let g = grain(x, y, 8);
        [base[0] - g, base[1] - g, base[2] - g, 255]
    })
}

/// Courses of brick in running bond.
pub fn brick() -> Texture {
    paint("brick", [64, 64], true, |x, y| {
        let course = y / 8;
        let across = (x + 8 * (course % 2)) % 16;
        let g = grain(x, y, 16);
        if y % 8 == 0 || across == 0 { [176 - g, 170 - g, 160 - g, 255] } else { [158 - g, 84 - g, 62 - g, 255] }
    })
}

/// Bars of a quarter of their distance; between them the surface is not there.
pub fn grating() -> Texture {
    paint("grating", [32, 32], true, |x, y| {
        let bar = x < 8 || y < 8;
        [90, 92, 96, if bar { 255 } else { 0 }]
    })
}

/// Coloured stripes for an emissive surface.
pub fn screen() -> Texture {
    paint("screen", [32, 16], true, |x, _| match x / 8 {
        0 => [255, 240, 200, 255],
        1 => [60, 200, 255, 255],
        2 => [255, 60, 120, 255],
        _ => [80, 255, 120, 255],
    })
}
