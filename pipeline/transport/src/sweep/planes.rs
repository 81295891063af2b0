//! The planes that surfels lie in.
//!
//! A wall is thousands of surfels of one plane. Whatever a sweep asks about a normal alone (on which side a line
//! passes, whether its next voxel lies behind) has one answer per plane and direction, and two surfels of one plane
//! belong to one surface without a look at their centroids. Each surfel of a curved surface has a plane of its own;
//! they are numbered such that planes of similar direction are neighbours, which lets the sweep's branches repeat.

use std::collections::HashMap;

use glam::Vec3;

use crate::surfel::Surfels;

/// Normals are the same to 1/STEPS in each component; an angle of 1e-5 moves a plane by a hundredth of a voxel at
/// the far end of the largest grid.
const STEPS: f32 = 65536.0;

/// Planes are the same within this share of a voxel edge. Much below the tolerance that makes surfels coplanar, so
/// that surfels of one plane always are.
const THICKNESS: f32 = 0.125;

/// The planes of all surfels.
pub struct Planes {
    /// Plane of every surfel, in the order of the list.
    pub of: Vec<u32>,
    /// Unit normal of every plane.
    pub normals: Vec<Vec3>,
}

/// A normal in steps, and the distance from the origin in thicknesses.
type Key = ([i32; 3], i32);

impl Planes {
    pub fn new(surfels: &Surfels) -> Self {
        let mut found: HashMap<Key, u32> = HashMap::new();
        let mut keys = Vec::new();
        let mut of: Vec<u32> = Vec::with_capacity(surfels.list.len());
        for s in &surfels.list {
            let key = key(s.normal, surfels.grid.local(s.centroid));
            let next = keys.len() as u32;
            of.push(*found.entry(key).or_insert_with(|| {
                keys.push(key);
                next
            }));
        }
        let mut sorted: Vec<u32> = (0..keys.len() as u32).collect();
        sorted.sort_unstable_by_key(|&k| (locality(keys[k as usize].0), keys[k as usize]));
        let mut rank = vec![0; keys.len()];
        sorted.iter().enumerate().for_each(|(r, &k)| rank[k as usize] = r as u32);
        of.iter_mut().for_each(|k| *k = rank[*k as usize]);
        let normal = |&k: &u32| Vec3::from(keys[k as usize].0.map(|steps| steps as f32 / STEPS));
        Self { of, normals: sorted.iter().map(normal).collect() }
    }
}

fn key(normal: Vec3, local: Vec3) -> Key {
    let steps = (normal * STEPS).round();
    // Shifted by no simple fraction: walls lie at simple ones.
    let distance = ((steps / STEPS).dot(local) / THICKNESS + 0.37).floor();
    (steps.as_ivec3().to_array(), distance as i32)
}

/// The cell of a coarse grid along a Z-order curve.
fn locality(normal: [i32; 3]) -> u32 {
    let cell = normal.map(|c| ((c as f32 / STEPS + 1.0) * 15.5) as u32);
    (0..5).fold(0, |z, bit| (0..3).fold(z, |z, axis| z | (cell[axis] >> bit & 1) << (3 * bit + axis)))
}
