//! luxel: an incremental lightmap baker.

pub mod discover;
pub mod plan;
pub mod preview;
pub mod settings;
pub mod store;
