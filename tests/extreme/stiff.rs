//! Nearly white rooms. In a closed room in which every wall has the albedo ρ and the direct irradiance E₀, E = E₀/(1 − ρ)
//! everywhere, whatever its shape, and the sum of the first n bounces is E₀ (1 − ρⁿ⁺¹)/(1 − ρ).

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use luxel::settings::{
    Settings,
    value::{Samples, Tolerance},
};
use luxel_scene::{Scene, Silent, build::Builder};
use luxel_transport::{
    Rgb,
    directions::DirectionSet,
    geometry::Geometry,
    rays::{OFFSET, Rays},
    sampling::{basis, cosine_hemisphere, mix, unit, unit2},
    solve::{SolveReport, SolveSettings, is_closed, row_sums, solve, stiff},
    surfel::Surfels,
    sweep::{Rule, Sweep},
};

use crate::kit::*;
use crate::support::*;

const ALBEDOS: [f32; 5] = [0.5, 0.8, 0.9, 0.99, 0.999];

fn box_room(b: &mut Builder, wall: usize) {
    b.cuboid("room", Vec3::new(-0.5, 0.0, -0.7), Vec3::new(0.8, 0.9, 0.4), wall, true);
}

fn round_room(b: &mut Builder, wall: usize) {
    b.sphere("room", Vec3::new(0.1, 0.2, -0.3), 0.7, 8, wall, true);
}

/// An L of two arms, 1 wide, 2 long and 0.8 high: a prism over six corners, seen from inside.
fn l_room(b: &mut Builder, wall: usize) {
    let outline = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]];
    let at = |i: usize, y: f32| Vec3::new(outline[i % 6][0], y, outline[i % 6][1]);
    for i in 0..6 {
        let (o, along) = (at(i, 0.0), at(i + 1, 0.0) - at(i, 0.0));
        b.quad("wall", o, along, Vec3::Y * 0.8, wall);
    }
    for (y, order) in [(0.0, [0, 2, 1]), (0.8, [0, 1, 2])] {
        let corners = [0, 1, 2, 3, 4, 5].map(|i| at(i, y));
        // Floor and ceiling in two rectangles each that share the inner corner's diagonal.
        let fan = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]].map(|t| order.map(|k: usize| t[k] as u32));
        b.mesh("lid", corners.to_vec(), fan.to_vec(), wall);
    }
}

/// The solver alone, with E₀ = 1 everywhere: its report, and the largest relative error of any surfel.
fn solver_of_constant(scene: &Scene, rho: f64) -> (SolveReport, f64) {
    let geometry = Geometry::new(scene);
    let surfels = voxelized(&geometry, 12_000);
    let closed = is_closed(&Rays::new(&geometry), &surfels, 1 << 14);
    assert!(closed, "{} is closed", scene.name);
    let direct = vec![Rgb::ONE; surfels.list.len()];
    let (solution, report) =
        solve(&surfels, &direct, &SolveSettings { closed, ..SolveSettings::default() }, None, &Silent).expect("light");
    let exact = 1.0 / (1.0 - rho);
    let off = |i: usize| (f64::from(solution.total(i).x) / exact - 1.0).abs();
    let worst = (0..surfels.list.len()).map(off).fold(0.0, f64::max);
    (report, worst)
}

fn assert_furnaces(name: &str, shape: impl Fn(&mut Builder, usize), settings: &Settings) {
    for albedo in ALBEDOS {
        let (scene, exact) = furnace(name, albedo, &shape);
        let (report, worst) = solver_of_constant(&scene, f64::from(albedo));
        let steps = report.bounces.len() as u32 + report.stiff_steps;
        let rows = report.rows.expect("rows are measured");
        println!(
            "{name} ρ {albedo}: {steps} steps, solver off by {:.4} %, row-sum defect before closing {:.2e}",
            100.0 * worst,
            rows.defect() + rows.sky
        );
        assert!(steps <= 12, "{name} {albedo}: {steps} steps");
        let lit = bake(&scene, settings);
        assert_within(&format!("{name} furnace, ρ {albedo}"), &scene, &lit, 0.005, |_| exact);
    }
}

#[test]
fn box_furnaces() {
    assert_furnaces("box", box_room, &coarse());
}

#[test]
fn sphere_furnaces() {
    assert_furnaces("sphere", round_room, &coarse());
}

