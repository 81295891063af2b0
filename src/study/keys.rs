//! What the keys of kept results have in common.

use crate::bake::{digest::Digest, matters};
use crate::plan::Stage;
use crate::settings::{FIELDS, Settings};

/// Raised whenever a measurement means something else: stored ones of an older version are then made anew.
const VERSION: u64 = 3;

/// The version of what is measured.
pub fn version(digest: Digest) -> Digest {
    digest.number(VERSION)
}

/// The versions of everything that measures.
pub fn versions(digest: Digest) -> Digest {
    let digest = version(digest).text(env!("CARGO_PKG_VERSION"));
    Stage::ALL.into_iter().fold(digest, Digest::version)
}

/// All settings: for times, on which the number of threads has a say.
pub fn all(digest: Digest, settings: &Settings) -> Digest {
    FIELDS.iter().fold(digest, |digest, field| digest.setting(settings, field.name))
}

/// The settings that light follows from.
pub fn lasting(digest: Digest, settings: &Settings) -> Digest {
    let told = FIELDS.iter().filter(|field| matters(field.name));
    told.fold(digest, |digest, field| digest.setting(settings, field.name))
}
