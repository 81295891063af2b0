//! f32 against f64: the same discrete operator both ways, and sums that could drift.

use glam::Vec3;
use luxel_scene::{Scene, Silent, build::Builder};
use luxel_transport::{
    Rgb,
    directions::{Direction, DirectionSet},
    geometry::Geometry,
    ledger::flux,
    solve::stiff,
    surfel::Surfels,
    sweep::{Rule, Sweep},
};

use crate::kit::*;
use crate::support::*;

/// A closed room with a block in it, tilted.
fn room(albedo: f32) -> Scene {
    let mut b = Builder::new("room");
    let wall = b.matte(Vec3::splat(albedo));
    b.cuboid("room", Vec3::ZERO, Vec3::new(1.0, 0.9, 1.1), wall, true);
    b.cuboid("block", Vec3::new(0.3, 0.2, 0.35), Vec3::new(0.55, 0.6, 0.6), wall, false);
    tilted(b.build())
}

fn directions(count: u32) -> Vec<Direction> {
    DirectionSet::Fibonacci.directions(count, 1)
}

/// The operator as a matrix, column by column: what every surfel receives where one alone sends 1. Three columns a sweep.
fn matrix(sweep: &Sweep, directions: &[Direction]) -> Vec<Vec<f64>> {
    let n = sweep.surfels().list.len();
    let mut columns = vec![vec![0.0; n]; n];
    for first in (0..n).step_by(3) {
        let mut ones = vec![Rgb::ZERO; n];
        (first..n.min(first + 3)).for_each(|j| ones[j][j - first] = 1.0);
        let arrived = sweep.apply(directions, ones, None, false, &Silent).expect("light");
        for j in first..n.min(first + 3) {
            columns[j].iter_mut().zip(&arrived).for_each(|(c, e)| *c = f64::from(e[j - first]));
        }
    }
    columns
}

#[test]
fn hundreds_of_bounces_in_f32_and_in_f64() {
    // The sweep's own sums in f32 against the same operator, taken apart into a matrix, in f64. Light on one side only.
    for albedo in [0.5f32, 0.9, 0.99] {
        let scene = room(albedo);
        let geometry = Geometry::new(&scene);
        let surfels = voxelized(&geometry, 900);
        let (sweep, set) = (Sweep::new(&surfels, Rule::Surface, true), directions(64));
        let columns = matrix(&sweep, &set);
        let n = surfels.list.len();
        let rho: Vec<f64> = surfels.list.iter().map(|s| f64::from(s.albedo().x)).collect();
        let lit = |i: usize| if surfels.list[i].centroid.x < 0.0 { 1.0f32 } else { 0.0 };
        let mut single: Vec<Rgb> = (0..n).map(|i| Rgb::splat(lit(i))).collect();
        let mut double: Vec<f64> = (0..n).map(|i| f64::from(lit(i))).collect();
        let (mut sum, mut exact) = (single.clone(), double.clone());
        for _ in 0..400 {
            let sent = single.iter().zip(&surfels.list).map(|(e, s)| *e * s.albedo()).collect();
            single = sweep.apply(&set, sent, None, true, &Silent).expect("light");
            let mut next = vec![0.0; n];
            for (j, column) in columns.iter().enumerate() {
                let sent = rho[j] * double[j];
                next.iter_mut().zip(column).for_each(|(e, t)| *e += sent * t);
            }
            double = next;
            sum.iter_mut().zip(&single).for_each(|(s, e)| *s += *e);
            exact.iter_mut().zip(&double).for_each(|(s, e)| *s += *e);
        }
        let total = |e: &dyn Fn(usize) -> f64| (0..n).map(|i| f64::from(surfels.list[i].area) * e(i)).sum::<f64>();
        let drift = total(&|i| f64::from(sum[i].x)) / total(&|i| exact[i]) - 1.0;
        let worst = (0..n).map(|i| (f64::from(sum[i].x) / exact[i] - 1.0).abs()).fold(0.0, f64::max);
        println!("ρ {albedo}: {n} surfels, 400 bounces: f32 off by {drift:+.1e} in all, {worst:.1e} at most");
        // One rounding of the matrix, 6·10⁻⁸ a bounce, is multiplied by the number of bounces that count, 1/(1 − ρ).
        let bound = 2e-6 + 1.2e-7 / (1.0 - f64::from(albedo));
        assert!(drift.abs() < bound && worst < 4.0 * bound, "{albedo}: {drift} {worst}");
    }
}

