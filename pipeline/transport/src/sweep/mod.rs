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
//! Directions are split into a fixed number of groups with an accumulator each, which are added in fixed order: the
//! result does not depend on the number of threads.

mod axis;
mod kernel;
mod lines;
mod literal;
mod planes;
mod rule;
mod sample;

use std::sync::Arc;

use glam::{Vec2, Vec4};
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use crate::{Rgb, directions::Direction, surfel::Surfels};
use axis::AxisCopy;
use lines::Lines;
use planes::Planes;
use sample::Sample;

/// Groups that the directions of one dominant axis are split into, at most, and directions per group, at least.
const GROUPS: usize = 8;
const PER_GROUP: usize = 4;

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
    rule: Rule,
    /// Nothing escapes from this scene: a line that comes from nowhere is unknown, not sky.
    closed: bool,
}

impl<'a> Sweep<'a> {
    pub fn new(surfels: &'a Surfels, rule: Rule, closed: bool) -> Self {
        let planes = Arc::new(Planes::new(surfels));
        let orders = Arc::new([0, 1, 2].map(|axis| axis::order(surfels, &planes, axis)));
        Self { surfels, planes, orders, rule, closed }
    }

    pub fn surfels(&self) -> &'a Surfels {
        self.surfels
    }

    /// The same operator, in which lines from nowhere see the sky.
    pub fn opened(&self) -> Self {
        Self { closed: false, planes: Arc::clone(&self.planes), orders: Arc::clone(&self.orders), ..*self }
    }

    /// The irradiance [lux] at every surfel from the radiosities [lm/m²] of all and from the sky.
    ///
    /// With `grey` only the first band is computed and copied to the others.
    ///
    /// # Errors
    /// When the work is cancelled.
    pub fn apply(
        &self,
        directions: &[Direction],
        radiosity: &[Rgb],
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
    /// the surfels lives at once.
    fn run<S: Sample, const LITERAL: bool>(
        &self,
        directions: &[Direction],
        radiosity: &[Rgb],
        sky: Option<SkyFn>,
        progress: &dyn Progress,
    ) -> Result<Vec<Rgb>, Cancelled> {
        let count = self.surfels.list.len();
        let mut sums = vec![S::default(); count];
        let mut sorted = vec![S::default(); count];
        let mut workspaces: Vec<_> = (0..rayon::current_num_threads().max(1)).map(|_| Workspace::default()).collect();
        for axis in 0..3 {
            let mine: Vec<Direction> =
                directions.iter().filter(|d| lines::dominant(d.sigma) == axis).copied().collect();
            if mine.is_empty() || count == 0 {
                continue;
            }
            let order = &self.orders[axis];
            let copy = AxisCopy::new(self.surfels, &self.planes, axis, order);
            let light = kernel::light::<S>(order, radiosity);
            let groups: Vec<&[Direction]> = groups(&mine).collect();
            // Waves as wide as the pool bound the memory; the order of addition is that of the groups in any case.
            for wave in groups.chunks(workspaces.len()) {
                wave.par_iter().zip(&mut workspaces).try_for_each(|(group, workspace)| {
                    self.sweep_group::<S, LITERAL>(&copy, &light, group, sky, workspace, progress)
                })?;
                for workspace in &workspaces[..wave.len()] {
                    sorted.iter_mut().zip(&workspace.sums).for_each(|(sum, part)| *sum += *part);
                }
            }
            for (&i, part) in order.iter().zip(&mut sorted) {
                sums[i as usize] += std::mem::take(part);
            }
        }
        Ok(sums.iter().map(|sum| sum.mean()).collect())
    }

    /// The sums of a group of directions, left in the workspace.
    fn sweep_group<S: Sample, const LITERAL: bool>(
        &self,
        copy: &AxisCopy,
        light: &[S],
        group: &[Direction],
        sky: Option<SkyFn>,
        workspace: &mut Workspace<S>,
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let Workspace { sums, table, literal } = workspace;
        sums.clear();
        sums.resize(copy.len(), S::default());
        for direction in group {
            progress.check()?;
            let lines = Lines::new(copy, direction);
            // Light travels along σ, so the sky is seen against it. L of the sky stands for the radiosity πL.
            let sky = sky.map(|sky| sky(-direction.sigma) * std::f32::consts::PI);
            if LITERAL {
                literal::sweep(copy, light, &lines, sky.unwrap_or_default(), literal, sums);
            } else {
                kernel::sweep(copy, light, &lines, sky, self.closed, table, sums);
            }
            progress.advance(copy.len() as u64);
        }
        Ok(())
    }
}

/// A split that depends on the directions alone.
fn groups(directions: &[Direction]) -> impl Iterator<Item = &[Direction]> {
    directions.chunks(directions.len().div_ceil(GROUPS).max(PER_GROUP))
}

/// What a thread needs to sweep, used again and again.
struct Workspace<S> {
    sums: Vec<S>,
    table: kernel::Table,
    literal: Vec<u32>,
}

impl<S> Default for Workspace<S> {
    fn default() -> Self {
        Self { sums: Vec::new(), table: kernel::Table::default(), literal: Vec::new() }
    }
}

#[cfg(test)]
pub mod tests;
