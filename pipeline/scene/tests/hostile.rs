//! Damaged and hostile files: whatever the bytes, the importer returns, soon and without a panic.

#[path = "support/glb.rs"]
mod support;

use std::path::PathBuf;

use luxel_scene::import::{FaultKind, ImportError, load};
use luxel_scene::{ImportOptions, Limits, Scene};
use proptest::prelude::*;
use serde_json::{Value, json};
use support::glb;

/// Builds the binary chunk piece by piece.
#[derive(Default)]
struct Bin {
    bytes: Vec<u8>,
    views: Vec<Value>,
}

impl Bin {
    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()}));
        self.bytes.extend(bytes);
        self.views.len() - 1
    }

    fn floats(&mut self, values: &[f32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|f| f.to_le_bytes()).collect();
        self.view(&bytes)
    }
}

fn png() -> Vec<u8> {
    let pixels = image::RgbaImage::from_fn(4, 4, |x, y| image::Rgba([60 * x as u8, 60 * y as u8, 9, 128]));
    let mut out = Vec::new();
    pixels.write_to(&mut std::io::Cursor::new(&mut out), image::ImageFormat::Png).unwrap();
    out
}

/// A small scene that uses most of what the importer reads.
fn everything() -> (Value, Vec<u8>) {
    let mut bin = Bin::default();
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0];
    let positions = bin.floats(&corners);
    let normals = bin.floats(&[0.0, 0.0, 1.0].repeat(4));
    let uvs = bin.floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
    let colors = bin.view(&[255, 128, 0, 255].repeat(4));
    let indices = bin.view(&[0, 0, 1, 0, 2, 0, 2, 0, 1, 0, 3, 0]);
    let sparse_indices = bin.view(&[3]);
    let sparse_values = bin.floats(&[1.5, 1.5, 0.0]);
    let offsets = bin.floats(&[0.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    let turns = bin.view(&[0, 0, 0, 127, 0, 127, 0, 0]);
    let image = bin.view(&png());
    let packed = meshopt_vertices(&corners);
    let encoded = bin.view(&packed);
    let mut views = bin.views.clone();
    let compression = json!({"buffer": 0, "byteOffset": views[encoded]["byteOffset"], "byteLength": packed.len(),
                             "byteStride": 12, "count": 4, "mode": "ATTRIBUTES"});
    views.push(json!({"buffer": 1, "byteLength": 48, "byteStride": 12,
                      "extensions": {"EXT_meshopt_compression": compression}}));
    let view = views.len() - 1;
    let float = |view: usize, count: usize, kind: &str| json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind});
    let document = json!({
        "asset": {"version": "2.0"},
        "extensionsUsed": ["EXT_meshopt_compression", "EXT_mesh_gpu_instancing", "KHR_lights_punctual"],
        "extensionsRequired": ["EXT_meshopt_compression", "KHR_mesh_quantization"],
        "buffers": [{"byteLength": bin.bytes.len()},
                    {"byteLength": 48, "extensions": {"EXT_meshopt_compression": {"fallback": true}}}],
        "bufferViews": views,
        "accessors": [
            float(positions, 4, "VEC3"), float(normals, 4, "VEC3"), float(uvs, 4, "VEC2"),
            {"bufferView": colors, "componentType": 5121, "normalized": true, "count": 4, "type": "VEC4"},
            {"bufferView": indices, "componentType": 5123, "count": 6, "type": "SCALAR"},
            {"bufferView": positions, "componentType": 5126, "count": 4, "type": "VEC3", "sparse": {"count": 1,
                "indices": {"bufferView": sparse_indices, "componentType": 5121}, "values": {"bufferView": sparse_values}}},
            float(offsets, 2, "VEC3"),
            {"bufferView": turns, "componentType": 5120, "normalized": true, "count": 2, "type": "VEC4"},
            float(view, 4, "VEC3")],
        "images": [{"bufferView": image, "mimeType": "image/png"}],
        "samplers": [{"wrapS": 33071, "wrapT": 33648}],
        "textures": [{"source": 0, "sampler": 0}],
        "materials": [
            {"name": "Leaf", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true,
             "pbrMetallicRoughness": {"baseColorTexture": {"index": 0,
                "extensions": {"KHR_texture_transform": {"offset": [0.5, 0], "rotation": 0.3, "scale": [2, 2]}}}}},
            {"name": "Lamp", "emissiveFactor": [1, 0.5, 0.25], "emissiveTexture": {"index": 0},
             "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 10}}},
            {"name": "Glass", "alphaMode": "BLEND", "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.5}}}],
        "meshes": [
            {"name": "Quad", "primitives": [
                {"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 3}, "indices": 4, "material": 0},
                {"attributes": {"POSITION": 5}, "mode": 5, "material": 1}]},
            {"name": "Fan", "primitives": [{"attributes": {"POSITION": 8}, "mode": 6, "material": 2},
                                           {"attributes": {"POSITION": 0}, "mode": 1}]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "spot", "intensity": 100, "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5}}]}},
        "nodes": [
            {"name": "Root", "children": [1, 2, 3], "scale": [-1, 2, 1], "rotation": [0, 0.6, 0, 0.8]},
            {"name": "Wall", "mesh": 0, "translation": [1, 2, 3], "extras": {"luxel_scale": 2}},
            {"name": "Many", "mesh": 1, "extensions": {"EXT_mesh_gpu_instancing":
                {"attributes": {"TRANSLATION": 6, "ROTATION": 7}}}},
            {"name": "Lamp", "camera": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1],
             "extensions": {"KHR_lights_punctual": {"light": 0}}}],
        "scenes": [{"nodes": [0]}]
    });
    (document, bin.bytes)
}

fn meshopt_vertices(floats: &[f32]) -> Vec<u8> {
    let vertices: Vec<[f32; 3]> = floats.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
    meshopt::encode_vertex_buffer(&vertices).unwrap()
}

/// Small bounds, so that a hostile file is quick to refuse.
fn options() -> ImportOptions {
    let limits = Limits {
        geometry_bytes: 4 << 20,
        image_pixels: 1 << 16,
        triangles: 10_000,
        instances: 1_000,
        nodes: 1_000,
        ..Limits::default()
    };
    ImportOptions { limits, bake_animated: true, ..ImportOptions::default() }
}

/// Loads bytes through a file of their own.
fn import(bytes: &[u8]) -> Result<Scene, ImportError> {
    use std::sync::atomic::{AtomicU64, Ordering};
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let path: PathBuf = std::env::temp_dir().join(format!("luxel-hostile-{}-{number}.glb", std::process::id()));
    std::fs::write(&path, bytes).unwrap();
    let result = load(&path, &options());
    std::fs::remove_file(&path).unwrap();
    result
}

fn import_json(document: &Value, bin: &[u8]) -> Result<Scene, ImportError> {
    import(&glb(&document.to_string(), bin))
}

#[test]
fn the_whole_scene_is_read() {
    let (document, bin) = everything();
    let scene = import_json(&document, &bin).unwrap();
    // Quad: two triangles and a strip of two; fan of two, twice.
    assert_eq!(scene.triangle_count(), 8, "{:?}", scene.notices);
    assert_eq!((scene.meshes.len(), scene.instances.len(), scene.materials.len()), (3, 4, 3));
    assert_eq!((scene.lights.len(), scene.cameras.len()), (1, 1));
    assert_eq!(scene.textures.len(), 1, "two materials share one image");
    assert_eq!(scene.materials[1].emission, glam::Vec3::new(10.0, 5.0, 2.5));
    assert_eq!(scene.meshes[1].positions[3], glam::Vec3::new(1.5, 1.5, 0.0), "sparse");
    assert_eq!(scene.meshes[0].colors[0], glam::Vec4::new(1.0, 128.0 / 255.0, 0.0, 1.0));
    assert_eq!(scene.instances[0].texel_scale, 2.0);
    assert_eq!(scene.instances[3].gpu_instance, Some(1));
    assert!(scene.instances[0].transform.matrix3.determinant() < 0.0, "mirrored");
    assert_eq!(scene.inputs.len(), 1);
}

#[test]
fn named_faults() {
    type Change = fn(&mut Value);
    let cases: [(Change, &str, &str); 14] = [
        (|d| d["accessors"][4]["count"] = json!(60), "accessor 4", "do not fit"),
        (|d| d["accessors"][0]["count"] = json!(3), "mesh 0 \"Quad\" primitive 0", "beyond its 3 vertices"),
        (|d| d["accessors"][0]["type"] = json!("SCALAR"), "mesh 0 \"Quad\" primitive 0", "components"),
        (|d| d["accessors"][1]["count"] = json!(2), "mesh 0 \"Quad\" primitive 0", "values of NORMAL"),
        (|d| d["meshes"][1]["primitives"][0]["material"] = json!(9), "mesh 1 \"Fan\" primitive 0", "material 9"),
        (|d| d["nodes"][1]["mesh"] = json!(5), "node 1 \"Wall\"", "mesh 5"),
        (|d| d["nodes"][1]["scale"] = json!([1e300, 1e300, 1e300]), "node 1 \"Wall\"", "beyond"),
        (|d| d["nodes"][3]["children"] = json!([0]), "node 0", "ancestor"),
        (|d| d["images"][0]["bufferView"] = json!(0), "image 0", "does not read"),
        (|d| d["textures"][0] = json!({"extensions": {"KHR_texture_basisu": {"source": 0}}}), "texture 0", "basisu"),
        (|d| d["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]), "extensionsRequired", "draco"),
        (|d| d["meshes"][0]["primitives"][0]["mode"] = json!(9), "mesh 0 \"Quad\" primitive 0", "mode"),
        (
            |d| d["bufferViews"][11]["extensions"]["EXT_meshopt_compression"]["byteStride"] = json!(6),
            "bufferView 11",
            "stride",
        ),
        (|d| d["accessors"][6]["count"] = json!(1), "node 2 \"Many\" instances", "length"),
    ];
    for (change, place, word) in cases {
        let (mut document, bin) = everything();
        change(&mut document);
        let error = import_json(&document, &bin).expect_err(word);
        assert!(error.fault.place.contains(place) && error.fault.what.contains(word), "{error}");
    }
}

#[test]
fn non_finite_vertices_name_the_primitive() {
    let (document, mut bin) = everything();
    bin[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    let error = import_json(&document, &bin).unwrap_err();
    assert_eq!(error.fault.place, "mesh 0 \"Quad\" primitive 0", "{error}");
    assert!(error.fault.what.contains("vertex 0") && error.to_string().contains(".glb"), "{error}");
}

#[test]
fn bombs_are_refused_before_they_go_off() {
    let limit = |change: fn(&mut Value)| {
        let (mut document, bin) = everything();
        change(&mut document);
        let error = import_json(&document, &bin).unwrap_err();
        assert_eq!(error.fault.kind, FaultKind::Limit, "{error}");
    };
    limit(|d| d["accessors"][0] = json!({"componentType": 5126, "count": 4_000_000_000u64, "type": "VEC3"}));
    limit(|d| d["accessors"][6] = json!({"componentType": 5126, "count": 1_000_000_000u64, "type": "VEC3"}));
    limit(|d| {
        let view = &mut d["bufferViews"][11]["extensions"]["EXT_meshopt_compression"];
        view["count"] = json!(1u64 << 60);
    });
    limit(|d| d["nodes"] = Value::Array(vec![json!({}); 1001]));
    limit(|d| {
        d["nodes"] = Value::Array(vec![json!({"mesh": 0}); 900]);
        d["scenes"] = json!([]);
    });
    let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    let json = format!(r#"{{"asset":{{"version":"2.0","extras":{deep}}}}}"#);
    assert!(import(json.as_bytes()).is_err());
}

#[test]
fn images_that_nothing_needs_are_not_decoded() {
    let (mut document, bin) = everything();
    document["images"][0] = json!({"uri": "not-there.png"});
    assert!(import_json(&document, &bin).is_err(), "it is needed here");
    document["materials"] = json!([
        {"normalTexture": {"index": 0}, "occlusionTexture": {"index": 0}, "emissiveTexture": {"index": 0}},
        {"pbrMetallicRoughness": {"metallicFactor": 0, "metallicRoughnessTexture": {"index": 0}}}, {}]);
    let scene = import_json(&document, &bin).unwrap();
    assert!(scene.textures.is_empty());
}

#[test]
fn material_extensions_and_defaults() {
    let (mut document, bin) = everything();
    document["materials"] = json!([
        {"name": "Old", "extensions": {"KHR_materials_pbrSpecularGlossiness":
            {"diffuseFactor": [0.5, 0.25, 0.125, 1], "diffuseTexture": {"index": 0}}}},
        {"name": "Chrome", "pbrMetallicRoughness": {"roughnessFactor": 0.5, "metallicRoughnessTexture": {"index": 0}}}]);
    document["meshes"][1]["primitives"][0].as_object_mut().unwrap().remove("material");
    let path = std::env::temp_dir().join(format!("luxel-materials-{}.glb", std::process::id()));
    std::fs::write(&path, glb(&document.to_string(), &bin)).unwrap();
    let scene = load(&path, &ImportOptions { metal_diffuse: 0.25, ..ImportOptions::default() }).unwrap();
    std::fs::remove_file(&path).unwrap();
    let [old, chrome, none] = &scene.materials[..] else { panic!("{:?}", scene.materials) };
    assert_eq!((old.base_color, old.metallic), (glam::Vec4::new(0.5, 0.25, 0.125, 1.0), 0.0));
    assert!(old.base_color_texture.is_some());
    assert_eq!((chrome.metallic, chrome.roughness, chrome.metal_diffuse), (1.0, 0.5, 0.25));
    let (color, data) = (&scene.textures[0], &scene.textures[1]);
    assert!(color.srgb && !data.srgb && color.texels == data.texels, "one image in two encodings");
    assert_eq!((none.base_color.x, none.metal_diffuse), (0.8, 0.25));
    assert_eq!(scene.notices.iter().filter(|n| n.code == "no-material").count(), 1);
}

#[test]
fn flattening_and_vanishing_transforms() {
    let (mut document, bin) = everything();
    document["nodes"][0]["scale"] = json!([1, 1, 0]);
    document["nodes"][0]["rotation"] = json!([0, 0, 0, 1]);
    let scene = import_json(&document, &bin).unwrap();
    assert_eq!(scene.triangle_count(), 8, "the quads lie in the plane that is kept");
    assert!(scene.instances.iter().all(|i| i.transform.matrix3.determinant() == 1.0));
    document["nodes"][0]["scale"] = json!([0, 1, 1]);
    let scene = import_json(&document, &bin).unwrap();
    assert_eq!(scene.triangle_count(), 0);
    assert!(scene.notices.iter().any(|n| n.code == "flat-transform"));
}

#[test]
fn what_moves_is_left_out_unless_asked_for() {
    let (mut document, bin) = everything();
    document["animations"] =
        json!([{"channels": [{"sampler": 0, "target": {"node": 0, "path": "scale"}}], "samplers": []}]);
    let file = glb(&document.to_string(), &bin);
    assert_eq!(import(&file).unwrap().triangle_count(), 8);
    let path = std::env::temp_dir().join(format!("luxel-moving-{}.glb", std::process::id()));
    std::fs::write(&path, &file).unwrap();
    let still = load(&path, &ImportOptions::default()).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert!(still.instances.is_empty() && still.lights.is_empty());
    assert!(still.notices.iter().any(|n| n.code == "animated-left-out" && n.message.contains("Wall")));
}

#[test]
fn a_skin_and_a_morph_take_their_rest_pose() {
    let (mut document, bin) = everything();
    let mut bin = Bin { bytes: bin, views: document["bufferViews"].as_array().unwrap().clone() };
    let joints = bin.view(&[0, 0, 0, 0].repeat(4));
    let weights = bin.floats(&[1.0, 0.0, 0.0, 0.0].repeat(4));
    let shift = bin.floats(&[0.0, 0.0, 0.5].repeat(4));
    document["bufferViews"] = Value::Array(bin.views.clone());
    document["buffers"][0]["byteLength"] = json!(bin.bytes.len());
    let accessors = document["accessors"].as_array_mut().unwrap();
    accessors.push(json!({"bufferView": joints, "componentType": 5121, "count": 4, "type": "VEC4"}));
    accessors.push(json!({"bufferView": weights, "componentType": 5126, "count": 4, "type": "VEC4"}));
    accessors.push(json!({"bufferView": shift, "componentType": 5126, "count": 4, "type": "VEC3"}));
    document["meshes"][0] = json!({"weights": [2.0], "primitives": [{"indices": 4, "targets": [{"POSITION": 11}],
        "attributes": {"POSITION": 0, "NORMAL": 1, "JOINTS_0": 9, "WEIGHTS_0": 10}}]});
    document["skins"] = json!([{"joints": [4]}]);
    document["nodes"][1]["skin"] = json!(0);
    let nodes = document["nodes"].as_array_mut().unwrap();
    nodes.push(json!({"translation": [10, 20, 30]}));
    let scene = import_json(&document, &bin.bytes).unwrap();
    let instance = &scene.instances[0];
    assert_eq!(instance.transform, glam::DAffine3::IDENTITY);
    assert_eq!(scene.meshes[instance.mesh].positions[1], glam::Vec3::new(11.0, 20.0, 31.0));
    assert_eq!(scene.meshes[instance.mesh].normals[1], glam::Vec3::Z);
}

/// One way to damage a file.
#[derive(Clone, Debug)]
enum Damage {
    Flip(prop::sample::Index, u8),
    Cut(prop::sample::Index),
    Insert(prop::sample::Index, Vec<u8>),
    Remove(prop::sample::Index, usize),
    /// Writes a 32-bit word: lengths and counts of the container, floats of the buffers.
    Word(prop::sample::Index, u32),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = any::<prop::sample::Index>;
    let word = prop_oneof![Just(0u32), Just(u32::MAX), Just(0x7fc0_0000), Just(0x7f7f_ffff), any::<u32>()];
    prop_oneof![
        4 => (at(), 1u8..).prop_map(|(i, x)| Damage::Flip(i, x)),
        1 => at().prop_map(Damage::Cut),
        2 => (at(), prop::collection::vec(any::<u8>(), 1..9)).prop_map(|(i, b)| Damage::Insert(i, b)),
        2 => (at(), 1usize..9).prop_map(|(i, n)| Damage::Remove(i, n)),
        2 => (at(), word).prop_map(|(i, w)| Damage::Word(i, w)),
    ]
}

fn apply(bytes: &mut Vec<u8>, damage: &Damage) {
    if bytes.is_empty() {
        return;
    }
    match damage {
        Damage::Flip(at, bits) => {
            let i = at.index(bytes.len());
            bytes[i] ^= bits;
        }
        Damage::Cut(at) => bytes.truncate(at.index(bytes.len())),
        Damage::Insert(at, new) => {
            let i = at.index(bytes.len());
            bytes.splice(i..i, new.iter().copied());
        }
        Damage::Remove(at, n) => {
            let i = at.index(bytes.len());
            bytes.drain(i..(i + n).min(bytes.len()));
        }
        Damage::Word(at, word) => {
            let i = at.index(bytes.len());
            let n = (bytes.len() - i).min(4);
            bytes[i..i + n].copy_from_slice(&word.to_le_bytes()[..n]);
        }
    }
}

/// What every scene keeps, whatever it was read from.
fn assert_sound(scene: &Scene) {
    for mesh in &scene.meshes {
        assert!(mesh.positions.iter().all(|p| p.is_finite()));
        assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < mesh.positions.len()));
        assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-4));
        assert!(mesh.uvs.iter().flatten().all(|uv| uv.is_finite()));
        assert!(mesh.colors.iter().all(|c| c.min_element() >= 0.0 && c.max_element() <= 1.0));
        for t in 0..mesh.triangles.len().min(4) {
            let instance = scene.instances.iter().find(|i| std::ptr::eq(&scene.meshes[i.mesh], mesh));
            let Some(instance) = instance else { continue };
            let surface = scene.surface(instance.mesh, t, 0.3, 0.3, 0.1);
            assert!(surface.albedo.is_finite() && surface.albedo.min_element() >= 0.0);
            assert!(surface.emission.is_finite() && surface.emission.min_element() >= 0.0);
            assert!((0.0..=1.0).contains(&surface.coverage));
        }
    }
    assert!(scene.instances.iter().all(|i| i.transform.is_finite()));
    assert!(scene.lights.iter().all(|l| l.intensity.is_finite() && l.intensity.min_element() >= 0.0));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_bytes_never_panic(damages in prop::collection::vec(damage(), 1..4)) {
        let (document, bin) = everything();
        let mut file = glb(&document.to_string(), &bin);
        damages.iter().for_each(|d| apply(&mut file, d));
        if let Ok(scene) = import(&file) {
            assert_sound(&scene);
        }
    }

    #[test]
    fn damaged_buffers_never_panic(damages in prop::collection::vec(damage(), 1..6)) {
        let (document, mut bin) = everything();
        damages.iter().for_each(|d| apply(&mut bin, d));
        if let Ok(scene) = import_json(&document, &bin) {
            assert_sound(&scene);
        }
    }

    #[test]
    fn wild_numbers_in_the_document_never_panic(
        places in prop::collection::vec((any::<prop::sample::Index>(), wild()), 1..4)
    ) {
        let (mut document, bin) = everything();
        for (at, value) in places {
            let mut leaves = Vec::new();
            pointers(&document, String::new(), &mut leaves);
            let pointer = &leaves[at.index(leaves.len())];
            if let Some(slot) = document.pointer_mut(pointer) {
                *slot = value;
            }
        }
        if let Ok(scene) = import_json(&document, &bin) {
            assert_sound(&scene);
        }
    }
}

/// A value that a document may hold where it should not.
fn wild() -> impl Strategy<Value = Value> {
    prop_oneof![
        Just(json!(-1)),
        Just(json!(0)),
        Just(json!(1e300)),
        Just(json!(-1e300)),
        Just(json!(u64::MAX)),
        Just(json!(4294967295u64)),
        Just(json!(null)),
        Just(json!("x")),
        Just(json!([])),
        Just(json!({})),
        (0u64..12).prop_map(|n| json!(n)),
        (-10.0f64..10.0).prop_map(|f| json!(f)),
    ]
}

/// JSON pointers to all values below the root.
fn pointers(value: &Value, at: String, out: &mut Vec<String>) {
    match value {
        Value::Array(values) => values.iter().enumerate().for_each(|(i, v)| pointers(v, format!("{at}/{i}"), out)),
        Value::Object(map) => map.iter().for_each(|(k, v)| pointers(v, format!("{at}/{k}"), out)),
        _ => {}
    }
    if !at.is_empty() {
        out.push(at);
    }
}
