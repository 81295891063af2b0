//! Real, odd and malformed scenes through the real binary: each is baked, with outputs that hold what they promise, or
//! refused by name.

mod tool;

use std::path::Path;

use glam::Vec2;
use luxel_export::OutputSet;
use luxel_scene::import;
use serde_json::Value;
use tool::*;

/// Sides of the page for scenes whose meshes have more charts than a page of 128² has room for.
const SIZES: [(&str, u64); 4] = [("house/", 512), ("level/", 1024), ("sponza/", 256), ("sponza_encodings/", 256)];

fn expected(root: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(root.join("expected.json")).unwrap()).unwrap()
}

/// What the outputs of a scene are called in a folder.
fn stem(source: &Path, folder: &Path) -> String {
    OutputSet::new(source, Some(folder), None).unwrap().stem().to_owned()
}

/// Everything that a finished bake promises, for a scene that was read from `source`.
fn check_outputs(source: &Path, folder: &Path, size: u64) {
    let name = source.display();
    let stem = stem(source, folder);
    let out = Outputs::read(folder, &stem);
    let before = import::load(source, &import_all()).unwrap();
    assert_eq!(out.scene.triangle_count(), before.triangle_count(), "{name}: triangles");
    assert_eq!(out.scene.lights.len(), before.lights.len(), "{name}: lights");
    assert_eq!(out.scene.cameras.len(), before.cameras.len(), "{name}: cameras");
    assert!(out.lightmaps.iter().all(|m| u64::from(m.width()) == size && u64::from(m.height()) == size), "{name}");
    let baked = import::load(source, &luxel_scene::ImportOptions::default()).unwrap();
    let moves = baked.triangle_count() != before.triangle_count();
    for (i, instance) in out.scene.instances.iter().enumerate().filter(|(_, i)| i.receives && !moves) {
        let mesh = &out.scene.meshes[instance.mesh];
        let uvs = mesh.uvs.get(1).filter(|uvs| uvs.len() == mesh.positions.len());
        let uvs = uvs.unwrap_or_else(|| panic!("{name}: instance {i} of {} has no TEXCOORD_1", mesh.name));
        let used = mesh.triangles.iter().flatten().map(|&v| uvs[v as usize]);
        let inside = |uv: Vec2| uv.min_element() >= 0.0 && uv.max_element() <= 1.0;
        assert!(used.clone().all(inside), "{name}: {} leaves the atlas", mesh.name);
    }
    // The gltf crate knows fewer extensions than luxel: what it refuses before is no matter after.
    let bytes = std::fs::read(folder.join(format!("{stem}.glb"))).unwrap();
    if gltf::Gltf::from_slice(&std::fs::read(source).unwrap()).is_ok() {
        gltf::Gltf::from_slice(&bytes).unwrap_or_else(|e| panic!("{name}: the gltf crate refuses the output: {e}"));
    }
}

/// Bakes every file whose name `wanted` accepts.
fn bake_all(wanted: impl Fn(&str) -> bool) -> Vec<(String, Result<(), String>)> {
    let Some(root) = scenes() else { return Vec::new() };
    let mut results = Vec::new();
    for file in scene_files(&root).into_iter().filter(|f| wanted(f)) {
        let out = tempfile::tempdir().unwrap();
        let (source, folder) = (root.join(&file), out.path().join("out"));
        let size = SIZES.iter().find(|(scene, _)| file.starts_with(scene)).map_or(128, |(_, size)| *size);
        let run = luxel(
            &[
                "bake",
                source.to_str().unwrap(),
                "--preset",
                "draft",
                "--size",
                &size.to_string(),
                "--out",
                folder.to_str().unwrap(),
            ],
            &root,
        );
        let result = match run.code {
            Some(0) => {
                check_outputs(&source, &folder, size);
                Ok(())
            }
            _ => {
                let run = run.ended(1);
                assert!(run.stderr.contains("error: ") && run.stderr.contains(&file), "{file}: {}", run.stderr);
                assert!(!folder.exists() || files(&folder).is_empty(), "{file}: a refused scene leaves files");
                Err(run.stderr)
            }
        };
        results.push((file, result));
    }
    results
}

#[test]
fn every_good_scene_is_baked_and_draco_is_refused_by_name() {
    let Some(root) = scenes() else { return };
    let known = expected(&root);
    let results = bake_all(|file| !file.starts_with("malformed/"));
    for (file, result) in &results {
        let draco = known[file]["extensions_used"].to_string().contains("KHR_draco_mesh_compression");
        match result {
            Ok(()) => assert!(!draco, "{file} holds nothing but Draco data"),
            Err(why) => assert!(draco && why.contains("KHR_draco_mesh_compression"), "{file}: {why}"),
        }
    }
    let baked = results.iter().filter(|(_, r)| r.is_ok()).count();
    println!("{baked} of {} scenes baked", results.len());
    assert!(baked > 60);
}

/// Broken on purpose, by their names, in a part of the file that a bake does not read.
const HARMLESS: [&str; 3] = ["image-invalid-ktx.gltf", "invalid-uri.gltf", "light-invalid.gltf"];

#[test]
fn malformed_scenes_are_baked_or_refused_with_the_fault() {
    let results = bake_all(|file| file.starts_with("malformed/"));
    if results.is_empty() {
        return;
    }
    for (file, result) in &results {
        let name = Path::new(file).file_name().unwrap().to_str().unwrap();
        let broken = ["invalid", "oob", "cycle", "notfound", "out-of-bounds"].iter().any(|w| name.contains(w));
        match result {
            Ok(()) => assert!(!broken || HARMLESS.contains(&name), "{file} is broken and yet baked"),
            Err(why) => {
                // The path, the place in the file, the fault; and what to do.
                let said = why.split_once(file.as_str()).map_or("", |(_, rest)| rest.trim_start_matches([':', ' ']));
                assert!(said.len() > 20 && said.contains(':'), "{file}: {why}");
            }
        }
    }
    let refused = results.iter().filter(|(_, r)| r.is_err()).count();
    println!("{refused} of {} malformed scenes refused", results.len());
    assert!(refused > 50 && refused < results.len());
}

