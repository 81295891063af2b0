//! Which setting limits the error of a bake: the one whose own part of it is the largest.
//!
//! Each series about the settings says by its law ([`super::fit`]) what error is left however far its setting is refined;
//! what is not left is the setting's own. Twice the work there changes the error by what the law says.

use serde::Serialize;

use super::Point;
use super::fit::Fit;
use super::series::{Series, abscissa};
use crate::settings::{Field, Settings};

/// What a setting has to do with the error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    pub setting: String,
    /// What it is, in words.
    pub about: String,
    pub value: String,
    /// The law of its series; none where the error does not follow it.
    pub fit: Option<Fit>,
    /// By the law, over the mean irradiance: the error with this setting, and with twice the work in it.
    pub now: f64,
    pub doubled: f64,
    /// The setting's own share of the mean square.
    pub share: f64,
}

impl Advice {
    /// In one sentence.
    pub fn sentence(&self) -> String {
        let [now, doubled] = [self.now, self.doubled].map(|e| 100.0 * e);
        let (what, step) = match self.setting.as_str() {
            "voxels" => ("voxel size", "halving it"),
            "cut_error" | "node_spacing" => (self.about.as_str(), "halving it"),
            _ => (self.about.as_str(), "doubling it"),
        };
        format!(
            "{what} dominates ({:.0} % of the squared error): {step} would bring the RMSE from {now:.2} % to {doubled:.2} %",
            100.0 * self.share
        )
    }
}

/// What every swept setting has to do with the error at `base`, the one that limits it most first.
pub fn advise(base: &Settings, series: &[Series], points: &[Point]) -> Vec<Advice> {
    let mut list: Vec<Advice> = series.iter().filter_map(|series| of(base, series, points)).collect();
    let gain = |a: &Advice| a.now - a.doubled;
    list.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
    list
}

/// The sentence about the setting that limits the error, or that none does.
pub fn verdict(list: &[Advice]) -> String {
    match list.first().filter(|a| a.share > 0.05) {
        Some(first) => first.sentence(),
        None => "no setting alone limits the error: twice the work in any of them changes next to nothing".into(),
    }
}

fn of(base: &Settings, series: &Series, points: &[Point]) -> Option<Advice> {
    let value = (Field::find(&series.name)?.get)(base);
    let own: Vec<&Point> = points.iter().filter(|p| p.series == series.name).collect();
    let x = abscissa(&series.name, &value);
    // A value that is no number on the axis, as exact light instead of photons, has no place on the law; and what noise
    // alone may have made is none.
    let fit = Fit::of(&own.iter().map(|p| (p.x, p.score.rmse)).collect::<Vec<_>>()).filter(|_| x > 0.0 && falls(&own));
    let at = |x: f64| fit.map_or(0.0, |fit| fit.error(x));
    let share = fit.map_or(0.0, |fit| (fit.own(x) / fit.error(x)).powi(2));
    Some(Advice {
        setting: series.name.clone(),
        about: series.about.clone(),
        value,
        fit,
        now: at(x),
        doubled: at(2.0 * x),
        share: if share.is_finite() { share } else { 0.0 },
    })
}

/// The error of the finest value is surely below that of the coarsest, by their intervals.
fn falls(points: &[&Point]) -> bool {
    let on_axis = || points.iter().filter(|p| p.x > 0.0);
    let coarsest = on_axis().min_by(|a, b| a.x.total_cmp(&b.x));
    let finest = on_axis().max_by(|a, b| a.x.total_cmp(&b.x));
    coarsest.zip(finest).is_some_and(|(coarsest, finest)| finest.score.rmse_high < coarsest.score.rmse_low)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::Score;
    use crate::study::series::sweeps;

    fn points(name: &str, law: Fit) -> Vec<Point> {
        let series = sweeps(&Settings::default(), false);
        let series = series.iter().find(|s| s.name == name).unwrap();
        let point = |x: f64| Point {
            series: name.into(),
            x,
            score: Score {
                rmse: law.error(x),
                rmse_low: 0.9 * law.error(x),
                rmse_high: 1.1 * law.error(x),
                ..Score::default()
            },
            ..Point::default()
        };
        series.attempts.iter().map(|a| point(a.x)).collect()
    }

    #[test]
    fn a_value_beside_the_axis_has_no_law() {
        let base = Settings::default();
        let law = Fit { order: 0.5, floor: 0.01, scale: 3.0, misfit: 0.0 };
        let list = advise(&base, &sweeps(&base, false), &points("photons", law));
        let photons = list.iter().find(|a| a.setting == "photons").unwrap();
        assert_eq!((photons.fit, photons.now, photons.doubled, photons.share), (None, 0.0, 0.0, 0.0));
    }

    #[test]
    fn the_setting_with_the_largest_part_is_named() {
        let base = Settings::default();
        let steep = Fit { order: 1.0, floor: 0.002, scale: 3.0, misfit: 0.0 };
        let flat = Fit { order: 1.0, floor: 0.009, scale: 0.2, misfit: 0.0 };
        let all = [points("voxels", steep), points("directions", flat)].concat();
        let list = advise(&base, &sweeps(&base, false), &all);
        assert_eq!(list[0].setting, "voxels");
        let truth = (steep.own(316.2).powi(2)) / steep.error(316.2).powi(2);
        assert!((list[0].share - truth).abs() < 0.05, "{:?}", list[0]);
        assert!(verdict(&list).starts_with("voxel size dominates"), "{}", verdict(&list));
        assert!(verdict(&[]).starts_with("no setting"));
    }
}
