//! Light straight from the sources: exact from each of them, or by lightcuts where there are too many.
//!
//! The exact way ([`Direct`]) costs every receiver a look at every light; where light can pass through surfaces it
//! costs a ray to each of their points too. Above the numbers below, emissive surfaces are gathered by a cut through
//! the tree of their samples ([`Lightcuts`]) instead, whose cost grows with the logarithm of their number. Lamps and
//! suns stay exact.

use luxel_scene::{Cancelled, Progress, Uncounted};
use luxel_transport::{
    direct::{Direct, DirectSettings, Visibility},
    gather::{Field, Gather, Gathered, Lightcuts, Receiver, lightcuts},
    geometry::Geometry,
    lights::Emitters,
    lighttree::emitter_samples,
    rays::Rays,
    surfel::{Grid, Solution, Surfels},
};

use crate::Error;
use crate::settings::Settings;

/// Most emissive polygons that are gathered one by one where all surfaces are solid.
const MOST_AMONG_SOLIDS: usize = 1024;

/// The same where some surfaces let light pass: each point of a light behind one costs a ray.
const MOST_AMONG_VEILS: usize = 128;

/// Emissive polygons that are gathered one by one in any case.
pub const LEAST_CROWD: usize = MOST_AMONG_VEILS;

/// Samples of emissive surfaces for every polygon, and at least.
const SAMPLES: (usize, usize) = (4, 1 << 14);

/// Fewest rays for the near field: where it meets a lamp it is all the light there is.
const NEAR_RAYS: u32 = 16;

/// Emissive surfaces are too many to be gathered one by one.
pub fn is_crowded(geometry: &Geometry, emitters: &Emitters) -> bool {
    let scene = geometry.scene;
    let veiled = scene.instances.iter().any(|i| i.casts && !scene.materials[scene.meshes[i.mesh].material].is_opaque());
    emitters.areas.len() > if veiled { MOST_AMONG_VEILS } else { MOST_AMONG_SOLIDS }
}

/// Share of the error threshold for direct light: its clusters are lamps that no bounce has smoothed yet.
const FINER: f32 = 0.5;

/// Factor on the limit of a cut: the finer threshold takes more clusters, and the limit must not undo it.
const LONGER: u32 = 2;

/// Makes the gatherer of direct light and works with it. Where receivers are far apart, no two of them share what stands
/// between them and a light: a shadow ray to each of its points is quicker then than shafts.
pub fn with<T>(
    rays: &Rays,
    emitters: &Emitters,
    settings: &Settings,
    visibility: Visibility,
    progress: &dyn Progress,
    work: impl FnOnce(&dyn Gather) -> Result<T, Error>,
) -> Result<T, Error> {
    let how = DirectSettings { samples: settings.shadow_samples.0, visibility, ..DirectSettings::default() };
    if !is_crowded(rays.geometry, emitters) {
        return work(&Direct::build(rays, emitters, how, progress)?);
    }
    let punctual = Emitters { areas: Vec::new(), ..emitters.clone() };
    // Emitters are found by rays and by their own tree: no surfel is asked for anything.
    let surfels = Surfels::dark(Grid { origin: glam::Vec3::ZERO, edge: 1.0, size: glam::IVec3::ONE }, Vec::new());
    let dark = Solution::default();
    let field = Field::build(rays, &surfels, &dark, progress)?;
    let cuts = lightcuts::Settings {
        threshold: FINER * settings.cut_error.0,
        limit: LONGER * settings.cut_limit.0,
        near_rays: settings.near_rays.0.max(NEAR_RAYS),
        indirect: false,
    };
    let samples = emitter_samples(&emitters.areas, (SAMPLES.0 * emitters.areas.len()).max(SAMPLES.1));
    let punctual = Direct::build(rays, &punctual, how, progress)?;
    work(&Crowd { punctual, surfaces: Lightcuts::with_emitters(&field, cuts, samples, progress)? })
}

/// Lamps and suns one by one, emissive surfaces by cuts.
struct Crowd<'a> {
    punctual: Direct<'a>,
    surfaces: Lightcuts<'a>,
}

