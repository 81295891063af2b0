//! Walls thinner than anything that resolves them. Of two closed rooms one is lit; light that the other one holds has
//! leaked, and may be 2·10⁻³ of the bright side at most.

use std::f64::consts::FRAC_PI_6;

use glam::{DAffine3, DVec3, Vec3};
use luxel::settings::Settings;
use luxel_scene::{
    Material, Scene,
    build::{Builder, transformed},
};

use crate::kit::*;
use crate::support::*;

/// Largest mean irradiance of the dark side, as a share of the bright side's.
const LEAK: f64 = 2e-3;

/// A lamp that hangs in the room at x < 1.
fn lamp(b: &mut Builder) {
    let lamp = b.emitter(Vec3::splat(0.7), Vec3::splat(50.0));
    b.cuboid("lamp", Vec3::new(0.4, 0.8, 0.6), Vec3::new(0.7, 0.9, 0.9), lamp, false);
}

/// Two closed boxes with a gap in between: a wall of two faces and that thickness.
fn boxes(thickness: f32) -> Scene {
    let mut b = Builder::new("two boxes");
    let wall = b.matte(Vec3::splat(0.7));
    b.cuboid("lit room", Vec3::ZERO, Vec3::new(1.0, 1.2, 1.5), wall, true);
    b.cuboid("dark room", Vec3::new(1.0 + thickness, 0.0, 0.0), Vec3::new(2.0 + thickness, 1.2, 1.5), wall, true);
    lamp(&mut b);
    b.build()
}

/// One shell whose floor and ceiling run on below a slab of that thickness.
fn shell(thickness: f32) -> Scene {
    let mut b = Builder::new("shell with a slab");
    let wall = b.matte(Vec3::splat(0.7));
    b.cuboid("shell", Vec3::ZERO, Vec3::new(2.0 + thickness, 1.2, 1.5), wall, true);
    b.cuboid("wall", Vec3::new(1.0, 0.0, 0.0), Vec3::new(1.0 + thickness, 1.2, 1.5), wall, false);
    lamp(&mut b);
    b.build()
}

/// The same with a single double-sided sheet as the wall.
fn sheet() -> Scene {
    let mut b = Builder::new("shell with a sheet");
    let wall = b.matte(Vec3::splat(0.7));
    b.cuboid("shell", Vec3::ZERO, Vec3::new(2.0, 1.2, 1.5), wall, true);
    let both =
        b.material(Material { double_sided: true, base_color: Vec3::splat(0.7).extend(1.0), ..Material::default() });
    b.quad("sheet", Vec3::X, Vec3::Y * 1.2, Vec3::Z * 1.5, both);
    lamp(&mut b);
    b.build()
}

fn assert_no_leak(name: &str, upright: &Scene, transform: DAffine3, settings: &Settings) {
    let lit = bake(&transformed(upright.clone(), transform), settings);
    assert_sound(name, &lit);
    // Texels name points of meshes, so the upright copy says which room they are in. The sheet's own texels hold its
    // front, which looks into the dark room.
    let x = |i: usize| position(upright, &lit, i).x;
    let sheet = |i: usize| upright.instances[lit.atlas.chart(&lit.atlas.texels[i]).instance as usize].name == "sheet";
    let (dark, bright) = (valid_texels(&lit, |i| x(i) > 1.0001 || sheet(i)), valid_texels(&lit, |i| x(i) < 0.9999));
    assert!(dark.len() > 300 && bright.len() > 300, "{name}: {} {}", dark.len(), bright.len());
    let lightest = dark.iter().map(|&i| f64::from(value(&lit, i).element_sum()) / 3.0).fold(0.0, f64::max);
    let (dark, bright) = (mean(&lit, &dark), mean(&lit, &bright));
    println!("{name}: leak {:.2e} of {bright:.2} lux, the lightest texel {:.2e}", dark / bright, lightest / bright);
    assert!(bright > 1.0, "{name}: {bright}");
    assert!(dark <= LEAK * bright, "{name}: {dark} of {bright}");
}

fn turns() -> [(&'static str, DAffine3); 2] {
    let turn = DAffine3::from_rotation_y(FRAC_PI_6) * DAffine3::from_rotation_x(FRAC_PI_6);
    [("upright", DAffine3::IDENTITY), ("tilted", turn)]
}

#[test]
fn boxes_a_millimetre_apart() {
    for (how, transform) in turns() {
        for (budget, side) in [(25_000, 64), (100_000, 96)] {
            assert_no_leak(
                &format!("boxes 1 mm apart, {how}, {budget}"),
                &boxes(1e-3),
                transform,
                &sized(side, budget),
            );
        }
    }
}

#[test]
fn a_slab_of_a_millimetre() {
    for (how, transform) in turns() {
        for (budget, side) in [(25_000, 64), (100_000, 96)] {
            assert_no_leak(&format!("slab of 1 mm, {how}, {budget}"), &shell(1e-3), transform, &sized(side, budget));
        }
    }
}

#[test]
fn a_sheet() {
    for (how, transform) in turns() {
        for (budget, side) in [(25_000, 64), (100_000, 96)] {
            assert_no_leak(&format!("sheet, {how}, {budget}"), &sheet(), transform, &sized(side, budget));
        }
    }
}

#[test]
fn a_thin_wall_in_a_large_level() {
    let scale = DAffine3::from_scale(DVec3::splat(50.0));
    for (how, transform) in turns() {
        // 100 m, and a wall of 0.1 m.
        assert_no_leak(&format!("100 m level, {how}"), &shell(2e-3), transform * scale, &coarse());
    }
}
