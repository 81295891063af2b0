//! Lights of every strength, size, number and place.
//!
//! Two laws bound the light in a closed room of one albedo ρ, whatever its lamps:
//!
//! - energy: what lamps send is absorbed, so the mean of E over all surfaces is Φ / (A (1 − ρ));
//! - the maximum principle: with E₁ a bound of what arrives first, reflected light is E − E₁ ≤ ρ/(1 − ρ) · max E₁,
//!   because no point sees a radiosity above ρ · max E.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use luxel::Lit;
use luxel::settings::{LightGroups, Only, Settings};
use luxel_scene::{LightKind, Material, Scene, build::Builder};

use crate::kit::*;
use crate::support::*;

const RHO: f64 = 0.5;

fn grey(b: &mut Builder) -> usize {
    b.matte(Vec3::splat(RHO as f32))
}

fn point(position: DVec3) -> LightKind {
    LightKind::Point { position, range: None, radius: 0.0 }
}

/// A room from the origin to `size`, seen from inside, as one object.
fn room(b: &mut Builder, lo: Vec3, hi: Vec3) {
    let wall = grey(b);
    b.cuboid("room", lo, hi, wall, true);
}

fn area(size: DVec3) -> f64 {
    2.0 * (size.x * size.y + size.y * size.z + size.z * size.x)
}

/// World normal of the face of an inward box from `lo` to `hi` that holds a point.
fn inward(p: DVec3, lo: DVec3, hi: DVec3) -> DVec3 {
    let (near, far) = (p - lo, hi - p);
    let depth = near.min(far);
    let axis = (0..3).fold(0, |best, k| if depth[k] < depth[best] { k } else { best });
    let mut normal = DVec3::ZERO;
    normal[axis] = if near[axis] < far[axis] { 1.0 } else { -1.0 };
    normal
}

/// I cos θ / d² of a bare lamp [lux].
fn lamp_at(lamp: DVec3, intensity: f64, p: DVec3, n: DVec3) -> f64 {
    let d = lamp - p;
    intensity * n.dot(d).max(0.0) / d.length().powi(3)
}

fn brightness(lit: &Lit, i: usize) -> f64 {
    f64::from(value(lit, i).element_sum()) / 3.0
}

/// Every texel is between `low` and `high` of its place.
fn assert_between(name: &str, scene: &Scene, lit: &Lit, texels: &[usize], bounds: impl Fn(DVec3) -> (f64, f64)) {
    assert_sound(name, lit);
    assert!(texels.len() > 100, "{name}: {} texels", texels.len());
    let (mut lowest, mut highest) = (f64::INFINITY, 0.0f64);
    for &i in texels {
        let p = position(scene, lit, i);
        let (low, high) = bounds(p);
        let e = brightness(lit, i);
        lowest = lowest.min(e / low);
        highest = highest.max(e / high);
        assert!(e >= low && e <= high, "{name}: {e} at {p}, not in {low}..{high}");
    }
    println!("{name}: {} texels, least {lowest:.4} of the lower bound, most {highest:.4} of the upper", texels.len());
}

#[test]
fn lamps_of_all_strengths_in_one_room() {
    let (lo, hi) = (DVec3::ZERO, DVec3::new(4.0, 3.0, 5.0));
    let lamps: Vec<(DVec3, f64)> = (0..6)
        .map(|k| (DVec3::new(0.6 + 0.5 * f64::from(k), 1.0 + 0.2 * f64::from(k), 4.2 - 0.6 * f64::from(k)), k))
        .map(|(p, k)| (p, 10f64.powi(3 * k - 6)))
        .collect();
    let mut b = Builder::new("strengths");
    room(&mut b, lo.as_vec3(), hi.as_vec3());
    lamps.iter().for_each(|(p, i)| b.light(&format!("lamp {i}"), point(*p), Vec3::splat(*i as f32)));
    let scene = b.build();
    let nearest = |p: DVec3| (p - lo).min_element().min((hi - p).min_element());
    let first = |p: DVec3| {
        let n = inward(p, lo, hi);
        lamps.iter().map(|(lamp, i)| lamp_at(*lamp, *i, p, n)).sum::<f64>()
    };
    let most: f64 = lamps.iter().map(|(p, i)| i / nearest(*p).powi(2)).sum();
    let flux: f64 = lamps.iter().map(|(_, i)| 4.0 * PI * i).sum();
    for light_groups in [LightGroups::One, LightGroups::Auto] {
        let lit = bake(&scene, &Settings { light_groups, ..coarse() });
        let texels = valid_texels(&lit, |_| true);
        let name = format!("10⁻⁶ to 10⁹ cd, groups {light_groups:?}");
        // 0.1 % below: the direct part alone, which f32 rounds.
        let bounds = |p: DVec3| (0.999 * first(p), first(p) + RHO / (1.0 - RHO) * most);
        assert_between(&name, &scene, &lit, &texels, bounds);
        let balance = mean(&lit, &texels) * area(hi - lo) * (1.0 - RHO) / flux;
        println!("{name}: absorbed / sent = {balance:.4}");
        assert!((balance - 1.0).abs() < 0.01, "{name}: {balance}");
    }
}

