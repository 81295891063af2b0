//! EXT_mesh_gpu_instancing: one mesh, many transforms below its node.

use glam::{DAffine3, DVec3, DVec4};
use gltf_json::accessor::{ComponentType, Type};
use gltf_json::validation::Checked as Valid;
use serde_json::Value;

use super::buffers::Buffers;
use super::error::{Bound, Checked, Fault};
use super::options::Limits;
use super::transform::from_trs;

/// Transforms of a node's instances to the node, or None when it is not instanced.
pub fn read(buffers: &Buffers, node: usize, limits: &Limits) -> Checked<Option<Vec<DAffine3>>> {
    let document = buffers.document();
    let others = document.root.nodes.get(node).and_then(|n| n.extensions.as_ref()).map(|e| &e.others);
    let Some(object) = others.and_then(|o| o.get("EXT_mesh_gpu_instancing")) else { return Ok(None) };
    let place = format!("{} instances", document.node_place(node));
    let attribute = |name: &str| -> Checked<Option<usize>> {
        let Some(value) = object.get("attributes").and_then(|a| a.get(name)) else { return Ok(None) };
        let index = value.as_u64().and_then(|i| usize::try_from(i).ok());
        index.map(Some).ok_or_else(|| Fault::invalid(&place, format!("their {name} is {value}, not an accessor")))
    };
    let [translation, rotation, scale] = [attribute("TRANSLATION")?, attribute("ROTATION")?, attribute("SCALE")?];
    // Other attributes may be there (colours, ids); the count comes from whichever of the three there is.
    let Some(first) = [translation, rotation, scale].into_iter().flatten().next() else {
        let any = object.get("attributes").and_then(Value::as_object).and_then(|a| a.values().next());
        let Some(index) = any.and_then(Value::as_u64).and_then(|i| usize::try_from(i).ok()) else {
            return Err(Fault::invalid(place, "they have no attributes"));
        };
        let count = bounded(buffers.accessor_count(index)?, limits, &place)?;
        return Ok(Some(vec![DAffine3::IDENTITY; count]));
    };
    let count = bounded(buffers.accessor_count(first)?, limits, &place)?;
    let vectors3 = |accessor: Option<usize>, default: [f32; 3]| match accessor {
        Some(accessor) => buffers.vectors::<3>(accessor),
        None => Ok(vec![default; count]),
    };
    let translations = vectors3(translation, [0.0; 3])?;
    let scales = vectors3(scale, [1.0; 3])?;
    let rotations = match rotation {
        Some(accessor) => rotations(buffers, accessor, &place)?,
        None => vec![[0.0, 0.0, 0.0, 1.0]; count],
    };
    if [translations.len(), rotations.len(), scales.len()].iter().any(|&n| n != count) {
        return Err(Fault::invalid(place, "their attributes differ in length"));
    }
    let mut transforms = Vec::with_capacity(count);
    for (i, ((t, r), s)) in translations.iter().zip(&rotations).zip(&scales).enumerate() {
        let vector = |v: &[f32; 3]| DVec3::from_array(v.map(f64::from));
        let transform = from_trs(vector(t), DVec4::from_array(r.map(f64::from)), vector(s));
        let transform = transform.filter(|t| t.is_finite());
        transforms.push(
            transform.ok_or_else(|| Fault::invalid(&place, format!("the transform of number {i} is not valid")))?,
        );
    }
    Ok(Some(transforms))
}

fn bounded(count: u64, limits: &Limits, place: &str) -> Checked<usize> {
    if count > limits.instances {
        return Err(Fault::limit(place, format!("there are {count}"), Bound::Instances, limits.instances));
    }
    Ok(count as usize)
}

/// Rotations are floats or normalised integers; that `normalized` is often forgotten does no harm, because quaternions
/// are normalised anyway and only their direction matters.
fn rotations(buffers: &Buffers, accessor: usize, place: &str) -> Checked<Vec<[f32; 4]>> {
    let found = buffers.document().root.accessors.get(accessor);
    let fits = found.is_some_and(|a| {
        let signed = matches!(
            a.component_type,
            Valid::Valid(c) if matches!(c.0, ComponentType::F32 | ComponentType::I8 | ComponentType::I16)
        );
        signed && matches!(a.type_, Valid::Valid(Type::Vec4))
    });
    if !fits {
        return Err(Fault::invalid(place, "their ROTATION is not an accessor of signed four-vectors"));
    }
    buffers.vectors::<4>(accessor)
}
