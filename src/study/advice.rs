//! Which setting limits the error of a bake: the one whose own part of it is the largest.
//!
//! Each series about the settings says by its law ([`super::fit`]) what error is left however far its setting is refined;
//! what is not left is the setting's own. Twice the work there changes the error by what the law says.

use serde::Serialize;

use super::Point;
use super::fit::Fit;
use super::series::{Axis, BASE, Series, abscissa, axis, is_doubled, names};
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
    /// By the law, over the mean irradiance: the error with this setting, and with its number on the axis doubled; none
    /// where it takes no such value.
    pub now: f64,
    pub doubled: Option<f64>,
    /// The setting's own share of the mean square.
    pub share: f64,
}

impl Advice {
    /// In one sentence.
    fn sentence(&self, doubled: f64) -> String {
        let [now, doubled] = [self.now, doubled].map(|e| 100.0 * e);
        let what = if self.setting == "voxels" { "voxel size" } else { self.about.as_str() };
        let step = if axis(&self.setting) == Axis::Same { "doubling it" } else { "halving it" };
        let part =
            if self.share > 0.5 { "dominates" } else { "has the largest part of what one setting can take away" };
        format!(
            "{what} {part} ({:.0} % of the squared error): {step} would bring the RMSE from {now:.2} % to {doubled:.2} %",
            100.0 * self.share
        )
    }
}

/// What every swept setting has to do with the error at `base`, the one that limits it most first.
pub fn advise(base: &Settings, series: &[Series], points: &[Point]) -> Vec<Advice> {
    let mut list: Vec<Advice> = series.iter().filter_map(|series| of(base, series, points)).collect();
    let gain = |a: &Advice| a.doubled.map_or(0.0, |doubled| a.now - doubled);
    list.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
    list
}

/// The sentence about the setting that limits the error, or that none does.
pub fn verdict(list: &[Advice]) -> String {
    if list.is_empty() {
        return "no setting was swept, so none is known to limit the error".into();
    }
    let first = list.first().filter(|a| a.share > 0.05).and_then(|a| Some((a, a.doubled?)));
    let sentence = match first {
        Some((first, doubled)) => first.sentence(doubled),
        None => "no setting alone limits the error: twice the work in any of them changes next to nothing".into(),
    };
    let swept: Vec<&str> = list.iter().map(|a| a.setting.as_str()).collect();
    if swept.len() + 1 < names().count() {
        return format!("{sentence} (swept: {} alone)", swept.join(", "));
    }
    sentence
}

fn of(base: &Settings, series: &Series, points: &[Point]) -> Option<Advice> {
    let field = Field::find(&series.name)?;
    let value = (field.get)(base);
    let mut own: Vec<&Point> = points.iter().filter(|p| p.series == series.name).collect();
    let as_it_is = points.iter().find(|p| p.series == BASE);
    let x = match as_it_is {
        // Voxels that are not told by their number have one all the same.
        Some(base) if series.name == "voxels" => (base.surfels as f64).sqrt(),
        _ => abscissa(&series.name, &value),
    };
    // A value that is no number on the axis, as exact light instead of photons, has no place on the law. Nor does it hold
    // here where none of the finer values that were tried is better by a twentieth: then it comes from coarser ones.
    let finer = own.iter().filter(|p| p.x > 1.01 * x).map(|p| p.score.rmse).min_by(f64::total_cmp);
    let falls_on = finer.zip(as_it_is).is_none_or(|(finer, base)| finer < 0.95 * base.score.rmse);
    // The settings as they are have their place in every series.
    let here = as_it_is.filter(|_| x > 0.0 && own.iter().all(|p| (p.x / x - 1.0).abs() > 0.01));
    let here = here.map(|base| Point { x, ..base.clone() });
    own.extend(&here);
    let fit = Fit::of_series(&own).filter(|_| x > 0.0 && falls_on);
    let at = |x: f64| fit.map_or(0.0, |fit| fit.error(x));
    let share = fit.map_or(0.0, |fit| (fit.own(x) / fit.error(x)).powi(2));
    Some(Advice {
        setting: series.name.clone(),
        about: series.about.clone(),
        value,
        fit,
        now: at(x),
        doubled: (fit.is_some() && is_doubled(base, field)).then(|| at(2.0 * x)),
        share: if share.is_finite() { share } else { 0.0 },
    })
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
        assert_eq!((photons.fit, photons.now, photons.doubled, photons.share), (None, 0.0, None, 0.0));
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
        // What nobody looked at is not said to be less.
        let few = verdict(&list[..2]);
        assert!(few.starts_with("voxel size dominates") && few.contains("(swept: voxels, "), "{few}");
        assert!(verdict(&[]).starts_with("no setting was swept"));
    }

    #[test]
    fn a_setting_at_its_end_or_whose_finer_values_change_nothing_is_not_advised() {
        let base = Settings::preset(crate::settings::Preset::Final);
        let law = Fit { order: 1.0, floor: 0.001, scale: 0.01, misfit: 0.0 };
        let list = advise(&base, &sweeps(&base, false), &points("node_spacing", law));
        let spacing = list.iter().find(|a| a.setting == "node_spacing").unwrap();
        assert!(spacing.share > 0.9 && spacing.doubled.is_none(), "{spacing:?}");
        assert!(verdict(&list).contains("no setting alone"), "{}", verdict(&list));

        // The error stands still from the base on.
        let base = Settings::default();
        let mut all = points("cut_error", Fit { order: 1.0, floor: 0.0, scale: 1.0, misfit: 0.0 });
        let x = abscissa("cut_error", "0.017");
        let still = all.iter().find(|p| p.x >= 0.99 * x).unwrap().score;
        all.iter_mut().filter(|p| p.x > x).for_each(|p| p.score = still);
        all.push(Point { series: BASE.into(), score: still, ..Point::default() });
        let list = advise(&base, &sweeps(&base, false), &all);
        assert!(list.iter().all(|a| a.fit.is_none()), "{list:?}");
    }
}
