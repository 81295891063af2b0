//! A mesh made ready for unwrapping: welded vertices, face normals, areas, manifold adjacency.

use std::collections::HashMap;

use glam::{DVec3, Vec3};
use luxel_scene::Mesh;

/// Below this ratio of height to longest edge a triangle is a line in f32 and gets no chart.
const SLIVER: f64 = 1e-6;

/// Digest of all that an unwrap reads of a mesh: positions, normals, triangles. Names and materials do not matter.
pub fn mesh_key(mesh: &Mesh) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"luxel charts");
    for (len, bytes) in [
        (mesh.positions.len(), bytemuck::cast_slice(&mesh.positions)),
        (mesh.normals.len(), bytemuck::cast_slice(&mesh.normals)),
        (mesh.triangles.len(), bytemuck::cast_slice::<_, u8>(&mesh.triangles)),
    ] {
        hasher.update(&(len as u64).to_le_bytes());
        hasher.update(bytes);
    }
    *hasher.finalize().as_bytes()
}

/// A mesh with what unwrapping and stitching need to know about it. Lengths in object units.
pub(crate) struct Solid<'a> {
    pub mesh: &'a Mesh,
    /// For each vertex a number shared by all vertices at exactly the same place.
    pub weld: Vec<u32>,
    /// Unit face normals; zero for triangles that are degenerate or not finite.
    pub normals: Vec<DVec3>,
    /// Areas; zero for triangles that get no chart.
    pub areas: Vec<f64>,
}

/// Two triangles that share an edge, seen from the first: corner `k` to corner `k + 1` in each.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Joint {
    pub triangles: [u32; 2],
    /// Corner at which the edge starts, in each triangle; the second runs it backwards.
    pub starts: [usize; 2],
}

impl<'a> Solid<'a> {
    pub fn new(mesh: &'a Mesh) -> Self {
        let mut places: HashMap<[u32; 3], u32> = HashMap::with_capacity(mesh.positions.len());
        let weld = mesh
            .positions
            .iter()
            .map(|p| {
                let next = places.len() as u32;
                // Adding zero turns −0 into +0.
                *places.entry((*p + Vec3::ZERO).to_array().map(f32::to_bits)).or_insert(next)
            })
            .collect();
        let mut solid = Self { mesh, weld, normals: Vec::new(), areas: Vec::new() };
        (solid.normals, solid.areas) = mesh.triangles.iter().map(|t| solid.face(t)).unzip();
        solid
    }

    /// Unit normal and area of a face, or zeros.
    fn face(&self, triangle: &[u32; 3]) -> (DVec3, f64) {
        if triangle.iter().any(|&v| v as usize >= self.mesh.positions.len()) {
            return (DVec3::ZERO, 0.0);
        }
        let [a, b, c] = triangle.map(|v| self.position(v));
        let (e, f) = (b - a, c - a);
        let longest = e.length().max(f.length()).max((c - b).length());
        if !longest.is_finite() || longest <= 0.0 {
            return (DVec3::ZERO, 0.0);
        }
        // Scaled first, so that neither huge nor tiny triangles leave the range of numbers.
        let cross = (e / longest).cross(f / longest);
        let twice = cross.length();
        if !twice.is_finite() || twice <= SLIVER {
            return (DVec3::ZERO, 0.0);
        }
        (cross / twice, 0.5 * twice * longest * longest)
    }

    pub fn position(&self, vertex: u32) -> DVec3 {
        self.mesh.positions[vertex as usize].as_dvec3()
    }

