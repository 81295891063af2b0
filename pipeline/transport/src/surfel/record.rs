//! The record of one surfel: 52 bytes, because a fine grid has millions of them.
//!
//! Centroid, normal and area are f32, since the plane tests of the sweep work on their differences. What only scales
//! light or names a place on a triangle takes the bits that a bake can see:
//!
//! | field | bits | steps |
//! |---|---|---|
//! | voxel | 3 × 16, signed | exact: a side has at most [`MAX_SIDE`](super::MAX_SIDE) + 2 voxels |
//! | albedo | 3 × 21 | [`MAX_ALBEDO`] / (2²¹ − 1), an error of 2.4·10⁻⁷; 0 and [`MAX_ALBEDO`] are exact, equal bands stay equal |
//! | back | 1 | |
//! | fill | 16 | 1 / 65535, rounded up: 1 is exact, and nothing that is there becomes 0 |
//! | u, v | 2 × 16 | 1 / 65535 of the triangle's edges, and u + v ≤ 1: the point stays on its triangle |
//!
//! Few surfels emit: their radiance lies beside the list ([`Surfels::emission`](super::Surfels::emission)).

use bytemuck::{Pod, Zeroable};
use glam::{IVec3, Vec3};
use luxel_scene::material::MAX_ALBEDO;

use crate::{Rgb, geometry::Geometry};

/// One oriented patch of surface in one voxel. Lengths are in frame units.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Surfel {
    /// Area-weighted centroid of the clipped fragments; on a curved surface it lies slightly under it.
    pub centroid: Vec3,
    /// Unit area-weighted normal.
    pub normal: Vec3,
    /// Exact clipped area (times coverage), squared frame units.
    pub area: f32,
    /// The triangle of the surfel's own point ([`Self::u`], [`Self::v`]).
    pub triangle: u32,
    /// Three bands of 21 bits from the lowest bit on, then the flag of the back side.
    albedo: [u32; 2],
    voxel: [i16; 3],
    fill: u16,
    point: [u16; 2],
}

/// What a surfel is made of, spelled out; [`Surfel::from`] packs it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    pub voxel: IVec3,
    pub centroid: Vec3,
    pub normal: Vec3,
    pub area: f32,
    pub albedo: Rgb,
    pub fill: f32,
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
    pub back: bool,
}

const ALBEDO_BITS: u32 = 21;
const ALBEDO_STEPS: u64 = (1 << ALBEDO_BITS) - 1;
const BACK: u32 = 1 << 31;
const STEPS: f32 = 65535.0;

impl From<Patch> for Surfel {
    fn from(p: Patch) -> Self {
        let albedo = pack_albedo(p.albedo);
        Self {
            centroid: p.centroid,
            normal: p.normal,
            area: p.area,
            triangle: p.triangle,
            albedo: [albedo as u32, (albedo >> 32) as u32 | if p.back { BACK } else { 0 }],
            voxel: p.voxel.to_array().map(|c| c.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16),
            // The slack keeps a share that has been rounded already where it is.
            fill: (p.fill * STEPS - 0.01).ceil().clamp(1.0, STEPS) as u16,
            point: pack_point(p.u, p.v),
        }
    }
}

impl Surfel {
    pub fn voxel(&self) -> IVec3 {
        IVec3::from(self.voxel.map(i32::from))
    }

    /// The surfel's own point on its triangle, and the unit normal of its side there: where light is sampled, because
    /// the centroid of a curved surface lies under it.
    pub fn place(&self, geometry: &Geometry) -> (Vec3, Vec3) {
        let triangle = &geometry.triangles[self.triangle as usize];
        let normal = if self.back() { -triangle.normal } else { triangle.normal };
        (triangle.at(self.u(), self.v()), normal)
    }

    /// Area-weighted Lambertian albedo ρ, at most [`MAX_ALBEDO`].
    #[inline]
    pub fn albedo(&self) -> Rgb {
        let bits = u64::from(self.albedo[1]) << 32 | u64::from(self.albedo[0]);
        // In f64, so that the largest step gives the largest albedo to the bit.
        let band = |b: u32| ((bits >> (b * ALBEDO_BITS) & ALBEDO_STEPS) as f64 * ALBEDO_STEP) as f32;
        Rgb::new(band(0), band(1), band(2))
    }

    /// Whether the three bands of the albedo are equal.
    pub fn is_grey(&self) -> bool {
        let albedo = self.albedo();
        albedo.x == albedo.y && albedo.y == albedo.z
    }

    /// Share of its plane within the voxel that the surfel fills times its opacity, in (0, 1]: the share of the lines
    /// through that plane that it stops.
    pub fn fill(&self) -> f32 {
        f32::from(self.fill) / STEPS
    }

    /// [`Self::fill`] in steps of 1/65535.
    pub fn fill_steps(&self) -> u16 {
        self.fill
    }

