//! Where the light on visible surfaces comes from: any method of transport, or a finished lightmap.

use luxel_scene::{Cancelled, Progress};
use luxel_transport::{
    Rgb,
    gather::Receiver,
    geometry::Geometry,
    methods::{Light, Method},
};
use rayon::prelude::*;

use super::march::Layer;

/// A point of a visible surface that wants to know its light.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// Among the geometry's triangles, with barycentric coordinates of its second and third corner.
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
    /// On the side that is seen.
    pub receiver: Receiver,
}

impl Point {
    /// A point that stands for a square of side `footprint` [frame units].
    pub fn new(layer: &Layer, footprint: f32, seed: u64) -> Self {
        let Layer { triangle, u, v, position, normal, shading_normal, .. } = *layer;
        Self { triangle, u, v, receiver: Receiver { position, normal, shading_normal, footprint, seed } }
    }
}

/// The light at a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lit {
    /// E [lux].
    pub irradiance: Rgb,
    /// Estimated standard error of its band mean [lux]; none where none is known.
    pub error: Option<f32>,
    /// Continuous rays spent.
    pub rays: u32,
}

impl From<&Light> for Lit {
    fn from(light: &Light) -> Self {
        Self { irradiance: light.total(), error: light.error, rays: light.rays }
    }
}

/// Light on surfaces. Implementations are pure: the same points give the same bits, on any number of threads.
pub trait Illumination: Sync {
    /// The light at every point, in their order.
    ///
    /// # Errors
    /// When it is no longer wanted.
    fn light(&self, points: &[Point], progress: &dyn Progress) -> Result<Vec<Lit>, Cancelled>;

    /// Asking costs little more than finding the point, so every sample asks for itself.
    fn is_cheap(&self) -> bool {
        false
    }
}

/// Light as a method finds it at the very point.
pub struct ByMethod<'a>(pub &'a dyn Method);

impl Illumination for ByMethod<'_> {
    fn light(&self, points: &[Point], progress: &dyn Progress) -> Result<Vec<Lit>, Cancelled> {
        Ok(self.0.light(&receivers(points), progress)?.iter().map(Lit::from).collect())
    }
}

fn receivers(points: &[Point]) -> Vec<Receiver> {
    points.iter().map(|p| p.receiver).collect()
}

/// The same of a method that draws at random, with so many draws.
pub struct ByDraws<'a> {
    pub method: &'a dyn Method,
    pub draws: u32,
}

impl Illumination for ByDraws<'_> {
    fn light(&self, points: &[Point], progress: &dyn Progress) -> Result<Vec<Lit>, Cancelled> {
        let found = self.method.drawn(&receivers(points), self.draws, progress)?;
        Ok(found.iter().map(Lit::from).collect())
    }
}

/// Irradiance [lux] at a point of an instance's triangle, barycentric (1−u−v, u, v); None without a lightmap there.
pub type Lookup<'a> = dyn Fn(u32, u32, f32, f32) -> Option<Rgb> + Sync + 'a;

/// Light as a lightmap holds it; a surface without a place in it is shown under the mean irradiance of the scene, as
/// under a light probe. Backs of double-sided surfaces have the texels of their fronts.
pub struct ByLightmap<'a> {
    pub geometry: &'a Geometry<'a>,
    pub lookup: &'a Lookup<'a>,
    /// [lux]
    pub mean: Rgb,
}

impl Illumination for ByLightmap<'_> {
    fn light(&self, points: &[Point], progress: &dyn Progress) -> Result<Vec<Lit>, Cancelled> {
        progress.check()?;
        let at = |p: &Point| {
            let triangle = &self.geometry.triangles[p.triangle as usize];
            let found = (self.lookup)(triangle.instance, triangle.index, p.u, p.v);
            Lit { irradiance: found.unwrap_or(self.mean), ..Lit::default() }
        };
        Ok(points.par_iter().map(at).collect())
    }

    fn is_cheap(&self) -> bool {
        true
    }
}
