//! Hostile input through the whole tool: whatever the file holds, a bake ends soon, with finite light or with a message
//! that names the file; never with a panic, a hang, or memory that the file's size does not account for.

mod tool;

use std::path::Path;
use std::time::{Duration, Instant};

use glam::{DAffine3, DMat3, DVec3, Vec3};
use luxel::settings::{Only, Preset, Resolved, Settings, resolve, value::*};
use luxel::{Error, Request, bake, bake_scene, plan_file};
use luxel_export::{ExportError, OutputSet};
use luxel_scene::{Instance, LightKind, Material, Mesh, Scene, Silent, Sky, build::Builder};
use proptest::prelude::*;
use serde_json::{Value, json};
use tool::{asset, luxel, parts};

/// The least work that still runs every stage.
fn tiny() -> Settings {
    Settings {
        size: Texels(32),
        voxels: Voxels::Budget(200),
        directions: Samples(16),
        bounces: Samples(4),
        near_rays: Samples(1),
        sky_rays: Samples(4),
        shadow_samples: Samples(1),
        threads: Threads(1),
        ..Settings::preset(Preset::Draft)
    }
}

/// Bakes a file as the binary does, within this process.
fn bake_file(path: &Path) -> Result<(), Error> {
    let mut settings = resolve(&[]).unwrap();
    settings.settings = tiny();
    let outputs = OutputSet::new(path, None, None).unwrap();
    let baked = bake(
        &Request {
            scene: path.into(),
            outputs,
            settings,
            worker: None,
            store: Default::default(),
            kept: Default::default(),
        },
        &Silent,
    )?;
    for file in baked.files.iter().filter(|file| file.extension().is_some_and(|e| e == "exr")) {
        tool::lightmap(file);
    }
    Ok(())
}

/// A damaged file is baked or refused by name, soon.
fn survives(bytes: &[u8]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.glb");
    std::fs::write(&path, bytes).unwrap();
    let start = Instant::now();
    if let Err(error) = bake_file(&path) {
        let said = told(&error);
        assert!(!matches!(error, Error::Internal { .. }), "{said}");
        if let Error::Import(error) | Error::Export(ExportError::Scene(error)) = &error {
            assert!(said.contains("damaged.glb"), "{said}");
            assert!(is_place(&error.fault.place), "{said}");
            assert!(!error.fault.what.is_empty() && !error.fault.hint.is_empty(), "{said}");
        }
    }
    assert!(start.elapsed() < Duration::from_secs(30), "it took {:?}", start.elapsed());
}

/// The message with its causes.
fn told(error: &Error) -> String {
    let mut said = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(e) = cause {
        said = format!("{said}: {e}");
        cause = e.source();
    }
    said
}

/// A place within a glTF file, as messages name it; none is the file as a whole, which is no glTF at all.
fn is_place(place: &str) -> bool {
    const KINDS: [&str; 20] = [
        "accessor",
        "animation",
        "asset",
        "buffer",
        "bufferView",
        "camera",
        "extensionsRequired",
        "GLB",
        "image",
        "JSON",
        "light",
        "lights",
        "material",
        "mesh",
        "node",
        "sampler",
        "scene",
        "skin",
        "texture",
        "extras",
    ];
    place.is_empty() || place.split(' ').next().is_some_and(|kind| KINDS.contains(&kind))
}

fn glb(document: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut out = b"glTF".to_vec();
    out.extend(2u32.to_le_bytes());
    out.extend((28 + text.len() as u32 + bin.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text[..]), (b"BIN\0", bin)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    /// Vertices, indices and images become noise: mostly still a scene, and a wild one.
    #[test]
    fn damaged_geometry_bakes_or_is_refused(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        textured in any::<bool>(),
    ) {
        let (document, mut bin) = parts(if textured { "textured_room.glb" } else { "cornell.glb" });
        for (at, byte) in edits {
            let i = at.index(bin.len());
            bin[i] = byte;
        }
        survives(&glb(&document, &bin));
    }

    /// Numbers of the document become other numbers.
    #[test]
    fn wild_numbers_bake_or_are_refused(
        edits in prop::collection::vec((any::<prop::sample::Index>(), number()), 1..4),
    ) {
        let (mut document, bin) = parts("cornell.glb");
        let mut places = Vec::new();
        numbers(&document, String::new(), &mut places);
        for (at, value) in edits {
            *document.pointer_mut(&places[at.index(places.len())]).unwrap() = value;
        }
        survives(&glb(&document, &bin));
    }

    #[test]
    fn bytes_anywhere_and_cuts_bake_or_are_refused(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..3),
        keep in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let mut bytes = std::fs::read(asset("cornell.glb")).unwrap();
        for (at, byte) in edits {
            let i = at.index(bytes.len());
            bytes[i] = byte;
        }
        if cut {
            bytes.truncate(keep.index(bytes.len()));
        }
        survives(&bytes);
    }
}

