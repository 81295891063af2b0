//! The atlas of whole scenes: uniqueness, exactness, order, determinism, sizes.

use std::collections::BTreeSet;

use glam::{DAffine3, DVec2, DVec3, Vec3};
use luxel_atlas::unwrap::{Answers, Piece, PieceCharts};
use luxel_atlas::{
    Atlas, AtlasError, AtlasReport, AtlasSettings, InProcess, Layout, UnwrapError, Unwrapper, Unwraps, assemble, build,
};
use luxel_scene::build::Builder;
use luxel_scene::{Mesh, Progress, Scene, Silent};
use proptest::prelude::*;

fn baked(scene: &Scene, size: u32) -> (Atlas, AtlasReport) {
    let settings = AtlasSettings { size, ..AtlasSettings::default() };
    let (atlas, report) = build(scene, &settings, &InProcess, &Silent).expect("an atlas");
    check(scene, &atlas, 2);
    (atlas, report)
}

/// Everything that holds for every atlas of unwrapped instances.
fn check(scene: &Scene, atlas: &Atlas, padding: i64) {
    let mut owner = std::collections::HashMap::new();
    let mut next = 0;
    for (number, chart) in atlas.charts.iter().enumerate() {
        assert_eq!(chart.first_texel, next, "runs follow each other");
        next += chart.texels;
        let page = atlas.pages[chart.page as usize];
        assert!(chart.x >= padding as u32 && chart.x + chart.width + padding as u32 <= page.width);
        assert!(chart.y >= padding as u32 && chart.y + chart.height + padding as u32 <= page.height);
        let run = &atlas.texels[chart.first_texel as usize..next as usize];
        assert!(run.windows(2).all(|w| (w[0].y, w[0].x) < (w[1].y, w[1].x)), "row by row");
        for t in run {
            assert_eq!(t.chart as usize, number);
            assert!((chart.x..chart.x + chart.width).contains(&t.x.into()));
            assert!((chart.y..chart.y + chart.height).contains(&t.y.into()));
            assert!(t.coverage() > 0.0 && t.coverage() <= 1.0 && t.footprint() > 0.0 && t.footprint().is_finite());
            let [u, v] = t.barycentric();
            assert!(u >= 0.0 && v >= 0.0 && u + v <= 1.0);
            assert!(owner.insert((chart.page, t.x, t.y), t.chart).is_none(), "a texel is taken twice");
        }
    }
    assert_eq!(next as usize, atlas.texels.len());
    // The padding of every texel belongs to its own chart alone.
    for (&(page, x, y), &chart) in &owner {
        let reach = 2 * padding;
        for (dx, dy) in [(reach, 0), (0, reach), (reach, reach), (-reach, reach), (1, 1), (-1, 1)] {
            let at = (page, (i64::from(x) + dx) as u16, (i64::from(y) + dy) as u16);
            let near = owner.get(&at).copied().unwrap_or(chart);
            // Primitives of one authored layout share their block.
            let block = |c: u32| (atlas.charts[c as usize].x, atlas.charts[c as usize].y);
            assert!(block(near) == block(chart), "padding of two charts overlaps");
        }
    }
    for t in &atlas.texels {
        let placed = atlas.placed[atlas.chart(t).instance as usize].as_ref().expect("a receiver is placed");
        let mesh = &scene.meshes[scene.instances[atlas.chart(t).instance as usize].mesh];
        let corners = placed.triangles[t.triangle as usize];
        assert_eq!(corners.map(|c| placed.source[c as usize]), mesh.triangles[t.triangle as usize]);
        // The stored point, taken through the UVs, lies in the texel's square (and at its centre if it is whole).
        let side = f64::from(atlas.pages[atlas.chart(t).page as usize].width);
        let [a, b, c] = corners.map(|c| placed.uvs[c as usize].as_dvec2() * side);
        let [u, v] = t.barycentric().map(f64::from);
        let at = a + u * (b - a) + v * (c - a);
        let off = (at - DVec2::new(f64::from(t.x) + 0.5, f64::from(t.y) + 0.5)).abs().max_element();
        let limit = if t.coverage() >= 1.0 { 2e-3 } else { 0.502 };
        assert!(off <= limit, "{off} at {t:?}");
    }
    every_triangle_is_lit(scene, atlas, &owner);
}

