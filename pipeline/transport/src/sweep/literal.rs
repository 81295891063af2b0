//! The paper's rule taken literally: the next voxel in the ordered list is the visible one.
//!
//! A surfel receives from the surfel before it on its line if they face each other along the direction. In the row
//! of voxels that a grazing line shares with a wall only the first exchanges light; what the others ought to have
//! received is lost, at every resolution.

use luxel_scene::Cancelled;

use super::{axis::AxisCopy, kernel::dot, lines::Lines, sample::Sample, turns};
use crate::Rgb;

/// The line has met nothing yet.
const SKY: u32 = u32::MAX;

/// Adds one direction to the sums. Rows are not repaired: what is not received counts as black.
///
/// # Errors
/// When another direction has failed.
pub fn sweep<S: Sample>(
    copy: &AxisCopy,
    radiosity: &[S::Light],
    lines: &Lines,
    sky: Rgb,
    table: &mut Vec<u32>,
    sums: &turns::Direction<S>,
) -> Result<(), Cancelled> {
    table.clear();
    table.resize(lines.cells as usize, SKY);
    let (sky, nothing) = (S::light(sky), S::light(Rgb::ZERO));
    let along: Vec<f32> = copy.normals.iter().map(|n| dot(n, &lines.sigma)).collect();
    for (part, first) in lines.order(copy) {
        let contents = copy.parts[part];
        let slice = &lines.slices[contents.slice as usize];
        if first {
            lines.enter(slice, table, SKY);
        }
        sums.add(part, |sums| {
            for (i, sum) in (contents.start as usize..).zip(sums) {
                let d = along[copy.planes[i] as usize];
                let cell = &mut table[lines.cell(copy.key(i), slice) as usize];
                let before = std::mem::replace(cell, i as u32);
                if d < 0.0 {
                    let light = match before {
                        SKY => sky,
                        before if along[copy.planes[before as usize] as usize] > 0.0 => radiosity[before as usize],
                        _ => nothing,
                    };
                    let w = -d * lines.weight;
                    *sum += S::arrived(light, w, w);
                }
            }
        })?;
    }
    Ok(())
}
