//! Geometry of every size, place and kind. In a closed room whose walls all glow, E = πLₑ/(1 − ρ) everywhere, whatever its
//! shape and whatever its triangles are like.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use luxel::plan::Plan;
use luxel::settings::{Settings, Voxels};
use luxel_scene::{
    LightKind, Material, Scene, Silent, Sky,
    build::{Builder, transformed},
};
use luxel_transport::{
    geometry::Geometry,
    surfel::{Resolution, Surfels, VoxelSettings},
};

use crate::kit::*;
use crate::support::*;

const SKY: f32 = 1.5;

fn open_sky(b: &mut Builder) {
    b.scene_mut().sky = Sky::Constant(Vec3::splat(SKY));
}

/// The Cornell box with its lamp panel; with a point light in place of that for `point`.
fn cornell(point: bool) -> Scene {
    let mut scene = luxel_assets::cornell();
    if point {
        scene.materials.iter_mut().for_each(|m| m.emission = Vec3::ZERO);
        let (lo, hi) = scene.bounds().expect("the box has bounds");
        let mut b = Builder::new("lamp");
        let position = lo + (hi - lo) * DVec3::new(0.45, 0.8, 0.6);
        b.light("lamp", LightKind::Point { position, range: None, radius: 0.0 }, Vec3::splat(3.0));
        scene.lights = b.build().lights;
    }
    scene
}

/// The copy has `factor` times the light of the original at the same points.
fn assert_copy(name: &str, scene: &Scene, transform: DAffine3, factor: f64) {
    let settings = coarse();
    let a = bake(scene, &settings);
    let b = bake(&transformed(scene.clone(), transform), &settings);
    assert_sound(name, &b);
    let texels = valid_texels(&a, |_| true);
    let at = |lit: &luxel::Lit, i: usize| {
        let t = &a.atlas.texels[i];
        let [u, v] = t.barycentric();
        value_at(lit, lit.atlas.chart(t).instance, t.triangle, u, v)
    };
    let truth: Vec<Vec3> = texels.iter().map(|&i| (at(&a, i).as_dvec3() * factor).as_vec3()).collect();
    let values: Vec<Vec3> = texels.iter().map(|&i| at(&b, i)).collect();
    let s = score(&values, &truth, &vec![0.0; texels.len()], &areas(&a, &texels));
    println!(
        "{name}: {} texels, mean E {:.4e}, RMSE {:.4} %, bias {:+.4} %",
        s.samples,
        s.mean,
        100.0 * s.rmse,
        100.0 * s.bias
    );
    // Rounding alone: voxels, trees and seeds are those of the original.
    assert!(s.samples > 1000 && s.mean > 0.0 && s.rmse <= 2e-3, "{name}: {s:?}");
}

#[test]
fn scales_from_a_micrometre_to_a_thousand_kilometres() {
    for scale in [1e-6, 1e6] {
        let transform = DAffine3::from_scale(DVec3::splat(scale));
        assert_copy(&format!("emissive, scale {scale:e}"), &cornell(false), transform, 1.0);
        assert_copy(&format!("point light, scale {scale:e}"), &cornell(true), transform, 1.0 / (scale * scale));
    }
}

#[test]
fn a_thousand_kilometres_away() {
    let away = DAffine3::from_translation(DVec3::new(1e6, -1e6, 1e6));
    assert_copy("offset 10⁶", &cornell(true), away, 1.0);
}

/// A wall as a fan of `count` triangles about its first corner, whose points on the far sides crowd together: the thinnest
/// are 10⁻⁶ wide, and every tenth has no area at all.
fn needles(b: &mut Builder, o: Vec3, a: Vec3, c: Vec3, count: u32, material: usize) {
    let mut positions = vec![o, o + a];
    let mut at = 0.0f32;
    for k in 1..=count {
        at = (at + [1e-6, 0.2, 1e-4, 0.06][k as usize % 4]).min(1.0);
        positions.push(o + a + c * if k == count { 1.0 } else { at });
    }
    positions.push(o + c);
    let last = positions.len() as u32 - 1;
    let mut triangles: Vec<[u32; 3]> = (1..last).map(|i| [0, i, i + 1]).collect();
    triangles.extend((2..last).step_by(10).flat_map(|i| [[0, i, i], [i, i, i]]));
    b.mesh("needles", positions, triangles, material);
}

