//! The scene's triangles in the normalised frame, with what shading needs at a point on one of them.

use glam::{DMat3, DVec3, Vec3};
use luxel_scene::{Instance, Mesh, Scene, Surface};
use rayon::prelude::*;

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

/// Largest number of triangles of a [`Geometry`], instances expanded: the ray tracer keeps two bits of an index for
/// itself. The importer refuses larger scenes.
pub const MAX_TRIANGLES: usize = 1 << 30;

/// A triangle that no ray meets.
const NOWHERE: Triangle = Triangle { corners: [Vec3::ZERO; 3], normal: Vec3::ZERO, instance: 0, index: 0 };

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
    /// Places all instances. The frame is that of the lit world: unlit instances (sky domes) do not stretch it.
    ///
    /// # Panics
    /// When the instances hold more than [`MAX_TRIANGLES`] triangles together.
    pub fn new(scene: &'a Scene) -> Self {
        let count = scene.triangle_count();
        assert!(count <= MAX_TRIANGLES, "{}: {count} triangles are more than {MAX_TRIANGLES}", scene.name);
        let frame = lit_frame(scene);
        let mut triangles = vec![NOWHERE; count];
        let mut first = Vec::with_capacity(scene.instances.len() + 1);
        let (mut parts, mut rest, mut at) = (Vec::with_capacity(scene.instances.len()), &mut triangles[..], 0);
        for (i, instance) in scene.instances.iter().enumerate() {
            let (part, others) = rest.split_at_mut(scene.meshes[instance.mesh].triangles.len());
            first.push(at);
            at += part.len() as u32;
            parts.push((i as u32, part));
            rest = others;
        }
        first.push(at);
        parts.into_par_iter().for_each(|(i, part)| {
            let placed = Placed::new(scene, i, &frame);
            part.par_iter_mut().with_min_len(1024).enumerate().for_each(|(t, triangle)| *triangle = placed.triangle(t));
        });
        let normal_matrices = scene.instances.iter().map(|i| normal_matrix(&i.transform.matrix3)).collect();
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

/// The frame of everything that is not unlit.
fn lit_frame(scene: &Scene) -> Frame {
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for instance in &scene.instances {
        let mesh = &scene.meshes[instance.mesh];
        if scene.materials[mesh.material].unlit {
            continue;
        }
        for &i in mesh.triangles.iter().flatten() {
            let p = instance.transform.transform_point3(mesh.positions[i as usize].as_dvec3());
            if p.is_finite() {
                (lo, hi) = (lo.min(p), hi.max(p));
            }
        }
    }
    Frame::new(lo, hi)
}

/// The cofactor matrix: the inverse transpose times the determinant, and there for singular matrices too; mirrored
/// with the winding.
fn normal_matrix(m: &DMat3) -> DMat3 {
    let cofactor = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    if m.determinant() < 0.0 { cofactor * -1.0 } else { cofactor }
}

/// An instance on its way into the frame.
struct Placed<'a> {
    mesh: &'a Mesh,
    instance: &'a Instance,
    id: u32,
    frame: &'a Frame,
    mirrored: bool,
}

impl<'a> Placed<'a> {
    fn new(scene: &'a Scene, id: u32, frame: &'a Frame) -> Self {
        let instance = &scene.instances[id as usize];
        let mirrored = instance.transform.matrix3.determinant() < 0.0;
        Self { mesh: &scene.meshes[instance.mesh], instance, id, frame, mirrored }
    }

    fn triangle(&self, index: usize) -> Triangle {
        let corners = self.mesh.triangles[index].map(|v| {
            let p = self.instance.transform.transform_point3(self.mesh.positions[v as usize].as_dvec3());
            (p - self.frame.center) * self.frame.scale
        });
        let cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let corners = corners.map(|p| p.as_vec3());
        let place = Triangle { instance: self.id, index: index as u32, ..NOWHERE };
        match cross.try_normalize() {
            // A corner beyond the range of f32 leaves nothing to trace.
            Some(normal) if corners.iter().all(|p| p.is_finite()) => {
                let normal = if self.mirrored { -normal } else { normal }.as_vec3();
                Triangle { corners, normal, ..place }
            }
            _ if corners.iter().all(|p| p.is_finite()) => Triangle { corners, ..place },
            _ => place,
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;
    use luxel_scene::{Material, build::Builder};

    use super::*;

    fn quad() -> Builder {
        let mut b = Builder::new("quad");
        let white = b.matte(Vec3::splat(0.5));
        b.quad("quad", Vec3::ZERO, Vec3::X, Vec3::Y, white);
        b
    }

    #[test]
    fn a_sky_dome_does_not_stretch_the_frame() {
        let alone = Geometry::new(&quad().build()).frame;
        let mut b = quad();
        let dome = b.material(Material { unlit: true, ..Material::default() });
        b.sphere("dome", Vec3::ZERO, 1e5, 8, dome, true);
        assert_eq!(Geometry::new(&b.build()).frame, alone);
    }

    #[test]
    fn what_has_no_area_or_no_place_is_degenerate() {
        for transform in [
            DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0)),
            DAffine3::from_scale(DVec3::splat(f64::INFINITY)),
            DAffine3::from_scale(DVec3::splat(f64::NAN)),
        ] {
            let mut b = quad();
            b.place(0, transform, "broken");
            let scene = b.build();
            let geometry = Geometry::new(&scene);
            assert_eq!(geometry.first, [0, 2, 4]);
            for t in &geometry.triangles[2..] {
                assert!(t.is_degenerate(), "{transform}: {t:?}");
                assert!(t.corners.iter().all(|p| p.is_finite()), "{transform}: {t:?}");
            }
        }
    }

    /// Normals turn with the inverse transpose: a sheared and squeezed plane keeps them upright.
    #[test]
    fn vertex_normals_stay_perpendicular() {
        let mut b = quad();
        b.scene_mut().meshes[0].normals = vec![Vec3::Z; 4];
        let mut squeeze = DAffine3::from_scale(DVec3::new(1.0, 3.0, -0.1));
        squeeze.matrix3.x_axis.z = 0.7;
        b.place(0, squeeze, "squeezed");
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let t = &geometry.triangles[2];
        let n = geometry.shading_normal(2, 0.2, 0.3);
        assert!(n.abs_diff_eq(t.normal, 1e-6), "{n} {}", t.normal);
        assert!((t.corners[1] - t.corners[0]).dot(n).abs() < 1e-3);
    }
}