#[test]
fn a_candle_beside_a_thousand_million_candles_keeps_its_room_dim() {
    // Six closed rooms side by side, 0.5 apart, each with a lamp a thousand times as strong as the last: no room may
    // receive anything that counts of a brighter one.
    let size = DVec3::new(2.0, 1.5, 2.0);
    let mut b = Builder::new("rooms");
    let place = |k: i32| DVec3::new(2.5 * f64::from(k), 0.0, 0.0);
    for k in 0..6 {
        let lo = place(k);
        room(&mut b, lo.as_vec3(), (lo + size).as_vec3());
        b.light(&format!("lamp {k}"), point(lo + DVec3::new(0.9, 0.8, 1.1)), Vec3::splat(10f32.powi(3 * k - 6)));
    }
    let scene = b.build();
    for light_groups in [LightGroups::Auto, LightGroups::One] {
        let lit = bake(&scene, &Settings { light_groups, ..sized(96, 24_000) });
        assert_sound("rooms of all strengths", &lit);
        for k in 0..6 {
            let texels = valid_texels(&lit, |i| lit.atlas.chart(&lit.atlas.texels[i]).instance == k as u32);
            let exact = 4.0 * PI * 10f64.powi(3 * k - 6) / (area(size) * (1.0 - RHO));
            let ratio = mean(&lit, &texels) / exact;
            println!(
                "room of 10^{} cd, groups {light_groups:?}: {} texels, mean E {ratio:.4} of the energy balance",
                3 * k - 6,
                texels.len()
            );
            // In one group, whose light is one, the dim rooms are right within a tenth.
            let most = if light_groups == LightGroups::Auto { 0.02 } else { 0.1 };
            assert!((ratio - 1.0).abs() < most, "room {k}: {ratio}");
        }
    }
}

#[test]
fn a_sheet_of_light_just_below_the_ceiling() {
    // Double-sided, 5 mm below a ceiling: half of the light is caught in a slit that is a fifth of a voxel high, where E is
    // hundreds of times that of the room. The room must get what comes out of it and no more.
    let (lo, hi) = (Vec3::ZERO, Vec3::new(2.0, 1.5, 2.0));
    for gap in [0.005f32, 0.02] {
        let mut b = Builder::new("sheet below the ceiling");
        let wall = b.material(Material {
            double_sided: true,
            base_color: Vec3::splat(RHO as f32).extend(1.0),
            ..Material::default()
        });
        let glow = b.material(Material {
            double_sided: true,
            base_color: Vec3::splat(0.8).extend(1.0),
            emission: Vec3::splat(20.0),
            ..Material::default()
        });
        b.cuboid("room", lo, hi, wall, true);
        b.quad("sheet", Vec3::new(0.7, 1.5 - gap, 0.8), Vec3::X * 0.5, Vec3::Z * 0.4, glow);
        let scene = b.build();
        let lit = bake(&scene, &sized(96, 60_000));
        assert_sound("sheet below the ceiling", &lit);
        // Not where texels are wider than the slit is high.
        let below = |i: usize| position(&scene, &lit, i).y < 1.4;
        let s = score_texels(&scene, &lit, &some_texels(&lit, 200, below), 2048);
        println!("sheet {} mm below the ceiling: {s}", 1000.0 * gap);
        let noise = s.noise / (s.samples as f64).sqrt();
        assert!(s.samples > 150 && s.bias.abs() < 0.01 + 3.0 * noise && s.rmse < 0.02f64.hypot(2.0 * s.noise), "{s:?}");
    }
}

