//! Elements of an accessor as raw bytes, sparse ones resolved, nothing converted.

use super::{
    fault::{Checked, Fault},
    json::{Object, item, number, place},
    original::Original,
};

/// The raw elements of one accessor.
pub struct Elements<'a> {
    pub component: Component,
    /// Components of an element in the order of the file, padding not counted.
    pub components: usize,
    /// Bytes of one element, column padding of matrices included.
    pub size: usize,
    pub count: usize,
    base: Option<(&'a [u8], usize)>,
    sparse: Option<(Vec<u32>, &'a [u8])>,
    zero: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn parse(code: usize) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    pub fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The number at the front of `bytes`; None when they are too few.
    pub fn value(self, bytes: &[u8]) -> Option<f64> {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| bytes.get(i).copied());
        Some(match self {
            Self::I8 => f64::from(i8::from_le_bytes([a?])),
            Self::U8 => f64::from(a?),
            Self::I16 => f64::from(i16::from_le_bytes([a?, b?])),
            Self::U16 => f64::from(u16::from_le_bytes([a?, b?])),
            Self::U32 => f64::from(u32::from_le_bytes([a?, b?, c?, d?])),
            Self::F32 => f64::from(f32::from_le_bytes([a?, b?, c?, d?])),
        })
    }

    /// The factor of a normalized component.
    fn unit(self) -> f64 {
        match self {
            Self::I8 => 1.0 / 127.0,
            Self::U8 => 1.0 / 255.0,
            Self::I16 => 1.0 / 32767.0,
            Self::U16 => 1.0 / 65535.0,
            Self::U32 | Self::F32 => 1.0,
        }
    }
}

/// (components, bytes) of an element: columns of matrices start at multiples of four bytes.
fn shape(kind: &str, component: Component) -> Option<(usize, usize)> {
    let (columns, rows) = match kind {
        "SCALAR" => (1, 1),
        "VEC2" => (1, 2),
        "VEC3" => (1, 3),
        "VEC4" => (1, 4),
        "MAT2" => (2, 2),
        "MAT3" => (3, 3),
        "MAT4" => (4, 4),
        _ => return None,
    };
    let column = rows * component.bytes();
    let bytes = if columns == 1 { column } else { columns * column.next_multiple_of(4) };
    Some((columns * rows, bytes))
}

impl<'a> Elements<'a> {
    /// Checks that every element lies inside its bufferView.
    pub fn new(original: &'a Original, accessor: usize) -> Checked<Self> {
        let object = item(&original.root, "accessors", accessor)?;
        let name = place(&original.root, "accessors", accessor);
        let fault = |what: &str| Fault::new(&name, what);
        let component = number(object, "componentType").and_then(Component::parse);
        let component = component.ok_or_else(|| fault("has no known componentType"))?;
        let kind = object.get("type").and_then(|t| t.as_str()).unwrap_or_default();
        let (components, size) = shape(kind, component).ok_or_else(|| fault("has no known type"))?;
        let count = number(object, "count").filter(|c| *c <= u32::MAX as usize);
        let count = count.ok_or_else(|| fault("has no sensible count"))?;
        let mut elements = Self { component, components, size, count, base: None, sparse: None, zero: vec![0; size] };
        if let Some(view) = number(object, "bufferView") {
            let stride = number(item(&original.root, "bufferViews", view)?, "byteStride");
            let stride = stride.filter(|s| *s > 0).unwrap_or(size);
            let bytes = run(original.view(view)?, object, count, size, stride);
            elements.base = Some((bytes.ok_or_else(|| fault("does not fit into its bufferView"))?, stride));
        }
        if let Some(sparse) = object.get("sparse").and_then(|s| s.as_object()) {
            elements.sparse = Some(sparse_parts(original, sparse, count, size, &fault)?);
        }
        Ok(elements)
    }

    /// The bytes of element `i`; None past the end.
    pub fn get(&self, i: usize) -> Option<&[u8]> {
        if i >= self.count {
            return None;
        }
        if let Some((indices, values)) = &self.sparse
            && let Ok(k) = indices.binary_search(&(i as u32))
        {
            return values.get(k * self.size..(k + 1) * self.size);
        }
        match self.base {
            Some((bytes, stride)) => bytes.get(i * stride..i * stride + self.size),
            None => Some(&self.zero),
        }
    }

    /// Component `c` of element `i` as a number, normalized integers in [−1, 1]. For vectors and scalars only.
    pub fn number(&self, i: usize, c: usize, normalized: bool) -> Option<f64> {
        let value = self.component.value(self.get(i)?.get(c * self.component.bytes()..)?)?;
        Some(if normalized { (value * self.component.unit()).max(-1.0) } else { value })
    }
}

/// The bytes from the first element of a run to the end of the last one.
fn run<'a>(view: &'a [u8], object: &Object, count: usize, size: usize, stride: usize) -> Option<&'a [u8]> {
    let start = number(object, "byteOffset").unwrap_or(0);
    let length = if count == 0 { 0 } else { stride.checked_mul(count - 1)?.checked_add(size)? };
    if stride < size && count > 1 {
        return None;
    }
    view.get(start..start.checked_add(length)?)
}

/// Increasing indices below `count` and their values.
fn sparse_parts<'a>(
    original: &'a Original,
    sparse: &Object,
    count: usize,
    size: usize,
    fault: &dyn Fn(&str) -> Fault,
) -> Checked<(Vec<u32>, &'a [u8])> {
    let part = |key: &str| sparse.get(key).and_then(|p| p.as_object()).ok_or_else(|| fault("is sparse without data"));
    let (indices, values) = (part("indices")?, part("values")?);
    let n = number(sparse, "count").filter(|n| *n <= count);
    let n = n.ok_or_else(|| fault("has more sparse elements than elements"))?;
    let view = |object: &Object| {
        let view = number(object, "bufferView").ok_or_else(|| fault("has sparse data without a bufferView"))?;
        original.view(view)
    };
    let outside = || fault("has sparse data outside its bufferView");
    let component = number(indices, "componentType").and_then(Component::parse);
    let component = component.filter(|c| matches!(c, Component::U8 | Component::U16 | Component::U32));
    let component = component.ok_or_else(|| fault("has sparse indices of an unknown type"))?;
    let bytes = run(view(indices)?, indices, n, component.bytes(), component.bytes()).ok_or_else(outside)?;
    let list: Vec<u32> =
        bytes.chunks_exact(component.bytes()).filter_map(|b| component.value(b)).map(|v| v as u32).collect();
    if list.windows(2).any(|w| w[0] >= w[1]) || list.last().is_some_and(|l| *l as usize >= count) {
        return Err(fault("has sparse indices that do not increase or lie outside"));
    }
    Ok((list, run(view(values)?, values, n, size, size).ok_or_else(outside)?))
}