/// A box seen from inside of walls made by `wall`.
fn walls(b: &mut Builder, material: usize, wall: impl Fn(&mut Builder, Vec3, Vec3, Vec3, usize)) {
    let (x, y, z) = (Vec3::X * 1.3, Vec3::Y * 0.9, Vec3::Z * 1.1);
    let corner = x + y + z;
    for (a, c) in [(z, x), (x, y), (y, z)] {
        wall(b, Vec3::ZERO, a, c, material);
        wall(b, corner, -c, -a, material);
    }
}

#[test]
fn needles_and_triangles_without_area() {
    let (scene, exact) = furnace("needles", 0.8, |b, wall| {
        walls(b, wall, |b, o, a, c, material| needles(b, o, a, c, 14, material));
    });
    let lit = bake(&scene, &coarse());
    assert_within("needles", &scene, &lit, 0.005, |_| exact);
}

#[test]
fn coplanar_faces_that_overlap() {
    // Every wall is there twice, the second one as two larger pieces; light comes from a lamp, so that E is not the same
    // everywhere, and a copy without the doubles says how much it is.
    let build = |twice: bool| {
        let mut b = Builder::new("doubles");
        let grey = b.matte(Vec3::splat(0.7));
        walls(&mut b, grey, |b, o, a, c, material| {
            b.quad("wall", o, a, c, material);
            if twice {
                let double = b.quad("double", o, a * 0.6, c, material);
                b.scene_mut().instances[double].receives = false;
                let double = b.quad("double", o + a * 0.2, a * 0.8, c, material);
                b.scene_mut().instances[double].receives = false;
            }
        });
        b.light("lamp", LightKind::Point { position: DVec3::new(0.5, 0.6, 0.4), range: None, radius: 0.0 }, Vec3::ONE);
        b.build()
    };
    let settings = coarse();
    let (plain, doubled) = (bake(&build(false), &settings), bake(&build(true), &settings));
    assert_sound("doubles", &doubled);
    let (a, b) = (valid_texels(&plain, |_| true), valid_texels(&doubled, |_| true));
    let (one, two) = (mean(&plain, &a), mean(&doubled, &b));
    let exact = 4.0 * PI / (2.0 * (1.3 * 0.9 + 0.9 * 1.1 + 1.1 * 1.3) * 0.3);
    println!("doubled walls: mean E {two:.4}, {one:.4} without doubles, energy balance {exact:.4}");
    assert!((one / exact - 1.0).abs() < 0.01 && (two / exact - 1.0).abs() < 0.01, "{one} {two} {exact}");
    assert!(b.len() * 10 > a.len() * 9, "{} of {} texels are valid", b.len(), a.len());
}

#[test]
fn glowing_faces_that_overlap() {
    // Of two coplanar faces only one is seen: doubles must not glow twice.
    let (scene, exact) = furnace("glowing doubles", 0.5, |b, wall| {
        walls(b, wall, |b, o, a, c, material| {
            b.quad("wall", o, a, c, material);
            let double = b.quad("double", o, a, c, material);
            b.scene_mut().instances[double].receives = false;
        });
    });
    let lit = bake(&scene, &coarse());
    assert_within("glowing doubles", &scene, &lit, 0.005, |_| exact);
}

