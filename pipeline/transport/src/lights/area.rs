//! Emissive surfaces as convex planar polygons.

use std::f64::consts::PI;

use glam::{DVec3, Vec2, Vec3};
use luxel_scene::Alpha;
use rayon::prelude::*;

use super::{Source, name_hash, sane};
use crate::{Rgb, geometry::Geometry, rays::OFFSET, sampling::combine};

/// A convex planar polygon of three or four corners that shines from its front, or from both sides.
#[derive(Clone, Debug)]
pub struct AreaLight {
    corners: [Vec3; 4],
    count: u8,
    /// Unit normal of the front side.
    pub normal: Vec3,
    /// Squared frame units.
    pub area: f32,
    /// Mean radiance [cd/m²], coverage included.
    pub radiance: Rgb,
    /// Radiance over the triangle where it varies.
    pub table: Option<Box<RadianceTable>>,
    pub two_sided: bool,
    pub source: Source,
    /// Stable hash of the instance's name and the mesh triangle: the seed of its photons.
    pub identity: u64,
    /// First triangle among [`Geometry::triangles`].
    pub triangle: u32,
}

impl AreaLight {
    pub fn corners(&self) -> &[Vec3] {
        &self.corners[..usize::from(self.count)]
    }

    /// Mean of the corners.
    pub fn center(&self) -> Vec3 {
        self.corners().iter().sum::<Vec3>() / f32::from(self.count)
    }

    /// The same light, every band of it times a weight.
    pub(super) fn weighted(&self, weight: Rgb) -> Self {
        let weigh =
            |table: &RadianceTable| Box::new(RadianceTable { parts: table.parts.map(|p| p.map(|l| l * weight)) });
        Self { radiance: self.radiance * weight, table: self.table.as_deref().map(weigh), ..self.clone() }
    }

    /// A part of it, of three or four corners; `number` tells it from the others.
    pub(super) fn part(&self, corners: &[Vec3], area: f32, number: u64) -> Self {
        let mut slots = [corners[corners.len() - 1]; 4];
        slots[..corners.len()].copy_from_slice(corners);
        let identity = combine(self.identity, number);
        Self { corners: slots, count: corners.len() as u8, area, identity, ..self.clone() }
    }

    /// Luminous flux [lm] of all lit sides.
    pub fn power(&self, scale: f64) -> DVec3 {
        let sides = if self.two_sided { 2.0 } else { 1.0 };
        self.radiance.as_dvec3() * (sides * PI * f64::from(self.area) / (scale * scale))
    }

    /// Point and radiance at a point of the unit square, uniform in area.
    pub fn sample(&self, p: Vec2) -> (Vec3, Rgb) {
        let [a, b, c, d] = self.corners;
        let mut p = p;
        let (mut second, mut third) = (b, c);
        if self.count == 4 {
            let first = 0.5 * (b - a).cross(c - a).length() / self.area;
            if p.x < first {
                p.x /= first;
            } else {
                p.x = ((p.x - first) / (1.0 - first)).min(1.0);
                (second, third) = (c, d);
            }
        }
        let (u, v) = crate::sampling::triangle(p);
        let radiance = self.table.as_ref().map_or(self.radiance, |t| t.at(u, v));
        (a + (second - a) * u + (third - a) * v, radiance)
    }
}

/// Mean radiances of the 64 congruent parts of a triangle.
#[derive(Clone, Debug)]
pub struct RadianceTable {
    parts: [[Rgb; 2]; RadianceTable::SIDE * RadianceTable::SIDE],
}

impl RadianceTable {
    /// Parts along each edge.
    pub const SIDE: usize = 8;

    /// Radiance [cd/m²] at barycentric coordinates (1−u−v, u, v).
    pub fn at(&self, u: f32, v: f32) -> Rgb {
        let last = Self::SIDE - 1;
        let (x, y) = (u.clamp(0.0, 1.0) * Self::SIDE as f32, v.clamp(0.0, 1.0) * Self::SIDE as f32);
        let i = (x as usize).min(last);
        let j = (y as usize).min(last - i);
        let upper = (x - i as f32) + (y - j as f32) > 1.0 && i + j < last;
        self.parts[j * Self::SIDE + i][usize::from(upper)]
    }

