//! From a point on a surface to its surfel: an open-addressing table of bricks of 4³ voxels, each with a bit mask of its
//! occupied voxels, whose rank among the bits finds the voxel's surfels. Neighbouring voxels share a brick, so most
//! look-ups stay in the nearest cache; memory is in proportion to the surfels, however large and empty the scene is.

use glam::{IVec3, Vec3};
use luxel_scene::{Cancelled, Progress, Silent, watched};

use crate::{
    sampling::mix,
    surfel::{Surfel, Surfels},
};

/// A surfel and a surface point look to the same side when their normals agree at least this well: surfels gather
/// normals within dot 0.9 of their mean.
const FACING: f32 = 0.5;

/// A slot of the table; free while its mask is empty.
#[derive(Clone, Copy)]
struct Brick {
    /// Voxel coordinates divided by 4.
    place: IVec3,
    /// Number of the brick's first occupied voxel.
    first: u32,
    /// Occupied voxels: bit 16x + 4y + z.
    mask: u64,
}

/// Finds surfels by voxel.
#[derive(Clone)]
pub struct SurfelIndex<'a> {
    bricks: Vec<Brick>,
    /// The first surfel of each occupied voxel, by its number; the others follow it.
    firsts: Vec<u32>,
    list: &'a [Surfel],
    origin: Vec3,
    per_edge: f32,
}

impl<'a> SurfelIndex<'a> {
    pub fn new(surfels: &'a Surfels) -> Self {
        match Self::build(surfels, &Silent) {
            Ok(index) => index,
            Err(Cancelled) => unreachable!("nobody cancels"),
        }
    }

    /// [`SurfelIndex::new`] that can be cancelled.
    pub fn build(surfels: &'a Surfels, progress: &dyn Progress) -> Result<Self, Cancelled> {
        let list = &surfels.list;
        let voxels = || watched(list.chunk_by(|a, b| a.voxel() == b.voxel()), progress);
        let mut bricks = insert_all(voxels().map(|run| Ok(run?[0].voxel())))?;
        let mut occupied = 0;
        for brick in &mut bricks {
            brick.first = occupied;
            occupied += brick.mask.count_ones();
        }
        let mut firsts = vec![0; occupied as usize];
        let mut first = 0;
        for run in voxels() {
            let run = run?;
            if let Some(number) = number(&bricks, run[0].voxel()) {
                firsts[number] = first;
            }
            first += run.len() as u32;
        }
        Ok(Self { bricks, firsts, list, origin: surfels.grid.origin, per_edge: 1.0 / surfels.grid.edge })
    }

    /// The voxel that holds a point.
    pub fn voxel(&self, point: Vec3) -> IVec3 {
        ((point - self.origin) * self.per_edge).floor().as_ivec3()
    }

    /// The surfels of a voxel, as a range of the list.
    pub fn surfels(&self, voxel: IVec3) -> std::ops::Range<usize> {
        let Some(number) = number(&self.bricks, voxel) else { return 0..0 };
        let first = self.firsts[number] as usize;
        first..first + self.list[first..].iter().take_while(|s| s.voxel() == voxel).count()
    }

    /// The surfel at a surface point on the side that `normal` looks to: the best aligned one of the point's voxel, on the
    /// point's side of the walls there; in a
    /// voxel without any (a sliver that carries no area) the nearest one of the neighbours that faces the same side.
    pub fn find(&self, point: Vec3, normal: Vec3) -> Option<usize> {
        let voxel = self.voxel(point);
        let mut best = (FACING, None);
        let mates = self.surfels(voxel);
        for i in mates.clone() {
            let facing = self.list[i].normal.dot(normal);
            if facing > best.0 {
                best = (facing, Some(i));
            }
        }
        best.1
            .map(|best| Surfels::owner(self.list, 1.0 / self.per_edge, mates, best, point))
            .or_else(|| self.nearest(voxel, point, normal))
    }

    #[cold]
    fn nearest(&self, voxel: IVec3, point: Vec3, normal: Vec3) -> Option<usize> {
        let mut best = (f32::INFINITY, None);
        for neighbour in neighbours(voxel, 1) {
            for i in self.surfels(neighbour) {
                let distance = self.list[i].centroid.distance_squared(point);
                if self.list[i].normal.dot(normal) > FACING && distance < best.0 {
                    best = (distance, Some(i));
                }
            }
        }
        best.1
    }
}

