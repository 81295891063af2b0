//! Which receivers are inside geometry, and where such a receiver can go.
//!
//! A texel whose centre lies in a wall, under a box that stands on the floor or in a closed gap sees nothing but backs
//! and surfaces in contact. It must never be a node of an interpolation nor count in a metric. The test sends
//! [`RAYS`] rays over the receiver's hemisphere in proportion to the cosine; the receiver is *buried* when three
//! quarters of them meet a single-sided back, at any distance, or, nearer than [`NEAR`] of its footprint, a
//! double-sided back or a lid (a surface that faces the receiver's). Walls beside a receiver, however near, do not bury
//! it. Veils and holes are looked through: what stands behind glass is not buried.

use glam::{Vec2, Vec3};

use crate::{
    gather::Receiver,
    rays::{Hit, OFFSET, Rays, leave},
    sampling,
};

/// Rays that decide about one receiver.
const RAYS: u32 = 16;
/// Of these, so many have to be stopped at once.
const STOPPED: u32 = 12;
/// What is nearer than this share of the footprint is in contact.
const NEAR: f32 = 0.7;
/// A lid's normal and the receiver's have at most this cosine.
const LID: f32 = -0.5;
/// A surface that passes more than this share of the light is looked through.
const CLEAR: f32 = 0.5;
/// Rings of places tried by [`sides`], as shares of the footprint, and places on each.
const RINGS: [f32; 3] = [0.15, 0.3, 0.45];
const PLACES: u32 = 8;
/// Fewest free places of a side that is worth a look, of 24.
const WORTH: usize = 4;
/// How far above their surface places look for each other, and places on it are looked for, as a share of the footprint.
const LIFT: f32 = 0.1;

/// Whether a receiver is inside geometry or in contact with something that covers it. One without a normal, as on a
/// degenerate triangle, is.
pub fn is_buried(rays: &Rays, receiver: &Receiver) -> bool {
    if !(receiver.position.is_finite() && receiver.normal.is_normalized()) {
        return true;
    }
    let frame = sampling::basis(receiver.normal);
    let shift = sampling::unit2(sampling::mix(receiver.seed));
    let mut stopped = 0;
    for i in 0..RAYS {
        // Neither outcome can change any more.
        if stopped >= STOPPED || stopped + (RAYS - i) < STOPPED {
            break;
        }
        let direction = (frame * sampling::cosine_hemisphere(sampling::r2(i, shift))).normalize();
        stopped += u32::from(is_stopped(rays, receiver, direction));
    }
    stopped >= STOPPED
}

fn is_stopped(rays: &Rays, receiver: &Receiver, direction: Vec3) -> bool {
    let origin = leave(receiver.position, receiver.normal, direction);
    first_solid(rays, origin, direction, f32::INFINITY).is_some_and(|hit| {
        let is_inside = hit.back && !rays.geometry.material(hit.triangle).double_sided;
        let is_near = || hit.distance < NEAR * receiver.footprint;
        let is_lid = || rays.geometry.triangles[hit.triangle as usize].normal.dot(receiver.normal) < LID;
        is_inside || ((hit.back || is_lid()) && is_near())
    })
}

/// The first surface along a ray that is not looked through.
fn first_solid(rays: &Rays, origin: Vec3, direction: Vec3, max: f32) -> Option<Hit> {
    let mut first: Option<Hit> = None;
    rays.first_hits(origin, direction, max, |hit, _| {
        let surface = || rays.geometry.surface(hit.triangle, hit.u, hit.v, 0.0);
        if first.is_none() && (rays.all_solid() || surface().transmittance.max_element() <= CLEAR) {
            first = Some(*hit);
        }
    });
    first
}

/// The sides of what buries a receiver, each with the nearest free place of its footprint there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sides {
    /// The side with the most free places.
    pub larger: Option<Receiver>,
    /// The next one, where it has [`WORTH`] free places.
    pub smaller: Option<Receiver>,
}

