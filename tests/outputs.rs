//! The contract of the outputs: names and pages, what flags and extras do to them, what is stored and reused, and what
//! is left alone when something fails.

mod tool;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tool::*;

/// Writes a scene as `stem.gltf` beside `stem.bin`.
fn write_gltf(folder: &Path, stem: &str, mut document: Value, bin: &[u8]) -> PathBuf {
    document["buffers"][0]["uri"] = json!(format!("{stem}.bin"));
    std::fs::write(folder.join(format!("{stem}.bin")), bin).unwrap();
    let path = folder.join(format!("{stem}.gltf"));
    std::fs::write(&path, document.to_string()).unwrap();
    path
}

/// The Cornell box with extras on the node of that name, baked.
fn cornell_with(node: &str, extras: Value) -> (Outputs, usize) {
    let (mut document, bin) = parts("cornell.glb");
    let nodes = document["nodes"].as_array_mut().unwrap();
    let index = nodes.iter().position(|n| n["name"] == node).unwrap();
    nodes[index]["extras"] = extras;
    let folder = tempfile::tempdir().unwrap();
    write_gltf(folder.path(), "a", document, &bin);
    quick(&["bake", "a.gltf"], folder.path()).ended(0);
    (Outputs::read(&folder.path().join("baked"), "a"), index)
}

/// Area of a node's charts, as a share of its page.
fn share(outputs: &Outputs, node: usize) -> f32 {
    let of_instance = |i: &luxel_scene::Instance| {
        let mesh = &outputs.scene.meshes[i.mesh];
        let Some(uvs) = mesh.uvs.get(1).filter(|uvs| !uvs.is_empty()) else { return 0.0 };
        let corners = mesh.triangles.iter().map(|t| t.map(|i| uvs[i as usize]));
        corners.map(|[a, b, c]| 0.5 * (b - a).perp_dot(c - a).abs()).sum::<f32>()
    };
    outputs.scene.instances.iter().filter(|i| i.node == node).map(of_instance).sum()
}

fn mean(outputs: &Outputs) -> f64 {
    outputs.report["quality"]["mean_irradiance_lux"].as_f64().unwrap()
}

#[test]
fn several_pages_are_numbered_and_go_when_one_suffices() {
    let folder = folder(&["cornell.glb"]);
    let dense = ["bake", "cornell.glb", "--texel-density", "120", "--gather", "lightcuts", "--bound"];
    quick(&dense, folder.path()).ended(0);
    let baked = folder.path().join("baked");
    let outputs = Outputs::read(&baked, "cornell");
    let pages = outputs.lightmaps.len();
    assert!(pages > 1, "{pages} page");
    let names: Vec<String> = files(&baked).into_keys().collect();
    for page in 0..pages {
        for kind in ["lightmap", "bound"] {
            assert!(names.contains(&format!("cornell.{kind}.{page}.exr")), "{names:?}");
        }
    }
    assert!(!names.contains(&"cornell.lightmap.exr".to_owned()), "{names:?}");
    let nodes = outputs.document["nodes"].as_array().unwrap();
    let mut used = vec![false; pages];
    for node in nodes.iter().filter(|n| n.get("mesh").is_some()) {
        used[node["extras"]["lightmap"].as_u64().unwrap() as usize] = true;
    }
    assert!(used.iter().all(|u| *u), "every page holds a node");

    quick(&["bake", "cornell.glb"], folder.path()).ended(0);
    let names: Vec<String> = files(&baked).into_keys().collect();
    assert_eq!(names, ["cornell.bake.json", "cornell.glb", "cornell.lightmap.exr", "cornell.preview.png"]);
}

#[test]
fn direct_and_indirect_light_make_the_whole() {
    let folder = folder(&["cornell.glb"]);
    let bake = |only: &str| {
        quick(&["bake", "cornell.glb", "--only", only, "--out", only], folder.path()).ended(0);
        Outputs::read(&folder.path().join(only), "cornell")
    };
    let [all, direct, indirect] = ["all", "direct", "indirect"].map(bake);
    let (mut off, mut sum) = (0.0, 0.0);
    for (i, whole) in all.lightmaps[0].irradiance().iter().enumerate() {
        let parts = direct.lightmaps[0].irradiance()[i] + indirect.lightmaps[0].irradiance()[i];
        off += f64::from((*whole - parts).abs().element_sum());
        sum += f64::from(whole.element_sum());
    }
    assert!(sum > 0.0 && off < 1e-3 * sum, "{off} of {sum}");
    for (outputs, stage) in [(&direct, "propagate"), (&indirect, "direct")] {
        let (state, reason) = outputs.stage(stage);
        assert!(state == "left out" && reason.contains("only"), "{stage}: {state}, {reason}");
    }
}

