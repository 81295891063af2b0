//! Incremental bakes are clean bakes, only shorter: counted by stages and compared by bytes, never by time.
//!
//! | module | what it proves |
//! |---|---|
//! | `level` | a small level that can be edited in every way that a bake may notice |
//! | `baked` | a bake of it, what ran for it, and what of it has to be the same whatever ran |
//! | `stages` | which stages an edit costs, in which words, and that a plan foresees it |
//! | `edits` | random edits |
//! | `singles` | everything that a bake reads, changed for itself |
//! | `sequences` | after every edit the incremental bake has the bytes of the clean one |
//! | `faults` | a spoilt store costs reuse alone |
//! | `killed` | a bake that is killed leaves whole files, and nothing that a later one trips over |
//! | `together` | bakes that share a store at the same time |

mod baked;
mod edits;
mod faults;
mod killed;
mod level;
mod sequences;
mod singles;
mod stages;
mod together;
#[path = "../tool/mod.rs"]
mod tool;
