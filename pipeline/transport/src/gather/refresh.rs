//! Refresh: one exact application of the transport operator. A final gather at every surfel's real surface point takes
//! the place of what the sweep found, so that voxel bias and the leaks of thin walls shrink by about the albedo.
//!
//! Few rays never meet a small bright spot, or one does and counts for all: with a share s of all reflected flux and k
//! times the mean radiosity, N rays find it with a relative error of √(sk/N). Where sk is above [`SPOT`] (half the light
//! of a lamp that almost touches a wall), the surfel is taken out of what rays see, and every receiver aims at it:
//!
//!   E += B · A cos θ cos θ' V / (πr² + A)     the form factor of a disc, V the transmittance of a shadow ray

use glam::Vec3;
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use super::{Field, Receiver, final_gather::collect, hemisphere::Hemisphere};
use crate::{
    Rgb,
    lighttree::identity,
    rays::OFFSET,
    surfel::{Solution, Surfel},
};

/// Surfels that a thread takes at a time, and between two looks at the progress where each aims at spots.
const CHUNK: usize = 256;
const BREATH: usize = 32;

/// Share of flux times relative radiosity from which on a surfel is a spot: 64 rays would leave an error of 3 %.
const SPOT: f64 = 1.0 / 16.0;

/// Spots, at most.
const MOST_SPOTS: usize = 64;

/// The solution with its indirect irradiance gathered anew by `rays` rays a surfel. `sky` is the radiance [cd/m²] that
/// comes in along a direction (seen from inside, towards the sky). Reports one unit of progress per surfel.
pub fn refresh(
    field: &Field,
    rays: u32,
    sky: &(dyn Fn(Vec3) -> Rgb + Sync),
    progress: &dyn Progress,
) -> Result<Solution, Cancelled> {
    let hemisphere = Hemisphere::new(rays.max(1));
    let spots = spots(field);
    let dimmed = (!spots.is_empty()).then(|| without(field.solution, &spots));
    let rest = dimmed.as_ref().map(|solution| field.under(solution));
    let seen = rest.as_ref().unwrap_or(field);
    let mut indirect = vec![Rgb::ZERO; field.surfels.list.len()];
    let chunks = field.surfels.list.par_chunks(CHUNK).zip(indirect.par_chunks_mut(CHUNK));
    chunks.try_for_each(|(surfels, out)| {
        for (i, (surfel, out)) in surfels.iter().zip(out).enumerate() {
            if i % CHUNK == 0 || !spots.is_empty() && i % BREATH == 0 {
                progress.check()?;
            }
            let receiver = surfel_receiver(field, surfel);
            let (surfaces, beyond, _) = collect(seen, &hemisphere, &receiver, sky);
            *out = surfaces + beyond + spots.iter().map(|spot| from_spot(field, &receiver, spot)).sum::<Rgb>();
        }
        progress.advance(surfels.len() as u64);
        Ok(())
    })?;
    Ok(Solution { direct: field.solution.direct.clone(), indirect })
}

/// A surfel that receivers aim at.
struct Spot {
    surfel: usize,
    position: Vec3,
    normal: Vec3,
    area: f32,
    /// B [lux].
    radiosity: Rgb,
}

/// The surfels that rays would find too rarely, the worst ones first.
fn spots(field: &Field) -> Vec<Spot> {
    let list = &field.surfels.list;
    let radiosity = |i: usize| list[i].albedo() * field.solution.total(i);
    let flux = |i: usize| f64::from(list[i].area * radiosity(i).element_sum());
    let (all, area) = ((0..list.len()).map(flux).sum::<f64>(), field.surfels.area());
    // s · k, with s = Φ/ΣΦ and k = (Φ/A)/(ΣΦ/ΣA).
    let noise = |i: usize| flux(i) * flux(i) / (all * all) * area / f64::from(list[i].area);
    let mut found: Vec<(f64, usize)> = (0..list.len()).map(|i| (noise(i), i)).filter(|(sk, _)| *sk > SPOT).collect();
    found.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let spot = |(_, surfel): &(f64, usize)| {
        let (position, normal) = list[*surfel].place(field.rays.geometry);
        Spot { surfel: *surfel, position, normal, area: list[*surfel].area, radiosity: radiosity(*surfel) }
    };
    found.iter().take(MOST_SPOTS).map(spot).collect()
}

/// The light of all surfels but these.
fn without(solution: &Solution, spots: &[Spot]) -> Solution {
    let mut dimmed = solution.clone();
    for spot in spots {
        (dimmed.direct[spot.surfel], dimmed.indirect[spot.surfel]) = (Rgb::ZERO, Rgb::ZERO);
    }
    dimmed
}

fn from_spot(field: &Field, receiver: &Receiver, spot: &Spot) -> Rgb {
    let way = spot.position - receiver.position;
    let square = way.length_squared();
    let (cosine, other) = (receiver.normal.dot(way), -spot.normal.dot(way));
    if cosine <= 0.0 || other <= 0.0 {
        return Rgb::ZERO;
    }
    let factor = spot.area * cosine * other / (square * (std::f32::consts::PI * square + spot.area));
    let (from, to) = (receiver.position + receiver.normal * OFFSET, spot.position + spot.normal * OFFSET);
    let length = from.distance(to);
    let open = if length > 0.0 { field.rays.transmittance(from, (to - from) / length, length) } else { Rgb::ONE };
    spot.radiosity * open * factor
}

/// The surfel's representative point as a receiver.
pub(super) fn surfel_receiver(field: &Field, surfel: &Surfel) -> Receiver {
    let (position, normal) = surfel.place(field.rays.geometry);
    Receiver { position, normal, shading_normal: normal, footprint: surfel.area.sqrt(), seed: identity(surfel) }
}