/// The voxels within `reach` of one, itself included, in a fixed order.
pub(super) fn neighbours(voxel: IVec3, reach: i32) -> impl Iterator<Item = IVec3> {
    let span = move || -reach..=reach;
    let offsets = span().flat_map(move |x| span().flat_map(move |y| span().map(move |z| IVec3::new(x, y, z))));
    offsets.map(move |offset| IVec3::from_array([0, 1, 2].map(|i| voxel[i].wrapping_add(offset[i]))))
}

/// A table that holds the bricks of all voxels and is at least half free.
fn insert_all(voxels: impl Iterator<Item = Result<IVec3, Cancelled>>) -> Result<Vec<Brick>, Cancelled> {
    const FREE: Brick = Brick { place: IVec3::ZERO, first: 0, mask: 0 };
    let (mut table, mut used) = (vec![FREE; 64], 0);
    for voxel in voxels {
        let voxel = voxel?;
        if 2 * used >= table.len() {
            let mut larger = vec![FREE; 2 * table.len()];
            for brick in table.into_iter().filter(|b| b.mask != 0) {
                let at = slot(&larger, brick.place);
                larger[at] = brick;
            }
            table = larger;
        }
        let (place, bit) = split(voxel);
        let at = slot(&table, place);
        used += usize::from(table[at].mask == 0);
        table[at].place = place;
        table[at].mask |= bit;
    }
    Ok(table)
}

/// The slot of a brick, or the free one where it would go. At least half of the slots are free, so the search ends.
fn slot(table: &[Brick], place: IVec3) -> usize {
    let mask = table.len() - 1;
    let mut at = hash(place) & mask;
    while table[at].mask != 0 && table[at].place != place {
        at = (at + 1) & mask;
    }
    at
}

/// The number of an occupied voxel.
fn number(table: &[Brick], voxel: IVec3) -> Option<usize> {
    let (place, bit) = split(voxel);
    let brick = &table[slot(table, place)];
    let below = brick.mask & (bit - 1);
    (brick.mask & bit != 0).then(|| (brick.first + below.count_ones()) as usize)
}

/// A voxel's brick, and its bit there.
fn split(voxel: IVec3) -> (IVec3, u64) {
    let inside = voxel & 3;
    (voxel >> 2, 1 << (16 * inside.x + 4 * inside.y + inside.z))
}

fn hash(place: IVec3) -> usize {
    let [x, y, z] = place.to_array().map(|v| u64::from(v as u32));
    // 21 bits an axis fill the word; larger coordinates only share slots.
    mix(x ^ (y << 21) ^ (z << 42)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Rgb,
        surfel::{Grid, Patch, Surfel},
    };

    fn surfel(voxel: IVec3, normal: Vec3) -> Surfel {
        Surfel::from(Patch {
            voxel,
            centroid: voxel.as_vec3() + 0.5,
            normal,
            area: 1.0,
            albedo: Rgb::ONE,
            fill: 1.0,
            triangle: 0,
            u: 0.0,
            v: 0.0,
            back: false,
        })
    }

    #[test]
    fn every_surfel_is_found_from_its_own_centre_and_side() {
        let mut list = Vec::new();
        for x in -37..39 {
            for y in 0..41 {
                let z = (x * 7 + y * 3) % 5;
                list.push(surfel(IVec3::new(x, y, z), Vec3::Z));
                list.push(surfel(IVec3::new(x, y, z), -Vec3::Z));
            }
        }
        let surfels = Surfels::dark(Grid { origin: Vec3::ZERO, edge: 1.0, size: IVec3::splat(16) }, list);
        let index = SurfelIndex::new(&surfels);
        for (i, s) in surfels.list.iter().enumerate() {
            assert_eq!(index.find(s.centroid, s.normal), Some(i));
        }
        // Sideways nobody looks; far away nobody is.
        assert_eq!(index.find(surfels.list[0].centroid, Vec3::X), None);
        assert_eq!(index.find(Vec3::splat(1e9), Vec3::Z), None);
        // Half a voxel outside the sheet the nearest neighbour answers.
        let edge = Vec3::new(-37.2, 0.5, surfels.list[0].centroid.z);
        assert_eq!(index.find(edge, Vec3::Z), Some(0));
    }

    #[test]
    fn an_empty_index_finds_nothing() {
        let surfels = Surfels::dark(Grid { origin: Vec3::ZERO, edge: 1.0, size: IVec3::ONE }, Vec::new());
        assert_eq!(SurfelIndex::new(&surfels).find(Vec3::ZERO, Vec3::Z), None);
    }
}