    fn new(geometry: &Geometry, triangle: u32) -> Self {
        let footprint = uv_side(geometry, triangle) / (2 * Self::SIDE) as f32;
        let part = |i: usize, j: usize, upper: bool| {
            let mut sum = Rgb::ZERO;
            // Centroids of the four quarters of the part.
            for (a, b) in [(1.0, 1.0), (4.0, 1.0), (1.0, 4.0), (2.0, 2.0)] {
                let (a, b) = if upper { (6.0 - a, 6.0 - b) } else { (a, b) };
                let u = (i as f32 + a / 6.0) / Self::SIDE as f32;
                let v = (j as f32 + b / 6.0) / Self::SIDE as f32;
                let s = geometry.surface(triangle, u, v, footprint);
                sum += sane(s.emission * s.coverage);
            }
            sum * 0.25
        };
        let mut parts = [[Rgb::ZERO; 2]; Self::SIDE * Self::SIDE];
        for j in 0..Self::SIDE {
            for i in 0..Self::SIDE - j {
                let upper = if i + j + 1 < Self::SIDE { part(i, j, true) } else { Rgb::ZERO };
                parts[j * Self::SIDE + i] = [part(i, j, false), upper];
            }
        }
        Self { parts }
    }

    fn mean(&self) -> Rgb {
        // Unused upper parts are zero and do not count among the SIDE² parts.
        self.parts.iter().flatten().sum::<Rgb>() / (Self::SIDE * Self::SIDE) as f32
    }
}

/// Side of the square that has the area of the triangle in the emissive texture's coordinates.
fn uv_side(geometry: &Geometry, triangle: u32) -> f32 {
    let t = &geometry.triangles[triangle as usize];
    let mesh = &geometry.scene.meshes[geometry.scene.instances[t.instance as usize].mesh];
    let set = geometry.material(triangle).emissive_texture.as_ref().map_or(0, |t| t.tex_coord);
    let Some(uvs) = mesh.uvs.get(set).filter(|uvs| !uvs.is_empty()) else { return 0.0 };
    let [a, b, c] = mesh.triangles[t.index as usize].map(|i| uvs[i as usize]);
    let side = (0.5 * (b - a).perp_dot(c - a).abs()).sqrt();
    if side.is_finite() { side } else { 0.0 }
}

/// All emissive surfaces of the scene, instance by instance.
pub(super) fn area_lights(geometry: &Geometry) -> Vec<AreaLight> {
    let scene = geometry.scene;
    let mut lights = Vec::new();
    for (i, instance) in scene.instances.iter().enumerate() {
        let mesh = &scene.meshes[instance.mesh];
        let material = &scene.materials[mesh.material];
        if !material.emits() || material.unlit || !instance.casts {
            continue;
        }
        let varies = material.base_color_texture.is_some() || !mesh.colors.is_empty();
        let uniform = material.emissive_texture.is_none() && (material.alpha == Alpha::Opaque || !varies);
        let range = geometry.first[i]..geometry.first[i + 1];
        if uniform {
            lights.extend(paired(geometry, range));
        } else {
            let textured = range.into_par_iter().filter_map(|t| {
                let table = RadianceTable::new(geometry, t);
                let light = AreaLight { table: None, ..single(geometry, t, table.mean())? };
                Some(AreaLight { table: Some(Box::new(table)), ..light })
            });
            lights.extend(textured.collect::<Vec<_>>());
        }
    }
    lights
}