#[test]
fn l_shaped_furnaces() {
    // Its inner corner hides part of every glowing wall, so that direct light at surfels is sampled and differs by some
    // 0.1 %. The cut of the preset makes up to 0.6 % of that at single texels where ρ = 0.5; a third of its threshold is
    // enough.
    let settings = Settings { cut_error: Tolerance(0.005), cut_limit: Samples(4000), ..coarse() };
    assert_furnaces("L", l_room, &settings);
}

/// A fixed set of directions, as the solver of stiff scenes has one.
fn fixed() -> Vec<luxel_transport::directions::Direction> {
    DirectionSet::Fibonacci.directions(128, u32::MAX - 1)
}

#[test]
fn partial_sums_of_a_furnace() {
    // Bounce by bounce: after n of them E = E₀ (1 − ρⁿ⁺¹)/(1 − ρ) at every surfel. A closed scene's rows sum to 1, so what
    // is left is the rounding of f32.
    for (name, shape) in [("box", box_room as fn(&mut Builder, usize)), ("sphere", round_room), ("L", l_room)] {
        for albedo in [0.5f32, 0.9, 0.99] {
            let (scene, _) = furnace(name, albedo, shape);
            let geometry = Geometry::new(&scene);
            let surfels = voxelized(&geometry, 3000);
            let sweep = Sweep::new(&surfels, Rule::Surface, true);
            let rho: Vec<f64> = surfels.list.iter().map(|s| f64::from(s.albedo().x)).collect();
            let mut current = vec![Rgb::ONE; rho.len()];
            let mut sum = current.clone();
            let mut worst = 0.0f64;
            for n in 1..=60 {
                let sent = current.iter().zip(&surfels.list).map(|(e, s)| *e * s.albedo()).collect();
                current = sweep.apply(&fixed(), sent, None, true, &Silent).expect("light");
                sum.iter_mut().zip(&current).for_each(|(s, e)| *s += *e);
                for (s, r) in sum.iter().zip(&rho) {
                    let exact = (1.0 - r.powi(n + 1)) / (1.0 - r);
                    worst = worst.max((f64::from(s.x) / exact - 1.0).abs());
                }
            }
            println!("{name} ρ {albedo}: 60 partial sums, largest error of any surfel {worst:.2e}");
            assert!(worst < 2e-5, "{name} {albedo}: {worst}");
        }
    }
}

#[test]
fn partial_sums_of_bakes() {
    // The solver's own bounces, with fewer directions from one to the next: increments fall by ρ each.
    let (scene, _) = furnace("sphere", 0.9, round_room);
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 3000);
    let direct = vec![Rgb::ONE; surfels.list.len()];
    let settings =
        SolveSettings { closed: true, tolerance: 0.0, stiff: 1.0, max_bounces: 40, ..SolveSettings::default() };
    let (_, report) = solve(&surfels, &direct, &settings, None, &Silent).expect("light");
    let mut sum = 0.0;
    for (n, bounce) in (1..).zip(&report.bounces) {
        sum += bounce.increment / surfels.area();
        let exact = 0.9 * (1.0 - 0.9f64.powi(n)) / 0.1;
        assert!((sum / exact - 1.0).abs() < 1e-5, "{n}: {sum} {exact}");
    }
    println!("40 bounces of the solver: the sum is {sum:.6}, exactly {:.6}", 9.0 * (1.0 - 0.9f64.powi(40)));
    assert_eq!(report.bounces.len(), 40);
}

/// The sweep's operator at any reflectance, solved as the solver does it after its first bounces: x = source + ρTx.
fn applications(surfels: &Surfels, rho: f64, source: &[Rgb], tolerance: f64) -> (u32, Vec<Rgb>) {
    let sweep = Sweep::new(surfels, Rule::Surface, true);
    let operator = |x: &[Rgb]| sweep.apply(&fixed(), x.to_vec(), None, true, &Silent);
    let rest = stiff::solve(&closed_equation(surfels, &|_| Rgb::splat(rho as f32), source), 0.0, tolerance, operator)
        .expect("light");
    (rest.steps, rest.irradiance)
}

