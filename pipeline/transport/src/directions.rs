//! Sets of sample directions, D of them with ΣΔΩ = 4π.
//!
//! A discrete line needs no integer direction: any real slope works in the same sweep. Rotated Fibonacci sets of
//! equal weight beat primitive integer vectors with Voronoi weights at equal count, which lose 1–7 % a bounce on
//! axis-aligned walls (directions within the plane of the wall own solid angle but have no cosine). The integer sets
//! of Chatelier & Malgouyres 2006 stay selectable.
//!
//! Rotation and phase depend on the bounce alone, so that no edit of a scene changes anybody's noise.

use glam::{DQuat, DVec3, IVec3, Vec3};

use crate::sampling;

/// Which set of directions a bounce uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum DirectionSet {
    /// Rotated Fibonacci spiral, equal weights.
    #[default]
    Fibonacci,
    /// All primitive integer vectors with |v|² up to a bound that gives at most the wanted count (26, 98, 146, 266 or
    /// 578), Voronoi weights.
    Integer,
}

/// One direction of a sweep: light travels along `sigma`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    /// Unit vector.
    pub sigma: Vec3,
    /// Solid angle ΔΩ [sr].
    pub weight: f32,
    /// Phase μ of the partition into lines, along the two minor axes, in [0, 1).
    pub phase: [f64; 2],
    /// Seed of the coverage tests of this direction.
    pub seed: u32,
}

impl DirectionSet {
    /// The directions of a bounce; `count` is met exactly by the Fibonacci set.
    pub fn directions(self, count: u32, bounce: u32) -> Vec<Direction> {
        let seed = sampling::combine(0x6c75_7865_6c20_6469, u64::from(bounce));
        let weighted = match self {
            DirectionSet::Fibonacci => fibonacci(count.max(1), seed),
            DirectionSet::Integer => integer(count),
        };
        let finish = |(i, (sigma, weight)): (usize, (DVec3, f64))| {
            let hash = sampling::combine(seed, 1 + i as u64);
            let phase = sampling::unit2(hash).as_dvec2().to_array();
            Direction { sigma: sigma.as_vec3(), weight: weight as f32, phase, seed: sampling::mix(hash) as u32 }
        };
        weighted.into_iter().enumerate().map(finish).collect()
    }
}

/// The spherical Fibonacci spiral (Swinbank & Purser 2006) under a random rotation.
fn fibonacci(count: u32, seed: u64) -> Vec<(DVec3, f64)> {
    let rotation = rotation(seed);
    let golden_angle = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let weight = 4.0 * std::f64::consts::PI / f64::from(count);
    let point = |i: u32| {
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
        let r = (1.0 - z * z).max(0.0).sqrt();
        let phi = f64::from(i) * golden_angle;
        (rotation * DVec3::new(r * libm::cos(phi), r * libm::sin(phi), z), weight)
    };
    (0..count).map(point).collect()
}

/// A uniform random rotation (Shoemake 1992).
fn rotation(seed: u64) -> DQuat {
    let unit = |word| f64::from(sampling::unit(sampling::combine(seed, word)));
    let (a, b, c) = (unit(0xa), unit(0xb), unit(0xc));
    let (r, s) = ((1.0 - a).sqrt(), a.sqrt());
    let (tb, tc) = (std::f64::consts::TAU * b, std::f64::consts::TAU * c);
    DQuat::from_xyzw(r * libm::sin(tb), r * libm::cos(tb), s * libm::sin(tc), s * libm::cos(tc)).normalize()
}

/// Bounds on |v|² of the integer sets, with their counts.
const INTEGER_SETS: [(i32, u32); 5] = [(3, 26), (9, 98), (11, 146), (17, 266), (29, 578)];

/// The number of directions nearest to `count` of which there is an integer set.
pub fn nearest_integer_set(count: u32) -> u32 {
    INTEGER_SETS.iter().map(|(_, n)| *n).min_by_key(|n| n.abs_diff(count)).unwrap_or(count)
}