impl Gather for Crowd<'_> {
    fn gather(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        let mut gathered = self.surfaces.gather(receivers, progress)?;
        // The receivers are counted once.
        for (sum, lamps) in gathered.iter_mut().zip(self.punctual.gather(receivers, &Uncounted(progress))?) {
            sum.irradiance += lamps.irradiance;
            sum.rays = sum.rays.saturating_add(lamps.rays);
        }
        Ok(gathered)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, DVec3, Vec3};
    use luxel_scene::{LightKind, Scene, Silent, build::Builder};

    /// A floor under a grid of small lamps, so many in each place, and one point light.
    fn hall(side: u32, each: u32) -> Scene {
        let mut b = Builder::new("hall");
        let grey = b.matte(Vec3::splat(0.5));
        let glow = b.emitter(Vec3::ZERO, Vec3::new(30.0, 20.0, 10.0));
        b.quad("floor", Vec3::new(-8.0, 0.0, 8.0), Vec3::X * 16.0, Vec3::NEG_Z * 16.0, grey);
        b.cuboid("block", Vec3::new(-1.0, 0.5, -1.0), Vec3::new(1.0, 1.0, 1.0), grey, false);
        let size = 4.0 / side as f32;
        let lamp = b.quad("lamp", Vec3::new(0.0, 4.0, 0.0), Vec3::X * size, Vec3::Z * size, glow);
        let mesh = b.scene_mut().instances[lamp].mesh;
        for i in each..side * side * each {
            let (x, z) = (i / each % side, i / each / side);
            let at = DVec3::new(f64::from(x), 0.0, f64::from(z)) * (12.0 / f64::from(side)) - 6.0;
            let at = DAffine3::from_translation(DVec3::new(at.x, 0.0, at.z));
            b.place(mesh, at, &format!("lamp {i}"));
        }
        let kind = LightKind::Point { position: DVec3::new(0.0, 2.0, 5.0), range: None, radius: 0.0 };
        b.light("bulb", kind, Vec3::splat(20.0));
        b.build()
    }

    #[test]
    fn a_crowd_shines_like_its_members() {
        // Of two lamps in one place the second one shines nowhere.
        for each in [1, 2] {
            assert_like_its_members(&hall(36, each));
        }
    }

    fn assert_like_its_members(scene: &Scene) {
        let geometry = Geometry::new(scene);
        let rays = Rays::new(&geometry);
        let emitters = Emitters::new(&geometry);
        assert!(is_crowded(&geometry, &emitters), "{} lamps", emitters.areas.len());
        let receivers: Vec<Receiver> = (0..200u32)
            .map(|i| {
                let p = luxel_transport::sampling::r2(i, glam::Vec2::ZERO);
                Receiver::on_triangle(&geometry, i % 2, p.x.min(p.y), 0.5 * (p.x - p.y).abs(), 1.0, u64::from(i))
            })
            .collect();
        let settings = Settings::default();
        let found =
            with(&rays, &emitters, &settings, Visibility::Shafts, &Silent, |g| Ok(g.gather(&receivers, &Silent)?))
                .unwrap();
        let exact = Direct::new(&rays, &emitters, DirectSettings::default()).gather(&receivers, &Silent).unwrap();
        let (mut square, mut bias, mut mean) = (0.0, 0.0, 0.0);
        for (a, b) in found.iter().zip(&exact) {
            let (a, b) = (f64::from(a.irradiance.y), f64::from(b.irradiance.y));
            square += (a - b) * (a - b);
            bias += a - b;
            mean += b;
        }
        let n = receivers.len() as f64;
        let (rmse, bias) = ((square / n).sqrt() / (mean / n), bias / mean);
        assert!(rmse < 0.02 && bias.abs() < 0.005, "RMSE {rmse}, bias {bias}");
    }

    #[test]
    fn a_few_lamps_are_no_crowd() {
        let scene = hall(12, 1);
        let geometry = Geometry::new(&scene);
        assert!(!is_crowded(&geometry, &Emitters::new(&geometry)));
    }
}
