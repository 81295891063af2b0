//! The empirical order with which an error falls: e(x)² = e₀² + (c·x⁻ᵏ)², fitted to the points of a series.
//!
//! x grows with the work, k is the order, and e₀ is where the error stands still however far this one parameter is
//! refined: what all others leave. For every candidate e₀ the line log √(e² − e₀²) = log c − k log x is fitted by least
//! squares; the e₀ with the least squared error of log e wins. Three points at least, and an error that falls by a tenth:
//! else there is no order to speak of.

use serde::{Deserialize, Serialize};

use super::Point;

/// The law of a series.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// k.
    pub order: f64,
    /// e₀, the error that is left.
    pub floor: f64,
    /// c.
    pub scale: f64,
    /// Root mean square of log e about the law.
    pub misfit: f64,
}

/// Candidates for the floor between 0 and the least error.
const FLOORS: usize = 1000;

/// Largest order that is believed: above it two points near a floor decide.
const STEEPEST: f64 = 4.0;

/// Least order: below it the error stands still, or grows.
const FLATTEST: f64 = 0.05;

impl Fit {
    /// The law of a series, where its finest value has an error that is surely below that of its coarsest, by their
    /// intervals. An error that is not told from none counts as half of the most that it may be.
    pub fn of_series(points: &[&Point]) -> Option<Self> {
        let on_axis = || points.iter().filter(|p| p.x > 0.0);
        let coarsest = on_axis().min_by(|a, b| a.x.total_cmp(&b.x))?;
        let finest = on_axis().max_by(|a, b| a.x.total_cmp(&b.x))?;
        let falls = finest.score.rmse_high < coarsest.score.rmse_low;
        let error = |p: &Point| if p.score.rmse > 0.0 { p.score.rmse } else { 0.5 * p.score.rmse_high };
        let pairs: Vec<(f64, f64)> = on_axis().map(|p| (p.x, error(p))).collect();
        Self::of(&pairs).filter(|_| falls)
    }

    /// Fits pairs (x, e) with x > 0; none where they are too few or say nothing.
    pub fn of(points: &[(f64, f64)]) -> Option<Self> {
        let points: Vec<(f64, f64)> = points.iter().copied().filter(|(x, e)| *x > 0.0 && *e > 0.0).collect();
        let least = points.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
        let most = points.iter().map(|p| p.1).fold(0.0, f64::max);
        if points.len() < 3 || least > 0.9 * most {
            return None;
        }
        let candidates = (0..=FLOORS).map(|i| least * i as f64 / FLOORS as f64);
        let fits = candidates.filter_map(|floor| Self::above(&points, floor));
        fits.min_by(|a, b| a.misfit.total_cmp(&b.misfit)).filter(|fit| fit.order >= FLATTEST)
    }

    /// The line for a given floor. A point counts by how much of its error is above the floor: d log e = w d log √(e² − e₀²)
    /// with w = (e² − e₀²)/e², so that what lies on the floor has no say in the order.
    fn above(points: &[(f64, f64)], floor: f64) -> Option<Self> {
        let line = |(x, e): &(f64, f64)| {
            let own = (e * e - floor * floor).max(1e-12 * e * e);
            [(own / (e * e)).powi(2), x.ln(), 0.5 * own.ln()]
        };
        let logs: Vec<[f64; 3]> = points.iter().map(line).collect();
        let sum = |of: &dyn Fn(f64, f64) -> f64| logs.iter().map(|[w, x, y]| w * of(*x, *y)).sum::<f64>();
        let weight = sum(&|_, _| 1.0);
        let (mx, my) = (sum(&|x, _| x) / weight, sum(&|_, y| y) / weight);
        let xx = sum(&|x, _| (x - mx).powi(2));
        if !(weight > 0.0 && xx > 0.0) {
            return None;
        }
        let order = (-sum(&|x, y| (x - mx) * (y - my)) / xx).clamp(0.0, STEEPEST);
        let fit = Self { order, floor, scale: (my + order * mx).exp(), misfit: 0.0 };
        let squares: f64 = points.iter().map(|(x, e)| (fit.error(*x).ln() - e.ln()).powi(2)).sum();
        Some(Self { misfit: (squares / points.len() as f64).sqrt(), ..fit })
    }

    /// The error at x.
    pub fn error(&self, x: f64) -> f64 {
        self.floor.hypot(self.own(x))
    }

    /// The part of the error at x that further work on this parameter takes away.
    pub fn own(&self, x: f64) -> f64 {
        self.scale * x.powf(-self.order)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_law_is_found_again() {
        for (order, floor) in [(1.0, 0.004), (0.5, 0.0), (2.0, 0.01)] {
            let law = Fit { order, floor, scale: 1.0, misfit: 0.0 };
            let points: Vec<(f64, f64)> = (3..10).map(|i| f64::from(1 << i)).map(|x| (x, law.error(x))).collect();
            let fit = Fit::of(&points).unwrap();
            assert!((fit.order - order).abs() < 0.05, "{fit:?}");
            assert!((fit.floor - floor).abs() < 0.1 * floor + 1e-3, "{fit:?}");
            assert!((fit.error(200.0) / law.error(200.0) - 1.0).abs() < 0.02);
        }
    }

    #[test]
    fn what_noise_may_have_made_is_no_law_of_a_series() {
        let points = |spread: f64| -> Vec<Point> {
            let point = |i: u32| {
                let e = 0.04 / f64::from(1 << i);
                let score = crate::study::Score {
                    rmse: if i == 3 { 0.0 } else { e },
                    rmse_low: e / spread,
                    rmse_high: e * spread,
                    ..Default::default()
                };
                Point { x: f64::from(1 << i), score, ..Point::default() }
            };
            (0..4).map(point).collect()
        };
        let fit = |points: &[Point]| Fit::of_series(&points.iter().collect::<Vec<_>>());
        // An error of which only the upper end is known counts all the same.
        let known = fit(&points(1.2)).unwrap();
        assert!((known.order - 1.0).abs() < 0.3 && known.floor < 0.005, "{known:?}");
        assert_eq!(fit(&points(3.0)), None);
    }

    #[test]
    fn what_does_not_fall_has_no_order() {
        assert_eq!(Fit::of(&[(1.0, 0.1), (2.0, 0.1), (4.0, 0.099)]), None);
        assert_eq!(Fit::of(&[(1.0, 0.1), (2.0, 0.11), (4.0, 0.13), (8.0, 0.14)]), None);
        assert_eq!(Fit::of(&[(1.0, 0.1), (2.0, 0.05)]), None);
        assert_eq!(Fit::of(&[(0.0, 0.1), (0.0, 0.05), (0.0, 0.01)]), None);
    }
}
