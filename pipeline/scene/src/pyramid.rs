//! Averages of an image over squares of 2, 4, 8… texels, in linear light.
//!
//! Texel i of level k covers the base texels [i·2ᵏ, (i+1)·2ᵏ) of its axis; the last one covers what is left, so odd
//! sizes need no resampling. Levels hold four floats per texel, which together take a third more memory than the 8-bit
//! image; they are built when a texture is first averaged over more than a few texels.

use std::sync::OnceLock;

use glam::Vec4;

use crate::texture::Weighted;
use crate::{AlphaUse, Texture, Wrap};

/// Averages of one texture in one use of its alpha. They are made on first use, by whichever thread comes first (the
/// result is the same); the texture must not change after that.
#[derive(Default)]
pub struct Averages(OnceLock<Pyramid>);

impl Averages {
    pub(crate) fn get(&self, texture: &Texture, alpha: AlphaUse) -> &Pyramid {
        self.0.get_or_init(|| Pyramid::build(texture, alpha))
    }
}

impl std::fmt::Debug for Averages {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.0.get().is_some() { "Averages(made)" } else { "Averages(not yet made)" })
    }
}

/// Levels 1, 2, … of an image, down to a single texel.
pub(crate) struct Pyramid {
    levels: Vec<Level>,
}

struct Level {
    width: u32,
    height: u32,
    texels: Vec<Vec4>,
}

impl Pyramid {
    fn build(texture: &Texture, alpha: AlphaUse) -> Self {
        let tested = |value: Vec4| match alpha {
            AlphaUse::Test(cutoff) => value.truncate().extend(f32::from(u8::from(value.w >= cutoff))),
            AlphaUse::Ignored | AlphaUse::Coverage => value,
        };
        let mut levels: Vec<Level> = Vec::new();
        let (mut width, mut height, mut side) = (texture.width, texture.height, 1u32);
        while width > 1 || height > 1 {
            let below = levels.last();
            let fetch = |x: u32, y: u32| match below {
                Some(level) => level.texels[y as usize * level.width as usize + x as usize],
                None => tested(texture.texel(x, y)),
            };
            // How many base texels a texel of the level below covers along one axis; the last one may cover fewer.
            let covered = |i: u32, size: u32| (size - i * side).min(side) as f32;
            let (w, h) = (width.div_ceil(2), height.div_ceil(2));
            let mut texels = Vec::with_capacity(w as usize * h as usize);
            for y in 0..h {
                for x in 0..w {
                    let mut sum = Weighted::new(alpha);
                    for j in 2 * y..(2 * y + 2).min(height) {
                        for i in 2 * x..(2 * x + 2).min(width) {
                            let weight = covered(i, texture.width) * covered(j, texture.height);
                            sum.add(fetch(i, j), weight);
                        }
                    }
                    texels.push(sum.mean());
                }
            }
            levels.push(Level { width: w, height: h, texels });
            (width, height, side) = (w, h, side.saturating_mul(2));
        }
        Self { levels }
    }

    /// A texel of level ≥ 1; beyond the last level, and beyond a level's edges, the nearest one there is.
    pub(crate) fn cell(&self, level: usize, x: u32, y: u32) -> Vec4 {
        let Some(level) = self.levels.get(level - 1).or(self.levels.last()) else { return Vec4::ONE };
        let (x, y) = (x.min(level.width - 1), y.min(level.height - 1));
        level.texels[y as usize * level.width as usize + x as usize]
    }
}

/// Most texels that a box can touch along one axis.
const MOST: usize = 24;

/// Which texels of a level a box touches along one axis, and over how many base texels.
pub(crate) struct Spans {
    spans: [(u32, f32); MOST],
    count: usize,
}

impl Spans {
    pub(crate) fn as_slice(&self) -> &[(u32, f32)] {
        &self.spans[..self.count]
    }
}

/// The box is `side` base texels wide around `center` (in units of the image), the image `size` base texels.
pub(crate) fn spans(center: f32, side: f32, size: u32, level: usize, wrap: Wrap) -> Spans {
    let mut out = Spans { spans: [(0, 0.0); MOST], count: 0 };
    let (start, end) = (center * size as f32 - 0.5 * side, center * size as f32 + 0.5 * side);
    let mut at = start;
    while at < end && out.count < MOST {
        let texel = at.floor();
        let (cell, next) = cell_at(texel as i64, i64::from(size), level, wrap);
        // Rounding may leave a sliver that does not reach the next texel; it still has to move on.
        let next = (next as f32).max(texel + 1.0).min(end);
        out.spans[out.count] = (cell, next - at);
        out.count += 1;
        if next <= at {
            break;
        }
        at = next;
    }
    out
}

/// The texel of `level` under a base texel, and the first base texel to the right that lies under another one.
fn cell_at(texel: i64, size: i64, level: usize, wrap: Wrap) -> (u32, i64) {
    let width = 1i64 << level.min(40);
    let (period, inside) = (texel.div_euclid(size), texel.rem_euclid(size));
    let forward = |inside: i64| {
        let cell = inside / width;
        (cell, ((cell + 1) * width).min(size) - inside)
    };
    let (cell, steps) = match wrap {
        Wrap::Clamp if texel < 0 => (0, -texel),
        Wrap::Clamp if texel >= size => ((size - 1) / width, i64::from(u32::MAX)),
        Wrap::Mirror if period.rem_euclid(2) == 1 => {
            // Runs backwards: from `size − 1 − inside` down to the left border of its cell.
            let mirrored = size - 1 - inside;
            let cell = mirrored / width;
            (cell, mirrored - cell * width + 1)
        }
        _ => forward(inside),
    };
    (cell as u32, texel + steps)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn covered(center: f32, side: f32, size: u32, level: usize, wrap: Wrap) -> Vec<(u32, f32)> {
        spans(center, side, size, level, wrap).as_slice().to_vec()
    }

    #[test]
    fn spans_cover_the_box() {
        assert_eq!(covered(0.5, 4.0, 8, 0, Wrap::Repeat), [(2, 1.0), (3, 1.0), (4, 1.0), (5, 1.0)]);
        assert_eq!(covered(0.5, 4.0, 8, 1, Wrap::Repeat), [(1, 2.0), (2, 2.0)]);
        assert_eq!(covered(0.0, 2.0, 8, 1, Wrap::Repeat), [(3, 1.0), (0, 1.0)]);
        assert_eq!(covered(0.0, 2.0, 8, 1, Wrap::Clamp), [(0, 1.0), (0, 1.0)]);
        assert_eq!(covered(1.0, 4.0, 8, 1, Wrap::Mirror), [(3, 2.0), (3, 2.0)]);
        assert_eq!(covered(0.5, 3.0, 3, 1, Wrap::Repeat), [(0, 2.0), (1, 1.0)], "the last cell is narrower");
    }

    #[test]
    fn spans_never_end_early() {
        for size in [1u32, 2, 3, 7, 64, 100, 4096] {
            for level in 0..8 {
                for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
                    let side = ((1u32 << level) as f32 * 3.3).min(size as f32).max(1.0);
                    for center in [-0.9, 0.0, 0.3, 0.999, 1.7] {
                        let total: f32 = covered(center, side, size, level, wrap).iter().map(|s| s.1).sum();
                        assert!((total - side).abs() < 2e-3 * side, "{size} {level} {wrap:?} {center}: {total} {side}");
                    }
                }
            }
        }
    }
}
