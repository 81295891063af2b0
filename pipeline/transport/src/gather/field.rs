//! The field of reflected light: what radiosity a ray sees where it hits.
//!
//! ```text
//! B(x) = ρ(x)·E(s(x))     ρ exact at the hit, E = direct + indirect irradiance of the surfel s there [lux]
//! ```

use glam::Vec3;
use luxel_scene::{Cancelled, Progress, Silent, watched};

pub use super::surfaces::Encounter;
use super::{surfaces::Surfaces, surfel_index::SurfelIndex};
use crate::{
    Rgb,
    rays::Rays,
    surfel::{Solution, Surfels},
};

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

/// Rays, surfels and the irradiance at them: all that a gather reads.
pub struct Field<'a> {
    pub rays: &'a Rays<'a>,
    pub surfels: &'a Surfels,
    pub solution: &'a Solution,
    pub index: SurfelIndex<'a>,
    surfaces: Surfaces<'a>,
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
        let index = SurfelIndex::build(surfels, progress)?;
        Ok(Self { rays, surfels, solution, index, surfaces: Surfaces::new(rays) })
    }

    /// The same surfels under another light, which has been checked.
    pub(super) fn under<'b>(&'b self, solution: &'b Solution) -> Field<'b> {
        Field { solution, index: self.index.clone(), surfaces: self.surfaces.clone(), ..*self }
    }

    /// Follows a ray from `origin` along `direction` (unit) through all veils, and shows every surface on its way.
    /// Returns the share of light that comes in from beyond all surfaces, and the rays spent.
    #[inline]
    pub fn walk(&self, origin: Vec3, direction: Vec3, visit: impl FnMut(&Encounter)) -> (Rgb, u32) {
        let irradiance = |point, normal| self.index.find(point, normal).map(|surfel| self.solution.total(surfel));
        self.surfaces.walk(origin, direction, irradiance, visit)
    }

    /// Radiosity that a ray brings from all surfaces on its way [lux], the share that comes from beyond, rays spent.
    pub fn radiosity(&self, origin: Vec3, direction: Vec3) -> (Rgb, Rgb, u32) {
        let mut sum = Rgb::ZERO;
        let (beyond, rays) = self.walk(origin, direction, |e| sum += e.share * e.radiosity);
        (sum, beyond, rays)
    }
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
