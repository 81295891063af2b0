//! Primitives over new vertices: attributes copied raw along the unwrap's seams, TEXCOORD_1 in atlas space.

use std::collections::BTreeMap;

use glam::Vec2;
use luxel_atlas::Placed;
use luxel_scene::import::{
    Checked, Fault,
    accessors::{ComponentType, Elements},
};
use serde_json::{Value, json};

use super::{
    draft::{Draft, Target},
    json::{Object, item, number},
    mismatch,
    original::Original,
};

/// Copies primitives; instances that split their vertices alike share the copied attributes.
#[derive(Default)]
pub struct Vertices {
    copies: BTreeMap<(usize, usize), Vec<Copied>>,
}

struct Copied {
    source: Vec<u32>,
    attributes: Object,
    targets: Option<Value>,
    /// Accessors of index lists over these vertices.
    indices: Vec<(Vec<[u32; 3]>, usize)>,
}

impl Vertices {
    /// The primitive as a triangle list over the vertices of `placed`. An authored TEXCOORD_1 moves to the set
    /// `moved` where that is given, and makes room otherwise. The material is left to others.
    pub fn primitive(
        &mut self,
        draft: &mut Draft,
        original: &Original,
        (mesh, primitive): (usize, usize),
        placed: &Placed,
        moved: Option<usize>,
    ) -> Checked<Object> {
        let old = source_primitive(original, mesh, primitive)?;
        let name = primitive_place(original, mesh, primitive);
        check(&name, placed)?;
        let copies = self.copies.entry((mesh, primitive)).or_default();
        let known = copies.iter().position(|c| c.source == placed.source);
        let known = match known {
            Some(known) => known,
            None => {
                copies.push(copy(draft, original, old, &name, &placed.source)?);
                copies.len() - 1
            }
        };
        let copied = &mut copies[known];
        let mut new = old.clone();
        new.insert("attributes".into(), Value::Object(with_texcoord(draft, &copied.attributes, placed, moved)));
        if let Some(mut targets) = copied.targets.clone() {
            let all = targets.as_array_mut().into_iter().flatten().filter_map(Value::as_object_mut);
            all.for_each(|target| *target = renamed(target, moved));
            new.insert("targets".into(), targets);
        }
        let indices = copied.indices.iter().find(|(t, _)| *t == placed.triangles).map(|(_, accessor)| *accessor);
        let indices = indices.unwrap_or_else(|| {
            let accessor = add_indices(draft, placed);
            copied.indices.push((placed.triangles.clone(), accessor));
            accessor
        });
        new.insert("indices".into(), indices.into());
        if new.contains_key("mode") {
            new.insert("mode".into(), 4.into());
        }
        super::json::remove_extension(&mut new, super::references::DRACO);
        Ok(new)
    }
}

/// `mesh 3 "Wall" primitive 0`.
fn primitive_place(original: &Original, mesh: usize, primitive: usize) -> String {
    format!("{} primitive {primitive}", original.buffers.document().mesh_place(mesh))
}

/// A primitive of the input.
pub fn source_primitive(original: &Original, mesh: usize, primitive: usize) -> Checked<&Object> {
    let value = item(&original.root, "meshes", mesh)?.get("primitives").and_then(|p| p.get(primitive));
    let name = || primitive_place(original, mesh, primitive);
    value.and_then(Value::as_object).ok_or_else(|| Fault::invalid(name(), "it does not exist"))
}

fn check(name: &str, placed: &Placed) -> Checked<()> {
    let inside = |uv: &Vec2| uv.is_finite() && uv.min_element() >= 0.0 && uv.max_element() <= 1.0;
    if placed.source.len() != placed.uvs.len() || !placed.uvs.iter().all(inside) {
        return Err(mismatch(name, "its atlas coordinates are not one per vertex inside [0, 1]²"));
    }
    if placed.triangles.iter().flatten().any(|i| *i as usize >= placed.source.len()) {
        return Err(mismatch(name, "its unwrapped triangles point outside its vertices"));
    }
    Ok(())
}

fn copy(draft: &mut Draft, original: &Original, old: &Object, name: &str, source: &[u32]) -> Checked<Copied> {
    let missing = || Fault::invalid(name, "it has no POSITION");
    let attributes = old.get("attributes").and_then(Value::as_object).ok_or_else(missing)?;
    let position = number(attributes, "POSITION").ok_or_else(missing)?;
    let plain = item(&original.root, "accessors", position)?;
    let without_data = !plain.contains_key("bufferView") && !plain.contains_key("sparse");
    if super::json::extension(old, super::references::DRACO).is_some() && without_data {
        return Err(Fault::invalid(name, "it is compressed by Draco and has no plain vertices beside it"));
    }
    let count = original.elements(position)?.count;
    let targets = old.get("targets").cloned();
    let mut copied = Copied { source: source.into(), attributes: attributes.clone(), targets, indices: Vec::new() };
    if source.len() == count && source.iter().enumerate().all(|(i, s)| i == *s as usize) {
        return Ok(copied);
    }
    copy_all(draft, original, &mut copied.attributes, source)?;
    for target in copied.targets.as_mut().and_then(Value::as_array_mut).into_iter().flatten() {
        let target =
            target.as_object_mut().ok_or_else(|| Fault::invalid(name, "it has a morph target that is no object"))?;
        copy_all(draft, original, target, source)?;
    }
    Ok(copied)
}

