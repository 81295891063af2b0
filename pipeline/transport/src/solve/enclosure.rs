//! Whether a scene is closed: nothing that leaves a surface ever reaches the sky or the inside of a surface.

use rayon::prelude::*;

use crate::{
    rays::{OFFSET, Rays},
    sampling,
    surfel::Surfels,
};

/// Whether none of `probes` cosine-distributed rays from the surfels escapes, meets the back of a single-sided
/// surface or a surface that lets light through. An opening that they miss lets out less than about 1/`probes` of
/// the light. The solver may then treat lines from nowhere as unknown, so that every row of its operator sums to 1.
pub fn is_closed(rays: &Rays, surfels: &Surfels, probes: u32) -> bool {
    let count = surfels.list.len() as u64;
    if count == 0 || probes == 0 {
        return false;
    }
    let geometry = rays.geometry;
    (0..probes).into_par_iter().all(|k| {
        let s = &surfels.list[(u64::from(k) * count / u64::from(probes)) as usize];
        let (point, normal) = s.place(geometry);
        let hash = sampling::combine(0xc105_ed00, u64::from(k));
        let direction = sampling::basis(normal) * sampling::cosine_hemisphere(sampling::unit2(hash));
        let hit = rays.closest(point + normal * OFFSET, direction, f32::INFINITY);
        hit.is_some_and(|hit| {
            let front = !hit.back || geometry.material(hit.triangle).double_sided;
            let opaque = geometry.material(hit.triangle).is_opaque()
                || geometry.surface(hit.triangle, hit.u, hit.v, 0.0).transmittance.max_element() == 0.0;
            front && opaque
        })
    })
}
