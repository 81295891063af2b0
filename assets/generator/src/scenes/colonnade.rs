//! Two rows of columns under beams and half a roof, in sun and sky.

use glam::{DVec3, Vec3};
use luxel_scene::{LightKind, Scene, Sky, build::Builder};

use crate::shapes::{camera, column, matte};

const COLUMNS: u32 = 5;
const SIDES: u32 = 20;

/// Angular diameter of the sun seen from the earth [degrees].
const SUN: f64 = 0.53;

pub fn colonnade() -> Scene {
    let mut b = Builder::new("colonnade");
    let stone = matte(&mut b, "stone", [0.6, 0.55, 0.48]);
    let paving = matte(&mut b, "paving", [0.42, 0.4, 0.38]);
    let tiles = matte(&mut b, "tiles", [0.5, 0.22, 0.14]);

    b.cuboid("ground", Vec3::new(-5.0, -0.2, -3.0), Vec3::new(5.0, 0.0, 3.0), paving, false);
    for (row, z) in [-1.2f32, 1.2].into_iter().enumerate() {
        for i in 0..COLUMNS {
            let x = -3.2 + 1.6 * i as f32;
            let foot = Vec3::new(x, 0.0, z);
            let name = |part: &str| format!("{part} {row}.{i}");
            let half = Vec3::new(0.26, 0.0, 0.26);
            b.cuboid(&name("base"), foot - half, foot + half + Vec3::Y * 0.15, stone, false);
            b.add(column(&name("shaft"), foot + Vec3::Y * 0.15, 0.18, 2.3, SIDES, stone));
            let top = foot + Vec3::Y * 2.45;
            b.cuboid(&name("capital"), top - half, top + half + Vec3::Y * 0.12, stone, false);
        }
        let (lo, hi) = (Vec3::new(-3.6, 2.57, z - 0.2), Vec3::new(3.6, 2.87, z + 0.2));
        b.cuboid(&format!("beam {row}"), lo, hi, stone, false);
    }
    b.cuboid("roof", Vec3::new(-3.8, 2.87, -1.6), Vec3::new(0.2, 2.97, 1.6), tiles, false);

    let sun = LightKind::Sun { direction: DVec3::new(-0.45, -0.75, -0.5).normalize(), angle: SUN.to_radians() };
    b.light("sun", sun, Vec3::new(80_000.0, 74_000.0, 64_000.0));
    let scene = b.scene_mut();
    scene.sky = Sky::Constant(Vec3::new(2400.0, 3200.0, 4600.0));
    scene.cameras.push(camera("camera", [5.2, 1.7, 3.4], [0.0, 1.2, -0.3], 55.0, 1.6));
    b.build()
}
