//! Damaged files: an error or a .glb, never a panic.

use proptest::prelude::*;
use serde_json::json;

use super::super::Original;
use super::kit::{File, import, lightmaps, names, split};
use crate::Effort;

fn victim() -> Vec<u8> {
    let mut file = File::new();
    let mut quad = file.quad(0.0);
    file.push("textures", json!({}));
    quad["material"] = file.push("materials", json!({"normalTexture": {"index": 0, "texCoord": 1}})).into();
    let indices = file.view(&[1, 0]);
    let values = file.view(&[0; 12]);
    let target = json!({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": {"count": 1,
        "indices": {"bufferView": indices, "componentType": 5123}, "values": {"bufferView": values}}});
    quad["targets"] = json!([{"POSITION": file.push("accessors", target)}]);
    file.push("meshes", json!({"primitives": [quad]}));
    let at = file.floats("VEC3", &[0., 0., 0., 5., 0., 0.]);
    let extension = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": at}}});
    file.node(json!({"mesh": 0, "extensions": extension}));
    file.node(json!({"mesh": 0}));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("victim.glb");
    file.write_glb(&path);
    std::fs::read(path).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]
    #[test]
    fn mutated_bytes_never_panic(edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4)) {
        let whole = victim();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("level.glb");
        std::fs::write(&path, &whole).unwrap();
        // The scene of the undamaged file: what a bake would hold in its hands when the file is damaged meanwhile.
        let scene = import(&Original::read(&path).unwrap());
        let atlas = split(&scene, 2);
        let mut bytes = whole.clone();
        for (at, byte) in edits {
            // Digits and quotes break more than random bytes do, which are refused as JSON at once.
            let text = b"0123456789-e\"[]{},:.";
            let i = at.index(bytes.len());
            bytes[i] = if i < whole.len() - 300 { text[usize::from(byte) % text.len()] } else { byte };
        }
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(original) = Original::read(&path) {
            let _ = original.lightmapped(&scene, &atlas, &lightmaps(2), &names(2), Effort::Small, &luxel_scene::Silent);
        }
    }
}

#[test]
fn depth_and_sizes_are_bounded() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("level.gltf");
    let refused = |text: &str| {
        std::fs::write(&path, text).unwrap();
        Original::read(&path).err().unwrap().to_string()
    };
    refused(&format!("{}{}", "{\"a\":".repeat(100_000), "}".repeat(100_000)));
    refused("[]");
    refused("");
    let with = |buffers: &str| refused(&format!(r#"{{"asset":{{"version":"2.0"}},{buffers}}}"#));
    let e = with(
        r#""buffers":[{"byteLength":0}],"bufferViews":[{"buffer":0,"byteOffset":18446744073709551615,"byteLength":2}]"#,
    );
    assert!(e.contains("bufferView 0"), "{e}");
    let e = with(r#""buffers":[{"uri":"../../../../etc/hosts","byteLength":9}]"#);
    assert!(e.contains("buffer 0") && e.contains("above") && e.contains("keep buffers"), "{e}");
    // 4 GiB from a few bytes are not even allocated.
    let e = with(
        r#""buffers":[{"uri":"data:,a","byteLength":1}],"bufferViews":[{"buffer":0,"byteLength":1,"extensions":{
            "EXT_meshopt_compression":{"buffer":0,"byteLength":1,"byteStride":4,"count":1073741824,"mode":"ATTRIBUTES"}}}]"#,
    );
    assert!(e.contains("bufferView 0") && e.contains("decoded geometry") && e.contains("expansion"), "{e}");
    assert!(Original::read(dir.path()).is_err());
}

#[test]
fn a_list_of_instances_without_data_is_not_believed() {
    let mut file = File::new();
    let quad = file.quad(0.0);
    file.push("meshes", json!({"primitives": [quad]}));
    let at = file.push("accessors", json!({"componentType": 5126, "count": 4_000_000_000u32, "type": "VEC3"}));
    file.node(json!({"mesh": 0}));
    let mut scene = import(&file.read());
    scene.instances[0].gpu_instance = Some(0);
    file.root["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": at}}});
    let original = file.read();
    let error = original
        .lightmapped(&scene, &split(&scene, 1), &lightmaps(1), &names(1), Effort::Small, &luxel_scene::Silent)
        .unwrap_err()
        .to_string();
    assert!(error.contains("4000000000 instances"), "{error}");
}
