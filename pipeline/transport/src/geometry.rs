//! The scene's triangles in the normalised frame, with what shading needs at a point on one of them.

use glam::{DMat3, DVec3, Vec3};
use luxel_scene::{Scene, Surface};

use crate::frame::Frame;

/// One world triangle in frame units.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    pub corners: [Vec3; 3],
    /// Unit geometric normal on the front side; zero where the triangle has no area after its transform.
    pub normal: Vec3,
    pub instance: u32,
    /// Index among the triangles of the instance's mesh.
    pub index: u32,
}

impl Triangle {
    /// The point at barycentric coordinates (1−u−v, u, v).
    pub fn at(&self, u: f32, v: f32) -> Vec3 {
        let [a, b, c] = self.corners;
        a + (b - a) * u + (c - a) * v
    }

    /// Area in squared frame units.
    pub fn area(&self) -> f32 {
        let [a, b, c] = self.corners;
        0.5 * (b - a).cross(c - a).length()
    }

    pub fn is_degenerate(&self) -> bool {
        self.normal == Vec3::ZERO
    }
}

/// All triangles of all instances, instance by instance, in mesh order: the triangle of (instance, index) is
/// `first[instance] + index`. Instances that neither cast nor receive are present too, so that indices stay simple.
pub struct Geometry<'a> {
    pub scene: &'a Scene,
    pub frame: Frame,
    pub triangles: Vec<Triangle>,
    /// First triangle of each instance; one more entry than instances.
    pub first: Vec<u32>,
    /// Object-to-world matrix for normals (inverse transpose, up to scale) of each instance.
    normal_matrices: Vec<DMat3>,
}

impl<'a> Geometry<'a> {
    pub fn new(scene: &'a Scene) -> Self {
        let (lo, hi) = scene.bounds().unwrap_or((DVec3::ZERO, DVec3::ZERO));
        let frame = Frame::new(lo, hi);
        let mut triangles = Vec::with_capacity(scene.triangle_count());
        let mut first = Vec::with_capacity(scene.instances.len() + 1);
        let mut normal_matrices = Vec::with_capacity(scene.instances.len());
        for (i, instance) in scene.instances.iter().enumerate() {
            first.push(triangles.len() as u32);
            let mesh = &scene.meshes[instance.mesh];
            let m = instance.transform.matrix3;
            let mirrored = m.determinant() < 0.0;
            // The cofactor matrix is the inverse transpose times the determinant, and exists for singular matrices too.
            let cofactor =
                DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
            normal_matrices.push(if mirrored { cofactor * -1.0 } else { cofactor });
            for (t, corners) in mesh.triangles.iter().enumerate() {
                let world = corners.map(|v| {
                    let p = instance.transform.transform_point3(mesh.positions[v as usize].as_dvec3());
                    (p - frame.center) * frame.scale
                });
                let cross = (world[1] - world[0]).cross(world[2] - world[0]);
                let normal = cross.try_normalize().unwrap_or(DVec3::ZERO);
                triangles.push(Triangle {
                    corners: world.map(|p| p.as_vec3()),
                    normal: if mirrored { -normal } else { normal }.as_vec3(),
                    instance: i as u32,
                    index: t as u32,
                });
            }
        }
        first.push(triangles.len() as u32);
        Self { scene, frame, triangles, first, normal_matrices }
    }

    /// Index of a mesh triangle of an instance among [`Geometry::triangles`].
    pub fn triangle(&self, instance: u32, index: u32) -> u32 {
        self.first[instance as usize] + index
    }

    pub fn material(&self, triangle: u32) -> &luxel_scene::Material {
        let t = &self.triangles[triangle as usize];
        let mesh = &self.scene.meshes[self.scene.instances[t.instance as usize].mesh];
        &self.scene.materials[mesh.material]
    }

    /// The material at a point of a triangle, textures averaged over `footprint` in UV units.
    pub fn surface(&self, triangle: u32, u: f32, v: f32, footprint: f32) -> Surface {
        let t = &self.triangles[triangle as usize];
        let mesh = self.scene.instances[t.instance as usize].mesh;
        self.scene.surface(mesh, t.index as usize, u, v, footprint)
    }

    /// The interpolated vertex normal at a point of a triangle, on the front side of the face; the geometric normal
    /// where there is none or where the vertex normals contradict the face.
    pub fn shading_normal(&self, triangle: u32, u: f32, v: f32) -> Vec3 {
        let t = &self.triangles[triangle as usize];
        let mesh = &self.scene.meshes[self.scene.instances[t.instance as usize].mesh];
        if mesh.normals.is_empty() {
            return t.normal;
        }
        let [a, b, c] = mesh.triangles[t.index as usize].map(|i| mesh.normals[i as usize].as_dvec3());
        let object = a * f64::from(1.0 - u - v) + b * f64::from(u) + c * f64::from(v);
        let world = (self.normal_matrices[t.instance as usize] * object).try_normalize().map(|n| n.as_vec3());
        match world {
            Some(n) if n.is_finite() && n.dot(t.normal) > 0.0 => n,
            _ => t.normal,
        }
    }
}
