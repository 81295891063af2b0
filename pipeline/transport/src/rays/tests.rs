use std::time::Duration;

use glam::{DAffine3, DVec3, Vec2};
use luxel_scene::{Mesh, Scene, Texture, TextureRef, build::Builder};
use obvhs::{BvhBuildParams, bvh2::builder::build_bvh2};

use super::*;
use crate::sampling;

const GREY: Vec3 = Vec3::splat(0.5);

fn direction(i: u32) -> Vec3 {
    sampling::sphere(sampling::r2(i, Vec2::new(0.37, 0.61)))
}

/// A point inside the unit ball of radius `r` about the frame's origin.
fn inside(i: u32, r: f32) -> Vec3 {
    let hash = sampling::mix(u64::from(i));
    sampling::sphere(sampling::unit2(hash)) * r * sampling::unit(sampling::mix(hash))
}

fn escapes(scene: &Scene, radius: f32, count: u32) -> usize {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    (0..count).filter(|&i| rays.closest(inside(i, radius), direction(i), f32::INFINITY).is_none()).count()
}

#[test]
fn a_box_is_hit_from_inside_on_its_front() {
    let mut b = Builder::new("box");
    let white = b.matte(GREY);
    b.cuboid("room", Vec3::ZERO, Vec3::ONE, white, true);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let hit = rays.closest(Vec3::ZERO, Vec3::X, f32::INFINITY).unwrap();
    assert!(!hit.back);
    assert!((hit.distance - 2048.0).abs() < 1e-2, "{}", hit.distance);
    assert_eq!(rays.transmittance(Vec3::ZERO, Vec3::X, 2000.0), Rgb::ONE);
    assert_eq!(rays.transmittance(Vec3::ZERO, Vec3::X, 3000.0), Rgb::ZERO);
}

#[test]
fn no_ray_slips_out_of_a_closed_mesh() {
    let mut b = Builder::new("box");
    let white = b.matte(GREY);
    b.cuboid("room", Vec3::ZERO, Vec3::new(1.0, 0.7, 0.4), white, true);
    assert_eq!(escapes(&b.build(), 800.0, 500_000), 0);
    let mut b = Builder::new("sphere");
    let white = b.matte(GREY);
    b.sphere("room", Vec3::splat(3.3), 1.0, 123, white, true);
    let tilt = DAffine3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.7);
    assert_eq!(escapes(&luxel_scene::build::transformed(b.build(), tilt), 1900.0, 500_000), 0);
}

#[test]
fn no_ray_slips_through_edges_and_corners_that_it_aims_at() {
    let mut b = Builder::new("sphere");
    let white = b.matte(GREY);
    b.sphere("room", Vec3::ZERO, 1.0, 40, white, true);
    b.cuboid("box", Vec3::splat(-2.0), Vec3::splat(2.0), white, true);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let mut escaped = 0;
    for (i, t) in geometry.triangles.iter().enumerate() {
        for k in 0..20 {
            let origin = inside(20 * i as u32 + k, 500.0);
            let along = k as f32 / 19.0;
            let target = t.corners[k as usize % 3].lerp(t.corners[(k as usize + 1) % 3], along);
            escaped += usize::from(rays.closest(origin, (target - origin).normalize(), f32::INFINITY).is_none());
        }
    }
    assert_eq!(escaped, 0, "of {}", 20 * geometry.triangles.len());
}

/// Axis-parallel rays, with zeros of either sign, meet what they should.
#[test]
fn the_sign_of_a_zero_does_not_matter() {
    let mut b = Builder::new("box");
    let white = b.matte(GREY);
    b.cuboid("room", Vec3::ZERO, Vec3::ONE, white, true);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    for axis in 0..3 {
        for (sign, zero) in [(1.0, 0.0), (1.0, -0.0), (-1.0, 0.0), (-1.0, -0.0)] {
            let mut d = Vec3::splat(zero);
            d[axis] = sign;
            let hit = rays.closest(Vec3::new(3.0, 5.0, 7.0), d, f32::INFINITY);
            assert!(hit.is_some(), "{d}");
            assert_eq!(rays.transmittance(Vec3::new(3.0, 5.0, 7.0), d, f32::INFINITY), Rgb::ZERO, "{d}");
        }
    }
}

