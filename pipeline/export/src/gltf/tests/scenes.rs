//! Scenes from elsewhere, split at every edge and put back together.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use serde_json::Value;

use super::super::{Original, json::list};
use super::kit::{bake, import, raw, reread, split, triangles};

fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("LUXEL_SCENES")
        .map(PathBuf::from)
        .unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes"));
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: {} is not there (LUXEL_SCENES names the folder of test scenes)", folder.display());
    None
}

fn gltf_files(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            gltf_files(&path, found);
        } else if path.extension().is_some_and(|e| e == "gltf" || e == "glb") {
            found.push(path);
        }
    }
}

fn has_draco(original: &Original) -> bool {
    Value::Object(original.root.clone()).to_string().contains("KHR_draco_mesh_compression")
}

/// Everything that is no mesh, material, buffer or lightmap is as it was.
fn same_elsewhere(original: &Original, out: &Original) {
    for (key, old) in &original.root {
        let new = out.root.get(key);
        match key.as_str() {
            "meshes" | "materials" | "accessors" | "bufferViews" | "buffers" | "extensionsUsed"
            | "extensionsRequired" => {}
            "nodes" => {
                for (old, new) in old.as_array().unwrap().iter().zip(new.unwrap().as_array().unwrap()) {
                    if old["extensions"].get("EXT_mesh_gpu_instancing").is_none() {
                        let (mut old, mut new) = (old.clone(), new.clone());
                        old.as_object_mut().unwrap().shift_remove("mesh");
                        new.as_object_mut().unwrap().shift_remove("mesh");
                        assert_eq!(old, new);
                    }
                }
            }
            "textures" | "images" | "samplers" => {
                // Views may have other numbers, all else is the same, and new ones come last.
                for (old, new) in old.as_array().unwrap().iter().zip(new.unwrap().as_array().unwrap()) {
                    assert_eq!(old, new);
                }
            }
            _ => assert_eq!(Some(old), new, "{key}"),
        }
    }
    for animation in list(&original.root, "animations") {
        for sampler in animation["samplers"].as_array().unwrap() {
            for key in ["input", "output"] {
                let accessor = sampler[key].as_u64().unwrap() as usize;
                assert_eq!(raw(original, accessor), raw(out, accessor));
            }
        }
    }
    for (i, image) in list(&original.root, "images").iter().enumerate() {
        if let Some(view) = image.get("bufferView").and_then(Value::as_u64) {
            let new = out.root["images"][i]["bufferView"].as_u64().unwrap();
            assert_eq!(original.view(view as usize).unwrap(), out.view(new as usize).unwrap(), "image {i}");
        }
    }
}

/// Every lightmapped node shows the same triangles, attribute by attribute.
fn same_triangles(original: &Original, out: &Original) -> usize {
    let mut compared = 0;
    for (old, new) in list(&original.root, "nodes").iter().zip(list(&out.root, "nodes")) {
        let Some(mesh) = old.get("mesh").and_then(Value::as_u64) else { continue };
        // The last child of an expanded list stands for all: they share their vertices.
        let child = new["children"].as_array().and_then(|c| c.last()).and_then(Value::as_u64);
        let holder = child.filter(|_| new.get("mesh").is_none()).map_or(new, |c| &out.root["nodes"][c as usize]);
        let old = &original.root["meshes"][mesh as usize]["primitives"];
        let new = &out.root["meshes"][holder["mesh"].as_u64().unwrap() as usize]["primitives"];
        for (old, new) in old.as_array().unwrap().iter().zip(new.as_array().unwrap()) {
            let (before, after) = (triangles(original, old), triangles(out, new));
            assert_eq!(before.len(), after.len());
            for (semantic, accessor) in old["attributes"].as_object().unwrap() {
                let Some(copy) = new["attributes"].get(semantic).filter(|_| semantic != "TEXCOORD_1") else { continue };
                let (a, b) =
                    (raw(original, accessor.as_u64().unwrap() as usize), raw(out, copy.as_u64().unwrap() as usize));
                for (s, t) in before.iter().flatten().zip(after.iter().flatten()) {
                    assert_eq!(a[*s as usize], b[*t as usize], "{semantic}");
                }
            }
            compared += after.len();
        }
    }
    compared
}

#[test]
fn every_scene_comes_back_whole() {
    let Some(folder) = folder() else { return };
    let mut files = Vec::new();
    gltf_files(&folder, &mut files);
    files.retain(|path| !path.starts_with(folder.join("malformed")));
    let (mut written, mut refused) = (0, BTreeSet::new());
    for path in files {
        let name = path.strip_prefix(&folder).unwrap().display().to_string();
        let original = match Original::read(&path) {
            Ok(original) => original,
            Err(e) if e.to_string().contains("KHR_draco_mesh_compression") => {
                refused.insert(name);
                continue;
            }
            Err(e) => panic!("{e}"),
        };
        if has_draco(&original) {
            refused.insert(name);
            continue;
        }
        let scene = import(&original);
        let glb = bake(&original, &scene, &split(&scene, 1));
        let out = reread(&glb);
        same_elsewhere(&original, &out);
        let compared = same_triangles(&original, &out);
        // The gltf crate refuses what requires an extension that it does not know, and scenes without nodes.
        if gltf::Gltf::open(&path).is_ok() {
            gltf::Gltf::from_slice(&glb.bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
        }
        println!(
            "{name}: {compared} triangles, {} → {} bytes",
            std::fs::metadata(&path).unwrap().len(),
            glb.bytes.len()
        );
        written += 1;
    }
    println!("{written} scenes written; without plain vertices: {refused:?}");
    assert!(written > 30);
}

#[test]
fn malformed_scenes_are_read_or_refused_by_name() {
    let Some(folder) = folder() else { return };
    let mut files = Vec::new();
    gltf_files(&folder.join("malformed"), &mut files);
    let refused: Vec<String> = files.iter().filter_map(|p| Original::read(p).err()).map(|e| e.to_string()).collect();
    for message in &refused {
        println!("{message}");
        assert!(message.contains("malformed"), "{message}");
    }
    assert!(!refused.is_empty() && refused.len() < files.len());
}
