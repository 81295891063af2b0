//! Fragments: the piece of one triangle in one voxel, with its material averaged over the piece.

use glam::{DVec3, IVec3, Vec3};
use luxel_scene::{Alpha, Material, Surface, TextureRef};

use super::{Grid, polygon::Polygon, record::holdable};
use crate::{Rgb, geometry::Geometry};

/// Points at which a material with holes is looked up within a fragment; the footprints of all of them cover it.
const HOLE_SAMPLES: u32 = 16;

/// The piece of one triangle in one voxel. Lengths are in voxel edges.
#[derive(Clone, Copy)]
pub struct Fragment {
    pub voxel: IVec3,
    pub triangle: u32,
    pub area: f64,
    pub centroid: DVec3,
    /// Barycentric coordinates of a point where the surface is there.
    pub u: f32,
    pub v: f32,
    /// Averages over the covered part.
    pub albedo: Rgb,
    pub emission: Rgb,
    /// Share of the area that is there.
    pub coverage: f32,
    /// Share of the light that the piece stops.
    pub opacity: f32,
}

impl Fragment {
    /// The order in which fragments meet in a voxel: unique, because a triangle has one piece per voxel.
    pub fn key(&self) -> ([i32; 3], u32) {
        (self.voxel.to_array(), self.triangle)
    }
}

/// One triangle in voxel units, ready to be cut.
pub struct Cutter<'a, 'g> {
    geometry: &'a Geometry<'g>,
    triangle: u32,
    corners: [DVec3; 3],
    look: Look,
}

/// How the material of a triangle is to be averaged.
enum Look {
    /// The same everywhere.
    Constant(Surface),
    /// One look-up with the footprint of the fragment; the value is UV area per squared voxel edge.
    Smooth(f64),
    /// Several look-ups, because what is averaged has holes.
    Holes(f64),
}

/// The corners of a triangle in voxel units.
pub fn corners(geometry: &Geometry, grid: &Grid, triangle: u32) -> [DVec3; 3] {
    let (origin, edge) = (grid.origin.as_dvec3(), f64::from(grid.edge));
    geometry.triangles[triangle as usize].corners.map(|p| (p.as_dvec3() - origin) / edge)
}

impl<'a, 'g> Cutter<'a, 'g> {
    /// A triangle with its [`corners`].
    pub fn new(geometry: &'a Geometry<'g>, triangle: u32, corners: [DVec3; 3]) -> Self {
        let t = &geometry.triangles[triangle as usize];
        let mesh = &geometry.scene.meshes[geometry.scene.instances[t.instance as usize].mesh];
        let material = geometry.material(triangle);
        let density = || {
            let area = 0.5 * (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
            if area > 0.0 { uv_area(geometry, triangle, material) / area } else { 0.0 }
        };
        // Where the surface is and what it reflects is averaged in the same way whether or not it shines.
        let varies = reflected(material).into_iter().any(Option::is_some) || !mesh.colors.is_empty();
        let look = match material.alpha {
            Alpha::Mask(_) if varies => Look::Holes(density()),
            _ if varies || material.emissive_texture.is_some() => Look::Smooth(density()),
            _ => Look::Constant(geometry.surface(triangle, 1.0 / 3.0, 1.0 / 3.0, 0.0)),
        };
        Self { geometry, triangle, corners, look }
    }

    /// The fragment of a piece of this triangle; None where nothing of it is there.
    pub fn fragment(&self, voxel: IVec3, piece: &Polygon) -> Option<Fragment> {
        let (area, centroid) = piece.area_and_centroid()?;
        let (mut u, mut v) = self.barycentric(centroid);
        let surface = match self.look {
            Look::Constant(surface) => surface,
            Look::Smooth(density) => self.look_up(u, v, area * density),
            Look::Holes(density) => {
                let (surface, at) = self.average(piece, area * density)?;
                (u, v) = at;
                surface
            }
        };
        let opacity = 1.0 - surface.transmittance.element_sum() / 3.0;
        let there = surface.coverage > 0.0 && opacity > 0.0;
        there.then_some(Fragment {
            voxel,
            triangle: self.triangle,
            area,
            centroid,
            u,
            v,
            albedo: surface.albedo,
            emission: surface.emission,
            coverage: surface.coverage,
            opacity: opacity.clamp(0.0, 1.0),
        })
    }

    fn look_up(&self, u: f32, v: f32, uv_area: f64) -> Surface {
        self.geometry.surface(self.triangle, u, v, uv_area.max(0.0).sqrt() as f32)
    }

    /// Coverage-weighted mean of the material over a piece, and a point of it that is there.
    fn average(&self, piece: &Polygon, uv_area: f64) -> Option<(Surface, (f32, f32))> {
        let mut at = None;
        let (mut albedo, mut emission, mut pass, mut coverage) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, 0.0);
        let points = piece.points(HOLE_SAMPLES);
        for &p in &points {
            // The very point that the surfel will hold: what is tested here is what shadow rays start from.
            let (u, v) = self.barycentric(p);
            let (u, v) = holdable(u, v);
            // A cut-off is a step: what counts is the share of points that pass it, not an average of alpha.
            let s = self.look_up(u, v, 0.0);
            if s.coverage > 0.0 {
                let smooth = self.look_up(u, v, uv_area / f64::from(HOLE_SAMPLES));
                at.get_or_insert((u, v));
                albedo += s.coverage * smooth.albedo;
                emission += s.coverage * smooth.emission;
            }
            coverage += s.coverage;
            pass += s.transmittance;
        }
        let count = points.len() as f32;
        let surface = Surface {
            albedo: albedo / coverage,
            emission: emission / coverage,
            coverage: coverage / count,
            transmittance: pass / count,
        };
        at.map(|at| (surface, at))
    }

    /// Barycentric coordinates of the second and third corner, clamped to the triangle.
    fn barycentric(&self, p: DVec3) -> (f32, f32) {
        let [a, b, c] = self.corners;
        let normal = (b - a).cross(c - a);
        let square = normal.length_squared();
        if square <= 0.0 {
            return (1.0 / 3.0, 1.0 / 3.0);
        }
        let u = ((p - a).cross(c - a).dot(normal) / square).clamp(0.0, 1.0);
        let v = ((b - a).cross(p - a).dot(normal) / square).clamp(0.0, 1.0 - u);
        (u as f32, v as f32)
    }
}

/// The textures that decide where a surface is and what it reflects.
fn reflected(m: &Material) -> [&Option<TextureRef>; 3] {
    [&m.base_color_texture, &m.metallic_roughness_texture, &m.transmission_texture]
}

/// Area of a triangle in the texture coordinates that its colour uses, those of its emission where nothing else has a
/// texture; 0 where nothing has.
fn uv_area(geometry: &Geometry, triangle: u32, material: &Material) -> f64 {
    let textures = reflected(material).into_iter().chain([&material.emissive_texture]);
    let Some(texture) = textures.flatten().next() else { return 0.0 };
    let t = &geometry.triangles[triangle as usize];
    let mesh = &geometry.scene.meshes[geometry.scene.instances[t.instance as usize].mesh];
    let Some(uvs) = mesh.uvs.get(texture.tex_coord).filter(|uvs| !uvs.is_empty()) else { return 0.0 };
    let [a, b, c] = mesh.triangles[t.index as usize].map(|i| uvs[i as usize].as_dvec2());
    let area = 0.5 * (b - a).perp_dot(c - a).abs();
    if area.is_finite() { area } else { 0.0 }
}