/// Whatever the size of the scene and however near the wall, the hierarchy finds what a plain one finds.
#[test]
fn walls_in_contact_are_found_at_every_scale() {
    for scale in [1e-6, 1e-3, 1.0, 1e4] {
        let mut b = Builder::new("gap");
        let white = b.matte(GREY);
        b.cuboid("room", Vec3::splat(-1.0), Vec3::ONE, white, true);
        let scene = luxel_scene::build::transformed(b.build(), DAffine3::from_scale(DVec3::splat(scale)));
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let boxes: Vec<_> = geometry.triangles.iter().map(|t| Aabb::from_points(&t.corners.map(Vec3A::from))).collect();
        let plain = build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut Duration::default());
        let wall = geometry.triangles[0].corners[0].abs().max_element();
        for (i, gap) in [0.0, 1e-6, 5e-5, 1e-4, 3e-4, 1e-3, OFFSET].into_iter().enumerate() {
            for k in 0..50 {
                let mut d = direction(50 * i as u32 + k);
                d.x = d.x.abs().max(0.05);
                let d = d.normalize();
                let origin = Vec3::new(wall - gap, 10.0, 20.0);
                let found = rays.closest(origin, d, f32::INFINITY).map_or(f32::INFINITY, |hit| hit.distance);
                let mut nearest = f32::INFINITY;
                let shear = Shear::new(origin, d);
                plain.ray_traverse(ray(origin, d, f32::INFINITY), &mut RayHit::none(), |_, at| {
                    let t = &geometry.triangles[plain.primitive_indices[at] as usize];
                    let t = Corners::new(t.corners).intersect(&shear, f32::INFINITY);
                    let t = t.map_or(f32::INFINITY, |crossing| crossing.distance);
                    nearest = nearest.min(t);
                    t
                });
                assert_eq!(found, nearest, "scale {scale} gap {gap}");
                // A gap below half an ulp of the coordinates is none: either side of the wall is right.
                if origin.x < wall {
                    assert!(found <= (wall - origin.x) / d.x * 1.001 + 1e-3, "scale {scale} gap {gap}: {found}");
                }
            }
        }
    }
}

/// A surface never shadows itself: not where it is flat, tilted, or lit at a grazing angle.
#[test]
fn a_ray_that_leaves_a_surface_does_not_meet_it_again() {
    let mut b = Builder::new("plane");
    let white = b.matte(GREY);
    b.quad("plane", Vec3::ZERO, Vec3::X, Vec3::new(0.2, 0.9, 0.4), white);
    b.quad("far end", Vec3::splat(0.9), Vec3::X * 0.1, Vec3::Y * 0.1, white);
    let tilt = DAffine3::from_axis_angle(DVec3::new(0.48, 0.6, 0.64), 0.9);
    let scene = luxel_scene::build::transformed(b.build(), tilt);
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    for i in 0..100_000 {
        let triangle = i % 2;
        let (u, v) = sampling::triangle(sampling::r2(i, Vec2::ZERO));
        let t = &geometry.triangles[triangle as usize];
        let d = direction(i);
        // Grazing ones are the hard ones.
        let d = (d - t.normal * d.dot(t.normal) * if i % 3 == 0 { 0.999 } else { 0.0 }).normalize();
        let origin = leave(t.at(u, v), t.normal, d);
        let met = rays.closest(origin, d, f32::INFINITY).is_some_and(|hit| hit.triangle < 2);
        assert!(!met, "from triangle {triangle} at {u} {v} along {d}");
    }
}

