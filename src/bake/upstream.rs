//! What an artefact was made from: to be kept in a store as long as what was made of it is used.
//!
//! A bake reads the last artefact that serves and none of those before it, which the next edit may need all the same: who
//! moves lamps all day reads finished images or gathers, and would lose the octrees and surfels as the least recently
//! used.

use super::Baking;
use crate::store::{Key, Kind};

impl Baking<'_> {
    /// Records that an artefact of a light group was found: everything that it follows from was used with it. What is of
    /// no group is of any.
    pub fn found(&self, kind: Kind, group: usize) {
        for (kind, key) in self.upstream(kind, group) {
            if let Some(store) = self.store {
                store.touch(kind, &key);
            }
        }
    }

    fn upstream(&self, kind: Kind, group: usize) -> Vec<(Kind, Key)> {
        let keys = self.keys;
        let own = &keys.groups[group];
        let surfels = (Kind::Surfels, keys.surfels);
        match kind {
            Kind::Shoot => vec![surfels],
            Kind::Solution => vec![(Kind::Shoot, own.shoot), surfels],
            Kind::Gather => vec![(Kind::Solution, own.solution), (Kind::Shoot, own.shoot), surfels],
            Kind::Finish => {
                let clear = (Kind::Clear, keys.clear);
                let of = [clear, (Kind::Direct, own.direct), (Kind::Sky, keys.sky), (Kind::Gather, own.gather)];
                of.into_iter().chain(self.upstream(Kind::Gather, group)).collect()
            }
            // What these were made from, a bake that reads them reads itself.
            Kind::Unwrap | Kind::Layout | Kind::Surfels | Kind::Clear | Kind::Direct | Kind::Sky => Vec::new(),
            // No bake reads what a report found out.
            Kind::Reference | Kind::Measurement | Kind::Choice | Kind::Figures | Kind::Map => Vec::new(),
        }
    }
}