/// Every triangle with area on the page lies over texels of its own chart.
fn every_triangle_is_lit(scene: &Scene, atlas: &Atlas, owner: &std::collections::HashMap<(u32, u16, u16), u32>) {
    for (i, placed) in atlas.placed.iter().enumerate() {
        let Some(placed) = placed else { continue };
        // Where no triangle has any area there is no page.
        let side = atlas.pages.get(placed.page as usize).map_or(0.0, |page| f64::from(page.width));
        for (number, t) in placed.triangles.iter().enumerate() {
            let [p, q, r] = scene.corners(scene.instances[i].mesh, number).map(|p| p.as_dvec3());
            let world = (q - p).cross(r - p).length();
            let [a, b, c] = t.map(|c| placed.uvs[c as usize].as_dvec2() * side);
            if (b - a).perp_dot(c - a).abs() < 1e-3 || !world.is_finite() || world <= 0.0 {
                continue;
            }
            let middle = (a + b + c) / 3.0;
            let chart = owner.get(&(placed.page, middle.x as u16, middle.y as u16));
            let chart = chart.unwrap_or_else(|| panic!("no texel under a triangle of instance {i} at {middle}"));
            assert_eq!(atlas.charts[*chart as usize].instance as usize, i);
        }
    }
}

fn cornell() -> Scene {
    let mut b = Builder::new("box");
    let m = b.matte(Vec3::splat(0.7));
    b.cuboid("room", Vec3::ZERO, Vec3::ONE, m, true);
    b.cuboid("block", Vec3::new(0.2, 0.0, 0.2), Vec3::new(0.5, 0.6, 0.5), m, false);
    b.cuboid("low", Vec3::new(0.6, 0.0, 0.5), Vec3::new(0.9, 0.3, 0.8), m, false);
    b.build()
}

fn torus(around: u32, across: u32, smooth: bool) -> Mesh {
    let mut mesh = Mesh { name: "torus".into(), ..Mesh::default() };
    for i in 0..around {
        for j in 0..across {
            let a = std::f64::consts::TAU * f64::from(i) / f64::from(around);
            let b = std::f64::consts::TAU * f64::from(j) / f64::from(across);
            let out = DVec3::new(libm::cos(a), 0.0, libm::sin(a));
            let n = out * libm::cos(b) + DVec3::Y * libm::sin(b);
            mesh.positions.push((out + 0.35 * n).as_vec3());
            if smooth {
                mesh.normals.push(n.as_vec3());
            }
        }
    }
    for i in 0..around {
        for j in 0..across {
            let at = |i: u32, j: u32| i % around * across + j % across;
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.triangles.extend([[a, c, b], [a, d, c]]);
        }
    }
    mesh
}

#[test]
fn a_room_has_whole_rectangles_of_whole_texels() {
    let (atlas, report) = baked(&cornell(), 256);
    assert_eq!(report.charts, 18);
    assert_eq!(report.pages, 1);
    assert!(report.fallbacks.is_empty());
    for chart in &atlas.charts {
        assert_eq!(chart.texels, chart.width * chart.height, "no partial texel");
    }
    assert!(atlas.texels.iter().all(|t| t.coverage() == 1.0));
    assert!(report.utilisation > 0.7, "{report:?}");
}

#[test]
fn texels_measure_the_world() {
    let scene = cornell();
    let (atlas, _) = baked(&scene, 256);
    let area: f64 = atlas.texels.iter().map(|t| f64::from(t.coverage()) * f64::from(t.footprint()).powi(2)).sum();
    let exact = 6.0 + 2.0 * (0.09 + 2.0 * 0.18) + 2.0 * (0.09 + 2.0 * 0.09);
    assert!((area / exact - 1.0).abs() < 1e-4, "{area} {exact}");
}

#[test]
fn curved_meshes_unwrap_into_few_charts() {
    let mut b = Builder::new("curved");
    let m = b.matte(Vec3::ONE);
    b.sphere("sphere", Vec3::ZERO, 1.0, 24, m, false);
    b.add(torus(48, 24, true));
    let (_, report) = baked(&b.build(), 512);
    assert!(report.charts < 100, "{report:?}");
    assert!(report.fallbacks.is_empty(), "{report:?}");
    assert!(report.utilisation > 0.5, "{report:?}");
}

