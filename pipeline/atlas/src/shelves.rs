//! How large a page must be to hold some rectangles, by a bound that needs no packing.
//!
//! Next-fit decreasing height: rectangles lie on their longer side, highest first, on shelves that are as high as
//! their first one. The packer of `pack` takes the lowest place that is free instead of the next on the shelf, and
//! nests outlines besides.

use glam::DVec2;

use crate::MAX_SIZE;

/// The smallest power of two up to [`MAX_SIZE`] whose square holds all rectangles (sides in texels, not yet whole) with
/// their padding; None where none does.
pub(crate) fn side(sizes: impl Iterator<Item = DVec2>, padding: u32) -> Option<u32> {
    let grown = |texels: f64| (texels.round() as u32).max(1).saturating_add(2 * padding);
    let mut lying: Vec<[u32; 2]> = sizes.map(|s| [grown(s.min_element()), grown(s.max_element())]).collect();
    lying.sort_unstable_by(|a, b| b.cmp(a));
    (0..=MAX_SIZE.ilog2()).map(|power| 1 << power).find(|&side| height(&lying, side).is_some_and(|h| h <= side.into()))
}

/// Height of the shelves; None where a rectangle is longer than a shelf.
fn height(lying: &[[u32; 2]], side: u32) -> Option<u64> {
    let (mut total, mut left) = (0, 0);
    for &[high, long] in lying {
        if long > side {
            return None;
        }
        if long > left {
            total += u64::from(high);
            left = side;
        }
        left -= long;
    }
    Some(total)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_lie_on_shelves() {
        let square = |n: usize, side: f64| std::iter::repeat_n(DVec2::splat(side), n);
        assert_eq!(side(square(1, 60.0), 2), Some(64));
        assert_eq!(side(square(1, 60.6), 2), Some(128));
        assert_eq!(side(square(4, 60.0), 2), Some(128));
        assert_eq!(side(square(5, 60.0), 2), Some(256));
        assert_eq!(side([DVec2::new(1.0, 124.0), DVec2::new(124.0, 1.0)].into_iter(), 2), Some(128));
    }

    #[test]
    fn what_no_page_holds_has_no_side() {
        let one = |x: f64, y: f64| side(std::iter::once(DVec2::new(x, y)), 2);
        assert_eq!(one(16_380.0, 1.0), Some(MAX_SIZE));
        for (x, y) in [(16_381.0, 1.0), (1e30, 1e30), (f64::INFINITY, 1.0)] {
            assert_eq!(one(x, y), None);
        }
    }
}
