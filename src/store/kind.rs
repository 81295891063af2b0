//! What is stored: one kind of artefact per stage whose result outlives its bake, and what `luxel report` found out.

use super::Format;

/// Longest body of an artefact that is read [bytes].
const LIMIT: u64 = 8 << 30;

/// A kind of artefact. The order is that of the stages, each of which reads earlier ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// The charts of one mesh.
    Unwrap,
    /// Where charts lie in the atlas, and its texels.
    Layout,
    /// Voxels and their surfels.
    Surfels,
    /// Direct irradiance at surfels.
    Shoot,
    /// The light at surfels after all bounces: the octree irradiance cache.
    Solution,
    /// Buried texels, moved or marked.
    Clear,
    /// Irradiance at texels that lamps, suns and emissive surfaces make directly.
    Direct,
    /// Irradiance at texels that the sky makes directly.
    Sky,
    /// Indirect irradiance at texels.
    Gather,
    /// Finished images.
    Finish,
    /// Irradiance at some texels by the reference path tracer, of a report.
    Reference,
    /// What one bake or method cost and how exact it was, of a report.
    Measurement,
    /// The settings that were found for an error.
    Choice,
    /// The figures of the paper's Table 1 of one bake, of a report.
    Figures,
    /// Light at the texels of an error map, of a report.
    Map,
}

impl Kind {
    /// What bakes make.
    pub const BAKED: [Self; 10] = [
        Self::Unwrap,
        Self::Layout,
        Self::Surfels,
        Self::Shoot,
        Self::Solution,
        Self::Clear,
        Self::Direct,
        Self::Sky,
        Self::Gather,
        Self::Finish,
    ];

    pub const ALL: [Self; 15] = {
        let mut all = [Self::Choice; 15];
        let mut i = 0;
        while i < Self::BAKED.len() {
            all[i] = Self::BAKED[i];
            i += 1;
        }
        (all[10], all[11]) = (Self::Reference, Self::Measurement);
        (all[13], all[14]) = (Self::Figures, Self::Map);
        all
    };

    /// The name of its folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unwrap => "unwrap",
            Self::Layout => "layout",
            Self::Surfels => "surfels",
            Self::Shoot => "shoot",
            Self::Solution => "solution",
            Self::Clear => "clear",
            Self::Direct => "direct",
            Self::Sky => "sky",
            Self::Gather => "gather",
            Self::Finish => "finish",
            Self::Reference => "reference",
            Self::Measurement => "measurement",
            Self::Choice => "choice",
            Self::Figures => "figures",
            Self::Map => "map",
        }
    }

    /// How its files are told from others; the version is raised whenever the meaning of a body changes.
    pub fn format(self) -> Format {
        let (letters, version) = match self {
            Self::Unwrap => (b"Unw", 1),
            Self::Layout => (b"Lay", 1),
            Self::Surfels => (b"Srf", 1),
            Self::Shoot => (b"Sht", 2),
            Self::Solution => (b"Sol", 3),
            Self::Clear => (b"Clr", 1),
            Self::Direct => (b"Dir", 1),
            Self::Sky => (b"Sky", 1),
            Self::Gather => (b"Gth", 3),
            Self::Finish => (b"Fin", 3),
            Self::Reference => (b"Ref", 2),
            Self::Measurement => (b"Mea", 1),
            Self::Choice => (b"Cho", 1),
            Self::Figures => (b"Fig", 1),
            Self::Map => (b"Map", 1),
        };
        let mut magic = *b"luxel\0\0\0";
        magic[5..].copy_from_slice(letters);
        Format { magic, version, limit: LIMIT }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn no_two_kinds_share_a_folder_or_a_magic() {
        let names: BTreeSet<_> = Kind::ALL.iter().map(|kind| kind.name()).collect();
        let magics: BTreeSet<_> = Kind::ALL.iter().map(|kind| kind.format().magic).collect();
        assert_eq!((names.len(), magics.len()), (Kind::ALL.len(), Kind::ALL.len()));
        assert!(magics.iter().all(|magic| magic.starts_with(b"luxel") && *magic != super::super::OCTREE.magic));
    }
}