    /// Barycentric coordinate of the triangle's second corner at a point of the surfel that really is there, for
    /// shadow rays; a centroid lies under a curved surface.
    pub fn u(&self) -> f32 {
        f32::from(self.point[0]) / STEPS
    }

    /// The same of the third corner.
    pub fn v(&self) -> f32 {
        f32::from(self.point[1]) / STEPS
    }

    /// Whether the surfel is the back side of its triangle.
    pub fn back(&self) -> bool {
        self.albedo[1] & BACK != 0
    }

    /// Whether bytes from elsewhere make a surfel of a grid of so many voxels.
    pub(crate) fn is_sound(&self, size: IVec3) -> bool {
        let placed = self.centroid.is_finite() && (self.normal.length() - 1.0).abs() < 1e-3;
        let on_triangle = u32::from(self.point[0]) + u32::from(self.point[1]) <= u32::from(u16::MAX);
        let sized = self.area >= 0.0 && self.area.is_finite() && self.fill > 0;
        let inside = self.voxel().min_element() >= 0 && self.voxel().cmplt(size).all();
        inside && placed && on_triangle && sized
    }
}

const ALBEDO_STEP: f64 = MAX_ALBEDO as f64 / ALBEDO_STEPS as f64;

fn pack_albedo(albedo: Rgb) -> u64 {
    let band = |rho: f32| (f64::from(rho.clamp(0.0, MAX_ALBEDO)) / ALBEDO_STEP).round() as u64;
    (0..3).fold(0, |bits, b| bits | band(albedo[b]) << (b as u32 * ALBEDO_BITS))
}

fn pack_point(u: f32, v: f32) -> [u16; 2] {
    let step = |c: f32| (c.clamp(0.0, 1.0) * STEPS).round() as u16;
    [step(u), step(v).min(u16::MAX - step(u))]
}

/// The point of a triangle that a surfel can hold nearest to this one.
pub fn holdable(u: f32, v: f32) -> (f32, f32) {
    let [u, v] = pack_point(u, v);
    (f32::from(u) / STEPS, f32::from(v) / STEPS)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn patch() -> Patch {
        Patch {
            voxel: IVec3::new(1, 2049, 7),
            centroid: Vec3::new(0.5, -1024.25, 3.0),
            normal: Vec3::Y,
            area: 2.5,
            albedo: Rgb::splat(0.5),
            fill: 1.0,
            triangle: 77,
            u: 0.25,
            v: 0.5,
            back: true,
        }
    }

    #[test]
    fn a_surfel_takes_52_bytes() {
        assert_eq!(size_of::<Surfel>(), 52);
    }

    #[test]
    fn what_is_exact_stays_exact() {
        let s = Surfel::from(patch());
        assert_eq!((s.voxel(), s.centroid, s.normal), (patch().voxel, patch().centroid, patch().normal));
        assert_eq!((s.area, s.triangle, s.back(), s.fill()), (2.5, 77, true, 1.0));
        for albedo in [0.0, MAX_ALBEDO] {
            assert_eq!(Surfel::from(Patch { albedo: Rgb::splat(albedo), ..patch() }).albedo(), Rgb::splat(albedo));
        }
        // What is partial stays partial, and what is there stops some line.
        assert!(Surfel::from(Patch { fill: 0.9999, ..patch() }).fill() < 1.0);
        assert!(Surfel::from(Patch { fill: 1e-9, ..patch() }).fill() > 0.0);
        assert!(!Surfel::from(Patch { back: false, albedo: Rgb::splat(MAX_ALBEDO), ..patch() }).back());
    }

    proptest! {
        #[test]
        fn packing_loses_next_to_nothing(
            rho in prop::array::uniform3(0.0f32..=MAX_ALBEDO), fill in 1e-6f32..=1.0, p in (0.0f32..=1.0, 0.0f32..=1.0)
        ) {
            let (u, v) = (p.0, p.1 * (1.0 - p.0));
            let s = Surfel::from(Patch { albedo: rho.into(), fill, u, v, ..patch() });
            prop_assert!((s.albedo() - Rgb::from(rho)).abs().max_element() < 2.7e-7);
            prop_assert!(s.albedo().max_element() <= MAX_ALBEDO);
            prop_assert!((s.fill() - fill).abs() < 1.6e-5);
            prop_assert!((s.u() - u).abs() < 8e-6 && (s.v() - v).abs() < 1.6e-5);
            prop_assert!(s.u() + s.v() <= 1.0);
            prop_assert!(s.is_sound(IVec3::splat(2050)));
            // What has been packed once does not change any more.
            let again = Patch { albedo: s.albedo(), fill: s.fill(), u: s.u(), v: s.v(), ..patch() };
            prop_assert_eq!(Surfel::from(again), s);
            prop_assert_eq!(holdable(u, v), (s.u(), s.v()));
            let grey = Patch { albedo: Rgb::splat(rho[0]), ..patch() };
            prop_assert!(Surfel::from(grey).is_grey());
        }
    }
}
