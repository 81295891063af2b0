//! Nothing of the input is lost, wherever it came from.

use std::fs;

use serde_json::{Value, json};

use super::super::{Original, glb_bytes};
use super::kit::{File, bake, import, lightmaps, names, raw, reread, split};
use crate::Effort;

#[test]
fn numbers_texts_and_strangers_survive_byte_by_byte() {
    // Values that a careless way through floating point, sorting or escaping would change.
    let extras =
        r#"{"z":1,"a":[0.1,1e-7,123456789012345678,-0.5,3.4028234663852886e+38],"ü\n":"\u0000\"","n":null,"e":{}}"#;
    let mut file = File::new();
    let quad = file.quad(0.0);
    file.push("meshes", json!({"primitives": [quad]}));
    file.node(json!({"mesh": 0, "name": "Ärger"}));
    file.root["nodes"][0]["extras"] = serde_json::from_str(extras).unwrap();
    file.root["scenes"][0]["extensions"] = json!({"VENDOR_weather": {"rain": 0.3}});
    file.root["extensions"] = json!({"VENDOR_world": {"gravity": [0, -9.81, 0]}});
    file.root["extensionsUsed"] = json!(["VENDOR_weather", "VENDOR_world"]);
    file.root["asset"]["copyright"] = "somebody".into();
    file.root["unheard_of"] = json!([1, 2, {"x": 1.25}]);
    let original = file.read();
    let scene = import(&original);
    let root = Value::Object(reread(&bake(&original, &scene, &split(&scene, 1))).root);
    let text = serde_json::to_string(&root["nodes"][0]["extras"]).unwrap();
    assert_eq!(text, extras);
    for key in ["scenes", "extensions", "asset", "unheard_of"] {
        assert_eq!(root[key], original.root[key], "{key}");
    }
    assert_eq!(root["extensionsUsed"], json!(["VENDOR_weather", "VENDOR_world", "MOZ_lightmap"]));
}

