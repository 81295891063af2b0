//! Emissive surfaces as point lights: every polygon that shines is cut into congruent triangles of about equal size, each
//! with one light in its middle. No random numbers: a regular pattern has no noise, and the near field is left to rays.

use glam::Vec3;

use super::{Light, Seeded};
use crate::{Rgb, lights::AreaLight, sampling::combine};

/// Most pieces along one side of a triangle, so that a single huge emitter stays affordable.
const MAX_SIDE: u32 = 256;

/// Point lights on emissive surfaces.
#[derive(Default)]
pub struct EmitterSamples {
    pub lights: Vec<Seeded>,
    /// Longest side of a piece, frame units: how near a receiver may be before the pieces stop looking like points.
    pub spacing: f32,
}

/// About `budget` lights on all polygons, and at least one on each of their triangles.
pub fn emitter_samples(areas: &[AreaLight], budget: usize) -> EmitterSamples {
    let total: f64 = areas.iter().map(|light| f64::from(light.area)).sum();
    let piece = total / budget.max(1) as f64;
    let mut samples = EmitterSamples::default();
    for light in areas {
        let mut number = 0;
        let [a, b, c] = [0, 1, 2].map(|i| light.corners()[i]);
        sample(light, [a, b, c], piece as f32, &mut number, &mut samples);
        if let Some(&d) = light.corners().get(3) {
            sample(light, [a, c, d], piece as f32, &mut number, &mut samples);
        }
    }
    samples
}

/// One triangle of a polygon; `number` counts the polygon's samples.
fn sample(light: &AreaLight, [a, b, c]: [Vec3; 3], piece: f32, number: &mut u64, samples: &mut EmitterSamples) {
    let area = 0.5 * (b - a).cross(c - a).length();
    let n = ((area / piece).sqrt().ceil() as u32).clamp(1, MAX_SIDE);
    let step = 1.0 / n as f32;
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    samples.spacing = samples.spacing.max(longest * step);
    let sides = if light.two_sided { &[1.0, -1.0][..] } else { &[1.0] };
    for i in 0..n {
        // Row i of the pattern holds n − i upright pieces and n − i − 1 upside-down ones between them.
        for j in 0..2 * (n - i) - 1 {
            let third = if j % 2 == 0 { 1.0 / 3.0 } else { 2.0 / 3.0 };
            let (u, v) = (((j / 2) as f32 + third) * step, (i as f32 + third) * step);
            let position = a + (b - a) * u + (c - a) * v;
            // What varies is a triangle. I = πLₑ·A/π.
            let radiance = light.table.as_ref().map_or(light.radiance, |table| table.at(u, v));
            let intensity = radiance.max(Rgb::ZERO) * (area * step * step);
            *number += 1;
            for &side in sides {
                let normal = light.normal * side;
                let sample = Light { position, normal, intensity, area: 0.0 };
                samples.lights.push(Seeded { light: sample, seed: combine(light.identity, *number) });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{geometry::Geometry, lights::Emitters};
    use luxel_scene::build::Builder;

    #[test]
    fn the_samples_carry_the_whole_power_of_the_emitter() {
        // A second lamp in the place of the first shines nowhere.
        let lamps = |names: &[&str]| {
            let mut b = Builder::new("lamp");
            let glow = b.emitter(Vec3::splat(0.5), Vec3::new(3.0, 2.0, 1.0));
            names.iter().for_each(|name| {
                b.quad(name, Vec3::ZERO, Vec3::X * 2.0, Vec3::Z, glow);
            });
            b.build()
        };
        let (single, double) = (lamps(&["lamp"]), lamps(&["lamp", "double"]));
        let geometry = Geometry::new(&single);
        let area: f32 = geometry.triangles.iter().map(|t| t.area()).sum();
        for (scene, budget) in [(&single, 1), (&single, 2), (&single, 7), (&single, 100), (&double, 7), (&double, 1000)]
        {
            let samples = emitter_samples(&Emitters::new(&Geometry::new(scene)).areas, budget);
            assert!(samples.lights.len() >= 2 && samples.lights.len() <= 2 * budget + 8);
            let intensity: Vec3 = samples.lights.iter().map(|l| l.light.intensity).sum();
            assert!(intensity.abs_diff_eq(Vec3::new(3.0, 2.0, 1.0) * area, 1e-4 * area), "{intensity}");
        }
    }

    #[test]
    fn a_scene_without_emitters_has_no_samples() {
        let mut b = Builder::new("dark");
        let grey = b.matte(Vec3::splat(0.5));
        b.quad("floor", Vec3::ZERO, Vec3::X, Vec3::Z, grey);
        let scene = b.build();
        let samples = emitter_samples(&Emitters::new(&Geometry::new(&scene)).areas, 100);
        assert!(samples.lights.is_empty() && samples.spacing == 0.0);
    }
}