/// Where the light of a buried receiver can be taken from. A wall that stands on its footprint and is thinner than that
/// leaves free places on two sides, whose light may have nothing in common. Places are on one side when a way leads from
/// the one to the other, from place to place, with nothing across it a little above the surface.
pub fn sides(rays: &Rays, receiver: &Receiver) -> Sides {
    if !(receiver.position.is_finite() && receiver.normal.is_normalized()) {
        return Sides::default();
    }
    // The free places of each side by their number, which grows with the distance. Where distances are equal, rounding
    // must not choose.
    let mut sides: Vec<Vec<(u32, Receiver)>> = Vec::new();
    for (number, place) in (0..).zip(places(receiver)) {
        let moved = on_surface(rays, receiver, place).map(|position| Receiver { position, ..*receiver });
        let Some(moved) = moved.filter(|moved| !is_buried(rays, moved)) else { continue };
        let is_near = |side: &mut Vec<(u32, Receiver)>| side.iter().any(|(_, r)| see_each_other(rays, r, &moved));
        let mut joined: Vec<(u32, Receiver)> = sides.extract_if(.., is_near).flatten().collect();
        joined.push((number, moved));
        joined.sort_unstable_by_key(|(number, _)| *number);
        sides.push(joined);
    }
    sides.sort_by_key(|side| (std::cmp::Reverse(side.len()), side.first().map(|(number, _)| *number)));
    let nearest = |side: &Vec<(u32, Receiver)>| side.first().map(|(_, nearest)| *nearest);
    Sides {
        larger: sides.first().and_then(nearest),
        smaller: sides.get(1).filter(|side| side.len() >= WORTH).and_then(nearest),
    }
}

/// Rings of places about a receiver in its plane, from the nearest to the farthest.
fn places(receiver: &Receiver) -> impl Iterator<Item = Vec3> {
    let (at, size) = (receiver.position, receiver.footprint);
    let frame = sampling::basis(receiver.normal);
    RINGS.into_iter().flat_map(move |ring| {
        (0..PLACES).map(move |i| {
            let turn = std::f32::consts::TAU * i as f32 / PLACES as f32;
            let step = Vec2::new(libm::cosf(turn), libm::sinf(turn)) * ring * size;
            at + frame * step.extend(0.0)
        })
    })
}

fn see_each_other(rays: &Rays, a: &Receiver, b: &Receiver) -> bool {
    let lift = a.normal * (LIFT * a.footprint);
    let (from, way) = (a.position + lift, b.position - a.position);
    let distance = way.length();
    distance <= 0.0 || rays.transmittance(from, way / distance, distance).max_element() > CLEAR
}

/// The front that a plumb ray from `lift` above a place meets first.
fn plumb(rays: &Rays, place: Vec3, normal: Vec3, lift: f32) -> Option<Hit> {
    rays.closest(place + normal * lift, -normal, 2.0 * lift).filter(|hit| !hit.back)
}

