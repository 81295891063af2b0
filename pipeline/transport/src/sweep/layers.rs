//! The order of surfels in a voxel that a wall divides.
//!
//! By the depth of centroids alone, a line that runs steeply up through the foot of a thin wall meets the lit floor of the
//! far side before the wall's near face, which then sees it. A wall divides its voxel in layers (binary space partition,
//! Fuchs, Kedem & Naylor 1980): what lies behind its faces, the faces, what lies before them. A line goes through one
//! layer after the other; depth counts within a layer only.

use crate::surfel::{Surfel, Surfels};

/// Least cosine between the normals of two parts of a surface, on both sides of a wall.
const TWIN: f32 = 0.99;

/// Cosine from which on faces belong to one wall.
const PARALLEL: f32 = 0.9;

/// Distance from a plane, in voxel edges, that counts as on it.
const ON_PLANE: f32 = 1e-4;

/// Layers of a voxel: what lies beyond the last one is in it.
const MOST: u8 = 7;

/// Set where the voxel is divided, and on the wall itself.
const DIVIDED: u8 = 1 << 3;
const WALL: u8 = 1 << 4;

/// Set where a voxel holds both faces of something thin.
const THIN: u8 = 1 << 5;

/// Distance between two faces that makes them thin, in voxel edges.
const THICKNESS: f32 = 0.5;

/// The place of a surfel in its voxel.
#[derive(Clone, Copy, Default)]
pub struct Layer(u8);

impl Layer {
    pub const BITS: u32 = 6;

    pub fn from_bits(bits: u32) -> Self {
        Self(bits as u8)
    }

    pub fn bits(self) -> u32 {
        u32::from(self.0)
    }

    /// Whether a wall divides the voxel.
    pub fn is_divided(self) -> bool {
        self.0 & DIVIDED != 0
    }

    /// There is something in the voxel that both of its sides are near to.
    pub fn is_thin(self) -> bool {
        self.0 & (DIVIDED | THIN) != 0
    }

    /// The surfel is the wall along whose normal layers count.
    pub fn is_wall(self) -> bool {
        self.0 & WALL != 0
    }

    /// The surfel is a face of the wall.
    pub fn is_face(self) -> bool {
        self.is_divided() && self.number() % 2 == 1
    }

    pub fn number(self) -> u8 {
        self.0 & MOST
    }
}

/// The layers of all surfels, in the order of the list; empty where nothing is thin and no wall divides any voxel.
pub fn layers(surfels: &Surfels) -> Vec<Layer> {
    let (edge, mut layers) = (surfels.grid.edge, Vec::new());
    let mut first = 0;
    for mates in surfels.list.chunk_by(|a, b| a.voxel() == b.voxel()) {
        let (wall, thin) = (wall(mates, edge), if is_thin(mates, edge) { THIN } else { 0 });
        if wall.is_some() || thin != 0 {
            layers.resize(surfels.list.len(), Layer::default());
        }
        for (i, s) in mates.iter().enumerate().filter(|_| wall.is_some() || thin != 0) {
            let place = wall.map_or(0, |w| number(mates, &mates[w], s, edge) | DIVIDED);
            layers[first + i] = Layer(place | thin | if wall == Some(i) { WALL } else { 0 });
        }
        first += mates.len();
    }
    layers
}

/// Two surfels of a voxel look away from each other and are close.
fn is_thin(mates: &[Surfel], edge: f32) -> bool {
    let is_back = |a: &Surfel, b: &Surfel| a.normal.dot(b.normal) < -PARALLEL && height(a, b, edge).abs() < THICKNESS;
    mates.iter().enumerate().any(|(i, a)| mates[i + 1..].iter().any(|b| is_back(a, b)))
}

/// How far a surfel lies in front of another one [voxel edges].
fn height(plane: &Surfel, s: &Surfel, edge: f32) -> f32 {
    plane.normal.dot(s.centroid - plane.centroid) / edge
}

fn is_across(wall: &Surfel, s: &Surfel) -> bool {
    wall.normal.dot(s.normal).abs() < PARALLEL
}

/// The surfel of a voxel that parts most pairs of surfels of one surface, the first one of equals.
fn wall(mates: &[Surfel], edge: f32) -> Option<usize> {
    let mut best = (0, None);
    for (w, wall) in mates.iter().enumerate().filter(|_| mates.len() > 2) {
        let mut parted = 0;
        for (i, a) in mates.iter().enumerate().filter(|(_, a)| is_across(wall, a)) {
            let at = height(wall, a, edge);
            let is_parted = |b: &&Surfel| a.normal.dot(b.normal) > TWIN && at * height(wall, b, edge) < 0.0;
            parted += mates[i + 1..].iter().filter(is_parted).count();
        }
        if parted > best.0 {
            best = (parted, Some(w));
        }
    }
    best.1
}

