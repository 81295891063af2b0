//! The field of reflected light: what radiosity a ray sees where it hits.
//!
//! ```text
//! B(x) = ρ(x)·E(s(x))     ρ exact at the hit, E = direct + indirect irradiance of the surfel s there [lux]
//! ```

use glam::{Vec2, Vec3, Vec4};
use luxel_scene::{Cancelled, Material, Progress, Scene, Silent, Surface, watched};

use super::surfel_index::SurfelIndex;
use crate::{
    Rgb,
    geometry::{Geometry, Triangle},
    rays::{Hit, OFFSET, Rays},
    surfel::{Solution, Surfels},
};

/// Most veils that one ray goes through; behind them nothing is seen.
const MAX_VEILS: u32 = 64;

/// A share of light below this is not followed further.
const FAINT: f32 = 1e-4;

/// Surfels and solution that do not belong together or to the scene.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FieldError {
    #[error("{surfels} surfels but {direct} direct and {indirect} indirect irradiances")]
    Lengths { surfels: usize, direct: usize, indirect: usize },
    #[error("surfel {surfel} refers to triangle {triangle} of {triangles}")]
    Triangle { surfel: usize, triangle: u32, triangles: usize },
    #[error("the voxel edge is not a positive number")]
    Edge,
    #[error("surfel {surfel} has a value that is negative or not finite")]
    Value { surfel: usize },
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A surface that a ray met on its way.
pub struct Encounter {
    /// Along the ray, frame units.
    pub distance: f32,
    /// Cosine between the ray and the surface's normal, on the side that was met.
    pub cosine: f32,
    /// Share of the light leaving this surface that reaches the ray's origin: its coverage, and what the veils in
    /// front of it let through.
    pub share: Rgb,
    /// Reflected radiosity B of the covered part [lux].
    pub radiosity: Rgb,
    /// Emitted radiosity πLₑ of the covered part [lux].
    pub emission: Rgb,
    /// There is a surfel here.
    pub known: bool,
}

/// Rays, surfels and the irradiance at them: all that a gather reads.
pub struct Field<'a> {
    pub rays: &'a Rays<'a>,
    pub surfels: &'a Surfels,
    pub solution: &'a Solution,
    pub index: SurfelIndex<'a>,
    /// For each material what it is everywhere, where that does not depend on the point.
    uniform: Vec<Option<Surface>>,
}

impl<'a> Field<'a> {
    /// Checks that the three belong together.
    pub fn new(rays: &'a Rays<'a>, surfels: &'a Surfels, solution: &'a Solution) -> Result<Self, FieldError> {
        Self::build(rays, surfels, solution, &Silent)
    }

    /// [`Field::new`] that can be cancelled.
    pub fn build(
        rays: &'a Rays<'a>,
        surfels: &'a Surfels,
        solution: &'a Solution,
        progress: &dyn Progress,
    ) -> Result<Self, FieldError> {
        check(rays, surfels, solution, progress)?;
        let uniform = uniform_materials(rays.geometry.scene);
        Ok(Self { rays, surfels, solution, index: SurfelIndex::build(surfels, progress)?, uniform })
    }

    /// The same surfels under another light, which has been checked.
    pub(super) fn under<'b>(&'b self, solution: &'b Solution) -> Field<'b> {
        Field { solution, index: self.index.clone(), uniform: self.uniform.clone(), ..*self }
    }

    /// Follows a ray from `origin` along `direction` (unit) through all veils, and shows every surface on its way.
    /// Returns the share of light that comes in from beyond all surfaces, and the rays spent.
    #[inline]
    pub fn walk(&self, origin: Vec3, direction: Vec3, mut visit: impl FnMut(&Encounter)) -> (Rgb, u32) {
        let (mut from, mut passed, mut pass) = (origin, 0.0, Rgb::ONE);
        let mut last = u32::MAX;
        for rays in 1..=MAX_VEILS {
            let Some(hit) = self.rays.closest(from, direction, f32::INFINITY) else { return (pass, rays) };
            // A straight line meets a triangle once: a second time, at a grazing angle, is rounding.
            if hit.triangle != last {
                let (encounter, transmittance) = self.meet(&hit, passed + hit.distance, direction, pass);
                visit(&encounter);
                pass *= transmittance;
                if pass.max_element() <= FAINT {
                    return (Rgb::ZERO, rays);
                }
            }
            last = hit.triangle;
            passed += hit.distance + OFFSET;
            from = origin + direction * passed;
        }
        (Rgb::ZERO, MAX_VEILS)
    }