fn number() -> impl Strategy<Value = Value> {
    prop_oneof![
        Just(json!(0)),
        Just(json!(-1)),
        Just(json!(1e-30)),
        Just(json!(1e18)),
        Just(json!(-1e30)),
        Just(json!(1e300)),
        Just(json!(4294967295u64)),
        Just(json!(u64::MAX)),
        (0u64..20).prop_map(|n| json!(n)),
        (-10.0f64..10.0).prop_map(|f| json!(f)),
    ]
}

/// JSON pointers to all numbers.
fn numbers(value: &Value, at: String, out: &mut Vec<String>) {
    match value {
        Value::Array(values) => values.iter().enumerate().for_each(|(i, v)| numbers(v, format!("{at}/{i}"), out)),
        Value::Object(map) => map.iter().for_each(|(k, v)| numbers(v, format!("{at}/{k}"), out)),
        Value::Number(_) => out.push(at),
        _ => {}
    }
}

/// Bakes a scene in memory under a sky and with every stage; its light is finite and not negative, and so are its direct
/// and its indirect part, each baked alone.
fn bakes(mut scene: Scene) -> luxel::Lit {
    scene.sky = Sky::Constant(Vec3::ONE);
    let bake = |only| {
        let settings = Settings { sky: SkySetting::Constant(Vec3::ONE), only, ..tiny() };
        let start = Instant::now();
        let lit = bake_scene(&scene, &settings, &Silent).unwrap_or_else(|e| panic!("{}: {e:?}", scene.name));
        assert!(start.elapsed() < Duration::from_secs(20), "{}: {:?}", scene.name, start.elapsed());
        let images = lit.lightmaps.iter().flat_map(|map| map.irradiance());
        for e in images.chain(&lit.texels.irradiance) {
            assert!(e.is_finite() && e.min_element() >= 0.0, "{}, {only:?}: {e}", scene.name);
        }
        lit
    };
    let [all, direct, indirect] = [Only::All, Only::Direct, Only::Indirect].map(bake);
    let parts = direct.texels.irradiance.iter().zip(&indirect.texels.irradiance).map(|(d, i)| *d + *i);
    assert!(parts.eq(all.texels.irradiance.iter().copied()), "{}: the parts are not the whole", scene.name);
    all
}

fn brightest(lit: &luxel::Lit) -> f32 {
    lit.lightmaps.iter().flat_map(|m| m.irradiance()).map(|e| e.max_element()).fold(0.0, f32::max)
}

#[test]
fn nothing_and_next_to_nothing() {
    assert!(bakes(Scene::default()).lightmaps.is_empty());
    let mut b = Builder::new("a single triangle");
    let white = b.matte(Vec3::ONE);
    b.mesh("t", vec![Vec3::ZERO, Vec3::X, Vec3::Z], vec![[0, 2, 1]], white);
    let lit = bakes(b.build());
    assert!((brightest(&lit) - std::f32::consts::PI).abs() < 0.2, "open to half the sky: {}", brightest(&lit));

    let mut b = Builder::new("no area at all");
    let white = b.matte(Vec3::ONE);
    b.mesh("point", vec![Vec3::ONE; 3], vec![[0, 1, 2]; 5], white);
    b.mesh("line", vec![Vec3::ZERO, Vec3::X, Vec3::X * 2.0], vec![[0, 1, 2]], white);
    b.mesh("none", vec![], vec![], white);
    b.light("l", LightKind::Point { position: DVec3::ZERO, range: None, radius: 0.0 }, Vec3::ONE);
    bakes(b.build());
}

/// A closed box with a lamp in it, placed by `transform`.
fn lamp_box(name: &str, transform: DAffine3) -> Scene {
    let mut b = Builder::new(name);
    let grey = b.matte(Vec3::splat(0.5));
    let glow = b.emitter(Vec3::splat(0.5), Vec3::ONE);
    b.cuboid("shell", Vec3::ZERO, Vec3::ONE, grey, true);
    b.cuboid("lamp", Vec3::new(0.4, 0.8, 0.4), Vec3::new(0.6, 0.9, 0.6), glow, false);
    luxel_scene::build::transformed(b.build(), transform)
}

