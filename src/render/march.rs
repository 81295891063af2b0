//! What a ray from the eye sees: L = Σ τₖ·cₖ·(Lₑ + ρE/π)ₖ + τ·L_sky over the surfaces on its way.
//!
//! Veils are passed with their transmittance τ and weighed by their coverage c, backs of single-sided surfaces are
//! culled as engines do (so a closed room can be seen from outside), and what is beyond shows the sky. Surfaces of
//! unlit materials are no part of the light and are not seen. Radiances in cd/m², linear RGB.

use glam::Vec3;
use luxel_transport::{
    Rgb,
    rays::{OFFSET, Rays},
};

/// Surfaces along one ray at most.
const MAX_SURFACES: u32 = 64;

/// Where less than this share of the light passes, nothing behind is looked for.
const FAINT: f32 = 1e-3;

/// What is to be seen.
pub struct Look<'a> {
    pub rays: &'a Rays<'a>,
    /// Factors on what the scene's materials emit, and on its sky: where its lights are at their units.
    pub emission: Option<&'a [Rgb]>,
    pub sky: Rgb,
}

/// A surface on the way of a ray, as it is on the side that is seen.
#[derive(Clone, Copy, Debug)]
pub struct Layer {
    /// Among the geometry's triangles, with barycentric coordinates of its second and third corner.
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
    pub back: bool,
    pub instance: u32,
    /// From the eye, frame units.
    pub distance: f32,
    pub position: Vec3,
    /// Unit geometric and interpolated normals towards the eye's side.
    pub normal: Vec3,
    pub shading_normal: Vec3,
    /// Share of its radiance that reaches the eye.
    pub weight: Rgb,
    /// Emitted radiance [cd/m²].
    pub emission: Rgb,
    pub albedo: Rgb,
}

impl Layer {
    /// Share of the irradiance that reaches the eye as radiance [1/sr].
    pub fn reflects(&self) -> Rgb {
        self.weight * self.albedo / std::f32::consts::PI
    }
}

impl Look<'_> {
    /// Appends the surfaces along `direction` (unit), from front to back; returns the radiance of what is beyond.
    pub fn along(&self, eye: Vec3, direction: Vec3, layers: &mut Vec<Layer>) -> Rgb {
        let geometry = self.rays.geometry;
        let (mut origin, mut travelled) = (eye, 0.0);
        let mut pass = Rgb::ONE;
        for _ in 0..MAX_SURFACES {
            let Some(hit) = self.rays.closest(origin, direction, f32::INFINITY) else {
                return pass * self.sky * geometry.scene.sky.radiance(direction);
            };
            travelled += hit.distance;
            if !hit.back || geometry.material(hit.triangle).double_sided {
                let surface = geometry.surface(hit.triangle, hit.u, hit.v, 0.0);
                let triangle = &geometry.triangles[hit.triangle as usize];
                let side = if hit.back { -1.0 } else { 1.0 };
                let mesh = geometry.scene.instances[triangle.instance as usize].mesh;
                let factor = self.emission.map_or(Rgb::ONE, |f| f[geometry.scene.meshes[mesh].material]);
                layers.push(Layer {
                    triangle: hit.triangle,
                    u: hit.u,
                    v: hit.v,
                    back: hit.back,
                    instance: triangle.instance,
                    distance: travelled,
                    position: triangle.at(hit.u, hit.v),
                    normal: triangle.normal * side,
                    shading_normal: geometry.shading_normal(hit.triangle, hit.u, hit.v) * side,
                    weight: pass * surface.coverage,
                    emission: surface.emission * factor,
                    albedo: surface.albedo,
                });
                pass *= surface.transmittance;
                if pass.max_element() < FAINT {
                    break;
                }
            }
            // Past the surface, by more than the rounding of a point so far away.
            let step = OFFSET.max(travelled * 1e-6);
            travelled += step;
            origin = eye + direction * travelled;
        }
        Rgb::ZERO
    }
}