#[test]
fn a_mirrored_instance_keeps_its_front() {
    let mut b = Builder::new("mirror");
    let white = b.matte(GREY);
    let quad = b.quad("quad", Vec3::new(1.0, 0.0, 0.0), Vec3::X, Vec3::Y, white);
    let mesh = b.scene_mut().instances[quad].mesh;
    b.place(mesh, DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)), "mirrored");
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    for (i, t) in geometry.triangles.iter().enumerate() {
        assert!(t.normal.abs_diff_eq(Vec3::Z, 1e-6), "{i}: {}", t.normal);
        let at = t.at(0.3, 0.3);
        let front = rays.closest(at + Vec3::Z * 10.0, -Vec3::Z, f32::INFINITY).unwrap();
        let back = rays.closest(at - Vec3::Z * 10.0, Vec3::Z, f32::INFINITY).unwrap();
        assert_eq!((front.triangle, front.back), (i as u32, false));
        assert_eq!((back.triangle, back.back), (i as u32, true));
        assert!(geometry.triangles[front.triangle as usize].at(front.u, front.v).abs_diff_eq(at, 1e-2));
    }
}

/// Veils at z = 1, 2, 3 (twice, coincident), an opaque wall at z = 5, all seen from z = 0.
fn veils(b: &mut Builder) -> Vec<Vec3> {
    let colors = [Vec3::new(1.0, 0.5, 0.2), Vec3::new(0.3, 1.0, 1.0), Vec3::splat(0.9), Vec3::splat(0.4)];
    for (color, z) in colors.into_iter().zip([1.0, 2.0, 3.0, 3.0]) {
        let glass = Material { transmission: 0.5, base_color: color.extend(1.0), ..Material::default() };
        let glass = b.material(glass);
        b.quad("veil", Vec3::new(-4.0, -4.0, z), Vec3::X * 8.0, Vec3::Y * 8.0, glass);
    }
    colors.map(|c| c * 0.5).to_vec()
}

#[test]
fn a_walk_meets_every_veil_once_from_front_to_back() {
    let mut b = Builder::new("veils");
    let passes = veils(&mut b);
    let wall = b.matte(GREY);
    b.quad("wall", Vec3::new(-4.0, -4.0, 5.0), Vec3::X * 8.0, Vec3::Y * 8.0, wall);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let origin = geometry.frame.point(DVec3::new(0.3, 0.1, 0.0));
    let (mut share, mut seen) = (Rgb::ONE, Vec::new());
    let rest = rays.walk(origin, Vec3::Z, f32::INFINITY, 0.0, |hit, s| {
        assert_eq!(s, share, "at {}", hit.distance);
        if let Some(pass) = passes.get(seen.len()) {
            share *= *pass;
        }
        seen.push(geometry.triangles[hit.triangle as usize].instance);
    });
    assert_eq!(seen, [0, 1, 2, 3, 4]);
    assert_eq!(rest, Rgb::ZERO);
    let before_the_wall = geometry.frame.length(4.0);
    assert_eq!(rays.transmittance(origin, Vec3::Z, before_the_wall), share);
    assert_eq!(rays.walk(origin, Vec3::Z, before_the_wall, 0.0, |_, _| ()), share);
    assert_eq!(rays.transmittance(origin, Vec3::Z, f32::INFINITY), Rgb::ZERO);
    // Seen from behind, each once too.
    let behind = origin + Vec3::Z * before_the_wall;
    let back = rays.transmittance(behind, -Vec3::Z, f32::INFINITY);
    assert!(back.abs_diff_eq(share, 1e-7), "{back} {share}");
}

/// Rays through the diagonal of a veil's two triangles meet one of them.
#[test]
fn a_veil_counts_once_on_its_inner_edges() {
    let mut b = Builder::new("diagonal");
    let passes = veils(&mut b);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let all: Rgb = passes.into_iter().product();
    for i in -20..=20 {
        for d in [Vec3::Z, Vec3::new(0.5, 0.5, 1.0).normalize()] {
            let origin = geometry.frame.point(DVec3::new(f64::from(i) / 16.0, f64::from(i) / 16.0, 0.0));
            let pass = rays.transmittance(origin, d, f32::INFINITY);
            assert!(pass.abs_diff_eq(all, 1e-7), "{pass} instead of {all}");
        }
    }
}

