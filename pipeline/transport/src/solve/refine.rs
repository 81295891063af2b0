//! Defect correction: what one exact bounce says about all bounces.
//!
//! A refresh gathers E₁ = T E₀ by rays, where T is exact but for noise and E₀ the sweep's solution. The sweep's own
//! operator T̃ leaks a little through thin walls, and a dark room that ought to have nothing holds δ; the exact bounce
//! leaves ρδ of it. But the defect r = E₁ − E₀ is known, and the sweep can say what it does to all later bounces
//! (Stetter 1978):
//!
//!   E = E₁ + Σₖ (T̃ρ)ᵏ r,   k = 1, 2, …
//!
//! What is left is of second order, the defect of T̃ times the defect. Noise of the rays is averaged over the scene by
//! T̃. The series ends when its terms are small, or after [`MOST`] of them: in nearly white rooms only the start of it is
//! taken. Light stays positive: no term takes more than all but [`LEAST`] of what is there, as it would behind the second door
//! of a dark room; where it takes a leak away, it takes 1 − ρ of it. Irradiances in lux.

use luxel_scene::{Cancelled, Progress};

use super::SolveSettings;
use crate::{Rgb, ledger::flux, surfel::Surfels, sweep::Sweep};

/// Directions of a term: the defect is small, and its terms are smooth.
const DIRECTIONS: u32 = 64;

/// Terms, at most.
const MOST: u32 = 12;

/// Share of all indirect light below which a term ends the series.
const ENOUGH: f64 = 1e-5;

/// Share of what is there that no term takes away: less than any albedo that is not black.
const LEAST: f32 = 1.0 / 16.0;

/// Adds to refreshed irradiance what the defect of the irradiance `before`, whose memory is used, does to later bounces.
/// Returns the discrete rays spent.
///
/// # Errors
/// When the work is cancelled.
pub fn refine(
    surfels: &Surfels,
    before: Vec<Rgb>,
    refreshed: &mut [Rgb],
    settings: &SolveSettings,
    progress: &dyn Progress,
) -> Result<u64, Cancelled> {
    let total = flux(surfels, |i| refreshed[i]).element_sum();
    let mut defect = before;
    defect.iter_mut().zip(&*refreshed).for_each(|(before, after)| *before = *after - *before);
    let sweep = Sweep::new(surfels, settings.rule, settings.closed);
    let mut rays = 0;
    for term in 0..MOST {
        if flux(surfels, |i| defect[i].abs()).element_sum() <= ENOUGH * total {
            break;
        }
        let directions = settings.set.directions(DIRECTIONS, FIRST + term);
        rays += directions.len() as u64 * surfels.list.len() as u64;
        surfels.list.iter().zip(&mut defect).for_each(|(s, e)| *e *= s.albedo());
        defect = sweep.apply(&directions, defect, None, false, progress)?;
        refreshed.iter_mut().zip(&defect).for_each(|(e, d)| *e = (*e + *d).max(*e * LEAST));
    }
    Ok(rays)
}

/// Sets of directions that no bounce has.
const FIRST: u32 = 1 << 16;
