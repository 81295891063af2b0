//! Stiff and extreme cases through the whole chain and through its solver, each against a closed form or a bound that its
//! comment states: nearly white rooms, lights of all strengths and places, geometry of all sizes and kinds, and f32
//! against f64. With `-- --nocapture` every case prints what was measured.
//!
//! Cases that take longer than a minute run with `LUXEL_HEAVY=1` only; without it they pass at once and say so.

mod support;

#[path = "extreme/geometry.rs"]
mod geometry;
#[path = "extreme/kit.rs"]
mod kit;
#[path = "extreme/light.rs"]
mod light;
#[path = "extreme/precision.rs"]
mod precision;
#[path = "extreme/stiff.rs"]
mod stiff;
#[path = "extreme/walls.rs"]
mod walls;
