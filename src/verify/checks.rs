//! What must hold of a lightmap besides its error: each a value, a limit, and words.

use luxel_atlas::{Overlapping, overlapping};
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

/// Texels that are looked at for leaks, for each that is compared, and at most.
const PROBES: u64 = 8;
const MOST_PROBES: u64 = 100_000;

/// The brightest of all that a few paths find dark are traced by many, of which there are so many at most.
const SUSPECTS: usize = 64;
const LONGEST: u32 = 8 * MOST;

/// Where n trials had no success, its chance is at most 3/n with 95 % confidence: the rule of three (Hanley &
/// Lippman-Hand 1983).
const RULE: f64 = 3.0;

/// Seed of their draw.
const SEED: u64 = 0x1ea4;

/// Overlap of charts in the finished atlas.
pub fn uv_overlap(scene: &Scene, baked: &Baked, progress: &dyn Progress) -> Result<Check, Error> {
    Ok(overlap(scene, &overlapping(baked.atlas, progress)?))
}

fn overlap(scene: &Scene, overlap: &Overlapping) -> Check {
    let share = if overlap.area > 0.0 { overlap.doubled / overlap.area } else { 0.0 };
    let passed = share <= OVERLAP && !overlap.entangled;
    let mut message = format!("{:.4} % of the charts' area lies on another triangle", 100.0 * share);
    if overlap.entangled {
        message += "; too many triangles cross each other to look at all of them: split these meshes, or give them another \
                    TEXCOORD_1, or none";
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
    Check { name: "uv-overlap".into(), passed, value: share, limit: OVERLAP, message }
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
    let doubt = 2.0 * energy::vaguest(stages).map_or(0.0, |stage| stage.share_error);
    let passed = value <= LIMIT && doubt <= LIMIT;
    let mut message = format!(
        "{:.2} % of the light is missing or too much after the stage {}, beyond twice the standard error of {:.2} %",
        100.0 * value,
        stage.name,
        100.0 * stage.share_error
    );
    if value > LIMIT {
        message += &format!("; {}", energy::remedy(&stage.name));
    } else if !passed {
        message += &format!(
            "; too few photons meet the scene to tell within ±{:.2} %: bake it in parts that are less long or wide",
            100.0 * doubt
        );
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
    places: Vec<Place>,
    mean: f64,
}

/// Looks for texels that a closed wall separates from all light and that hold light all the same, among those that were
/// compared and more of them. Where a few paths find next to no light, more are walked, until they find some or it is sure
/// that there is none: a path that comes to light brings about as much as where most of the light is, so what n paths may
/// have missed is 3/n of that. `mean` is the mean irradiance [lux].
pub(crate) fn leaks(trial: &Trial, ask: &Verify, found: &Found, mean: f64) -> Result<Leaks, Error> {
    let more = probes(ask.texels, trial.population.len() as u64);
    let texels = trial.population.draw(more as usize, SEED);
    let bright = |texel: &usize| y(trial.baked.value(*texel)) > SEEN * mean;
    // What is dark in the lightmap leaks nothing.
    let texels: Vec<(usize, f64)> = texels.into_iter().filter(|(texel, _)| bright(texel)).collect();
    let mut probes = Drawn::all(trial.baked.atlas, trial.rays, texels, trial.holds);
    walk(&trial.reference, &mut probes, (FIRST, SEED), trial.progress)?;
    let typical = typical(found.drawn.iter().map(|d| (d.weight, y(d.sample(&trial.baked, trial.holds).expected))));
    let looks_dark = |d: &Drawn| y(d.sample(&trial.baked, trial.holds).expected) <= DARK * mean;
    let is_dark = |d: &Drawn, typical: f64| {
        let sample = d.sample(&trial.baked, trial.holds);
        let missed = RULE / d.paths().max(1.0) * typical;
        y(sample.expected) + 2.0 * f64::from(sample.error) + missed <= DARK * mean
    };
    let compared = found.drawn.iter().filter(|d| bright(&d.texel));
    let mut suspects: Vec<Drawn> = compared.chain(&probes).filter(|d| looks_dark(d)).cloned().collect();
    drop(probes);
    let found_light = |d: &Drawn| y(trial.baked.value(d.texel));
    suspects.sort_by(|a, b| found_light(b).total_cmp(&found_light(a)).then(a.texel.cmp(&b.texel)));
    suspects.dedup_by_key(|d| d.texel);
    suspects.truncate(SUSPECTS);
    let mut leaking = Vec::new();
    let mut paths = MOST / 2;
    loop {
        walk(&trial.reference, &mut suspects, (paths, SEED + u64::from(paths)), trial.progress)?;
        suspects.retain(&looks_dark);
        leaking.extend(suspects.extract_if(.., |d| is_dark(d, typical)));
        if suspects.is_empty() || paths >= LONGEST {
            break;
        }
        paths *= 2;
    }
    // In light that is all in a few spots nothing would ever be sure; what so many paths do not see is not there.
    leaking.extend(suspects.into_iter().filter(|d| is_dark(d, 0.0)));
    let place = |d: &Drawn| {
        let expected = d.sample(&trial.baked, trial.holds).expected;
        trial.baked.place(trial.rays.geometry.scene, d.texel, expected)
    };
    let mut leaks = Leaks { probed: more, places: leaking.iter().map(place).collect(), mean };
    leaks.places.sort_by(|a, b| b.found.iter().sum::<f64>().total_cmp(&a.found.iter().sum()));
    Ok(leaks)
}

/// How many texels are looked at for leaks alone.
fn probes(compared: u32, all: u64) -> u64 {
    (PROBES * u64::from(compared)).min(MOST_PROBES).min(all)
}

/// The mean of light by the light itself, of samples with weights: how bright it is where most of the light is.
fn typical(samples: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (sum, square) = samples.fold((0.0, 0.0), |(sum, square), (w, e)| (sum + w * e, square + w * e * e));
    if sum > 0.0 { square / sum } else { 0.0 }
}

impl Leaks {
    pub fn check(&self) -> Check {
        let mut message = format!(
            "{} texels that no light reaches hold more than {:.1} % of the mean irradiance; looked at are those compared \
             and {} more",
            self.places.len(),
            100.0 * SEEN,
            self.probed
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
    fn probes_follow_what_is_compared_within_bounds() {
        assert_eq!([probes(400, 9000), probes(400, 1000), probes(1_000_000, 9_000_000)], [3200, 1000, 100_000]);
        // Light in one room of ten.
        assert_eq!(typical((0..10).map(|i| (2.0, if i == 0 { 5.0 } else { 0.0 }))), 5.0);
        assert_eq!(typical(std::iter::empty()), 0.0);
    }

    #[test]
    fn triangles_that_are_too_many_to_look_at_fail_with_what_to_do() {
        let good = Overlapping { area: 100.0, doubled: 0.01, ..Overlapping::default() };
        let check = |of: &Overlapping| overlap(&Scene::default(), of);
        assert!(check(&good).passed && !check(&good).message.contains("split"), "{:?}", check(&good));
        let bad = check(&Overlapping { entangled: true, ..good });
        assert!(!bad.passed && bad.message.contains("split these meshes"), "{bad:?}");
    }

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
        let noisy = |error: f64| EnergyStage { error: [error; 3], ..stage(0.985) }.closed();
        let unsure = energy(&[noisy(0.004)]).unwrap();
        assert!(unsure.passed && (unsure.value - 0.007).abs() < 1e-9, "{unsure:?}");
        assert!(unsure.message.contains("standard error of 0.40 %"), "{unsure:?}");
        // What hides in noise is not known to balance.
        let hidden = energy(&[noisy(0.08)]).unwrap();
        assert!(!hidden.passed && hidden.value == 0.0 && hidden.message.contains("±16.00 %"), "{hidden:?}");
    }
}
