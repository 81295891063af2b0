//! The scenes that luxel ships, as code: for `assets/*.glb`, and for tests that want the same scenes without a file.
//!
//! | scene | what it shows |
//! |---|---|
//! | [`cornell`] | colour bleeding, an area light, contact with the floor |
//! | [`two_rooms`] | a dark room that is lit through a door only, walls thinner than a voxel |
//! | [`colonnade`] | sun and sky, curved surfaces, an open scene |
//! | [`textured_room`] | textures, holes, coloured glass, a window |
//! | [`many_lamps`] | two hundred lamps in one hall |
//!
//! Lengths are metres, radiances cd/m², illuminances lux. Surfaces look inwards and have one side, or are closed bodies.

pub mod glb;
mod scenes;
mod shapes;
mod textures;

use luxel_scene::Scene;

pub use scenes::colonnade::colonnade;
pub use scenes::cornell::cornell;
pub use scenes::many_lamps::many_lamps;
pub use scenes::textured_room::textured_room;
pub use scenes::two_rooms::two_rooms;

/// Every scene under the name of its file.
pub fn all() -> Vec<(&'static str, Scene)> {
    vec![
        ("cornell", cornell()),
        ("two_rooms", two_rooms()),
        ("colonnade", colonnade()),
        ("textured_room", textured_room()),
        ("many_lamps", many_lamps()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_files_in_assets_are_what_the_generator_writes() {
        for (name, scene) in all() {
            let path = format!("{}/../{name}.glb", env!("CARGO_MANIFEST_DIR"));
            let shipped = std::fs::read(&path).unwrap_or_default();
            let written = glb::write(&scene).unwrap();
            assert!(shipped == written, "{name}.glb is out of date: run `cargo run -p luxel-assets`");
            assert!(written.len() < 200_000, "{name}.glb has {} bytes", written.len());
        }
    }

    #[test]
    fn every_scene_has_a_camera_light_names_and_sound_geometry() {
        for (name, scene) in all() {
            assert!(!scene.cameras.is_empty(), "{name} has no camera");
            assert!(!scene.lights.is_empty() || scene.materials.iter().any(|m| m.emits()), "{name} is dark");
            assert!(scene.materials.iter().all(|m| !m.name.is_empty()));
            for (i, mesh) in scene.meshes.iter().enumerate() {
                assert!(!mesh.name.is_empty());
                for t in 0..mesh.triangles.len() {
                    let [a, b, c] = scene.corners(i, t);
                    assert!((b - a).cross(c - a).length() > 1e-9, "{name}: {} has a needle", mesh.name);
                }
                let vertices = mesh.positions.len();
                assert!(mesh.normals.is_empty() || mesh.normals.len() == vertices);
                assert!(mesh.uvs.iter().all(|set| set.is_empty() || set.len() == vertices));
            }
        }
    }
}
