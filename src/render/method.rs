//! The methods by which pictures can be made, by their names.

use crate::bake::lab::Technique;
use crate::settings::Gatherer;

/// Where a picture's light comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Way {
    /// The finished lightmap.
    Lightmap,
    /// Found at the points that are seen.
    Found(Technique),
}

impl Way {
    /// The cached voxel solution is what it starts from, so that methods that are compared share it.
    pub fn rests_on_solution(&self) -> bool {
        matches!(self, Self::Found(technique) if technique.is_cached())
    }
}

/// A method that can be named.
#[derive(Debug)]
pub struct Entry {
    pub name: &'static str,
    /// What it is, in a few words.
    pub title: &'static str,
    /// What is drawn at random for every point, where its number can be chosen: more of them, less noise.
    pub draws: Option<Draws>,
    /// The method with so many draws.
    make: fn(u32) -> Way,
}

/// Random draws of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Draws {
    /// What they are called.
    pub name: &'static str,
    /// How many there are unless somebody says it.
    pub usual: u32,
    /// Fewest of a picture or a pass: with less nothing is known of their noise, and every difference would be an edge.
    pub least: u32,
    /// How many the first of several passes has; none for a method that has to draw all at once.
    pub first: Option<u32>,
    /// Pictures are shown as they get better without being asked for.
    pub is_progressive: bool,
}

/// Walks from every point.
const PATHS: Draws = Draws { name: "paths", usual: 64, least: 2, first: Some(4), is_progressive: false };
/// Of two sets of sample voxels for every point.
const PASSES: Draws = Draws { name: "passes", usual: 8, least: 1, first: Some(1), is_progressive: true };
/// For the whole scene.
const PHOTONS: Draws = Draws { name: "photons", usual: 50_000, least: 1, first: None, is_progressive: false };

/// All of them; the first is the default.
pub static METHODS: &[Entry] = &[
    Entry {
        name: "lightcuts",
        title: "voxel solution, lightcuts at every point",
        draws: None,
        make: |_| Way::Found(Technique::Cached(Gatherer::Lightcuts)),
    },
    Entry { name: "lightmap", title: "the baked lightmap", draws: None, make: |_| Way::Lightmap },
    Entry {
        name: "lookup",
        title: "voxel solution, interpolated",
        draws: None,
        make: |_| Way::Found(Technique::Cached(Gatherer::Lookup)),
    },
    Entry {
        name: "final",
        title: "voxel solution, final gather",
        draws: None,
        make: |_| Way::Found(Technique::Cached(Gatherer::Final)),
    },
    Entry {
        name: "samples",
        title: "voxel solution, random sample voxels",
        draws: Some(PASSES),
        make: |passes| Way::Found(Technique::SampleVoxels { passes }),
    },
    Entry {
        name: "voxels",
        title: "voxel solution, shown directly",
        draws: None,
        make: |_| Way::Found(Technique::Voxels),
    },
    Entry {
        name: "photons",
        title: "photon mapping with lightcuts",
        draws: Some(PHOTONS),
        make: |photons| Way::Found(Technique::PhotonMap { photons }),
    },
    Entry {
        name: "paths",
        title: "path tracing, the reference",
        draws: Some(PATHS),
        make: |paths| Way::Found(Technique::PathTracing { paths }),
    },
];

/// A method with what it may spend.
#[derive(Clone, Copy, Debug)]
pub struct Chosen {
    pub entry: &'static Entry,
    /// Of its draws; none for methods without.
    pub draws: u32,
}

impl Chosen {
    /// Where its light comes from when it may draw `draws` times.
    pub fn way(&self, draws: u32) -> Way {
        (self.entry.make)(draws)
    }

    /// Draws of its first pass, where it can be shown as it gets better.
    pub fn first_pass(&self) -> Option<u32> {
        self.entry.draws?.first
    }

    /// Fewest draws of a pass.
    pub fn least(&self) -> u32 {
        self.entry.draws.map_or(1, |draws| draws.least)
    }

    /// As in a label: its name, and how many draws it may have.
    pub fn label(&self) -> String {
        match self.entry.draws {
            Some(draws) if draws.name == self.entry.name => format!("{} {}", self.draws, draws.name),
            Some(draws) => format!("{}, {} {}", self.entry.name, self.draws, draws.name),
            None => self.entry.name.into(),
        }
    }
}

/// The method of this name.
///
/// # Errors
/// Names those that there are.
pub fn named(name: &str) -> Result<&'static Entry, String> {
    METHODS.iter().find(|e| e.name == name).ok_or_else(|| {
        let names: Vec<&str> = METHODS.iter().map(|e| e.name).collect();
        format!("there is no method {name:?}; there are: {}", names.join(", "))
    })
}

/// Draws of the passes that end with `total`: each doubles what there is, so that a first picture comes soon and every
/// further one has less noise. What would be left for less than `least` draws goes with the pass before.
pub fn passes(first: u32, least: u32, total: u32) -> impl Iterator<Item = u32> {
    let mut spent = 0;
    std::iter::from_fn(move || {
        let rest = total - spent;
        let next = if spent == 0 { first } else { spent }.min(rest);
        let next = if rest - next < least { rest } else { next };
        spent += next;
        (next > 0).then_some(next)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_distinct_and_found() {
        for (i, entry) in METHODS.iter().enumerate() {
            assert!(std::ptr::eq(named(entry.name).unwrap(), entry), "{}", entry.name);
            assert!(METHODS[..i].iter().all(|e| e.name != entry.name));
        }
        let said = named("radiosity").unwrap_err();
        assert!(said.contains("lightcuts") && said.contains("paths"), "{said}");
    }

    #[test]
    fn every_pass_doubles_and_the_last_spends_the_rest() {
        assert_eq!(passes(4, 2, 100).collect::<Vec<_>>(), [4, 4, 8, 16, 32, 36]);
        assert_eq!(passes(4, 2, 3).collect::<Vec<_>>(), [3]);
        assert_eq!(passes(4, 2, 0).count(), 0);
        assert_eq!(passes(1, 1, u32::MAX).map(u64::from).sum::<u64>(), u64::from(u32::MAX));
    }

    #[test]
    fn no_pass_is_too_small_to_know_its_noise() {
        assert_eq!(passes(4, 2, 5).collect::<Vec<_>>(), [5]);
        assert_eq!(passes(4, 2, 17).collect::<Vec<_>>(), [4, 4, 9]);
        assert_eq!(passes(1, 1, 3).collect::<Vec<_>>(), [1, 1, 1]);
        for draws in METHODS.iter().filter_map(|entry| entry.draws) {
            assert!(draws.least <= draws.usual && draws.first.is_none_or(|first| draws.least <= first));
        }
    }
}
