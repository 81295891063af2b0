//! The shipped scenes at the default preset against the reference path tracer, upright and tilted; all lights in one
//! group, which several groups, each with the same error bound on its own light, are not worse than.

mod support;

use luxel::settings::{LightGroups, Settings};
use luxel_scene::Scene;
use support::*;

/// Texels per scene, and paths per texel of the reference: as many as its noise asks for.
const TEXELS: usize = 300;
const FEW: u32 = 4096;
const SOME: u32 = 8192;
const MANY: u32 = 32_768;

fn assert_accurate(name: &str, scene: &Scene, paths: u32) {
    let settings = Settings { light_groups: LightGroups::One, ..medium_512() };
    let lit = bake(scene, &settings);
    let texels = some_texels(&lit, TEXELS, |_| true);
    let s = score_texels(scene, &lit, &texels, paths);
    println!("{name}: {s}");
    assert!(s.noise < 0.01, "the reference is too noisy to judge by: {s:?}");
    assert!(s.rmse <= 0.03, "{s:?}");
    assert!(s.bias.abs() <= 0.01, "{s:?}");
    assert!(s.p95 <= 0.10, "{s:?}");
}

#[test]
fn cornell() {
    assert_accurate("cornell", &luxel_assets::cornell(), SOME);
}

#[test]
fn two_rooms() {
    assert_accurate("two rooms", &luxel_assets::two_rooms(), MANY);
}

#[test]
fn colonnade() {
    assert_accurate("colonnade", &luxel_assets::colonnade(), FEW);
}

#[test]
fn textured_room() {
    assert_accurate("textured room", &luxel_assets::textured_room(), MANY);
}

#[test]
fn many_lamps() {
    assert_accurate("many lamps", &luxel_assets::many_lamps(), SOME);
}

#[test]
fn cornell_tilted() {
    assert_accurate("cornell tilted", &tilted(luxel_assets::cornell()), SOME);
}

#[test]
fn two_rooms_tilted() {
    assert_accurate("two rooms tilted", &tilted(luxel_assets::two_rooms()), MANY);
}

#[test]
fn colonnade_tilted() {
    assert_accurate("colonnade tilted", &tilted(luxel_assets::colonnade()), FEW);
}

#[test]
fn textured_room_tilted() {
    assert_accurate("textured room tilted", &tilted(luxel_assets::textured_room()), MANY);
}

#[test]
fn many_lamps_tilted() {
    assert_accurate("many lamps tilted", &tilted(luxel_assets::many_lamps()), SOME);
}