#[test]
fn a_millimetre_a_thousand_kilometres_away() {
    let near = brightest(&bakes(lamp_box("near", DAffine3::IDENTITY)));
    let place = DAffine3::from_scale_rotation_translation(DVec3::splat(1e-3), glam::DQuat::IDENTITY, DVec3::splat(1e6));
    let far = brightest(&bakes(lamp_box("far and small", place)));
    assert!((near - far).abs() < 0.05 * near, "{near} and {far}");
}

#[test]
fn transforms_that_flatten_or_explode() {
    let flat = DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(1.0, 0.0, 1.0)));
    let gone = DAffine3::from_mat3(DMat3::ZERO);
    let skewed = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::X + DVec3::Y * 1e-12, DVec3::Z));
    let needle = DAffine3::from_scale(DVec3::new(1e9, 1e-9, 1.0));
    for (name, transform) in [("flat", flat), ("gone", gone), ("skewed", skewed), ("needle", needle)] {
        let mut scene = lamp_box(name, DAffine3::IDENTITY);
        for instance in &mut scene.instances {
            instance.transform = transform * instance.transform;
        }
        bakes(scene);
    }
}

#[test]
fn absurd_materials_and_lights() {
    let mut b = Builder::new("absurd");
    let bright =
        b.material(Material { emission: Vec3::splat(1e20), base_color: Vec3::ONE.extend(1.0), ..Material::default() });
    let faint = b.material(Material { emission: Vec3::splat(1e-38), ..Material::default() });
    b.cuboid("shell", Vec3::ZERO, Vec3::ONE, bright, true);
    b.cuboid("inner", Vec3::splat(0.4), Vec3::splat(0.6), faint, false);
    let inside = LightKind::Point { position: DVec3::splat(0.5), range: Some(1e-30), radius: 0.0 };
    b.light("buried", inside, Vec3::splat(1e20));
    b.light("at a corner", LightKind::Point { position: DVec3::ZERO, range: None, radius: 1e6 }, Vec3::ONE);
    b.light("sun", LightKind::Sun { direction: DVec3::Y, angle: std::f64::consts::PI }, Vec3::splat(1e20));
    bakes(b.build());
}

#[test]
fn a_pile_of_equal_triangles() {
    let mut b = Builder::new("pile");
    let white = b.matte(Vec3::splat(0.9));
    b.mesh("pile", vec![Vec3::ZERO, Vec3::Z, Vec3::X], vec![[0, 1, 2]; 2000], white);
    // Equal triangles never share a texel: each has a chart, for which a small page has no room.
    let scene = b.build();
    let error = bake_scene(&scene, &tiny(), &Silent).unwrap_err();
    assert!(told(&error).contains("\"pile\" has 2000 charts"), "{}", told(&error));
    bake_scene(&scene, &Settings { size: Texels(512), ..tiny() }, &Silent).unwrap();
    // And the same mesh in one place a thousand times.
    let mut scene = lamp_box("crowd", DAffine3::IDENTITY);
    let one = scene.instances[1].clone();
    scene.instances.extend((0..300).map(|i| Instance { node: 2 + i, ..one.clone() }));
    let settings = Settings { size: Texels(256), ..tiny() };
    let lit = bake_scene(&scene, &settings, &Silent).unwrap();
    assert!(lit.lightmaps.iter().flat_map(|m| m.irradiance()).all(|e| e.is_finite()));
}

#[test]
fn long_thin_and_far_apart() {
    let mut b = Builder::new("slivers");
    let white = b.matte(Vec3::splat(0.5));
    let sliver = |i: u32| {
        let x = i as f32 * 1e-3;
        [Vec3::new(x, 0.0, 0.0), Vec3::new(x + 1e-7, 0.0, 0.0), Vec3::new(x, 0.0, 1e3)]
    };
    let positions: Vec<Vec3> = (0..500).flat_map(sliver).collect();
    b.mesh("slivers", positions, (0..500).map(|i| [3 * i, 3 * i + 2, 3 * i + 1]).collect(), white);
    b.quad("far", Vec3::splat(1e7), Vec3::X, Vec3::NEG_Z, white);
    bakes(b.build());
    let mesh = Mesh { positions: vec![Vec3::splat(f32::MAX), Vec3::splat(-f32::MAX), Vec3::X], ..Mesh::default() };
    let mut b = Builder::new("the whole range of numbers");
    let white = b.matte(Vec3::ONE);
    b.add(Mesh { triangles: vec![[0, 1, 2]], material: white, ..mesh });
    let scene = b.build();
    if let Err(error) = bake_scene(&scene, &tiny(), &Silent) {
        assert!(error.to_string().contains("texels") || error.to_string().contains("surfels"), "{error}");
    }
}

