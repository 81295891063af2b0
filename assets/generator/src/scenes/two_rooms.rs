//! Two rooms of a cubic metre with a wall of 1 cm between them; only one has a lamp.

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use luxel_scene::{Scene, build::Builder};

use crate::shapes::{PiercedWall, camera, lamp, matte};

/// The dark room, x > 1, is lit through the door alone.
pub fn two_rooms() -> Scene {
    let mut b = Builder::new("two_rooms");
    let plaster = matte(&mut b, "plaster", [0.7, 0.7, 0.7]);
    let ochre = matte(&mut b, "ochre", [0.75, 0.55, 0.3]);
    let light = lamp(&mut b, "light", [0.8, 0.8, 0.8], [60.0, 55.0, 45.0]);

    b.cuboid("shell", Vec3::ZERO, Vec3::new(2.0, 1.0, 1.0), plaster, true);
    let wall = PiercedWall {
        width: 1.0,
        height: 1.0,
        thickness: 0.01,
        hole: [Vec2::new(0.35, 0.0), Vec2::new(0.65, 0.7)],
        per_metre: 1.0,
    };
    let wall = b.add(wall.mesh("dividing wall", ochre));
    // The wall's own X runs along −Z and its front looks towards +X.
    let turn = DMat3::from_cols(DVec3::NEG_Z, DVec3::Y, DVec3::X);
    b.scene_mut().instances[wall].transform = DAffine3::from_mat3_translation(turn, DVec3::new(1.005, 0.0, 1.0));
    // A lamp that hangs a hand under the ceiling.
    b.cuboid("lamp", Vec3::new(0.4, 0.86, 0.4), Vec3::new(0.6, 0.9, 0.6), light, false);
    b.scene_mut().cameras.push(camera("camera", [1.9, 0.6, 0.9], [0.9, 0.4, 0.4], 60.0, 1.5));
    b.build()
}
