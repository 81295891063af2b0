//! Lightmaps of a scene for pictures of it: the chain of a bake from its store, without its files.

use luxel_atlas::InProcess;
use luxel_scene::{Progress, Scene};
use luxel_transport::geometry::Geometry;

use super::groups::Lighting;
use super::journal::Journal;
use super::keys::Keys;
use super::lab::traced;
use super::tracer::Tracer;
use super::{Baking, Keep, Lit, atlas, light};
use crate::Error;
use crate::plan::Plan;
use crate::settings::Settings;
use crate::store::Store;

/// The finished lightmaps of a scene that was loaded with the same settings, and the continuous rays that were traced for
/// them. What is in the store is not made, and what
/// is made is left there, as by a bake; no other file is written.
///
/// # Errors
/// As a bake.
pub fn lightmaps(
    scene: &Scene,
    settings: &Settings,
    store: Option<&Store>,
    progress: &dyn Progress,
) -> Result<(Lit, u64), Error> {
    let mut scene = scene.clone();
    let lighting = Lighting::part(&mut scene, settings);
    let mut plan = Plan::new(&scene, settings);
    plan.part(lighting.groups.iter().map(|g| g.name.clone()).collect(), settings);
    let keys = Keys::new(&scene, &lighting, settings, &plan);
    let geometry = Geometry::new(&scene);
    let (plan, lighting, keys) = (&plan, &lighting, &keys);
    let baking =
        Baking { settings, plan, lighting, keys, store, kept: None, only_stored: false, books: store.is_some() };
    let mut journal = Journal::new(progress);
    let laid_out = atlas::run(&baking, &scene, &InProcess, &mut journal)?;
    let lit = light(&baking, &Tracer::new(&geometry, None), laid_out, Keep::Images, &mut journal)?;
    Ok((lit, traced(&journal.close())))
}
