//! The memory of work in the laboratory, estimated before any of it.

use luxel_scene::Scene;

use super::groups::Lighting;
use super::lab::Technique;
use crate::plan::{Memory, Plan};
use crate::settings::Settings;

/// Per photon of a map: its arrivals, the tree over them, and their density, as in the Cornell box. Brighter rooms take
/// more.
const PHOTON: u64 = 300;

/// Of a bake in memory: all but the files that it would write.
pub fn bake(scene: &Scene, settings: &Settings) -> Memory {
    let mut unit = scene.clone();
    let lighting = Lighting::part(&mut unit, settings);
    let mut plan = Plan::new(&unit, settings);
    plan.part(lighting.groups.iter().map(|g| g.name.clone()).collect(), settings);
    plan.least_memory(settings)
}

/// Of a method, whatever it is asked for.
pub fn method(scene: &Scene, settings: &Settings, technique: Technique) -> Memory {
    let plan = Plan::new(scene, settings);
    let rays = plan.memory_of_rays();
    match technique {
        Technique::PathTracing { .. } => Memory { rays, ..Memory::default() },
        Technique::PhotonMap { photons } => Memory { rays, photons: PHOTON * u64::from(photons), ..Memory::default() },
        Technique::SampleVoxels { .. } | Technique::Voxels | Technique::Cached(_) => {
            Memory { rays, surfels: plan.memory_of_surfels(scene, settings), ..Memory::default() }
        }
    }
}
