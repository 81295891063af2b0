//! One smoothing pass over nodes, which takes away what a gather's sampling puts into each of them alone.
//!
//! Through every node run four lines of its chart's texels: along the rows, the columns and the two diagonals. On each,
//! the two nearest nodes on either side say what light they expect at the node's place, by the polynomial through them
//! (Lagrange), and the node takes the mean of its own light and of what is expected, each by the inverse of its variance:
//!
//! ```text
//! Lₗ = Σₖ cₖ Eₖ    cₖ = Π_{m≠k} sₘ/(sₘ − sₖ)      sₖ place of node k on line l, the node itself at 0
//! E' = (E + Σₗ wₗ gₗ Lₗ) / (1 + Σₗ wₗ gₗ)          gₗ = 1/Σₖ cₖ²
//! wₗ = (1 − (δₗ/t)²)² where δₗ = |Lₗ − E|/E < t and all nodes of the line lie within t of E, else 0
//! ```
//!
//! With four nodes on a line whatever is a cubic along it stays as it is, with three whatever is a quadratic; fewer have
//! no say. A line that disagrees has none either: no edge of a shadow is washed out. Lines end at a place without a
//! receiver, where the chart has a hole or a wall stands. Where all four lines are whole and agree, 44 % of independent
//! noise is left.

use super::Gathered;
use crate::Rgb;

/// What stands at a place of a chart.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// No receiver.
    Nothing,
    /// A receiver that is no node.
    Between,
    Node(usize),
}

/// How nodes are averaged.
pub(super) struct Smoothing<'a> {
    /// What stands at (x, y); nothing outside the chart.
    pub at: &'a dyn Fn(i64, i64) -> Place,
    /// Two nodes lie on one smooth surface, this many texels apart.
    pub joined: &'a dyn Fn(usize, usize, u32) -> bool,
    /// Texels between two nodes of a line at most.
    pub reach: u32,
    /// t, the largest difference of a line from the node, as a share of the node's light.
    pub alike: f32,
}

/// Steps along the four lines.
const LINES: [[i64; 2]; 4] = [[1, 0], [0, 1], [1, 1], [1, -1]];

/// Nodes of a line on either side.
const SIDE: usize = 2;

/// Fewest nodes of a line.
const LEAST: usize = 3;