/// One triangle as a light; None where it has no area or no light.
fn single(geometry: &Geometry, triangle: u32, radiance: Rgb) -> Option<AreaLight> {
    let t = &geometry.triangles[triangle as usize];
    let instance = &geometry.scene.instances[t.instance as usize];
    let [a, b, c] = t.corners;
    let area = t.area();
    (!t.is_degenerate() && area > 0.0 && radiance.max_element() > 0.0).then(|| AreaLight {
        corners: [a, b, c, c],
        count: 3,
        normal: t.normal,
        area,
        radiance,
        table: None,
        two_sided: geometry.material(triangle).double_sided,
        source: Source::Instance(t.instance),
        identity: combine(name_hash(&instance.name), u64::from(t.index)),
        triangle,
    })
}

/// The triangles of one instance of uniform emission, joined to quads where two are coplanar and make a convex one.
fn paired(geometry: &Geometry, range: std::ops::Range<u32>) -> Vec<AreaLight> {
    let first = range.start;
    let singles: Vec<_> = range
        .map(|t| {
            let s = geometry.surface(t, 1.0 / 3.0, 1.0 / 3.0, 0.0);
            single(geometry, t, sane(s.emission * s.coverage))
        })
        .collect();
    let mut edges: Vec<([u32; 6], u32)> = Vec::with_capacity(3 * singles.len());
    for (i, light) in singles.iter().enumerate() {
        for k in 0..light.as_ref().map_or(0, |_| 3) {
            let c = geometry.triangles[first as usize + i].corners;
            edges.push((edge_key(c[k], c[(k + 1) % 3]), i as u32));
        }
    }
    edges.sort_unstable();
    let mut used = vec![false; singles.len()];
    let mut lights = Vec::new();
    for (i, light) in singles.iter().enumerate() {
        let Some(light) = light.as_ref().filter(|_| !used[i]) else { continue };
        let quad = (0..3).find_map(|k| {
            let key = edge_key(light.corners[(k + 1) % 3], light.corners[k]);
            let at = edges.partition_point(|e| e.0 < key);
            edges[at..].iter().take_while(|e| e.0 == key).find_map(|&(_, j)| {
                let other = singles[j as usize].as_ref().filter(|_| j as usize > i && !used[j as usize])?;
                Some((j, join(light, other, k)?))
            })
        });
        match quad {
            Some((j, quad)) => {
                used[j as usize] = true;
                lights.push(quad);
            }
            None => lights.push(light.clone()),
        }
    }
    lights
}

/// A directed edge by the bits of its ends, so that split vertices still meet.
fn edge_key(a: Vec3, b: Vec3) -> [u32; 6] {
    let bits = |x: f32| (x + 0.0).to_bits();
    [bits(a.x), bits(a.y), bits(a.z), bits(b.x), bits(b.y), bits(b.z)]
}

