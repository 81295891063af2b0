//! Every single thing that a bake reads, changed for itself in a level that was baked: what a key misses shows here.

use std::collections::BTreeSet;

use luxel::settings::FIELDS;
use serde_json::{Value, json};

use crate::baked::{Place, clean, plan, run};
use crate::edits::SETTINGS;
use crate::level::{Level, SCENE, matte, object};

type Edit = (&'static str, fn(&mut Level));

/// Something of the only texture that a material has for its colour.
fn wall(level: &mut Level) -> &mut Value {
    &mut level.materials[1]["pbrMetallicRoughness"]["baseColorTexture"]
}

/// Edits that give other light. The order of lights and nodes is that of [`Level::rich`].
const EDITS: [Edit; 50] = [
    ("a lamp's name, the seed of its noise", |l| l.lights[1]["name"] = json!("torch")),
    ("whether a lamp's name is the first of its kind", |l| l.lights[0]["name"] = json!("lantern")),
    ("the weight of a lamp in its group", |l| l.lights[0]["intensity"] = json!(13.0)),
    ("the strength of the strongest lamp of a group", |l| l.lights[1]["intensity"] = json!(600.0)),
    ("the group of a lamp", |l| l.node("bulb")["extras"] = json!({ "luxel_group": "second" })),
    ("the range of a lamp", |l| l.lights[0]["range"] = json!(1.5)),
    ("the radius of a lamp", |l| l.lights[0]["extras"] = json!({ "luxel_radius": 0.3 })),
    ("the cone of a spot", |l| l.lights[1]["spot"]["outerConeAngle"] = json!(0.9)),
    ("the inner cone of a spot", |l| l.lights[1]["spot"]["innerConeAngle"] = json!(0.1)),
    ("the angle of the sun", |l| l.lights[3]["extras"] = json!({ "luxel_angle": 20.0 })),
    ("the direction of the sun", |l| l.node("sun")["rotation"] = json!([-0.6, 0.0, 0.0, 0.8])),
    ("the sun's weight in the sky's group", |l| l.lights[3]["intensity"] = json!(1.0)),
    ("the sky's weight in its group", |l| l.set("sky_strength", "0.5")),
    ("the sky's image", |l| l.sky = 5),
    ("how the sky is turned", |l| l.set("sky_rotation", "40")),
    ("another kind of sky", |l| l.set("sky", "\"1,2,3/1,1,1/0,0,0\"")),
    ("the name of what receives, the seed of its noise", |l| l.node("crate")["name"] = json!("box")),
    ("the name of what shines", |l| l.node("panel")["name"] = json!("ceiling")),
    ("the texel density of a node", |l| l.node("crate")["extras"] = json!({ "luxel_scale": 3.0 })),
    ("what receives", |l| l.node("crate")["extras"] = json!({ "luxel_receive": false })),
    ("what casts", |l| l.node("crate")["extras"] = json!({ "luxel_cast": false })),
    ("what is there", |l| l.node("crate")["extras"] = json!({ "luxel_ignore": true })),
    ("which parts are of one node", |l| {
        let at = l.nodes.iter().position(|n| n["name"] == "chest").unwrap();
        l.nodes[at]["mesh"] = json!(9);
        l.nodes.insert(at + 1, object("chest", 10, [1.0, 0.2, 0.4]));
    }),
    ("where an object is", |l| l.node("ball")["translation"] = json!([-1.2, 0.25, 0.9])),
    ("how it is turned", |l| l.node("ball")["rotation"] = json!([0.0, 0.6, 0.0, 0.8])),
    ("on which side of a mirror", |l| l.node("leaves")["scale"] = json!([-1.0, 1.0, 1.0])),
    ("the order of objects", |l| l.nodes.swap(3, 11)),
    ("a mesh", |l| l.shapes[8].size[1] = 0.4),
    ("normals", |l| l.shapes[3].normals = false),
    ("vertex colours", |l| l.shapes[8].colors = Some(4)),
    ("a layout", |l| l.shapes[7].has_layout = false),
    ("the material of a part", |l| l.shapes[7].materials[1] = 0),
    ("an albedo", |l| l.materials[3] = matte([0.1, 0.1, 0.9])),
    ("how metallic a surface is", |l| l.materials[7]["pbrMetallicRoughness"]["metallicFactor"] = json!(0.2)),
    ("how rough a metal is", |l| l.materials[7]["pbrMetallicRoughness"]["roughnessFactor"] = json!(0.2)),
    ("the texture of a metal", |l| {
        l.materials[7]["pbrMetallicRoughness"]["metallicRoughnessTexture"]["index"] = json!(3);
    }),
    ("how a texture is wrapped", |l| wall(l)["index"] = json!(0)),
    ("where a texture begins", |l| {
        wall(l)["extensions"]["KHR_texture_transform"]["offset"] = json!([0.75, 0.125]);
    }),
    ("how a texture is turned", |l| wall(l)["extensions"]["KHR_texture_transform"]["rotation"] = json!(1.5)),
    ("which coordinates a texture has", |l| {
        l.materials[7]["pbrMetallicRoughness"]["metallicRoughnessTexture"]["texCoord"] = json!(1);
    }),
    ("the image of a texture", |l| l.images[0] = 6),
    ("the image of holes and light", |l| l.images[1] = 7),
    ("where holes begin", |l| l.materials[4]["alphaCutoff"] = json!(0.8)),
    ("holes or a veil", |l| l.materials[4]["alphaMode"] = json!("BLEND")),
    ("the back of a surface", |l| l.materials[4]["doubleSided"] = json!(false)),
    ("how much light passes", |l| {
        l.materials[5]["extensions"]["KHR_materials_transmission"]["transmissionFactor"] = json!(0.2);
    }),
    ("the colour of a veil", |l| {
        l.materials[5]["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.1, 0.9, 0.1, 1.0])
    }),
    ("what light does to a surface", |l| l.materials[3]["extensions"] = json!({ "KHR_materials_unlit": {} })),
    ("the light of a surface", |l| l.materials[2]["emissiveFactor"] = json!([0.1, 0.8, 0.5])),
    ("the image of a surface's light", |l| l.materials[6]["emissiveTexture"]["index"] = json!(2)),
];

/// Bakes a level and then, from the same store, the same with every edit for itself. Each of them has to show in the
/// light, but those that are called unseen must not.
fn bakes(level: &Level, edits: impl Iterator<Item = (String, Level)>, unseen: &[(&str, &str)]) {
    let place = Place::new();
    let first = place.bake(level);
    let scene = place.at(SCENE);
    let mut wrong = Vec::new();
    for (what, edited) in edits {
        edited.write(place.folder.path());
        let planned = plan(&scene, &place.target());
        let baked = run(&scene, &place.target());
        let right = clean(&scene);
        let is_right = baked.is_same(&right).and_then(|()| baked.is_as(&planned)).and_then(|()| baked.forgot_nothing());
        wrong.extend(is_right.err().map(|why| format!("{what}: {why}")));
        match (first.light == right.light, unseen.iter().find(|(name, _)| *name == what)) {
            (true, None) => wrong.push(format!("{what}: the light is the same, so nothing was proved")),
            (false, Some((_, why))) => wrong.push(format!("{what}: the light differs although {why}")),
            (true, Some(_)) | (false, None) => {}
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn edited(level: &Level, edits: &[Edit]) -> impl Iterator<Item = (String, Level)> {
    edits.iter().map(|(what, edit)| {
        let mut edited = level.clone();
        edit(&mut edited);
        ((*what).to_owned(), edited)
    })
}

#[test]
fn every_edit_for_itself_is_baked_as_a_clean_bake_does() {
    // The names of lights seed photons.
    let mut level = Level::rich();
    level.set("photons", "1000");
    bakes(&level, edited(&level, &EDITS), &[]);
}

/// Where nothing reflects, the finished images follow from the sky's own light and its weight alone.
#[test]
fn a_sky_is_weighed_in_a_black_level_too() {
    let mut level = Level::rich();
    for material in &mut level.materials {
        material["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.0, 0.0, 0.0, 1.0]);
    }
    let edits: [Edit; 3] = [
        ("the sky's weight in its group", |l| l.set("sky_strength", "0.5")),
        ("the sun's weight in the sky's group", |l| l.lights[3]["intensity"] = json!(0.1)),
        ("the sky's image", |l| l.sky = 5),
    ];
    bakes(&level, edited(&level, &edits), &[]);
}

/// Settings that no light follows from.
const UNSEEN: [(&str, &str); 1] = [("bound", "it writes an image beside the light")];

/// Settings that are tried elsewhere.
const ELSEWHERE: [(&str, &str); 1] = [("threads", "it changes no byte and is in no key: see the stages")];

/// Of every setting one other value, in a level where it has an effect: the sequences see the rest.
#[test]
fn every_setting_for_itself_is_baked_as_a_clean_bake_does() {
    let named: BTreeSet<&str> = SETTINGS.iter().map(|(name, _)| *name).collect();
    let elsewhere = ELSEWHERE.iter().map(|(name, _)| *name);
    let all: BTreeSet<&str> = FIELDS.iter().map(|field| field.name).collect();
    assert_eq!(named.iter().copied().chain(elsewhere).collect::<BTreeSet<_>>(), all, "every setting has to be tried");

    let gathers = |mode: &str, spacing: &str| {
        let mut level = Level::rich();
        level.set("gather", mode);
        level.set("node_spacing", spacing);
        level
    };
    let (by_cuts, by_rays) = (gathers("\"lightcuts\"", "4"), gathers("\"final\"", "4"));
    for (level, is_of_it) in [(by_cuts, false), (by_rays, true)] {
        let settings = SETTINGS.iter().filter(|(name, _)| (*name == "gather_rays") == is_of_it);
        let other = settings.filter_map(|(name, values)| {
            let differs = |value: &&&str| level.settings.get(name).is_none_or(|was| was != *value);
            Some((*name, *values.iter().rfind(differs)?))
        });
        let edits = other.map(|(name, value)| {
            let mut edited = level.clone();
            edited.set(name, value);
            (name.to_owned(), edited)
        });
        bakes(&level, edits, &UNSEEN);
    }
}
