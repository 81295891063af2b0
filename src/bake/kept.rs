//! What a process keeps of its last bake for the next one, beside the store: what takes a tenth of a second to make and
//! is the same as long as the scene has its shape. That is the atlas, drawn from its artefacts, and the tree of rays.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use luxel_atlas::{Atlas, AtlasReport, Texel};
use luxel_transport::rays::Tree;

use crate::store::Key;

/// Most bytes of texels, and of a tree, that are kept: together they stay below what a watch at rest may take.
const MOST_TEXELS: usize = 80 << 20;
const MOST_TREE: usize = 64 << 20;

/// Shared by the bakes of one watch. Each takes out what is its own, and what is another's is dropped.
#[derive(Clone, Debug, Default)]
pub struct Kept(Arc<Mutex<Last>>);

#[derive(Debug, Default)]
struct Last {
    /// By the key of its layout: an atlas is a function of what the layout reads.
    atlas: Option<(Key, (Arc<Atlas>, AtlasReport))>,
    /// By the digest of all that rays meet.
    tree: Option<(Key, Arc<Tree>)>,
}

impl Kept {
    /// The atlas of a layout, if it was the last one.
    pub(super) fn atlas(&self, layout: &Key) -> Option<(Arc<Atlas>, AtlasReport)> {
        own(&mut self.last().atlas, layout)
    }

    pub(super) fn keep_atlas(&self, layout: &Key, atlas: &Arc<Atlas>, report: &AtlasReport) {
        let is_small = size_of::<Texel>() * atlas.texels.len() <= MOST_TEXELS;
        self.last().atlas = is_small.then(|| (*layout, (atlas.clone(), report.clone())));
    }

    /// The tree over a shape, if it was the last one.
    pub(super) fn tree(&self, shape: &Key) -> Option<Arc<Tree>> {
        own(&mut self.last().tree, shape)
    }

    pub(super) fn keep_tree(&self, shape: &Key, tree: &Arc<Tree>) {
        self.last().tree = (tree.bytes() <= MOST_TREE).then(|| (*shape, tree.clone()));
    }

    fn last(&self) -> MutexGuard<'_, Last> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What is kept under this key; what is under another one goes.
fn own<T: Clone>(kept: &mut Option<(Key, T)>, key: &Key) -> Option<T> {
    *kept = kept.take().filter(|(of, _)| of == key);
    kept.as_ref().map(|(_, kept)| kept.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_atlas_is_kept_for_its_own_layout() {
        let kept = Kept::default();
        let atlas = Arc::new(Atlas::default());
        kept.keep_atlas(&[1; 32], &atlas, &AtlasReport::default());
        assert!(kept.clone().atlas(&[1; 32]).is_some_and(|(again, _)| Arc::ptr_eq(&again, &atlas)));
        assert!(kept.atlas(&[2; 32]).is_none());
        assert!(kept.atlas(&[1; 32]).is_none(), "another scene's bake has dropped it");
    }
}
