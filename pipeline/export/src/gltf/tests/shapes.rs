//! What a lightmapped scene must look like, shape by shape.

use serde_json::{Value, json};

use super::kit::{self, File, bake, import, raw, reread, split, triangles, whole};

/// The output passes the gltf crate's validation, and every lightmapped primitive is complete.
fn valid(glb: &crate::Glb) -> Value {
    let document = gltf::Gltf::from_slice(&glb.bytes).unwrap();
    let out = reread(glb);
    let root = Value::Object(out.root.clone());
    assert_eq!(root["buffers"].as_array().unwrap().len(), 1);
    assert!(root["buffers"][0].get("uri").is_none());
    for mesh in document.meshes() {
        for primitive in mesh.primitives() {
            let json = &root["meshes"][mesh.index()]["primitives"][primitive.index()];
            let material = primitive.material().index().map(|m| &root["materials"][m]);
            let lightmap = material.map(|m| &m["extensions"]["MOZ_lightmap"]).filter(|l| l.is_object());
            let Some(lightmap) = lightmap else { continue };
            assert_eq!(lightmap["texCoord"], 1);
            assert!(lightmap["intensity"].as_f64().unwrap() > 0.0);
            let sets = json["attributes"].as_object().unwrap().keys().filter(|k| k.starts_with("TEXCOORD_")).count();
            assert!((0..sets).all(|set| json["attributes"].get(format!("TEXCOORD_{set}")).is_some()), "a gap");
            let uv = primitive.get(&gltf::Semantic::TexCoords(1)).unwrap();
            let position = primitive.get(&gltf::Semantic::Positions).unwrap();
            assert_eq!(uv.count(), position.count());
            for accessor in primitive.attributes().map(|(_, a)| a) {
                let view = accessor.view().unwrap();
                assert_eq!((view.offset() + accessor.offset()) % 4, 0);
                assert_eq!(view.stride().unwrap_or(accessor.size()) % 4, 0);
            }
            for element in raw(&out, uv.index()) {
                for c in element.chunks(4) {
                    let x = f32::from_le_bytes(c.try_into().unwrap());
                    assert!((0.0..=1.0).contains(&x));
                }
            }
            assert!(triangles(&out, json).iter().flatten().all(|i| (*i as usize) < position.count()));
            let texture = &root["textures"][lightmap["index"].as_u64().unwrap() as usize];
            let image = &root["images"][texture["source"].as_u64().unwrap() as usize];
            let png = out.view(image["bufferView"].as_u64().unwrap() as usize).unwrap();
            assert_eq!(image::load_from_memory(png).unwrap().to_rgb8().dimensions(), (4, 4));
            let sampler = &root["samplers"][texture["sampler"].as_u64().unwrap() as usize];
            assert_eq!(*sampler, json!({"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}));
        }
    }
    root
}

/// Attribute values at the corners of all triangles, in order.
fn corners(original: &super::super::Original, primitive: &Value, semantic: &str) -> Vec<Vec<u8>> {
    let elements = raw(original, primitive["attributes"][semantic].as_u64().unwrap() as usize);
    triangles(original, primitive).iter().flatten().map(|i| elements[*i as usize].clone()).collect()
}

fn two_boxes() -> File {
    let mut file = File::new();
    let quad = file.quad(0.0);
    file.push("materials", json!({"name": "wall", "extras": {"keep": [1, 0.1]}}));
    let mut primitive = quad;
    primitive["material"] = 0.into();
    file.push("meshes", json!({"name": "box", "primitives": [primitive], "extras": {"m": 1}}));
    file.node(json!({"name": "a", "mesh": 0}));
    file.node(json!({"name": "b", "mesh": 0, "translation": [3.0, 0.0, 0.0], "extras": {"hp": 7}}));
    file
}

#[test]
fn two_nodes_of_one_mesh_get_a_mesh_each() {
    let original = two_boxes().read();
    let scene = import(&original);
    let glb = bake(&original, &scene, &split(&scene, 1));
    let root = valid(&glb);
    assert_eq!((root["nodes"][0]["mesh"].clone(), root["nodes"][1]["mesh"].clone()), (json!(0), json!(1)));
    let out = reread(&glb);
    for mesh in 0..2 {
        let (old, new) = (&original.root["meshes"][0]["primitives"][0], &root["meshes"][mesh]["primitives"][0]);
        for semantic in ["POSITION", "NORMAL", "TEXCOORD_0"] {
            assert_eq!(corners(&original, old, semantic), corners(&out, new, semantic));
        }
        assert_eq!(root["meshes"][mesh]["name"], "box");
        assert_eq!(root["meshes"][mesh]["extras"], json!({"m": 1}));
    }
    // Both copies share all vertices but the atlas coordinates, and the one material.
    let (a, b) = (&root["meshes"][0]["primitives"][0], &root["meshes"][1]["primitives"][0]);
    assert_eq!(a["attributes"]["POSITION"], b["attributes"]["POSITION"]);
    assert_ne!(a["attributes"]["TEXCOORD_1"], b["attributes"]["TEXCOORD_1"]);
    assert_eq!(root["materials"].as_array().unwrap().len(), 1);
    let material = &root["materials"][0];
    assert_eq!(material["name"], "wall");
    assert_eq!(material["extras"]["keep"], json!([1, 0.1]));
    let luxel = json!({"lightmap": "level.lightmap.0.exr", "page": 0, "unit": "lux", "version": "0.1.0"});
    assert_eq!(material["extras"]["luxel"], luxel);
    assert_eq!(root["extensionsUsed"], json!(["MOZ_lightmap"]));
    assert_eq!(root["nodes"][1]["extras"], json!({"hp": 7}));
    // The old four accessors made room: positions, normals, uvs and indices, and one more uv per copy.
    assert_eq!(root["accessors"].as_array().unwrap().len(), 6);
    assert_eq!(
        root["accessors"][a["attributes"]["POSITION"].as_u64().unwrap() as usize]["max"],
        json!([1.0, 1.0, 0.0])
    );
}

#[test]
fn the_same_scene_gives_the_same_bytes() {
    let original = two_boxes().read();
    let scene = import(&original);
    let atlas = split(&scene, 2);
    assert_eq!(bake(&original, &scene, &atlas).bytes, bake(&two_boxes().read(), &scene, &atlas).bytes);
}

#[test]
fn a_node_that_does_not_receive_keeps_the_old_mesh_and_material() {
    let original = two_boxes().read();
    let mut scene = import(&original);
    scene.instances[0].receives = false;
    let root = valid(&bake(&original, &scene, &split(&scene, 1)));
    assert_eq!((root["nodes"][0]["mesh"].clone(), root["nodes"][1]["mesh"].clone()), (json!(0), json!(1)));
    assert_eq!(root["meshes"][0], original.root["meshes"][0]);
    assert_eq!(root["materials"][0], original.root["materials"][0]);
    assert!(root["materials"][1]["extensions"]["MOZ_lightmap"].is_object());
}

#[test]
fn without_seams_the_vertices_stay_where_they_are() {
    let original = two_boxes().read();
    let scene = import(&original);
    let root = valid(&bake(&original, &scene, &whole(&scene, 1)));
    let (old, new) = (&original.root["meshes"][0]["primitives"][0], &root["meshes"][0]["primitives"][0]);
    for semantic in ["POSITION", "NORMAL", "TEXCOORD_0"] {
        assert_eq!(old["attributes"][semantic], new["attributes"][semantic]);
    }
}

#[test]
fn nothing_lightmapped_changes_nothing_but_the_container() {
    let mut file = two_boxes();
    file.root["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}]);
    let original = file.read();
    let mut scene = import(&original);
    scene.instances.iter_mut().for_each(|i| i.receives = false);
    let glb = bake(&original, &scene, &split(&scene, 1));
    assert_eq!(reread(&glb).root, original.root);
}

#[test]
fn several_pages_split_materials_and_number_the_nodes() {
    let original = two_boxes().read();
    let scene = import(&original);
    let glb = bake(&original, &scene, &split(&scene, 2));
    let root = valid(&glb);
    for node in 0..2 {
        assert_eq!(root["nodes"][node]["extras"]["lightmap"], node);
        let mesh = root["nodes"][node]["mesh"].as_u64().unwrap() as usize;
        let material = root["meshes"][mesh]["primitives"][0]["material"].as_u64().unwrap() as usize;
        let material = &root["materials"][material];
        assert_eq!(material["name"], "wall");
        assert_eq!(material["extras"]["luxel"]["page"], node);
        assert_eq!(material["extras"]["luxel"]["lightmap"], format!("level.lightmap.{node}.exr"));
    }
    assert_eq!(root["nodes"][1]["extras"]["hp"], 7);
    assert_eq!(root["samplers"].as_array().unwrap().len(), 1);
    assert_eq!((glb.pages[0].intensity, glb.pages[0].clipped), (15.0, 0));
}

#[test]
fn extras_that_are_no_object_stay_and_are_reported() {
    let mut file = two_boxes();
    file.root["nodes"][0]["extras"] = json!("a word");
    file.root["materials"][0]["extras"] = json!(3);
    let original = file.read();
    let scene = import(&original);
    let glb = bake(&original, &scene, &split(&scene, 2));
    let root = valid(&glb);
    assert_eq!(root["nodes"][0]["extras"], "a word");
    assert_eq!((&root["materials"][0]["extras"], &root["materials"][1]["extras"]), (&json!(3), &json!(3)));
    assert_eq!(root["textures"][1]["extras"]["luxel"]["lightmap"], "level.lightmap.1.exr");
    assert!(glb.notices.len() == 1 && glb.notices[0].message.contains("node 0 \"a\""), "{:?}", glb.notices);
}

#[test]
fn primitives_of_one_mesh_may_lie_on_different_pages() {
    let mut file = File::new();
    let (a, b) = (file.quad(0.0), file.quad(2.0));
    let points = json!({"attributes": {"POSITION": a["attributes"]["POSITION"]}, "mode": 0});
    file.push("meshes", json!({"primitives": [a, points, b]}));
    file.node(json!({"mesh": 0}));
    let original = file.read();
    let scene = import(&original);
    // Instances 0, 1, 2 are the three primitives; the points have no triangles and no place.
    let root = valid(&bake(&original, &scene, &split(&scene, 3)));
    assert_eq!(root["nodes"][0]["extras"]["lightmap"], json!([0, null, 2]));
    let primitives = root["meshes"][0]["primitives"].as_array().unwrap();
    assert_eq!(primitives[1], original.root["meshes"][0]["primitives"][1]);
    assert_ne!(primitives[0]["material"], primitives[2]["material"]);
    // Primitives without a material carry the lightmap on what they were baked with.
    let material = &root["materials"][primitives[0]["material"].as_u64().unwrap() as usize];
    assert_eq!(material["pbrMetallicRoughness"]["baseColorFactor"], json!([0.8, 0.8, 0.8, 1.0]));
    assert_eq!(material["pbrMetallicRoughness"]["metallicFactor"], json!(0.0));
}

#[test]
fn a_second_uv_set_that_textures_use_moves_with_them() {
    let mut file = File::new();
    let mut used = file.quad(0.0);
    let detail = file.floats("VEC2", &[0.5; 8]);
    used["attributes"]["TEXCOORD_1"] = detail.into();
    used["attributes"]["TEXCOORD_2"] = used["attributes"]["TEXCOORD_0"].clone();
    used["material"] = 0.into();
    let mut unused = file.quad(2.0);
    unused["attributes"]["TEXCOORD_1"] = detail.into();
    unused["material"] = 1.into();
    file.push("images", json!({"uri": "data:image/png;base64,AAAA"}));
    file.push("textures", json!({"source": 0}));
    let transform = json!({"KHR_texture_transform": {"texCoord": 1, "scale": [2.0, 2.0]}});
    file.push(
        "materials",
        json!({
            "occlusionTexture": {"index": 0, "texCoord": 1, "strength": 0.5},
            "emissiveTexture": {"index": 0, "extensions": transform},
            "normalTexture": {"index": 0},
            "extensions": {"VENDOR_x": {"grime": {"index": 0, "texCoord": 1}}}
        }),
    );
    file.push("materials", json!({"normalTexture": {"index": 0}}));
    file.root["extensionsUsed"] = json!(["KHR_texture_transform", "VENDOR_x"]);
    file.push("meshes", json!({"primitives": [used, unused]}));
    file.node(json!({"mesh": 0}));
    let original = file.read();
    let scene = import(&original);
    let glb = bake(&original, &scene, &split(&scene, 1));
    let root = valid(&glb);
    let out = reread(&glb);
    let primitives = &root["meshes"][0]["primitives"];
    let old = &original.root["meshes"][0]["primitives"];
    assert_eq!(corners(&original, &old[0], "TEXCOORD_1"), corners(&out, &primitives[0], "TEXCOORD_3"));
    let material = &root["materials"][primitives[0]["material"].as_u64().unwrap() as usize];
    assert_eq!(material["occlusionTexture"], json!({"index": 0, "texCoord": 3, "strength": 0.5}));
    assert_eq!(material["emissiveTexture"]["extensions"]["KHR_texture_transform"]["texCoord"], 3);
    assert_eq!(material["normalTexture"], json!({"index": 0}));
    assert_eq!(material["extensions"]["VENDOR_x"]["grime"]["texCoord"], 3);
    // Nothing looks at the other primitive's old set: it makes room.
    assert!(primitives[1]["attributes"].get("TEXCOORD_3").is_none());
}

#[test]
fn gpu_instances_become_nodes() {
    let mut file = File::new();
    let mut quad = file.quad(0.0);
    quad["material"] = file.push("materials", json!({"name": "wall"})).into();
    file.push("meshes", json!({"primitives": [quad]}));
    let at = file.floats("VEC3", &[0., 0., 0., 5., 0., 0., 9., 1., 2.]);
    let view = file.view(&[0, 0, 0, 127, 0, 90, 0, 90, 0, 0, 0, 127]);
    let turn = file.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5120, "normalized": true, "count": 3, "type": "VEC4"}),
    );
    let id = file.floats("SCALAR", &[10., 11., 12.]);
    let attributes = json!({"TRANSLATION": at, "ROTATION": turn, "_ID": id});
    let extension = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    let node = json!({"name": "crowd", "mesh": 0, "scale": [2.0, 2.0, 2.0], "extensions": extension.clone()});
    file.node(node);
    file.node(json!({"name": "far", "mesh": 0, "extensions": extension}));
    file.root["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
    file.root["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let original = file.read();
    let mut scene = import(&original);
    assert_eq!(scene.instances.len(), 6);
    let root = valid(&bake(&original, &scene, &split(&scene, 1)));
    assert!(root.get("extensionsRequired").is_none());
    assert_eq!(root["extensionsUsed"], json!(["MOZ_lightmap"]));
    let parent = &root["nodes"][0];
    assert_eq!(*parent, json!({"name": "crowd", "scale": [2.0, 2.0, 2.0], "children": [2, 3, 4]}));
    let child = &root["nodes"][3];
    assert_eq!((&child["name"], &child["translation"]), (&json!("crowd.1"), &json!([5.0, 0.0, 0.0])));
    let half = 0.5f64.sqrt();
    let turned: Vec<f64> = child["rotation"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    assert!(turned.iter().zip([0.0, half, 0.0, half]).all(|(a, b)| (a - b).abs() < 1e-12), "{turned:?}");
    assert_eq!(child["extras"]["instance"]["_ID"], json!([11.0]));
    let meshes: std::collections::BTreeSet<_> = (2..8).map(|n| root["nodes"][n]["mesh"].as_u64().unwrap()).collect();
    assert_eq!(meshes.len(), 6);

    // A list that does not receive stays a list; an instance without a place stays on the old mesh.
    scene.instances[1].receives = false;
    scene.instances[3..].iter_mut().for_each(|i| i.receives = false);
    let glb = bake(&original, &scene, &split(&scene, 1));
    let root = Value::Object(reread(&glb).root);
    assert_eq!(root["nodes"][1], original.root["nodes"][1]);
    assert_eq!(root["nodes"][3]["mesh"], 0);
    assert_eq!(root["meshes"][0], original.root["meshes"][0]);
    assert_eq!(root["extensionsRequired"], json!(["EXT_mesh_gpu_instancing"]));
}

#[test]
fn every_attribute_follows_its_vertex_in_its_own_type() {
    let mut file = File::new();
    let mut quad = file.quad(0.0);
    let joints = file.view(&[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]);
    let joints =
        file.push("accessors", json!({"bufferView": joints, "componentType": 5121, "count": 4, "type": "VEC4"}));
    let weights = file.floats("VEC4", &[0.25; 16]);
    // Three bytes in a stride of four.
    let colour = file.view(&[1, 2, 3, 99, 4, 5, 6, 99, 7, 8, 9, 99, 10, 11, 12, 99]);
    file.root["bufferViews"][colour]["byteStride"] = 4.into();
    let colour = file.push(
        "accessors",
        json!({"bufferView": colour, "componentType": 5121, "normalized": true, "count": 4, "type": "VEC3", "name": "c"}),
    );
    let temperature = file.floats("SCALAR", &[20., 21., 22., 23.]);
    // A morph target without data of its own: zeros, but for two sparse elements.
    let indices = file.view(&[1, 0, 3, 0]);
    let values: Vec<u8> = [1.0f32, 2., 3., -4., 5., 6.].iter().flat_map(|v| v.to_le_bytes()).collect();
    let values = file.view(&values);
    let target = file.push(
        "accessors",
        json!({"componentType": 5126, "count": 4, "type": "VEC3", "min": [-4.0, 0.0, 0.0], "max": [1.0, 5.0, 6.0],
            "sparse": {"count": 2, "indices": {"bufferView": indices, "componentType": 5123},
                "values": {"bufferView": values}}}),
    );
    for (k, v) in [("JOINTS_0", joints), ("WEIGHTS_0", weights), ("COLOR_0", colour), ("_TEMPERATURE", temperature)] {
        quad["attributes"][k] = v.into();
    }
    // Deltas of the old second set have no meaning for atlas coordinates.
    let drift = file.floats("VEC2", &[0.1; 8]);
    quad["attributes"]["TEXCOORD_1"] = drift.into();
    quad["targets"] = json!([{"POSITION": target, "TEXCOORD_1": drift}]);
    file.push("meshes", json!({"primitives": [quad], "weights": [0.5]}));
    file.node(json!({"mesh": 0}));
    let original = file.read();
    let scene = import(&original);
    let glb = bake(&original, &scene, &split(&scene, 1));
    let root = valid(&glb);
    let out = reread(&glb);
    let (old, new) = (&original.root["meshes"][0]["primitives"][0], &root["meshes"][0]["primitives"][0]);
    for semantic in ["POSITION", "JOINTS_0", "WEIGHTS_0", "COLOR_0", "_TEMPERATURE"] {
        assert_eq!(corners(&original, old, semantic), corners(&out, new, semantic), "{semantic}");
    }
    let colour = &root["accessors"][new["attributes"]["COLOR_0"].as_u64().unwrap() as usize];
    assert_eq!(
        (&colour["componentType"], &colour["normalized"], &colour["name"]),
        (&json!(5121), &json!(true), &json!("c"))
    );
    assert_eq!(new["targets"][0].as_object().unwrap().len(), 1);
    let target = new["targets"][0]["POSITION"].as_u64().unwrap() as usize;
    let moved: Vec<f32> = raw(&out, target).iter().map(|e| f32::from_le_bytes(e[..4].try_into().unwrap())).collect();
    assert_eq!(moved, [0.0, 1.0, 0.0, 0.0, 0.0, -4.0]);
    assert_eq!(root["accessors"][target]["min"], json!([-4.0, 0.0, 0.0]));
    assert!(root["accessors"][target].get("sparse").is_none());
    assert_eq!(root["meshes"][0]["weights"], json!([0.5]));
}

#[test]
fn strips_and_unindexed_triangles_become_lists() {
    let mut file = File::new();
    let mut strip = file.quad(0.0);
    strip["mode"] = 5.into();
    strip["indices"] = file.indices(&[0, 1, 3, 2]).into();
    let position = file.floats("VEC3", &[0., 0., 0., 1., 0., 0., 0., 1., 0.]);
    let plain = json!({"attributes": {"POSITION": position}});
    file.push("meshes", json!({"primitives": [strip, plain]}));
    file.node(json!({"mesh": 0}));
    let original = file.read();
    let scene = import(&original);
    let glb = bake(&original, &scene, &split(&scene, 1));
    let root = valid(&glb);
    let out = reread(&glb);
    for p in 0..2 {
        let (old, new) = (&original.root["meshes"][0]["primitives"][p], &root["meshes"][0]["primitives"][p]);
        assert_eq!(new.get("mode").and_then(Value::as_u64).unwrap_or(4), 4);
        assert_eq!(corners(&original, old, "POSITION"), corners(&out, new, "POSITION"));
    }
}

#[test]
fn variants_carry_the_lightmap_too() {
    let mut file = two_boxes();
    file.push("materials", json!({"name": "red"}));
    file.root["meshes"][0]["primitives"][0]["extensions"] =
        json!({"KHR_materials_variants": {"mappings": [{"material": 1, "variants": [0]}]}});
    file.root["extensions"] = json!({"KHR_materials_variants": {"variants": [{"name": "v"}]}});
    file.root["extensionsUsed"] = json!(["KHR_materials_variants"]);
    let original = file.read();
    let scene = import(&original);
    let root = valid(&bake(&original, &scene, &kit::split(&scene, 1)));
    let mapping = &root["meshes"][1]["primitives"][0]["extensions"]["KHR_materials_variants"]["mappings"][0];
    let material = &root["materials"][mapping["material"].as_u64().unwrap() as usize];
    assert_eq!(material["name"], "red");
    assert!(material["extensions"]["MOZ_lightmap"].is_object());
    assert_eq!(root["materials"].as_array().unwrap().len(), 2);
}
