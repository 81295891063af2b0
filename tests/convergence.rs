//! Convergence is shown, not assumed: as voxels, directions, cuts, rays and photons are refined together, the error falls
//! to what the reference itself does not know, below one per cent of the mean light, and so does all that the bias may be.

mod support;

use luxel::bake::lab::{self, Lab};
use luxel::settings::{LightGroups, Preset, Settings, value::Count, value::Texels};
use luxel::study::measure::Measure;
use luxel::study::series::{bake, together};
use luxel::study::truth::{self, Exactness};
use luxel::study::{Score, ladder};
use luxel_scene::{Scene, Silent};

/// The errors of a scene on some rungs of the ladder. With photons, direct light at surfels comes from as many as the
/// rung asks for, as in the paper, instead of closed forms.
fn errors(scene: &Scene, rungs: &[u32], how: Exactness, with_photons: bool) -> Vec<Score> {
    let base = Settings { size: Texels(96), light_groups: LightGroups::One, ..Settings::preset(Preset::Medium) };
    lab::on_threads(&base, || {
        Lab::with(scene, &base, None, &Silent, |lab| {
            let (atlas, _) = lab::lay_out(scene, &base, None, &Silent)?;
            let texels = truth::texels(lab, &atlas, how.texels);
            let truth = truth::truth(lab, texels, (&how, "test"), None, &Silent)?;
            let measure = Measure::new(lab, &atlas, &truth, None, "");
            let mut scores = Vec::new();
            for &rung in rungs {
                let mut settings = ladder::rung(&base, rung);
                if with_photons {
                    settings.photons = Count(1 << (14 + 2 * rung).min(23));
                }
                let attempt = bake(settings, rung.to_string(), ladder::work(rung));
                let point = measure.point(&together(&base, &[]), &attempt, &Silent)?;
                let s = point.score;
                println!(
                    "{}, rung {rung}{}: {} surfels, RMSE {:.2} ({:.2} to {:.2}) %, bias {:+.2} ({:+.2} to {:+.2}) %, reference noise {:.2} % \
                     of {} paths",
                    scene.name,
                    if with_photons { " with photons" } else { "" },
                    point.surfels,
                    100.0 * s.rmse,
                    100.0 * s.rmse_low,
                    100.0 * s.rmse_high,
                    100.0 * s.bias,
                    100.0 * s.bias_low,
                    100.0 * s.bias_high,
                    100.0 * s.noise,
                    truth.paths
                );
                scores.push(s);
            }
            Ok(scores)
        })
    })
    .unwrap_or_else(|e| panic!("{}: {e}", scene.name))
}

/// No rung is surely worse than the one before it, and the median error, in which the reference's noise is, falls with each;
/// from the first to the last one the RMSE falls to less than half; the last one is below `most`, and so is all that its bias
/// may be. (A single texel of the two rooms' lamp, just below the ceiling that it lights, has as much of the squared error as
/// all others, so that intervals of the RMSE are too wide to part first and last.)
fn assert_falls(scores: &[Score], most: f64) {
    assert!(scores.windows(2).all(|w| w[1].rmse_low < w[0].rmse_high), "{scores:?}");
    let [first, .., last] = scores else { panic!("there are rungs") };
    assert!(scores.windows(2).all(|w| w[1].median < w[0].median) && last.rmse < 0.5 * first.rmse, "{scores:?}");
    assert!(last.rmse < most && last.bias_low > -most && last.bias_high < most, "{last:?}");
}

const QUICK: Exactness = Exactness { texels: 400, noise: 0.006, paths: 65_536 };
const EXACT: Exactness = Exactness { texels: 400, noise: 0.003, paths: 262_144 };

#[test]
fn the_cornell_box_converges() {
    assert_falls(&errors(&luxel_assets::cornell(), &[0, 2, 4], QUICK, false), 0.01);
}

#[test]
fn two_rooms_converge() {
    assert_falls(&errors(&luxel_assets::two_rooms(), &[0, 2, 4], QUICK, false), 0.01);
}

#[test]
fn photons_converge_too() {
    assert_falls(&errors(&luxel_assets::cornell(), &[0, 2, 4], QUICK, true), 0.01);
}

#[test]
fn the_cornell_box_and_two_rooms_converge_below_half_a_per_cent() {
    if !support::is_heavy("convergence to the noise of the reference") {
        return;
    }
    for scene in [luxel_assets::cornell(), luxel_assets::two_rooms()] {
        for with_photons in [false, true] {
            assert_falls(&errors(&scene, &[0, 2, 4, 6], EXACT, with_photons), 0.005);
        }
    }
}
