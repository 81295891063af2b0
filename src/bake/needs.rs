//! The memory of work in the laboratory, estimated before any of it.

use glam::{Vec2, Vec4};
use luxel_scene::{Material, Scene};
use luxel_transport::gather::photon_map::most_arrivals;

use super::groups::Lighting;
use super::lab::Technique;
use crate::plan::{Memory, Plan, area};
use crate::settings::Settings;

/// Per arrival of a photon that a map keeps: itself, the trees over all of them, and their density, at the peak as
/// `cargo test --test memory` measures it.
const ARRIVAL: u64 = 320;

/// Photons that a light sends however few there are: sixteen from either side.
const OF_LIGHT: u64 = 32;

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
        Technique::PhotonMap { photons } => {
            Memory { rays, photons: ARRIVAL * arrivals(scene, &plan, photons), ..Memory::default() }
        }
        Technique::SampleVoxels { .. } | Technique::Voxels | Technique::Cached(_) => {
            Memory { rays, surfels: plan.memory_of_surfels(scene, settings), ..Memory::default() }
        }
    }
}

/// Arrivals of so many photons that a map keeps, if every surface sends on what all do in the mean, and nothing escapes.
fn arrivals(scene: &Scene, plan: &Plan, photons: u32) -> u64 {
    let facts = &plan.facts;
    let lights = facts.emissive_triangles + facts.lamps + facts.suns + usize::from(facts.sky);
    let sent = u64::from(photons) + OF_LIGHT * lights as u64;
    // Beyond the end of an integer the bound holds.
    ((sent as f64 / (1.0 - sent_on(scene)).max(f64::MIN_POSITIVE)) as u64).min(most_arrivals(photons))
}

/// Share of the light that surfaces send on, as the mean over their area.
fn sent_on(scene: &Scene) -> f64 {
    let share = |m: &Material| {
        let all = m.surface(&scene.textures, &|_| Vec2::splat(0.5), Vec4::ONE, 1.0);
        f64::from((all.albedo * all.coverage + all.transmittance).element_sum()) / 3.0
    };
    let shares: Vec<f64> = scene.materials.iter().map(share).collect();
    let (mut sum, mut whole) = (0.0, 0.0);
    for instance in scene.instances.iter().filter(|i| i.casts) {
        let material = scene.meshes[instance.mesh].material;
        if !scene.materials[material].unlit {
            let area = area(scene, instance);
            (sum, whole) = (sum + area * shares[material], whole + area);
        }
    }
    if whole > 0.0 { (sum / whole).clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_scene::build::Builder;

    fn room(albedo: f32) -> Scene {
        let mut b = Builder::new("room");
        let wall = b.matte(Vec3::splat(albedo));
        let lamp = b.emitter(Vec3::ZERO, Vec3::ONE);
        b.cuboid("shell", Vec3::ZERO, Vec3::ONE, wall, true);
        b.quad("lamp", Vec3::new(0.4, 0.9, 0.4), Vec3::X * 0.01, Vec3::Z * 0.01, lamp);
        b.build()
    }

    #[test]
    fn brighter_rooms_and_more_lights_take_more_photons_up_to_what_a_map_keeps() {
        let of = |scene: &Scene, photons| {
            method(scene, &Settings::default(), Technique::PhotonMap { photons }).photons as f64 / ARRIVAL as f64
        };
        for (albedo, expected) in [(0.0, 1.0), (0.5, 2.0), (0.8, 5.0), (0.999, 16.0)] {
            let found = of(&room(albedo), 100_000) / 100_000.0;
            assert!((found / expected - 1.0).abs() < 0.01, "{albedo}: {found}");
        }
        let mut crowd = room(0.5);
        let lamp = crowd.instances[1].clone();
        crowd.instances.extend((0..1000).map(|_| lamp.clone()));
        let most = most_arrivals(1000) as f64;
        assert!(of(&room(0.5), 1000) < 0.2 * most && of(&crowd, 1000) == most);
        assert!(of(&room(0.999), u32::MAX).is_finite());
    }
}