/// Odd numbers are faces of the wall, even ones what lies between and beside them, along the wall's normal.
fn number(mates: &[Surfel], wall: &Surfel, s: &Surfel, edge: f32) -> u8 {
    let along = |s: &Surfel| height(wall, s, edge);
    let is_face = !is_across(wall, s);
    let margin = if is_face { ON_PLANE } else { 0.0 };
    let faces = mates.iter().filter(|m| !is_across(wall, m));
    let below = faces.filter(|m| along(m) < along(s) - margin).count() as u8;
    // The highest number stays odd for faces and even for the rest.
    if is_face { (2 * below + 1).min(MOST) } else { (2 * below).min(MOST - 1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Rgb,
        surfel::{Grid, Patch},
    };
    use glam::{IVec3, Vec3};

    /// Surfels of voxels of edge 1: voxel, centroid, normal.
    fn surfels(list: &[(IVec3, Vec3, Vec3)]) -> Surfels {
        let surfel = |&(voxel, centroid, normal): &(IVec3, Vec3, Vec3)| {
            Surfel::from(Patch {
                voxel,
                centroid,
                normal,
                area: 0.5,
                albedo: Rgb::splat(0.5),
                fill: 1.0,
                triangle: 0,
                u: 0.0,
                v: 0.0,
                back: false,
            })
        };
        let grid = Grid { origin: Vec3::ZERO, edge: 1.0, size: IVec3::splat(2) };
        Surfels::dark(grid, list.iter().map(surfel).collect())
    }

    #[test]
    fn a_wall_parts_the_floor_on_both_of_its_sides() {
        let at = |x: f32, y: f32, normal: Vec3| (IVec3::ZERO, Vec3::new(x, y, 0.5), normal);
        let floor = |x: f32| at(x, 0.1, Vec3::Y);
        // Behind the wall, its two faces 0.1 apart, before it; in any order.
        let list = [at(0.5, 0.5, Vec3::X), floor(0.8), at(0.4, 0.5, Vec3::NEG_X), floor(0.2)];
        let found = layers(&surfels(&list));
        assert_eq!(found.iter().map(|l| l.number()).collect::<Vec<_>>(), [3, 4, 1, 0]);
        assert_eq!(found.iter().map(|l| l.is_face()).collect::<Vec<_>>(), [true, false, true, false]);
        assert_eq!(found.iter().map(|l| l.is_wall()).collect::<Vec<_>>(), [true, false, false, false]);
        assert!(found.iter().all(|l| l.is_divided() && l.is_thin() && Layer::from_bits(l.bits()).bits() == l.bits()));
    }

    #[test]
    fn what_nothing_divides_has_no_layers() {
        let corner = [
            (IVec3::ZERO, Vec3::new(0.5, 0.1, 0.5), Vec3::Y),
            (IVec3::ZERO, Vec3::new(0.1, 0.5, 0.5), Vec3::X),
            (IVec3::X, Vec3::new(1.5, 0.1, 0.5), Vec3::Y),
        ];
        assert!(layers(&surfels(&corner)).is_empty());
        // Two sides of a slab are thin, but part nothing; and farther apart than half a voxel not even that.
        let slab = |gap: f32| {
            let both = [(Vec3::new(0.5, 0.2 + gap, 0.5), Vec3::Y), (Vec3::new(0.5, 0.2, 0.5), Vec3::NEG_Y)];
            layers(&surfels(&both.map(|(centroid, normal)| (IVec3::ZERO, centroid, normal))))
        };
        assert!(slab(0.1).iter().all(|l| l.is_thin() && !l.is_divided()) && slab(0.1).len() == 2);
        assert!(slab(0.6).is_empty());
    }

    #[test]
    fn voxels_are_divided_one_by_one() {
        let at =
            |voxel: i32, x: f32, normal: Vec3| (IVec3::new(voxel, 0, 0), Vec3::new(voxel as f32 + x, 0.3, 0.5), normal);
        let list =
            [at(0, 0.5, Vec3::Y), at(0, 0.1, Vec3::X), at(1, 0.2, Vec3::Y), at(1, 0.5, Vec3::X), at(1, 0.7, Vec3::Y)];
        let found = layers(&surfels(&list));
        assert_eq!(found.iter().map(|l| l.is_divided()).collect::<Vec<_>>(), [false, false, true, true, true]);
        assert_eq!(found[2..].iter().map(|l| l.number()).collect::<Vec<_>>(), [0, 1, 2]);
    }
}
