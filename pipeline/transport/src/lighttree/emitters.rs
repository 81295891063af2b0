//! Emissive surfaces as point lights: every emitting triangle is cut into congruent triangles of about equal size, each
//! with one light in its middle. No random numbers: a regular pattern has no noise, and the near field is left to rays.

use glam::Vec3;

use super::{Light, Seeded};
use crate::{
    geometry::Geometry,
    sampling::{combine, mix},
};

/// Most pieces along one side of a triangle, so that a single huge emitter stays affordable.
const MAX_SIDE: u32 = 256;

/// Point lights on emissive surfaces.
pub struct EmitterSamples {
    pub lights: Vec<Seeded>,
    /// Longest side of a piece, frame units: how near a receiver may be before the pieces stop looking like points.
    pub spacing: f32,
}

/// About `budget` lights on all emitting triangles that cast, and at least one on each.
pub fn emitter_samples(geometry: &Geometry, budget: usize) -> EmitterSamples {
    let emits = |t: &u32| {
        let triangle = &geometry.triangles[*t as usize];
        let material = geometry.material(*t);
        let casts = geometry.scene.instances[triangle.instance as usize].casts;
        material.emits() && !material.unlit && casts && !triangle.is_degenerate()
    };
    let triangles: Vec<u32> = (0..geometry.triangles.len() as u32).filter(emits).collect();
    let total: f64 = triangles.iter().map(|&t| f64::from(geometry.triangles[t as usize].area())).sum();
    let piece = total / budget.max(1) as f64;
    let mut samples = EmitterSamples { lights: Vec::new(), spacing: 0.0 };
    for t in triangles {
        sample(geometry, t, piece as f32, &mut samples);
    }
    samples
}

fn sample(geometry: &Geometry, t: u32, piece: f32, samples: &mut EmitterSamples) {
    let triangle = &geometry.triangles[t as usize];
    let area = triangle.area();
    let n = ((area / piece).sqrt().ceil() as u32).clamp(1, MAX_SIDE);
    let step = 1.0 / n as f32;
    let [a, b, c] = triangle.corners;
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    samples.spacing = samples.spacing.max(longest * step);
    let identity = combine(mix(u64::from(triangle.instance)), u64::from(triangle.index));
    let sides = if geometry.material(t).double_sided { &[1.0, -1.0][..] } else { &[1.0] };
    let mut number = 0;
    for i in 0..n {
        // Row i of the pattern holds n − i upright pieces and n − i − 1 upside-down ones between them.
        for j in 0..2 * (n - i) - 1 {
            let third = if j % 2 == 0 { 1.0 / 3.0 } else { 2.0 / 3.0 };
            let (u, v) = (((j / 2) as f32 + third) * step, (i as f32 + third) * step);
            let surface = geometry.surface(t, u, v, 0.0);
            let position = triangle.at(u, v);
            // I = πLₑ·A/π.
            let intensity = (surface.emission * surface.coverage).max(Vec3::ZERO) * (area * step * step);
            number += 1;
            for &side in sides {
                let normal = triangle.normal * side;
                let light = Light { position, normal, intensity, area: 0.0 };
                samples.lights.push(Seeded { light, seed: combine(identity, number) });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::build::Builder;

    #[test]
    fn the_samples_carry_the_whole_power_of_the_emitter() {
        let mut b = Builder::new("lamp");
        let glow = b.emitter(Vec3::splat(0.5), Vec3::new(3.0, 2.0, 1.0));
        b.quad("lamp", Vec3::ZERO, Vec3::X * 2.0, Vec3::Z, glow);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let area: f32 = geometry.triangles.iter().map(|t| t.area()).sum();
        for budget in [1, 2, 7, 100, 1000] {
            let samples = emitter_samples(&geometry, budget);
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
        let samples = emitter_samples(&Geometry::new(&scene), 100);
        assert!(samples.lights.is_empty() && samples.spacing == 0.0);
    }
}