#[test]
fn instances_share_the_unwrap_and_nothing_else() {
    let mut b = Builder::new("instances");
    let m = b.matte(Vec3::ONE);
    b.cuboid("box", Vec3::ZERO, Vec3::ONE, m, false);
    let stretched = DAffine3::from_scale(DVec3::new(5.0, 1.0, -0.5));
    b.place(0, DAffine3::from_translation(DVec3::X * 20.0) * stretched, "stretched");
    let flat = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
    b.place(0, flat, "flat");
    b.scene_mut().instances[0].texel_scale = 2.0;
    let (atlas, report) = baked(&b.build(), 512);
    let near = |w: f64, h: f64, chart: &luxel_atlas::Chart| {
        let (a, b) = (f64::from(chart.width.max(chart.height)), f64::from(chart.width.min(chart.height)));
        (a - w * report.density).abs() <= 0.51 && (b - h * report.density).abs() <= 0.51
    };
    for chart in atlas.charts.iter().filter(|c| c.instance == 0) {
        assert!(near(2.0, 2.0, chart), "{chart:?} {report:?}");
    }
    let sizes = [(5.0, 1.0), (5.0, 0.5), (1.0, 0.5)];
    for chart in atlas.charts.iter().filter(|c| c.instance == 1) {
        assert!(sizes.iter().any(|&(w, h)| near(w, h, chart)), "{chart:?} {report:?}");
    }
    // Of the flattened box only top and bottom are left.
    assert_eq!(atlas.charts.iter().filter(|c| c.instance == 2 && c.texels > 0).count(), 2);
    let seeds: BTreeSet<u64> =
        atlas.texels.iter().map(|t| atlas.charts[t.chart as usize].texel_seed(t.x, t.y)).collect();
    assert_eq!(seeds.len(), atlas.texels.len());
}

#[test]
fn the_same_bytes_whatever_the_thread_count() {
    let mut b = Builder::new("threads");
    let m = b.matte(Vec3::ONE);
    for i in 0..6 {
        b.sphere("sphere", Vec3::X * i as f32 * 3.0, 1.0, 6 + i, m, false);
    }
    b.add(torus(24, 12, false));
    let scene = b.build();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (atlas, report) = pool.install(|| baked(&scene, 256));
        format!("{atlas:?}{report:?}")
    };
    let one = run(1);
    assert!(one == run(2) && one == run(7));
}

#[test]
fn scale_changes_the_density_and_nothing_else() {
    let scene = cornell();
    let (atlas, report) = baked(&scene, 128);
    for scale in [1e-4, 1e4] {
        let scaled = luxel_scene::build::transformed(cornell(), DAffine3::from_scale(DVec3::splat(scale)));
        let (other, scaled_report) = baked(&scaled, 128);
        let rectangles = |a: &Atlas| a.charts.iter().map(|c| (c.x, c.y, c.width, c.height)).collect::<Vec<_>>();
        assert_eq!(rectangles(&atlas), rectangles(&other));
        assert!((scaled_report.density * scale / report.density - 1.0).abs() < 1e-9);
    }
}

#[test]
fn a_wanted_density_adds_pages_and_keeps_instances_together() {
    let settings = AtlasSettings { size: 64, texel_density: Some(40.0), ..AtlasSettings::default() };
    let mut b = Builder::new("pages");
    let m = b.matte(Vec3::ONE);
    for i in 0..9 {
        b.quad("quad", Vec3::X * i as f32, Vec3::X, Vec3::Y, m);
    }
    b.cuboid("cube", Vec3::ZERO, Vec3::ONE, m, false);
    let scene = b.build();
    let (atlas, report) = build(&scene, &settings, &InProcess, &Silent).unwrap();
    check(&scene, &atlas, 2);
    assert_eq!(atlas.pages.len(), 10);
    for chart in atlas.charts.iter().filter(|c| c.instance < 9) {
        assert_eq!((chart.width, chart.height), (40, 40));
    }
    // Six faces of forty texels do not fit on one page; the report says that they had to shrink.
    assert_eq!(report.lowered.len(), 1);
    assert_eq!(report.lowered[0].0, "cube");
    let few = AtlasSettings { max_pages: 3, ..settings };
    assert!(build(&scene, &few, &InProcess, &Silent).is_err());
}

