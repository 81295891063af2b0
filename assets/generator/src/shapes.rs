//! Shapes that the scenes share.

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use luxel_scene::{Camera, Material, Mesh, build::Builder};

/// A named Lambertian material.
pub fn matte(b: &mut Builder, name: &str, albedo: [f32; 3]) -> usize {
    b.material(Material { name: name.into(), base_color: Vec3::from(albedo).extend(1.0), ..Material::default() })
}

/// A named Lambertian emitter of radiance `radiance` [cd/m²].
pub fn lamp(b: &mut Builder, name: &str, albedo: [f32; 3], radiance: [f32; 3]) -> usize {
    b.material(Material {
        name: name.into(),
        base_color: Vec3::from(albedo).extend(1.0),
        emission: radiance.into(),
        ..Material::default()
    })
}

/// Collects quads into one mesh; every quad has its own four vertices.
#[derive(Default)]
pub struct Quads {
    positions: Vec<Vec3>,
    uvs: Vec<Vec2>,
    triangles: Vec<[u32; 3]>,
}

impl Quads {
    /// A parallelogram that looks along `a × b`; texture coordinates run along a and b, `per_metre` to the metre.
    pub fn push(&mut self, o: Vec3, a: Vec3, b: Vec3, per_metre: f32) -> &mut Self {
        let at = self.positions.len() as u32;
        self.positions.extend([o, o + a, o + a + b, o + b]);
        let (u, v) = (a.length() * per_metre, b.length() * per_metre);
        self.uvs.extend([Vec2::new(0.0, v), Vec2::new(u, v), Vec2::new(u, 0.0), Vec2::ZERO]);
        self.triangles.extend([[at, at + 1, at + 2], [at, at + 2, at + 3]]);
        self
    }

    pub fn mesh(self, name: &str, material: usize) -> Mesh {
        Mesh {
            name: name.into(),
            positions: self.positions,
            uvs: vec![self.uvs],
            triangles: self.triangles,
            material,
            ..Mesh::default()
        }
    }
}

/// A wall along X with a rectangular hole: from (0, 0) to (`width`, `height`) in its own x and y, between z = 0 and
/// z = −`thickness`, its front towards +Z. It has no rim, since it ends in other walls; the hole is lined.
pub struct PiercedWall {
    pub width: f32,
    pub height: f32,
    pub thickness: f32,
    /// Lower left and upper right corner of the hole; a hole that reaches down to 0 is a door and has no sill.
    pub hole: [Vec2; 2],
    pub per_metre: f32,
}

impl PiercedWall {
    pub fn mesh(&self, name: &str, material: usize) -> Mesh {
        let [lo, hi] = self.hole;
        let (xs, ys) = ([0.0, lo.x, hi.x, self.width], [0.0, lo.y, hi.y, self.height]);
        let mut quads = Quads::default();
        for i in 0..3 {
            for j in 0..3 {
                let (dx, dy) = (xs[i + 1] - xs[i], ys[j + 1] - ys[j]);
                if (i == 1 && j == 1) || dx <= 0.0 || dy <= 0.0 {
                    continue;
                }
                let front = Vec3::new(xs[i], ys[j], 0.0);
                let back = Vec3::new(xs[i + 1], ys[j], -self.thickness);
                quads.push(front, Vec3::X * dx, Vec3::Y * dy, self.per_metre);
                quads.push(back, Vec3::NEG_X * dx, Vec3::Y * dy, self.per_metre);
            }
        }
        let depth = Vec3::NEG_Z * self.thickness;
        let (wide, high) = (Vec3::X * (hi.x - lo.x), Vec3::Y * (hi.y - lo.y));
        let corner = lo.extend(0.0);
        // The lining looks into the hole: left, right, top, and the sill of a window.
        quads.push(corner, depth, high, self.per_metre);
        quads.push(corner + wide, high, depth, self.per_metre);
        quads.push(corner + high, depth, wide, self.per_metre);
        if lo.y > 0.0 {
            quads.push(corner, wide, depth, self.per_metre);
        }
        quads.mesh(name, material)
    }
}

/// The side of an upright cylinder with smooth normals: base centre, radius, height.
pub fn column(name: &str, center: Vec3, radius: f32, height: f32, sides: u32, material: usize) -> Mesh {
    let mut mesh = Mesh { name: name.into(), material, ..Mesh::default() };
    for i in 0..sides {
        let angle = std::f64::consts::TAU * f64::from(i) / f64::from(sides);
        let out = DVec3::new(libm::cos(angle), 0.0, libm::sin(angle)).as_vec3();
        mesh.positions.extend([center + out * radius, center + out * radius + Vec3::Y * height]);
        mesh.normals.extend([out, out]);
    }
    for i in 0..sides {
        let (a, b) = (2 * i, 2 * ((i + 1) % sides));
        mesh.triangles.extend([[a, a + 1, b + 1], [a, b + 1, b]]);
    }
    mesh
}

/// A camera at `eye` that looks at `target`, with a vertical field of view in degrees.
pub fn camera(name: &str, eye: [f64; 3], target: [f64; 3], yfov: f64, aspect: f64) -> Camera {
    let (eye, target) = (DVec3::from(eye), DVec3::from(target));
    let back = (eye - target).normalize();
    let right = DVec3::Y.cross(back).normalize();
    let rotation = DMat3::from_cols(right, back.cross(right), back);
    Camera {
        name: name.into(),
        transform: DAffine3::from_mat3_translation(rotation, eye),
        yfov: yfov.to_radians(),
        aspect: Some(aspect),
    }
}