/// Joins `other` to the edge from corner `k` of `light`, where the two make a convex planar quad.
fn join(light: &AreaLight, other: &AreaLight, k: usize) -> Option<AreaLight> {
    let [a, b, c] = [light.corners[k], light.corners[(k + 1) % 3], light.corners[(k + 2) % 3]];
    let d = *other.corners().iter().find(|&&d| d != a && d != b)?;
    let flat = light.normal.dot(other.normal) > 1.0 - 1e-6 && light.normal.dot(d - a).abs() < 0.25 * OFFSET;
    let quad = [a, d, b, c];
    let turns = (0..4).map(|i| {
        let (p, q, r) = (quad[i], quad[(i + 1) % 4], quad[(i + 2) % 4]);
        (q - p).cross(r - q).dot(light.normal)
    });
    // The corners run one way round, which way depends on mirroring.
    let turns: Vec<f32> = turns.collect();
    let least = 1e-4 * light.area.min(other.area);
    let convex = turns.iter().all(|&t| t > least) || turns.iter().all(|&t| t < -least);
    let alike = light.radiance == other.radiance;
    (flat && convex && alike).then(|| AreaLight {
        corners: quad,
        count: 4,
        area: light.area + other.area,
        ..light.clone()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, Vec4};
    use luxel_scene::{Material, Texture, TextureRef, build::Builder};

    #[test]
    fn a_cuboid_becomes_six_quads_whatever_its_mirroring() {
        for flip in [1.0, -1.0] {
            let mut b = Builder::new("cube");
            let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
            b.cuboid("cube", Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0), shiny, false);
            let scene = luxel_scene::build::transformed(b.build(), DAffine3::from_scale(DVec3::new(flip, 1.0, 1.0)));
            let geometry = Geometry::new(&scene);
            let lights = area_lights(&geometry);
            assert_eq!(lights.len(), 6);
            let total: f32 = lights.iter().map(|l| l.area).sum();
            let expected = 22.0 * (geometry.frame.scale * geometry.frame.scale) as f32;
            assert!((total - expected).abs() < 1e-4 * expected);
            let outside = |l: &AreaLight| l.normal.dot(l.center()) > 0.0;
            assert!(lights.iter().all(outside));
        }
    }

    #[test]
    fn triangles_that_make_no_convex_quad_stay_alone() {
        let mut b = Builder::new("arrow");
        let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
        // Reflex at (1, 1): an arrow head.
        let positions = vec![Vec3::ZERO, Vec3::new(4.0, 0.0, 0.0), Vec3::new(1.0, 1.0, 0.0), Vec3::new(0.0, 4.0, 0.0)];
        b.mesh("arrow", positions, vec![[0, 1, 2], [0, 2, 3]], shiny);
        let scene = b.build();
        assert_eq!(area_lights(&Geometry::new(&scene)).len(), 2);
    }

    #[test]
    fn a_textured_emitter_keeps_its_mean_and_its_bright_half() {
        let mut b = Builder::new("screen");
        let texels = vec![[0, 0, 0, 255], [255, 255, 255, 255]];
        b.scene_mut().textures.push(Texture { name: "t".into(), width: 2, height: 1, srgb: false, texels });
        let mut texture = TextureRef::new(0);
        texture.wrap = [luxel_scene::Wrap::Clamp; 2];
        let screen = b.material(Material {
            emission: Vec3::splat(8.0),
            emissive_texture: Some(texture),
            base_color: Vec4::W,
            ..Material::default()
        });
        b.quad("screen", Vec3::ZERO, Vec3::X, Vec3::Y, screen);
        let scene = b.build();
        let lights = area_lights(&Geometry::new(&scene));
        assert_eq!(lights.len(), 2);
        let power: f64 = lights.iter().map(|l| l.power(4096.0).x).sum();
        assert!((power - 4.0 * PI).abs() < 0.01 * 4.0 * PI, "{power}");
        let table = lights[0].table.as_ref().unwrap();
        // The first triangle's second corner is at u = 1.
        assert!(table.at(0.9, 0.05).x > 7.9 && table.at(0.05, 0.05).x < 0.5);
    }

    #[test]
    fn samples_are_uniform_in_area() {
        let mut b = Builder::new("trapezoid");
        let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
        let positions = vec![Vec3::ZERO, Vec3::new(4.0, 0.0, 0.0), Vec3::new(3.0, 1.0, 0.0), Vec3::new(0.0, 2.0, 0.0)];
        b.mesh("quad", positions, vec![[0, 1, 2], [0, 2, 3]], shiny);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let light = &area_lights(&geometry)[0];
        assert_eq!(light.corners().len(), 4);
        let n = 4096;
        let mean =
            (0..n).map(|i| geometry.frame.world(light.sample(crate::sampling::r2(i, Vec2::ZERO)).0)).sum::<DVec3>()
                / f64::from(n);
        // Centroids (7/3, 1/3) with area 2 and (1, 1) with area 3.
        let expected = DVec3::new((2.0 * 7.0 / 3.0 + 3.0) / 5.0, (2.0 / 3.0 + 3.0) / 5.0, 0.0);
        assert!((mean - expected).length() < 5e-3, "{mean} {expected}");
    }
}
