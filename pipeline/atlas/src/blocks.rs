//! What the packer moves: one chart, or one authored layout, of one instance, with its true size in the world.

use glam::swizzles::Vec2Swizzles;
use glam::{DVec2, DVec3};
use luxel_scene::{Cancelled, Progress, Scene};
use rayon::prelude::*;

use crate::authored::LIGHTMAP_SET;
use crate::charts::NO_CHART;
use crate::layout::{Layout, Source, Unwraps};
use crate::mesh::Solid;
use crate::pack::{Line, Shape, Spans};
use crate::shape::Stretch;
use crate::{AtlasError, overlap};

/// A block whose triangles fill so much of its rectangle is packed as one.
const FULL: f64 = 0.97;
/// Slack against rounding when texels that a triangle touches are counted (texels); below the coverage that makes a
/// texel.
const TOUCH: f64 = 1e-7;

/// One triangle of a block.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Face {
    pub instance: u32,
    pub triangle: u32,
    /// Corners in the block's unit square.
    pub uv: [DVec2; 3],
    /// World area [scene units²].
    pub area: f64,
}

/// A rectangle of texels that is packed as a whole.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    /// All blocks of a group go on one page.
    pub group: u32,
    /// Instances in it: one, or all primitives of an authored layout.
    pub instances: Vec<u32>,
    /// Chart number within the instance's unwrap.
    pub number: u32,
    /// Side lengths [scene units, times texel scale].
    pub size: DVec2,
    /// Lower corner and extent in the unwrap's or the layout's own coordinates.
    pub origin: DVec2,
    pub extent: DVec2,
    pub faces: Vec<Face>,
    /// Share of the rectangle that the faces cover.
    pub filled: f64,
}

impl Block {
    /// Side lengths in whole texels at a density (texels per scene unit), at least one. A block longer than `limit`
    /// is scaled down as a whole.
    pub fn texels(&self, density: f64, limit: u32) -> [u32; 2] {
        let density = density.min(f64::from(limit) / self.size.max_element());
        // `as` saturates.
        [self.size.x, self.size.y].map(|s| ((s * density).round() as u32).clamp(1, limit))
    }

    /// Outline at this size, grown by the padding on every side.
    pub fn shape(&self, [width, height]: [u32; 2], padding: u32) -> Shape {
        let spans = (self.filled < FULL && width.min(height) > 4).then(|| {
            let scale = DVec2::new(width.into(), height.into());
            let scaled = |flip: bool| {
                self.faces.iter().map(move |f| f.uv.map(|p| if flip { (p * scale).yx() } else { p * scale }))
            };
            Spans {
                rows: grown(&touched(scaled(false), height, width), padding),
                columns: grown(&touched(scaled(true), width, height), padding),
            }
        });
        Shape { width: width + 2 * padding, height: height + 2 * padding, spans }
    }

    /// A point of the unwrap in the block's unit square.
    pub fn unit(&self, uv: [f32; 2]) -> DVec2 {
        unit(DVec2::new(uv[0].into(), uv[1].into()), self.origin, self.extent)
    }
}

fn unit(p: DVec2, origin: DVec2, extent: DVec2) -> DVec2 {
    ((p - origin) / extent).clamp(DVec2::ZERO, DVec2::ONE)
}

/// The x spans that triangles touch in each of `rows` rows of `width` texels.
fn touched(triangles: impl Iterator<Item = [DVec2; 3]>, rows: u32, width: u32) -> Vec<Line> {
    let mut lines: Vec<Line> = vec![Line::new(); rows as usize];
    for t in triangles {
        let (lo, hi) = (t[0].y.min(t[1].y).min(t[2].y), t[0].y.max(t[1].y).max(t[2].y));
        let from = (lo + TOUCH).floor().max(0.0) as u32;
        let to = ((hi - TOUCH).ceil().max(0.0) as u32).min(rows);
        for row in from..to {
            let (x0, x1) = band(&t, row.into(), f64::from(row) + 1.0);
            let (a, b) = ((x0 + TOUCH).floor().max(0.0) as u32, ((x1 - TOUCH).ceil().max(0.0) as u32).min(width));
            if a < b {
                lines[row as usize].push([a, b]);
            }
        }
    }
    lines.iter_mut().for_each(join);
    lines
}

