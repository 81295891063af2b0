//! Everything that shines and can be aimed at: emissive surfaces, lamps and suns, in the units of transport.
//!
//!   area light   E = L · F(polygon)          L  radiance [cd/m²], F from Lambert's formula
//!   lamp         E = I cos θ / d²            I  intensity [cd], scaled so that d is in frame units
//!   sun          E = E⊥ cos θ                E⊥ illuminance [lux]
//!
//! Emissive triangles are paired into convex planar quads where both shine alike, which halves the number of lights
//! of a usual level. A textured emitter stays a triangle and carries a small table of mean radiances. Of polygons that
//! lie on each other only what rays meet shines. Surfaces that do not cast, or are unlit, are absent from transport and do
//! not emit either.

mod area;
mod lamp;
mod overlap;

use glam::Vec3;
use luxel_scene::LightKind;

pub use area::{AreaLight, RadianceTable};
pub use lamp::{Lamp, Spot, SunLight};

use crate::{Rgb, geometry::Geometry, sampling::combine};

/// Where a light comes from: what a light group is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Source {
    /// An emissive surface of this instance.
    Instance(u32),
    /// This entry of the scene's list of lights.
    Light(u32),
}

/// All lights of a scene, in scene order: surfaces by instance and triangle, then lamps, then suns.
#[derive(Clone, Debug, Default)]
pub struct Emitters {
    pub areas: Vec<AreaLight>,
    pub lamps: Vec<Lamp>,
    pub suns: Vec<SunLight>,
    /// Frame units per scene unit.
    pub scale: f64,
}

impl Emitters {
    pub fn new(geometry: &Geometry) -> Self {
        let (mut lamps, mut suns) = (Vec::new(), Vec::new());
        let mut names = Vec::new();
        for (i, light) in geometry.scene.lights.iter().enumerate() {
            let identity = distinct(name_hash(&light.name), &mut names);
            let source = Source::Light(i as u32);
            // Light that is not a number, or negative, would spread over the whole scene.
            let intensity = sane(light.intensity);
            if intensity == Rgb::ZERO {
                continue;
            }
            match light.kind {
                LightKind::Sun { .. } => suns.extend(SunLight::new(light, intensity, source, identity)),
                _ => lamps.extend(Lamp::new(light, intensity, &geometry.frame, source, identity)),
            }
        }
        Self {
            areas: overlap::uncovered(geometry, area::area_lights(geometry)),
            lamps,
            suns,
            scale: geometry.frame.scale,
        }
    }

    /// Only the lights of the sources that `keep` accepts. Their contributions add up to those of the whole.
    pub fn only(&self, keep: impl Fn(Source) -> bool) -> Self {
        self.weighted(|source| keep(source).then_some(Rgb::ONE))
    }

    /// The lights of the sources that have a weight, every band of theirs times it.
    pub fn weighted(&self, weight: impl Fn(Source) -> Option<Rgb>) -> Self {
        let lamp = |l: &Lamp| Some(Lamp { intensity: l.intensity * weight(l.source)?, ..l.clone() });
        let sun = |l: &SunLight| Some(SunLight { illuminance: l.illuminance * weight(l.source)?, ..l.clone() });
        Self {
            areas: self.areas.iter().filter_map(|l| Some(l.weighted(weight(l.source)?))).collect(),
            lamps: self.lamps.iter().filter_map(lamp).collect(),
            suns: self.suns.iter().filter_map(sun).collect(),
            scale: self.scale,
        }
    }

    pub fn len(&self) -> usize {
        self.areas.len() + self.lamps.len() + self.suns.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Luminous flux of all emissive surfaces and lamps [lm] (a sun's depends on what it shines on).
    pub fn power(&self) -> glam::DVec3 {
        let areas = self.areas.iter().map(|l| l.power(self.scale));
        areas.chain(self.lamps.iter().map(|l| l.power(self.scale))).sum()
    }
}

/// Brighter than anything, and still far from the end of f32 when lights add up.
pub(crate) const BRIGHTEST: f32 = 1e30;

/// Negative or non-finite bands become dark, absurd ones [`BRIGHTEST`].
pub fn sane(light: Vec3) -> Rgb {
    Rgb::from_array(light.to_array().map(|x| if x.is_finite() { x.clamp(0.0, BRIGHTEST) } else { 0.0 }))
}

/// A hash of a name, eight bytes at a time.
pub(crate) fn name_hash(name: &str) -> u64 {
    name.as_bytes().chunks(8).fold(name.len() as u64, |hash, chunk| {
        let mut word = [0; 8];
        word[..chunk.len()].copy_from_slice(chunk);
        combine(hash, u64::from_le_bytes(word))
    })
}

/// Tells lights of equal name apart by their order among themselves; `seen` is sorted by hash.
fn distinct(hash: u64, seen: &mut Vec<(u64, u64)>) -> u64 {
    match seen.binary_search_by_key(&hash, |s| s.0) {
        Ok(at) => {
            seen[at].1 += 1;
            combine(hash, seen[at].1)
        }
        Err(at) => {
            seen.insert(at, (hash, 0));
            hash
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use luxel_scene::build::Builder;

    #[test]
    fn power_is_pi_l_a_for_surfaces_and_four_pi_i_for_points() {
        let mut b = Builder::new("lights");
        let shiny = b.emitter(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0));
        b.quad("panel", Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 3.0, shiny);
        b.light("bulb", LightKind::Point { position: DVec3::ONE, range: None, radius: 0.0 }, Vec3::splat(10.0));
        let scene = b.build();
        let emitters = Emitters::new(&Geometry::new(&scene));
        assert_eq!((emitters.areas.len(), emitters.lamps.len()), (1, 1));
        let pi = std::f64::consts::PI;
        let expected = DVec3::new(1.0, 2.0, 3.0) * 6.0 * pi + DVec3::splat(40.0 * pi);
        assert!((emitters.power() - expected).abs().max_element() < 1e-4 * expected.max_element());
        let panel = emitters.only(|s| s == Source::Instance(0));
        assert_eq!((panel.areas.len(), panel.lamps.len()), (1, 0));
        let red = emitters.weighted(|s| (s != Source::Instance(0)).then_some(Vec3::new(0.5, 0.0, 0.0)));
        assert!((red.power() - DVec3::new(20.0 * pi, 0.0, 0.0)).abs().max_element() < 1e-4);
    }

    #[test]
    fn lights_that_share_a_name_differ_and_dark_or_broken_ones_are_left_out() {
        let mut b = Builder::new("names");
        let kind = LightKind::Point { position: DVec3::ZERO, range: None, radius: 0.0 };
        b.light("lamp", kind, Vec3::ONE);
        b.light("lamp", kind, Vec3::ONE);
        b.light("dark", kind, Vec3::ZERO);
        b.light("broken", kind, Vec3::new(f32::NAN, -1.0, f32::INFINITY));
        let scene = b.build();
        let emitters = Emitters::new(&Geometry::new(&scene));
        assert_eq!(emitters.lamps.len(), 2);
        assert_ne!(emitters.lamps[0].identity, emitters.lamps[1].identity);
        assert_eq!(emitters.lamps[0].identity, name_hash("lamp"));
    }
}