/// Loose quads with sides from one to two units, in no order of size.
fn quads(n: u32) -> Scene {
    let mut b = Builder::new("many");
    let m = b.matte(Vec3::ONE);
    for i in 0..n {
        let side = |prime: u32| 1.0 + (i * prime % n) as f32 / n as f32;
        b.quad("quad", Vec3::X * 3.0 * i as f32, Vec3::X * side(7), Vec3::Y * side(11), m);
    }
    b.build()
}

#[test]
fn many_small_charts_open_further_pages() {
    let (atlas, report) = baked(&quads(300), 64);
    // A page of 64 × 64 holds 12 × 12 charts of one texel with their padding.
    assert_eq!(atlas.pages.len(), 3);
    // One page of as many texels, for comparison.
    let (_, one) = baked(&quads(300), 111);
    assert_eq!(one.pages, 1);
    assert!(report.density > 0.9 * one.density && report.utilisation > 0.8 * one.utilisation, "{report:?} {one:?}");
    assert!(report.lowered.is_empty() && report.density == report.wanted, "{report:?}");
}

#[test]
fn more_texels_are_more_density_whatever_the_number_of_pages() {
    let scene = quads(300);
    let area: f64 = scene
        .meshes
        .iter()
        .map(|m| {
            f64::from((m.positions[1] - m.positions[0]).length())
                * f64::from((m.positions[3] - m.positions[0]).length())
        })
        .sum();
    let mut known: Vec<(u32, u32, f64)> = Vec::new();
    for size in (48..=168).step_by(8) {
        let settings = AtlasSettings { size, ..AtlasSettings::default() };
        let (_, report) = build(&scene, &settings, &InProcess, &Silent).unwrap();
        let texels = report.pages * size * size;
        let bare = (f64::from(texels) / area).sqrt();
        assert!(report.density >= 0.25 * bare && report.density <= bare, "{size}: {report:?}");
        known.push((texels, size, report.density));
    }
    assert!(known[0].0 > 3 * 48 * 48 && known.last().unwrap().0 == 168 * 168, "several pages and one: {known:?}");
    for &(more, size, density) in &known {
        // Along an edge of the page up to one chart's breadth stays empty.
        let breadth = 1.5 * density + 4.0;
        for &(fewer, other, lower) in known.iter().filter(|k| k.0 <= more) {
            let least = lower * (1.0 - breadth / f64::from(size));
            assert!(density >= least, "{more} texels, side {size}: {density}; {fewer}, side {other}: {lower}");
        }
    }
}

#[test]
fn a_floor_of_texels_decides_between_one_page_and_two() {
    // Eighteen charts with their padding fit at one texel each from 25 × 25 on.
    for (size, pages) in [(64, 1), (28, 1), (24, 2)] {
        let (atlas, report) = baked(&cornell(), size);
        assert_eq!(report.pages, pages, "{size}");
        let texels = f64::from(report.pages * size * size);
        assert!(atlas.texels.len() as f64 > 0.08 * texels, "{size}: {} of {texels}", atlas.texels.len());
    }
}

