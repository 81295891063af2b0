//! A room with brick walls and a tiled floor; the sun falls through stained glass and a grating.

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3, Vec4};
use luxel_scene::{Alpha, LightKind, Material, Scene, Sky, TextureRef, build::Builder};

use crate::shapes::{PiercedWall, Quads, camera, matte};
use crate::textures;

pub fn textured_room() -> Scene {
    let mut b = Builder::new("textured_room");
    let materials = Materials::new(&mut b);
    shell(&mut b, &materials);
    window(&mut b, &materials);
    furniture(&mut b, &materials);

    // Through the window in the wall x = 0, which looks towards −X.
    let sun = LightKind::Sun { direction: DVec3::new(0.8, -0.62, 0.18).normalize(), angle: 0.53f64.to_radians() };
    b.light("sun", sun, Vec3::new(2000.0, 1850.0, 1600.0));
    let spot = LightKind::Spot {
        position: DVec3::new(3.2, 2.45, 0.7),
        direction: DVec3::new(0.1, -1.0, 0.1).normalize(),
        inner: 0.35,
        outer: 0.6,
        range: None,
        radius: 0.04,
    };
    b.light("spot", spot, Vec3::new(120.0, 110.0, 90.0));
    let scene = b.scene_mut();
    scene.sky = Sky::Constant(Vec3::new(60.0, 80.0, 115.0));
    scene.cameras.push(camera("camera", [3.8, 1.5, 2.8], [0.9, 1.05, 1.1], 65.0, 1.5));
    b.build()
}

struct Materials {
    tiles: usize,
    brick: usize,
    plaster: usize,
    glass: usize,
    grating: usize,
    wood: usize,
    screen: usize,
}

impl Materials {
    fn new(b: &mut Builder) -> Self {
        let scene = b.scene_mut();
        let first = scene.textures.len();
        scene.textures.extend([textures::checker(), textures::brick(), textures::grating(), textures::screen()]);
        let textured = |name: &str, texture: usize| Material {
            name: name.into(),
            base_color: Vec4::ONE,
            base_color_texture: Some(TextureRef::new(first + texture)),
            ..Material::default()
        };
        Self {
            tiles: b.material(textured("tiles", 0)),
            brick: b.material(textured("brick", 1)),
            plaster: matte(b, "plaster", [0.78, 0.76, 0.72]),
            glass: b.material(Material {
                name: "stained glass".into(),
                base_color: Vec4::new(0.9, 0.25, 0.12, 0.45),
                alpha: Alpha::Blend,
                double_sided: true,
                ..Material::default()
            }),
            grating: b.material(Material { alpha: Alpha::Mask(0.5), double_sided: true, ..textured("grating", 2) }),
            wood: matte(b, "wood", [0.45, 0.3, 0.18]),
            screen: b.material(Material {
                name: "screen".into(),
                base_color: Vec4::new(0.05, 0.05, 0.05, 1.0),
                emission: Vec3::splat(150.0),
                emissive_texture: Some(TextureRef::new(first + 3)),
                ..Material::default()
            }),
        }
    }
}

/// Floor, ceiling and three walls, seen from inside; the fourth wall holds the window.
fn shell(b: &mut Builder, m: &Materials) {
    let (w, h, d) = (Vec3::X * 4.0, Vec3::Y * 2.6, Vec3::Z * 3.0);
    let mut face = |name: &str, o: Vec3, u: Vec3, v: Vec3, material: usize| {
        let mut quads = Quads::default();
        quads.push(o, u, v, 1.0);
        b.add(quads.mesh(name, material));
    };
    face("floor", d, w, -d, m.tiles);
    face("ceiling", h, w, d, m.plaster);
    face("wall -z", Vec3::ZERO, w, h, m.brick);
    face("wall +z", w + d, -w, h, m.brick);
    face("wall +x", w, d, h, m.plaster);
}

/// A wall 0.2 m thick at x = 0, its window with a pane in the left half and a grating in the right one.
fn window(b: &mut Builder, m: &Materials) {
    let hole = [Vec2::new(0.9, 0.9), Vec2::new(2.1, 2.0)];
    let wall = PiercedWall { width: 3.0, height: 2.6, thickness: 0.2, hole, per_metre: 1.0 };
    let wall = b.add(wall.mesh("window wall", m.brick));
    let turn = DMat3::from_cols(DVec3::NEG_Z, DVec3::Y, DVec3::X);
    b.scene_mut().instances[wall].transform = DAffine3::from_mat3_translation(turn, DVec3::new(0.0, 0.0, 3.0));
    // In the middle of the wall; z runs from 0.9 to 2.1.
    let (up, across) = (Vec3::Y * 1.1, Vec3::NEG_Z * 0.6);
    let mut pane = Quads::default();
    pane.push(Vec3::new(-0.107, 0.9, 2.1), across, up, 1.0);
    b.add(pane.mesh("pane", m.glass));
    let mut bars = Quads::default();
    bars.push(Vec3::new(-0.107, 0.9, 1.5), across, up, 4.0);
    b.add(bars.mesh("grating", m.grating));
}

/// A table on four legs, and a glowing screen on the far wall.
fn furniture(b: &mut Builder, m: &Materials) {
    b.cuboid("table top", Vec3::new(1.4, 0.7, 0.9), Vec3::new(2.6, 0.75, 1.8), m.wood, false);
    for (i, [x, z]) in [[1.45, 0.95], [2.49, 0.95], [1.45, 1.69], [2.49, 1.69]].into_iter().enumerate() {
        let (lo, hi) = (Vec3::new(x, 0.0, z), Vec3::new(x + 0.06, 0.7, z + 0.06));
        b.cuboid(&format!("leg {i}"), lo, hi, m.wood, false);
    }
    let mut screen = Quads::default();
    screen.push(Vec3::new(1.5, 1.3, 0.01), Vec3::X, Vec3::Y * 0.6, 0.0);
    let mut mesh = screen.mesh("screen", m.screen);
    mesh.uvs = vec![vec![Vec2::new(0.0, 1.0), Vec2::ONE, Vec2::new(1.0, 0.0), Vec2::ZERO]];
    b.add(mesh);
}
