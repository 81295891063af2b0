//! How light travels (Piwowar & Malgouyres 2009): voxelize, shoot, propagate, cache, gather; and the reference that
//! everything is measured against.
//!
//! | stage | module | in → out |
//! |---|---|---|
//! | normalise | [`frame`], [`geometry`] | scene → world triangles in a frame of fixed size |
//! | ray tracing | [`rays`] | geometry → closest hits and transmittances |
//! | lights | [`lights`] | geometry → convex emitters, lamps, suns with their power |
//! | surfels | [`surfel`] | geometry → oriented voxel patches |
//! | shoot | [`shoot`] | lights, surfels → direct irradiance at surfels, exact or by photons |
//! | propagate | [`directions`], [`sweep`], [`solve`], [`ledger`] | direct irradiance → all bounces, with their energy |
//! | books | [`energy`] | lights, surfels and their light → where the light is after every stage |
//! | cache | [`octree`] | surfels and their light ↔ bytes |
//! | direct light | [`direct`], [`sky_light`] | receivers → irradiance straight from lights and sky |
//! | gather | [`lighttree`], [`gather`] | receivers → indirect irradiance with a stated bound |
//! | validity | [`validity`] | receivers → which of them are inside geometry |
//! | reference | [`reference`] | receivers → irradiance with its standard error |
//! | comparison | [`methods`] | receivers → irradiance by each of several methods |
//!
//! Invariants: no module here reads a file, a clock or the number of threads to decide a value; the same input
//! gives the same bytes. Lengths are in the units of the [`frame::Frame`], light is in SI photometric units.

mod aside;
mod boxes;
pub mod direct;
pub mod directions;
pub mod energy;
pub mod frame;
pub mod gather;
pub mod geometry;
pub mod ledger;
pub mod lights;
pub mod lighttree;
pub mod methods;
pub mod octree;
pub mod rays;
pub mod reference;
pub mod sampling;
pub mod shoot;
pub mod sky_light;
pub mod solve;
pub mod surfel;
pub mod sweep;
pub mod validity;

/// Linear RGB triple of radiances, irradiances or reflectances; the name of the variable says which.
pub type Rgb = glam::Vec3;
