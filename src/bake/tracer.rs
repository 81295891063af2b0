//! The tracer of rays, made when the first stage asks for it: where everything is stored, none does.

use std::cell::OnceCell;

use luxel_transport::{geometry::Geometry, rays::Rays};

use super::Kept;
use super::journal::Journal;
use crate::Error;
use crate::plan::{Plan, Stage};
use crate::store::Key;

/// A scene's triangles, and the tree over them once it is needed.
pub struct Tracer<'g> {
    pub geometry: &'g Geometry<'g>,
    /// Where the tree may be kept from bake to bake, and the key of the scene's shape.
    kept: Option<(&'g Kept, Key)>,
    rays: OnceCell<Rays<'g>>,
}

impl<'g> Tracer<'g> {
    pub fn new(geometry: &'g Geometry<'g>, kept: Option<(&'g Kept, Key)>) -> Self {
        Self { geometry, kept, rays: OnceCell::new() }
    }

    /// With rays that are there already.
    pub fn with(geometry: &'g Geometry<'g>, rays: Rays<'g>) -> Self {
        Self { geometry, kept: None, rays: OnceCell::from(rays) }
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
        let known = self.kept.and_then(|(kept, shape)| kept.tree(&shape));
        let is_known = known.is_some();
        let rays = journal.always(Stage::Rays, plan.reason(Stage::Rays), Some(0), |progress, _| match known {
            Some(tree) => Ok(Rays::with(self.geometry, tree)),
            None => Ok(Rays::build(self.geometry, progress)?),
        });
        journal.group = group;
        let rays = rays?;
        if is_known {
            journal.add(Stage::Rays, "their tree is that of the last bake");
        } else if let Some((kept, shape)) = self.kept {
            kept.keep_tree(&shape, rays.tree());
        }
        Ok(self.rays.get_or_init(|| rays))
    }
}
