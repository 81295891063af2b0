//! Nearly white rooms: x = s + ρTx where plain bounces need ln ε / ln q of them (6900 at ρ = 0.999).
//!
//! Only one mode is slow, that of equal light everywhere, and what T does to it is measured by one sweep: T·1 = 1 in a
//! closed scene, but for surfels that see nothing. So the iterate is kept as x = c + d, a level and what deviates from it:
//!
//! - the operator is applied to d alone, and the residual r = s − c(1 − ρ T·1) + ρTd − d loses nothing to the rounding of
//!   a level that is 1/(1 − ρ) times as large;
//! - a residual corrects both, d by itself and c by what balances the scene's energy, ρ̄ ΣAr / ΣA(1 − ρ T·1): a two-level
//!   preconditioner (Nicolaides 1987) with the constant as its coarse space;
//! - Anderson's acceleration (Walker & Ni 2011) of depth eight combines the last iterates so that the residual is least
//!   in the area norm, for a linear operator a truncated GMRES. The balance by areas is not quite the operator's own,
//!   since gathering is not exactly symmetric; this is what makes up for it.
//!
//! The steps do not depend on ρ: 3 to 8 to a thousandth in boxes, spheres and L-shaped rooms, tilted or not, at ρ from 0.5
//! to 0.99999 (`tests/extreme/stiff.rs`).

use glam::DVec3;
use luxel_scene::Cancelled;

use crate::{Rgb, ledger::flux, surfel::Surfels};

/// Steps, at most.
const MAX_STEPS: u32 = 40;

/// Steps between iterates to combine with the current one.
const DEPTH: usize = 8;

/// Modes but the constant one shrink by less than this in a bounce; it turns their residual into an error.
const OTHER_MODES: f64 = 0.75;

/// The equation x = s + ρTx for the radiosity x.
pub struct Equation<'a> {
    pub surfels: &'a Surfels,
    /// ρ of every surfel, below 1; the solver's own surfels have [`Surfel::albedo`](crate::surfel::Surfel).
    pub reflectance: &'a dyn Fn(usize) -> Rgb,
    /// s, the radiosity that starts [lm/m²].
    pub source: &'a [Rgb],
    /// T·1 of every surfel; None where all of them are 1, as in most closed scenes.
    pub rows: Option<&'a [Rgb]>,
}

/// All light after the source.
pub struct Rest {
    /// T x: what arrives [lux].
    pub irradiance: Vec<Rgb>,
    /// x: what is sent for it.
    pub radiosity: Vec<Rgb>,
    pub steps: u32,
    /// Estimate of what is missing, Σ A·E.
    pub remaining: f64,
}

/// x = c + d.
struct Light {
    level: DVec3,
    deviation: Vec<Rgb>,
}

/// An iterate x: its residual r, and the next one of plain iteration.
struct Iterate {
    residual: Vec<Rgb>,
    plain: Light,
}

/// What changed from one iterate to the next.
struct Step {
    residual: Short,
    level: DVec3,
    deviation: Short,
}

impl Step {
    fn between(old: &Iterate, new: &Iterate) -> Self {
        Self {
            residual: Short::difference(&old.residual, &new.residual),
            level: new.plain.level - old.plain.level,
            deviation: Short::difference(&old.plain.deviation, &new.plain.deviation),
        }
    }
}

/// Differences as the upper halves of f32, cut off: 6 bytes a surfel. What is lost (2⁻⁷ of each difference, at most)
/// makes a combination less than the best one, but no error stays: every residual is computed anew.
struct Short(Vec<[u16; 3]>);

impl Short {
    fn difference(old: &[Rgb], new: &[Rgb]) -> Self {
        let upper = |(a, b): (&Rgb, &Rgb)| (*b - *a).to_array().map(|d| (d.to_bits() >> 16) as u16);
        Self(old.iter().zip(new).map(upper).collect())
    }

    fn get(&self, i: usize) -> Rgb {
        Rgb::from(self.0[i].map(|half| f32::from_bits(u32::from(half) << 16)))
    }
}