/// Sorts spans and joins those that touch.
fn join(line: &mut Line) {
    line.sort_unstable();
    line.dedup_by(|next, last| {
        let touch = next[0] <= last[1];
        if touch {
            last[1] = last[1].max(next[1]);
        }
        touch
    });
}

/// Extent in x of the part of a triangle between two heights.
fn band(t: &[DVec2; 3], y0: f64, y1: f64) -> (f64, f64) {
    let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
    let mut see = |x: f64| (lo, hi) = (lo.min(x), hi.max(x));
    for k in 0..3 {
        let (a, b) = (t[k], t[(k + 1) % 3]);
        if (y0..=y1).contains(&a.y) {
            see(a.x);
        }
        for y in [y0, y1] {
            if (a.y < y) != (b.y < y) {
                see(a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y)));
            }
        }
    }
    (lo, hi)
}

/// Spans after growing the shape by `p` in all directions, in a frame that is larger by `p` on every side.
fn grown(lines: &[Line], p: u32) -> Vec<Line> {
    let reach = 2 * p as usize;
    (0..lines.len() + reach)
        .map(|row| {
            let near = &lines[row.saturating_sub(reach)..(row + 1).min(lines.len())];
            let mut line: Line = near.iter().flatten().map(|[a, b]| [*a, b + 2 * p]).collect();
            join(&mut line);
            line
        })
        .collect()
}

/// All blocks of a scene, in the order of its instances.
pub(crate) fn blocks(
    scene: &Scene,
    layout: &Layout,
    unwraps: &Unwraps,
    progress: &dyn Progress,
) -> Result<Vec<Block>, AtlasError> {
    let seeds: Vec<(u32, Kind)> = layout
        .sources
        .iter()
        .enumerate()
        .filter_map(|(i, source)| match *source {
            Source::None => None,
            Source::Unwrap(key) => Some(Kind::Unwrap(i, key)),
            Source::Authored(g) => (layout.groups[g].first() == Some(&i)).then_some(Kind::Authored(g)),
        })
        .zip(0..)
        .map(|(kind, group)| (group, kind))
        .collect();
    for instance in scene.instances.iter().filter(|i| i.receives) {
        if !(instance.texel_scale.is_finite() && instance.texel_scale > 0.0) {
            return Err(AtlasError::TexelScale { instance: instance.name.clone(), scale: instance.texel_scale });
        }
    }
    let parts: Vec<Vec<Block>> = seeds
        .par_iter()
        .map(|&(group, kind)| match kind {
            _ if progress.is_cancelled() => Err(Cancelled.into()),
            Kind::Unwrap(i, key) => {
                let charts = unwraps.get(&key).ok_or(AtlasError::MissingUnwrap)?;
                let mesh = &scene.meshes[scene.instances[i].mesh];
                if !charts.is_consistent(mesh.positions.len(), mesh.triangles.len()) {
                    return Err(AtlasError::ForeignUnwrap { mesh: mesh.name.clone() });
                }
                Ok(unwrapped(scene, group, i, charts))
            }
            Kind::Authored(g) => Ok(authored(scene, group, &layout.groups[g]).into_iter().collect()),
        })
        .collect::<Result<_, AtlasError>>()?;
    Ok(parts.into_iter().flatten().collect())
}

#[derive(Clone, Copy)]
enum Kind {
    Unwrap(usize, crate::layout::MeshKey),
    Authored(usize),
}

