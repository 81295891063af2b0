//! The tracer of rays, made when the first stage asks for it: where everything is stored, none does.

use std::cell::OnceCell;

use luxel_transport::{geometry::Geometry, rays::Rays};

use super::journal::Journal;
use crate::Error;
use crate::plan::{Plan, Stage};

/// A scene's triangles, and the tree over them once it is needed.
pub struct Tracer<'g> {
    pub geometry: &'g Geometry<'g>,
    rays: OnceCell<Rays<'g>>,
}

impl<'g> Tracer<'g> {
    pub fn new(geometry: &'g Geometry<'g>) -> Self {
        Self { geometry, rays: OnceCell::new() }
    }

    /// The rays. To be asked for by stages that the plan runs: each of them needs light, as this one does.
    ///
    /// # Errors
    /// When the bake is no longer wanted.
    pub fn rays(&self, plan: &Plan, journal: &mut Journal) -> Result<&Rays<'g>, Error> {
        if let Some(rays) = self.rays.get() {
            return Ok(rays);
        }
        let group = journal.group.take();
        let rays = journal.always(Stage::Rays, plan.reason(Stage::Rays), Some(0), |progress, _| {
            Ok(Rays::build(self.geometry, progress)?)
        });
        journal.group = group;
        let rays = rays?;
        Ok(self.rays.get_or_init(|| rays))
    }
}