    fn meet(&self, hit: &Hit, distance: f32, direction: Vec3, pass: Rgb) -> (Encounter, Rgb) {
        let geometry = self.rays.geometry;
        let triangle = &geometry.triangles[hit.triangle as usize];
        let normal = if hit.back { -triangle.normal } else { triangle.normal };
        let material = geometry.material(hit.triangle);
        let surfel = self.index.find(triangle.at(hit.u, hit.v), normal);
        let cosine = normal.dot(direction).abs();
        let shines = !hit.back || material.double_sided;
        if !shines && material.is_opaque() {
            let dark = Encounter {
                distance,
                cosine,
                share: pass,
                radiosity: Rgb::ZERO,
                emission: Rgb::ZERO,
                known: surfel.is_some(),
            };
            return (dark, Rgb::ZERO);
        }
        let surface = match &self.uniform[material_index(geometry, triangle)] {
            Some(surface) => *surface,
            None => geometry.surface(hit.triangle, hit.u, hit.v, 0.0),
        };
        let irradiance = surfel.map_or(Rgb::ZERO, |s| self.solution.total(s));
        let lit = if shines { 1.0 } else { 0.0 };
        let encounter = Encounter {
            distance,
            cosine,
            share: pass * surface.coverage,
            radiosity: surface.albedo * irradiance * lit,
            emission: surface.emission * (std::f32::consts::PI * lit),
            known: surfel.is_some(),
        };
        (encounter, surface.transmittance)
    }

    /// Radiosity that a ray brings from all surfaces on its way [lux], the share that comes from beyond, rays spent.
    pub fn radiosity(&self, origin: Vec3, direction: Vec3) -> (Rgb, Rgb, u32) {
        let mut sum = Rgb::ZERO;
        let (beyond, rays) = self.walk(origin, direction, |e| sum += e.share * e.radiosity);
        (sum, beyond, rays)
    }
}

fn material_index(geometry: &Geometry, triangle: &Triangle) -> usize {
    let scene = geometry.scene;
    scene.meshes[scene.instances[triangle.instance as usize].mesh].material
}

/// The surfaces of all materials without textures, on meshes without vertex colours.
fn uniform_materials(scene: &Scene) -> Vec<Option<Surface>> {
    let plain = |m: &Material| {
        let textures =
            [&m.base_color_texture, &m.metallic_roughness_texture, &m.emissive_texture, &m.transmission_texture];
        textures.iter().all(|t| t.is_none()).then(|| m.surface(&[], &|_| Vec2::ZERO, Vec4::ONE, 0.0))
    };
    let mut uniform: Vec<Option<Surface>> = scene.materials.iter().map(plain).collect();
    for mesh in scene.meshes.iter().filter(|m| !m.colors.is_empty()) {
        uniform[mesh.material] = None;
    }
    uniform
}

fn check(rays: &Rays, surfels: &Surfels, solution: &Solution, progress: &dyn Progress) -> Result<(), FieldError> {
    let (n, direct, indirect) = (surfels.list.len(), solution.direct.len(), solution.indirect.len());
    if direct != n || indirect != n {
        return Err(FieldError::Lengths { surfels: n, direct, indirect });
    }
    if !(surfels.grid.edge > 0.0 && surfels.grid.edge.is_finite() && surfels.grid.origin.is_finite()) {
        return Err(FieldError::Edge);
    }
    let triangles = rays.geometry.triangles.len();
    let light = |v: Rgb| v.is_finite() && v.min_element() >= 0.0;
    for item in watched(surfels.list.iter().enumerate(), progress) {
        let (surfel, s) = item?;
        if s.triangle as usize >= triangles {
            return Err(FieldError::Triangle { surfel, triangle: s.triangle, triangles });
        }
        let place = s.centroid.is_finite() && s.normal.is_finite();
        let size = s.area.is_finite() && s.area >= 0.0;
        let lit = light(s.albedo()) && light(solution.direct[surfel]) && light(solution.indirect[surfel]);
        if !(place && size && lit) {
            return Err(FieldError::Value { surfel });
        }
    }
    Ok(())
}
