//! The whole chain, from scene to finished lightmap, against closed forms.

mod support;

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use luxel::Lit;
use luxel::settings::{Only, Settings, Voxels};
use luxel_scene::{LightKind, Scene, Sky, build::Builder};
use support::*;

/// Side of the atlases: enough texels to find what is wrong, few enough to be quick.
const SIDE: u32 = 64;

/// Every valid texel is within `tolerance` of the closed form.
fn assert_all_within(name: &str, scene: &Scene, lit: &Lit, tolerance: f64, truth: impl Fn(DVec3) -> f64) {
    let texels = valid_texels(lit, |_| true);
    assert_texels_within(name, scene, lit, &texels, tolerance, truth);
}

/// Radiance of the furnaces' walls [cd/m²].
const GLOW: f32 = 2.0;

/// In a closed room where every wall has the albedo ρ and emits Lₑ, E = πLₑ + ρE everywhere, whatever its shape.
fn assert_furnace(name: &str, shape: impl Fn(&mut Builder, usize), albedo: f32, settings: &Settings) {
    let mut b = Builder::new(name);
    let wall = b.emitter(Vec3::splat(albedo), Vec3::splat(GLOW));
    shape(&mut b, wall);
    let scene = b.build();
    let lit = bake(&scene, settings);
    let exact = PI * f64::from(GLOW) / (1.0 - f64::from(albedo));
    assert_all_within(&format!("{name} furnace, albedo {albedo}"), &scene, &lit, 0.005, |_| exact);
}

/// The preset `medium` with a quarter of its voxels: less work, and no easier for a furnace.
fn coarse() -> Settings {
    Settings { voxels: Voxels::Budget(25_000), ..medium(SIDE) }
}

fn box_room(b: &mut Builder, wall: usize) {
    b.cuboid("room", Vec3::new(-0.5, 0.0, -0.7), Vec3::new(0.8, 0.9, 0.4), wall, true);
}

fn round_room(b: &mut Builder, wall: usize) {
    b.sphere("room", Vec3::new(0.1, 0.2, -0.3), 0.7, 8, wall, true);
}

#[test]
fn box_furnace_of_albedo_50() {
    assert_furnace("box", box_room, 0.5, &coarse());
}

#[test]
fn box_furnace_of_albedo_80() {
    assert_furnace("box", box_room, 0.8, &medium(SIDE));
}

#[test]
fn box_furnace_of_albedo_95() {
    assert_furnace("box", box_room, 0.95, &coarse());
}

#[test]
fn sphere_furnace_of_albedo_50() {
    assert_furnace("sphere", round_room, 0.5, &coarse());
}

#[test]
fn sphere_furnace_of_albedo_80() {
    assert_furnace("sphere", round_room, 0.8, &medium(SIDE));
}

#[test]
fn sphere_furnace_of_albedo_95() {
    assert_furnace("sphere", round_room, 0.95, &coarse());
}

/// A floor of 4 m square about the origin; alone, it sees nothing of itself.
fn floor(b: &mut Builder) {
    let plaster = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0, plaster);
}

/// Lambert's formula (1760): E = L/2 · Σ θᵢ n·(rᵢ × rᵢ₊₁)/|rᵢ × rᵢ₊₁|, θᵢ the angle that the i-th edge subtends, for a
/// polygon of radiance 1 that lies above the receiver's horizon and shows its front.
fn lambert(point: DVec3, normal: DVec3, corners: &[DVec3]) -> f64 {
    let edges = corners.iter().zip(corners.iter().cycle().skip(1));
    let sum: f64 = edges
        .map(|(a, b)| {
            let (a, b) = (*a - point, *b - point);
            let across = a.cross(b);
            // An edge that the point lies on subtends π and has no plane with it.
            let length = across.length();
            if length > 0.0 { libm::atan2(length, a.dot(b)) * normal.dot(across) / length } else { 0.0 }
        })
        .sum();
    0.5 * sum.abs()
}