#[test]
fn steps_do_not_grow_with_the_albedo() {
    // Plain bounces take ln ε / ln ρ of them, 690 772 at ρ = 0.99999. Light on one end only, so that there is more to solve
    // for than the constant; the same solved to 10⁻⁶ says how far it is off. With light everywhere, E = ρ/(1 − ρ) exactly.
    for (name, shape) in [("box", box_room as fn(&mut Builder, usize)), ("sphere", round_room), ("L", l_room)] {
        let (scene, _) = furnace(name, 0.5, shape);
        for (turn, scene) in [("", scene.clone()), (" tilted", tilted(scene))] {
            let geometry = Geometry::new(&scene);
            let surfels = voxelized(&geometry, 12_000);
            let lowest = surfels.list.iter().map(|s| s.centroid.x).fold(f32::INFINITY, f32::min);
            for rho in [0.5, 0.8, 0.9, 0.99, 0.999, 0.9999, 0.99999] {
                // f32 rounds ρ, and 1 − ρ with it.
                let rho = f64::from(rho as f32);
                let lit = |s: &luxel_transport::surfel::Surfel| s.centroid.x < lowest + 400.0;
                let source: Vec<Rgb> =
                    surfels.list.iter().map(|s| if lit(s) { Rgb::splat(rho as f32) } else { Rgb::ZERO }).collect();
                let (steps, found) = applications(&surfels, rho, &source, 1e-3);
                let (more, exact) = applications(&surfels, rho, &source, 1e-6);
                let sum = |e: &[Rgb]| (0..e.len()).map(|i| f64::from(surfels.list[i].area * e[i].x)).sum::<f64>();
                let error = sum(&found) / sum(&exact) - 1.0;
                let everywhere = vec![Rgb::splat(rho as f32); surfels.list.len()];
                let (even, constant) = applications(&surfels, rho, &everywhere, 1e-3);
                let off =
                    constant.iter().map(|e| (f64::from(e.x) / (rho / (1.0 - rho)) - 1.0).abs()).fold(0.0, f64::max);
                println!(
                    "{name}{turn} ρ {rho:.6}: {steps} steps, off by {error:+.1e}; {more} steps to 10⁻⁶; light \
                     everywhere: {even} steps, off by {off:.1e}"
                );
                assert!(steps <= 10 && more <= 20 && even <= 2, "{name}{turn} {rho}: {steps}, {more}, {even}");
                assert!(error.abs() < 1e-3, "{name}{turn} {rho}: {error}");
                // What a sweep in f32 rounds of the one bounce that starts.
                assert!(off < 1e-5, "{name}{turn} {rho}: {off}");
            }
        }
    }
}

#[test]
fn rows_of_closed_rooms_sum_to_one() {
    for (name, shape) in [("box", box_room as fn(&mut Builder, usize)), ("sphere", round_room), ("L", l_room)] {
        let (scene, _) = furnace(name, 0.5, shape);
        for scene in [scene.clone(), tilted(scene)] {
            let geometry = Geometry::new(&scene);
            let surfels = voxelized(&geometry, 12_000);
            let rays = Rays::new(&geometry);
            assert!(is_closed(&rays, &surfels, 1 << 14), "{name}");
            let sums = |closed: bool| {
                let sweep = Sweep::new(&surfels, Rule::Surface, closed);
                row_sums(&sweep, &fixed(), &Silent).expect("light")
            };
            let defect = |rows: &[Rgb]| {
                let missing =
                    |(s, r): (&luxel_transport::surfel::Surfel, &Rgb)| f64::from(s.area) * (1.0 - f64::from(r.x));
                surfels.list.iter().zip(rows).map(missing).sum::<f64>() / surfels.area()
            };
            let (open, closed) = (sums(false), sums(true));
            // A surfel that no line tells anything has a row of zeros: there is nothing to divide by.
            let known = || closed.iter().filter(|r| r.x > 0.0);
            let worst = known().map(|r| (f64::from(r.x) - 1.0).abs()).fold(0.0, f64::max);
            let unknown = closed.len() - known().count();
            println!(
                "{name}: row-sum defect {:.2e} open, {:.1e} closed; largest of any row {worst:.1e}, {unknown} rows of \
                 nothing of {}",
                defect(&open),
                defect(&closed),
                closed.len()
            );
            assert!(worst < 2e-6, "{name}: {worst}");
            assert_eq!(unknown, 0, "{name}");
            assert!(defect(&open) < 5e-3, "{name}: {}", defect(&open));
        }
    }
}