#[test]
fn a_whole_sweep_is_the_sum_of_its_directions() {
    // 512 directions in one sum of f32 against one sweep for each, weighted and summed in f64 in the opposite order.
    let scene = room(0.8);
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 3000);
    let (sweep, set) = (Sweep::new(&surfels, Rule::Surface, true), directions(512));
    let sent: Vec<Rgb> = surfels.list.iter().map(|s| Rgb::new(1.0 + s.centroid.x.abs() * 1e-3, 1.0, 1.0)).collect();
    let whole = sweep.apply(&set, sent.clone(), None, false, &Silent).expect("light");
    let n = surfels.list.len();
    let (mut sums, mut weights) = (vec![0.0; n], vec![0.0; n]);
    for direction in set.iter().rev() {
        // The second band is 1 where the line told anything and 0 where not.
        let one = sweep.apply(std::slice::from_ref(direction), sent.clone(), None, false, &Silent).expect("light");
        for i in 0..n {
            let w = f64::from(direction.weight) * f64::from(-surfels.list[i].normal.dot(direction.sigma)).max(0.0);
            sums[i] += w * f64::from(one[i].x);
            weights[i] += w * f64::from(one[i].y);
        }
    }
    let worst = (0..n)
        .filter(|&i| weights[i] > 0.0)
        .map(|i| (f64::from(whole[i].x) / (sums[i] / weights[i]) - 1.0).abs())
        .fold(0.0, f64::max);
    println!("512 directions in f32 against f64 in another order: {worst:.1e} at most, {n} surfels");
    assert!(worst < 2e-5, "{worst}");
}

#[test]
fn sums_of_light_do_not_drift() {
    // Fluxes over all surfels, forwards, backwards, and with a light of 10⁹ among those of 10⁻⁶.
    let scene = room(0.8);
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 50_000);
    let light = |i: usize| Rgb::splat(if i.is_multiple_of(1000) { 1e9 } else { 1e-6 * (1 + i % 7) as f32 });
    let forwards = flux(&surfels, light).x;
    let reversed = reversed(&surfels);
    let last = surfels.list.len() - 1;
    let backwards = flux(&reversed, |i| light(last - i)).x;
    let faint = flux(&surfels, |i| if light(i).x < 1.0 { light(i) } else { Rgb::ZERO }).x;
    let bright = flux(&surfels, |i| if light(i).x < 1.0 { Rgb::ZERO } else { light(i) }).x;
    println!(
        "flux of {} surfels: backwards {:+.1e}, parts {:+.1e}",
        last + 1,
        backwards / forwards - 1.0,
        (faint + bright) / forwards - 1.0
    );
    assert!((backwards / forwards - 1.0).abs() < 1e-12 && ((faint + bright) / forwards - 1.0).abs() < 1e-12);
    assert!(faint > 0.0 && forwards > bright.max(0.0));
}

fn reversed(surfels: &Surfels) -> Surfels {
    let mut list = surfels.list.clone();
    list.reverse();
    Surfels { list, ..surfels.clone() }
}

#[test]
fn light_of_any_strength_bakes_alike() {
    // Everything is linear in light: 10⁻⁶ and 10⁹ times the lamp give that much light, but for rounding.
    let scene = |factor: f32| {
        let mut scene = luxel_assets::cornell();
        scene.materials.iter_mut().for_each(|m| m.emission *= factor);
        scene
    };
    let plain = bake(&scene(1.0), &coarse());
    for factor in [1e-6f32, 1e9] {
        let lit = bake(&scene(factor), &coarse());
        assert_sound("strength", &lit);
        let texels = valid_texels(&plain, |_| true);
        let truth: Vec<Vec3> = texels.iter().map(|&i| value(&plain, i) * factor).collect();
        let values: Vec<Vec3> = texels.iter().map(|&i| value(&lit, i)).collect();
        let s = score(&values, &truth, &vec![0.0; texels.len()], &areas(&plain, &texels));
        println!("lamp × {factor:e}: RMSE {:.1e}, bias {:+.1e}", s.rmse, s.bias);
        assert!(s.samples > 1000 && s.rmse < 1e-4, "{s:?}");
    }
}

