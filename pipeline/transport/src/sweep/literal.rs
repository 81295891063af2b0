//! The paper's rule taken literally: the next voxel in the ordered list is the visible one.
//!
//! A surfel receives from the surfel before it on its line if they face each other along the direction. In the row
//! of voxels that a grazing line shares with a wall only the first exchanges light; what the others ought to have
//! received is lost, at every resolution.

use super::{axis::AxisCopy, lines::Lines, sample::Sample};
use crate::Rgb;

/// The line has met nothing yet.
const SKY: u32 = u32::MAX;

/// Adds one direction to the sums. Rows are not repaired: what is not received counts as black.
pub fn sweep<S: Sample>(
    copy: &AxisCopy,
    radiosity: &[S],
    lines: &Lines,
    sky: Rgb,
    table: &mut Vec<u32>,
    sums: &mut [S],
) {
    table.clear();
    table.resize(lines.cells, SKY);
    let (sky, nothing) = (S::new(sky, 1.0), S::new(Rgb::ZERO, 1.0));
    let facing: Vec<f32> =
        copy.normals.iter().map(|n| n[0] * lines.sigma[0] + n[1] * lines.sigma[1] + n[2] * lines.sigma[2]).collect();
    for x in lines.order() {
        let shift = lines.slices[x].shift;
        let (start, end) = (copy.slices[x].start as usize, copy.slices[x + 1].start as usize);
        for (i, sum) in sums.iter_mut().enumerate().take(end).skip(start) {
            let d = facing[copy.planes[i] as usize];
            let cell = &mut table[(copy.key(i) + shift) as usize];
            let before = std::mem::replace(cell, i as u32);
            if d < 0.0 {
                let w = -d * lines.weight;
                let light = match before {
                    SKY => &sky,
                    before if facing[copy.planes[before as usize] as usize] > 0.0 => &radiosity[before as usize],
                    _ => &nothing,
                };
                *sum += *light * w;
            }
        }
    }
}