/// A floor under (or beside) one black rectangular emitter that looks along `a × b`.
fn under_a_rectangle(o: Vec3, a: Vec3, b: Vec3) -> (Scene, impl Fn(DVec3) -> f64) {
    let mut builder = Builder::new("rectangle");
    floor(&mut builder);
    let lamp = builder.emitter(Vec3::ZERO, Vec3::splat(3.0));
    let lamp = builder.quad("lamp", o, a, b, lamp);
    builder.scene_mut().instances[lamp].receives = false;
    let corners = [o, o + a, o + a + b, o + b].map(|c| c.as_dvec3());
    (builder.build(), move |p| 3.0 * lambert(p, DVec3::Y, &corners))
}

#[test]
fn lamberts_formula_knows_the_rectangle_overhead() {
    // A parallel rectangle a × b at distance c with one corner over the point: the standard form factor (Howell's
    // catalogue, B-3), times π for radiance 1.
    let (a, b, c) = (1.2f64, 0.7, 0.5);
    let corners = [DVec3::new(0.0, c, 0.0), DVec3::new(a, c, 0.0), DVec3::new(a, c, b), DVec3::new(0.0, c, b)];
    let (x, y) = (a / c, b / c);
    let part = |x: f64, y: f64| x / (1.0 + x * x).sqrt() * libm::atan(y / (1.0 + x * x).sqrt());
    let exact = 0.5 * (part(x, y) + part(y, x));
    assert!((lambert(DVec3::ZERO, DVec3::Y, &corners) / exact - 1.0).abs() < 1e-12);
}

#[test]
fn a_rectangle_over_a_plane() {
    let (scene, exact) = under_a_rectangle(Vec3::new(-0.4, 0.6, -0.3), Vec3::X * 1.1, Vec3::Z * 0.7);
    let lit = bake(&scene, &medium(SIDE));
    assert_all_within("rectangle over a plane", &scene, &lit, 0.005, exact);
}

#[test]
fn a_rectangle_that_stands_on_the_plane() {
    // It stands on the floor and looks along +X; what lies behind it is dark.
    let (scene, exact) = under_a_rectangle(Vec3::new(0.0, 0.0, -0.9), Vec3::Y * 0.8, Vec3::Z * 1.7);
    // Voxels of two texels, so that some texels lie within one.
    let settings = Settings { voxels: Voxels::Edge(0.125), ..medium(SIDE) };
    let lit = bake(&scene, &settings);
    let distance = |i: usize| {
        let p = position(&scene, &lit, i);
        let beside = (p.z - 0.8).max(-0.9 - p.z).max(0.0);
        p.x.hypot(beside)
    };
    let before = |i: usize| position(&scene, &lit, i).x > 0.0;
    let far = valid_texels(&lit, |i| before(i) && distance(i) > 0.125);
    let near = valid_texels(&lit, |i| before(i) && distance(i) <= 0.125);
    assert_texels_within("rectangle on a plane", &scene, &lit, &far, 0.005, &exact);
    assert_texels_within("rectangle on a plane, within a voxel", &scene, &lit, &near, 0.02, &exact);
    // Its back is dark, and hides the lit side of the floor, which reflects.
    for i in valid_texels(&lit, |i| !before(i)) {
        assert_eq!(lit.texels.irradiance[i], Vec3::ZERO, "{}", position(&scene, &lit, i));
    }
}

/// A floor under one lamp or sun of intensity 5, or illuminance 5.
fn assert_lamp(name: &str, kind: LightKind, exact: impl Fn(DVec3) -> f64) {
    let mut b = Builder::new(name);
    floor(&mut b);
    b.light(name, kind, Vec3::splat(5.0));
    let scene = b.build();
    let lit = bake(&scene, &medium(SIDE));
    let bright = valid_texels(&lit, |i| exact(position(&scene, &lit, i)) > 0.0);
    assert_texels_within(name, &scene, &lit, &bright, 1e-3, &exact);
    // Where the closed form is dark the lightmap is, too.
    for i in valid_texels(&lit, |i| exact(position(&scene, &lit, i)) == 0.0) {
        assert_eq!(lit.texels.irradiance[i], Vec3::ZERO, "{name}: {}", position(&scene, &lit, i));
    }
}

