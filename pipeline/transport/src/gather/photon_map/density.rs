//! Irradiance from the density of photons (Jensen 1996), found once at every photon and looked up from there
//! (Christensen 1999).
//!
//! ```text
//! E(x) ≈ Σⱼ Φⱼ / A(x, r)      over x itself and the K − 1 photons nearest to it, r the distance of the K-th
//! ```
//!
//! That has no bias where photons fall independently and evenly with density λ: a point that asks for the nearest photon
//! lies in an empty disc of mean area 1/λ, which lacks one photon, and the photon x itself makes up for it. Only photons in a flat cylinder count, of radius r about x and ±0.3 r high, whose surfaces look the same way.
//!
//! A(x, r) is not πr² but the part of the disc that really is surface, from short probe rays: across the cylinder's upper
//! end, then down. It ends at edges and walls, so corners are not dark. Where a probe meets a wall, every photon has to
//! be visible along that way too.
//!
//! **Bias.** The estimate is a mean of E over the disc: E + r²∇²E/8 + …, so detail finer than r is lost: r falls with the
//! root of the density. The area at an edge is a sum of a few probes: a right angle is off by some per cent, a slender
//! strip by more. Walls thinner than what the probes see, or that none of them meets, let light leak within r.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use super::{
    nearest::{Found, Nearest},
    trace::Deposit,
};
use crate::{
    Rgb,
    rays::Rays,
    sampling::{basis, mix, r2, unit2},
};

/// Photons of one estimate.
const COUNT: usize = 48;

/// Probes of the disc.
const PROBES: u32 = 24;

/// Half height of the cylinder in radii: more than the sagitta of what counts as one surface.
const HEIGHT: f32 = 0.3;

/// Least cosine between normals of one surface.
const FACING: f32 = 0.7;

/// Photons per unit of parallel work.
const CHUNK: usize = 256;

/// Irradiance at photons.
pub(super) struct Density {
    tree: Nearest,
    points: Vec<Estimate>,
}

#[derive(Clone, Copy)]
struct Estimate {
    position: Vec3,
    normal: Vec3,
    irradiance: Rgb,
    radius: f32,
}

impl Density {
    pub fn new(rays: &Rays, deposits: &[Deposit], progress: &dyn Progress) -> Result<Self, Cancelled> {
        let mut tree = Nearest::new(deposits.iter().map(|d| d.light.light.position), progress)?;
        let maker = Maker { rays, deposits, tree: &tree };
        let chunks = deposits.par_chunks(CHUNK).enumerate().map(|(chunk, part)| {
            let mut found = Vec::with_capacity(COUNT);
            progress.check()?;
            let first = (chunk * CHUNK) as u32;
            Ok((first..first + part.len() as u32).map(|i| maker.estimate(i, &mut found)).collect())
        });
        let points = chunks.collect::<Result<Vec<Vec<Estimate>>, Cancelled>>()?.concat();
        tree.bound(|i| points[i as usize].radius * points[i as usize].radius);
        Ok(Self { tree, points })
    }

    /// Irradiance [lux] at a point of a surface on the side of `normal`: that of the nearest photon of the same surface
    /// whose disc holds the point. None where there is none, which is dark.
    pub fn at(&self, point: Vec3, normal: Vec3, found: &mut Vec<Found>) -> Option<Rgb> {
        let accept = |i: u32| {
            let p = &self.points[i as usize];
            let d = p.position - point;
            p.normal.dot(normal) > FACING
                && d.length_squared() <= p.radius * p.radius
                && normal.dot(d).abs() <= HEIGHT * p.radius
        };
        self.tree.find(point, 1, f32::INFINITY, accept, found);
        found.first().map(|f| self.points[f.point as usize].irradiance)
    }
}

struct Maker<'m> {
    rays: &'m Rays<'m>,
    deposits: &'m [Deposit],
    tree: &'m Nearest,
}

impl Maker<'_> {
    fn estimate(&self, i: u32, found: &mut Vec<Found>) -> Estimate {
        let own = &self.deposits[i as usize].light;
        let (position, normal) = (own.light.position, own.light.normal);
        let accept = |j: u32| j != i && self.deposits[j as usize].light.light.normal.dot(normal) > FACING;
        self.tree.find(position, COUNT, f32::INFINITY, accept, found);
        let Some(last) = found.pop() else {
            return Estimate { position, normal, irradiance: Rgb::ZERO, radius: 0.0 };
        };
        let radius = last.square.sqrt();
        let lift = HEIGHT * radius * normal;
        let (share, divided) = self.share(position, normal, radius, own.seed);
        let counts = |f: &&Found| {
            let at = self.deposits[f.point as usize].light.light.position;
            let flat = (at - position).dot(normal).abs() <= HEIGHT * radius;
            flat && (!divided || self.is_open(position + lift, at - (at - position).dot(normal) * normal + lift))
        };
        let others: Rgb = found.iter().filter(counts).map(|f| self.deposits[f.point as usize].flux).sum();
        let flux = self.deposits[i as usize].flux + others;
        let area = PI * radius * radius * share;
        let irradiance = if area > 0.0 { flux / area } else { Rgb::ZERO };
        Estimate { position, normal, irradiance, radius }
    }

    /// Area of the surface in the cylinder over that of its disc, and whether anything stands in it.
    fn share(&self, center: Vec3, normal: Vec3, radius: f32, seed: u64) -> (f32, bool) {
        let axes = basis(normal);
        let lift = HEIGHT * radius * normal;
        let shift = unit2(mix(seed));
        let (mut sum, mut divided) = (0.0, false);
        for i in 0..PROBES {
            // A lattice in the azimuth, strata in the squared radius: the first is next to the centre.
            let at = Vec2::new((i as f32 + 0.5) / PROBES as f32, r2(i, shift).y);
            let (r, phi) = (radius * at.x.sqrt(), std::f32::consts::TAU * at.y);
            let across = axes.x_axis * (r * libm::cosf(phi)) + axes.y_axis * (r * libm::sinf(phi));
            let top = center + across + lift;
            if !self.is_open(center + lift, top) {
                divided = true;
                continue;
            }
            let Some(hit) = self.rays.closest(top, -normal, 2.0 * HEIGHT * radius) else { continue };
            let found = self.rays.geometry.triangles[hit.triangle as usize].normal;
            let cosine = if hit.back { -found.dot(normal) } else { found.dot(normal) };
            // What leans has more area than its shadow on the disc.
            sum += if cosine > FACING { 1.0 / cosine } else { 0.0 };
        }
        (sum / PROBES as f32, divided)
    }

    fn is_open(&self, from: Vec3, to: Vec3) -> bool {
        let d = to - from;
        let length = d.length();
        length <= 0.0 || self.rays.transmittance(from, d / length, length).max_element() > 0.0
    }
}
