//! Deterministic points and directions: hashes instead of generators, lattices instead of random numbers.

use std::f32::consts::TAU;

use glam::{Mat3, Vec2, Vec3};

/// A 64-bit mix (the finaliser of SplitMix64): stable identities in, noise out.
pub fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Mixes another word into a seed.
pub fn combine(seed: u64, word: u64) -> u64 {
    mix(seed ^ mix(word))
}

/// A number in [0, 1) from the upper bits of a hash.
pub fn unit(hash: u64) -> f32 {
    (hash >> 40) as f32 * (1.0 / (1u64 << 24) as f32)
}

/// Two numbers in [0, 1)² from a hash.
pub fn unit2(hash: u64) -> Vec2 {
    Vec2::new(unit(hash), unit(hash << 24))
}

/// Point `i` of the R2 sequence (Roberts 2018), shifted by `shift`, in [0, 1)².
pub fn r2(i: u32, shift: Vec2) -> Vec2 {
    // The two irrationals as fractions of 2³², so that the sequence is exact in integers.
    let x = i.wrapping_mul(3_242_174_889) >> 8;
    let y = i.wrapping_mul(2_447_445_414) >> 8;
    let p = Vec2::new(x as f32, y as f32) * (1.0 / (1u32 << 24) as f32) + shift;
    (p - p.floor()).min(Vec2::splat(1.0 - f32::EPSILON / 2.0))
}

/// An orthonormal basis whose third column is the unit vector `n` (Duff et al. 2017).
pub fn basis(n: Vec3) -> Mat3 {
    let sign = 1.0f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    Mat3::from_cols(
        Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        Vec3::new(b, sign + n.y * n.y * a, -n.y),
        n,
    )
}

/// A direction about +Z with density cos θ/π.
pub fn cosine_hemisphere(p: Vec2) -> Vec3 {
    let (r, phi) = (p.x.sqrt(), TAU * p.y);
    Vec3::new(r * libm::cosf(phi), r * libm::sinf(phi), (1.0 - p.x).max(0.0).sqrt())
}

/// A direction with density 1/4π.
pub fn sphere(p: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * p.x;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let phi = TAU * p.y;
    Vec3::new(r * libm::cosf(phi), r * libm::sinf(phi), z)
}

/// A direction about +Z, uniform over the cap with the given cosine of its half angle; density 1/(2π(1−cos)).
pub fn cap(p: Vec2, cos_max: f32) -> Vec3 {
    let z = 1.0 - p.x * (1.0 - cos_max);
    let r = (1.0 - z * z).max(0.0).sqrt();
    let phi = TAU * p.y;
    Vec3::new(r * libm::cosf(phi), r * libm::sinf(phi), z)
}

/// Uniform barycentric coordinates (u, v) of a triangle's second and third corner.
pub fn triangle(p: Vec2) -> (f32, f32) {
    let s = p.x.sqrt();
    (s * (1.0 - p.y), s * p.y)
}

/// A number in [0, 1] with density linear from `a` at 0 to `b` at 1, not both 0.
pub fn linear(a: f32, b: f32, p: f32) -> f32 {
    let root = (a * a + p * (b * b - a * a)).max(0.0).sqrt();
    let t = p * (a + b) / (a + root);
    if t.is_finite() { t.clamp(0.0, 1.0) } else { p }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cosine_lattice_integrates_the_cosine_exactly_enough() {
        let n = 1024;
        let mean: f32 = (0..n).map(|i| cosine_hemisphere(r2(i, Vec2::ZERO)).z).sum::<f32>() / n as f32;
        assert!((mean - 2.0 / 3.0).abs() < 1e-3, "{mean}");
    }

    #[test]
    fn a_basis_is_orthonormal_everywhere() {
        for i in 0..1000 {
            let n = sphere(r2(i, Vec2::splat(0.3)));
            let m = basis(n);
            assert!((m.transpose() * m).abs_diff_eq(Mat3::IDENTITY, 1e-5));
        }
    }
}