/// Radiosity of two parallel square plates that face each other, of side 2 and albedo ρ, the lower one glowing, by the
/// midpoint rule on n² cells a plate with the kernel d²/(π(r² + d²)²): E on both, cell by cell, iterated to rest.
fn plates_by_quadrature(n: usize, gap: f64, rho: f64) -> [Vec<f64>; 2] {
    let (h, side) = (2.0 / n as f64, n * n);
    let kernel: Vec<f64> = (0..side)
        .map(|k| {
            let r2 = h * h * ((k % n).pow(2) + (k / n).pow(2)) as f64;
            h * h * gap * gap / (PI * (r2 + gap * gap).powi(2))
        })
        .collect();
    let through = |b: &[f64]| -> Vec<f64> {
        let one = |i: usize| {
            let (x, y) = (i % n, i / n);
            (0..side).map(|j| b[j] * kernel[(y.abs_diff(j / n)) * n + x.abs_diff(j % n)]).sum::<f64>()
        };
        (0..side).map(one).collect()
    };
    let glow = PI * f64::from(GLOW);
    let mut e = [vec![0.0; side], vec![0.0; side]];
    for _ in 0..40 {
        let lower: Vec<f64> = e[0].iter().map(|e| glow + rho * e).collect();
        let upper: Vec<f64> = e[1].iter().map(|e| rho * e).collect();
        e = [through(&upper), through(&lower)];
    }
    e
}

#[test]
fn two_parallel_plates() {
    // The rule converges with the square of the cells' size, so the finer solution is off by a third of what halving them
    // has changed.
    let (gap, rho, n) = (0.8f32, 0.9f32, 24);
    let exact = plates_by_quadrature(n, gap.into(), rho.into());
    let finer = plates_by_quadrature(2 * n, gap.into(), rho.into());
    let average = |e: &[f64]| e.iter().sum::<f64>() / e.len() as f64;
    for plate in 0..2 {
        let change = average(&exact[plate]) / average(&finer[plate]) - 1.0;
        assert!(change.abs() / 3.0 < 1e-3, "{change}");
    }
    let mut b = Builder::new("plates");
    let (dark, glow) = (b.matte(Vec3::splat(rho)), b.emitter(Vec3::splat(rho), Vec3::splat(GLOW)));
    b.quad("lower", Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::NEG_Z * 2.0, glow);
    b.quad("upper", Vec3::new(-1.0, gap, -1.0), Vec3::X * 2.0, Vec3::Z * 2.0, dark);
    let scene = b.build();
    // The finer solution, bilinear between the middles of its cells.
    let truth = |p: DVec3| {
        let (m, e) = (2 * n, &finer[usize::from(p.y > 0.1)]);
        let place = |c: f64| ((c + 1.0) * 0.5 * m as f64 - 0.5).clamp(0.0, m as f64 - 1.0);
        let (x, z) = (place(p.x), place(p.z));
        let (i, j) = ((x as usize).min(m - 2), (z as usize).min(m - 2));
        let (s, t) = (x - i as f64, z - j as f64);
        let row = |j: usize| e[j * m + i] * (1.0 - s) + e[j * m + i + 1] * s;
        row(j) * (1.0 - t) + row(j + 1) * t
    };
    for (name, baked) in [("plates", scene.clone()), ("plates tilted", tilted(scene.clone()))] {
        let lit = bake(&baked, &coarse());
        assert_sound("plates", &lit);
        let texels = valid_texels(&lit, |_| true);
        let (s, worst, place) = score_closed_form(&scene, &lit, &texels, truth);
        println!(
            "{}: {} texels, RMSE {:.3} %, bias {:+.3} %, largest {:.2} % at {place:.2}",
            name,
            s.samples,
            100.0 * s.rmse,
            100.0 * s.bias,
            100.0 * worst
        );
        assert!(s.samples > 1000 && s.rmse <= 0.01 && s.bias.abs() <= 0.005 && worst <= 0.03, "{s:?}");
    }
}

