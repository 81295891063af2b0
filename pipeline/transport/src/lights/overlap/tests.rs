use glam::{DAffine3, DQuat};
use luxel_scene::{Alpha, Material, Scene, build::Builder};

use super::*;
use crate::{
    lights::{Emitters, Source, area::area_lights},
    sampling::r2,
};

/// Panels of 1 × 1 at these places of the plane z = 0, each with a radiance of its own: 1, 2, …
fn panels(places: &[(f32, f32)]) -> Builder {
    let mut b = Builder::new("panels");
    for (i, (x, y)) in places.iter().enumerate() {
        let glow = b.emitter(Vec3::ZERO, Vec3::splat(1.0 + i as f32));
        b.quad("panel", Vec3::new(*x, *y, 0.0), Vec3::X, Vec3::Y, glow);
    }
    b
}

/// Areas by source, in squares of scene units, and how many polygons they are made of.
fn areas(scene: &Scene) -> Vec<(f64, usize)> {
    let geometry = Geometry::new(scene);
    let emitters = Emitters::new(&geometry);
    let unit = geometry.frame.scale * geometry.frame.scale;
    let of = |i: usize| {
        let own = emitters.areas.iter().filter(|l| l.source == Source::Instance(i as u32));
        own.fold((0.0, 0), |(sum, count), light| (sum + f64::from(light.area) / unit, count + 1))
    };
    (0..scene.instances.len()).map(of).collect()
}

#[track_caller]
fn assert_areas(scene: &Scene, expected: &[(f64, usize)]) {
    let found = areas(scene);
    let same = |(a, b): (&(f64, usize), &(f64, usize))| (a.0 - b.0).abs() < 1e-5 && a.1 == b.1;
    assert!(found.len() == expected.len() && found.iter().zip(expected).all(same), "{found:?}");
}

#[test]
fn a_panel_that_is_there_twice_shines_once() {
    let mut b = Builder::new("doubles");
    let shiny = b.emitter(Vec3::ZERO, Vec3::ONE);
    b.quad("panel", Vec3::ZERO, Vec3::X, Vec3::Y, shiny);
    b.quad("double", Vec3::ZERO, Vec3::X, Vec3::Y, shiny);
    b.quad("back", Vec3::ZERO, Vec3::Y, Vec3::X, shiny);
    assert_areas(&b.build(), &[(1.0, 1), (0.0, 0), (1.0, 1)]);
}

#[test]
fn what_is_covered_is_cut_out_of_the_later_one() {
    // Half of it, a quarter of it, a window in it (a larger one after a smaller one), and nothing but an edge.
    assert_areas(&panels(&[(0.0, 0.0), (0.5, 0.0)]).build(), &[(1.0, 1), (0.5, 1)]);
    assert_areas(&panels(&[(0.0, 0.0), (0.5, 0.5)]).build(), &[(1.0, 1), (0.75, 2)]);
    assert_areas(&panels(&[(0.0, 0.0), (1.0, 0.0)]).build(), &[(1.0, 1), (1.0, 1)]);
    let mut b = panels(&[(0.0, 0.0)]);
    let glow = b.emitter(Vec3::ZERO, Vec3::splat(5.0));
    b.quad("frame", Vec3::new(-1.0, -1.0, 0.0), Vec3::X * 3.0, Vec3::Y * 3.0, glow);
    assert_areas(&b.build(), &[(1.0, 1), (8.0, 4)]);
    // A part that two others cover together is cut out once.
    assert_areas(&panels(&[(0.0, 0.0), (0.5, 0.0), (0.25, 0.0)]).build(), &[(1.0, 1), (0.5, 1), (0.0, 0)]);
}

#[test]
fn power_is_that_of_the_union() {
    let mut b = Builder::new("union");
    let glow = b.emitter(Vec3::ZERO, Vec3::splat(2.0));
    b.quad("panel", Vec3::ZERO, Vec3::X, Vec3::Y, glow);
    b.quad("larger", Vec3::new(-0.5, 0.25, 0.0), Vec3::X * 2.0, Vec3::Y * 1.5, glow);
    let turn = DAffine3::from_quat(DQuat::from_rotation_x(0.7) * DQuat::from_rotation_y(0.4));
    let scene = luxel_scene::build::transformed(b.build(), turn);
    let power = Emitters::new(&Geometry::new(&scene)).power().x;
    let expected = std::f64::consts::PI * 2.0 * (1.0 + 3.0 - 0.75);
    assert!((power / expected - 1.0).abs() < 1e-5, "{power} {expected}");
}