/// Corners of a triangle in the world, about the origin of its instance: to the last bit, no size depends on where that
/// is, so an object that is moved keeps its place on the pages.
fn world(scene: &Scene, instance: usize, triangle: usize) -> [DVec3; 3] {
    let instance = &scene.instances[instance];
    scene.corners(instance.mesh, triangle).map(|p| instance.transform.transform_vector3(p.as_dvec3()))
}

fn unwrapped(scene: &Scene, group: u32, instance: usize, charts: &crate::charts::Charts) -> Vec<Block> {
    let corner = |v: u32| {
        let [u, v] = charts.uvs[v as usize];
        DVec2::new(u.into(), v.into())
    };
    charts
        .members()
        .into_iter()
        .zip(0..)
        .filter_map(|(members, number)| {
            let raw = members.iter().map(|&t| {
                (instance as u32, t, charts.triangles[t as usize].map(corner), world(scene, instance, t as usize))
            });
            let raw: Vec<_> = raw.collect();
            assemble(scene, group, vec![instance as u32], number, &raw)
        })
        .collect()
}

fn authored(scene: &Scene, group: u32, instances: &[usize]) -> Option<Block> {
    let mut raw = Vec::new();
    for &i in instances {
        let mesh = &scene.meshes[scene.instances[i].mesh];
        let solid = Solid::new(mesh);
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            if solid.areas[t] > 0.0 {
                let uv = triangle.map(|v| mesh.uvs[LIGHTMAP_SET][v as usize].as_dvec2());
                raw.push((i as u32, t as u32, uv, world(scene, i, t)));
            }
        }
    }
    assemble(scene, group, instances.iter().map(|&i| i as u32).collect(), NO_CHART, &raw)
}

type Raw = (u32, u32, [DVec2; 3], [DVec3; 3]);

/// None where nothing has area in the world, or where the world coordinates leave the range of numbers.
fn assemble(scene: &Scene, group: u32, instances: Vec<u32>, number: u32, raw: &[Raw]) -> Option<Block> {
    let mut stretch = Stretch::default();
    raw.iter().for_each(|(_, _, uv, points)| stretch.add(uv, points));
    let factors = stretch.factors()?;
    let all = || raw.iter().flat_map(|r| r.2);
    let origin = all().fold(DVec2::INFINITY, DVec2::min);
    let extent = all().fold(DVec2::NEG_INFINITY, DVec2::max) - origin;
    let scale = instances.iter().map(|&i| scene.instances[i as usize].texel_scale).fold(0.0, f32::max);
    let size = extent * factors * f64::from(scale);
    if !size.is_finite() || extent.min_element() <= 0.0 {
        return None;
    }
    let faces: Vec<Face> = raw
        .iter()
        .map(|&(instance, triangle, uv, points)| Face {
            instance,
            triangle,
            uv: uv.map(|p| unit(p, origin, extent)),
            area: 0.5 * (points[1] - points[0]).cross(points[2] - points[0]).length(),
        })
        .filter(|face| face.area > 0.0 && face.area.is_finite())
        .collect();
    let filled = faces.iter().map(|f| overlap::signed_area(&f.uv).abs()).sum::<f64>().min(1.0);
    Some(Block { group, instances, number, size, origin, extent, faces, filled })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_touches_its_rows_and_no_more() {
        let t = [DVec2::ZERO, DVec2::new(4.0, 0.0), DVec2::new(0.0, 4.0)];
        let expected = [vec![[0, 4]], vec![[0, 3]], vec![[0, 2]], vec![[0, 1]], vec![]];
        assert_eq!(touched([t].into_iter(), 5, 8), expected);
    }

    #[test]
    fn growing_by_one_takes_in_the_neighbours() {
        let line = |a, b| vec![[a, b]];
        let apart = vec![[1, 4], [5, 9]];
        let expected = [line(1, 4), line(1, 4), apart.clone(), line(5, 9), line(5, 9)];
        assert_eq!(grown(&[line(1, 2), vec![], line(5, 7)], 1), expected);
    }
}