#[test]
fn glowing_faces_that_overlap_in_part() {
    // Every wall is two panels that overlap in their middle, or a panel and behind it a larger one that is seen about it.
    // All have one name, so their light is one group's, and even.
    for is_nested in [false, true] {
        let (scene, exact) = furnace("glowing overlaps", 0.5, |b, wall| {
            walls(b, wall, |b, o, a, c, material| {
                let (first, later) = match is_nested {
                    false => ([o, a * 0.6, c], [o + a * 0.2, a * 0.8, c]),
                    true => ([o + a * 0.3 + c * 0.2, a * 0.4, c * 0.5], [o, a, c]),
                };
                let inner = b.quad("panel", first[0], first[1], first[2], material);
                b.scene_mut().instances[inner].receives = !is_nested;
                let outer = b.quad("panel", later[0], later[1], later[2], material);
                b.scene_mut().instances[outer].receives = is_nested;
            });
        });
        let lit = bake(&scene, &coarse());
        assert_within(&format!("glowing overlaps, nested {is_nested}"), &scene, &lit, 0.005, |_| exact);
        // The reference counts what overlaps once, too.
        let texels = some_texels(&lit, 100, |_| true);
        let s = score_texels(&scene, &lit, &texels, 1024);
        println!("against the reference: {s}");
        assert!(s.rmse <= 0.005 + 3.0 * s.noise && s.bias.abs() <= 0.005 + 3.0 * s.noise / 10.0, "{s:?}");
    }
}

#[test]
fn a_single_triangle() {
    let mut b = Builder::new("triangle");
    let white = b.matte(Vec3::splat(0.8));
    b.mesh("triangle", vec![Vec3::ZERO, Vec3::X, Vec3::Z], vec![[0, 2, 1]], white);
    open_sky(&mut b);
    let scene = b.build();
    let lit = bake(&scene, &coarse());
    assert_within("a single triangle", &scene, &lit, 1e-3, |_| PI * f64::from(SKY));
}

#[test]
fn a_single_voxel() {
    let (scene, exact) = furnace("one voxel", 0.8, |b, wall| {
        b.cuboid("room", Vec3::new(-0.5, 0.0, -0.7), Vec3::new(0.8, 0.9, 0.4), wall, true);
    });
    let how = VoxelSettings { resolution: Resolution::Edge(10.0), ..VoxelSettings::default() };
    let surfels = Surfels::new(&Geometry::new(&scene), &how, &Silent).expect("voxels");
    assert!(surfels.list.len() == 6 && surfels.list.iter().all(|s| s.voxel() == surfels.list[0].voxel()));
    let lit = bake(&scene, &Settings { voxels: Voxels::Edge(10.0), ..coarse() });
    // One surfel a wall, and each sees the five others: the light of a furnace is even, so nothing has to be resolved.
    assert_within("a single voxel", &scene, &lit, 0.005, |_| exact);
}

#[test]
fn an_empty_scene() {
    let mut scene = Scene::default();
    assert!(bake(&scene, &coarse()).lightmaps.is_empty());
    // Lights and a sky shine on nothing.
    let mut b = Builder::new("lights alone");
    b.light("lamp", LightKind::Point { position: DVec3::ZERO, range: None, radius: 0.0 }, Vec3::ONE);
    scene.lights = b.build().lights;
    scene.sky = Sky::Constant(Vec3::ONE);
    assert!(bake(&scene, &coarse()).lightmaps.is_empty());
}

