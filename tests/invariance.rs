//! What must not change a lightmap: size, place, mirror, the number of threads; and what must not cross a wall.

mod support;

use glam::{DAffine3, DVec3, Vec3};
use luxel::Lit;
use luxel::settings::{Settings, Voxels, value::Threads};
use luxel_scene::{
    Scene,
    build::{Builder, transformed},
};
use support::*;

const SIDE: u32 = 96;

/// A transformed copy of the Cornell box has the same light at the same points.
fn assert_same_light(name: &str, transform: DAffine3, settings: &Settings, tolerance: f64) {
    let scene = luxel_assets::cornell();
    let a = bake(&scene, settings);
    let b = bake(&transformed(scene, transform), settings);
    let texels = valid_texels(&a, |_| true);
    let s = score_copies(&a, &b, &texels);
    println!("{name}: RMSE {:.3} %, bias {:+.3} %, p95 {:.2} %", 100.0 * s.rmse, 100.0 * s.bias, 100.0 * s.p95);
    assert!(s.samples > 3000 && s.mean > 0.1, "{name}: {s:?}");
    assert!(s.rmse <= tolerance, "{name}: {s:?}");
}

// Copies of another size differ by rounding alone, noise included: voxels, trees and seeds are those of the original.

#[test]
fn a_tenth_of_a_millimetre_is_as_good_as_a_metre() {
    assert_same_light("scale 1e-4", DAffine3::from_scale(DVec3::splat(1e-4)), &medium(SIDE), 2e-3);
}

#[test]
fn ten_kilometres_are_as_good_as_a_metre() {
    assert_same_light("scale 1e4", DAffine3::from_scale(DVec3::splat(1e4)), &medium(SIDE), 2e-3);
}

#[test]
fn a_mirrored_copy_has_the_same_light() {
    // Directions, voxels and representatives are not mirrored, so both copies have noise of their own.
    assert_same_light("mirrored", DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)), &medium(SIDE), 0.01);
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let scene = luxel_assets::cornell();
    let with = |threads| {
        let settings = Settings { threads: Threads(threads), voxels: Voxels::Budget(25_000), ..medium(SIDE) };
        let lit = bake(&scene, &settings);
        let bits = |e: &Vec3| e.to_array().map(f32::to_bits);
        lit.lightmaps.iter().flat_map(|map| map.irradiance().iter().map(bits)).collect::<Vec<_>>()
    };
    let one = with(1);
    assert!(one.len() == (SIDE * SIDE) as usize && one.iter().filter(|e| **e != [0; 3]).count() > 3000);
    assert!(one == with(2), "two threads");
    assert!(one == with(7), "seven threads");
}

/// Two closed boxes 1 cm apart; the one at x < 1 has a lamp.
fn two_boxes() -> Scene {
    let mut b = Builder::new("two boxes");
    let wall = b.matte(Vec3::splat(0.7));
    let lamp = b.emitter(Vec3::splat(0.7), Vec3::splat(50.0));
    b.cuboid("lit room", Vec3::ZERO, Vec3::new(1.0, 1.2, 1.5), wall, true);
    b.cuboid("dark room", Vec3::new(1.01, 0.0, 0.0), Vec3::new(2.01, 1.2, 1.5), wall, true);
    b.cuboid("lamp", Vec3::new(0.4, 0.8, 0.6), Vec3::new(0.7, 0.9, 0.9), lamp, false);
    b.build()
}

/// Mean irradiance over some texels, by area, over the bands [lux].
fn mean(lit: &Lit, texels: &[usize]) -> f64 {
    let areas = areas(lit, texels);
    let y = |i: usize| f64::from(value(lit, i).element_sum()) / 3.0;
    texels.iter().zip(&areas).map(|(&i, a)| a * y(i)).sum::<f64>() / areas.iter().sum::<f64>()
}

fn assert_no_leak(name: &str, turn: impl Fn(Scene) -> Scene) {
    let upright = two_boxes();
    let lit = bake(&turn(upright.clone()), &medium(SIDE));
    // Texels name points of meshes, so the upright copy says which room they are in.
    let is_dark = |i: usize| position(&upright, &lit, i).x > 1.005;
    let (dark, bright) = (valid_texels(&lit, is_dark), valid_texels(&lit, |i| !is_dark(i)));
    assert!(dark.len() > 500 && bright.len() > 500);
    let (dark, bright) = (mean(&lit, &dark), mean(&lit, &bright));
    println!("{name}: leak {:.2e} of {bright:.2} lux", dark / bright);
    assert!(bright > 1.0);
    assert!(dark <= 5e-3 * bright, "{name}: {dark} of {bright}");
}

#[test]
fn a_dark_box_beside_a_lit_one_stays_dark() {
    assert_no_leak("two boxes", |scene| scene);
}

#[test]
fn a_dark_box_beside_a_lit_one_stays_dark_tilted() {
    assert_no_leak("two boxes tilted", tilted);
}

