//! Surfaces as rays meet them, veil after veil, with the light that leaves them.
//!
//! ```text
//! B(x) = ρ(x)·E(x)     ρ exact at the hit, E the irradiance that somebody knows there [lux]
//! ```

use glam::{Vec2, Vec3, Vec4};
use luxel_scene::{Material, Scene, Surface};

use crate::{
    Rgb,
    geometry::{Geometry, Triangle},
    rays::{Hit, OFFSET, Rays},
};

/// Most veils that one ray goes through; behind them nothing is seen.
const MAX_VEILS: u32 = 64;

/// A share of light below this is not followed further.
const FAINT: f32 = 1e-4;

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
    /// Somebody knows the irradiance here.
    pub known: bool,
}

/// The surfaces of a scene.
#[derive(Clone)]
pub(super) struct Surfaces<'a> {
    rays: &'a Rays<'a>,
    /// For each material what it is everywhere, where that does not depend on the point.
    uniform: Vec<Option<Surface>>,
}

impl<'a> Surfaces<'a> {
    pub fn new(rays: &'a Rays<'a>) -> Self {
        Self { rays, uniform: uniform_materials(rays.geometry.scene) }
    }

    /// Follows a ray from `origin` along `direction` (unit) through all veils, and shows every surface on its way;
    /// `irradiance` knows E [lux] at a point on the side of a unit normal. Returns the share of light that comes in
    /// from beyond all surfaces, and the rays spent.
    #[inline]
    pub fn walk(
        &self,
        origin: Vec3,
        direction: Vec3,
        irradiance: impl Fn(Vec3, Vec3) -> Option<Rgb>,
        mut visit: impl FnMut(&Encounter),
    ) -> (Rgb, u32) {
        let (mut from, mut passed, mut pass) = (origin, 0.0, Rgb::ONE);
        let mut last = u32::MAX;
        for rays in 1..=MAX_VEILS {
            let Some(hit) = self.rays.closest(from, direction, f32::INFINITY) else { return (pass, rays) };
            // A straight line meets a triangle once: a second time, at a grazing angle, is rounding.
            if hit.triangle != last {
                let (encounter, transmittance) = self.meet(&hit, passed + hit.distance, direction, pass, &irradiance);
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

    #[inline]
    fn meet(
        &self,
        hit: &Hit,
        distance: f32,
        direction: Vec3,
        pass: Rgb,
        irradiance: &impl Fn(Vec3, Vec3) -> Option<Rgb>,
    ) -> (Encounter, Rgb) {
        let geometry = self.rays.geometry;
        let triangle = &geometry.triangles[hit.triangle as usize];
        let normal = if hit.back { -triangle.normal } else { triangle.normal };
        let material = geometry.material(hit.triangle);
        let irradiance = irradiance(triangle.at(hit.u, hit.v), normal);
        let known = irradiance.is_some();
        let cosine = normal.dot(direction).abs();
        let shines = !hit.back || material.double_sided;
        if !shines && material.is_opaque() {
            let dark = Encounter { distance, cosine, share: pass, radiosity: Rgb::ZERO, emission: Rgb::ZERO, known };
            return (dark, Rgb::ZERO);
        }
        let surface = match &self.uniform[material_index(geometry, triangle)] {
            Some(surface) => *surface,
            None => geometry.surface(hit.triangle, hit.u, hit.v, 0.0),
        };
        let lit = if shines { 1.0 } else { 0.0 };
        let encounter = Encounter {
            distance,
            cosine,
            share: pass * surface.coverage,
            radiosity: surface.albedo * irradiance.unwrap_or(Rgb::ZERO) * lit,
            emission: surface.emission * (std::f32::consts::PI * lit),
            known,
        };
        (encounter, surface.transmittance)
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
