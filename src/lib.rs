//! luxel bakes light into glTF levels.
//!
//! [`bake`] goes from a scene file to files, [`bake_drafted`] with a draft on the way, [`export()`] with other weights of
//! its light groups, and [`bake_scene`] from a [`Scene`](luxel_scene::Scene) to images in memory. All run the same chain,
//! each link of which is a pure function of its input and of the settings it reads:
//!
//! | stage | input → output | made anew when | left out when |
//! |---|---|---|---|
//! | import | files → `Scene` | a file that was read changes | never |
//! | unwrap | `Scene` → `Atlas` | geometry, authored TEXCOORD_1, size, density, padding | nothing receives light |
//! | rays | geometry → `Rays` | geometry, holes | there is no light |
//! | surfels | geometry, materials → `Surfels` | geometry, materials, voxels, area | light does not bounce, or is not wanted |
//! | shoot | lights, `Surfels` → direct irradiance at surfels | lights, surfels, shadow samples, photons; with very many emissive surfaces cut error, cut limit, near rays | the sky is the only light |
//! | propagate | direct irradiance → `Solution` | the above, sky, directions, their decay, direction set, rule, closed, bounces, tolerance | as surfels |
//! | refresh | rays, `Solution` → `Solution` gathered anew, its defect bounced | the above, refresh rays | switched off, and as surfels |
//! | cache | `Solution` → octree file | the above | as surfels |
//! | clear | rays, `Atlas` → buried texels moved or marked | geometry, atlas | there is no light |
//! | direct | `Atlas`, lights → E at texels | geometry, lights, atlas, shadow samples; with very many emissive surfaces cut error, cut limit, near rays | no lamp, sun or emissive surface |
//! | sky | `Atlas`, sky → E at texels | geometry, sky, atlas, sky rays | there is no sky |
//! | gather | `Atlas`, `Solution` → E at texels | solution, atlas, gather settings | as surfels |
//! | finish | E at texels → `Lightmap`s | any of the above | nothing receives light |
//! | preview | `Lightmap`s → picture | any of the above | nothing receives light |
//! | export | everything → .exr, .glb, .png, .json | any of the above | never |
//!
//! [`verify`] measures the error of a finished lightmap, before export, where that is asked for; [`render`] takes pictures
//! of a scene, by the same light or that of other methods; [`study`] measures error against run time.
//!
//! [`plan`] decides what is left out before anything runs, and the report tells it. No stage reads a clock or the
//! number of threads to decide a value. Import and export touch files, and every stage that costs time leaves an artefact
//! in the [`store`], under the digest of what it reads, from which the next bake takes it.

pub mod bake;
mod content;
pub mod current;
pub mod discover;
mod error;
pub mod live;
pub mod plan;
pub mod render;
pub mod settings;
pub mod store;
pub mod study;
pub mod text;
pub mod verify;
pub mod watch;

pub use bake::{Baked, Kept, Lit, Request, bake, bake_drafted, bake_scene, bake_verified, export, plan_file};
pub use error::Error;