#[test]
fn open_and_non_manifold_meshes() {
    // An open box whose edges carry fins, three and more faces at an edge, all of one double-sided mesh under a sky: by the
    // maximum principle E ≤ πL; and as the reference says.
    let mut b = Builder::new("fins");
    let both =
        b.material(Material { double_sided: true, base_color: Vec3::splat(0.6).extend(1.0), ..Material::default() });
    let p = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let positions = vec![
        p(0.0, 0.0, 0.0),
        p(1.0, 0.0, 0.0),
        p(1.0, 0.0, 1.0),
        p(0.0, 0.0, 1.0),
        p(0.0, 0.7, 0.0),
        p(1.0, 0.7, 0.0),
        p(1.0, 0.7, 1.0),
        p(0.0, 0.7, 1.0),
        p(0.5, 0.35, 0.5),
        p(1.5, 0.2, -0.4),
    ];
    let quad = |a, b, c, d| [[a, b, c], [a, c, d]];
    let mut triangles: Vec<[u32; 3]> =
        [quad(0, 3, 2, 1), quad(0, 1, 5, 4), quad(3, 7, 6, 2), quad(0, 4, 7, 3)].concat();
    // Fins: from the floor's diagonal edge, from one wall's foot outwards, and one that shares two edges with others.
    triangles.extend([[0, 1, 8], [0, 1, 9], [1, 5, 9], [0, 8, 4]]);
    b.mesh("box with fins", positions, triangles, both);
    open_sky(&mut b);
    let scene = b.build();
    let lit = bake(&scene, &coarse());
    assert_sound("fins", &lit);
    let texels = some_texels(&lit, 150, |_| true);
    let most = texels.iter().map(|&i| value(&lit, i).max_element()).fold(0.0, f32::max);
    let s = score_texels(&scene, &lit, &texels, 4096);
    println!("fins: {s}; most {:.4} of πL", most / (SKY * std::f32::consts::PI));
    assert!(most <= 1.001 * SKY * std::f32::consts::PI, "{most}");
    assert!(s.noise < 0.01 && s.rmse <= 0.03 && s.bias.abs() <= 0.01, "{s:?}");
}

#[test]
fn mirrored_and_sheared_rooms() {
    let shear = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::new(0.7, 1.0, 0.2), DVec3::new(-0.3, 0.0, 1.4)));
    let mirror = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    let turned = DAffine3::from_quat(DQuat::from_rotation_z(0.4)) * shear;
    for (name, transform) in [("sheared", shear), ("mirrored", mirror), ("mirrored and sheared", mirror * turned)] {
        let (mut scene, exact) = furnace(name, 0.8, |b, wall| {
            b.cuboid("room", Vec3::new(-0.5, 0.0, -0.7), Vec3::new(0.8, 0.9, 0.4), wall, true);
        });
        scene.instances[0].transform = transform;
        let lit = bake(&scene, &coarse());
        assert_within(name, &scene, &lit, 0.005, |_| exact);
    }
}

#[test]
fn singular_transforms_leave_the_rest_alone() {
    // Copies that are flat, thin as a line, a point, or nowhere, beside a furnace.
    let (mut scene, exact) = furnace("singular", 0.8, |b, wall| {
        b.cuboid("room", Vec3::new(-0.5, 0.0, -0.7), Vec3::new(0.8, 0.9, 0.4), wall, true);
    });
    let flatten = [DVec3::new(1.0, 0.0, 1.0), DVec3::new(1.0, 0.0, 0.0), DVec3::ZERO, DVec3::splat(f64::NAN)];
    for (k, scale) in flatten.into_iter().enumerate() {
        let mut copy = scene.instances[0].clone();
        copy.transform = DAffine3::from_translation(DVec3::X * 2.0 * (k + 1) as f64) * DAffine3::from_scale(scale);
        copy.node = k + 1;
        scene.instances.push(copy);
    }
    let lit = bake(&scene, &coarse());
    assert_sound("singular", &lit);
    let texels = valid_texels(&lit, |i| lit.atlas.chart(&lit.atlas.texels[i]).instance == 0);
    let (s, worst, place) = score_closed_form(&scene, &lit, &texels, |_| exact);
    println!("beside singular copies: {} texels, largest error {:.4} %", s.samples, 100.0 * worst);
    assert!(s.samples > 300 && worst <= 0.005, "{worst} at {place}");
}