fn integer(count: u32) -> Vec<(DVec3, f64)> {
    let bound = INTEGER_SETS.iter().rev().find(|(_, n)| *n <= count).unwrap_or(&INTEGER_SETS[0]).0;
    let reach = f64::from(bound).sqrt() as i32;
    let chamber: Vec<IVec3> = vectors(reach, bound).filter(|v| v.x >= v.y && v.y >= v.z && v.z >= 0).collect();
    let shares = voronoi_shares(&chamber);
    let all: Vec<IVec3> = vectors(reach, bound).collect();
    let orbit = |v: IVec3| {
        let mut a = v.abs().to_array();
        a.sort_unstable_by(|x, y| y.cmp(x));
        a
    };
    let weight = |v: &IVec3| {
        let class = chamber.iter().position(|c| c.to_array() == orbit(*v)).unwrap_or(0);
        let members = all.iter().filter(|w| orbit(**w) == orbit(*v)).count();
        4.0 * std::f64::consts::PI * shares[class] / members as f64
    };
    all.iter().map(|v| (v.as_dvec3().normalize(), weight(v))).collect()
}

/// Primitive integer vectors with 0 < |v|² ≤ `bound`.
fn vectors(reach: i32, bound: i32) -> impl Iterator<Item = IVec3> {
    let range = move || -reach..=reach;
    let all = range().flat_map(move |x| range().flat_map(move |y| range().map(move |z| IVec3::new(x, y, z))));
    all.filter(move |v| (1..=bound).contains(&v.length_squared()) && gcd(v.x, gcd(v.y, v.z)) == 1)
}

fn gcd(a: i32, b: i32) -> i32 {
    if b == 0 { a.abs() } else { gcd(b, a % b) }
}

/// The share of the sphere that is nearest to each orbit of the octahedral group. A point of the chamber
/// x ≥ y ≥ z ≥ 0 is nearest to the representatives in that chamber, so a lattice over the sphere, folded into it,
/// needs a dozen comparisons a point.
fn voronoi_shares(chamber: &[IVec3]) -> Vec<f64> {
    const POINTS: u32 = 200_000;
    let units: Vec<DVec3> = chamber.iter().map(|v| v.as_dvec3().normalize()).collect();
    let mut counts = vec![0u32; units.len()];
    for (p, _) in fibonacci(POINTS, 1) {
        let mut a = p.abs().to_array();
        a.sort_unstable_by(|x, y| y.total_cmp(x));
        let p = DVec3::from_array(a);
        let nearest = (0..units.len()).fold(0, |b, i| if units[i].dot(p) > units[b].dot(p) { i } else { b });
        counts[nearest] += 1;
    }
    counts.iter().map(|&n| f64::from(n) / f64::from(POINTS)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row_sum(set: &[Direction], n: Vec3) -> f32 {
        set.iter().map(|d| d.sigma.dot(n).max(0.0) * d.weight).sum::<f32>() / std::f32::consts::PI
    }

    #[test]
    fn every_set_covers_the_sphere() {
        for set in [DirectionSet::Fibonacci, DirectionSet::Integer] {
            for count in [26, 98, 146, 266, 578] {
                let directions = set.directions(count, 3);
                assert_eq!(directions.len(), count as usize, "{set:?}");
                let sum: f64 = directions.iter().map(|d| f64::from(d.weight)).sum();
                assert!((sum - 4.0 * std::f64::consts::PI).abs() < 1e-4, "{set:?} {count}: {sum}");
                let mean = directions.iter().map(|d| d.sigma * d.weight).sum::<Vec3>();
                assert!(mean.length() < 2.5 / count as f32, "{set:?} {count}: {mean}");
            }
        }
    }

    #[test]
    fn integer_sets_lose_light_on_axis_aligned_walls_and_rotated_ones_do_not() {
        let integer = row_sum(&DirectionSet::Integer.directions(26, 0), Vec3::X);
        assert!((integer - 0.927).abs() < 0.01, "{integer}");
        let spiral = row_sum(&DirectionSet::Fibonacci.directions(512, 0), Vec3::X);
        assert!((spiral - 1.0).abs() < 5e-3, "{spiral}");
    }

    #[test]
    fn bounces_differ_and_repeat() {
        let a = DirectionSet::Fibonacci.directions(64, 1);
        assert_eq!(a, DirectionSet::Fibonacci.directions(64, 1));
        assert_ne!(a, DirectionSet::Fibonacci.directions(64, 2));
    }
}
