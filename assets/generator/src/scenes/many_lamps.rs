//! A hall of 4 × 1 × 2 m with two hundred small lamps under its ceiling.

use glam::{DAffine3, DVec3, Vec3};
use luxel_scene::{Mesh, Scene, build::Builder};

use crate::shapes::{Quads, camera, lamp, matte};

const ROWS: u32 = 10;
const COLUMNS: u32 = 20;

/// Lamps are glowing panes of 2 cm that hang freely and shine up and down; they have no place in the lightmap.
pub fn many_lamps() -> Scene {
    let mut b = Builder::new("many_lamps");
    let white = matte(&mut b, "plaster", [0.75, 0.75, 0.72]);
    let blue = matte(&mut b, "blue", [0.25, 0.35, 0.6]);
    let warm = pane(&mut b, "warm lamp", [120.0, 95.0, 60.0]);
    let cold = pane(&mut b, "cold lamp", [70.0, 90.0, 130.0]);

    b.cuboid("hall", Vec3::ZERO, Vec3::new(4.0, 1.0, 2.0), white, true);
    for (i, x) in [0.8f32, 2.0, 3.2].into_iter().enumerate() {
        let (lo, hi) = (Vec3::new(x - 0.15, 0.0, 0.85), Vec3::new(x + 0.15, 0.45, 1.15));
        b.cuboid(&format!("plinth {i}"), lo, hi, blue, false);
    }
    let meshes = [warm, cold];
    for row in 0..ROWS {
        for column in 0..COLUMNS {
            let at = DVec3::new(0.1 + 0.2 * f64::from(column), 0.92, 0.1 + 0.2 * f64::from(row));
            let mesh = meshes[((row / 2 + column / 5) % 2) as usize];
            let instance = b.place(mesh, DAffine3::from_translation(at), &format!("lamp {row}.{column}"));
            b.scene_mut().instances[instance].receives = false;
        }
    }
    b.scene_mut().cameras.push(camera("camera", [3.85, 0.55, 1.85], [1.6, 0.4, 0.8], 60.0, 1.6));
    b.build()
}

/// A lamp's mesh, without an instance.
fn pane(b: &mut Builder, name: &str, radiance: [f32; 3]) -> usize {
    let material = lamp(b, name, [0.8, 0.8, 0.8], radiance);
    let mut quads = Quads::default();
    quads.push(Vec3::new(-0.01, 0.0, -0.01), Vec3::X * 0.02, Vec3::Z * 0.02, 0.0);
    let scene = b.scene_mut();
    scene.materials[material].double_sided = true;
    let gltf_mesh = scene.meshes.len();
    let mut mesh = quads.mesh(name, material);
    mesh.uvs.clear();
    scene.meshes.push(Mesh { gltf_mesh, ..mesh });
    gltf_mesh
}