/// A hall of 20 × 6 × 30 m.
const HALL: DVec3 = DVec3::new(20.0, 6.0, 30.0);

#[test]
fn a_square_millimetre_in_a_hall() {
    let (at, side, radiance) = (DVec3::new(8.0, 5.8, 13.0), 1e-3, 1e6);
    let mut b = Builder::new("millimetre");
    room(&mut b, Vec3::ZERO, HALL.as_vec3());
    let glow = b.emitter(Vec3::ZERO, Vec3::splat(radiance as f32));
    let corner = (at - DVec3::new(0.5, 0.0, 0.5) * side).as_vec3();
    // a × b looks down.
    let lamp = b.quad("lamp", corner, Vec3::X * side as f32, Vec3::Z * side as f32, glow);
    b.scene_mut().instances[lamp].receives = false;
    let scene = b.build();
    // Farther than 1000 sides it is a point with a cosine.
    let first = |p: DVec3| {
        let down = (at.y - p.y).max(0.0) / at.distance(p);
        lamp_at(at, radiance * side * side * down, p, inward(p, DVec3::ZERO, HALL))
    };
    let flux = PI * radiance * side * side;
    let lit = bake(&scene, &coarse());
    let texels = valid_texels(&lit, |_| true);
    let most = radiance * side * side / 5.8f64.powi(2);
    let bounds = |p: DVec3| (0.995 * first(p), 1.005 * first(p) + RHO / (1.0 - RHO) * most);
    assert_between("1 mm² in a hall", &scene, &lit, &texels, bounds);
    let balance = mean(&lit, &texels) * area(HALL) * (1.0 - RHO) / flux;
    println!("1 mm² in a hall: absorbed / sent = {balance:.4}");
    assert!((balance - 1.0).abs() < 0.01, "{balance}");
}

#[test]
fn ten_thousand_emitters() {
    let (count, side, radiance) = (100, 0.05f32, 40.0f32);
    let mut b = Builder::new("ten thousand");
    room(&mut b, Vec3::ZERO, HALL.as_vec3());
    let glow = b.emitter(Vec3::ZERO, Vec3::splat(radiance));
    let (mut positions, mut triangles, mut centres) = (Vec::new(), Vec::new(), Vec::new());
    for (i, j) in (0..count).flat_map(|i| (0..count).map(move |j| (i, j))) {
        let o = Vec3::new(0.1 + 0.2 * i as f32 - 0.5 * side, 5.0, 0.15 + 0.3 * j as f32 - 0.5 * side);
        let at = positions.len() as u32;
        positions.extend([o, o + Vec3::X * side, o + (Vec3::X + Vec3::Z) * side, o + Vec3::Z * side]);
        triangles.extend([[at, at + 1, at + 2], [at, at + 2, at + 3]]);
        centres.push((o + (Vec3::X + Vec3::Z) * (0.5 * side)).as_dvec3());
    }
    let lamps = b.mesh("lamps", positions, triangles, glow);
    b.scene_mut().instances[lamps].receives = false;
    let scene = b.build();
    let power = f64::from(radiance * side * side);
    // Each lamp is a point with a cosine where it is ten sides away: below 4 m all of them are.
    let first = |p: DVec3| {
        let n = inward(p, DVec3::ZERO, HALL);
        let one = |c: &DVec3| lamp_at(*c, power * (c.y - p.y).max(0.0) / c.distance(p), p, n);
        centres.iter().map(one).sum::<f64>()
    };
    let lit = bake(&scene, &Settings { only: Only::Direct, ..coarse() });
    assert_sound("ten thousand emitters", &lit);
    let texels = some_texels(&lit, 300, |i| position(&scene, &lit, i).y < 4.0);
    let (s, worst, place) = score_closed_form(&scene, &lit, &texels, first);
    println!(
        "ten thousand emitters: {} texels, RMSE {:.3} %, bias {:+.3} %, largest {:.2} % at {place:.2}",
        s.samples,
        100.0 * s.rmse,
        100.0 * s.bias,
        100.0 * worst
    );
    // So many are gathered by cuts, whose error the setting `cut_error` (1.7 %) governs.
    assert!(s.rmse <= 0.02 && s.bias.abs() <= 0.005 && worst <= 0.06, "{s:?}");
    let lit = bake(&scene, &coarse());
    // No texel receives more than a hemisphere of lamps would give it, and what they all reflect.
    let most = PI * f64::from(radiance) / (1.0 - RHO);
    assert_between("ten thousand emitters, all light", &scene, &lit, &texels, |p| (0.95 * first(p), most));
}

