//! Refresh: one exact application of the transport operator. A final gather at every surfel's real surface point takes
//! the place of what the sweep found, so that voxel bias and the leaks of thin walls shrink by about the albedo.
//!
//! Few rays never meet a small bright spot, or one does and counts for all: with a share s of all reflected flux and k
//! times the mean radiosity, which is met with the probability s/k and then k − 1 too bright, N rays find it with a
//! relative error of √(s (k − 1)²/kN). Where s (k − 1)²/k is above [`SPOT`] (half the light of a lamp that almost
//! touches a wall), the surfel is taken out of what rays see, and every receiver aims at it:
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

/// Variance of what one ray sees of a surfel from which on it is a spot: 64 rays would leave an error of 3 %.
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
    // s = Φ/ΣΦ, k = (Φ/A)/(ΣΦ/ΣA).
    let noise = |i: usize| {
        let s = flux(i) / all;
        let k = s * area / f64::from(list[i].area);
        if k > 1.0 { s * (k - 1.0) * (k - 1.0) / k } else { 0.0 }
    };
    let mut found: Vec<(f64, usize)> =
        (0..list.len()).map(|i| (noise(i), i)).filter(|(noise, _)| *noise > SPOT).collect();
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        geometry::Geometry,
        rays::Rays,
        surfel::{Resolution, Surfels, VoxelSettings},
    };
    use luxel_scene::{Silent, build::Builder};

    /// A grey floor and a ceiling of 4 × 4, 1 apart, and the light that `direct` gives to their surfels.
    fn refreshed(direct: impl Fn(&Surfels, usize) -> f32, check: impl Fn(&Geometry, &Field, &Solution)) {
        let mut b = Builder::new("floor and ceiling");
        let grey = b.matte(Vec3::splat(0.5));
        b.quad("floor", Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0, grey);
        b.quad("ceiling", Vec3::new(-2.0, 1.0, -2.0), Vec3::X * 4.0, Vec3::Z * 4.0, grey);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let settings = VoxelSettings { resolution: Resolution::Side(32), ..VoxelSettings::default() };
        let surfels = Surfels::new(&geometry, &settings, &Silent).unwrap();
        let light = (0..surfels.list.len()).map(|i| Rgb::splat(direct(&surfels, i))).collect();
        let solution = Solution { direct: light, indirect: vec![Rgb::ZERO; surfels.list.len()] };
        let field = Field::new(&rays, &surfels, &solution).unwrap();
        check(&geometry, &field, &refresh(&field, 64, &|_| Rgb::ZERO, &Silent).unwrap());
    }

    #[test]
    fn a_spot_of_light_is_found_by_every_surfel() {
        let lamp = |surfels: &Surfels| {
            let above = |i: &usize| surfels.list[*i].normal.y < 0.0;
            let middle = |i: usize| surfels.list[i].centroid.with_y(0.0).length_squared();
            (0..surfels.list.len()).filter(above).min_by(|a, b| middle(*a).total_cmp(&middle(*b))).unwrap()
        };
        let direct = |surfels: &Surfels, i: usize| if i == lamp(surfels) { 1000.0 } else { 0.0 };
        refreshed(direct, |geometry, field, found| {
            let lamp = lamp(field.surfels);
            assert_eq!(spots(field).iter().map(|s| s.surfel).collect::<Vec<_>>(), [lamp]);
            let (source, _) = field.surfels.list[lamp].place(geometry);
            let floor = |i: &usize| field.surfels.list[*i].normal.y > 0.0;
            for i in (0..field.surfels.list.len()).filter(floor) {
                // B = ρE; a patch eight times as far as it is wide is a point: E = B·A·h²/(π d⁴).
                let (place, _) = field.surfels.list[i].place(geometry);
                let (h, d2) = (f64::from(source.y - place.y), f64::from(source.distance_squared(place)));
                let area = f64::from(field.surfels.list[lamp].area);
                let exact = 500.0 * area * h * h / (std::f64::consts::PI * d2 * d2);
                let off = f64::from(found.indirect[i].x) / exact - 1.0;
                assert!(off.abs() < 0.03, "surfel {i}: {off}");
            }
        });
    }

    #[test]
    fn even_light_has_no_spots() {
        refreshed(|_, _| 10.0, |_, field, _| assert!(spots(field).is_empty()));
        // Nor has light on half of the floor, or none at all.
        refreshed(
            |s, i| if s.list[i].centroid.x < 0.0 { 10.0 } else { 0.0 },
            |_, field, _| {
                assert!(spots(field).is_empty());
            },
        );
        refreshed(
            |_, _| 0.0,
            |_, field, found| {
                assert!(spots(field).is_empty() && found.indirect.iter().all(|e| *e == Rgb::ZERO));
            },
        );
    }

    #[test]
    fn a_wall_of_one_surfel_is_no_spot() {
        // A sixth of all flux from a sixth of all area, as in a scene of one voxel, is no brighter than its surroundings.
        let mut b = Builder::new("box");
        let grey = b.matte(Vec3::splat(0.5));
        b.cuboid("box", Vec3::ZERO, Vec3::ONE, grey, true);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let settings = VoxelSettings { resolution: Resolution::Edge(10.0), ..VoxelSettings::default() };
        let surfels = Surfels::new(&geometry, &settings, &Silent).unwrap();
        assert_eq!(surfels.list.len(), 6);
        let solution = Solution { direct: vec![Rgb::splat(2.0); 6], indirect: vec![Rgb::ZERO; 6] };
        let field = Field::new(&rays, &surfels, &solution).unwrap();
        assert!(spots(&field).is_empty());
        let found = refresh(&field, 16, &|_| Rgb::ZERO, &Silent).unwrap();
        assert!(found.indirect.iter().all(|e| (*e - 1.0).abs().max_element() < 1e-5), "{:?}", found.indirect);
    }
}
