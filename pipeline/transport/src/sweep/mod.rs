//! One bounce along discrete lines in linear time (Piwowar & Malgouyres 2009, §2; Chatelier & Malgouyres 2006):
//!
//!   E(x) = Σ_σ B(I(x,σ)) · |n(x)·σ| ΔΩ(σ) / Σ_σ |n(x)·σ| ΔΩ(σ),   n(x)·σ < 0
//!
//! E irradiance [lux], B radiosity [lm/m²] (B = πL), σ the direction in which light travels, I(x,σ) the surfel seen
//! from x against σ. The denominator is what was known about x; it tends to π as D → ∞, and dividing by it makes
//! every row of the operator sum to at most 1: bounces cannot diverge for any set of directions and any ρ < 1.
//!
//! For a direction with dominant axis x and slopes m, space falls into the naive discrete lines
//! (y − ⌊m₁x + μ₁⌋, z − ⌊m₂x + μ₂⌋). Going through the voxels in the lexicographic order of the dominant axis, the
//! paper's sorted lists are one table that remembers, for every line, the last surfels met: O(N) per direction.
//!
//! Differs from the paper: the next voxel of a line is not simply the visible one ([`Rule`]). Taken literally that
//! loses 30–50 % of the light, because a grazing line runs through a row of voxels of one wall and only the first of
//! them exchanges light with the far side.
//!
//! Threads sweep directions one behind the other (`turns.rs`): the result does not depend on their number, and all add
//! to one set of sums.

mod axis;
mod kernel;
mod layers;
mod lines;
mod literal;
mod planes;
mod rule;
mod sample;
mod turns;

use std::sync::Arc;

use glam::{Vec2, Vec4};
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use crate::{Rgb, directions::Direction, surfel::Surfels};
use axis::AxisCopy;
use layers::Layer;
use lines::Lines;
use planes::Planes;
use sample::Sample;
use turns::Turns;

/// Lines for each surfel, at most, of all directions that are swept at once: 64 bytes. Across a terrain, a single
/// direction has as many lines as there are surfels.
const MOST_LINES: usize = 4;

/// Who sees whom on a discrete line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Rule {
    /// Runs of voxels of one surface share what the line carries; plane tests and fill fractions tell a surface that
    /// the line crosses from one that it brushes. `rule.rs` has the rule.
    #[default]
    Surface,
    /// The paper's rule: the next voxel in the ordered list is the visible one. For comparison.
    Literal,
}

/// Light that enters along lines that start outside of the scene: radiance [cd/m²] seen when looking along a unit
/// direction.
pub type SkyFn<'a> = &'a (dyn Fn(glam::Vec3) -> Rgb + Sync);

/// The transport operator T of a scene: radiosities in, irradiances out.
pub struct Sweep<'a> {
    surfels: &'a Surfels,
    /// What does not change from sweep to sweep: the planes, and the orders along the three axes.
    planes: Arc<Planes>,
    orders: Arc<[Vec<u32>; 3]>,
    /// Where walls divide voxels; empty where none does.
    layers: Arc<Vec<Layer>>,
    rule: Rule,
    /// Nothing escapes from this scene: a line that comes from nowhere is unknown, not sky.
    closed: bool,
}

impl<'a> Sweep<'a> {
    pub fn new(surfels: &'a Surfels, rule: Rule, closed: bool) -> Self {
        let planes = Arc::new(Planes::new(surfels));
        let orders = Arc::new([0, 1, 2].map(|axis| axis::order(surfels, &planes, axis)));
        let layers = Arc::new(layers::layers(surfels));
        Self { surfels, planes, orders, layers, rule, closed }
    }