impl Smoothing<'_> {
    /// The smoothed light of a node that stands at `place`.
    pub fn smoothed(&self, light: &[Gathered], node: usize, place: [i64; 2]) -> Gathered {
        let own = light[node];
        let (mut sum, mut bound, mut total) = (own.irradiance, own.bound, 1.0);
        for step in LINES {
            let Some((line, count)) = self.line(node, place, step) else { continue };
            let line = &line[..count];
            let (mut expected, mut spread, mut widest) = (Rgb::ZERO, 0.0, 0.0f32);
            for &(other, share) in line {
                expected += light[other].irradiance * share;
                spread += share * share;
                widest = widest.max(light[other].bound);
            }
            let mean = own.irradiance.element_sum() / 3.0;
            let far = |e: Rgb| (e - own.irradiance).abs().max_element();
            // Written so that a dark node agrees with nothing.
            let alike = |e: Rgb| far(e) < self.alike * mean;
            if !(alike(expected) && line.iter().all(|(other, _)| alike(light[*other].irradiance))) {
                continue;
            }
            let off = far(expected) / (self.alike * mean);
            let inside = 1.0 - off * off;
            let weight = inside * inside / spread;
            sum += expected * weight;
            bound += widest * weight;
            total += weight;
        }
        let irradiance = (sum / total).max(Rgb::ZERO);
        let moved = (irradiance - own.irradiance).abs().element_sum() / 3.0;
        Gathered { irradiance, bound: bound / total + moved, ..own }
    }

    /// The nodes of a line with their shares c, and how many there are; none where they are too few or all on one side.
    fn line(&self, node: usize, place: [i64; 2], step: [i64; 2]) -> Option<([(usize, f32); 2 * SIDE], usize)> {
        let (mut nodes, mut count) = ([(0, 0.0f32); 2 * SIDE], 0);
        for sense in [-1, 1] {
            let before = count;
            self.along(node, place, step.map(|s| s * sense), |other, distance| {
                nodes[count] = (other, distance as f32 * sense as f32);
                count += 1;
            });
            if count == before {
                return None;
            }
        }
        let places = nodes.map(|(_, s)| s);
        for (k, (_, share)) in nodes[..count].iter_mut().enumerate() {
            let others = (0..count).filter(|m| *m != k);
            *share = others.map(|m| places[m] / (places[m] - places[k])).product();
        }
        (count >= LEAST).then_some((nodes, count))
    }

    /// The nearest nodes in one direction, each with its distance in steps.
    fn along(&self, node: usize, [x, y]: [i64; 2], [dx, dy]: [i64; 2], mut found: impl FnMut(usize, u32)) {
        let (mut distance, mut count, mut end) = (0, 0, self.reach);
        while count < SIDE && distance < end {
            distance += 1;
            let steps = i64::from(distance);
            match (self.at)(x + steps * dx, y + steps * dy) {
                Place::Nothing => return,
                Place::Between => {}
                Place::Node(other) => {
                    if !(self.joined)(node, other, distance) {
                        return;
                    }
                    found(other, distance);
                    count += 1;
                    end = distance + self.reach;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{mix, unit};

    const SIZE: i64 = 24;

    fn index(x: i64, y: i64) -> usize {
        (y * SIZE + x) as usize
    }

    /// One pass over a square of nodes.
    fn pass(light: impl Fn(i64, i64) -> f32, hole: impl Fn(i64, i64) -> bool) -> Vec<f32> {
        let inside = |v: i64| (0..SIZE).contains(&v);
        let at = |x: i64, y: i64| match inside(x) && inside(y) && !hole(x, y) {
            true => Place::Node(index(x, y)),
            false => Place::Nothing,
        };
        let places = (0..SIZE * SIZE).map(|i| [i % SIZE, i / SIZE]);
        let lights: Vec<Gathered> = places
            .clone()
            .map(|[x, y]| Gathered { irradiance: Rgb::splat(light(x, y)), ..Gathered::default() })
            .collect();
        let how = Smoothing { at: &at, joined: &|_, _, _| true, reach: 4, alike: 0.2 };
        places.map(|[x, y]| how.smoothed(&lights, index(x, y), [x, y]).irradiance.x).collect()
    }

    #[test]
    fn what_is_quadratic_stays_as_it_is() {
        let exact = |x: i64, y: i64| 100.0 + (x * x) as f32 * 0.05 - (x * y) as f32 * 0.08 + y as f32;
        for (i, found) in (0..).zip(pass(exact, |_, _| false)) {
            let exact = exact(i % SIZE, i / SIZE);
            assert!((found - exact).abs() < 1e-4 * exact, "{found} for {exact}");
        }
    }

    #[test]
    fn independent_noise_falls_to_what_the_variances_say() {
        let noise = |x: i64, y: i64| 0.01 * (unit(mix(index(x, y) as u64)) - 0.5);
        let found = pass(|x, y| 1.0 + noise(x, y), |_, _| false);
        let inner: Vec<[i64; 2]> = (2..SIZE - 2).flat_map(|y| (2..SIZE - 2).map(move |x| [x, y])).collect();
        let square = |f: &dyn Fn(i64, i64) -> f32| inner.iter().map(|&[x, y]| f(x, y).powi(2)).sum::<f32>();
        let left = (square(&|x, y| found[index(x, y)] - 1.0) / square(&noise)).sqrt();
        // Inverse variances 1 + 4·36/34 in all: 0.437, and the estimate from 400 places is good to a tenth.
        assert!((left - 0.437).abs() < 0.045, "{left}");
    }

    #[test]
    fn no_light_crosses_an_edge_or_a_hole() {
        let edge = |x: i64, _: i64| if x < 12 { 1.0 } else { 0.5 };
        for (i, found) in (0..).zip(pass(edge, |_, _| false)) {
            assert_eq!(found, edge(i % SIZE, 0));
        }
        // Without the hole the faint step would be smoothed.
        let step = |x: i64, _: i64| if x < 12 { 1.0 } else { 0.95 };
        let through = pass(step, |_, _| false);
        assert!(through.iter().any(|e| *e != 1.0 && *e != 0.95));
        for (i, found) in (0..).zip(pass(step, |x, _| x == 12)) {
            assert!(i % SIZE == 12 || (found - step(i % SIZE, 0)).abs() < 1e-6, "{found} at {}", i % SIZE);
        }
    }

    #[test]
    fn darkness_stays_dark_and_finite() {
        assert!(pass(|_, _| 0.0, |_, _| false).iter().all(|e| *e == 0.0));
        let specks = pass(|x, y| if (x + y) % 5 == 0 { 1e-30 } else { 0.0 }, |_, _| false);
        assert!(specks.iter().all(|e| e.is_finite() && *e >= 0.0));
    }
}