/// The room that is lit through a door alone, against the reference and over its own mean.
fn assert_dark_room(name: &str, turn: impl Fn(Scene) -> Scene) {
    let upright = luxel_assets::two_rooms();
    let scene = turn(upright.clone());
    let lit = bake(&scene, &medium_512());
    // The dark side of the dividing wall lies at x = 1.005.
    let texels = some_texels(&lit, 120, |i| position(&upright, &lit, i).x > 1.004);
    let s = score_texels(&scene, &lit, &texels, 32_768);
    println!("{name}: {s}");
    assert!(s.noise < 0.03, "the reference is too noisy to judge by: {s:?}");
    assert!(s.rmse <= 0.10, "{name}: {s:?}");
}

#[test]
fn the_room_behind_the_door() {
    assert_dark_room("dark room", |scene| scene);
}

#[test]
fn the_room_behind_the_door_tilted() {
    assert_dark_room("dark room tilted", tilted);
}

#[test]
fn a_furnace_a_millimetre_wide_a_thousand_kilometres_away() {
    let mut b = Builder::new("furnace");
    let wall = b.emitter(Vec3::splat(0.8), Vec3::ONE);
    b.cuboid("room", Vec3::splat(-0.5), Vec3::splat(0.5), wall, true);
    let near = b.build();
    let away = DAffine3::from_translation(DVec3::new(1e6, -1e6, 1e6)) * DAffine3::from_scale(DVec3::splat(1e-3));
    let far = transformed(near.clone(), away);
    // Fewer voxels than by default: less work, and no easier.
    let settings = Settings { voxels: Voxels::Budget(25_000), ..medium(64) };
    let (a, b) = (bake(&near, &settings), bake(&far, &settings));
    let s = score_copies(&a, &b, &valid_texels(&a, |_| true));
    let exact = std::f64::consts::PI / (1.0 - f64::from(0.8f32));
    let (_, worst, place) = score_closed_form(&far, &b, &valid_texels(&b, |_| true), |_| exact);
    println!("far furnace: RMSE {:.4} % against the near one, largest {:.4} %", 100.0 * s.rmse, 100.0 * worst);
    assert!(s.samples > 1500 && s.rmse <= 1e-3, "{s:?}");
    assert!(worst <= 0.005, "{worst} at {place}");
}

/// Along the foot of the wall between the rooms, all around, no texel that the dark room reads is brighter than the room
/// two texels further in.
fn assert_no_line_of_light(name: &str, transform: DAffine3, size: u32) {
    let upright = luxel_assets::two_rooms();
    let scene = transformed(upright.clone(), transform);
    let lit = bake(&scene, &medium(size));
    let shell = upright.instances.iter().position(|i| i.name == "shell").expect("the rooms have a shell") as u32;
    let texels: Vec<(usize, DVec3)> = valid_texels(&lit, |i| lit.atlas.chart(&lit.atlas.texels[i]).instance == shell)
        .into_iter()
        .map(|i| (i, position(&upright, &lit, i)))
        .collect();
    let brightness = |i: usize| value(&lit, i).element_sum();
    let (mut checked, mut under, mut worst, mut place) = (0, 0, 0.0f32, DVec3::ZERO);
    // The door leads to the floor at 0.35 < z < 0.65, and light falls through it.
    let is_door = |p: DVec3| p.y < 1e-3 && p.z > 0.25 && p.z < 0.75;
    for &(i, p) in texels.iter().filter(|(_, p)| !is_door(*p)) {
        let step = f64::from(lit.atlas.texels[i].footprint());
        // Those that lie under the wall, and the first row of the dark room.
        if p.x <= 0.9999 || p.x >= 1.01 + step {
            continue;
        }
        let inwards = p + DVec3::X * (2.0 * step);
        let near = |q: DVec3| q.distance(inwards) < 0.3 * step;
        let Some(&(other, _)) = texels.iter().find(|(_, q)| near(*q)) else { continue };
        let ratio = brightness(i) / brightness(other);
        if ratio > worst {
            (worst, place) = (ratio, p);
        }
        under += usize::from(p.x <= 1.01);
        checked += 1;
    }
    println!("{name} at {size}: {checked} texels, {under} of them under the wall, largest ratio {worst:.2} at {place}");
    assert!(checked > 100 && under > 50, "{name}: {checked}, {under}");
    assert!(worst < 1.15, "{name}: {worst} at {place}");
}

#[test]
fn no_line_of_light_runs_along_the_foot_of_a_wall() {
    let mirror = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    let turn = DAffine3::from_rotation_y(std::f64::consts::FRAC_PI_2);
    assert_no_line_of_light("two rooms", DAffine3::IDENTITY, 128);
    assert_no_line_of_light("two rooms mirrored", mirror, 128);
    assert_no_line_of_light("two rooms turned", turn, 96);
}
