//! KHR_lights_punctual: point, spot and directional lights in the world.

use glam::{DAffine3, DVec3, Vec3};
use serde_json::Value;

use super::document::Document;
use super::error::{Checked, Fault, place};
use super::extras::{Keys, group_name};
use super::nodes::Visit;
use super::notes::Notes;
use super::options::ImportOptions;
use super::power::BRIGHTEST;
use super::transform::MAX_COORDINATE;
use crate::{Light, LightKind};

const EXTENSION: &str = "KHR_lights_punctual";

/// Index of the light that a node carries.
pub fn on_node(document: &Document, node: usize) -> Checked<Option<usize>> {
    let others = document.root.nodes.get(node).and_then(|n| n.extensions.as_ref()).map(|e| &e.others);
    let Some(object) = others.and_then(|o| o.get(EXTENSION)) else { return Ok(None) };
    let index = object.get("light").and_then(Value::as_u64).and_then(|i| usize::try_from(i).ok());
    let index = index.filter(|&i| i < definitions(document).len());
    index.map(Some).ok_or_else(|| {
        Fault::invalid(document.node_place(node), format!("its light {} does not exist", object["light"]))
    })
}

/// All lights that the document defines.
fn definitions(document: &Document) -> &[Value] {
    let others = document.root.extensions.as_ref().map(|e| &e.others);
    let lights = others.and_then(|o| o.get(EXTENSION)?.get("lights")?.as_array());
    lights.map_or(&[], Vec::as_slice)
}

/// Places a light. A node's scale is ignored, as the extension asks; luxel's own sizes are in scene units.
pub fn read(
    document: &Document,
    visit: &Visit,
    index: usize,
    options: &ImportOptions,
    notes: &mut Notes,
) -> Checked<Option<Light>> {
    let Some(light) = definitions(document).get(index) else { return Ok(None) };
    let at = place("light", index, light.get("name").and_then(Value::as_str));
    let at = format!("{at} on {}", document.node_place(visit.node));
    let intensity = intensity(light, options, &at, notes)?;
    let own = light.get("extras").map_or(Keys::default(), |extras| Keys::from_value(extras, &at, notes));
    let radius = visit.keys.radius.or(own.radius).unwrap_or(options.lamp_radius);
    let angle = visit.keys.angle.or(own.angle).unwrap_or(options.sun_angle).to_radians();
    let position = visit.world.translation;
    if position.abs().max_element() > MAX_COORDINATE {
        return Err(Fault::invalid(at, "it is too far away to compute with"));
    }
    let range = range(light, &at, notes)?;
    let kind = match light.get("type").and_then(Value::as_str) {
        Some("point") => LightKind::Point { position, range, radius },
        Some(kind @ ("spot" | "directional")) => {
            let Some(direction) = forward(&visit.world) else {
                notes.add("light-without-direction", format!("{at}: its node has no direction; it is left out"));
                return Ok(None);
            };
            if kind == "directional" {
                LightKind::Sun { direction, angle }
            } else {
                let (inner, outer) = cone(light, &at, notes)?;
                LightKind::Spot { position, direction, inner, outer, range, radius }
            }
        }
        other => {
            let what = format!("its type is {}", other.map_or("missing".into(), super::error::quoted));
            return Err(Fault::invalid(at, format!("{what}, not point, spot or directional")));
        }
    };
    let named = light.get("name").and_then(Value::as_str).filter(|name| !name.is_empty());
    let node = document.own_node_name(visit.node);
    // By its name a light is known again after an edit: a node's number would change with the nodes before it.
    let name = named.or(node).unwrap_or("light").to_owned();
    let group = visit.keys.group.clone().or(own.group).or_else(|| visit.extras.group.clone());
    let group = group.or_else(|| [node, named].into_iter().flatten().find_map(group_name));
    let group = group.unwrap_or_else(|| document.node_place(visit.node).into());
    Ok(Some(Light { name, node: visit.node, group, kind, intensity }))
}

/// −Z of the node in the world, a unit vector.
pub fn forward(world: &DAffine3) -> Option<DVec3> {
    (-world.matrix3.z_axis).try_normalize()
}

