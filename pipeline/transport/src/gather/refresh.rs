//! Refresh: one exact application of the transport operator. A final gather at every surfel's real surface point takes
//! the place of what the sweep found, so that voxel bias and the leaks of thin walls shrink by about the albedo.

use glam::Vec3;
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use super::{Field, Receiver, final_gather::collect, hemisphere::Hemisphere};
use crate::{
    Rgb,
    lighttree::identity,
    surfel::{Solution, Surfel},
};

/// Surfels between two looks at the progress.
const CHUNK: usize = 256;

/// The solution with its indirect irradiance gathered anew by `rays` rays a surfel. `sky` is the radiance [cd/m²] that
/// comes in along a direction (seen from inside, towards the sky). Reports one unit of progress per surfel.
pub fn refresh(
    field: &Field,
    rays: u32,
    sky: &(dyn Fn(Vec3) -> Rgb + Sync),
    progress: &dyn Progress,
) -> Result<Solution, Cancelled> {
    let hemisphere = Hemisphere::new(rays.max(1));
    let mut indirect = vec![Rgb::ZERO; field.surfels.list.len()];
    let chunks = field.surfels.list.par_chunks(CHUNK).zip(indirect.par_chunks_mut(CHUNK));
    chunks.try_for_each(|(surfels, out)| {
        progress.check()?;
        for (surfel, out) in surfels.iter().zip(out) {
            let (surfaces, beyond, _) = collect(field, &hemisphere, &surfel_receiver(field, surfel), sky);
            *out = surfaces + beyond;
        }
        progress.advance(surfels.len() as u64);
        Ok(())
    })?;
    Ok(Solution { direct: field.solution.direct.clone(), indirect })
}

/// The surfel's representative point as a receiver.
pub(super) fn surfel_receiver(field: &Field, surfel: &Surfel) -> Receiver {
    let (position, normal) = surfel.place(field.rays.geometry);
    Receiver { position, normal, shading_normal: normal, footprint: surfel.area.sqrt(), seed: identity(surfel) }
}
