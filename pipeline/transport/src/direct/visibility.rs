//! Which points of a target a receiver sees.

use glam::{Vec2, Vec3};

use super::{
    cone::Cone,
    occluders::{Occluders, Passage, VEIL},
    target::{LANES, Plane, Points},
};
use crate::{Rgb, rays::Rays};

/// What is known about what stands between a tile of receivers and a light.
#[derive(Clone, Copy, Debug)]
pub enum Between<'c> {
    /// Nothing: every point is seen.
    Nothing,
    /// At most these occluders.
    These(&'c [u32]),
    /// Too many to list: every point is asked for by a segment through the occluders' tree.
    Many,
    /// Not asked: every point is asked for by a shadow ray.
    Unknown,
}

/// The view of a block of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// Nothing in the way at all.
    Free,
    /// Some points are hidden or veiled; see the lanes.
    Partial,
    /// All points are hidden by solid surfaces.
    Dark,
}

/// What occluders do to a whole polygon.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Screen {
    /// None of them reaches its view.
    Misses,
    /// A single solid one hides all of it.
    Covers,
    Touches,
}

/// Visibility of a block's points, as numbers to multiply weights with.
pub struct Lanes {
    /// 0 where something solid is in the way.
    pub open: [f32; LANES],
    /// 0 where a veil is in the way: the point needs a ray that knows how much it lets pass.
    pub clear: [f32; LANES],
}

/// Asks the occluders, and where those cannot tell, the rays.
pub struct Sight<'a> {
    pub occluders: Occluders<'a>,
    pub rays: &'a Rays<'a>,
}

impl Sight<'_> {
    /// Looks from `eye` at the points of a target.
    pub fn look(&self, eye: Vec3, plane: &Plane, points: &Points, between: Between, lanes: &mut Lanes) -> View {
        lanes.open = [1.0; LANES];
        lanes.clear = [1.0; LANES];
        match between {
            Between::Nothing => return View::Free,
            Between::Unknown => {
                lanes.clear = [0.0; LANES];
                return View::Partial;
            }
            Between::These(list) => {
                for &id in list {
                    let Some(cone) = Cone::new(eye, self.occluders.corners(id), plane, &points.corners) else {
                        continue;
                    };
                    cone.shade(points, if id & VEIL == 0 { &mut lanes.open } else { &mut lanes.clear });
                }
            }
            Between::Many => {
                let mut last = None;
                for i in 0..points.count {
                    match self.occluders.passage(eye, plane, points, i, &mut last) {
                        Passage::Open => {}
                        Passage::Veiled => lanes.clear[i] = 0.0,
                        Passage::Blocked => lanes.open[i] = 0.0,
                    }
                }
            }
        }
        let (mut seen, mut most) = (1.0f32, 0.0f32);
        for i in 0..points.count {
            seen = seen.min(lanes.open[i] * lanes.clear[i]);
            most = most.max(lanes.open[i]);
        }
        match (seen == 1.0, most == 0.0) {
            (true, _) => View::Free,
            (_, true) => View::Dark,
            _ => View::Partial,
        }
    }

    /// What the occluders surely do to a whole convex polygon, as far as a list tells.
    pub fn screen(&self, eye: Vec3, plane: &Plane, corners: &[Vec2; 4], between: Between) -> Screen {
        let list = match between {
            Between::Nothing => return Screen::Misses,
            Between::These(list) => list,
            Between::Many | Between::Unknown => return Screen::Touches,
        };
        let mut screen = Screen::Misses;
        for &id in list {
            if let Some(cone) = Cone::new(eye, self.occluders.corners(id), plane, corners) {
                if id & VEIL == 0 && corners.iter().all(|c| cone.hides(c.x, c.y)) {
                    return Screen::Covers;
                }
                screen = Screen::Touches;
            }
        }
        screen
    }

    /// The share of light from one point of a target that arrives, and the rays that it took to know.
    pub fn transmittance(&self, eye: Vec3, plane: &Plane, points: &Points, lanes: &Lanes, at: usize) -> (Rgb, u32) {
        if lanes.open[at] == 0.0 {
            return (Rgb::ZERO, 0);
        }
        if lanes.clear[at] == 1.0 {
            return (Rgb::ONE, 0);
        }
        let to = plane.at(points.u[at], points.v[at]);
        let distance = to.length();
        if distance == 0.0 {
            return (Rgb::ONE, 0);
        }
        (self.rays.transmittance(eye, to / distance, distance), 1)
    }
}