    pub fn surfels(&self) -> &'a Surfels {
        self.surfels
    }

    /// The same operator, in which lines from nowhere see the sky.
    pub fn opened(&self) -> Self {
        let (planes, orders) = (Arc::clone(&self.planes), Arc::clone(&self.orders));
        Self { closed: false, planes, orders, layers: Arc::clone(&self.layers), ..*self }
    }

    /// The irradiance [lux] at every surfel from the radiosities [lm/m²] of all and from the sky.
    ///
    /// With `grey` only the first band is computed and copied to the others. The radiosities are taken, because their
    /// memory is needed.
    ///
    /// # Errors
    /// When the work is cancelled.
    pub fn apply(
        &self,
        directions: &[Direction],
        radiosity: Vec<Rgb>,
        sky: Option<SkyFn>,
        grey: bool,
        progress: &dyn Progress,
    ) -> Result<Vec<Rgb>, Cancelled> {
        match (self.rule, grey) {
            (Rule::Surface, false) => self.run::<Vec4, false>(directions, radiosity, sky, progress),
            (Rule::Surface, true) => self.run::<Vec2, false>(directions, radiosity, sky, progress),
            (Rule::Literal, false) => self.run::<Vec4, true>(directions, radiosity, sky, progress),
            (Rule::Literal, true) => self.run::<Vec2, true>(directions, radiosity, sky, progress),
        }
    }

    /// Sums of radiosity and weight over the three dominant axes, one axis at a time so that only one sorted copy of
    /// the surfels lives at once; light and sums are sorted along.
    fn run<S: Sample, const LITERAL: bool>(
        &self,
        directions: &[Direction],
        mut radiosity: Vec<Rgb>,
        sky: Option<SkyFn>,
        progress: &dyn Progress,
    ) -> Result<Vec<Rgb>, Cancelled> {
        let mut sums = vec![S::default(); radiosity.len()];
        for axis in 0..3 {
            let mine = along(directions, axis, sky);
            if mine.is_empty() || radiosity.is_empty() {
                continue;
            }
            let order = &self.orders[axis];
            let mut sorted = sorted(order, std::mem::take(&mut sums));
            let light = kernel::light::<S>(order, radiosity);
            let copy = AxisCopy::new(self.surfels, &self.planes, &self.layers, axis, order);
            let turns =
                Turns::new(&mut sorted, copy.parts.windows(2).map(|p| p[0].start as usize..p[1].start as usize));
            let flights = rayon::current_num_threads().min(MOST_LINES * copy.len() / copy.cells() as usize).max(1);
            let mut workspaces: Vec<_> = (0..flights).map(|_| Workspace::default()).collect();
            workspaces.par_iter_mut().try_for_each(|workspace| {
                turns.take(mine.len(), |turn| {
                    progress.check()?;
                    let (direction, sky) = mine[turn.number];
                    let lines = Lines::new(&copy, direction);
                    if LITERAL {
                        literal::sweep(&copy, &light, &lines, sky.unwrap_or_default(), &mut workspace.literal, &turn)?;
                    } else {
                        kernel::sweep(&copy, &light, &lines, sky, self.closed, &mut workspace.table, &turn)?;
                    }
                    progress.advance(copy.len() as u64);
                    Ok(())
                })
            })?;
            drop((copy, workspaces));
            sums = unsorted(order, sorted.iter().copied());
            drop(sorted);
            radiosity = unsorted(order, light.iter().map(|&light| S::radiosity(light)));
        }
        Ok(sums.into_iter().map(S::mean).collect())
    }
}

/// The directions that go furthest along an axis, forward ones first, each with the light of the sky that it carries.
fn along<'d>(directions: &'d [Direction], axis: usize, sky: Option<SkyFn>) -> Vec<(&'d Direction, Option<Rgb>)> {
    let mine = directions.iter().filter(|d| lines::dominant(d.sigma) == axis);
    // Light travels along σ, so the sky is seen against it. L of the sky stands for the radiosity πL.
    let seen = |d: &Direction| sky.map(|sky| sky(-d.sigma) * std::f32::consts::PI);
    let mut mine: Vec<_> = mine.map(|d| (d, seen(d))).collect();
    // A direction that starts where the one before it has ended would wait for its end.
    mine.sort_by_key(|(d, _)| d.sigma[axis] < 0.0);
    mine
}

/// What is in the order of the list, in the order of an axis.
fn sorted<T: Copy>(order: &[u32], list: Vec<T>) -> Vec<T> {
    order.iter().map(|&i| list[i as usize]).collect()
}

/// What is in the order of an axis, in the order of the list.
fn unsorted<T: Copy + Default>(order: &[u32], sorted: impl Iterator<Item = T>) -> Vec<T> {
    let mut list = vec![T::default(); order.len()];
    order.iter().zip(sorted).for_each(|(&i, value)| list[i as usize] = value);
    list
}

/// What a thread needs to sweep, used again and again.
#[derive(Default)]
struct Workspace {
    table: kernel::Table,
    literal: Vec<u32>,
}

#[cfg(test)]
pub mod tests;
