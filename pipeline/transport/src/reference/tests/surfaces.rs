//! Veils, holes and backs.

use super::*;

/// A veil over the floor, under a lamp, an emitter or a sky: light times its transmittance.
#[test]
fn a_veil_colours_what_it_lets_through() {
    let tint = Vec3::new(1.0, 0.5, 0.1);
    let glass = Material { base_color: tint.extend(1.0), transmission: 0.5, ..Material::default() };
    let smoke =
        Material { base_color: Vec3::ZERO.extend(0.5), alpha: Alpha::Blend, double_sided: true, ..Material::default() };
    // α = ½ black: (1 − α) · lerp(1, 0, α) = ¼.
    for (material, pass) in [(glass, tint * 0.5), (smoke, Vec3::splat(0.25))] {
        for source in 0..4 {
            let mut b = floor("veil", 0.0);
            match source {
                0 => b.light("p", LightKind::Point { position: DVec3::Y, range: None, radius: 0.0 }, Vec3::splat(2.0)),
                1 => b.light("s", LightKind::Sun { direction: -DVec3::Y, angle: 0.1 }, Vec3::splat(2.0)),
                2 => b.scene_mut().sky = Sky::Constant(Vec3::splat(2.0)),
                _ => {
                    let light = b.emitter(Vec3::ZERO, Vec3::splat(2.0));
                    b.quad("light", Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z, light);
                }
            }
            let open = at_origin(&b.scene_mut().clone(), Options { bounces: Some(0), ..Options::default() }, 1 << 12);
            let veil = b.material(material.clone());
            b.quad("veil", Vec3::new(-50.0, 0.3, -50.0), Vec3::X * 100.0, Vec3::Z * 100.0, veil);
            let e = at_origin(&b.build(), Options { bounces: Some(0), ..Options::default() }, 1 << 12);
            let error = e.standard_error.max(open.standard_error);
            for band in 0..3 {
                let expected = open.total[band] * pass[band];
                assert!(
                    (e.total[band] - expected).abs() <= 4.0 * error + 1e-3 * expected,
                    "source {source}: {e:?}, open {open:?}"
                );
            }
        }
    }
}

/// Above a veil of coverage ½ and albedo ρ under a constant sky, in front of nothing: the veil reflects its share.
#[test]
fn a_veil_reflects_its_covered_share() {
    let mut b = Builder::new("reflecting veil");
    let grey = b.matte(Vec3::ZERO);
    let side = 1000.0;
    b.quad("ceiling", Vec3::new(-1.0, 1.0, -1.0), Vec3::X * 2.0, Vec3::Z * 2.0, grey);
    let veil = Material { base_color: Vec3::splat(0.6).extend(0.5), alpha: Alpha::Blend, ..Material::default() };
    let veil = b.material(veil);
    b.quad("veil", Vec3::new(-side, 0.0, side), Vec3::X * 2.0 * side, Vec3::Z * -2.0 * side, veil);
    b.light("sun", LightKind::Sun { direction: DVec3::new(0.6, -0.8, 0.0), angle: 0.0 }, Vec3::splat(10.0));
    // The receiver is the small ceiling; its shadow falls at 0.75 beside the point below it and covers little.
    let e = at_origin(&b.build(), Options::default(), 1 << 14);
    let open = 0.5 * 0.6 * 8.0;
    // The shadow of the ceiling on the veil takes the share of its form factor.
    let corners = [(-0.25, -1.0), (1.75, -1.0), (1.75, 1.0), (-0.25, 1.0)].map(|(x, z)| Vec3::new(x, 1.0, z));
    check(mean(e.indirect), e.standard_error, open * (1.0 - lambert(&corners) / PI), 0.01);
}