#[test]
fn a_closed_box_seen_only_from_outside() {
    // Convex, so every face sees a hemisphere of sky and nothing else; the lamp inside shines on backs.
    let mut b = Builder::new("outside");
    let white = b.matte(Vec3::splat(0.9));
    b.cuboid("box", Vec3::new(-0.5, 0.0, -0.7), Vec3::new(0.8, 0.9, 0.4), white, false);
    let lamp = LightKind::Point { position: DVec3::new(0.1, 0.4, -0.1), range: None, radius: 0.0 };
    b.light("inside", lamp, Vec3::splat(1e6));
    open_sky(&mut b);
    let scene = b.build();
    let lit = bake(&scene, &coarse());
    assert_within("a box from outside", &scene, &lit, 1e-3, |_| PI * f64::from(SKY));
}

/// A closed room of 6 × 13² panels, each of 60² squares: 7.3 million triangles in the world, and a lamp.
fn panels() -> Scene {
    let (n, side) = (60u32, 13);
    let mut b = Builder::new("panels");
    let grey = b.matte(Vec3::splat(0.5));
    let at = |i: u32, j: u32| Vec3::new(i as f32, j as f32, 0.0) / n as f32;
    let positions = (0..=n).flat_map(|j| (0..=n).map(move |i| at(i, j))).collect();
    let index = |i: u32, j: u32| j * (n + 1) + i;
    let cell = |i: u32, j: u32| {
        let [a, b, c, d] = [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    let triangles = (0..n).flat_map(|j| (0..n).flat_map(move |i| cell(i, j))).collect();
    let first = b.mesh("panel", positions, triangles, grey);
    let mesh = b.scene_mut().instances[first].mesh;
    b.scene_mut().instances.clear();
    let size = f64::from(side);
    for face in 0..6 {
        // The panel looks along +Z; the first three turns bring that to +X, +Y, +Z, the others opposite.
        let axis = [DVec3::X, DVec3::Y, DVec3::Z][face % 3];
        let normal = if face < 3 { axis } else { -axis };
        let turn = DQuat::from_rotation_arc(DVec3::Z, normal);
        let origin = DVec3::splat(0.5 * size) - normal * (0.5 * size);
        for k in 0..side * side {
            let (i, j) = (f64::from(k % side) - 0.5 * size, f64::from(k / side) - 0.5 * size);
            let place = origin + turn * DVec3::new(i, j, 0.0);
            b.place(mesh, DAffine3::from_rotation_translation(turn, place), "panel");
        }
    }
    let position = DVec3::new(0.55, 0.4, 0.45) * size;
    b.light("lamp", LightKind::Point { position, range: None, radius: 0.0 }, Vec3::splat(100.0));
    b.build()
}

/// The most memory that this process has had at once [MiB], where the system tells.
fn peak() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1024.0)
}

#[test]
fn seven_million_instanced_triangles() {
    if !is_heavy("7 million instanced triangles") {
        return;
    }
    let scene = panels();
    let count = scene.triangle_count();
    let settings = sized(256, 12_000);
    let lit = bake(&scene, &settings);
    assert_sound("panels", &lit);
    let texels = valid_texels(&lit, |_| true);
    let exact = 4.0 * PI * 100.0 / (6.0 * 13.0 * 13.0 * 0.5);
    let ratio = mean(&lit, &texels) / exact;
    println!(
        "{count} triangles: {} texels, mean E {ratio:.4} of the energy balance, most memory {:?} MiB",
        texels.len(),
        peak().map(f64::round)
    );
    assert!(count > 7_000_000);
    // Texels are few and large, so the mean over them is a midpoint rule with 10 points along every side.
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
    // No more than the plan says of it, and what the process has besides.
    let planned = Plan::new(&scene, &settings).memory.total() as f64 / 1048576.0;
    println!("the plan says {planned:.0} MiB");
    if let Some(peak) = peak() {
        // The plan counts the heap; what the system counts is a tenth more at most.
        assert!(peak < 1.1 * planned + 64.0, "{peak} MiB");
    }
}
