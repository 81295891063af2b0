//! What a process keeps of its last bake for the next one, beside the store: what takes a tenth of a second to make and
//! is the same as long as the scene has its shape. That is the atlas, drawn from its artefacts, and the tree of rays.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use luxel_atlas::{Atlas, AtlasReport, Placed};
use luxel_transport::rays::Tree;

use crate::store::Key;

/// Most bytes of an atlas, and of a tree, that are kept: together they stay below what a watch at rest may take.
const MOST_ATLAS: usize = 80 << 20;
const MOST_TREE: usize = 64 << 20;

/// Shared by the bakes of one watch. Each takes out what is its own, and what is another's is dropped.
#[derive(Clone, Debug, Default)]
pub struct Kept(Arc<Mutex<Last>>);

#[derive(Debug, Default)]
struct Last {
    /// By what it was drawn from.
    atlas: Option<(Key, (Arc<Atlas>, AtlasReport))>,
    /// By the digest of all that rays meet.
    tree: Option<(Key, Arc<Tree>)>,
}

impl Kept {
    /// The atlas that was drawn from this, if it was the last one.
    pub(super) fn atlas(&self, drawn_from: &Key) -> Option<(Arc<Atlas>, AtlasReport)> {
        own(&mut self.last().atlas, drawn_from)
    }

    pub(super) fn keep_atlas(&self, drawn_from: &Key, atlas: &Arc<Atlas>, report: &AtlasReport) {
        let is_small = bytes(atlas) <= MOST_ATLAS;
        self.last().atlas = is_small.then(|| (*drawn_from, (atlas.clone(), report.clone())));
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

/// Bytes that an atlas holds.
fn bytes(atlas: &Atlas) -> usize {
    let placed = |p: &Placed| size_of_val(&p.source[..]) + size_of_val(&p.uvs[..]) + size_of_val(&p.triangles[..]);
    let placed: usize = atlas.placed.iter().flatten().map(placed).sum();
    placed + size_of_val(&atlas.placed[..]) + size_of_val(&atlas.texels[..]) + size_of_val(&atlas.charts[..])
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
    fn the_last_atlas_is_kept_for_its_own_scene() {
        let kept = Kept::default();
        let atlas = Arc::new(Atlas::default());
        kept.keep_atlas(&[1; 32], &atlas, &AtlasReport::default());
        assert!(kept.clone().atlas(&[1; 32]).is_some_and(|(again, _)| Arc::ptr_eq(&again, &atlas)));
        assert!(kept.atlas(&[2; 32]).is_none());
        assert!(kept.atlas(&[1; 32]).is_none(), "another scene's bake has dropped it");
        // Many instances of a mesh in a small picture.
        let triangles = vec![[0; 3]; 1 << 20];
        let placed = Some(Placed { page: 0, source: Vec::new(), uvs: Vec::new(), triangles });
        let large = Arc::new(Atlas { placed: vec![placed; 8], ..Atlas::default() });
        kept.keep_atlas(&[1; 32], &large, &AtlasReport::default());
        assert!(kept.atlas(&[1; 32]).is_none());
    }
}