/// A lamp of 10 cd at `distance` before the wall z = 0 of a closed room.
fn assert_lamp_before_a_wall(name: &str, distance: f64) {
    let (hi, intensity) = (DVec3::new(4.0, 3.0, 4.0), 10.0);
    let lamp = DVec3::new(2.1, 1.4, distance);
    let mut b = Builder::new(name);
    room(&mut b, Vec3::ZERO, hi.as_vec3());
    b.light("lamp", point(lamp), Vec3::splat(intensity as f32));
    let scene = b.build();
    let lit = bake(&scene, &coarse());
    // What the spot on the wall reflects of half the lamp's light, as a Lambertian point: Φ = ρ · 2πI, its intensity Φ cos/π.
    let reflected = RHO * 2.0 * intensity;
    let first = |p: DVec3| {
        let (n, cosine) = (inward(p, DVec3::ZERO, hi), p.z / lamp.distance(p));
        lamp_at(lamp, intensity + reflected * cosine, p, n)
    };
    // The walls beside the lamp are brightest in its plane.
    let most = (intensity + reflected) / 1.4f64.powi(2);
    let rest = RHO / (1.0 - RHO) * most;
    let off_wall = |p: DVec3| p.z > 1e-3;
    let texels = valid_texels(&lit, |i| off_wall(position(&scene, &lit, i)));
    // The spot is a surfel to the gather, not a point: 2 % of what it reflects.
    let bounds = |p: DVec3| (0.98 * first(p), first(p) + rest);
    assert_between(name, &scene, &lit, &texels, bounds);
    // Energy: what arrives on walls other than the lamp's is half the lamp's light and what the spot reflects of the other
    // half, then all of it bounces in the closed room; the spot itself, a point, is left out of both sides.
    let flux = 2.0 * PI * intensity + PI * reflected;
    let lit_wall = valid_texels(&lit, |i| {
        let p = position(&scene, &lit, i);
        off_wall(p) || p.distance(lamp) > 0.5
    });
    let balance = mean(&lit, &lit_wall) * area(hi) * (1.0 - RHO) / flux;
    println!("{name}: absorbed / sent = {balance:.4}");
    assert!((balance - 1.0).abs() < 0.02, "{name}: {balance}");
}

#[test]
fn a_lamp_a_micrometre_before_a_wall() {
    assert_lamp_before_a_wall("lamp 1 µm before a wall", 1e-6);
}

#[test]
fn a_lamp_a_millimetre_before_a_wall() {
    assert_lamp_before_a_wall("lamp 1 mm before a wall", 1e-3);
}

#[test]
fn a_lamp_on_a_wall() {
    // Exactly in the wall's plane, the half that goes into the wall is the wall's.
    let (hi, intensity) = (DVec3::new(4.0, 3.0, 4.0), 10.0);
    let lamp = DVec3::new(2.1, 1.4, 0.0);
    let mut b = Builder::new("on");
    room(&mut b, Vec3::ZERO, hi.as_vec3());
    b.light("lamp", point(lamp), Vec3::splat(intensity as f32));
    let scene = b.build();
    let lit = bake(&scene, &coarse());
    let first = |p: DVec3| lamp_at(lamp, intensity, p, inward(p, DVec3::ZERO, hi));
    let texels = valid_texels(&lit, |i| position(&scene, &lit, i).z > 1e-3);
    // At most the wall reflects its half, too, as it does 1 µm before it.
    let most = intensity * (1.0 + 2.0 * RHO) / 1.4f64.powi(2);
    let bounds = |p: DVec3| (0.98 * first(p), (1.0 + 2.0 * RHO) * first(p) + RHO / (1.0 - RHO) * most);
    assert_between("lamp on a wall", &scene, &lit, &texels, bounds);
}

