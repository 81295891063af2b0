//! What the whole-tool tests share: a bake in memory, and its error against the reference path tracer by the metrics
//! of the design: over valid texels, weighted by area, RMSE and bias over the mean irradiance, and percentiles of the
//! relative error.

#![allow(dead_code)] // Every test binary uses its part of this.

use std::path::PathBuf;

use glam::{DAffine3, DVec3, Vec2, Vec3};
use luxel::settings::{Preset, Settings, value::Texels};
use luxel::verify::{Sample, measure};
use luxel::{Lit, bake_scene};
use luxel_scene::{Scene, Silent};
use luxel_transport::{
    gather::Receiver,
    geometry::Geometry,
    rays::Rays,
    reference::{Estimate, Options, Reference},
    sampling::{mix, unit},
    validity,
};

/// The error of some values against others, the reference's noise left in. Shares of the mean.
#[derive(Clone, Copy, Debug)]
pub struct Score {
    pub samples: usize,
    /// Area-weighted mean of the reference, band mean [lux].
    pub mean: f64,
    pub rmse: f64,
    pub bias: f64,
    /// Of the relative error.
    pub median: f64,
    pub p95: f64,
    /// Root mean square of the reference's standard error.
    pub noise: f64,
}

impl std::fmt::Display for Score {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let [rmse, bias, median, p95, noise] =
            [self.rmse, self.bias, self.median, self.p95, self.noise].map(|share| 100.0 * share);
        write!(
            f,
            "mean E {:.4}, RMSE {rmse:.2} %, bias {bias:+.2} %, median {median:.2} %, p95 {p95:.1} %, \
             reference noise {noise:.2} %",
            self.mean
        )
    }
}

/// Compares values with a reference; `noise` are the reference's standard errors, `weights` areas.
pub fn score(values: &[Vec3], truth: &[Vec3], noise: &[f32], weights: &[f64]) -> Score {
    // What no band is said to be uncertain by is not taken off.
    let sample = |i: usize| Sample {
        found: values[i],
        expected: truth[i],
        band_error: Vec3::ZERO,
        error: noise[i],
        weight: weights[i],
    };
    let m = measure(&(0..values.len()).map(sample).collect::<Vec<_>>());
    Score {
        samples: m.samples,
        mean: m.mean,
        rmse: m.rmse.value,
        bias: m.bias.value,
        median: m.median.value,
        p95: m.p95.value,
        noise: m.noise,
    }
}

/// The preset `medium` on one atlas of 512².
pub fn medium_512() -> Settings {
    Settings { size: Texels(512), ..Settings::preset(Preset::Medium) }
}

/// Bakes in memory; panics with the bake's own message.
pub fn bake(scene: &Scene, settings: &Settings) -> Lit {
    bake_scene(scene, settings, &Silent).unwrap_or_else(|e| panic!("{}: {e:?}", scene.name))
}

/// Where the real scenes are, or None with a plain word about it.
pub fn scenes() -> Option<PathBuf> {
    let path = std::env::var_os("LUXEL_SCENES")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/scenes")), PathBuf::from);
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("SKIPPED: no scenes at {} (set LUXEL_SCENES)", path.display());
    None
}

/// Whether cases run that take longer than a minute (`LUXEL_HEAVY=1`); says so where they do not.
pub fn is_heavy(name: &str) -> bool {
    let is_wanted = std::env::var_os("LUXEL_HEAVY").is_some_and(|value| value == "1");
    if !is_wanted {
        println!("SKIPPED: {name} (takes longer than a minute; LUXEL_HEAVY=1 runs it)");
    }
    is_wanted
}

/// A texel that counts: at least half covered and not inside geometry.
pub fn is_valid(lit: &Lit, texel: usize) -> bool {
    lit.atlas.texels[texel].coverage() >= 0.5 && !lit.texels.buried[texel]
}

/// What the finished lightmap holds at a texel [lux].
pub fn value(lit: &Lit, texel: usize) -> Vec3 {
    let t = &lit.atlas.texels[texel];
    let map = &lit.lightmaps[lit.atlas.chart(t).page as usize];
    map.irradiance()[usize::from(t.y) * map.width() as usize + usize::from(t.x)]
}