/// Solves x = e + ρTx by elimination with partial pivots; `columns` are those of T.
fn eliminated(columns: &[Vec<f64>], rho: f64, e: &[f64]) -> Vec<f64> {
    let n = e.len();
    let mut rows: Vec<Vec<f64>> = (0..n)
        .map(|i| (0..n).map(|j| f64::from(u8::from(i == j)) - rho * columns[j][i]).chain([e[i]]).collect())
        .collect();
    for k in 0..n {
        let pivot = (k..n).fold(k, |best, i| if rows[i][k].abs() > rows[best][k].abs() { i } else { best });
        rows.swap(k, pivot);
        let (done, rest) = rows.split_at_mut(k + 1);
        let top = &done[k];
        for row in rest {
            let factor = row[k] / top[k];
            if factor != 0.0 {
                row[k..].iter_mut().zip(&top[k..]).for_each(|(r, t)| *r -= factor * t);
            }
        }
    }
    let mut x = vec![0.0; n];
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| rows[k][j] * x[j]).sum();
        x[k] = (rows[k][n] - known) / rows[k][k];
    }
    x
}

#[test]
fn the_stiff_solver_against_elimination_in_f64() {
    // Light on one side of a tilted room, tolerance 10⁻³. In a closed room every row of the operator sums to 1, and f32
    // rounds that by some 10⁻⁷, which would count 1/(1 − ρ) times: the matrix of f64 gets its rows put right.
    let scene = room(0.5);
    let geometry = Geometry::new(&scene);
    let surfels = voxelized(&geometry, 900);
    let (sweep, set) = (Sweep::new(&surfels, Rule::Surface, true), directions(64));
    let mut columns = matrix(&sweep, &set);
    let n = surfels.list.len();
    let rows: Vec<f64> = (0..n).map(|i| columns.iter().map(|column| column[i]).sum()).collect();
    assert!(rows.iter().all(|row| (row - 1.0).abs() < 2e-6));
    columns.iter_mut().for_each(|column| column.iter_mut().zip(&rows).for_each(|(t, row)| *t /= row));
    for rho in [0.5f32, 0.9, 0.99, 0.999, 0.9999, 0.99999] {
        let lit = |i: usize| if surfels.list[i].centroid.x < 0.0 { rho } else { 0.0 };
        let source: Vec<Rgb> = (0..n).map(|i| Rgb::splat(lit(i))).collect();
        let operator = |x: &[Rgb]| sweep.apply(&set, x.to_vec(), None, true, &Silent);
        let q = f64::from(rho);
        let rest = stiff::solve(&closed_equation(&surfels, &|_| Rgb::splat(rho), &source), 0.0, 1e-3, operator)
            .expect("light");
        let exact = eliminated(&columns, q, &(0..n).map(|i| f64::from(lit(i))).collect::<Vec<_>>());
        let total = |x: &dyn Fn(usize) -> f64| (0..n).map(|i| f64::from(surfels.list[i].area) * x(i)).sum::<f64>();
        let error = total(&|i| f64::from(rest.radiosity[i].x)) / total(&|i| exact[i]) - 1.0;
        let off = total(&|i| (f64::from(rest.radiosity[i].x) - exact[i]).abs()) / total(&|i| exact[i]);
        println!("ρ {rho}: {} steps, off by {error:+.1e} in all, {off:.1e} in the mean", rest.steps);
        assert!(rest.steps <= 12, "{rho}: {} steps", rest.steps);
        assert!(error.abs() <= 1e-3 && off <= 1e-3, "{rho}: {error} {off}");
    }
}