#[test]
fn charts_that_fit_nowhere_are_told_apart() {
    let fault = |scene: &Scene, size: u32, max_pages: u32| {
        let settings = AtlasSettings { size, max_pages, ..AtlasSettings::default() };
        build(scene, &settings, &InProcess, &Silent).map(|_| ()).unwrap_err()
    };
    // A page of 16 × 16 has room for three charts abreast, the pages together for fewer than there are.
    assert_eq!(fault(&quads(30), 16, 3), AtlasError::TooManyPages { limit: 3 });
    let mut triangles = Mesh { name: "triangles".into(), ..Mesh::default() };
    for i in 0..10 {
        let at = Vec3::X * 3.0 * i as f32;
        triangles.positions.extend([at, at + Vec3::X, at + Vec3::Y]);
        triangles.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    let named = AtlasError::TooManyCharts { instance: "triangles".into(), charts: 10, size: 16 };
    let mut b = Builder::new("one");
    b.add(triangles.clone());
    assert_eq!(fault(&b.build(), 16, 64), named);
    let mut b = Builder::new("one of several");
    let m = b.matte(Vec3::ONE);
    b.quad("quad", Vec3::ZERO, Vec3::X, Vec3::Y, m);
    b.add(triangles);
    assert_eq!(fault(&b.build(), 16, 64), named);
}

#[test]
fn an_unreachable_density_is_lowered_to_what_fills_a_page() {
    let wanted = |size: u32, density: f32| {
        let settings = AtlasSettings { size, texel_density: Some(density), ..AtlasSettings::default() };
        build(&cornell(), &settings, &InProcess, &Silent).unwrap().1
    };
    let most = wanted(128, 1e30);
    // An object on each page.
    assert_eq!((most.pages, most.lowered.len()), (3, 3));
    // The room is six equal squares: three abreast are 38 texels wide each, and a third of the page stays free.
    assert!(most.utilisation > 0.5, "{most:?}");
    assert_eq!((most.wanted, most.enough), (f64::from(1e30_f32), None));
    let densities = || most.lowered.iter().map(|(_, density)| *density);
    let (least, greatest) = (densities().fold(f64::INFINITY, f64::min), densities().fold(0.0, f64::max));
    assert!(least > 38.0 && least < most.density && most.density < greatest, "{most:?}");
    let less = wanted(128, 1e5);
    assert_eq!((less.lowered.clone(), less.enough), (most.lowered.clone(), None));

    // The remedy that is told is one.
    for density in [60.0, 100.0, 333.0, 1000.0] {
        let report = wanted(64, density);
        let enough = report.enough.expect("a page that holds the charts");
        assert!(!report.lowered.is_empty() && report.density < density.into(), "{report:?}");
        let larger = wanted(enough, density);
        assert!(larger.lowered.is_empty(), "{density}: {larger:?}");
        assert_eq!(larger.density, f64::from(density));
    }
}

#[test]
fn hostile_meshes_end_well() {
    let mut b = Builder::new("hostile");
    let m = b.matte(Vec3::ONE);
    b.quad("tiny", Vec3::ZERO, Vec3::X * 1e-9, Vec3::Y * 1e-9, m);
    b.mesh("line", vec![Vec3::ZERO, Vec3::X, Vec3::X * 2.0], vec![[0, 1, 2]], m);
    b.mesh("nan", vec![Vec3::NAN, Vec3::X, Vec3::Y, Vec3::Z], vec![[0, 1, 2], [1, 2, 3]], m);
    b.mesh("empty", vec![], vec![], m);
    // Three faces on one edge, one triangle twice, one back to back.
    let p = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, -Vec3::Y];
    b.mesh("fan", p, vec![[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 2], [0, 2, 1]], m);
    let (atlas, report) = baked(&b.build(), 128);
    assert!(atlas.charts.iter().any(|c| c.instance == 0 && c.texels >= 1));
    assert_eq!(atlas.charts.iter().filter(|c| c.instance == 1).count(), 0);
    assert_eq!(atlas.charts.iter().filter(|c| c.instance == 2).count(), 1);
    assert_eq!(atlas.charts.iter().filter(|c| c.instance == 4 && c.texels > 0).count(), 5, "{report:?}");
}

#[test]
fn a_quad_as_large_as_a_galaxy() {
    let mut b = Builder::new("huge");
    b.quad("huge", Vec3::ZERO, Vec3::X * 1e18, Vec3::Y * 1e18, 0);
    let huge = b.build();
    let (atlas, _) = baked(&huge, 64);
    assert_eq!(atlas.charts[0].texels, 60 * 60);
    let mut b = Builder::new("too huge");
    b.quad("too huge", Vec3::ZERO, Vec3::X * 1e38, Vec3::Y * 1e38, 0);
    baked(&b.build(), 64);
}

#[test]
fn ten_thousand_loose_triangles() {
    let mut mesh = Mesh { name: "confetti".into(), ..Mesh::default() };
    let mut state = 1_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 16_777_216.0
    };
    for i in 0..10_000 {
        let o = Vec3::new(random(), random(), random()) * 100.0;
        for _ in 0..3 {
            mesh.positions.push(o + Vec3::new(random(), random(), random()));
        }
        mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    let mut b = Builder::new("confetti");
    b.add(mesh);
    let (_, report) = baked(&b.build(), 1024);
    assert_eq!(report.charts, 10_000);
    assert_eq!(report.pages, 1);
}