/// Ten rooms in a row, each 1 × 0.8 × 1, with a door in turn left and right; a lamp hangs in the first.
fn labyrinth() -> Scene {
    let mut b = Builder::new("labyrinth");
    let wall = b.matte(Vec3::splat(0.7));
    let lamp = b.emitter(Vec3::splat(0.7), Vec3::splat(100.0));
    b.cuboid("shell", Vec3::ZERO, Vec3::new(10.0, 0.8, 1.0), wall, true);
    for k in 1..10 {
        let (x, half) = (k as f32, 0.05);
        let [near, far] = if k % 2 == 0 { [0.0, 0.3] } else { [0.7, 1.0] };
        let slab = |b: &mut Builder, z: [f32; 2], y: [f32; 2]| {
            let (lo, hi) = (Vec3::new(x - half, y[0], z[0]), Vec3::new(x + half, y[1], z[1]));
            b.cuboid("wall", lo, hi, wall, false);
        };
        for side in [[0.0, near], [far, 1.0]].into_iter().filter(|s| s[1] > s[0]) {
            slab(&mut b, side, [0.0, 0.8]);
        }
        slab(&mut b, [near, far], [0.6, 0.8]);
    }
    b.cuboid("lamp", Vec3::new(0.3, 0.6, 0.4), Vec3::new(0.5, 0.65, 0.6), lamp, false);
    b.build()
}

/// The part of a room in which light is compared, away from the slabs: all of floor, ceiling and long walls there.
fn in_room(p: DVec3) -> Option<usize> {
    let along = p.x - p.x.floor();
    let is_end = p.x < 1e-6 || p.x > 10.0 - 1e-6;
    (!is_end && (0.1..0.9).contains(&along)).then_some(p.x as usize)
}

/// Mean irradiance of [`in_room`] of every room by particles from the lamp, with its standard error. Hardly one in twenty
/// goes through a door, so each that comes to a new room becomes [`COPIES`] of a [`COPIES`]th of its flux (splitting).
fn by_particles(scene: &Scene) -> [(f64, f64); 10] {
    const BATCHES: usize = 16;
    const EACH: u64 = 16_000;
    const COPIES: u32 = 20;
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let lamp = scene.instances.len() - 1;
    let sides: Vec<&luxel_transport::geometry::Triangle> =
        geometry.triangles.iter().filter(|t| t.instance as usize == lamp).collect();
    let size = |t: &luxel_transport::geometry::Triangle| {
        let [a, b, c] = t.corners.map(|c| c.as_dvec3());
        0.5 * (b - a).cross(c - a).length()
    };
    let surface: f64 = sides.iter().map(|t| size(t)).sum();
    let mut means = vec![[0.0; 10]; BATCHES];
    for (batch, mean) in means.iter_mut().enumerate() {
        let mut seed = mix(batch as u64 + 1);
        let mut random = move || {
            seed = mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15));
            seed
        };
        for k in 0..EACH {
            // Sides in proportion to their areas, one after the other.
            let mut wanted = surface * (k as f64 + f64::from(unit(random()))) / EACH as f64;
            let side = sides.iter().find(|t| {
                wanted -= size(t);
                wanted <= 0.0
            });
            let Some(side) = side.or(sides.last()) else { continue };
            let [mut u, mut v] = [unit(random()), unit(random())];
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            // Position, normal, flux as a share of the lamp's, deepest room so far.
            let mut flights = vec![(side.at(u, v), side.normal, 1.0 / EACH as f64, 0)];
            while let Some((from, normal, flux, deepest)) = flights.pop() {
                let way = basis(normal) * cosine_hemisphere(unit2(random()));
                let Some(hit) = rays.closest(from + normal * OFFSET, way, f32::INFINITY) else { continue };
                let triangle = &geometry.triangles[hit.triangle as usize];
                let point = triangle.at(hit.u, hit.v);
                let place = geometry.frame.world(point);
                if let (0, Some(room)) = (triangle.instance, in_room(place)) {
                    mean[room] += flux;
                }
                if f64::from(unit(random())) >= 0.7 {
                    continue;
                }
                let room = place.x.clamp(0.0, 9.0) as usize;
                let (copies, deepest) = if room > deepest { (COPIES, room) } else { (1, deepest) };
                let flux = flux / f64::from(copies);
                flights.extend((0..copies).map(|_| (point, triangle.normal, flux, deepest)));
            }
        }
    }
    // 0.8 m of floor, ceiling and two walls; the lamp's box of 0.2 × 0.05 × 0.2 m.
    let scale = PI * 100.0 * (2.0 * 0.04 + 4.0 * 0.01) / (0.8 * 3.6);
    std::array::from_fn(|room| {
        let n = BATCHES as f64;
        let mean = means.iter().map(|m| m[room]).sum::<f64>() / n;
        let square = means.iter().map(|m| (m[room] - mean).powi(2)).sum::<f64>();
        (mean * scale, (square / (n * (n - 1.0))).sqrt() * scale)
    })
}