/// The finished lightmap at a point of an instance's mesh, filtered as engines do [lux].
pub fn value_at(lit: &Lit, instance: u32, triangle: u32, u: f32, v: f32) -> Vec3 {
    let placed = lit.atlas.placed[instance as usize].as_ref().expect("the instance receives");
    let [a, b, c] = placed.triangles[triangle as usize].map(|i| placed.uvs[i as usize]);
    let uv: Vec2 = a * (1.0 - u - v) + b * u + c * v;
    lit.lightmaps[placed.page as usize].sample(uv)
}

/// About `count` valid texels that satisfy `wanted`, spread evenly over the atlas by a fixed pattern.
pub fn some_texels(lit: &Lit, count: usize, wanted: impl Fn(usize) -> bool) -> Vec<usize> {
    let all: Vec<usize> = (0..lit.atlas.texels.len()).filter(|&i| is_valid(lit, i) && wanted(i)).collect();
    let stride = (all.len() as f64 / count as f64).max(1.0);
    let steps = (all.len() as f64 / stride) as usize;
    (0..steps).map(|k| all[((k as f64 + f64::from(unit(mix(k as u64)))) * stride) as usize % all.len()]).collect()
}

/// World position of a texel.
pub fn position(scene: &Scene, lit: &Lit, texel: usize) -> DVec3 {
    let t = &lit.atlas.texels[texel];
    let instance = &scene.instances[lit.atlas.chart(t).instance as usize];
    let [a, b, c] = scene.corners(instance.mesh, t.triangle as usize).map(|corner| corner.as_dvec3());
    let [u, v] = t.barycentric().map(f64::from);
    instance.transform.transform_point3(a + (b - a) * u + (c - a) * v)
}

/// A texel as a receiver, at its own point.
fn receiver(geometry: &Geometry, lit: &Lit, texel: usize) -> Receiver {
    let t = &lit.atlas.texels[texel];
    let triangle = geometry.triangle(lit.atlas.chart(t).instance, t.triangle);
    let footprint = geometry.frame.length(f64::from(t.footprint()));
    let seed = lit.atlas.charts[t.chart as usize].texel_seed(t.x, t.y);
    let [u, v] = t.barycentric();
    Receiver::on_triangle(geometry, triangle, u, v, footprint, seed)
}

/// Reference irradiance at texels, each with its own standard error.
pub fn reference(scene: &Scene, lit: &Lit, texels: &[usize], paths: u32) -> Vec<Estimate> {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let receivers: Vec<Receiver> = texels.iter().map(|&i| receiver(&geometry, lit, i)).collect();
    Reference::new(&rays, Options::default()).irradiances(&receivers, paths, &Silent).expect("not cancelled")
}

/// The score of a bake at some of its texels. Texels whose point lies inside other geometry do not count (the bake gave
/// them the light of the nearest free point).
pub fn score_texels(scene: &Scene, lit: &Lit, texels: &[usize], paths: u32) -> Score {
    let geometry = Geometry::new(scene);
    let rays = Rays::new(&geometry);
    let is_free = |i: &usize| !validity::is_buried(&rays, &receiver(&geometry, lit, *i));
    let texels: &Vec<usize> = &texels.iter().copied().filter(is_free).collect();
    let estimates = reference(scene, lit, texels, paths);
    let values: Vec<Vec3> = texels.iter().map(|&i| value(lit, i)).collect();
    let truth: Vec<Vec3> = estimates.iter().map(|e| e.total).collect();
    let noise: Vec<f32> = estimates.iter().map(|e| e.standard_error).collect();
    score(&values, &truth, &noise, &areas(lit, texels))
}

/// World areas of texels.
pub fn areas(lit: &Lit, texels: &[usize]) -> Vec<f64> {
    texels
        .iter()
        .map(|&i| {
            let t = &lit.atlas.texels[i];
            f64::from(t.footprint()).powi(2) * f64::from(t.coverage())
        })
        .collect()
}

