//! A view of a scene that has no camera: the candidate that shows most of it lit, not too close and with some depth. The
//! same scene gives the same view.

use glam::DVec3;
use luxel_scene::{Camera, Cancelled, Progress, Uncounted};
use luxel_transport::{
    Rgb,
    rays::Rays,
    sampling::{combine, r2, unit2},
};
use rayon::prelude::*;

use super::lens::{Lens, camera};
use super::light::{Illumination, Point};
use super::march::{Layer, Look};

/// Rays of a candidate view, across and down.
const PROBE: [u32; 2] = [24, 16];

/// Candidates from outside and from inside.
const OUTSIDE: u32 = 8;
const INSIDE: u32 = 96;

/// Candidates whose light is asked for together.
const TOGETHER: usize = 8;

/// Chooses a view. `typical` is the irradiance of a surface that is lit well [lux].
///
/// # Errors
/// When it is no longer wanted.
pub fn choose(
    look: &Look,
    light: &dyn Illumination,
    typical: f32,
    progress: &dyn Progress,
) -> Result<Camera, Cancelled> {
    let candidates = candidates(look.rays);
    progress.begin("view", candidates.len() as u64);
    let mut best: Option<(f64, &Camera)> = None;
    for together in candidates.chunks(TOGETHER) {
        for (score, camera) in scores(look, light, typical, together, progress)?.into_iter().zip(together) {
            // The first of equals, so that the choice is stable.
            if best.is_none_or(|(most, _)| score > most) {
                best = Some((score, camera));
            }
        }
        progress.advance(together.len() as u64);
    }
    Ok(best.map_or_else(|| camera(DVec3::ZERO, DVec3::NEG_Z, 0.9), |(_, camera)| camera.clone()))
}

/// One ray of a candidate: the surfaces that it sees, and what is beyond.
struct Probe {
    layers: Vec<Layer>,
    background: Rgb,
}

fn scores(
    look: &Look,
    light: &dyn Illumination,
    typical: f32,
    candidates: &[Camera],
    progress: &dyn Progress,
) -> Result<Vec<f64>, Cancelled> {
    let probes: Vec<Vec<Probe>> = candidates
        .par_iter()
        .map(|camera| {
            progress.check()?;
            Ok(probes(look, camera))
        })
        .collect::<Result<_, Cancelled>>()?;
    let layers = probes.iter().flatten().flat_map(|p| &p.layers);
    let points: Vec<Point> = (0..).zip(layers).map(|(i, layer)| Point::new(layer, 0.01 * layer.distance, i)).collect();
    let mut light = light.light(&points, &Uncounted(progress))?.into_iter();
    let mut lit = |probe: &Probe| {
        let shown = probe.layers.iter().zip(light.by_ref());
        let seen = shown.map(|(layer, lit)| layer.weight * layer.emission + layer.reflects() * lit.irradiance);
        probe.background + seen.sum::<Rgb>()
    };
    let scores = probes.iter().map(|probes| {
        let seen: Vec<(Rgb, Option<&Layer>)> = probes.iter().map(|p| (lit(p), p.layers.first())).collect();
        score(&seen, typical)
    });
    Ok(scores.collect())
}

fn probes(look: &Look, camera: &Camera) -> Vec<Probe> {
    let lens = Lens::new(camera, &look.rays.geometry.frame, 1.5);
    let [across, down] = PROBE;
    (0..across * down)
        .map(|i| {
            let s = ((i % across) as f32 + 0.5) / across as f32 * 2.0 - 1.0;
            let t = 1.0 - ((i / across) as f32 + 0.5) / down as f32 * 2.0;
            let mut layers = Vec::new();
            let background = look.along(lens.eye, lens.direction(s, t), &mut layers);
            Probe { layers, background }
        })
        .collect()
}

/// How good a view is, from the radiances that it shows and the first surface along every ray.
fn score(seen: &[(Rgb, Option<&Layer>)], typical: f32) -> f64 {
    let reach = luxel_transport::frame::SIDE;
    let typical = f64::from(typical).max(f64::MIN_POSITIVE) / 8.0;
    let mut sum = 0.0;
    let mut depths = Vec::new();
    let mut normals = DVec3::ZERO;
    for (light, first) in seen {
        let Some(first) = first else { continue };
        let bright = f64::from(light.max_element());
        // A wall right before the eye counts little, a lit surface more than a dark one.
        let room = (f64::from(first.distance) / (0.1 * reach)).min(1.0);
        sum += room * (0.25 + 0.75 * bright / (bright + typical));
        depths.push(f64::from(first.distance) / reach);
        normals += first.normal.as_dvec3();
    }
    let n = depths.len() as f64;
    if n == 0.0 {
        return 0.0;
    }
    let mean = depths.iter().sum::<f64>() / n;
    let spread = (depths.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / n).sqrt();
    // 0 before a single wall, ½ before two at a right angle.
    let variety = 1.0 - (normals / n).length_squared();
    sum / seen.len() as f64 * (0.25 + spread.min(0.25) + variety)
}

/// Views from outside that show all of the scene's box, and views from points within it.
fn candidates(rays: &Rays) -> Vec<Camera> {
    let Some((lo, hi)) = rays.geometry.scene.bounds() else { return vec![camera(DVec3::ZERO, DVec3::NEG_Z, 0.9)] };
    let (center, size) = (0.5 * (lo + hi), hi - lo);
    let radius = (0.5 * size.length()).max(f64::MIN_POSITIVE);
    let mut list = Vec::new();
    for i in 0..OUTSIDE {
        let azimuth = std::f64::consts::TAU * (f64::from(i) + 0.4) / f64::from(OUTSIDE);
        let (sin, cos) = (libm::sin(azimuth), libm::cos(azimuth));
        let from = DVec3::new(0.87 * cos, 0.5, 0.87 * sin).normalize();
        // The bounding sphere fits a field of view of 0.7 rad.
        list.push(camera(center + from * radius / libm::sin(0.35), -from, 0.7));
    }
    for i in 0..INSIDE {
        let p = r2(i, glam::Vec2::ZERO);
        let q = unit2(combine(7, u64::from(i)));
        let share = DVec3::new(0.1 + 0.8 * f64::from(p.x), 0.3 + 0.4 * f64::from(q.x), 0.1 + 0.8 * f64::from(p.y));
        let azimuth = std::f64::consts::TAU * f64::from(q.y);
        let ahead = DVec3::new(libm::cos(azimuth), -0.12, libm::sin(azimuth)).normalize();
        list.push(camera(lo + size * share, ahead, 1.15));
    }
    list
}