fn intensity(light: &Value, options: &ImportOptions, at: &str, notes: &mut Notes) -> Checked<Vec3> {
    let wrong = |what: &str| Fault::invalid(at, format!("its {what} is wrong"));
    let mut color = Vec3::ONE;
    if let Some(value) = light.get("color") {
        let values = value.as_array().filter(|a| a.len() == 3).ok_or_else(|| wrong("color"))?;
        for (i, value) in values.iter().enumerate() {
            color[i] = value.as_f64().ok_or_else(|| wrong("color"))? as f32;
        }
    }
    let strength = number(light, "intensity", at)?.unwrap_or(1.0) as f32;
    let intensity = color * strength * options.light_scale;
    if !intensity.is_finite() {
        return Err(wrong("intensity or color"));
    }
    if intensity.max_element() > BRIGHTEST {
        return Err(Fault::invalid(
            at,
            format!("its intensity of {:e} is beyond {BRIGHTEST:e}", intensity.max_element()),
        ));
    }
    if intensity.min_element() < 0.0 {
        notes.add("negative-light", format!("{at}: its intensity is negative and counts as 0"));
    }
    Ok(intensity.max(Vec3::ZERO))
}

fn range(light: &Value, at: &str, notes: &mut Notes) -> Checked<Option<f64>> {
    let range = number(light, "range", at)?;
    if range.is_some_and(|r| r <= 0.0) {
        notes.add("light-range", format!("{at}: a range has to be positive; it counts as unlimited"));
        return Ok(None);
    }
    Ok(range)
}

/// Inner and outer half angle of a spot [rad], brought into 0 ≤ inner < outer ≤ π/2.
fn cone(light: &Value, at: &str, notes: &mut Notes) -> Checked<(f64, f64)> {
    let (right, quarter) = (std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_4);
    let empty = Value::Null;
    let spot = light.get("spot").unwrap_or(&empty);
    let inner = number(spot, "innerConeAngle", at)?.unwrap_or(0.0);
    let outer = number(spot, "outerConeAngle", at)?.unwrap_or(quarter);
    // Exporters write the outer angle as π/2 in single precision, slightly too large.
    let outer_fits = outer > 0.0 && outer <= right + 1e-6;
    if !outer_fits || inner < 0.0 || inner > outer {
        notes.add(
            "spot-cone",
            format!("{at}: cone angles of {inner} and {outer} rad are brought into 0 ≤ inner < outer ≤ π/2"),
        );
    }
    let outer = outer.clamp(1e-4, right);
    Ok((inner.clamp(0.0, outer * (1.0 - 1e-6)), outer))
}

