//! Lamps that almost touch a surface.
//!
//! A lamp 1 µm in front of a wall sends half of its light into a spot of some µm, which no point of a surfel sees: the
//! whole spot, and all that it reflects, would be missing. What a surfel receives is the flux through the cone that it
//! fills, Φ = ∫ I dΩ, and E = Φ/A. Where a lamp is nearer to a surfel than [`NEAR`] voxels, that integral is taken by
//! rays from the lamp, evenly over the sphere, in place of the mean over points of the surfel.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use glam::{DVec3, Vec2};
use luxel_scene::{Cancelled, Progress};

use super::exact::receivers;
use crate::{
    Rgb,
    direct::{Direct, DirectSettings, Visibility},
    gather::{Gather, Receiver},
    lights::{Emitters, Lamp},
    rays::Rays,
    sampling::{r2, sphere, unit2},
    surfel::{Grid, Surfels},
};

/// Nearer than this many voxel edges, points of a surfel are no measure of its light.
const NEAR: f32 = 1.0;

/// Radius of lamps that are points to a surfel, in voxel edges.
const SMALL: f32 = 0.25;

/// Rays from a lamp: a surfel at that distance gets some hundreds.
const RAYS: u32 = 1 << 14;

/// Rays between two looks at the progress.
const BREATH: u32 = 1 << 10;

/// Replaces the light of lamps at the surfels that they almost touch; `irradiance` has that of `points` points (1 or 5)
/// of each surfel. Returns the rays spent.
///
/// # Errors
/// When the work is cancelled.
pub fn close(
    rays: &Rays,
    emitters: &Emitters,
    surfels: &Surfels,
    points: u32,
    irradiance: &mut [Rgb],
    progress: &dyn Progress,
) -> Result<u64, Cancelled> {
    let mut spent = 0;
    // A luminous sphere of some size has no spot of light but a pool.
    for lamp in emitters.lamps.iter().filter(|lamp| lamp.radius < SMALL * surfels.grid.edge) {
        progress.check()?;
        let near = near(surfels, lamp);
        if near.is_empty() {
            continue;
        }
        let found = by_rays(rays, surfels, lamp, near, progress)?;
        spent += u64::from(RAYS);
        let alone = Emitters { areas: Vec::new(), lamps: vec![lamp.clone()], suns: Vec::new(), scale: emitters.scale };
        let how = DirectSettings { visibility: Visibility::Rays, ..DirectSettings::default() };
        let direct = Direct::build(rays, &alone, how, progress)?;
        for (surfel, flux) in found {
            let places: Vec<Receiver> =
                receivers(rays.geometry, surfels, surfel, points).into_iter().flatten().collect();
            let at_points: Rgb = direct.gather(&places, progress)?.iter().map(|g| g.irradiance).sum();
            let flux = flux / f64::from(surfels.list[surfel].area);
            let rest = irradiance[surfel] - at_points / places.len() as f32;
            irradiance[surfel] = rest.max(Rgb::ZERO) + flux.as_vec3();
        }
    }
    Ok(spent)
}

/// The surfels that a lamp is near to, each without light.
fn near(surfels: &Surfels, lamp: &Lamp) -> BTreeMap<usize, DVec3> {
    let Grid { edge, .. } = surfels.grid;
    let at = surfels.grid.voxel(lamp.position);
    let reach = NEAR.ceil() as i32 + 1;
    let mut near = BTreeMap::new();
    for x in -reach..=reach {
        for y in -reach..=reach {
            for z in -reach..=reach {
                for i in surfels.in_voxel(at + glam::IVec3::new(x, y, z)) {
                    let way = surfels.list[i].centroid - lamp.position;
                    let height = surfels.list[i].normal.dot(way).abs();
                    // Along its plane a surfel reaches further than its centroid.
                    if height < NEAR * edge && way.length() < (NEAR + 1.0) * edge {
                        near.insert(i, DVec3::ZERO);
                    }
                }
            }
        }
    }
    near
}

/// The flux of a lamp that arrives at each of these surfels [lux × squared frame units].
fn by_rays(
    rays: &Rays,
    surfels: &Surfels,
    lamp: &Lamp,
    mut near: BTreeMap<usize, DVec3>,
    progress: &dyn Progress,
) -> Result<BTreeMap<usize, DVec3>, Cancelled> {
    let shift: Vec2 = unit2(lamp.identity);
    let solid_angle = 4.0 * PI / f64::from(RAYS);
    for k in 0..RAYS {
        if k.is_multiple_of(BREATH) {
            progress.check()?;
        }
        let direction = sphere(r2(k, shift));
        let Some(hit) = rays.closest(lamp.position, direction, f32::INFINITY) else { continue };
        let material = rays.geometry.material(hit.triangle);
        if hit.back && !material.double_sided {
            continue;
        }
        let triangle = &rays.geometry.triangles[hit.triangle as usize];
        let normal = if hit.back { -triangle.normal } else { triangle.normal };
        let point = triangle.at(hit.u, hit.v);
        if let Some(sum) = surfels.find(point, normal).and_then(|i| near.get_mut(&i)) {
            let coverage = rays.geometry.surface(hit.triangle, hit.u, hit.v, 0.0).coverage;
            *sum += lamp.intensity_towards(point).as_dvec3() * (solid_angle * f64::from(coverage));
        }
    }
    Ok(near)
}