#[test]
fn twins_side_by_side_keep_their_extensions() {
    let folder = folder(&[]);
    let (document, bin) = parts("cornell.glb");
    write_gltf(folder.path(), "a", document, &bin);
    std::fs::copy(asset("two_rooms.glb"), folder.path().join("a.glb")).unwrap();
    quick(&["bake", "."], folder.path()).ended(0);
    let baked = folder.path().join("baked");
    let [glb, gltf] = ["a.glb", "a.gltf"].map(|stem| Outputs::read(&baked, stem));
    assert_eq!(files(&baked).len(), 8);
    assert_ne!(glb.scene.triangle_count(), gltf.scene.triangle_count());
    // An outside buffer is inside now.
    assert!(gltf.document["buffers"][0].get("uri").is_none());
}

#[test]
fn an_output_folder_that_cannot_be_made_is_named() {
    let folder = folder(&["cornell.glb"]);
    std::fs::write(folder.path().join("taken"), b"a file").unwrap();
    for out in ["taken", "taken/deeper"] {
        let run = quick(&["bake", "cornell.glb", "--out", out], folder.path()).ended(1);
        assert!(run.stderr.contains("taken"), "{}", run.stderr);
    }
    assert_eq!(files(folder.path()).len(), 2);
}

#[test]
fn failures_are_events_too_and_not_even_quiet_hides_them() {
    let folder = folder(&["cornell.glb"]);
    std::fs::write(folder.path().join("bad.gltf"), r#"{"asset":{"version":"1.0"}}"#).unwrap();
    let run = quick(&["bake", "bad.gltf", "cornell.glb", "--json"], folder.path()).ended(1);
    let events: Vec<Value> = run.stdout.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let failed = events.iter().find(|e| e["event"] == "failed").unwrap();
    assert!(failed["scene"] == "bad.gltf" && failed["error"].as_str().unwrap().contains("glTF 1.0"), "{failed}");
    assert!(events.iter().any(|e| e["event"] == "baked" && e["scene"] == "cornell.glb"));
    assert_eq!(events.last().unwrap()["failed"], json!(["bad.gltf"]));
    let run = quick(&["bake", "bad.gltf", "--quiet"], folder.path()).ended(1);
    assert!(run.stdout.is_empty() && run.stderr.contains("bad.gltf"), "{}{}", run.stdout, run.stderr);
}

#[test]
fn settings_lie_over_each_other_and_say_where_they_come_from() {
    let folder = folder(&[]);
    let (mut document, bin) = parts("cornell.glb");
    document["scenes"][0]["extras"] = json!({"luxel": {"padding": 4, "directions": 32}});
    write_gltf(folder.path(), "a", document, &bin);
    std::fs::write(folder.path().join("luxel.toml"), "padding = 3\nbounces = 5\npreset = \"draft\"\n").unwrap();
    luxel(&["bake", "a.gltf", "--size", "64", "--directions", "64"], folder.path()).ended(0);
    let outputs = Outputs::read(&folder.path().join("baked"), "a");
    let setting = |name: &str| {
        let list = outputs.report["settings"].as_array().unwrap();
        let found = list.iter().find(|s| s["name"] == name).unwrap();
        (found["value"].clone(), found["origin"].as_str().unwrap().to_owned())
    };
    assert_eq!(setting("directions"), (json!(64), "command line".into()));
    let (padding, origin) = setting("padding");
    assert!(padding == 4 && origin.contains("extras"), "{padding} from {origin}");
    let (bounces, origin) = setting("bounces");
    assert!(bounces == 5 && origin.contains("luxel.toml"), "{bounces} from {origin}");
    assert_eq!(setting("shadow_samples"), (json!(16), "preset draft".into()));
    assert_eq!(setting("only").1, "default");
}

#[test]
fn extras_of_nodes_are_honoured() {
    let (plain, block) = cornell_with("high block", json!({}));
    let (large, _) = cornell_with("high block", json!({"luxel_scale": 2}));
    let grown = share(&large, block) / share(&plain, block) / (share(&large, 0) / share(&plain, 0));
    assert!((3.0..5.5).contains(&grown), "twice the density is {grown} times the area beside a plain node");

    let (ignored, _) = cornell_with("high block", json!({"luxel_ignore": true}));
    assert_eq!(share(&ignored, block), 0.0);
    assert_eq!(
        ignored.scene.triangle_count(),
        plain.scene.triangle_count() - 10,
        "it is passed over on the way back too"
    );
    assert_eq!(ignored.document["nodes"][block]["name"], "high block", "but it is still in the file");

    let (ghost, _) = cornell_with("high block", json!({"luxel_cast": false}));
    assert!(share(&ghost, block) > 0.0, "what casts no shadow is lit all the same");
    let floor = |o: &Outputs| {
        let instance = o.scene.instances.iter().position(|i| i.node == 0).unwrap();
        let n = o.scene.meshes[o.scene.instances[instance].mesh].triangles.len();
        (0..n).map(|t| o.at(instance, t, 0.3, 0.3).unwrap().element_sum()).sum::<f32>()
    };
    assert!(floor(&ghost) != floor(&plain) && mean(&ghost) != mean(&plain));

    let (blind, _) = cornell_with("high block", json!({"luxel_receive": false}));
    assert_eq!(share(&blind, block), 0.0);
    let (odd, _) = cornell_with("high block", json!({"luxel_scale": "big"}));
    assert_eq!(odd.warnings("invalid-extra").len(), 1);
}

/// All that a store holds.
fn artefacts(store: &Path) -> std::collections::BTreeMap<std::path::PathBuf, Vec<u8>> {
    let kinds = std::fs::read_dir(store).unwrap().map(|kind| kind.unwrap().path());
    let files = kinds.flat_map(|kind| std::fs::read_dir(kind).unwrap().map(|file| file.unwrap().path()));
    files.map(|path| (path.clone(), std::fs::read(&path).unwrap())).collect()
}

/// The outputs whose bytes do not tell the time.
fn timeless(folder: &Path) -> Vec<(String, Vec<u8>)> {
    files(folder).into_iter().filter(|(name, _)| !name.ends_with(".json")).collect()
}

#[test]
fn the_stored_light_is_reused_and_a_damaged_one_made_anew() {
    let folder = folder(&["cornell.glb"]);
    let baked = folder.path().join("baked");
    let bake = |flags: &[&str]| {
        // What is current would not be baked, whatever became of the stored light.
        quick(&[&["bake", "cornell.glb", "--force"], flags].concat(), folder.path()).ended(0);
        Outputs::read(&baked, "cornell")
    };
    let ran = bake(&[]);
    assert_eq!((ran.stage("propagate").0, &ran.report["table1"]["state"]), ("ran", &json!("ran")));
    let first = timeless(&baked);
    let again = bake(&[]);
    for stage in ["unwrap", "surfels", "shoot", "propagate", "cache", "clear", "direct", "gather", "finish"] {
        assert_eq!(again.stage(stage).0, "reused", "{stage}");
    }
    assert!(timeless(&baked) == first, "reused light gives the same bytes");
    assert_eq!(again.stage("export").0, "ran");
    assert_eq!(again.stage("sky").0, "left out");
    // The stored light brings its figures along; what this bake itself did is counted apart.
    assert_eq!(again.report["table1"]["state"], "reused");
    assert_eq!(again.report["energy"]["state"], "reused");
    for figure in
        ["voxels", "light_path_length", "voxel_directions", "direct_photons", "continuous_rays", "discrete_rays"]
    {
        assert_eq!(again.report["table1"][figure], ran.report["table1"][figure], "{figure}");
    }
    for flux in ["emitted", "absorbed", "escaped", "remaining", "defect"] {
        assert_eq!(again.report["energy"][flux], ran.report["energy"][flux], "{flux}");
    }
    for figure in ["mean_row_sum", "row_sum_defect", "tail"] {
        assert!(again.report["quality"][figure].is_number(), "{figure}");
        assert_eq!(again.report["quality"][figure], ran.report["quality"][figure], "{figure}");
    }
    assert_eq!(again.report["counters"]["discrete_rays"], 0);
    assert!(ran.report["counters"]["discrete_rays"].as_u64().unwrap() > 0);

    let stored = artefacts(&baked.join(".luxel"));
    let half = |whole: &[u8]| whole[..whole.len() / 2].to_vec();
    let flipped = |whole: &[u8]| {
        let mut bytes = whole.to_vec();
        bytes[whole.len() - 9] ^= 4;
        bytes
    };
    for broken in
        [half, flipped, |_: &[u8]| Vec::new(), |_: &[u8]| b"no artefact".to_vec()] as [fn(&[u8]) -> Vec<u8>; 4]
    {
        for (path, whole) in &stored {
            std::fs::write(path, broken(whole)).unwrap();
        }
        let rebuilt = bake(&[]);
        assert_eq!(rebuilt.stage("propagate").0, "ran");
        let told = rebuilt.warnings("store");
        assert!(told.len() > 3 && told[0].contains(".luxel"), "{told:?}");
        assert!(timeless(&baked) == first && artefacts(&baked.join(".luxel")) == stored);
    }

    assert_eq!(bake(&["--padding", "3"]).stage("propagate").0, "reused", "the light does not know the atlas");
    assert_eq!(bake(&["--bounces", "3"]).stage("propagate").0, "ran");
    assert_eq!(bake(&["--emissive-scale", "3"]).stage("gather").0, "reused", "light is gathered at unit power");
}

#[test]
fn a_scene_without_light_is_black_and_says_how_to_light_it() {
    let folder = folder(&["cornell.glb"]);
    let run = quick(&["bake", "cornell.glb", "--emissive-scale", "0"], folder.path()).ended(0);
    assert!(run.stderr.contains("--sky"), "{}", run.stderr);
    let outputs = Outputs::read(&folder.path().join("baked"), "cornell");
    assert!(outputs.lightmaps[0].irradiance().iter().all(|e| *e == glam::Vec3::ZERO));
    assert_eq!(outputs.stage("propagate").0, "left out");
}

#[test]
fn the_output_can_be_baked_again() {
    let folder = folder(&["cornell.glb"]);
    quick(&["bake", "cornell.glb"], folder.path()).ended(0);
    std::fs::copy(folder.path().join("baked/cornell.glb"), folder.path().join("second.glb")).unwrap();
    quick(&["bake", "second.glb"], folder.path()).ended(0);
    let [first, second] = ["cornell", "second"].map(|s| Outputs::read(&folder.path().join("baked"), s));
    assert_eq!(first.scene.triangle_count(), second.scene.triangle_count());
    assert!(second.warnings("unwrapped-anew").is_empty(), "{:?}", second.warnings("unwrapped-anew"));
    let d = difference(&first, &second, 1.0, 2000);
    assert!(d.rmse < 0.05 && d.bias.abs() < 0.02, "{d:?}");

    // Nothing piles up, and the reference is to the new lightmap.
    std::fs::copy(folder.path().join("baked/second.glb"), folder.path().join("third.glb")).unwrap();
    quick(&["bake", "third.glb"], folder.path()).ended(0);
    let third = Outputs::read(&folder.path().join("baked"), "third");
    for kind in ["images", "textures", "samplers", "materials", "meshes", "accessors", "bufferViews"] {
        let counts = [&first, &second, &third].map(|o| o.document[kind].as_array().unwrap().len());
        assert!(counts == [counts[0]; 3], "{kind}: {counts:?}");
    }
    let lightmap = &third.document["textures"][0]["extras"]["luxel"]["lightmap"];
    assert_eq!(lightmap, "third.lightmap.exr");
}

/// The picture that a texture of a .glb shows.
fn embedded(glb: &[u8], document: &Value, texture: usize) -> image::RgbImage {
    let image = document["textures"][texture]["source"].as_u64().unwrap() as usize;
    let view = document["images"][image]["bufferView"].as_u64().unwrap() as usize;
    let [offset, length] = ["byteOffset", "byteLength"].map(|key| document["bufferViews"][view][key].as_u64());
    let bin = 20 + u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize + 8;
    let start = bin + offset.unwrap_or(0) as usize;
    image::load_from_memory(&glb[start..start + length.unwrap() as usize]).unwrap().to_rgb8()
}

/// A patch of sun, a thousand times as bright as the rest of the room, does not cost the rest its shades.
#[test]
fn the_embedded_pictures_hold_bright_and_dim_instances() {
    let folder = folder(&["textured_room.glb"]);
    quick(&["bake", "textured_room.glb"], folder.path()).ended(0);
    let baked = folder.path().join("baked");
    let outputs = Outputs::read(&baked, "textured_room");
    let glb = std::fs::read(baked.join("textured_room.glb")).unwrap();
    let map = &outputs.lightmaps[0];
    let size = glam::Vec2::new(map.width() as f32, map.height() as f32);
    let mut shown = Vec::new();
    for (i, instance) in outputs.scene.instances.iter().enumerate() {
        let mesh = &outputs.scene.meshes[instance.mesh];
        let primitive = &outputs.document["meshes"][mesh.gltf_mesh]["primitives"][mesh.gltf_primitive];
        let material = &outputs.document["materials"][primitive["material"].as_u64().unwrap() as usize];
        let lightmap = &material["extensions"]["MOZ_lightmap"];
        let intensity = lightmap["intensity"].as_f64().unwrap() as f32;
        let picture = embedded(&glb, &outputs.document, lightmap["index"].as_u64().unwrap() as usize);
        assert_eq!(picture.dimensions(), (map.width(), map.height()));
        let mut peak = 0.0f32;
        for triangle in &mesh.triangles {
            let corners = triangle.map(|corner| mesh.uvs[1][corner as usize]);
            let at = (corners.iter().sum::<glam::Vec2>() / 3.0 * size).as_uvec2();
            let stored = map.irradiance()[(at.y * map.width() + at.x) as usize];
            let seen = glam::Vec3::from(picture.get_pixel(at.x, at.y).0.map(f32::from)) / 255.0 * intensity;
            let error = (seen - stored.min(glam::Vec3::splat(intensity))).abs().max_element();
            assert!(error <= intensity / 254.0, "instance {i}: {seen} for {stored} of {intensity}");
            peak = peak.max(stored.max_element());
        }
        shown.push((peak, intensity));
    }
    let brightest = shown.iter().fold(0.0f32, |m, (_, intensity)| m.max(*intensity));
    let mut dim = shown.iter().filter(|(_, intensity)| *intensity < brightest / 8.0);
    assert!(dim.any(|(peak, _)| *peak > 0.0), "{shown:?}");
}

#[test]
fn a_scene_in_which_nothing_receives_comes_through_and_is_told_of() {
    let folder = folder(&[]);
    let (mut document, bin) = parts("cornell.glb");
    for node in document["nodes"].as_array_mut().unwrap() {
        node["extras"] = json!({"luxel_receive": false});
    }
    write_gltf(folder.path(), "a", document, &bin);
    quick(&["bake", "a.gltf"], folder.path()).ended(0);
    let outputs = Outputs::read(&folder.path().join("baked"), "a");
    assert_eq!(outputs.warnings("nothing-receives").len(), 1);
    assert!(outputs.scene.triangle_count() > 0 && outputs.lightmaps.is_empty());
    for stage in ["unwrap", "finish"] {
        assert_eq!(outputs.stage(stage).0, "left out", "{stage}");
    }
}

#[test]
fn the_papers_variants_are_other_light() {
    let folder = folder(&["cornell.glb"]);
    let bake = |flags: &[&str]| {
        quick(&[&["bake", "cornell.glb"], flags].concat(), folder.path()).ended(0);
        let outputs = Outputs::read(&folder.path().join("baked"), "cornell");
        assert_eq!(outputs.stage("propagate").0, "ran", "{flags:?}");
        outputs.report["quality"]["mean_indirect_lux"].as_f64().unwrap()
    };
    let plain = bake(&[]);
    let variants = [["--direction-set", "integer"], ["--rule", "literal"], ["--area", "faces"]];
    let light = variants.map(|flags| bake(&flags));
    assert!(light.iter().all(|l| *l > 0.0 && *l != plain), "{light:?}, not {plain}");
    assert!(light[1] < 0.9 * plain, "the literal rule loses light: {light:?}, {plain}");
}

#[test]
fn what_was_not_gathered_states_no_bound() {
    let folder = folder(&["cornell.glb"]);
    let flags = ["bake", "cornell.glb", "--only", "direct", "--gather", "lightcuts", "--bound"];
    quick(&flags, folder.path()).ended(0);
    let baked = folder.path().join("baked");
    let outputs = Outputs::read(&baked, "cornell");
    assert!(!baked.join("cornell.bound.exr").exists());
    assert!(outputs.report["quality"].get("mean_bound_lux").is_none());
    let told = outputs.warnings("no-bound");
    assert!(told.len() == 1 && told[0].contains("only"), "{told:?}");
}