/// Bakes a scene into a folder of its own.
fn bake(source: &Path, flags: &[&str]) -> (tempfile::TempDir, Outputs) {
    let out = tempfile::tempdir().unwrap();
    let args = [&["bake", source.to_str().unwrap(), "--out", out.path().to_str().unwrap()], flags].concat();
    luxel(&args, source.parent().unwrap()).ended(0);
    let outputs = Outputs::read(out.path(), &stem(source, out.path()));
    (out, outputs)
}

#[test]
fn encodings_of_sponza_give_the_same_light() {
    let Some(root) = scenes() else { return };
    // A budget of surfels is met by another size of voxels where the count differs by a hair.
    let flags = ["--preset", "draft", "--size", "256", "--sky", "1,1,1", "--voxels", "side:96"];
    let plain = bake(&root.join("sponza/sponza_dabrovic.glb"), &flags).1;
    // Thousands of charts: texels enough that there is something to compare.
    let texels = plain.report["counters"]["texels"].as_u64().unwrap();
    let used = plain.report["quality"]["atlas_utilisation"].as_f64().unwrap();
    assert!(texels > 25_000 && used > 0.1, "{texels} texels cover {used} of the pages");
    for encoding in ["quantized", "meshopt"] {
        let other = bake(&root.join(format!("sponza_encodings/sponza_{encoding}.glb")), &flags).1;
        assert!(other.scene.triangle_count() > 66_000, "{encoding}");
        let d = difference(&plain, &other, 1.0, 20_000);
        println!("{encoding}: {d:?}");
        assert!(d.bias.abs() < 0.005 && d.rmse < 0.03 && d.median < 0.015, "{encoding}: {d:?}");
    }
}

#[test]
fn the_size_of_a_scene_is_no_matter() {
    let Some(root) = scenes() else { return };
    let flags = ["--preset", "draft", "--size", "128"];
    let plain = bake(&root.join("cornell/CornellBox.glb"), &flags).1;
    for (name, scale) in [("1e-4", 1e-4), ("1e4", 1e4)] {
        let other = bake(&root.join(format!("cornell_scaled/CornellBox_scale_{name}.glb")), &flags).1;
        let d = difference(&plain, &other, scale, 5_000);
        println!("{name}: {d:?}");
        assert!(d.rmse < 0.001, "{name}: {d:?}");
    }
}

#[test]
fn authored_lightmap_uvs_are_kept_or_the_reason_is_told() {
    let Some(root) = scenes() else { return };
    let flags = ["--preset", "draft", "--size", "512", "--only", "direct"];
    // The house's own chart of its roof lies over one of its floor's: two places cannot share a texel.
    let house = bake(&root.join("house/house_uv1.glb"), &flags).1;
    let told = house.warnings("unwrapped-anew");
    assert!(told.len() == 2 && told.iter().all(|w| w.contains("TEXCOORD_1") && w.contains("overlap")), "{told:?}");

    for file in ["room/Room.glb", "cornell/CornellBox.glb"] {
        let baked = bake(&root.join(file), &flags).1;
        assert!(baked.warnings("unwrapped-anew").is_empty(), "{file}");
        let before = import::load(&root.join(file), &import_all()).unwrap();
        for (old, new) in before.instances.iter().zip(&baked.scene.instances) {
            let (old, new) = (&before.meshes[old.mesh], &baked.scene.meshes[new.mesh]);
            assert_eq!(old.triangles.len(), new.triangles.len(), "{file}");
            let corners = |mesh: &luxel_scene::Mesh| {
                let uvs = mesh.uvs[1].clone();
                mesh.triangles.iter().map(|t| t.map(|i| uvs[i as usize])).collect::<Vec<_>>()
            };
            assert_same_charts(&corners(old), &corners(new), &format!("{file}: {}", old.name));
        }
    }
}

/// The second layout is the first one moved chart by chart: triangles that share an edge still do, and all have
/// grown by the same factor.
fn assert_same_charts(old: &[[Vec2; 3]], new: &[[Vec2; 3]], what: &str) {
    let area = |[a, b, c]: [Vec2; 3]| 0.5 * f64::from((b - a).perp_dot(c - a));
    let total = |list: &[[Vec2; 3]]| list.iter().map(|t| area(*t).abs()).sum::<f64>();
    let factor = total(new) / total(old);
    let edges = |[a, b, c]: [Vec2; 3]| [(a, b), (b, c), (c, a)];
    for (i, (x, y)) in old.iter().zip(new).enumerate() {
        let (before, after) = (area(*x) * factor, area(*y));
        assert!((after - before).abs() < 0.05 * before.abs() + 1e-6, "{what}: triangle {i}: {before} is now {after}");
        for (j, (x2, y2)) in old.iter().zip(new).enumerate().skip(i + 1) {
            for (k, (p, q)) in edges(*x).into_iter().enumerate() {
                let Some(l) = edges(*x2).into_iter().position(|e| e == (q, p)) else { continue };
                let ((p, q), (r, s)) = (edges(*y)[k], edges(*y2)[l]);
                let apart = (p - s).length().max((q - r).length());
                assert!(apart < 1e-4, "{what}: triangles {i} and {j} are torn apart by {apart}");
            }
        }
    }
}