    pub fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.mesh.triangles[triangle as usize].map(|v| self.position(v))
    }

    pub fn has_normals(&self) -> bool {
        !self.mesh.normals.is_empty() && self.mesh.normals.len() == self.mesh.positions.len()
    }

    /// The vertex normal, or zero where there is none.
    pub fn normal(&self, vertex: u32) -> DVec3 {
        if !self.has_normals() {
            return DVec3::ZERO;
        }
        self.mesh.normals[vertex as usize].as_dvec3().try_normalize().unwrap_or(DVec3::ZERO)
    }

    /// A key that tells different vertex normals apart.
    pub fn normal_bits(&self, vertex: u32) -> [u32; 3] {
        if self.has_normals() { self.mesh.normals[vertex as usize].to_array().map(f32::to_bits) } else { [0; 3] }
    }

    pub fn bounds(&self, triangles: &[u32]) -> (DVec3, DVec3) {
        let mut bounds = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for p in triangles.iter().flat_map(|&t| self.corners(t)) {
            bounds = (bounds.0.min(p), bounds.1.max(p));
        }
        bounds
    }

    /// Every edge that exactly two proper triangles share with opposite directions, in a fixed order.
    pub fn joints(&self) -> Vec<Joint> {
        let mut edges: Vec<(u32, u32, bool, u32, u8)> = Vec::with_capacity(self.mesh.triangles.len() * 3);
        for (t, triangle) in self.mesh.triangles.iter().enumerate() {
            if self.areas[t] <= 0.0 {
                continue;
            }
            for k in 0..3 {
                let a = self.weld[triangle[k] as usize];
                let b = self.weld[triangle[(k + 1) % 3] as usize];
                edges.push((a.min(b), a.max(b), a > b, t as u32, k as u8));
            }
        }
        edges.sort_unstable();
        edges
            .chunk_by(|e, f| (e.0, e.1) == (f.0, f.1))
            .filter_map(|run| match run {
                [e, f] if e.2 != f.2 && e.0 != e.1 => {
                    Some(Joint { triangles: [e.3, f.3], starts: [usize::from(e.4), usize::from(f.4)] })
                }
                _ => None,
            })
            .collect()
    }

    /// Cosine between the faces of a joint: 1 in one plane.
    pub fn bend(&self, joint: &Joint) -> f64 {
        self.normals[joint.triangles[0] as usize].dot(self.normals[joint.triangles[1] as usize])
    }

    /// Smallest cosine between the vertex normals that the two faces of a joint have at its two ends; None without
    /// vertex normals.
    pub fn shading_bend(&self, joint: &Joint) -> Option<f64> {
        if !self.has_normals() {
            return None;
        }
        let [s, t] = joint.triangles.map(|t| self.mesh.triangles[t as usize]);
        let [i, j] = joint.starts;
        let ends = [(s[i], t[(j + 1) % 3]), (s[(i + 1) % 3], t[j])];
        Some(ends.iter().map(|&(a, b)| self.normal(a).dot(self.normal(b))).fold(1.0, f64::min))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quad_with_split_vertices_has_one_joint() {
        let p = [Vec3::ZERO, Vec3::X, Vec3::ONE, Vec3::ZERO, Vec3::ONE, Vec3::Y];
        let mesh = Mesh { positions: p.to_vec(), triangles: vec![[0, 1, 2], [3, 4, 5]], ..Mesh::default() };
        let solid = Solid::new(&mesh);
        assert_eq!(solid.weld, [0, 1, 2, 0, 2, 3]);
        assert_eq!(solid.joints().len(), 1);
    }

    #[test]
    fn lines_and_broken_points_have_no_area() {
        let p = [Vec3::ZERO, Vec3::X, 2.0 * Vec3::X, Vec3::splat(f32::NAN), Vec3::splat(1e38), -Vec3::splat(1e38)];
        let triangles = vec![[0, 1, 2], [0, 1, 3], [0, 0, 1], [4, 5, 1]];
        let mesh = Mesh { positions: p.to_vec(), triangles, ..Mesh::default() };
        let areas = Solid::new(&mesh).areas;
        assert_eq!(areas[..3], [0.0; 3]);
        assert!(areas[3].is_finite());
    }

    #[test]
    fn the_key_sees_geometry_and_nothing_else() {
        let mesh = Mesh { positions: vec![Vec3::ZERO; 3], triangles: vec![[0, 1, 2]], ..Mesh::default() };
        let renamed = Mesh { name: "other".into(), material: 3, ..mesh.clone() };
        assert_eq!(mesh_key(&mesh), mesh_key(&renamed));
        let moved = Mesh { positions: vec![Vec3::X; 3], ..mesh.clone() };
        assert_ne!(mesh_key(&mesh), mesh_key(&moved));
    }
}