/// The point of the receiver's surface at `place`, if the surface reaches there: a plumb ray from a little above it
/// must come down on the same instance, on a front that looks about the same way.
fn on_surface(rays: &Rays, receiver: &Receiver, place: Vec3) -> Option<Vec3> {
    let triangle = |hit: &Hit| &rays.geometry.triangles[hit.triangle as usize];
    let own = plumb(rays, receiver.position, receiver.normal, OFFSET)?;
    let hit = plumb(rays, place, receiver.normal, LIFT * receiver.footprint)?;
    let t = triangle(&hit);
    let is_same = t.instance == triangle(&own).instance && t.normal.dot(receiver.normal) > 0.9;
    is_same.then(|| t.at(hit.u, hit.v))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use luxel_scene::{Alpha, Material, Scene, build::Builder};

    use super::*;
    use crate::geometry::Geometry;

    /// A floor of side 2 about the origin, looking up; instance 0.
    fn floor() -> (Builder, usize) {
        let mut b = Builder::new("floor");
        let grey = b.matte(Vec3::splat(0.5));
        b.quad("floor", Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0, grey);
        (b, grey)
    }

    const TEXEL: f64 = 0.05;

    /// The receiver itself, or the nearest free place on its larger side.
    fn unocclude(rays: &Rays, receiver: &Receiver) -> Option<Receiver> {
        if is_buried(rays, receiver) { sides(rays, receiver).larger } else { Some(*receiver) }
    }

    /// A texel of the floor at (x, z).
    fn texel(geometry: &Geometry, x: f64, z: f64) -> Receiver {
        Receiver {
            position: geometry.frame.point(DVec3::new(x, 0.0, z)),
            normal: Vec3::Y,
            shading_normal: Vec3::Y,
            footprint: geometry.frame.length(TEXEL),
            seed: sampling::combine((x * 1e4) as i64 as u64, (z * 1e4) as i64 as u64),
        }
    }

    fn verdicts(scene: &Scene, places: &[(f64, f64)]) -> Vec<bool> {
        let geometry = Geometry::new(scene);
        let rays = Rays::new(&geometry);
        places.iter().map(|&(x, z)| is_buried(&rays, &texel(&geometry, x, z))).collect()
    }

    #[test]
    fn the_floor_under_a_thin_wall_is_buried() {
        for bottom in [0.0, 1e-3, -0.1] {
            let (mut b, grey) = floor();
            b.cuboid("wall", Vec3::new(-0.005, bottom, -1.0), Vec3::new(0.005, 1.0, 1.0), grey, false);
            let places: Vec<_> = (-9..=9).map(|i| (0.0, 0.1 * f64::from(i))).collect();
            assert_eq!(verdicts(&b.build(), &places), [true; 19], "bottom at {bottom}");
        }
    }

    #[test]
    fn the_floor_under_a_box_is_buried_and_beside_it_is_not() {
        let (mut b, grey) = floor();
        b.cuboid("box", Vec3::new(-0.5, 0.0, -0.5), Vec3::splat(0.5), grey, false);
        let scene = b.build();
        let inside: Vec<_> = (-4..=4).map(|i| (0.1 * f64::from(i), 0.4)).collect();
        assert_eq!(verdicts(&scene, &inside), [true; 9]);
        let beside: Vec<_> = (-9..=9).map(|i| (0.1 * f64::from(i), 0.5 + 0.5 * TEXEL)).collect();
        assert_eq!(verdicts(&scene, &beside), [false; 19]);
    }

    /// Without a bottom, and with both sides: only its nearness tells that this is no room.
    #[test]
    fn the_floor_in_a_thin_double_sided_wall_is_buried() {
        let (mut b, _) = floor();
        let sheet = b.material(Material { double_sided: true, ..Material::default() });
        b.cuboid("wall", Vec3::new(-0.005, -0.1, -1.0), Vec3::new(0.005, 1.0, 1.0), sheet, false);
        assert_eq!(verdicts(&b.build(), &[(0.0, 0.1), (0.002, 0.5), (0.03, 0.5)]), [true, true, false]);
    }

    #[test]
    fn texels_in_the_corners_of_a_room_are_open() {
        let mut b = Builder::new("room");
        let grey = b.matte(Vec3::splat(0.5));
        b.cuboid("room", Vec3::new(-1.0, 0.0, -1.0), Vec3::ONE, grey, true);
        let near = 1.0 - 0.5 * TEXEL;
        let mut places = vec![(near, near), (-near, near), (near, 0.3), (0.0, 0.0)];
        // Right in the corner, a tenth of a texel from either wall.
        places.push((1.0 - 0.1 * TEXEL, 1.0 - 0.1 * TEXEL));
        assert_eq!(verdicts(&b.build(), &places), [false; 5]);
    }

    #[test]
    fn both_sides_of_a_double_sided_sheet_are_open() {
        let mut b = Builder::new("sheet");
        let sheet = b.material(Material { double_sided: true, ..Material::default() });
        b.quad("sheet", Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0, sheet);
        b.quad("above", Vec3::new(-1.0, 1.0, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0, sheet);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let front = texel(&geometry, 0.1, 0.2);
        let back = Receiver { normal: -Vec3::Y, shading_normal: -Vec3::Y, ..front };
        assert!(!is_buried(&rays, &front) && !is_buried(&rays, &back));
    }

    #[test]
    fn what_stands_in_a_glass_case_is_open() {
        let (mut b, _) = floor();
        let glass =
            b.material(Material { base_color: Vec3::ONE.extend(0.1), alpha: Alpha::Blend, ..Material::default() });
        b.cuboid("case", Vec3::new(-0.5, 0.0, -0.5), Vec3::splat(0.5), glass, false);
        assert_eq!(verdicts(&b.build(), &[(0.1, 0.1), (-0.3, 0.2)]), [false; 2]);
    }

    #[test]
    fn a_buried_texel_moves_out_from_under_a_thin_wall_and_stays_on_its_floor() {
        let (mut b, grey) = floor();
        b.cuboid("wall", Vec3::new(-0.005, 0.0, -1.0), Vec3::new(0.005, 1.0, 1.0), grey, false);
        b.cuboid("box", Vec3::new(0.3, 0.0, -0.5), Vec3::new(0.9, 0.5, 0.5), grey, false);
        b.quad("rug", Vec3::new(-0.9, 2e-3, 0.3), Vec3::X * 0.6, Vec3::Z * -0.6, grey);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let before = texel(&geometry, 0.0, 0.1);
        let after = unocclude(&rays, &before).unwrap();
        let shift = (after.position - before.position) / before.footprint;
        assert!(shift.y == 0.0 && shift.x.abs() > 0.1 && shift.length() < 0.5, "{shift}");
        assert!(!is_buried(&rays, &after));
        assert!(unocclude(&rays, &texel(&geometry, 0.6, 0.0)).is_none(), "deep under the box there is no way out");
        let rug = geometry.frame.point(DVec3::new(-0.6, 2e-3, 0.0)).y;
        let before = texel(&geometry, -0.6, 0.0);
        assert!(is_buried(&rays, &before) && rug > before.position.y);
        assert!(unocclude(&rays, &before).is_none(), "a floor's texel does not climb onto the rug that hides it");
        let open = texel(&geometry, -0.2, 0.0);
        assert_eq!(unocclude(&rays, &open).unwrap().position, open.position);
        // At the rim of the floor, half of the footprint hangs over its edge.
        let wall = texel(&geometry, 0.0, 1.0 - 0.1 * TEXEL);
        let moved = geometry.frame.world(unocclude(&rays, &wall).unwrap().position);
        assert!(moved.z <= 1.0 && moved.x.abs() > 0.005, "{moved}");
    }

    #[test]
    fn a_thin_wall_has_two_sides_and_the_larger_comes_first() {
        let (mut b, grey) = floor();
        b.cuboid("wall", Vec3::new(-0.005, 0.0, -1.0), Vec3::new(0.005, 1.0, 1.0), grey, false);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        for (x, is_right) in [(-0.003, false), (0.003, true)] {
            let found = sides(&rays, &texel(&geometry, x, 0.1));
            let at = |r: Option<Receiver>| geometry.frame.world(r.unwrap().position).x;
            assert_eq!((at(found.larger) > 0.0, at(found.smaller) > 0.0), (is_right, !is_right));
            assert!(at(found.larger).abs() > 0.005 && at(found.smaller).abs() > 0.005);
        }
    }

    #[test]
    fn what_lies_round_a_post_is_one_side() {
        let (mut b, grey) = floor();
        b.cuboid("post", Vec3::new(-0.005, 0.0, -0.005), Vec3::new(0.005, 1.0, 0.005), grey, false);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let found = sides(&rays, &texel(&geometry, 0.0, 0.0));
        assert!(found.larger.is_some() && found.smaller.is_none(), "{found:?}");
    }

    #[test]
    fn a_receiver_without_a_normal_is_buried() {
        let (b, _) = floor();
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let mut receiver = texel(&geometry, 0.0, 0.0);
        receiver.normal = Vec3::ZERO;
        assert!(is_buried(&rays, &receiver) && unocclude(&rays, &receiver).is_none());
    }
}
