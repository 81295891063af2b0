//! Scenes in code: for tests, benches and the generator of the scenes that luxel ships.

use glam::{DAffine3, DVec3, Vec2, Vec3};

use crate::{Instance, Light, LightKind, Material, Mesh, Scene};

/// Builds a [`Scene`] from simple shapes. Every shape becomes a mesh of its own with one instance.
#[derive(Default)]
pub struct Builder {
    scene: Scene,
}

impl Builder {
    pub fn new(name: &str) -> Self {
        Self { scene: Scene { name: name.into(), ..Scene::default() } }
    }

    pub fn material(&mut self, material: Material) -> usize {
        self.scene.materials.push(material);
        self.scene.materials.len() - 1
    }

    /// A grey or coloured Lambertian material.
    pub fn matte(&mut self, albedo: Vec3) -> usize {
        let name = format!("matte {}", self.scene.materials.len());
        self.material(Material { name, base_color: albedo.extend(1.0), ..Material::default() })
    }

    /// A Lambertian emitter of the given albedo and radiance [cd/m²].
    pub fn emitter(&mut self, albedo: Vec3, radiance: Vec3) -> usize {
        let name = format!("emitter {}", self.scene.materials.len());
        self.material(Material { name, base_color: albedo.extend(1.0), emission: radiance, ..Material::default() })
    }

    /// Adds a mesh and one instance of it at the origin; returns the instance.
    pub fn mesh(&mut self, name: &str, positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, material: usize) -> usize {
        let mesh = Mesh { name: name.into(), positions, triangles, material, ..Mesh::default() };
        self.add(mesh)
    }

    /// Adds a whole mesh with one instance at the origin; returns the instance.
    pub fn add(&mut self, mut mesh: Mesh) -> usize {
        mesh.gltf_mesh = self.scene.meshes.len();
        let name = mesh.name.clone();
        self.scene.meshes.push(mesh);
        self.place(self.scene.meshes.len() - 1, DAffine3::IDENTITY, &name)
    }

    /// One more instance of a mesh; returns the instance.
    pub fn place(&mut self, mesh: usize, transform: DAffine3, name: &str) -> usize {
        self.scene.instances.push(Instance {
            mesh,
            transform,
            node: self.scene.instances.len(),
            gpu_instance: None,
            name: name.into(),
            receives: true,
            casts: true,
            texel_scale: 1.0,
            group: name.into(),
        });
        self.scene.instances.len() - 1
    }

    /// A parallelogram with corners `o`, `o+a`, `o+a+b`, `o+b`; its front looks along `a × b`; UVs run along a and b.
    pub fn quad(&mut self, name: &str, o: Vec3, a: Vec3, b: Vec3, material: usize) -> usize {
        let mesh = Mesh {
            name: name.into(),
            positions: vec![o, o + a, o + a + b, o + b],
            uvs: vec![vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material,
            ..Mesh::default()
        };
        self.add(mesh)
    }

    /// A closed axis-aligned box seen from outside, or from inside when `inward`.
    pub fn cuboid(&mut self, name: &str, lo: Vec3, hi: Vec3, material: usize, inward: bool) -> usize {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for axis in 0..3 {
            let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
            for side in 0..2 {
                let corner = |sj: f32, sk: f32| {
                    let mut p = lo;
                    p[axis] = if side == 1 { hi[axis] } else { lo[axis] };
                    p[j] = lo[j] + sj * (hi[j] - lo[j]);
                    p[k] = lo[k] + sk * (hi[k] - lo[k]);
                    p
                };
                let at = positions.len() as u32;
                positions.extend([corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)]);
                let flip = (side == 1) == inward;
                for t in [[0, 1, 2], [0, 2, 3]] {
                    let t = if flip { [t[0], t[2], t[1]] } else { t };
                    triangles.push(t.map(|i| i + at));
                }
            }
        }
        self.mesh(name, positions, triangles, material)
    }

    /// A UV sphere of `rings × 2 rings` patches, flat-shaded, seen from outside or from inside when `inward`.
    pub fn sphere(
        &mut self,
        name: &str,
        center: Vec3,
        radius: f32,
        rings: u32,
        material: usize,
        inward: bool,
    ) -> usize {
        let segments = 2 * rings;
        let mut positions = Vec::new();
        for i in 0..=rings {
            let theta = std::f64::consts::PI * f64::from(i) / f64::from(rings);
            for j in 0..segments {
                let phi = std::f64::consts::TAU * f64::from(j) / f64::from(segments);
                let d =
                    DVec3::new(libm::sin(theta) * libm::cos(phi), libm::cos(theta), libm::sin(theta) * libm::sin(phi));
                positions.push(center + radius * d.as_vec3());
            }
        }
        let mut triangles = Vec::new();
        for i in 0..rings {
            for j in 0..segments {
                let at = |r: u32, s: u32| r * segments + s % segments;
                let [a, b, c, d] = [at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)];
                let mut push = |t: [u32; 3]| triangles.push(if inward { [t[0], t[2], t[1]] } else { t });
                if i > 0 {
                    push([a, b, c]);
                }
                if i + 1 < rings {
                    push([a, c, d]);
                }
            }
        }
        self.mesh(name, positions, triangles, material)
    }

    pub fn light(&mut self, name: &str, kind: LightKind, intensity: Vec3) {
        let node = self.scene.instances.len() + self.scene.lights.len();
        self.scene.lights.push(Light { name: name.into(), node, group: name.into(), kind, intensity });
    }

    /// Direct access for what the shapes above do not cover.
    pub fn scene_mut(&mut self) -> &mut Scene {
        &mut self.scene
    }

    pub fn build(self) -> Scene {
        self.scene
    }
}

/// Applies a world transform to everything in the scene: instances, lights and cameras. Radiances and intensities
/// stay as they are.
pub fn transformed(mut scene: Scene, transform: DAffine3) -> Scene {
    for instance in &mut scene.instances {
        instance.transform = transform * instance.transform;
    }
    for camera in &mut scene.cameras {
        camera.transform = transform * camera.transform;
    }
    let scale = transform.matrix3.determinant().abs().cbrt();
    let turn = |d: DVec3| transform.transform_vector3(d).normalize();
    for light in &mut scene.lights {
        match &mut light.kind {
            LightKind::Point { position, range, radius } => {
                *position = transform.transform_point3(*position);
                *range = range.map(|r| r * scale);
                *radius *= scale;
            }
            LightKind::Spot { position, direction, range, radius, .. } => {
                *position = transform.transform_point3(*position);
                *direction = turn(*direction);
                *range = range.map(|r| r * scale);
                *radius *= scale;
            }
            LightKind::Sun { direction, .. } => *direction = turn(*direction),
        }
    }
    scene
}