#[test]
fn a_labyrinth_of_ten_rooms() {
    let scene = labyrinth();
    // Bounces end when little is left to come of all the light, of which the last rooms have some 10⁻¹⁰.
    let lit = bake(&scene, &Settings { tolerance: Tolerance(1e-9), ..sized(160, 30_000) });
    assert_sound("labyrinth", &lit);
    let known = by_particles(&scene);
    let shell = |i: usize| lit.atlas.chart(&lit.atlas.texels[i]).instance == 0;
    for (room, (exact, error)) in known.into_iter().enumerate() {
        let texels = valid_texels(&lit, |i| shell(i) && in_room(position(&scene, &lit, i)) == Some(room));
        let dimmest = texels.iter().map(|&i| value(&lit, i).min_element()).fold(f32::INFINITY, f32::min);
        let e = mean(&lit, &texels);
        println!(
            "labyrinth, room {room}: mean E {e:.3e}, {:+.1} % of {exact:.3e} by particles ± {:.1} %; least {dimmest:.1e}",
            100.0 * (e / exact - 1.0),
            100.0 * error / exact
        );
        // Behind the seventh door no ray of a surfel may have met another that has any light.
        assert!(texels.len() > 100 && (dimmest > 0.0 || room > 6 && dimmest == 0.0), "room {room}: {dimmest}");
        // Of the last two rooms particles tell hardly more than the order of magnitude.
        let known_within = if room < 8 { 0.1 } else { 0.4 };
        assert!(error < known_within * exact, "room {room}: {exact} ± {error}");
        // What a bounce has wrong of a door counts again at every door.
        let bound = 0.01 + 0.02 * room as f64;
        assert!((e / exact - 1.0).abs() <= bound + 3.0 * error / exact, "room {room}: {e} {exact} ± {error}");
    }
    for room in [0, 1] {
        let some = some_texels(&lit, 60, |i| shell(i) && in_room(position(&scene, &lit, i)) == Some(room));
        let s = score_texels(&scene, &lit, &some, 4096);
        println!("labyrinth, room {room} against the reference: {s}");
        let noise = s.noise / (s.samples as f64).sqrt();
        assert!(s.bias.abs() <= 0.01 + 3.0 * noise, "room {room}: {s:?}");
    }
}

#[test]
fn the_energy_of_a_labyrinth_is_accounted_for() {
    let scene = labyrinth();
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    for budget in [15_000, 120_000] {
        // So few voxels make almost two per cent of light that nobody sent.
        let most = if budget < 20_000 { 0.025 } else { 0.01 };
        let surfels = voxelized(&geometry, budget);
        let lit = |s: &luxel_transport::surfel::Surfel| geometry.frame.world(s.centroid).x < 0.3;
        let direct: Vec<Rgb> = surfels.list.iter().map(|s| if lit(s) { Rgb::ONE } else { Rgb::ZERO }).collect();
        let closed = is_closed(&rays, &surfels, 1 << 14);
        let settings = SolveSettings { closed, ..SolveSettings::default() };
        let (solution, report) = solve(&surfels, &direct, &settings, None, &Silent).expect("light");
        let ledger = &report.ledger;
        let share = |part: DVec3| part.x / ledger.shot.x;
        let steps = report.bounces.len() as u32 + report.stiff_steps;
        println!(
            "labyrinth, {} surfels, {steps} steps: absorbed {:.4}, escaped {:.1e}, in flight {:.1e}, imbalance {:.1e}",
            surfels.list.len(),
            share(ledger.absorbed),
            share(ledger.escaped),
            share(ledger.in_flight),
            share(ledger.imbalance)
        );
        assert!(solution.indirect.iter().all(|e| e.is_finite() && e.min_element() >= 0.0));
        assert!(share(ledger.imbalance).abs() < most && share(ledger.escaped) < 5e-3);
        assert!((share(ledger.absorbed) - 1.0).abs() < most && steps <= 30);
    }
}