#[test]
fn a_point_lamp_over_a_plane() {
    let lamp = DVec3::new(0.3, 0.9, -0.2);
    let exact = move |p: DVec3| {
        let d = lamp - p;
        5.0 * d.y / d.length().powi(3)
    };
    assert_lamp("point", LightKind::Point { position: lamp, range: None, radius: 0.0 }, exact);
}

#[test]
fn a_spot_over_a_plane_fades_by_cone_and_range() {
    let lamp = DVec3::new(-0.4, 1.1, 0.3);
    let axis = DVec3::new(0.5, -1.0, -0.3).normalize();
    let (inner, outer, range) = (20f64.to_radians(), 48f64.to_radians(), 2.5);
    let kind = LightKind::Spot { position: lamp, direction: axis, inner, outer, range: Some(range), radius: 0.0 };
    // KHR_lights_punctual: I · max(min(1 − (d/range)⁴, 1), 0)/d² · ((cos θ − cos outer)/(cos inner − cos outer))².
    let exact = move |p: DVec3| {
        let d = p - lamp;
        let distance = d.length();
        let cosine = axis.dot(d) / distance;
        let cone = ((cosine - libm::cos(outer)) / (libm::cos(inner) - libm::cos(outer))).clamp(0.0, 1.0);
        let window = (1.0 - (distance / range).powi(4)).clamp(0.0, 1.0);
        5.0 * cone * cone * window * -d.y / distance.powi(3)
    };
    assert_lamp("spot", kind, exact);
}

#[test]
fn a_sun_over_a_plane() {
    let direction = DVec3::new(0.3, -0.8, 0.5).normalize();
    assert_lamp("sun", LightKind::Sun { direction, angle: 0.0 }, move |_| 5.0 * -direction.y);
}

#[test]
fn a_constant_sky_over_an_open_plane() {
    let mut b = Builder::new("sky");
    floor(&mut b);
    b.scene_mut().sky = Sky::Constant(Vec3::splat(1.5));
    let scene = b.build();
    let lit = bake(&scene, &medium(SIDE));
    assert_all_within("open sky", &scene, &lit, 0.005, |_| 1.5 * PI);
}

#[test]
fn a_sky_that_a_wall_hides_half_of() {
    // A black wall, 40 m long and 12 m high, along x = −2, the floor's edge; it hides between a tenth and half of the
    // sky. What is left: π − Lambert's formula for the wall.
    let mut b = Builder::new("half sky");
    floor(&mut b);
    let black = b.matte(Vec3::ZERO);
    let (o, up, along) = (Vec3::new(-2.0, 0.0, -20.0), Vec3::Y * 12.0, Vec3::Z * 40.0);
    let wall = b.quad("wall", o, up, along, black);
    b.scene_mut().instances[wall].receives = false;
    b.scene_mut().sky = Sky::Constant(Vec3::splat(1.5));
    let scene = b.build();
    let lit = bake(&scene, &medium(SIDE));
    let corners = [o, o + up, o + up + along, o + along].map(|c| c.as_dvec3());
    let exact = |p: DVec3| 1.5 * (PI - lambert(p, DVec3::Y, &corners));
    // The sky is sampled: 1 % is the noise of its rays, and the mean over all texels must be far better.
    let (s, worst, _) = score_closed_form(&scene, &lit, &valid_texels(&lit, |_| true), exact);
    println!(
        "half sky: {} texels, RMSE {:.3} %, bias {:+.4} %, p95 {:.2} %, largest {:.2} %",
        s.samples,
        100.0 * s.rmse,
        100.0 * s.bias,
        100.0 * s.p95,
        100.0 * worst
    );
    assert!(s.samples > 3000 && s.rmse <= 0.01 && s.bias.abs() <= 1e-3, "{s:?}");
}