/// Triangles and quads at random in a tilted plane: at every point that one of them covers exactly one shines, the first.
#[test]
fn every_covered_point_shines_once_and_by_the_first() {
    let number = |i: u32| r2(i, glam::Vec2::new(0.3, 0.7));
    let mut b = Builder::new("heap");
    let mut polygons = Vec::new();
    for i in 0..40u32 {
        let glow = b.emitter(Vec3::ZERO, Vec3::splat(1.0 + i as f32));
        let corner = number(i) * 8.0;
        let (e, f) = (number(100 + i) * 2.0 + 0.3, number(200 + i) * 2.0 + 0.3);
        let (e, f) = (Vec3::new(e.x, -e.y, 0.0), Vec3::new(f.x, f.y, 0.0));
        let o = corner.extend(0.0);
        if i % 3 == 0 {
            b.mesh("triangle", vec![o, o + e, o + f], vec![[0, 1, 2]], glow);
        } else {
            b.quad("quad", o, e, f, glow);
        }
        polygons.push((o, e, f, i % 3 == 0));
    }
    let turn = DAffine3::from_quat(DQuat::from_rotation_x(0.7) * DQuat::from_rotation_y(0.4));
    let scene = luxel_scene::build::transformed(b.build(), turn);
    let geometry = Geometry::new(&scene);
    let lights = Emitters::new(&geometry).areas;
    let plane = Plane::of(&lights[0]);
    let shapes: Vec<Polygon> = lights.iter().map(|l| plane.polygon(l)).collect();
    assert!(lights.len() > 60, "{}", lights.len());
    // How far inside a point lies, negative outside [frame units].
    let depth = |polygon: &Polygon, p: DVec2| {
        let inward = |(from, to): (DVec2, DVec2)| (to - from).perp().normalize().dot(p - from);
        polygon.edges().map(inward).fold(f64::INFINITY, f64::min)
    };
    let all = area_lights(&geometry);
    let whole: Vec<Polygon> = all.iter().map(|l| plane.polygon(l)).collect();
    assert_eq!(whole.len(), polygons.len());
    let (mut lit, mut dark) = (0, 0);
    for k in 0..20_000 {
        let p = number(1000 + k).as_dvec2() * 10.0 - DVec2::splat(1.0);
        let at = geometry.frame.point(turn.transform_point3(p.extend(0.0))).as_dvec3() - plane.origin;
        let p = DVec2::new(plane.x.dot(at), plane.y.dot(at));
        // Where edges are close, rounding decides.
        if shapes.iter().chain(&whole).any(|s| depth(s, p).abs() < 0.05) {
            continue;
        }
        let first = whole.iter().position(|s| depth(s, p) > 0.0);
        let shining: Vec<f32> =
            lights.iter().zip(&shapes).filter(|(_, s)| depth(s, p) > 0.0).map(|(l, _)| l.radiance.x).collect();
        let expected: Vec<f32> = first.iter().map(|i| all[*i].radiance.x).collect();
        assert_eq!(shining, expected, "{p}");
        (lit, dark) = (lit + first.iter().len(), dark + usize::from(first.is_none()));
    }
    assert!(lit > 5000 && dark > 500, "{lit} {dark}");
}

#[test]
fn other_planes_and_fronts_are_left_alone() {
    let mut b = panels(&[(0.0, 0.0)]);
    let glow = b.emitter(Vec3::ZERO, Vec3::ONE);
    b.quad("the other way", Vec3::new(0.5, 0.0, 0.0), Vec3::Y, Vec3::X, glow);
    // 4096 frame units are 3 scene units here: a thousandth of one is more than rounding.
    b.quad("before it", Vec3::new(0.5, 0.0, 1e-3), Vec3::X, Vec3::Y, glow);
    b.quad("through it", Vec3::new(0.5, 0.0, -0.5), Vec3::Z, Vec3::Y, glow);
    b.quad("tilted", Vec3::new(0.5, 0.0, 0.0), Vec3::new(1.0, 0.0, 0.002), Vec3::Y, glow);
    let scene = b.build();
    assert_areas(&scene, &[(1.0, 1); 5]);
}

