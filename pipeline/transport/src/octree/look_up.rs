//! Irradiance at a point on a surface, interpolated from the surfels around it: draft quality.
//!
//! Only surfels that belong to the point's own surface count: they look the same way, lie in its plane and it in
//! theirs, and no other surfel stands between. A look-up that mixes surfels across a thin wall or at a wall's foot makes a
//! dark room behind a door 20 % too bright.

use glam::Vec3;

use super::{Leaf, Octree};
use crate::Rgb;

/// Cosine between the normals of one surface, at least.
const COSINE: f32 = 0.7;
/// Distance from each other's plane within one surface, in voxel edges, at most.
const PLANE: f32 = 0.5;
/// Radii of the search in voxel edges; the next one is tried when nothing lies within.
const RADII: [f32; 3] = [1.5, 3.0, 6.0];
/// Surfels around a point, at most; the nearest voxels of the widest search hold fewer but in absurd scenes.
const MAX_NEIGHBOURS: usize = 1024;

/// Interpolated irradiance [lux].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Irradiance {
    pub direct: Rgb,
    pub indirect: Rgb,
}

impl Octree {
    /// Irradiance at a frame position with a unit normal; `None` where no surfel of that surface is near.
    pub fn look_up(&self, position: Vec3, normal: Vec3) -> Option<Irradiance> {
        let mut near = Vec::new();
        RADII.iter().find_map(|r| {
            near.clear();
            self.collect(position, r * self.grid.edge, &mut near);
            self.interpolate(position, normal, r * self.grid.edge, &near)
        })
    }

    /// Leaves within a radius.
    fn collect(&self, position: Vec3, radius: f32, near: &mut Vec<u32>) {
        let square = radius * radius;
        let mut stack = Vec::with_capacity(64);
        stack.extend((!self.nodes.is_empty()).then_some(0u32));
        while let Some(index) = stack.pop() {
            let Some(node) = self.nodes.get(index as usize) else { continue };
            let closest = position.max(node.lo.into()).min(node.hi.into());
            if closest.distance_squared(position) > square {
                continue;
            }
            stack.extend(node.child..node.child + node.children);
            if node.children == 0 {
                let inside = |i: &u32| self.leaf(*i).surfel.centroid.distance_squared(position) <= square;
                near.extend((node.first..node.first + node.count).filter(inside));
            }
            if near.len() >= MAX_NEIGHBOURS {
                return;
            }
        }
    }

    fn leaf(&self, i: u32) -> &Leaf {
        &self.leaves[i as usize]
    }

    fn interpolate(&self, position: Vec3, normal: Vec3, radius: f32, near: &[u32]) -> Option<Irradiance> {
        let edge = self.grid.edge;
        let (mut sum, mut weight) = (Irradiance::default(), 0.0);
        for &i in near {
            let l = self.leaf(i);
            let (c, n) = (l.surfel.centroid, l.surfel.normal);
            let height = normal.dot(c - position).abs().max(n.dot(position - c).abs());
            if n.dot(normal) < COSINE || height > PLANE * edge || self.is_hidden(position, normal, c, near) {
                continue;
            }
            let tent = (1.0 - c.distance(position) / radius).max(0.0);
            let w = tent * tent * l.surfel.area;
            sum.direct += w * l.direct;
            sum.indirect += w * l.indirect;
            weight += w;
        }
        let scale = 1.0 / weight;
        (weight > 0.0 && scale.is_finite())
            .then(|| Irradiance { direct: sum.direct * scale, indirect: sum.indirect * scale })
    }

    /// Whether a surfel of another surface stands between two points of one surface.
    fn is_hidden(&self, position: Vec3, normal: Vec3, c: Vec3, near: &[u32]) -> bool {
        let edge = self.grid.edge;
        near.iter().any(|&i| {
            let m = &self.leaf(i).surfel;
            let (cm, nm) = (m.centroid, m.normal);
            let (here, there) = (nm.dot(position - cm), nm.dot(c - cm));
            let crosses = here * there < 0.0 && here.abs().min(there.abs()) > 0.02 * edge;
            let across = nm.dot(normal).abs() < COSINE && m.fill() > 0.5;
            crosses && across && {
                let at = position + (c - position) * (here / (here - there));
                at.distance_squared(cm) < edge * edge
            }
        })
    }
}