/// Solves the equation and returns x with Tx. `before` is the indirect energy (Σ A·E) so far; `tolerance` of that and of
/// what the solution adds may be missing. `operator` is T for radiosities of either sign.
///
/// # Errors
/// When the work is cancelled.
pub fn solve(
    equation: &Equation,
    before: f64,
    tolerance: f64,
    operator: impl Fn(&[Rgb]) -> Result<Vec<Rgb>, Cancelled>,
) -> Result<Rest, Cancelled> {
    let balance = equation.balance();
    let Equation { surfels, source, .. } = *equation;
    let mut x = Light { level: balance.level(surfels, source), deviation: source.to_vec() };
    let mut history: Vec<Step> = Vec::new();
    let mut last: Option<Iterate> = None;
    let mut steps = 0;
    loop {
        let arrived = operator(&x.deviation)?;
        steps += 1;
        let residual = equation.residual(&x, &arrived);
        let remaining = balance.error(surfels, &residual);
        let irradiance = |i: usize| (x.level * equation.row(i)).as_vec3() + arrived[i];
        let total = before + flux(surfels, irradiance).element_sum() / 3.0;
        if remaining <= tolerance * total || steps == MAX_STEPS {
            let level = x.level.as_vec3();
            // What was solved for is linear; light alone is never negative.
            let irradiance = (0..arrived.len()).map(|i| irradiance(i).max(Rgb::ZERO)).collect();
            let radiosity = x.deviation.iter().map(|d| (level + *d).max(Rgb::ZERO)).collect();
            return Ok(Rest { irradiance, radiosity, steps, remaining });
        }
        drop(arrived);
        x.level += balance.level(surfels, &residual);
        x.deviation.iter_mut().zip(&residual).for_each(|(d, r)| *d += *r);
        let now = Iterate { residual, plain: x };
        if let Some(last) = last.take() {
            if history.len() == DEPTH {
                history.remove(0);
            }
            history.push(Step::between(&last, &now));
        }
        x = combine(surfels, &history, &now);
        last = Some(now);
    }
}

impl Equation<'_> {
    fn row(&self, i: usize) -> DVec3 {
        self.rows.map_or(DVec3::ONE, |rows| rows[i].as_dvec3())
    }

    /// s + ρTx − x, given Td.
    fn residual(&self, x: &Light, arrived: &[Rgb]) -> Vec<Rgb> {
        let one = |i: usize| {
            let rho = (self.reflectance)(i).as_dvec3();
            let level = x.level * (DVec3::ONE - rho * self.row(i));
            let deviation = rho * arrived[i].as_dvec3() - x.deviation[i].as_dvec3();
            (self.source[i].as_dvec3() - level + deviation).as_vec3()
        };
        (0..arrived.len()).map(one).collect()
    }

    fn balance(&self) -> Balance {
        let (mut area, mut reflected, mut seen, mut lost) = (0.0, DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        for (i, s) in self.surfels.list.iter().enumerate() {
            let (a, rho, row) = (f64::from(s.area), (self.reflectance)(i).as_dvec3(), self.row(i));
            area += a;
            reflected += a * rho;
            seen += a * row;
            lost += a * (DVec3::ONE - rho * row);
        }
        let safe = lost.max(DVec3::splat(f64::MIN_POSITIVE));
        Balance { gain: reflected / (area.max(f64::MIN_POSITIVE) * safe), light: seen / safe }
    }
}

/// The scene as one surface: what a flux that starts in it becomes.
struct Balance {
    /// ρ̄ / ΣA(1 − ρ T·1).
    gain: DVec3,
    /// ΣA T·1 / ΣA(1 − ρ T·1).
    light: DVec3,
}

/// The share of a residual that may lie in the slow mode although its energy balances: by so much the gather's
/// balance differs from that of areas.
const ASYMMETRY: f64 = 0.05;

impl Balance {
    /// The level that reflections of a source come to.
    fn level(&self, surfels: &Surfels, source: &[Rgb]) -> DVec3 {
        self.gain * flux(surfels, |i| source[i])
    }

