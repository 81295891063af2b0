//! Whether texels of a finished atlas belong to one place of one surface: no two triangles of a page lie on each other.
//!
//! Triangles are clipped against each other exactly, in texels of their page (f64); those of one chart that fold over
//! each other count like those of two. Coordinates are f32, so neighbours share slivers of rounding.

use glam::DVec2;
use luxel_scene::{Cancelled, Progress};

use crate::Atlas;
use crate::overlap::{Overlap, each_pair, signed_area};

/// A pair of triangles that shares less of a texel than this shares rounding.
const ROUNDING: f64 = 1e-3;

/// What of an atlas lies on each other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Overlapping {
    /// Area of all triangles, and what of it lies on another one [texels].
    pub area: f64,
    pub doubled: f64,
    /// The pair that shares the largest area: instance, and triangle of its mesh.
    pub worst: Option<[(u32, u32); 2]>,
    /// On some page too many long triangles cross each other's bounds for all pairs to be looked at.
    pub entangled: bool,
}

/// Why not all pairs were visited.
enum Stop {
    Entangled,
    Cancelled,
}

impl From<Overlap> for Stop {
    fn from(_: Overlap) -> Self {
        Self::Entangled
    }
}

/// Looks at all pages of an atlas.
///
/// # Errors
/// It was cancelled.
pub fn overlapping(atlas: &Atlas, progress: &dyn Progress) -> Result<Overlapping, Cancelled> {
    let mut found = Overlapping::default();
    let mut largest = ROUNDING;
    for page in 0..atlas.pages.len() as u32 {
        progress.check()?;
        let (names, triangles) = triangles(atlas, page);
        found.area += triangles.iter().map(|t| signed_area(t).abs()).sum::<f64>();
        let look_up = || progress.check().map_err(|Cancelled| Stop::Cancelled);
        let done = each_pair(&triangles, look_up, |a, b, area| {
            if area > ROUNDING {
                found.doubled += area;
            }
            if area > largest {
                largest = area;
                found.worst = Some([names[a], names[b]]);
            }
            Ok(())
        });
        match done {
            Ok(()) => {}
            Err(Stop::Entangled) => found.entangled = true,
            Err(Stop::Cancelled) => return Err(Cancelled),
        }
    }
    Ok(found)
}

/// The triangles on a page in texels, with their instances and numbers.
fn triangles(atlas: &Atlas, page: u32) -> (Vec<(u32, u32)>, Vec<[DVec2; 3]>) {
    let size = &atlas.pages[page as usize];
    let size = DVec2::new(size.width.into(), size.height.into());
    let (mut names, mut triangles) = (Vec::new(), Vec::new());
    for (instance, placed) in (0u32..).zip(&atlas.placed) {
        let Some(placed) = placed.as_ref().filter(|placed| placed.page == page) else { continue };
        for (number, corners) in (0u32..).zip(&placed.triangles) {
            let corners = corners.map(|i| placed.uvs[i as usize].as_dvec2() * size);
            if corners.iter().all(|p| p.is_finite()) {
                names.push((instance, number));
                triangles.push(corners);
            }
        }
    }
    (names, triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AtlasSettings, InProcess, build};
    use luxel_scene::Silent;

    #[test]
    fn an_atlas_of_ours_has_no_overlap_and_a_moved_chart_is_found() {
        let scene = room();
        let settings = AtlasSettings { size: 128, ..AtlasSettings::default() };
        let (mut atlas, _) = build(&scene, &settings, &InProcess, &Silent).unwrap();
        let good = overlapping(&atlas, &Silent).unwrap();
        assert!(good.doubled <= 1e-3 * good.area && !good.entangled, "{good:?}");
        assert!(good.area > 1000.0, "{good:?}");
        // The second instance lies where the first one is: all of its area is there twice.
        let (names, shapes) = triangles(&atlas, 0);
        let own = |(name, _): &(&(u32, u32), &[DVec2; 3])| name.0 == 0;
        let first: f64 = names.iter().zip(&shapes).filter(own).map(|(_, t)| signed_area(t).abs()).sum();
        atlas.placed[1] = atlas.placed[0].clone();
        let bad = overlapping(&atlas, &Silent).unwrap();
        assert!(first > 1000.0 && (bad.doubled / first - 1.0).abs() < 1e-3, "{bad:?} {first}");
        assert!(bad.worst.is_some_and(|[a, b]| a.0 != b.0), "{bad:?}");
    }

    fn room() -> luxel_scene::Scene {
        use glam::Vec3;
        let mut b = luxel_scene::build::Builder::new("room");
        let grey = b.matte(Vec3::splat(0.5));
        b.cuboid("shell", Vec3::ZERO, Vec3::new(1.0, 0.8, 1.2), grey, true);
        b.cuboid("block", Vec3::splat(0.2), Vec3::splat(0.5), grey, false);
        b.sphere("ball", Vec3::splat(0.7), 0.1, 12, grey, false);
        b.build()
    }
}
