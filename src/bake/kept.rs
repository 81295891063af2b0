//! What a process keeps of its last bake for the next one: the atlas, which takes a tenth of a second to draw from its
//! artefacts and is the same as long as what receives light has its shape.

use std::sync::{Arc, Mutex, PoisonError};

use luxel_atlas::{Atlas, AtlasReport};

use crate::store::Key;

/// Most texels that are kept, 28 bytes each.
const MOST: usize = 4 << 20;

/// Shared by the bakes of one watch. Each takes out what is its own, and what is another's is dropped.
#[derive(Clone, Debug, Default)]
pub struct Kept(Arc<Mutex<Option<Drawn>>>);

#[derive(Debug)]
struct Drawn {
    /// That of the layout: an atlas is a function of what the layout reads.
    key: Key,
    atlas: Arc<Atlas>,
    report: AtlasReport,
}

impl Kept {
    /// The atlas of a layout, if it was the last one.
    pub(super) fn atlas(&self, key: &Key) -> Option<(Arc<Atlas>, AtlasReport)> {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *last = last.take().filter(|drawn| drawn.key == *key);
        last.as_ref().map(|drawn| (drawn.atlas.clone(), drawn.report.clone()))
    }

    pub(super) fn keep(&self, key: &Key, atlas: &Arc<Atlas>, report: &AtlasReport) {
        let drawn = Drawn { key: *key, atlas: atlas.clone(), report: report.clone() };
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = (atlas.texels.len() <= MOST).then_some(drawn);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_atlas_is_kept_for_its_own_layout() {
        let kept = Kept::default();
        let atlas = Arc::new(Atlas::default());
        kept.keep(&[1; 32], &atlas, &AtlasReport::default());
        assert!(kept.clone().atlas(&[1; 32]).is_some_and(|(again, _)| Arc::ptr_eq(&again, &atlas)));
        assert!(kept.atlas(&[2; 32]).is_none());
        assert!(kept.atlas(&[1; 32]).is_none(), "another scene's bake has dropped it");
    }
}