/// Two bakes of one scene under different transforms (or settings), compared at equal points of its meshes.
pub fn score_copies(a: &Lit, b: &Lit, texels: &[usize]) -> Score {
    let at = |lit: &Lit, i: usize| {
        let t = &a.atlas.texels[i];
        let [u, v] = t.barycentric();
        value_at(lit, lit.atlas.chart(t).instance, t.triangle, u, v)
    };
    let truth: Vec<Vec3> = texels.iter().map(|&i| at(a, i)).collect();
    let values: Vec<Vec3> = texels.iter().map(|&i| at(b, i)).collect();
    score(&values, &truth, &vec![0.0; texels.len()], &areas(a, texels))
}

/// 30° about X, then 30° about Y: no wall is aligned with the voxels any more.
pub fn tilted(scene: Scene) -> Scene {
    let angle = 30f64.to_radians();
    let turn = DAffine3::from_rotation_y(angle) * DAffine3::from_rotation_x(angle);
    luxel_scene::build::transformed(scene, turn)
}

/// The preset `medium` on one atlas of the given side.
pub fn medium(side: u32) -> Settings {
    Settings { size: Texels(side), ..Settings::preset(Preset::Medium) }
}

/// All texels that count.
pub fn valid_texels(lit: &Lit, wanted: impl Fn(usize) -> bool) -> Vec<usize> {
    (0..lit.atlas.texels.len()).filter(|&i| is_valid(lit, i) && wanted(i)).collect()
}

/// The error of a bake at some of its texels against a closed form, the same in all bands: score, and the largest
/// relative error of any band of any texel with the world point where it is.
pub fn score_closed_form(
    scene: &Scene,
    lit: &Lit,
    texels: &[usize],
    truth: impl Fn(DVec3) -> f64,
) -> (Score, f64, DVec3) {
    let exact: Vec<f64> = texels.iter().map(|&i| truth(position(scene, lit, i))).collect();
    let values: Vec<Vec3> = texels.iter().map(|&i| value(lit, i)).collect();
    let (mut worst, mut place) = (0.0, DVec3::ZERO);
    for ((&i, value), exact) in texels.iter().zip(&values).zip(&exact) {
        let error = (value.as_dvec3() - *exact).abs().max_element() / exact;
        // A value that is not a number is the worst of all.
        if error > worst || error.is_nan() {
            (worst, place) = (if error.is_nan() { f64::INFINITY } else { error }, position(scene, lit, i));
        }
    }
    let truth: Vec<Vec3> = exact.iter().map(|e| Vec3::splat(*e as f32)).collect();
    (score(&values, &truth, &vec![0.0; texels.len()], &areas(lit, texels)), worst, place)
}

/// Every one of some texels, and at least 30 of them, is within `tolerance` of the closed form.
pub fn assert_texels_within(
    name: &str,
    scene: &Scene,
    lit: &Lit,
    texels: &[usize],
    tolerance: f64,
    truth: impl Fn(DVec3) -> f64,
) {
    assert!(texels.len() >= 30, "{name}: only {} texels to judge by", texels.len());
    let (s, worst, place) = score_closed_form(scene, lit, texels, truth);
    println!(
        "{name}: {} texels, mean E {:.5}, RMSE {:.4} %, bias {:+.4} %, largest {:.4} % at {place:.3}",
        s.samples,
        s.mean,
        100.0 * s.rmse,
        100.0 * s.bias,
        100.0 * worst
    );
    assert!(worst <= tolerance, "{name}: {worst} at {place}: {s:?}");
}

/// Mean irradiance over some texels, by area, over the bands [lux].
pub fn mean(lit: &Lit, texels: &[usize]) -> f64 {
    let areas = areas(lit, texels);
    let y = |i: usize| f64::from(value(lit, i).element_sum()) / 3.0;
    texels.iter().zip(&areas).map(|(&i, a)| a * y(i)).sum::<f64>() / areas.iter().sum::<f64>()
}