/// The order of the triangles in the file shapes the hierarchy, and must not shape the result.
#[test]
fn what_a_ray_meets_does_not_depend_on_the_order_of_the_triangles() {
    let build = |reverse: bool| {
        let mut b = Builder::new("order");
        veils(&mut b);
        let wall = b.matte(GREY);
        b.sphere("ball", Vec3::new(0.0, 0.0, 4.0), 0.5, 12, wall, false);
        let mut scene = b.build();
        if reverse {
            scene.meshes.iter_mut().for_each(|m| m.triangles.reverse());
        }
        scene
    };
    let (one, other) = (build(false), build(true));
    let (one, other) = (Geometry::new(&one), Geometry::new(&other));
    let (one, other) = (Rays::new(&one), Rays::new(&other));
    for i in 0..20_000 {
        let (o, d) = (inside(i, 1500.0), direction(i));
        let distances = |rays: &Rays| {
            let mut list = Vec::new();
            let rest = rays.walk(o, d, f32::INFINITY, 0.0, |hit, share| list.push((hit.distance, share)));
            (list, rest, rays.transmittance(o, d, f32::INFINITY), rays.closest(o, d, 1e9).map(|h| h.distance))
        };
        assert_eq!(distances(&one), distances(&other), "ray {i}");
    }
}

#[test]
fn holes_let_rays_through() {
    let mut b = Builder::new("mask");
    // Left half a hole, right half there.
    let texels = vec![[255, 255, 255, 0], [255; 4]];
    b.scene_mut().textures.push(Texture { name: "mask".into(), width: 2, height: 1, srgb: false, texels });
    let mask =
        Material { base_color_texture: Some(TextureRef::new(0)), alpha: Alpha::Mask(0.5), ..Material::default() };
    let mask = b.material(mask);
    b.quad("leaf", Vec3::ZERO, Vec3::X, Vec3::Y, mask);
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    for (x, there) in [(0.3, false), (0.7, true)] {
        let origin = geometry.frame.point(DVec3::new(x, 0.4, 1.0));
        assert_eq!(rays.closest(origin, -Vec3::Z, f32::INFINITY).is_some(), there);
        let mut visits = 0;
        let pass = if there { Rgb::ZERO } else { Rgb::ONE };
        assert_eq!(rays.first_hits(origin, -Vec3::Z, f32::INFINITY, |_, _| visits += 1), pass);
        assert_eq!(visits, usize::from(there));
        assert_eq!(rays.transmittance(origin, -Vec3::Z, f32::INFINITY), pass);
    }
}

#[test]
fn an_empty_scene_stops_nothing() {
    let scene = Builder::new("nothing").build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    assert_eq!(rays.closest(Vec3::ZERO, Vec3::X, f32::INFINITY), None);
    assert_eq!(rays.transmittance(Vec3::ZERO, Vec3::X, f32::INFINITY), Rgb::ONE);
    assert_eq!(rays.first_hits(Vec3::ZERO, Vec3::X, f32::INFINITY, |_, _| ()), Rgb::ONE);
}

/// Squares nested around one centre, each a little larger than the last: a greedy clustering chains them one by one.
#[test]
fn a_pathological_scene_gets_a_hierarchy_that_works() {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let count = 3000;
    for i in 0..count {
        let (r, z) = (libm::powf(1.002, i as f32), i as f32 * 1e-2);
        let at = positions.len() as u32;
        positions.extend([Vec3::new(-r, -r, z), Vec3::new(r, -r, z), Vec3::new(r, r, z), Vec3::new(-r, r, z)]);
        triangles.extend([[at, at + 1, at + 2], [at, at + 2, at + 3]]);
    }
    let mut b = Builder::new("nested");
    let white = b.matte(GREY);
    b.add(Mesh { name: "nested".into(), positions, triangles, material: white, ..Mesh::default() });
    let scene = b.build();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    for i in 0..count {
        let square = &geometry.triangles[2 * i];
        let mut origin = square.at(0.9995, 0.0003);
        origin.z = -2000.0;
        let hit = rays.closest(origin, Vec3::Z, f32::INFINITY).unwrap();
        assert_eq!(hit.triangle, 2 * i as u32);
    }
}
