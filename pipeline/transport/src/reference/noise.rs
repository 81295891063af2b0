//! The numbers that a walk consumes: a shifted lattice at its first vertex, hashes behind it.

use crate::sampling::{combine, mix};

/// The powers 1/p and 1/p² of the plastic number as fractions of 2⁶⁴ (the R2 sequence, Roberts 2018).
const R2: [u64; 2] = [0xc13f_a9a9_02a6_328f, 0x91e1_0da5_c79e_7b1c];

/// What a pair of numbers decides.
#[derive(Clone, Copy)]
pub(super) enum Use {
    Direction,
    Emitter,
    Sky,
    Lamp(u32),
}

impl Use {
    fn word(self) -> u64 {
        match self {
            Use::Direction => 0,
            Use::Emitter => 1,
            Use::Sky => 2,
            Use::Lamp(i) => 3 + u64::from(i),
        }
    }
}

/// The numbers of one batch of one receiver.
pub(super) struct Noise {
    batch: u64,
    index: u32,
    state: u64,
}

impl Noise {
    pub fn new(seed: u64, batch: u32) -> Self {
        Self { batch: combine(mix(seed), u64::from(batch)), index: 0, state: 0 }
    }

    /// Begins walk `index`.
    pub fn start(&mut self, index: u32) {
        self.index = index;
        self.state = combine(self.batch, !u64::from(index));
    }

    /// A pair in [0, 1)². At the first vertex the pairs of all walks of the batch that serve one use are a lattice.
    pub fn pair(&mut self, depth: u32, purpose: Use) -> [f64; 2] {
        if depth > 0 {
            return [self.number(), self.number()];
        }
        let shift = combine(self.batch, purpose.word());
        let i = u64::from(self.index);
        [fraction(i.wrapping_mul(R2[0]).wrapping_add(shift)), fraction(i.wrapping_mul(R2[1]).wrapping_add(mix(shift)))]
    }

    /// A number in [0, 1) that nothing else depends on.
    pub fn number(&mut self) -> f64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        fraction(mix(self.state))
    }
}

/// The upper 53 bits as a number in [0, 1).
fn fraction(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Where `x` in [0, 1) falls into running sums of weights: the index, and the position within it in [0, 1). None when
/// the weights are all zero.
pub(super) fn pick(sums: &[f64], x: f64) -> Option<(usize, f64)> {
    let total = *sums.last()?;
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    let target = x * total;
    let at = sums.partition_point(|&sum| sum <= target).min(sums.len() - 1);
    let before = if at == 0 { 0.0 } else { sums[at - 1] };
    let weight = sums[at] - before;
    (weight > 0.0).then(|| (at, ((target - before) / weight).clamp(0.0, 1.0 - f64::EPSILON)))
}

/// The weight of entry `at` in running sums.
pub(super) fn weight(sums: &[f64], at: usize) -> f64 {
    sums[at] - if at == 0 { 0.0 } else { sums[at - 1] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picks_are_in_proportion_and_reuse_their_number() {
        let sums = [0.0, 1.0, 1.0, 4.0];
        let mut counts = [0; 4];
        for i in 0..4000 {
            let (at, rest) = pick(&sums, f64::from(i) / 4000.0).unwrap();
            counts[at] += 1;
            let x = (weight(&sums, at) * rest + if at == 1 { 0.0 } else { 1.0 }) / 4.0;
            assert!((x - f64::from(i) / 4000.0).abs() < 1e-12);
        }
        assert_eq!(counts, [0, 1000, 0, 3000]);
        assert_eq!(pick(&[0.0, 0.0], 0.5), None);
        assert_eq!(pick(&[], 0.5), None);
    }

    #[test]
    fn batches_and_uses_are_different_lattices() {
        let pairs = |batch, purpose| {
            let mut noise = Noise::new(7, batch);
            (0..4)
                .map(|i| {
                    noise.start(i);
                    noise.pair(0, purpose)
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(pairs(0, Use::Sky), pairs(0, Use::Sky));
        assert_ne!(pairs(0, Use::Sky), pairs(1, Use::Sky));
        assert_ne!(pairs(0, Use::Sky), pairs(0, Use::Emitter));
    }
}
