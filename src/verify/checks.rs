//! What must hold of a lightmap besides its error: each a value, a limit, and words.

use luxel_atlas::overlapping;
use luxel_export::report::{Check, EnergyStage, Place};
use luxel_scene::{Progress, Scene};
use luxel_transport::Rgb;

use super::sample::{Baked, Drawn, walk};
use super::score::y;
use super::{FIRST, Found, MOST, Trial, Verify};
use crate::Error;
use crate::bake::energy;
pub use crate::bake::energy::LIMIT;
use crate::text::plain;

/// Share of the charts' area that may lie on another chart: what exporters round.
const OVERLAP: f64 = 1e-3;

/// Share of the shown texels' area that may lie inside geometry. Floors under furniture are there: up to 6 % of the
/// scenes that luxel ships. What stands in a room whose walls are turned inside out is more, and so is a level that is
/// filled with surfaces that nobody sees.
const BURIED: f64 = 0.1;

/// Light below this share of the mean is darkness, and above this one is seen in it.
const DARK: f64 = 1e-3;
const SEEN: f64 = 2e-3;

/// Texels that are looked at for leaks, for each that is compared.
const PROBES: u64 = 8;

/// The brightest of them that a few paths find dark are traced by many.
const SUSPECTS: usize = 64;

/// Seed of their draw.
const SEED: u64 = 0x1ea4;

/// Overlap of charts in the finished atlas.
pub fn uv_overlap(scene: &Scene, baked: &Baked, progress: &dyn Progress) -> Result<Check, Error> {
    let overlap = overlapping(baked.atlas, progress)?;
    let share = if overlap.area > 0.0 { overlap.doubled / overlap.area } else { 0.0 };
    let passed = share <= OVERLAP && overlap.shared_texels == 0 && !overlap.entangled;
    let mut message = format!(
        "{:.4} % of the charts' area lies on another triangle, {} texels belong to two charts",
        100.0 * share,
        overlap.shared_texels
    );
    if overlap.entangled {
        message += "; there are too many crossing triangles to look at all of them";
    }
    if let Some([a, b]) = overlap.worst.filter(|_| !passed) {
        let name = |instance: u32| plain(&scene.instances[instance as usize].name).into_owned();
        message += &format!(
            "; worst: triangle {} of {} and {} of {}; give these meshes another TEXCOORD_1, or none",
            a.1,
            name(a.0),
            b.1,
            name(b.0)
        );
    }
    Ok(Check { name: "uv-overlap".into(), passed, value: share, limit: OVERLAP, message })
}

/// Texels that are shown although their point is inside geometry and nothing free is near.
pub fn buried(baked: &Baked) -> Check {
    let (mut area, mut hidden) = (0.0, 0.0);
    for texel in (0..baked.atlas.texels.len()).filter(|t| baked.is_shown(*t)) {
        area += baked.area(texel);
        hidden += if baked.is_buried(texel) { baked.area(texel) } else { 0.0 };
    }
    let share = if area > 0.0 { hidden / area } else { 0.0 };
    let passed = share <= BURIED;
    let mut message = format!("{:.2} % of the area of texels lies inside or under other geometry", 100.0 * share);
    if !passed {
        message += "; are faces turned inside out? Leave surfaces that nobody sees out with luxel_receive = false";
    }
    Check { name: "buried".into(), passed, value: share, limit: BURIED, message }
}

/// The balance of the energy ledger; none where nothing was propagated.
pub fn energy(stages: &[EnergyStage]) -> Option<Check> {
    let (stage, value) = energy::worst(stages)?;
    let passed = value <= LIMIT;
    let mut message = format!(
        "{:.2} % of the light is missing or too much after the stage {}, beyond twice the standard error",
        100.0 * value,
        stage.name
    );
    if !passed {
        message += &format!("; {}", energy::remedy(&stage.name));
    }
    Some(Check { name: "energy".into(), passed, value, limit: LIMIT, message })
}

/// Texels that hold no light: negative or not finite. Making a lightmap of such texels fails already, so this fails only
/// where that does not hold.
pub fn values(baked: &Baked) -> Check {
    finite(baked.lightmaps.iter().flat_map(|map| map.irradiance()))
}

fn finite<'e>(all: impl Iterator<Item = &'e Rgb>) -> Check {
    let wrong = all.filter(|e| !(e.is_finite() && e.min_element() >= 0.0)).count();
    let message = format!("{wrong} texels are negative or not finite");
    Check { name: "values".into(), passed: wrong == 0, value: wrong as f64, limit: 0.0, message }
}

/// Texels in darkness that are lit.
pub struct Leaks {
    pub probed: u64,
    /// Texels that the reference knows to be dark.
    dark: u64,
    places: Vec<Place>,
    mean: f64,
}

