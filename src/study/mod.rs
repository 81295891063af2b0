//! Error against run time: what `luxel report` measures, and what follows from it.
//!
//! A *point* is one way to find a scene's light with one setting or another, with what it cost and how far it is from
//! the reference path tracer at the same texels. A *series* is a row of points that differ in one thing.
//!
//! | module | what it knows |
//! |---|---|
//! | [`truth`] | the reference at some texels, more exact with every round, kept in a store |
//! | [`point`] | one measurement, and a table of them |
//! | [`series`] | which settings and methods are tried |
//! | [`ladder`] | settings that grow better together, rung by rung |
//! | [`measure`] | the measurement itself |
//! | [`fit`] | the order with which an error falls, and where it stops falling |
//! | [`advice`] | which setting limits the error of a bake |
//! | `small` | the small atlas on which settings are tried |
//! | [`budget`] | the settings for an error or a time |
//! | [`table`] | the paper's Table 1, row by row |
//! | [`plot`], [`maps`] | pictures of it |
//! | `keys` | what kept results follow from |
//! | [`run`] | all of it for one scene |
//!
//! Errors follow from scene and settings alone; only seconds are read off clocks, and nothing but [`budget`] for a time
//! decides by them.

pub mod advice;
pub mod budget;
pub mod fit;
mod keys;
pub mod ladder;
pub mod maps;
pub mod measure;
pub mod plot;
pub mod point;
pub mod run;
pub mod score;
pub mod series;
mod small;
pub mod table;
pub mod truth;

pub use point::Point;
pub use run::{Findings, Order, study};
pub use score::Score;
