//! A rough account of what shines: enough to see that an exporter's units went wrong, or that nothing shines at all.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3, Vec4};

use super::notes::Notes;
use crate::{AlphaUse, LightKind, Scene};

/// Emissive and punctual light that differ by more than this factor are worth a notice.
const SUSPICIOUS: f64 = 1e4;

/// Largest intensity [cd], illuminance [lux] and radiance [cd/m²] that is read. The sun's surface has 1.6e9; beyond this
/// sums over many bounces and squared distances leave the range of 32 bit.
pub const BRIGHTEST: f32 = 1e20;

/// Flux of punctual and of emissive light, in the scene's photometric units (lm).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Power {
    pub punctual: f64,
    pub emissive: f64,
}

/// Estimates the flux: 4πI of a point, its share of the sphere for a spot, illuminance times the scene's cross section
/// for a sun, πLA for an emissive surface with its mean texture.
pub fn estimate(scene: &Scene) -> Power {
    let has_sun = scene.lights.iter().any(|l| matches!(l.kind, LightKind::Sun { .. }));
    let bounds = if has_sun { scene.bounds() } else { None };
    let radius = bounds.map_or(0.0, |(lo, hi)| 0.5 * (hi - lo).length());
    let luminance = |c: Vec3| f64::from(c.dot(Vec3::new(0.2126, 0.7152, 0.0722)));
    let punctual = scene.lights.iter().map(|light| {
        luminance(light.intensity)
            * match light.kind {
                LightKind::Point { .. } => 4.0 * PI,
                LightKind::Spot { outer, .. } => TAU * (1.0 - libm::cos(outer)),
                LightKind::Sun { .. } => PI * radius * radius,
            }
    });
    let emissive = scene.instances.iter().map(|instance| {
        let Some(mesh) = scene.meshes.get(instance.mesh) else { return 0.0 };
        let Some(material) = scene.materials.get(mesh.material).filter(|m| m.emits()) else { return 0.0 };
        let texture = material.emissive_texture.as_ref();
        let tint = texture.map_or(Vec4::ONE, |t| t.mean(&scene.textures, AlphaUse::Ignored)).truncate();
        let area: f64 = mesh
            .triangles
            .iter()
            .map(|t| area(t.map(|i| instance.transform.transform_point3(mesh.positions[i as usize].as_dvec3()))))
            .sum();
        PI * area * luminance(material.emission * tint)
    });
    Power { punctual: punctual.sum(), emissive: emissive.sum() }
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

/// Says so when there is no light, or when the two kinds cannot belong together.
pub fn note(scene: &Scene, notes: &mut Notes) {
    let power = estimate(scene);
    let (low, high) = (power.punctual.min(power.emissive), power.punctual.max(power.emissive));
    if high <= 0.0 {
        notes.add("no-light", "nothing in the scene shines; give it a sky with --sky 1,1,1, or lamps");
    } else if low > 0.0 && high > SUSPICIOUS * low {
        notes.add(
            "light-units",
            format!(
                "lamps emit about {:.2e} lm and emissive surfaces {:.2e} lm; exporters differ in units, see \
                 --light-scale and --emissive-scale",
                power.punctual, power.emissive
            ),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::Builder;

    #[test]
    fn a_panel_and_a_lamp() {
        let mut builder = Builder::new("room");
        let panel = builder.emitter(Vec3::ZERO, Vec3::splat(10.0));
        builder.quad("panel", Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 3.0, panel);
        let at = LightKind::Point { position: DVec3::ONE, range: None, radius: 0.0 };
        builder.light("lamp", at, Vec3::splat(5.0));
        let scene = builder.build();
        let power = estimate(&scene);
        assert!((power.emissive - PI * 60.0).abs() < 1e-4 && (power.punctual - 20.0 * PI).abs() < 1e-4, "{power:?}");
        let mut notes = Notes::default();
        note(&scene, &mut notes);
        assert!(notes.finish().is_empty());
        let mut strong = scene.clone();
        strong.lights[0].intensity *= 1e5;
        let mut notes = Notes::default();
        note(&strong, &mut notes);
        note(&Scene::default(), &mut notes);
        assert_eq!(notes.finish().iter().map(|n| n.code).collect::<Vec<_>>(), ["light-units", "no-light"]);
    }
}
