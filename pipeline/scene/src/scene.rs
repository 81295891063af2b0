//! The scene: meshes in object space, their instances in the world, and everything that shines.

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};
use std::path::PathBuf;
use std::sync::Arc;

use crate::{Light, Material, Sky, Surface, Texture};

/// A level as luxel sees it. Indices between its lists are always valid (the importer and the builder see to it).
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Name for messages: the file name, as a rule.
    pub name: String,
    pub meshes: Vec<Mesh>,
    pub instances: Vec<Instance>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    pub lights: Vec<Light>,
    pub sky: Sky,
    pub cameras: Vec<Camera>,
    /// What the importer repaired, dropped or assumed, for the report.
    pub notices: Vec<Notice>,
    /// Every file that was read, with the BLAKE3 digest of its bytes.
    pub inputs: Vec<InputFile>,
}

/// One glTF primitive: triangles in object space, as stored in the file (f32).
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// For messages: `mesh 3 "Wall" primitive 0`.
    pub name: String,
    /// Index of the glTF mesh and of the primitive within it.
    pub gltf_mesh: usize,
    pub gltf_primitive: usize,
    /// Vertex positions, finite.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals, or empty: then faces are shaded flat.
    pub normals: Vec<Vec3>,
    /// Texture coordinate sets TEXCOORD_0, 1, …; a set that the primitive lacks is empty.
    pub uvs: Vec<Vec<Vec2>>,
    /// COLOR_0, linear RGBA, or empty.
    pub colors: Vec<Vec4>,
    /// Counter-clockwise seen from the front; indices are in range; no zero-area triangle in object space.
    pub triangles: Vec<[u32; 3]>,
    pub material: usize,
}

/// One mesh placed in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    pub mesh: usize,
    /// Object to world, accumulated over the node hierarchy in f64. A mirroring transform (negative determinant)
    /// flips the winding, as glTF says: the front side stays the outside.
    pub transform: DAffine3,
    /// glTF node index, and the index within its EXT_mesh_gpu_instancing list.
    pub node: usize,
    pub gpu_instance: Option<u32>,
    pub name: String,
    /// Gets a place in the lightmap.
    pub receives: bool,
    /// Blocks and bounces light.
    pub casts: bool,
    /// Factor on the lightmap's texel density (1 = as the rest).
    pub texel_scale: f32,
    /// Light group of its emission: the extra `luxel_group`, else the name of its node.
    pub group: Arc<str>,
}

#[derive(Clone, Debug)]
pub struct Camera {
    pub name: String,
    /// Camera to world; looks along −Z, up is +Y.
    pub transform: DAffine3,
    /// Vertical field of view, radians.
    pub yfov: f64,
    /// Width over height, where the file says.
    pub aspect: Option<f64>,
}

/// Something a person should know about their file: what was repaired, left out or assumed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// A stable word for machines, such as `degenerate-triangles`.
    pub code: &'static str,
    pub message: String,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputFile {
    pub path: PathBuf,
    /// BLAKE3 of the bytes that were read.
    pub digest: [u8; 32],
}

impl Scene {
    pub fn notice(&mut self, code: &'static str, message: impl Into<String>) {
        self.notices.push(Notice { code, message: message.into() });
    }

    /// The three object-space corners of a mesh triangle.
    pub fn corners(&self, mesh: usize, triangle: usize) -> [Vec3; 3] {
        let mesh = &self.meshes[mesh];
        mesh.triangles[triangle].map(|i| mesh.positions[i as usize])
    }

    /// What the surface is made of at barycentric coordinates (1−u−v, u, v) of a mesh triangle.
    ///
    /// `footprint` is the side of the square in UV space over which textures are averaged (0: a point sample).
    pub fn surface(&self, mesh: usize, triangle: usize, u: f32, v: f32, footprint: f32) -> Surface {
        let mesh = &self.meshes[mesh];
        let at = mesh.triangles[triangle].map(|i| i as usize);
        let w = [1.0 - u - v, u, v];
        let uv = |set: usize| match mesh.uvs.get(set) {
            Some(uvs) if !uvs.is_empty() => uvs[at[0]] * w[0] + uvs[at[1]] * w[1] + uvs[at[2]] * w[2],
            _ => Vec2::ZERO,
        };
        let color = if mesh.colors.is_empty() {
            Vec4::ONE
        } else {
            mesh.colors[at[0]] * w[0] + mesh.colors[at[1]] * w[1] + mesh.colors[at[2]] * w[2]
        };
        self.materials[mesh.material].surface(&self.textures, &uv, color, footprint)
    }

    /// Number of world triangles, instances expanded.
    pub fn triangle_count(&self) -> usize {
        self.instances.iter().map(|i| self.meshes[i.mesh].triangles.len()).sum()
    }

    /// World bounds of all instances, or None for an empty scene.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let mut bounds: Option<(DVec3, DVec3)> = None;
        for instance in &self.instances {
            let mesh = &self.meshes[instance.mesh];
            for &i in mesh.triangles.iter().flatten() {
                let p = instance.transform.transform_point3(mesh.positions[i as usize].as_dvec3());
                bounds = Some(bounds.map_or((p, p), |(lo, hi)| (lo.min(p), hi.max(p))));
            }
        }
        bounds
    }
}
