//! Finished images: dilation, validity, stitched seams.

use glam::{DAffine3, DVec3, Vec2, Vec3};
use luxel_atlas::{Atlas, AtlasSettings, FinishError, FinishSettings, Image, InProcess, build, finish};
use luxel_scene::build::Builder;
use luxel_scene::{Mesh, Scene, Silent};

fn atlas(scene: &Scene, size: u32) -> Atlas {
    let settings = AtlasSettings { size, ..AtlasSettings::default() };
    build(scene, &settings, &InProcess, &Silent).expect("an atlas").0
}

fn sphere(rings: u32) -> Scene {
    let mut b = Builder::new("sphere");
    b.sphere("sphere", Vec3::ZERO, 1.0, rings, 0, false);
    let scene = b.scene_mut();
    scene.meshes[0].normals = scene.meshes[0].positions.clone();
    b.build()
}

/// A cylinder's side, open at both ends.
fn cylinder(around: u32) -> Scene {
    let mut mesh = Mesh { name: "cylinder".into(), ..Mesh::default() };
    for i in 0..around {
        let a = std::f64::consts::TAU * f64::from(i) / f64::from(around);
        let n = DVec3::new(libm::cos(a), 0.0, libm::sin(a)).as_vec3();
        mesh.positions.extend([n, n + 2.0 * Vec3::Y]);
        mesh.normals.extend([n, n]);
        let (k, l) = (2 * i, 2 * ((i + 1) % around));
        mesh.triangles.extend([[k, k + 1, l], [l, k + 1, l + 1]]);
    }
    let mut b = Builder::new("cylinder");
    b.add(mesh);
    b.build()
}

/// World points of all texels.
fn points(scene: &Scene, atlas: &Atlas) -> Vec<Vec3> {
    let at = |t: &luxel_atlas::Texel| {
        let [a, b, c] = scene.corners(scene.instances[atlas.chart(t).instance as usize].mesh, t.triangle as usize);
        let [u, v] = t.barycentric();
        a + u * (b - a) + v * (c - a)
    };
    atlas.texels.iter().map(at).collect()
}

fn smooth_light(p: Vec3) -> Vec3 {
    Vec3::new(2.0 + p.x + 0.5 * p.y, 2.5 + p.y * p.z, 1.5 + 0.7 * p.z)
}

fn read(image: &Image, uv: Vec2) -> Vec3 {
    let p = uv * Vec2::new(image.width as f32, image.height as f32) - 0.5;
    let (base, f) = (p.floor(), p - p.floor());
    let fetch = |dx: f32, dy: f32| {
        let x = (base.x + dx).clamp(0.0, image.width as f32 - 1.0) as usize;
        let y = (base.y + dy).clamp(0.0, image.height as f32 - 1.0) as usize;
        image.values[y * image.width as usize + x]
    };
    fetch(0.0, 0.0).lerp(fetch(1.0, 0.0), f.x).lerp(fetch(0.0, 1.0).lerp(fetch(1.0, 1.0), f.x), f.y)
}

fn run(scene: &Scene, atlas: &Atlas, values: &[Vec3], stitch: bool) -> (Vec<Image>, luxel_atlas::FinishReport) {
    let settings = FinishSettings { stitch, ..FinishSettings::default() };
    finish(scene, atlas, |i| Some(values[i]), &settings, &Silent).expect("images")
}

/// A value with noise that differs between charts: what stitching is there to hide.
fn disturbed(atlas: &Atlas, points: &[Vec3]) -> Vec<Vec3> {
    let shift = |chart: u32| 1.0 + 0.1 * (chart % 5) as f32;
    atlas.texels.iter().zip(points).map(|(t, p)| smooth_light(*p) * shift(t.chart)).collect()
}

#[test]
fn stitching_closes_the_seams_of_curved_surfaces() {
    for scene in [sphere(16), cylinder(24)] {
        let atlas = atlas(&scene, 128);
        let points = points(&scene, &atlas);
        for values in [disturbed(&atlas, &points), points.iter().map(|p| smooth_light(*p)).collect()] {
            let (plain, _) = run(&scene, &atlas, &values, false);
            let (stitched, report) = run(&scene, &atlas, &values, true);
            assert!(report.seam_samples > 50, "{report:?}");
            assert!(report.jump_after < 0.2 * report.jump_before, "{}: {report:?}", scene.name);
            // What both sides of a vertex read agrees with the report's own measure.
            let spread = |images: &[Image]| {
                let placed = atlas.placed[0].as_ref().unwrap();
                let mut sum = 0.0;
                let mut first: std::collections::BTreeMap<[u32; 3], Vec3> = std::collections::BTreeMap::new();
                for (uv, source) in placed.uvs.iter().zip(&placed.source) {
                    let key = scene.meshes[0].positions[*source as usize].to_array().map(f32::to_bits);
                    let value = read(&images[0], *uv);
                    sum += (*first.entry(key).or_insert(value) - value).length_squared();
                }
                sum
            };
            assert!(spread(&stitched) < 0.2 * spread(&plain), "{} {}", spread(&stitched), spread(&plain));
        }
    }
}

