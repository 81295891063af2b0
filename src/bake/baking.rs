//! What every stage of a bake is told, and what is done when it is over.

use std::io;
use std::path::Path;

use luxel_scene::{Progress, Watched};

use super::Kept;
use super::groups::Lighting;
use super::keys::Keys;
use crate::Error;
use crate::plan::Plan;
use crate::settings::Settings;
use crate::store::{self, Key, Kind, Store, Writer};

/// What every stage of a bake is told.
#[derive(Clone, Copy)]
pub struct Baking<'a> {
    pub settings: &'a Settings,
    pub plan: &'a Plan,
    pub lighting: &'a Lighting,
    pub keys: &'a Keys,
    pub store: Option<&'a Store>,
    pub kept: Option<&'a Kept>,
    /// Light that is not stored is not made either.
    pub only_stored: bool,
    /// The energy ledger is kept, which traces rays of its own: of everything that is stored or shown, and not of what is
    /// made for its time and error alone.
    pub books: bool,
}

impl Baking<'_> {
    /// Stores an artefact, where there is a store, as long as the bake is wanted; returns the length of its body.
    pub fn put(
        &self,
        kind: Kind,
        key: &Key,
        progress: &dyn Progress,
        fill: impl FnOnce(&mut Watched<&mut Writer>) -> io::Result<()>,
    ) -> Result<Option<u64>, Error> {
        let written = self.store.and_then(|store| store.put(kind, key, |out| fill(&mut Watched::new(out, progress))));
        progress.check()?;
        Ok(written)
    }

    /// To be asked before anything is made that an export has to find in the store.
    pub fn may_make_part(&self, what: impl FnOnce() -> String) -> Result<(), Error> {
        match self.store {
            Some(store) if self.only_stored => Err(not_stored(store, what())),
            _ => Ok(()),
        }
    }

    /// To be asked before the light of a group is made.
    pub fn may_make(&self, group: &str) -> Result<(), Error> {
        self.may_make_part(|| light_of(group))
    }
}

/// What an export says of a group whose light it misses.
pub fn light_of(group: &str) -> String {
    format!("the light of the group {group:?}")
}

/// Keeps a store below its cap, and a folder of outputs free of what killed bakes left there, when a bake is over:
/// however it ends, it has put artefacts into the store.
pub struct Tidy<'a> {
    pub store: &'a Store,
    pub folder: &'a Path,
}

impl Drop for Tidy<'_> {
    fn drop(&mut self) {
        self.store.evict();
        store::sweep(self.folder);
    }
}

pub fn not_stored(store: &Store, what: String) -> Error {
    Error::NotStored { what, store: store.folder().into() }
}