#[test]
fn a_lamp_in_a_wall() {
    // Between the faces of a solid block: nobody sees it.
    let mut b = Builder::new("in");
    room(&mut b, Vec3::ZERO, Vec3::new(4.0, 3.0, 4.0));
    let wall = grey(&mut b);
    b.cuboid("block", Vec3::new(1.5, 0.5, 1.5), Vec3::new(2.5, 2.0, 1.6), wall, false);
    b.light("lamp", point(DVec3::new(2.0, 1.2, 1.55)), Vec3::splat(1e6));
    let lit = bake(&b.build(), &coarse());
    assert_sound("lamp in a wall", &lit);
    let brightest = valid_texels(&lit, |_| true).iter().map(|&i| brightness(&lit, i)).fold(0.0, f64::max);
    println!("lamp in a wall: brightest texel {brightest:.3e} lux of 10⁶ cd");
    assert_eq!(brightest, 0.0);
}

#[test]
fn a_sun_and_a_candle() {
    // A hut with walls of 0.3 m on open ground; a candle in it, the sun outside.
    let candle = DVec3::new(0.3, 1.0, -0.2);
    let build = |sun: bool, light: bool| {
        let mut b = Builder::new("hut");
        let wall = grey(&mut b);
        b.quad("ground", Vec3::new(-6.0, -0.3, 6.0), Vec3::X * 12.0, Vec3::NEG_Z * 12.0, wall);
        b.cuboid("outside", Vec3::new(-1.8, -0.3, -1.8), Vec3::new(1.8, 2.3, 1.8), wall, false);
        b.cuboid("inside", Vec3::new(-1.5, 0.0, -1.5), Vec3::new(1.5, 2.0, 1.5), wall, true);
        if light {
            b.light("candle", point(candle), Vec3::ONE);
        }
        if sun {
            let direction = DVec3::new(0.4, -0.8, 0.45).normalize();
            b.light("sun", LightKind::Sun { direction, angle: 0.0093 }, Vec3::splat(1e5));
        }
        b.build()
    };
    let scene = build(true, true);
    let lit = bake(&scene, &coarse());
    assert_sound("sun and candle", &lit);
    let inside = |lit: &Lit| valid_texels(lit, |i| lit.atlas.chart(&lit.atlas.texels[i]).instance == 2);
    let outside = valid_texels(&lit, |i| lit.atlas.chart(&lit.atlas.texels[i]).instance == 0);
    let alone = bake(&build(false, true), &coarse());
    let (both, one) = (mean(&lit, &inside(&lit)), mean(&alone, &inside(&alone)));
    let sunny = mean(&lit, &outside);
    let exact = 4.0 * PI / (area(DVec3::new(3.0, 2.0, 3.0)) * (1.0 - RHO));
    println!(
        "sun and candle: inside {both:.5} lux, by candle alone {one:.5} (energy balance {exact:.5}), outside {sunny:.0}"
    );
    assert!((one / exact - 1.0).abs() < 0.01, "{one} {exact}");
    assert!(sunny > 1e4);
    let leak = (both - one) / sunny;
    println!("sun and candle: leak {leak:.2e} of the sunlit ground");
    assert!(leak.abs() <= 1e-6, "{leak}");
    let (lo, hi) = (DVec3::new(-1.5, 0.0, -1.5), DVec3::new(1.5, 2.0, 1.5));
    let first = |p: DVec3| lamp_at(candle, 1.0, p, inward(p, lo, hi));
    // The floor and the ceiling are 1 m away, and no wall is nearer.
    let bounds = |p: DVec3| (0.999 * first(p), first(p) + RHO / (1.0 - RHO) + 1e-6 * sunny);
    assert_between("sun and candle, inside", &scene, &lit, &inside(&lit), bounds);
}
