//! The paper's rule taken literally: the next voxel in the ordered list is the visible one.
//!
//! A surfel receives from the surfel before it on its line if they face each other along the direction. In the row
//! of voxels that a grazing line shares with a wall only the first exchanges light; what the others ought to have
//! received is lost, at every resolution.

use super::{axis::AxisCopy, lines::Lines};
use crate::Rgb;

/// The line has met nothing yet.
const SKY: u32 = u32::MAX;

/// Adds one direction to the sums. Rows are not repaired: what is not received counts as black.
pub fn sweep<const BANDS: usize, const SLOTS: usize>(
    copy: &AxisCopy,
    lines: &Lines,
    sky: Rgb,
    table: &mut Vec<u32>,
    sums: &mut [[f32; SLOTS]],
) {
    table.clear();
    table.resize(lines.cells, SKY);
    let sky = sky.to_array();
    for x in lines.order() {
        let shift = lines.slices[x].shift;
        let (start, end) = (copy.slices[x] as usize, copy.slices[x + 1] as usize);
        for (i, (s, sum)) in copy.surfels.iter().zip(sums.iter_mut()).enumerate().take(end).skip(start) {
            let d = s.along(&lines.sigma);
            let cell = &mut table[(s.key() + shift) as usize];
            let before = std::mem::replace(cell, i as u32);
            if d < 0.0 {
                let w = -d * lines.weight;
                sum[BANDS] += w;
                let light = if before == SKY {
                    Some(&sky)
                } else {
                    let faces = copy.surfels[before as usize].along(&lines.sigma) > 0.0;
                    faces.then(|| &copy.radiosity[before as usize])
                };
                if let Some(light) = light {
                    (0..BANDS).for_each(|b| sum[b] += w * light[b]);
                }
            }
        }
    }
}