/// A checker of holes over a sun: the texels decide.
#[test]
fn holes_are_holes() {
    let texels = vec![[255, 255, 255, 0], [255; 4]];
    let mask = Material {
        base_color_texture: Some(TextureRef::new(0)),
        alpha: Alpha::Mask(0.5),
        double_sided: true,
        ..Material::default()
    };
    for (shift, expected) in [(0.3, 10.0), (-0.3, 0.0)] {
        let mut b = floor("mask", 0.0);
        b.scene_mut().textures.push(Texture {
            name: "mask".into(),
            width: 2,
            height: 1,
            srgb: false,
            texels: texels.clone(),
        });
        let mask = b.material(mask.clone());
        b.quad("leaf", Vec3::new(shift - 0.5, 0.5, -0.5), Vec3::X, Vec3::Z, mask);
        b.light("sun", LightKind::Sun { direction: -DVec3::Y, angle: 0.0 }, Vec3::splat(10.0));
        assert_eq!(at_origin(&b.build(), Options::default(), 64).direct, Rgb::splat(expected), "{shift}");
    }
}

/// A single-sided back blocks, absorbs and emits nothing; a double-sided one emits and reflects like the front.
#[test]
fn backs_are_black_unless_double_sided() {
    for double_sided in [false, true] {
        let mut b = floor("back", 0.0);
        let light = b.material(Material {
            base_color: Vec3::splat(0.5).extend(1.0),
            emission: Vec3::ONE,
            double_sided,
            ..Material::default()
        });
        b.scene_mut().sky = Sky::Constant(Vec3::ONE);
        // Looks up, so the floor sees its back.
        b.quad("sheet", Vec3::new(-900.0, 0.1, 900.0), Vec3::X * 1800.0, Vec3::Z * -1800.0, light);
        let e = at_origin(&b.build(), Options::default(), 1 << 12);
        check(mean(e.direct) + 1.0, e.direct_error, if double_sided { PI } else { 0.0 } + 1.0, 0.005);
        assert!(double_sided || mean(e.total) < 0.01, "{e:?}");
    }
}

/// Tilted panels that lie on each other: of those that look at the receiver the first is seen, whether aimed at or not.
#[test]
fn of_emitters_that_overlap_the_first_is_seen() {
    let (o, a, c) = (Vec3::new(-0.7, 0.6, -0.4), Vec3::new(0.9, 0.35, 0.1), Vec3::new(-0.15, 0.2, 0.8));
    let from = |x: f32, width: f32| lambert(&[o + a * x, o + a * (x + width), o + a * (x + width) + c, o + a * x + c]);
    let whole = from(0.0, 1.0);
    // Radiance and place of panels along `a`, those of width below 0 looking away; and what arrives.
    let cases = [
        (vec![(5.0, 0.0, 0.7), (5.0, 0.3, 0.7)], 5.0 * whole),
        (vec![(5.0, 0.0, 0.7), (2.0, 0.3, 0.7)], 5.0 * from(0.0, 0.7) + 2.0 * from(0.7, 0.3)),
        (vec![(1.0, 0.4, 0.2), (5.0, 0.0, 1.0)], 5.0 * (whole - from(0.4, 0.2)) + from(0.4, 0.2)),
        (vec![(5.0, 0.0, 1.0), (3.0, 0.0, 1.0), (4.0, 0.2, 0.5)], 5.0 * whole),
        (vec![(7.0, 1.0, -1.0), (5.0, 0.0, 1.0)], 5.0 * whole),
    ];
    for (panels, expected) in cases {
        let mut b = floor("overlaps", 0.0);
        for (radiance, x, width) in panels {
            let glow = b.emitter(Vec3::ZERO, Vec3::splat(radiance));
            b.quad("panel", o + a * x, a * width, c, glow);
        }
        let scene = b.build();
        for next_event in [true, false] {
            let samples = if next_event { 1 << 15 } else { 1 << 18 };
            let e = at_origin(&scene, Options { next_event, bounces: Some(0), ..Options::default() }, samples);
            check(mean(e.direct), e.direct_error, expected, 0.004);
        }
    }
}