fn copy_all(draft: &mut Draft, original: &Original, attributes: &mut Object, source: &[u32]) -> Checked<()> {
    for (semantic, reference) in attributes.iter_mut() {
        let index = super::json::index(reference);
        let index = index.ok_or_else(|| Fault::invalid(semantic.as_str(), "it is not the index of an accessor"))?;
        *reference = copy_accessor(draft, original, index, source, semantic == "POSITION")?.into();
    }
    Ok(())
}

/// The elements that `source` names, in its order, in their own component type.
fn copy_accessor(
    draft: &mut Draft,
    original: &Original,
    index: usize,
    source: &[u32],
    needs_bounds: bool,
) -> Checked<usize> {
    let elements = original.elements(index)?;
    let stride = elements.size.next_multiple_of(4);
    let mut bytes = Vec::with_capacity(source.len() * stride);
    for &i in source {
        let name = || original.buffers.accessor_place(index);
        let element =
            elements.get(i as usize).ok_or_else(|| Fault::invalid(name(), format!("it has no element {i}")))?;
        bytes.extend_from_slice(element);
        bytes.resize(bytes.len().next_multiple_of(4), 0);
    }
    let mut accessor = item(&original.root, "accessors", index)?.clone();
    let had_bounds = accessor.contains_key("min") || accessor.contains_key("max");
    ["bufferView", "byteOffset", "sparse", "min", "max"].iter().for_each(|k| drop(accessor.shift_remove(*k)));
    accessor.insert("count".into(), source.len().into());
    // Bounds of matrices are never needed, and their padding makes them awkward.
    let plain = elements.lanes * elements.component.size() == elements.size;
    if (needs_bounds || had_bounds) && plain && !source.is_empty() {
        let (min, max) = bounds(&elements, source)
            .ok_or_else(|| Fault::invalid(original.buffers.accessor_place(index), "it is not finite"))?;
        accessor.insert("min".into(), min);
        accessor.insert("max".into(), max);
    }
    let view = if stride == elements.size {
        draft.add_view(bytes, Target::Vertices)
    } else {
        draft.add_strided_view(bytes, stride)
    };
    accessor.insert("bufferView".into(), view.into());
    Ok(draft.add_accessor(Value::Object(accessor)))
}

/// Smallest and largest value of every component among the elements that `source` names, as the JSON lists of an
/// accessor; None where one is not finite.
fn bounds(elements: &Elements, source: &[u32]) -> Option<(Value, Value)> {
    let mut range = vec![(f64::INFINITY, f64::NEG_INFINITY); elements.lanes];
    for &i in source {
        for (c, (lo, hi)) in range.iter_mut().enumerate() {
            let value = elements.value(i as usize, c).filter(|v| v.is_finite())?;
            (*lo, *hi) = (lo.min(value), hi.max(value));
        }
    }
    let is_float = elements.component == ComponentType::F32;
    let number = |v: f64| if is_float { json!(v) } else { json!(v as i64) };
    let (lo, hi): (Vec<Value>, Vec<Value>) = range.into_iter().map(|(lo, hi)| (number(lo), number(hi))).unzip();
    Some((lo.into(), hi.into()))
}

/// Attributes without the old TEXCOORD_1, or with it under its new name.
fn renamed(attributes: &Object, moved: Option<usize>) -> Object {
    let name = |(semantic, accessor): (&String, &Value)| match (semantic.as_str(), moved) {
        ("TEXCOORD_1", Some(set)) => Some((format!("TEXCOORD_{set}"), accessor.clone())),
        ("TEXCOORD_1", None) => None,
        _ => Some((semantic.clone(), accessor.clone())),
    };
    attributes.iter().filter_map(name).collect()
}

fn with_texcoord(draft: &mut Draft, copied: &Object, placed: &Placed, moved: Option<usize>) -> Object {
    let mut attributes = renamed(copied, moved);
    let view = draft.add_view(bytemuck::cast_slice(&little_endian(&placed.uvs)).to_vec(), Target::Vertices);
    let accessor = json!({ "bufferView": view, "componentType": 5126, "count": placed.uvs.len(), "type": "VEC2" });
    let accessor = draft.add_accessor(accessor);
    // Sets must be numbered without a gap from 0 on. Nothing looks at this one; the bytes are there anyway.
    attributes.entry("TEXCOORD_0").or_insert(accessor.into());
    attributes.insert("TEXCOORD_1".into(), accessor.into());
    attributes
}

fn little_endian(uvs: &[Vec2]) -> Vec<[[u8; 4]; 2]> {
    uvs.iter().map(|uv| [uv.x.to_le_bytes(), uv.y.to_le_bytes()]).collect()
}

/// An index list: 16 bits where they suffice (65535 is the primitive-restart value and no index).
fn add_indices(draft: &mut Draft, placed: &Placed) -> usize {
    let short = placed.source.len() <= usize::from(u16::MAX);
    let all = placed.triangles.iter().flatten();
    let bytes: Vec<u8> = if short {
        all.flat_map(|i| (*i as u16).to_le_bytes()).collect()
    } else {
        all.flat_map(|i| i.to_le_bytes()).collect()
    };
    let view = draft.add_view(bytes, Target::Indices);
    let component = if short { 5123 } else { 5125 };
    let count = placed.triangles.len() * 3;
    draft.add_accessor(json!({ "bufferView": view, "componentType": component, "count": count, "type": "SCALAR" }))
}
