//! Settings that grow better together: what a budget chooses from, and what shows that the method converges.
//!
//! Every rung has 1.8 times the surfels of the one below, one and a half times the directions, two thirds of the cut error
//! and about 1.4 times the rays, so that no part of the error is left standing while another falls: an edge of a voxel is
//! the root of their number, and noise the root of the number of samples. Where the rungs begin is what the sweeps of
//! `assets/reports` show: cuts and nodes limit the error of a few thousand surfels already, so these start fine.

use crate::settings::value::{Count, Samples, Spacing, Tolerance};
use crate::settings::{FIELDS, GatherMode, Settings, Voxels};

/// Rungs of the ladder.
pub const RUNGS: u32 = 8;

/// Surfels of the lowest rung.
const SURFELS: u32 = 6250;

/// Surfels of a rung over those of the one below.
const MORE: f64 = 1.8;

/// Puts the settings that trade time for exactness on a rung; everything else stays. The preset `medium` is between the
/// rungs 3 and 4, with more surfels.
pub fn rung(base: &Settings, rung: u32) -> Settings {
    let grown = |least: f64, factor: f64| least * libm::pow(factor, f64::from(rung));
    let samples = |least: f64, factor: f64| Samples((grown(least, factor).round() as u32).clamp(1, 65_536));
    let spacing = [8, 4, 4, 2, 2, 2, 1, 1][rung.min(RUNGS - 1) as usize];
    Settings {
        voxels: Voxels::Budget(grown(f64::from(SURFELS), MORE) as u32),
        directions: samples(96.0, 1.5),
        tolerance: Tolerance(grown(3e-3, 0.5) as f32),
        refresh: Count(grown(16.0, 1.414) as u32),
        gather: GatherMode::Lightcuts,
        cut_error: Tolerance(grown(0.05, 0.66) as f32),
        cut_limit: samples(600.0, 1.3),
        near_rays: samples(6.0, 1.3),
        node_spacing: Spacing(spacing),
        // Points on lights come by the 64.
        shadow_samples: Samples(64 << (rung.saturating_sub(3) / 2)),
        sky_rays: samples(256.0, 1.6),
        ..base.clone()
    }
}

/// The same where somebody has chosen the values of the settings `fixed`, which stay as they are.
pub fn rung_keeping(base: &Settings, number: u32, fixed: &[&str]) -> Settings {
    let mut settings = rung(base, number);
    for field in FIELDS.iter().filter(|field| fixed.contains(&field.name)) {
        let is_kept = field.assign(&mut settings, &(field.get)(base));
        debug_assert!(is_kept, "{}", field.name);
    }
    settings
}

/// What a rung stands for on an axis: surfels along a side, by which all the others go.
pub fn work(rung: u32) -> f64 {
    (f64::from(SURFELS) * libm::pow(MORE, f64::from(rung))).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Preset;

    #[test]
    fn every_rung_asks_for_more_than_the_one_below() {
        let base = Settings::preset(Preset::Draft);
        let rungs: Vec<Settings> = (0..RUNGS).map(|r| rung(&base, r)).collect();
        for pair in rungs.windows(2) {
            let [a, b] = [&pair[0], &pair[1]];
            assert!(b.directions.0 > a.directions.0 && b.cut_error.0 < a.cut_error.0);
            assert!(b.near_rays.0 > a.near_rays.0 && b.node_spacing.0 <= a.node_spacing.0);
            assert!(b.shadow_samples.0 >= a.shadow_samples.0 && b.sky_rays.0 > a.sky_rays.0);
        }
        // What somebody chose stays.
        let chosen = Settings { voxels: Voxels::Side(77), ..base.clone() };
        let kept = rung_keeping(&chosen, 3, &["voxels"]);
        assert_eq!(kept, Settings { voxels: Voxels::Side(77), ..rung(&base, 3) });
        // Values are written and read back on their way through a settings layer.
        for settings in &rungs {
            let mut copy = Settings::default();
            assert!(FIELDS.iter().all(|field| field.assign(&mut copy, &(field.get)(settings))));
            assert_eq!(copy, *settings);
        }
    }
}