/// Refused by the binary with exit code 1, with the file, and with the word.
fn refused(name: &str, bytes: &[u8], word: &str) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(name), bytes).unwrap();
    for command in ["plan", "bake"] {
        let start = Instant::now();
        let run = luxel(&[command, name], folder.path()).ended(1);
        assert!(run.stderr.contains(name) && run.stderr.contains(word), "{word}: {}", run.stderr);
        assert!(start.elapsed() < Duration::from_secs(20), "{name}: {:?}", start.elapsed());
    }
    assert_eq!(tool::files(folder.path()).len(), 1, "a refused scene leaves nothing");
}

#[test]
fn bombs_are_refused_by_the_binary() {
    let (document, bin) = parts("textured_room.glb");
    let with = |change: &dyn Fn(&mut Value)| {
        let mut document = document.clone();
        change(&mut document);
        glb(&document, &bin)
    };
    refused(
        "claims.glb",
        &with(&|d| {
            d["accessors"][0].as_object_mut().unwrap().remove("bufferView");
            d["accessors"][0]["count"] = json!(4_000_000_000u64);
        }),
        "accessor",
    );
    refused("cycle.glb", &with(&|d| d["nodes"][0]["children"] = json!([0])), "node 0");
    let deep = format!("{}{}", "[".repeat(200_000), "]".repeat(200_000));
    refused("deep.gltf", format!(r#"{{"asset":{{"version":"2.0"}},"extras":{deep}}}"#).as_bytes(), "JSON");
    refused("empty.glb", b"", "empty.glb");
    refused("header.glb", b"glTF\x02\0\0\0\xff\xff\xff\xff\xff\xff\xff\xffJSON", "header.glb");
    refused("noise.gltf", &[0xff; 4096], "JSON");
    refused(
        "nan.glb",
        &{
            let mut bin = bin.clone();
            let at = document["bufferViews"][0]["byteOffset"].as_u64().unwrap_or(0) as usize;
            bin[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
            glb(&document, &bin)
        },
        "not finite",
    );
    refused(
        "glare.glb",
        &with(&|d| {
            for material in d["materials"].as_array_mut().unwrap() {
                material["emissiveFactor"] = json!([1, 1, 1]);
                material["extensions"] = json!({"KHR_materials_emissive_strength": {"emissiveStrength": 1e30}});
            }
        }),
        "beyond",
    );
    // A picture of 60000 × 60000 in 60 bytes.
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\xea\x60\0\0\xea\x60\x08\x06\0\0\0".to_vec();
    png.extend([0; 31]);
    refused(
        "image.glb",
        &{
            let (mut document, mut bin) = (document.clone(), bin.clone());
            let view = document["images"][0]["bufferView"].as_u64().unwrap() as usize;
            let view = &mut document["bufferViews"][view];
            view["byteOffset"] = json!(bin.len());
            view["byteLength"] = json!(png.len());
            bin.extend(&png);
            document["buffers"][0]["byteLength"] = json!(bin.len());
            glb(&document, &bin)
        },
        "image 0",
    );
}

#[test]
fn what_only_the_export_reads_is_refused_before_anything_is_baked() {
    let (mut document, bin) = parts("cornell.glb");
    let views = document["bufferViews"].as_array_mut().unwrap();
    // Nothing refers to this view, so no mesh needs its bytes; the .glb of the bake would carry it on.
    views.push(json!({"buffer": 0, "byteOffset": bin.len() - 4, "byteLength": 400}));
    let place = format!("bufferView {}", views.len() - 1);
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.glb"), glb(&document, &bin)).unwrap();
    let run = luxel(&["bake", "a.glb", "--json"], folder.path()).ended(1);
    let failed = run.stdout.lines().find(|l| l.contains("\"failed\"")).unwrap();
    assert!(failed.contains(&place) && failed.contains("a.glb"), "{failed}");
    assert!(!run.stdout.contains("unwrap"), "it fails early: {}", run.stdout);
}

#[test]
fn every_cut_of_a_file_is_refused_by_name() {
    let bytes = std::fs::read(asset("two_rooms.glb")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.glb");
    let resolved = Resolved { settings: tiny(), ..Resolved::default() };
    for length in (0..bytes.len()).step_by(37).chain([bytes.len() - 1]) {
        std::fs::write(&path, &bytes[..length]).unwrap();
        let error = plan_file(&path, None, &resolved, &Silent).expect_err("a cut file is no scene").to_string();
        assert!(error.contains("cut.glb"), "{error}");
    }
    std::fs::write(&path, &bytes).unwrap();
    plan_file(&path, None, &resolved, &Silent).unwrap();
}