#[test]
fn an_authored_layout_is_one_block() {
    let mut b = Builder::new("authored");
    b.matte(Vec3::ONE);
    b.quad("left", Vec3::ZERO, Vec3::X, Vec3::Y, 0);
    b.quad("right", Vec3::X, Vec3::X, Vec3::Y, 0);
    let scene = b.scene_mut();
    for (i, mesh) in scene.meshes.iter_mut().enumerate() {
        let half = glam::Vec2::new(0.5, 1.0);
        let uv: Vec<_> = mesh.uvs[0].iter().map(|p| *p * half + glam::Vec2::X * 0.5 * i as f32).collect();
        mesh.uvs.push(uv);
        (mesh.gltf_mesh, mesh.gltf_primitive) = (7, i);
    }
    scene.instances.iter_mut().for_each(|i| i.node = 3);
    let (atlas, report) = baked(&b.build(), 64);
    assert_eq!(report.kept, ["left"]);
    let [l, r] = &atlas.charts[..] else { panic!("{:?}", atlas.charts) };
    assert_eq!((l.x, l.y, l.width, l.height), (r.x, r.y, r.width, r.height));
    assert_eq!(l.texels + r.texels, l.width * l.height);
    let [a, b] = [0, 1].map(|i| atlas.placed[i].as_ref().unwrap());
    assert_eq!(a.uvs[1], b.uvs[0], "the layout keeps its shape");
}

#[test]
fn a_refused_layout_is_unwrapped_anew_with_the_reason() {
    let mut b = Builder::new("refused");
    b.quad("wall", Vec3::ZERO, Vec3::X, Vec3::Y, 0);
    let uv = b.scene_mut().meshes[0].uvs[0].iter().map(|p| *p * 3.0).collect();
    b.scene_mut().meshes[0].uvs.push(uv);
    let (atlas, report) = baked(&b.build(), 64);
    assert_eq!(atlas.charts.len(), 1);
    assert_eq!(report.unwrapped_anew.len(), 1);
    assert!(report.unwrapped_anew[0].1.contains("outside [0, 1]"), "{report:?}");
}

#[test]
fn what_receives_nothing_takes_no_room() {
    let mut scene = cornell();
    scene.instances.iter_mut().for_each(|i| i.receives = false);
    let (atlas, report) = baked(&scene, 64);
    assert_eq!((atlas.pages.len(), atlas.charts.len(), report.pages), (0, 0, 0));
    assert!(atlas.placed.iter().all(Option::is_none));
}

/// An unwrapper that answers every piece alike.
struct Liar(fn(&Piece) -> Result<PieceCharts, String>);

impl Unwrapper for Liar {
    fn unwrap(&self, pieces: &[Piece]) -> Result<Answers, UnwrapError> {
        Ok(pieces.iter().map(self.0).collect())
    }
}

/// Every triangle of the piece at the same place of one chart.
fn one_chart(piece: &Piece, uv: [[f32; 2]; 3]) -> Result<PieceCharts, String> {
    let n = piece.triangles.len();
    Ok(PieceCharts { chart_of: vec![0; n], uvs: vec![uv; n] })
}

#[test]
fn whatever_the_unwrapper_answers_the_atlas_is_sound() {
    let mut b = Builder::new("sphere");
    b.sphere("sphere", Vec3::ZERO, 1.0, 10, 0, false);
    let scene = b.build();
    let stacked = Liar(|p| one_chart(p, [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]));
    let flat = Liar(|p| one_chart(p, [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]));
    let broken = Liar(|p| one_chart(p, [[f32::NAN, 0.0], [f32::INFINITY, 0.0], [0.0, 1.0]]));
    let flattened = Liar(|p| {
        // The sphere seen from the side: its back folds over its front.
        let at = |i: u32| [p.positions[i as usize][0], p.positions[i as usize][1]];
        Ok(PieceCharts { chart_of: vec![0; p.triangles.len()], uvs: p.triangles.iter().map(|t| t.map(at)).collect() })
    });
    let short = Liar(|_| Ok(PieceCharts::default()));
    let silent = Liar(|p| {
        Ok(PieceCharts { chart_of: vec![u32::MAX; p.triangles.len()], uvs: vec![[[0.0; 2]; 3]; p.triangles.len()] })
    });
    let failing = Liar(|_| Err("it died".into()));
    let settings = AtlasSettings { size: 128, ..AtlasSettings::default() };
    for (liar, word) in [
        (stacked, "overlaps"),
        (flat, "no area"),
        (broken, "not finite"),
        (flattened, "folds over"),
        (short, "lost"),
        (silent, "left triangles out"),
        (failing, "it died"),
    ] {
        let (atlas, report) = build(&scene, &settings, &liar, &Silent).expect(word);
        check(&scene, &atlas, 2);
        assert_eq!(report.fallbacks.len(), 1);
        let (name, why, triangles) = &report.fallbacks[0];
        assert!(why.contains(word) && name == "sphere", "{why} {word}");
        assert_eq!(*triangles as usize, scene.meshes[0].triangles.len());
    }
}