    /// Σ A·|error| from the residual: its mean is the slow mode.
    fn error(&self, surfels: &Surfels, residual: &[Rgb]) -> f64 {
        let constant = flux(surfels, |i| residual[i]).abs();
        let all = flux(surfels, |i| residual[i].abs());
        (self.light * (constant + ASYMMETRY * all) + all / (1.0 - OTHER_MODES)).element_sum() / 3.0
    }
}

/// The combination of the current iterate with the steps before it whose residual is least.
fn combine(surfels: &Surfels, history: &[Step], now: &Iterate) -> Light {
    let n = history.len();
    let step = |j: usize, i: usize| history[j].residual.get(i).as_dvec3();
    let dot = |product: &dyn Fn(usize) -> DVec3| -> DVec3 {
        surfels.list.iter().enumerate().map(|(i, s)| f64::from(s.area) * product(i)).sum()
    };
    let mut gram = [[DVec3::ZERO; DEPTH]; DEPTH];
    let mut right = [DVec3::ZERO; DEPTH];
    for j in 0..n {
        // The lower half is all that the factorisation reads.
        for (k, product) in gram[j].iter_mut().enumerate().take(j + 1) {
            *product = dot(&|i| step(j, i) * step(k, i));
        }
        right[j] = dot(&|i| step(j, i) * now.residual[i].as_dvec3());
    }
    let weights = [0, 1, 2].map(|b| cholesky(n, |j, k| gram[j][k][b], |j| right[j][b]));
    let mut x = Light { level: now.plain.level, deviation: now.plain.deviation.clone() };
    for (j, h) in history.iter().enumerate() {
        let w = DVec3::new(weights[0][j], weights[1][j], weights[2][j]);
        x.level -= w * h.level;
        let w = w.as_vec3();
        x.deviation.iter_mut().enumerate().for_each(|(i, d)| *d -= w * h.deviation.get(i));
    }
    x
}

/// Solves a small symmetric positive system; directions that add nothing new get no weight.
fn cholesky(n: usize, a: impl Fn(usize, usize) -> f64, b: impl Fn(usize) -> f64) -> [f64; DEPTH] {
    let mut l = [[0.0; DEPTH]; DEPTH];
    let mut z = [0.0; DEPTH];
    for j in 0..n {
        for k in 0..j {
            let sum: f64 = (0..k).map(|m| l[j][m] * l[k][m]).sum();
            l[j][k] = if l[k][k] > 0.0 { (a(j, k) - sum) / l[k][k] } else { 0.0 };
        }
        let pivot = a(j, j) - (0..j).map(|m| l[j][m] * l[j][m]).sum::<f64>();
        l[j][j] = if pivot > 1e-12 * a(j, j) { pivot.sqrt() } else { 0.0 };
        let sum: f64 = (0..j).map(|m| l[j][m] * z[m]).sum();
        z[j] = if l[j][j] > 0.0 { (b(j) - sum) / l[j][j] } else { 0.0 };
    }
    let mut x = [0.0; DEPTH];
    for j in (0..n).rev() {
        let sum: f64 = (j + 1..n).map(|m| l[m][j] * x[m]).sum();
        x[j] = if l[j][j] > 0.0 { (z[j] - sum) / l[j][j] } else { 0.0 };
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_system_is_solved() {
        let a = [[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]];
        let exact = [1.0, -2.0, 0.5];
        let b = |j: usize| (0..3).map(|k| a[j][k] * exact[k]).sum();
        let x = cholesky(3, |j, k| a[j][k], b);
        assert!((0..3).all(|j| (x[j] - exact[j]).abs() < 1e-12), "{x:?}");
    }

    #[test]
    fn a_direction_that_is_there_twice_counts_once() {
        let x = cholesky(2, |_, _| 2.0, |_| 2.0);
        assert!((x[0] + x[1] - 1.0).abs() < 1e-9, "{x:?}");
    }
}
