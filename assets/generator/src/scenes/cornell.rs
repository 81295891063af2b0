//! The Cornell box (Goral et al. 1984, with the proportions that Cornell measured later): 0.55 m, open in front.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use luxel_scene::{Scene, build::Builder};

use crate::shapes::{Quads, camera, lamp, matte};

/// A lamp is let into the ceiling; a low and a high block stand on the floor.
pub fn cornell() -> Scene {
    let mut b = Builder::new("cornell");
    let white = matte(&mut b, "white", [0.725, 0.71, 0.68]);
    let red = matte(&mut b, "red", [0.63, 0.065, 0.05]);
    let green = matte(&mut b, "green", [0.14, 0.45, 0.091]);
    let light = lamp(&mut b, "light", [0.78, 0.78, 0.78], [17.0, 12.0, 4.0]);

    let s = 0.55;
    let h = 0.5 * s;
    let (x, y, z) = (Vec3::X * s, Vec3::Y * s, Vec3::Z * s);
    b.quad("floor", Vec3::new(-h, 0.0, h), x, -z, white);
    b.quad("back wall", Vec3::new(-h, 0.0, -h), x, y, white);
    b.quad("left wall", Vec3::new(-h, 0.0, h), -z, y, red);
    b.quad("right wall", Vec3::new(h, 0.0, -h), z, y, green);
    ceiling(&mut b, s, white, light);
    block(&mut b, "low block", 0.165, [0.0925, 0.0925], -17.0, white);
    block(&mut b, "high block", 0.33, [-0.0925, -0.0725], 17.0, white);
    b.scene_mut().cameras.push(camera("camera", [0.0, 0.275, 1.065], [0.0, 0.275, 0.0], 39.0, 1.0));
    b.build()
}

/// The ceiling around the lamp, and the lamp in it.
fn ceiling(b: &mut Builder, s: f32, white: usize, light: usize) {
    let h = 0.5 * s;
    let (xs, zs) = ([-h, -0.065, 0.065, h], [-h, -0.0525, 0.0525, h]);
    let mut around = Quads::default();
    for i in 0..3 {
        for j in 0..3 {
            let corner = Vec3::new(xs[i], s, zs[j]);
            let (dx, dz) = (Vec3::X * (xs[i + 1] - xs[i]), Vec3::Z * (zs[j + 1] - zs[j]));
            if (i, j) == (1, 1) {
                b.quad("lamp", corner, dx, dz, light);
            } else {
                around.push(corner, dx, dz, 1.0);
            }
        }
    }
    b.add(around.mesh("ceiling", white));
}

/// A block of 0.165 m square without an underside, turned about the vertical by `degrees`.
fn block(b: &mut Builder, name: &str, height: f32, [x, z]: [f64; 2], degrees: f64, material: usize) {
    let (r, y) = (0.0825, Vec3::Y * height);
    let w = 2.0 * r;
    let mut quads = Quads::default();
    quads
        .push(Vec3::new(-r, 0.0, r), Vec3::X * w, y, 1.0)
        .push(Vec3::new(r, 0.0, -r), Vec3::NEG_X * w, y, 1.0)
        .push(Vec3::new(r, 0.0, r), Vec3::NEG_Z * w, y, 1.0)
        .push(Vec3::new(-r, 0.0, -r), Vec3::Z * w, y, 1.0)
        .push(Vec3::new(-r, height, r), Vec3::X * w, Vec3::NEG_Z * w, 1.0);
    let instance = b.add(quads.mesh(name, material));
    // The half angle's sine and cosine from libm, so that the file has the same bytes everywhere.
    let half = 0.5 * degrees.to_radians();
    let turn = DQuat::from_xyzw(0.0, libm::sin(half), 0.0, libm::cos(half));
    let place = DAffine3::from_rotation_translation(turn, DVec3::new(x, 0.0, z));
    b.scene_mut().instances[instance].transform = place;
}