#[test]
fn stored_unwraps_are_used_and_foreign_ones_refused() {
    let scene = cornell();
    let settings = AtlasSettings { size: 64, ..AtlasSettings::default() };
    let (fresh, _) = build(&scene, &settings, &InProcess, &Silent).unwrap();
    let layout = Layout::new(&scene);
    let mut unwraps = Unwraps::new();
    let empty = assemble(&scene, &settings, &layout, &unwraps, &Silent);
    assert_eq!(empty.map(|_| ()), Err(AtlasError::MissingUnwrap));
    layout.complete(&scene, &mut unwraps, &InProcess, &Silent).unwrap();
    let config = bincode::config::standard().with_limit::<1_000_000>();
    let bytes = bincode::serde::encode_to_vec(&unwraps, config).unwrap();
    let (mut stored, _): (Unwraps, usize) = bincode::serde::decode_from_slice(&bytes, config).unwrap();
    let (again, _) = assemble(&scene, &settings, &layout, &stored, &Silent).unwrap();
    assert_eq!(format!("{fresh:?}"), format!("{again:?}"));
    stored.values_mut().next().unwrap().triangles[0][0] = 1_000_000;
    let error = assemble(&scene, &settings, &layout, &stored, &Silent).map(|_| ()).unwrap_err();
    assert!(matches!(error, AtlasError::ForeignUnwrap { .. }), "{error}");
}

#[test]
fn a_cancelled_bake_stops() {
    struct Overtaken;
    impl Progress for Overtaken {
        fn begin(&self, _: &'static str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            true
        }
    }
    let error = build(&cornell(), &AtlasSettings::default(), &InProcess, &Overtaken).map(|_| ()).unwrap_err();
    assert!(matches!(error, AtlasError::Cancelled(_)));
}

#[test]
fn settings_out_of_range_are_named() {
    let says = |settings: AtlasSettings, word: &str| {
        let error = build(&cornell(), &settings, &InProcess, &Silent).map(|_| ()).unwrap_err();
        assert!(error.to_string().contains(word), "{error}");
    };
    says(AtlasSettings { size: 4, ..AtlasSettings::default() }, "size of a page");
    says(AtlasSettings { size: 1 << 20, ..AtlasSettings::default() }, "size of a page");
    says(AtlasSettings { padding: 1, ..AtlasSettings::default() }, "padding");
    says(AtlasSettings { texel_density: Some(-1.0), ..AtlasSettings::default() }, "density");
    let mut scene = cornell();
    scene.instances[1].texel_scale = 0.0;
    let error = build(&scene, &AtlasSettings::default(), &InProcess, &Silent).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("block"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_soup_of_triangles_gets_unique_texels(
        points in prop::collection::vec(prop::array::uniform3(-4_i8..4), 4..24),
        picks in prop::collection::vec(prop::array::uniform3(any::<prop::sample::Index>()), 1..60),
        size in 48_u32..200,
    ) {
        let positions: Vec<Vec3> = points.iter().map(|p| Vec3::from(p.map(f32::from))).collect();
        let triangles = picks.iter().map(|t| t.map(|i| i.index(positions.len()) as u32)).collect();
        let mut b = Builder::new("soup");
        b.mesh("soup", positions, triangles, 0);
        b.place(0, DAffine3::from_translation(DVec3::X * 9.0), "twin");
        baked(&b.build(), size);
    }
}