/// All light of a scene, and the bakes of direct and of indirect light alone, which are its two parts.
fn whole_and_parts(scene: &Scene) -> [Lit; 3] {
    let lit = [Only::All, Only::Direct, Only::Indirect].map(|only| bake(scene, &Settings { only, ..medium(SIDE) }));
    let [all, direct, indirect] = [&lit[0], &lit[1], &lit[2]].map(|lit| &lit.texels.irradiance);
    assert!(all.len() == direct.len() && all.len() == indirect.len());
    assert!((0..all.len()).all(|i| all[i] == direct[i] + indirect[i]), "the parts add up to the last bit");
    lit
}

#[test]
fn black_surfaces_have_no_indirect_light() {
    let mut scene = luxel_assets::cornell();
    for material in &mut scene.materials {
        material.base_color = Vec3::ZERO.extend(1.0);
    }
    let [all, direct, indirect] = whole_and_parts(&scene);
    assert!(indirect.texels.irradiance.iter().all(|e| *e == Vec3::ZERO));
    assert_eq!(all.texels.irradiance, direct.texels.irradiance);
    assert!(valid_texels(&all, |i| direct.texels.irradiance[i].min_element() > 0.1).len() > 500);
}

#[test]
fn one_black_room_in_a_grey_world_has_no_indirect_light() {
    // Here light does bounce, elsewhere: no stage is left out, and the black room must still come out exactly black.
    let mut b = Builder::new("black room");
    let (black, grey) = (b.matte(Vec3::ZERO), b.matte(Vec3::splat(0.6)));
    let lamp = b.emitter(Vec3::ZERO, Vec3::splat(4.0));
    for (x, wall) in [(0.0, black), (3.0, grey)] {
        b.cuboid("room", Vec3::new(x, 0.0, 0.0), Vec3::new(x + 1.0, 1.0, 1.0), wall, true);
        b.cuboid("lamp", Vec3::new(x + 0.4, 0.7, 0.4), Vec3::new(x + 0.6, 0.8, 0.6), lamp, false);
    }
    let scene = b.build();
    let [all, direct, indirect] = whole_and_parts(&scene);
    let is_black = |i: &usize| position(&scene, &all, *i).x < 2.0;
    let (dark, lit_ones): (Vec<usize>, Vec<usize>) = valid_texels(&all, |_| true).into_iter().partition(is_black);
    let [all, direct, indirect] = [all, direct, indirect].map(|lit| lit.texels.irradiance);
    assert!(dark.iter().all(|&i| indirect[i] == Vec3::ZERO && all[i] == direct[i]));
    assert!(dark.iter().filter(|&&i| direct[i].min_element() > 0.1).count() > 100);
    assert!(lit_ones.iter().filter(|&&i| indirect[i].min_element() > 0.1).count() > 100);
}

#[test]
fn a_scene_without_light_is_dark() {
    let mut scene = luxel_assets::cornell();
    for material in &mut scene.materials {
        material.emission = Vec3::ZERO;
    }
    let lit = bake(&scene, &medium(SIDE));
    assert_eq!(lit.lightmaps.len(), 1);
    assert!(lit.lightmaps[0].irradiance().iter().all(|e| *e == Vec3::ZERO));
    assert!(lit.lightmaps[0].irradiance().len() == (SIDE * SIDE) as usize);
    assert!(lit.texels.irradiance.len() > 1000);
}

#[test]
fn twice_the_lamp_is_twice_the_light() {
    let scene = luxel_assets::cornell();
    let mut brighter = scene.clone();
    for material in &mut brighter.materials {
        material.emission *= 2.0;
    }
    let (lit, twice) = (bake(&scene, &medium(SIDE)), bake(&brighter, &medium(SIDE)));
    let irradiances = lit.lightmaps[0].irradiance().iter().zip(twice.lightmaps[0].irradiance());
    let mut bright = 0;
    for (once, twice) in irradiances {
        assert!((*twice - *once * 2.0).abs().max_element() <= 1e-6 * twice.max_element(), "{once} and {twice}");
        bright += usize::from(once.min_element() > 0.02);
    }
    assert!(bright > 500, "only {bright} bright texels");
}