#[test]
fn stitching_changes_little_inside_and_never_leaves_the_range() {
    let scene = sphere(16);
    let atlas = atlas(&scene, 128);
    let values: Vec<Vec3> = points(&scene, &atlas).iter().map(|p| smooth_light(*p)).collect();
    let (images, _) = run(&scene, &atlas, &values, true);
    let mut sum = 0.0;
    for (t, value) in atlas.texels.iter().zip(&values) {
        let at = usize::from(t.y) * images[0].width as usize + usize::from(t.x);
        sum += f64::from((images[0].values[at] - *value).length_squared());
        assert_eq!(images[0].coverage[at], t.coverage());
    }
    let mean: f64 = values.iter().map(|v| f64::from(v.length_squared())).sum();
    assert!((sum / mean).sqrt() < 0.02, "{}", (sum / mean).sqrt());
    let (lo, hi) = values.iter().fold((Vec3::INFINITY, Vec3::ZERO), |(l, h), v| (l.min(*v), h.max(*v)));
    assert_eq!(images[0].coverage.iter().filter(|c| **c > 0.0).count(), atlas.texels.len());
    for &v in images[0].values.iter().filter(|v| **v != Vec3::ZERO) {
        assert!(v.cmpge(lo).all() && v.cmple(hi).all(), "{v}");
    }
}

#[test]
fn constants_stay_constant_to_the_last_bit() {
    let scene = sphere(12);
    let atlas = atlas(&scene, 96);
    let value = Vec3::new(0.1, 1.0 / 3.0, 12345.678);
    let (images, report) = run(&scene, &atlas, &vec![value; atlas.texels.len()], true);
    assert!(report.seam_samples > 0 && report.jump_after < 1e-9 * 12345.0);
    for pixel in &images[0].values {
        assert!(*pixel == Vec3::ZERO || *pixel == value, "{pixel}");
    }
}

#[test]
fn hard_edges_are_left_alone() {
    let mut b = Builder::new("box");
    b.cuboid("box", Vec3::ZERO, Vec3::ONE, 0, false);
    let scene = b.build();
    let atlas = atlas(&scene, 64);
    let values: Vec<Vec3> = atlas.texels.iter().map(|t| Vec3::splat(t.chart as f32)).collect();
    let (images, report) = run(&scene, &atlas, &values, true);
    assert_eq!(report.seam_samples, 0);
    // The padding of each face has the face's value, two texels deep, and nothing else is lit.
    for chart in 1..6 {
        let c = &atlas.charts[chart];
        let lit = images[0].values.iter().filter(|p| p.x == chart as f32).count() as u32;
        assert_eq!(lit, (c.width + 4) * (c.height + 4));
    }
}

#[test]
fn buried_texels_take_their_own_chart_s_light() {
    let mut b = Builder::new("two");
    b.quad("wall", Vec3::ZERO, Vec3::X, Vec3::Y, 0);
    b.place(0, DAffine3::from_translation(DVec3::Z), "buried");
    let scene = b.build();
    let atlas = atlas(&scene, 64);
    let valid: Vec<bool> =
        atlas.texels.iter().map(|t| atlas.chart(t).instance == 0 && u32::from(t.x) % 7 != 0).collect();
    let value = |i: usize| valid[i].then_some(Vec3::splat(3.0));
    let (images, report) = finish(&scene, &atlas, value, &FinishSettings::default(), &Silent).unwrap();
    assert_eq!(report.lost, atlas.charts[1].texels);
    assert_eq!(report.filled, valid.iter().filter(|v| !**v).count() as u32 - report.lost);
    for t in &atlas.texels {
        let pixel = images[0].values[usize::from(t.y) * 64 + usize::from(t.x)];
        assert_eq!(pixel.x, if atlas.chart(t).instance == 0 { 3.0 } else { 0.0 });
    }
}

#[test]
fn values_that_are_no_light_are_refused() {
    let scene = sphere(6);
    let atlas = atlas(&scene, 32);
    let n = atlas.texels.len();
    for bad in [Vec3::NAN, Vec3::INFINITY, Vec3::new(1.0, -1.0, 1.0)] {
        let value = |i: usize| Some(if i == n / 2 { bad } else { Vec3::ONE });
        let refused = finish(&scene, &atlas, value, &FinishSettings::default(), &Silent).expect_err("no images");
        assert_eq!(refused, FinishError::Value { texel: n / 2 });
    }
}