fn number(object: &Value, key: &str, at: &str) -> Checked<Option<f64>> {
    let Some(value) = object.get(key) else { return Ok(None) };
    let number = value.as_f64().filter(|n| n.is_finite());
    number.map(Some).ok_or_else(|| Fault::invalid(at, format!("its {key} is not a number")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::nodes::walk;
    use crate::import::options::Limits;

    fn lights(nodes: &str, lights: &str) -> Checked<Vec<Light>> {
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"nodes":{nodes},"extensions":{{"{EXTENSION}":{{"lights":{lights}}}}}}}"#
        );
        let document = Document::parse(json.as_bytes(), &Limits::default())?;
        let options = ImportOptions { light_scale: 2.0, lamp_radius: 0.5, sun_angle: 1.0, ..ImportOptions::default() };
        let mut notes = Notes::default();
        let mut out = Vec::new();
        for visit in walk(&document, &mut notes)? {
            if let Some(index) = on_node(&document, visit.node)? {
                out.extend(read(&document, &visit, index, &options, &mut notes)?);
            }
        }
        Ok(out)
    }

    const ON_NODE: &str = r#""extensions":{"KHR_lights_punctual":{"light":0}}"#;

    #[test]
    fn a_spot_in_the_world() {
        let half = 0.5f64.sqrt();
        // A quarter turn about −X takes −Z to −Y.
        let nodes = format!(
            r#"[{{"translation":[1,2,3],"rotation":[{},0,0,{half}],"scale":[7,7,7],{ON_NODE},"extras":{{"luxel_radius":0.25}}}}]"#,
            -half
        );
        let lamp = r#"[{"type":"spot","color":[1,0.5,0],"intensity":10,"range":4,
                        "spot":{"innerConeAngle":0.2,"outerConeAngle":0.4},"extras":{"luxel_radius":9}}]"#;
        let light = &lights(&nodes, lamp).unwrap()[0];
        assert_eq!(light.intensity, Vec3::new(20.0, 10.0, 0.0));
        let LightKind::Spot { position, direction, inner, outer, range, radius } = light.kind else { panic!() };
        assert_eq!((position, inner, outer, range), (DVec3::new(1.0, 2.0, 3.0), 0.2, 0.4, Some(4.0)));
        assert!((direction - DVec3::NEG_Y).length() < 1e-12, "{direction}");
        assert_eq!(radius, 0.25, "the node's radius wins, and is not scaled");
    }

    #[test]
    fn a_sun_has_an_angle_and_defaults_hold() {
        let nodes = format!(r#"[{{{ON_NODE}}}]"#);
        let sun = r#"[{"type":"directional","extras":{"luxel_angle":0.53}}]"#;
        let light = &lights(&nodes, sun).unwrap()[0];
        let LightKind::Sun { direction, angle } = light.kind else { panic!() };
        assert_eq!((direction, light.intensity), (DVec3::NEG_Z, Vec3::splat(2.0)));
        assert!((angle - 0.53f64.to_radians()).abs() < 1e-15);
        let spot = &lights(&nodes, r#"[{"type":"spot","spot":{}}]"#).unwrap()[0];
        let LightKind::Spot { inner, outer, radius, .. } = spot.kind else { panic!() };
        assert_eq!(radius, 0.5, "a lamp without a radius of its own has that of the options");
        let LightKind::Sun { angle, .. } = lights(&nodes, r#"[{"type":"directional"}]"#).unwrap()[0].kind else {
            panic!()
        };
        assert!((angle - 1f64.to_radians()).abs() < 1e-15);
        assert_eq!((inner, outer), (0.0, std::f64::consts::FRAC_PI_4));
    }

    #[test]
    fn a_light_without_a_name_keeps_its_identity_when_a_node_comes_before_it() {
        let (lamp, named) = (r#"[{"type":"point"}]"#, r#"[{"type":"point","name":"bulb"}]"#);
        let of = |nodes: &str, lamp: &str| {
            let light = lights(nodes, lamp).unwrap().remove(0);
            (light.name, light.group.to_string())
        };
        let (one, two) = (format!("[{{{ON_NODE}}}]"), format!("[{{}},{{{ON_NODE}}}]"));
        assert_eq!(of(&one, lamp).0, of(&two, lamp).0);
        assert_eq!(of(&two, named), ("bulb".into(), "bulb".into()));
        let node = format!(r#"[{{"name":"desk",{ON_NODE}}}]"#);
        assert_eq!(of(&node, named), ("bulb".into(), "desk".into()), "a group is named by its node");
        assert_eq!(of(&node, lamp), ("desk".into(), "desk".into()));
        let spaced = format!(r#"[{{"name":" desk lamp ",{ON_NODE}}}]"#);
        assert_eq!(
            of(&spaced, lamp),
            (" desk lamp ".into(), "desk lamp".into()),
            "blanks around a name cannot be typed"
        );
        let blank = format!(r#"[{{"name":"  ",{ON_NODE}}}]"#);
        assert_eq!(of(&blank, named).1, "bulb");
    }

    #[test]
    fn impossible_cones_are_repaired_and_nonsense_is_refused() {
        let nodes = format!(r#"[{{{ON_NODE}}}]"#);
        let spot = r#"[{"type":"spot","spot":{"innerConeAngle":2,"outerConeAngle":0.5}}]"#;
        let LightKind::Spot { inner, outer, .. } = lights(&nodes, spot).unwrap()[0].kind else { panic!() };
        assert!(inner < outer && outer == 0.5);
        for bad in [
            r#"[{"type":"area"}]"#,
            r#"[{}]"#,
            r#"[]"#,
            r#"[{"type":"point","color":[1,1]}]"#,
            r#"[{"type":"point","intensity":1e39}]"#,
            r#"[{"type":"point","intensity":2e20}]"#,
            r#"[{"type":"point","range":"far"}]"#,
        ] {
            assert!(lights(&nodes, bad).is_err(), "{bad}");
        }
    }
}
