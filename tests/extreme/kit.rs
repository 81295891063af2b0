//! What the extreme cases share.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use luxel::Lit;
use luxel::settings::{Settings, Voxels};
use luxel_scene::{Scene, Silent, build::Builder};
use luxel_transport::{
    Rgb,
    geometry::Geometry,
    solve::stiff,
    surfel::{Resolution, Surfels, VoxelSettings},
};

use crate::support::*;

/// Radiance of glowing walls [cd/m²].
pub const GLOW: f32 = 2.0;

/// The preset `medium` with few voxels on a small atlas: less work, and no easier.
pub fn coarse() -> Settings {
    sized(64, 12_000)
}

pub fn sized(side: u32, voxels: u32) -> Settings {
    Settings { voxels: Voxels::Budget(voxels), ..medium(side) }
}

/// All light of a bake, images and texels, is a finite irradiance.
pub fn assert_sound(name: &str, lit: &Lit) {
    let images = lit.lightmaps.iter().flat_map(|map| map.irradiance());
    for e in images.chain(&lit.texels.irradiance) {
        assert!(e.is_finite() && e.min_element() >= 0.0, "{name}: {e}");
    }
}

/// Every valid texel, and at least 30 of them, is within `tolerance` of the closed form.
pub fn assert_within(name: &str, scene: &Scene, lit: &Lit, tolerance: f64, truth: impl Fn(DVec3) -> f64) {
    assert_sound(name, lit);
    assert_texels_within(name, scene, lit, &valid_texels(lit, |_| true), tolerance, truth);
}

/// A closed room whose walls all have the albedo ρ and emit [`GLOW`], and E = πLₑ/(1 − ρ) in it.
pub fn furnace(name: &str, albedo: f32, shape: impl Fn(&mut Builder, usize)) -> (Scene, f64) {
    let mut b = Builder::new(name);
    let wall = b.emitter(Vec3::splat(albedo), Vec3::splat(GLOW));
    shape(&mut b, wall);
    (b.build(), PI * f64::from(GLOW) / (1.0 - f64::from(albedo)))
}

/// About so many surfels of a scene.
pub fn voxelized(geometry: &Geometry, budget: u32) -> Surfels {
    let settings = VoxelSettings { resolution: Resolution::Budget(budget), ..VoxelSettings::default() };
    Surfels::new(geometry, &settings, &Silent).expect("voxels")
}

/// x = source + ρTx in a closed room.
pub fn closed_equation<'a>(
    surfels: &'a Surfels,
    reflectance: &'a dyn Fn(usize) -> Rgb,
    source: &'a [Rgb],
) -> stiff::Equation<'a> {
    stiff::Equation { surfels, reflectance, source, rows: None }
}
