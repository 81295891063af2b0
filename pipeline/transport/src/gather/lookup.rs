//! The draft: the cache itself, interpolated. A tent over the surfels around the receiver,
//!
//! ```text
//! E = Σⱼ wⱼ Eⱼ / Σⱼ wⱼ,   wⱼ = Aⱼ · Π max(0, 1 − |dⱼ|/(1.5 h))      dⱼ from the receiver along the three axes
//! ```
//!
//! but only over those that face the same way, lie in the same plane and can be seen from it: surfels across a thin wall
//! or around a corner have nothing to say about this point. The indirect irradiance that is read contains sky light.

use glam::Vec3;
use luxel_scene::{Cancelled, Progress};

use super::{Field, Gather, Gathered, Receiver, run, surfel_index::neighbours};
use crate::{Rgb, rays::OFFSET};

/// Half width of the tent in voxels.
const REACH: f32 = 1.5;

/// Least cosine between the normals of receiver and surfel.
const FACING: f32 = 0.8;

/// Largest distance of a surfel's centroid from the receiver's plane, in voxels: more than the sagitta of a curved
/// surface whose normals FACING admits, less than the distance to the next shelf.
const COPLANAR: f32 = 0.4;

/// Reads the cache.
pub struct Lookup<'a> {
    field: &'a Field<'a>,
}

/// What the tent has seen so far.
#[derive(Default)]
struct Tent {
    sum: Rgb,
    weight: f32,
    rays: u32,
}

impl<'a> Lookup<'a> {
    pub fn new(field: &'a Field<'a>) -> Self {
        Self { field }
    }

    fn at(&self, receiver: &Receiver) -> Gathered {
        let tent = self.tent(receiver);
        let irradiance = if tent.weight > 0.0 { tent.sum / tent.weight } else { self.nearest(receiver) };
        Gathered { irradiance, bound: 0.0, rays: tent.rays, cut: 0 }
    }

    fn tent(&self, receiver: &Receiver) -> Tent {
        let (field, edge) = (self.field, self.field.surfels.grid.edge);
        let voxel = field.index.voxel(receiver.position);
        let mut near = [0usize; 128];
        let (mut found, mut divided) = (0, false);
        for neighbour in neighbours(voxel, 2).filter(|v| self.meets_plane(*v, receiver)) {
            for i in field.index.surfels(neighbour) {
                let surfel = &field.surfels.list[i];
                let d = surfel.centroid - receiver.position;
                if d.abs().max_element() >= REACH * edge {
                    continue;
                }
                let same =
                    surfel.normal.dot(receiver.normal) > FACING && receiver.normal.dot(d).abs() < COPLANAR * edge;
                // Anything else near by may stand between the receiver and its neighbours.
                divided |= !same;
                if same && found < near.len() {
                    near[found] = i;
                    found += 1;
                }
            }
        }
        let mut tent = Tent::default();
        for &i in &near[..found] {
            self.add(&mut tent, i, receiver, divided);
        }
        tent
    }

    fn add(&self, tent: &mut Tent, i: usize, receiver: &Receiver, divided: bool) {
        let surfel = &self.field.surfels.list[i];
        let d = ((surfel.centroid - receiver.position) / self.field.surfels.grid.edge).abs();
        let w = (Vec3::ONE - d / REACH).max(Vec3::ZERO);
        let weight = w.x * w.y * w.z * surfel.area;
        if weight <= 0.0 {
            return;
        }
        if divided {
            tent.rays += 1;
            if !self.sees(receiver, i) {
                return;
            }
        }
        tent.sum += self.field.solution.indirect[i] * weight;
        tent.weight += weight;
    }

    /// A voxel can hold coplanar surfels only if the receiver's plane comes near it.
    fn meets_plane(&self, voxel: glam::IVec3, receiver: &Receiver) -> bool {
        let grid = &self.field.surfels.grid;
        let middle = grid.origin + (voxel.as_vec3() + 0.5) * grid.edge;
        let reach = (0.5 * receiver.normal.abs().element_sum() + COPLANAR) * grid.edge;
        receiver.normal.dot(middle - receiver.position).abs() <= reach
    }

    fn sees(&self, receiver: &Receiver, i: usize) -> bool {
        let surfel = &self.field.surfels.list[i];
        let (point, side) = surfel.place(self.field.rays.geometry);
        let from = receiver.position + receiver.normal * OFFSET;
        let d = point + side * OFFSET - from;
        let length = d.length();
        length <= OFFSET || self.field.rays.transmittance(from, d / length, length).max_element() > 0.0
    }

    /// Where no neighbour qualifies (slender things), the surfel of the receiver's own voxel and side.
    fn nearest(&self, receiver: &Receiver) -> Rgb {
        let found = self.field.index.find(receiver.position, receiver.normal);
        found.map_or(Rgb::ZERO, |i| self.field.solution.indirect[i])
    }
}

impl Gather for Lookup<'_> {
    fn gather(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        run::each(receivers, progress, || (), |(), receiver| self.at(receiver))
    }
}
