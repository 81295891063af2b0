//! Where in a pixel its samples lie: Sobol's (0, 2)-sequence in base 2 (Sobol 1967; Kollig & Keller 2002).
//!
//! The first 2ⁿ points have one point in every elementary interval of area 2⁻ⁿ, so 16 of them show 16 steps of an edge
//! that is upright, level, or along a diagonal of slope 2ᵏ. All pixels have the same points: edges are even, and nothing
//! depends on where in the picture a pixel is. The first point is the centre, up to half a step.

use glam::Vec2;
use luxel_transport::sampling::mix;

/// Point `i` of `count`, in [0, 1)². Passes have patterns of their own, which a digital shift makes of the first one.
pub fn point(i: u32, count: u32, pass: u32) -> Vec2 {
    if count == 1 && pass == 0 {
        return Vec2::splat(0.5);
    }
    // Half of the interval of [0, 1) in front of the first point makes that one the centre.
    const HALF: u32 = 1 << 31;
    let shift = if pass == 0 { 0 } else { mix(u64::from(pass)) };
    let x = i.reverse_bits() ^ HALF ^ (shift >> 32) as u32;
    let y = second(i) ^ HALF ^ shift as u32;
    let step = if pass == 0 { 0.5 / count as f32 } else { 0.0 };
    let unit = |bits: u32| ((bits >> 8) as f32 / (1u32 << 24) as f32 + step).min(1.0 - f32::EPSILON / 2.0);
    Vec2::new(unit(x), unit(y))
}

/// The second dimension of Sobol's sequence: its direction numbers are the rows of Pascal's triangle mod 2.
fn second(mut i: u32) -> u32 {
    let (mut direction, mut bits) = (1u32 << 31, 0);
    while i != 0 {
        if i & 1 == 1 {
            bits ^= direction;
        }
        direction ^= direction >> 1;
        i >>= 1;
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_elementary_interval_holds_one_point() {
        for pass in [0, 1, 7] {
            for (across, down) in [(16, 1), (8, 2), (4, 4), (2, 8), (1, 16)] {
                let mut seen = vec![0; 16];
                for i in 0..16 {
                    let p = point(i, 16, pass);
                    seen[(p.x * across as f32) as usize * down + (p.y * down as f32) as usize] += 1;
                }
                assert!(seen.iter().all(|n| *n == 1), "{pass} {across}×{down}: {seen:?}");
            }
        }
    }

    #[test]
    fn the_first_point_is_near_the_centre_and_one_alone_is_the_centre() {
        assert_eq!(point(0, 1, 0), Vec2::splat(0.5));
        assert!((point(0, 16, 0) - Vec2::splat(0.5)).abs().max_element() <= 1.0 / 32.0);
        assert_ne!(point(0, 1, 1), point(0, 1, 2));
    }
}
