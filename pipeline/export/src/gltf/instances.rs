//! EXT_mesh_gpu_instancing turned into nodes: every instance needs its own place in the lightmap.

use luxel_scene::import::{Checked, Fault, accessors::Elements};
use serde_json::{Value, json};

use super::{
    json::{Object, extension, item, item_mut, list_mut, place, remove_extension},
    original::Original,
};

pub const EXTENSION: &str = "EXT_mesh_gpu_instancing";

/// Nodes that one list may become.
const MAX_INSTANCES: usize = 1 << 22;

/// Replaces the instancing of a node by child nodes, one per instance, without meshes; returns their indices.
pub fn expand(root: &mut Object, original: &Original, node: usize) -> Checked<Vec<usize>> {
    let name = place(root, "nodes", node);
    let source = item(&original.root, "nodes", node)?;
    let attributes = extension(source, EXTENSION).and_then(|e| e.get("attributes")).and_then(Value::as_object);
    let attributes = attributes.ok_or_else(|| Fault::invalid(&name, "it has no instance attributes"))?;
    let mut columns = Vec::new();
    for (semantic, reference) in attributes {
        let index = super::json::index(reference);
        let index = index.ok_or_else(|| Fault::invalid(&name, "it has an instance attribute that is no accessor"))?;
        columns.push(Column::new(original, semantic, index)?);
    }
    let count = columns.iter().map(|c| c.elements.count).min().unwrap_or(0);
    if count > MAX_INSTANCES {
        return Err(Fault::invalid(name, format!("it has {count} instances, more than {MAX_INSTANCES}")));
    }
    let label = source.get("name").and_then(Value::as_str);
    let weights = source.get("weights");
    let mut children = Vec::with_capacity(count);
    for i in 0..count {
        let mut child =
            instance(&columns, i).ok_or_else(|| Fault::invalid(&name, format!("instance {i} is not finite")))?;
        label.map(|l| child.insert("name".into(), format!("{l}.{i}").into()));
        weights.map(|w| child.insert("weights".into(), w.clone()));
        let nodes = list_mut(root, "nodes")?;
        nodes.push(Value::Object(child));
        children.push(nodes.len() - 1);
    }
    let parent = item_mut(root, "nodes", node)?;
    remove_extension(parent, EXTENSION);
    parent.shift_remove("mesh");
    parent.shift_remove("weights");
    if !children.is_empty() {
        list_mut(parent, "children")?.extend(children.iter().map(|c| Value::from(*c)));
    }
    Ok(children)
}

/// One instance attribute.
struct Column<'a> {
    semantic: &'a str,
    elements: Elements<'a>,
}

impl<'a> Column<'a> {
    fn new(original: &'a Original, semantic: &'a str, accessor: usize) -> Checked<Self> {
        let elements = original.elements(accessor)?;
        let expected = match semantic {
            "TRANSLATION" | "SCALE" => 3,
            "ROTATION" => 4,
            _ => elements.lanes,
        };
        if elements.lanes != expected || elements.lanes * elements.component.size() != elements.size {
            return Err(Fault::invalid(
                original.buffers.accessor_place(accessor),
                "it has the wrong type for an instance",
            ));
        }
        Ok(Self { semantic, elements })
    }

    fn values(&self, i: usize) -> Option<Vec<f64>> {
        let values: Option<Vec<f64>> = (0..self.elements.lanes).map(|c| self.elements.number(i, c)).collect();
        values.filter(|v| v.iter().all(|x| x.is_finite()))
    }
}

/// A node with the transform of instance `i`; attributes of other meaning are kept as `extras.instance`.
fn instance(columns: &[Column], i: usize) -> Option<Object> {
    let mut node = Object::new();
    let mut others = Object::new();
    for column in columns {
        let values = column.values(i)?;
        match column.semantic {
            "TRANSLATION" => node.insert("translation".into(), json!(values)),
            "SCALE" => node.insert("scale".into(), json!(values)),
            "ROTATION" => node.insert("rotation".into(), json!(unit(values))),
            other => others.insert(other.into(), json!(values)),
        };
    }
    if !others.is_empty() {
        node.insert("extras".into(), json!({ "instance": others }));
    }
    Some(node)
}

/// A quaternion of length 1, as nodes must have; quantized ones are a little off. Without direction it turns nothing.
fn unit(q: Vec<f64>) -> Vec<f64> {
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 0.0 { q.iter().map(|x| x / length).collect() } else { vec![0.0, 0.0, 0.0, 1.0] }
}
