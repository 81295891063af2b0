//! The memory that pictures take beyond their scene, estimated before any work.

use luxel_scene::Scene;

use super::method::Way;
use crate::bake::lab::Technique;
use crate::bake::needs;
use crate::plan::Memory;
use crate::settings::{Gatherer, Settings};

/// Per pixel of every picture that is held: its radiance, the part of it that surfaces reflect, its error.
const HELD: u64 = 28;

/// Per pixel while one of them is written.
const WRITTEN: u64 = 8;

/// Of pictures by these ways, of so many pixels each. A view that luxel chooses is chosen by the voxel solution.
pub fn estimate(scene: &Scene, settings: &Settings, ways: &[Way], pixels: u64, has_camera: bool) -> Memory {
    let lookup = Way::Found(Technique::Cached(Gatherer::Lookup));
    let chooses = (!has_camera).then_some(lookup);
    let each = |way: &Way| match way {
        Way::Found(technique) => needs::method(scene, settings, *technique),
        // The tree of rays of the picture stands beside that of the bake.
        Way::Lightmap => {
            let bake = needs::bake(scene, settings);
            Memory { rays: bake.rays.saturating_mul(2), ..bake }
        }
    };
    // Passes are blended with those before them, and methods are compared when all have their picture.
    let blends = |way: &Way| matches!(way, Way::Found(Technique::PathTracing { .. } | Technique::SampleVoxels { .. }));
    let held = ways.len().max(1 + usize::from(ways.iter().any(blends))) as u64;
    let picture = pixels.saturating_mul(HELD.saturating_mul(held) + WRITTEN);
    let most = ways.iter().chain(&chooses).map(each).fold(Memory::default(), Memory::max);
    Memory { picture, ..most }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_takes_what_its_method_reads() {
        let (scene, settings) = (luxel_assets::cornell(), Settings::default());
        let of = |ways: &[Way], has_camera| estimate(&scene, &settings, ways, 1000, has_camera);
        let paths = Way::Found(Technique::PathTracing { paths: 4 });
        let map = Way::Found(Technique::PhotonMap { photons: 10 });
        let voxels = Way::Found(Technique::Voxels);
        let bake = needs::bake(&scene, &settings);
        assert!(of(&[paths], true).rays == bake.rays && bake.rays > 0);
        assert_eq!((of(&[paths], true).surfels, of(&[paths], false).surfels), (0, bake.surfels));
        assert_eq!((of(&[voxels], true).surfels, of(&[voxels], true).photons), (bake.surfels, 0));
        assert!(of(&[map], true).photons > of(&[Way::Found(Technique::PhotonMap { photons: 1 })], true).photons);
        let lightmap = of(&[Way::Lightmap], true);
        assert_eq!((lightmap.texels, lightmap.rays), (bake.texels, 2 * bake.rays));
        // Side by side they take what the largest takes, and all of their pictures.
        let all = of(&[paths, map, voxels], true);
        assert_eq!((all.surfels, all.picture), (bake.surfels, 1000 * (3 * HELD + WRITTEN)));
        assert_eq!(of(&[voxels], true).picture, 1000 * (HELD + WRITTEN));
    }
}