#[test]
fn animations_skins_and_cameras_keep_their_data() {
    let mut file = File::new();
    let quad = file.quad(0.0);
    file.push("meshes", json!({"primitives": [quad]}));
    let times = file.floats("SCALAR", &[0.0, 1.0]);
    let path = file.floats("VEC3", &[0., 0., 0., 1., 2., 3.]);
    let bind = file.view(&[7; 64]);
    let bind = file.push("accessors", json!({"bufferView": bind, "componentType": 5126, "count": 1, "type": "MAT4"}));
    let node = file.node(json!({"mesh": 0}));
    let bone = file.node(json!({"name": "bone", "camera": 0}));
    file.push("skins", json!({"joints": [bone], "inverseBindMatrices": bind}));
    file.push("cameras", json!({"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}));
    file.push(
        "animations",
        json!({"channels": [{"sampler": 0, "target": {"node": node, "path": "translation"}}],
            "samplers": [{"input": times, "output": path}]}),
    );
    let original = file.read();
    let scene = import(&original);
    let out = reread(&bake(&original, &scene, &split(&scene, 1)));
    for key in ["skins", "cameras", "animations"] {
        assert_eq!(out.root[key], original.root[key], "{key}");
    }
    for accessor in [times, path, bind] {
        assert_eq!(raw(&out, accessor), raw(&original, accessor));
    }
}

#[test]
fn outdated_vertices_leave_the_file_unless_a_stranger_may_mean_them() {
    let mut file = File::new();
    let quad = file.quad(0.0);
    let position = quad["attributes"]["POSITION"].as_u64().unwrap();
    file.push("meshes", json!({"primitives": [quad]}));
    file.node(json!({"mesh": 0}));
    let original = file.read();
    let scene = import(&original);
    let lean = reread(&bake(&original, &scene, &split(&scene, 1)));
    assert_eq!(lean.root["accessors"].as_array().unwrap().len(), 5);

    file.root["nodes"][0]["extensions"] = json!({"VENDOR_physics": {"collider": {"points": position}}});
    file.root["extensionsUsed"] = json!(["VENDOR_physics"]);
    let original = file.read();
    let kept = reread(&bake(&original, &scene, &split(&scene, 1)));
    assert_eq!(raw(&kept, position as usize), raw(&original, position as usize));
    assert_eq!(kept.root["accessors"].as_array().unwrap().len(), 6);
}

#[test]
fn views_that_overlap_share_their_bytes_and_unused_bytes_go() {
    let mut file = File::new();
    file.view(&[99; 4000]);
    file.root["bufferViews"] = json!([]);
    let floats: Vec<u8> = (0..24).flat_map(|i| (i as f32).to_le_bytes()).collect();
    let (at, n) = (file.bin.len(), floats.len());
    file.bin.extend(&floats);
    // Position and normal interleaved, named by two overlapping views.
    for (offset, length) in [(0, n - 12), (12, n - 12)] {
        let view = json!({"buffer": 0, "byteOffset": at + offset, "byteLength": length, "byteStride": 24});
        let view = file.push("bufferViews", view);
        file.push(
            "accessors",
            json!({"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC3",
            "min": [0.0, 1.0, 2.0], "max": [21.0, 22.0, 23.0]}),
        );
    }
    file.push("meshes", json!({"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}}]}));
    file.node(json!({"mesh": 0}));
    let original = file.read();
    let mut scene = import(&original);
    scene.instances[0].receives = false;
    let glb = bake(&original, &scene, &split(&scene, 1));
    let out = reread(&glb);
    assert_eq!(out.buffers.bytes(0).len(), n);
    for accessor in 0..2 {
        assert_eq!(raw(&out, accessor), raw(&original, accessor));
    }
}

#[test]
fn files_and_data_uris_are_taken_in() {
    let mut file = File::new();
    let quad = file.quad(0.0);
    file.push("meshes", json!({"primitives": [quad]}));
    file.node(json!({"mesh": 0}));
    let dir = tempfile::tempdir().unwrap();
    let png = crate::encode_png(&crate::Image8 { width: 1, height: 1, texels: vec![[1, 2, 3]] }).unwrap();
    fs::create_dir(dir.path().join("my textures")).unwrap();
    fs::write(dir.path().join("my textures/a b.png"), &png).unwrap();
    let base64 = |bytes: &[u8]| base64::Engine::encode(&base64::engine::general_purpose::STANDARD, bytes);
    let cut = file.bin.len() / 2 / 4 * 4;
    // Two buffers, one a file, one a data URI: every view must lie in one of them.
    let mut root = file.root.clone();
    fs::write(dir.path().join("level.bin"), &file.bin).unwrap();
    root["buffers"] = json!([
        {"uri": "level.bin", "byteLength": file.bin.len(), "name": "first"},
        {"uri": format!("data:application/octet-stream;base64,{}", base64(&file.bin[cut..])), "byteLength": file.bin.len() - cut}
    ]);
    for view in root["bufferViews"].as_array_mut().unwrap() {
        let offset = view["byteOffset"].as_u64().unwrap() as usize;
        if offset >= cut {
            view["buffer"] = 1.into();
            view["byteOffset"] = (offset - cut).into();
        }
    }
    root["images"] = json!([
        {"uri": "my%20textures/a%20b.png", "name": "file"},
        {"uri": format!("data:image/png;base64,{}", base64(&png))},
        {"uri": "missing.png", "name": "gone"}
    ]);
    let path = dir.path().join("level.gltf");
    fs::write(&path, serde_json::to_vec(&root).unwrap()).unwrap();
    let original = Original::read(&path).unwrap();
    let scene = import(&original);
    let glb = bake(&original, &scene, &split(&scene, 1));
    let out = reread(&glb);
    for image in 0..2 {
        let json = &out.root["images"][image];
        assert_eq!(json["mimeType"], "image/png");
        assert_eq!(out.view(json["bufferView"].as_u64().unwrap() as usize).unwrap(), png);
    }
    assert_eq!(out.root["images"][0]["name"], "file");
    assert_eq!(out.root["images"][2], json!({"uri": "missing.png", "name": "gone"}));
    assert_eq!(glb.notices.len(), 1);
    assert!(glb.notices[0].message.contains("gone"), "{}", glb.notices[0].message);
    assert_eq!(out.root["buffers"][0]["name"], "first");
    gltf::Gltf::from_slice(&glb.bytes).unwrap();
}

#[test]
fn a_file_that_changed_under_the_bake_is_refused() {
    let mut file = File::new();
    let quad = file.quad(0.0);
    file.push("meshes", json!({"primitives": [quad]}));
    file.node(json!({"mesh": 0}));
    let original = file.read();
    let mut scene = import(&original);
    let atlas = split(&scene, 1);
    let refused = |scene: &luxel_scene::Scene| {
        original
            .lightmapped(scene, &atlas, &lightmaps(1), &names(1), Effort::Small, &luxel_scene::Silent)
            .unwrap_err()
            .to_string()
    };
    scene.inputs.push(luxel_scene::InputFile { path: original.path.clone(), digest: [0; 32] });
    assert!(refused(&scene).contains("has changed"));
    scene.inputs.clear();
    for (node, gpu_instance) in [(1, None), (0, Some(0))] {
        (scene.instances[0].node, scene.instances[0].gpu_instance) = (node, gpu_instance);
        assert!(refused(&scene).contains("node "), "{}", refused(&scene));
    }
    assert!(original.lightmapped(&scene, &atlas, &[], &[], Effort::Small, &luxel_scene::Silent).is_err());
}

#[test]
fn the_container_counts_its_bytes() {
    let bytes = glb_bytes(b"{}".to_vec(), &[1, 2, 3, 4, 5], &luxel_scene::Silent).ok().unwrap();
    assert_eq!(bytes.len() % 4, 0);
    assert_eq!(u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize, bytes.len());
    assert_eq!(glb_bytes(b"{}".to_vec(), &[], &luxel_scene::Silent).ok().unwrap().len(), 24);
}
