//! One scene of a watch: how it was seen last, what its outputs were made from, and what follows from that.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use super::Options;
use super::depend::Look;
use super::event::Fault;
use super::place::Place;
use crate::current;
use crate::discover::Found;

/// One scene.
pub struct Item {
    pub found: Found,
    /// It exists, and a search finds it.
    pub here: bool,
    /// As it was seen last.
    pub look: Look,
    /// The paths it depends on, by the names under which events speak of them.
    pub keys: BTreeMap<PathBuf, PathBuf>,
    /// Where those are, or would appear.
    pub folders: BTreeSet<PathBuf>,
    /// What its last good bake read.
    pub read: BTreeSet<PathBuf>,
    /// What its outputs were made from.
    pub baked: Option<Look>,
    pub outputs: Vec<PathBuf>,
    /// The real name of the .glb that a bake of it writes: no other scene may write there.
    pub target: Option<PathBuf>,
    pub failed: Option<Failure>,
    /// The higher, the later it has changed.
    pub changed: u64,
}

/// What could not be baked, and why.
pub struct Failure {
    pub look: Look,
    pub fault: Fault,
    /// It follows from the look alone: the same look fails again.
    pub is_lasting: bool,
}

impl Item {
    pub fn new(found: Found) -> Self {
        let nothing = Fault::default();
        Self {
            found,
            here: true,
            look: Look { files: BTreeMap::new(), settings: Err(nothing.clone()), outputs: Err(nothing) },
            keys: BTreeMap::new(),
            folders: BTreeSet::new(),
            read: BTreeSet::new(),
            baked: None,
            outputs: Vec::new(),
            target: None,
            failed: None,
            changed: 0,
        }
    }

    /// Finds out under which names events will speak of what a look saw.
    pub fn find(&mut self, look: &Look, options: &Options) {
        (self.keys, self.folders) = Default::default();
        let settings = options.choices.file(&self.found.scene);
        for path in look.files.keys().chain([&settings]) {
            for place in Place::all(path) {
                self.keys.insert(place.key, path.clone());
                self.folders.insert(place.folder);
            }
        }
    }

    /// It is to be baked as it is now.
    pub fn is_wanted(&self) -> bool {
        self.here && self.baked.as_ref() != Some(&self.look) && !self.is_broken()
    }

    /// Outputs that would be current and are not there any more, whoever took them away: the scene is to be baked again.
    pub fn lose(&mut self) -> Vec<PathBuf> {
        if !self.here || self.baked.as_ref() != Some(&self.look) {
            return Vec::new();
        }
        let lost: Vec<PathBuf> = self.outputs.iter().filter(|file| !file.exists()).cloned().collect();
        self.baked.take_if(|_| !lost.is_empty());
        lost
    }

    /// Whether its outputs, as they lie there, are a draft.
    pub fn kept(&self) -> Option<bool> {
        current::is_draft(self.look.outputs.as_ref().ok()?)
    }

    /// It could not be baked as it is now.
    pub fn is_broken(&self) -> bool {
        self.here && self.failed.as_ref().is_some_and(|f| f.look == self.look)
    }
}