#[test]
fn sides_are_covered_each_by_itself() {
    let mut b = Builder::new("sheets");
    let glow = b.emitter(Vec3::ZERO, Vec3::ONE);
    let sheet = b.material(Material { emission: Vec3::ONE, double_sided: true, ..Material::default() });
    // A sheet covers both fronts.
    b.quad("sheet", Vec3::ZERO, Vec3::X, Vec3::Y, sheet);
    b.quad("front", Vec3::new(0.5, 0.0, 0.0), Vec3::X, Vec3::Y, glow);
    b.quad("back", Vec3::new(0.0, 0.25, 0.0), Vec3::Y, Vec3::X, glow);
    // Of a sheet behind a panel the back is left, of which the panel shows nothing.
    b.quad("panel", Vec3::X * 3.0, Vec3::X, Vec3::Y, glow);
    b.quad("sheet", Vec3::new(3.25, 0.0, 0.0), Vec3::X, Vec3::Y, sheet);
    let scene = b.build();
    assert_areas(&scene, &[(1.0, 1), (0.5, 1), (0.25, 1), (1.0, 1), (1.0, 2)]);
    let emitters = Emitters::new(&Geometry::new(&scene));
    let own: Vec<&AreaLight> = emitters.areas.iter().filter(|l| l.source == Source::Instance(4)).collect();
    let of = |two_sided: bool| own.iter().find(|l| l.two_sided == two_sided).unwrap();
    assert!((of(true).area * 3.0 - of(false).area).abs() < 1e-3 * of(false).area);
    assert_eq!((of(true).normal, of(false).normal), (Vec3::Z, Vec3::NEG_Z));
    assert_ne!(of(true).identity, of(false).identity);
}

#[test]
fn veils_hide_nothing() {
    let mut b = Builder::new("veils");
    let glow = b.emitter(Vec3::ZERO, Vec3::ONE);
    let veil = b.material(Material {
        emission: Vec3::ONE,
        alpha: Alpha::Blend,
        base_color: glam::Vec4::splat(0.5),
        ..Material::default()
    });
    b.quad("veil", Vec3::ZERO, Vec3::X, Vec3::Y, veil);
    b.quad("panel", Vec3::new(0.5, 0.0, 0.0), Vec3::X, Vec3::Y, glow);
    assert_areas(&b.build(), &[(1.0, 1), (1.0, 1)]);
}

/// Ten thousand in one plane, side by side without a gap: none of them changes by a bit.
#[test]
fn a_wall_of_lamps_stays_as_it_is() {
    let mut b = Builder::new("wall");
    let glow = b.emitter(Vec3::ZERO, Vec3::ONE);
    let lamp = b.quad("lamp", Vec3::ZERO, Vec3::X, Vec3::Y, glow);
    let mesh = b.scene_mut().instances[lamp].mesh;
    for i in 1..10_000 {
        let at = glam::DVec3::new(f64::from(i % 100), f64::from(i / 100), 0.0);
        b.place(mesh, DAffine3::from_translation(at), &format!("lamp {i}"));
    }
    let turn = DAffine3::from_quat(DQuat::from_rotation_x(0.7) * DQuat::from_rotation_y(0.4));
    let scene = luxel_scene::build::transformed(b.build(), turn);
    let geometry = Geometry::new(&scene);
    let before = area_lights(&geometry);
    assert_eq!(before.len(), 10_000);
    let after = uncovered(&geometry, before.clone());
    let same = |(a, b): (&AreaLight, &AreaLight)| a.corners() == b.corners() && a.identity == b.identity;
    assert!(after.len() == before.len() && after.iter().zip(&before).all(same));
}

/// Equal corners: of a sheet behind a panel the back is left, and what is seen through hides nothing.
#[test]
fn of_equal_polygons_each_side_shines_once() {
    let mut b = Builder::new("equals");
    let glow = b.emitter(Vec3::ZERO, Vec3::ONE);
    let sheet = b.material(Material { emission: Vec3::ONE, double_sided: true, ..Material::default() });
    let base_color = glam::Vec4::splat(0.5);
    let veil = b.material(Material { emission: Vec3::ONE, alpha: Alpha::Blend, base_color, ..Material::default() });
    b.quad("up", Vec3::ZERO, Vec3::X, Vec3::Y, glow);
    b.quad("sheet", Vec3::ZERO, Vec3::X, Vec3::Y, sheet);
    b.quad("down", Vec3::ZERO, Vec3::Y, Vec3::X, glow);
    b.quad("down", Vec3::X * 2.0, Vec3::Y, Vec3::X, glow);
    b.quad("sheet", Vec3::X * 2.0, Vec3::X, Vec3::Y, sheet);
    b.quad("veil", Vec3::X * 4.0, Vec3::X, Vec3::Y, veil);
    b.quad("panel", Vec3::X * 4.0, Vec3::X, Vec3::Y, glow);
    let scene = b.build();
    assert_areas(&scene, &[(1.0, 1), (1.0, 1), (0.0, 0), (1.0, 1), (1.0, 1), (1.0, 1), (1.0, 1)]);
    let areas = Emitters::new(&Geometry::new(&scene)).areas;
    let (below, above) = (&areas[1], &areas[3]);
    assert_eq!((below.normal, below.two_sided), (Vec3::NEG_Z, false));
    assert_eq!((above.normal, above.two_sided), (Vec3::Z, false));
}