/// Looks for texels that a closed wall separates from all light and that hold light all the same: among those that were
/// compared, and among more of them by a few paths first, by all of them where these find no light. `mean` is the mean
/// irradiance [lux].
pub(crate) fn leaks(trial: &Trial, ask: &Verify, found: &Found, mean: f64) -> Result<Leaks, Error> {
    let more = (PROBES * u64::from(ask.texels)).min(trial.population.len() as u64);
    let texels = trial.population.draw(more as usize, SEED);
    let bright = |texel: &usize| y(trial.baked.value(*texel)) > SEEN * mean;
    // What is dark in the lightmap leaks nothing.
    let texels: Vec<(usize, f64)> = texels.into_iter().filter(|(texel, _)| bright(texel)).collect();
    let mut probes = Drawn::all(trial.baked.atlas, trial.rays, texels, trial.holds);
    walk(&trial.reference, &mut probes, (FIRST, SEED), trial.progress)?;
    probes.retain(|d| y(d.sample(&trial.baked, trial.holds).expected) <= DARK * mean);
    let found_light = |d: &Drawn| y(trial.baked.value(d.texel));
    probes.sort_by(|a, b| found_light(b).total_cmp(&found_light(a)).then(a.texel.cmp(&b.texel)));
    probes.truncate(SUSPECTS);
    walk(&trial.reference, &mut probes, (MOST / 2, SEED + 1), trial.progress)?;
    let mut leaks = Leaks { probed: more, dark: 0, places: Vec::new(), mean };
    let mut seen = std::collections::BTreeSet::new();
    for drawn in found.drawn.iter().chain(&probes) {
        let sample = drawn.sample(&trial.baked, trial.holds);
        let most = y(sample.expected) + 2.0 * f64::from(sample.error);
        if most <= DARK * mean && seen.insert(drawn.texel) {
            leaks.dark += 1;
            if bright(&drawn.texel) {
                leaks.places.push(trial.baked.place(trial.rays.geometry.scene, drawn.texel, sample.expected));
            }
        }
    }
    leaks.places.sort_by(|a, b| b.found.iter().sum::<f64>().total_cmp(&a.found.iter().sum()));
    Ok(leaks)
}

impl Leaks {
    pub fn check(&self) -> Check {
        let mut message = format!(
            "{} of {} texels that no light reaches hold more than {:.1} % of the mean irradiance",
            self.places.len(),
            self.dark,
            100.0 * SEEN
        );
        if let Some(worst) = self.places.first() {
            message += &format!(
                "; worst: {} at {} holds {:.2} % of it; smaller voxels (--voxels) or thicker walls",
                plain(&worst.object),
                super::gate::point(worst.position),
                100.0 * worst.found.iter().sum::<f64>() / 3.0 / self.mean.max(f64::MIN_POSITIVE)
            );
        }
        let value = self.places.len() as f64;
        Check { name: "leaks".into(), passed: self.places.is_empty(), value, limit: 0.0, message }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texels_that_are_no_light_are_counted() {
        let wrong = [Rgb::new(0.0, f32::NAN, 0.0), Rgb::new(1.0, -1e-6, 1.0), Rgb::new(1.0, 1.0, f32::INFINITY)];
        let light = [Rgb::ZERO, Rgb::MAX];
        let bad = finite(wrong.iter().chain(&light));
        assert!(!bad.passed && bad.value == 3.0 && bad.message.starts_with("3 texels"), "{bad:?}");
        let good = finite(light.iter());
        assert!(good.passed && good.value == 0.0, "{good:?}");
    }

    #[test]
    fn books_that_are_out_fail_the_check_and_none_have_none() {
        assert_eq!(energy(&[]), None);
        let stage = |absorbed: f64| EnergyStage {
            name: "tail".into(),
            emitted: [1.0; 3],
            absorbed: [absorbed; 3],
            ..EnergyStage::default()
        };
        let good = energy(&[stage(0.9901).closed()]).unwrap();
        assert!(good.passed && (good.value - 0.0099).abs() < 1e-9, "{good:?}");
        let bad = energy(&[stage(0.9899).closed()]).unwrap();
        assert!(!bad.passed && (bad.value - 0.0101).abs() < 1e-9, "{bad:?}");
        assert!(bad.message.contains("tail") && bad.message.contains("--voxels"), "{bad:?}");
        // Only what is beyond twice the standard error is sure.
        let noisy = EnergyStage { error: [0.005; 3], ..stage(0.985) }.closed();
        let unsure = energy(&[noisy]).unwrap();
        assert!(unsure.passed && (unsure.value - 0.005).abs() < 1e-9, "{unsure:?}");
    }
}
