//! Accessors (glTF 2.0 §3.6.2): typed elements out of buffer views, without trusting a single number of the file.
//!
//! Everything is read byte by byte in little-endian order, so alignment does not matter; interleaved, sparse,
//! zero-filled, normalised and quantised (KHR_mesh_quantization) elements all come out as plain vectors. `min` and
//! `max` are ignored: they cannot be relied on.

pub use gltf_json::accessor::ComponentType;
use gltf_json::accessor::Type;
use gltf_json::validation::Checked as Valid;

use super::buffers::Buffers;
use super::error::{Checked, Fault, place};

/// An accessor's elements where they lie in the file: nothing is copied but the list of sparse indices.
pub struct Elements<'b> {
    pub component: ComponentType,
    /// Components of an element, padding not counted.
    pub lanes: usize,
    /// Bytes of an element, the padding of matrix columns included.
    pub size: usize,
    pub normalized: bool,
    pub count: usize,
    /// From the first element's first byte to the last one's last, and the stride; none: zeros.
    base: Option<(&'b [u8], usize)>,
    sparse: Option<Sparse<'b>>,
}

/// The elements that a sparse accessor replaces.
struct Sparse<'b> {
    /// Which element, and the number of its value, in rising order.
    order: Vec<(u64, usize)>,
    /// Tightly packed.
    values: &'b [u8],
}

/// The largest element is a matrix of 4 × 4 floats.
static ZEROS: [u8; 64] = [0; 64];

/// Shape and place of an accessor's elements within its view.
struct Layout {
    component: ComponentType,
    lanes: usize,
    /// Bytes of one element without padding behind it.
    size: usize,
    stride: usize,
    offset: u64,
    count: u64,
}

impl Buffers {
    /// `accessor 5 "positions"`, for messages.
    pub fn accessor_place(&self, index: usize) -> String {
        place("accessor", index, self.document().root.accessors.get(index).and_then(|a| a.name.as_deref()))
    }

    /// Number of elements an accessor claims to have.
    pub fn accessor_count(&self, index: usize) -> Checked<u64> {
        Ok(self.accessor(index)?.count.0)
    }

    fn accessor(&self, index: usize) -> Checked<&gltf_json::Accessor> {
        let accessor = self.document().root.accessors.get(index);
        accessor.ok_or_else(|| Fault::invalid(self.accessor_place(index), "it does not exist"))
    }

    /// The elements as the file stores them, every one of them checked to lie within its view. Takes memory for the
    /// sparse indices only: 16 bytes for each, at every call, from the budget of decoded geometry.
    pub fn elements(&self, index: usize) -> Checked<Elements<'_>> {
        let accessor = self.accessor(index)?;
        let place = self.accessor_place(index);
        let layout = self.layout(accessor, &place)?;
        let count = usize::try_from(layout.count).map_err(|_| {
            Fault::invalid(&place, format!("its {} elements are more than any memory holds", layout.count))
        })?;
        let mut base = None;
        if let Some(view) = accessor.buffer_view {
            let source = strided(self.view(view.value())?, &layout).ok_or_else(|| {
                let what = format!("its {count} elements do not fit into bufferView {}", view.value());
                Fault::invalid(&place, what)
            })?;
            base = Some((source, layout.stride));
        }
        let sparse = accessor.sparse.as_ref().map(|s| self.sparse(s, &layout, &place)).transpose()?;
        let Layout { component, lanes, size, .. } = layout;
        Ok(Elements { component, lanes, size, normalized: accessor.normalized, count, base, sparse })
    }

    fn layout(&self, accessor: &gltf_json::Accessor, place: &str) -> Checked<Layout> {
        let (Valid::Valid(component), Valid::Valid(kind)) = (accessor.component_type, accessor.type_) else {
            return Err(Fault::invalid(place, "its componentType or type is unknown"));
        };
        let (size, lanes) = (element_size(component.0, kind), kind.multiplicity());
        let mut stride = size;
        if let Some(view) = accessor.buffer_view {
            let view = self.document().root.buffer_views.get(view.value());
            let view = view.ok_or_else(|| Fault::invalid(place, "its bufferView does not exist"))?;
            // Some exporters write a stride of 0 for tightly packed data.
            stride = view.byte_stride.map_or(size, |s| if s.0 == 0 { size } else { s.0 });
        }
        if stride < size {
            let what = format!("its elements of {size} bytes overlap at a stride of {stride}");
            return Err(Fault::invalid(place, what));
        }
        let offset = accessor.byte_offset.map_or(0, |o| o.0);
        Ok(Layout { component: component.0, lanes, size, stride, offset, count: accessor.count.0 })
    }

    /// What a sparse accessor replaces.
    fn sparse(
        &self,
        sparse: &gltf_json::accessor::sparse::Sparse,
        layout: &Layout,
        place: &str,
    ) -> Checked<Sparse<'_>> {
        let Valid::Valid(index_type) = sparse.indices.component_type else {
            return Err(Fault::invalid(place, "its sparse indices have an unknown type"));
        };
        if sparse.count.0 > layout.count {
            let what = format!("its {} sparse values are more than its {} elements", sparse.count.0, layout.count);
            return Err(Fault::invalid(place, what));
        }
        let index_size = index_type.0.size();
        let indices = Layout {
            component: index_type.0,
            lanes: 1,
            size: index_size,
            stride: index_size,
            offset: sparse.indices.byte_offset.0,
            count: sparse.count.0,
        };
        let values =
            Layout { offset: sparse.values.byte_offset.0, stride: layout.size, count: sparse.count.0, ..*layout };
        let indices = strided(self.view(sparse.indices.buffer_view.value())?, &indices);
        let values = strided(self.view(sparse.values.buffer_view.value())?, &values);
        let (Some(indices), Some(values)) = (indices, values) else {
            return Err(Fault::invalid(place, "its sparse indices or values do not fit into their bufferViews"));
        };
        self.spend(sparse.count.0.checked_mul(size_of::<(u64, usize)>() as u64), place)?;
        let order = indices.chunks_exact(index_size).enumerate().map(|(k, bytes)| (u64::from(unsigned(bytes)), k));
        // They should come in rising order; where they do not, each still finds its value.
        let mut order: Vec<(u64, usize)> = order.collect();
        order.sort_unstable();
        match order.last() {
            Some((index, _)) if *index >= layout.count => {
                Err(Fault::invalid(place, format!("its sparse index {index} is beyond its {} elements", layout.count)))
            }
            _ => Ok(Sparse { order, values }),
        }
    }

    /// Reads vectors of exactly N components as numbers, normalised integers mapped to [0, 1] or [−1, 1].
    pub fn vectors<const N: usize>(&self, index: usize) -> Checked<Vec<[f32; N]>> {
        let elements = self.elements(index)?;
        if elements.lanes != N {
            let what = format!("it has {} components, {N} are needed here", elements.lanes);
            return Err(Fault::invalid(self.accessor_place(index), what));
        }
        self.spend((elements.count as u64).checked_mul(4 * N as u64), &self.accessor_place(index))?;
        Ok(elements.vectors())
    }

    /// Reads vertex indices; the largest value of the type is reserved for primitive restart and refused (§3.7.2.1).
    pub fn indices(&self, index: usize) -> Checked<Vec<u32>> {
        let place = self.accessor_place(index);
        let elements = self.elements(index)?;
        let restart = match elements.component {
            ComponentType::U8 => 0xff,
            ComponentType::U16 => 0xffff,
            ComponentType::U32 => 0xffff_ffff,
            other => return Err(Fault::invalid(place, format!("indices cannot be of type {other:?}"))),
        };
        if elements.lanes != 1 {
            return Err(Fault::invalid(place, "indices have to be scalars"));
        }
        self.spend((elements.count as u64).checked_mul(4), &place)?;
        let indices: Vec<u32> = elements.iter().map(unsigned).collect();
        if indices.contains(&restart) {
            return Err(Fault::invalid(place, format!("it contains the primitive restart value {restart}")));
        }
        Ok(indices)
    }
}

impl<'b> Elements<'b> {
    /// The bytes of an element; none past the end.
    pub fn get(&self, i: usize) -> Option<&'b [u8]> {
        if i >= self.count {
            return None;
        }
        if let Some(sparse) = &self.sparse {
            // Of several values for one element the last one holds.
            let end = sparse.order.partition_point(|(element, _)| *element <= i as u64);
            if let Some((_, k)) = sparse.order[..end].last().filter(|(element, _)| *element == i as u64) {
                return sparse.values.get(k * self.size..(k + 1) * self.size);
            }
        }
        match self.base {
            Some((bytes, stride)) => bytes.get(i * stride..i * stride + self.size),
            None => ZEROS.get(..self.size),
        }
    }

    /// All elements in order.
    pub fn iter(&self) -> impl Iterator<Item = &'b [u8]> + '_ {
        (0..self.count).map_while(|i| self.get(i))
    }

    /// A component of an element as the integer or float that is stored. Not for matrices, whose columns are padded.
    pub fn value(&self, i: usize, lane: usize) -> Option<f64> {
        Some(decode(self.lane(i, lane)?, self.component, false))
    }

    /// A component as a number: normalised integers in [0, 1] or [−1, 1]. Not for matrices, whose columns are padded.
    pub fn number(&self, i: usize, lane: usize) -> Option<f64> {
        Some(decode(self.lane(i, lane)?, self.component, self.normalized))
    }

    fn lane(&self, i: usize, lane: usize) -> Option<&'b [u8]> {
        let size = self.component.size();
        self.get(i)?.get(lane * size..(lane + 1) * size)
    }

    /// The elements as vectors; N has to be the number of lanes.
    fn vectors<const N: usize>(&self) -> Vec<[f32; N]> {
        let size = self.component.size();
        let number = |bytes: &[u8]| decode(bytes, self.component, self.normalized) as f32;
        let element = |bytes: &[u8]| {
            let mut out = [0.0; N];
            for (slot, bytes) in out.iter_mut().zip(bytes.chunks_exact(size)) {
                *slot = number(bytes);
            }
            out
        };
        self.iter().map(element).collect()
    }
}

/// Bytes of one element. The columns of matrices of small components are padded to four bytes (§3.6.2.4).
pub fn element_size(component: ComponentType, kind: Type) -> usize {
    let column = |rows: usize| (rows * component.size()).next_multiple_of(4);
    match kind {
        Type::Mat2 => 2 * column(2),
        Type::Mat3 => 3 * column(3),
        Type::Mat4 => 4 * column(4),
        _ => component.size() * kind.multiplicity(),
    }
}

/// The stretch of a view from the first element's first byte to the last element's last one.
fn strided<'v>(view: &'v [u8], layout: &Layout) -> Option<&'v [u8]> {
    let Some(last) = layout.count.checked_sub(1) else { return Some(&[]) };
    let span = last.checked_mul(layout.stride as u64)?.checked_add(layout.size as u64)?;
    let end = layout.offset.checked_add(span)?;
    view.get(usize::try_from(layout.offset).ok()?..usize::try_from(end).ok()?)
}

fn unsigned(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
}

/// One component; integers that are not normalised keep their value (§3.11, and KHR_mesh_quantization).
fn decode(bytes: &[u8], component: ComponentType, normalized: bool) -> f64 {
    let raw = unsigned(bytes);
    let scaled = |value: f64, largest: f64| if normalized { (value / largest).max(-1.0) } else { value };
    match component {
        ComponentType::I8 => scaled(f64::from(raw as u8 as i8), 127.0),
        ComponentType::U8 => scaled(f64::from(raw), 255.0),
        ComponentType::I16 => scaled(f64::from(raw as u16 as i16), 32767.0),
        ComponentType::U16 => scaled(f64::from(raw), 65535.0),
        ComponentType::U32 => scaled(f64::from(raw), f64::from(u32::MAX)),
        ComponentType::F32 => f64::from(f32::from_bits(raw)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::document::Document;
    use crate::import::files::Files;
    use crate::import::options::Limits;
    use serde_json::{Value, json};
    use std::path::Path;

    /// Loads buffers from `bin` with the given views and accessors and hands them to a test.
    fn with<R>(views: Value, accessors: Value, bin: &[u8], test: impl FnOnce(&Buffers) -> R) -> R {
        let json = json!({"asset": {"version": "2.0"}, "buffers": [{"byteLength": bin.len()}],
                          "bufferViews": views, "accessors": accessors});
        let limits = Limits::default();
        let document = Document::parse(json.to_string().as_bytes(), &limits).unwrap();
        let mut files = Files::beside(Path::new("scene.glb"), &limits);
        test(&Buffers::load(document, Some(bin.to_vec()), &mut files, &limits, &crate::Silent).unwrap())
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|f| f.to_le_bytes()).collect()
    }

    #[test]
    fn interleaved_and_offset_elements() {
        let bin = floats(&[0.0, 1.0, 2.0, 9.0, 3.0, 4.0, 5.0, 9.0]);
        let views = json!([{"buffer": 0, "byteLength": 32, "byteStride": 16}]);
        let accessors = json!([
            {"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3"},
            {"bufferView": 0, "byteOffset": 12, "componentType": 5126, "count": 2, "type": "SCALAR"}]);
        with(views, accessors, &bin, |b| {
            assert_eq!(b.vectors::<3>(0).unwrap(), [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]);
            assert_eq!(b.vectors::<1>(1).unwrap(), [[9.0], [9.0]]);
            assert!(b.vectors::<2>(0).is_err(), "a VEC3 is no VEC2");
        });
    }

    #[test]
    fn every_component_type_with_and_without_normalisation() {
        let bin = [0x80, 0x7f, 0xff, 0x00, 0x00, 0x80, 0xff, 0x7f, 0xff, 0xff, 0xff, 0xff];
        let views = json!([{"buffer": 0, "byteLength": 12}]);
        let accessor = |offset: usize, component: u32, count: usize, normalized: bool| {
            json!({"bufferView": 0, "byteOffset": offset, "componentType": component, "count": count,
                   "type": "SCALAR", "normalized": normalized})
        };
        let cases = [
            (accessor(0, 5120, 2, false), vec![-128.0, 127.0]),
            (accessor(0, 5120, 2, true), vec![-1.0, 1.0]),
            (accessor(1, 5121, 3, false), vec![127.0, 255.0, 0.0]),
            (accessor(1, 5121, 3, true), vec![127.0 / 255.0, 1.0, 0.0]),
            (accessor(4, 5122, 2, false), vec![-32768.0, 32767.0]),
            (accessor(4, 5122, 2, true), vec![-1.0, 1.0]),
            (accessor(4, 5123, 3, false), vec![32768.0, 32767.0, 65535.0]),
            (accessor(8, 5123, 1, true), vec![1.0]),
            (accessor(8, 5125, 1, true), vec![1.0]),
            (accessor(0, 5125, 1, false), vec![0x00ff_7f80 as f32]),
        ];
        let accessors: Vec<Value> = cases.iter().map(|c| c.0.clone()).collect();
        with(views, json!(accessors), &bin, |b| {
            for (i, (_, expected)) in cases.iter().enumerate() {
                assert_eq!(b.vectors::<1>(i).unwrap().concat(), *expected, "{i}");
            }
        });
    }

    #[test]
    fn sparse_over_zeros_and_over_a_view() {
        let mut bin = floats(&[1.0, 2.0, 3.0, 10.0, 20.0]);
        bin.extend([0, 2]);
        let views = json!([{"buffer": 0, "byteLength": 12}, {"buffer": 0, "byteOffset": 12, "byteLength": 8},
                           {"buffer": 0, "byteOffset": 20, "byteLength": 2}]);
        let sparse = |count: usize| {
            json!({"count": count, "values": {"bufferView": 1},
                                          "indices": {"bufferView": 2, "componentType": 5121}})
        };
        let accessors = json!([
            {"componentType": 5126, "count": 3, "type": "SCALAR", "sparse": sparse(2)},
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "SCALAR", "sparse": sparse(2)},
            {"componentType": 5126, "count": 2, "type": "SCALAR", "sparse": sparse(2)},
            {"componentType": 5126, "count": 3, "type": "SCALAR", "sparse": sparse(3)},
            {"componentType": 5126, "count": 2, "type": "VEC3"},
            {"componentType": 5126, "count": 1, "type": "SCALAR", "sparse": sparse(2)}]);
        with(views, accessors, &bin, |b| {
            assert_eq!(b.vectors::<1>(0).unwrap().concat(), [10.0, 0.0, 20.0]);
            assert_eq!(b.vectors::<1>(1).unwrap().concat(), [10.0, 2.0, 20.0]);
            assert!(b.vectors::<1>(2).unwrap_err().what.contains("sparse index 2"), "out of range");
            assert!(b.vectors::<1>(3).is_err(), "more values than the view holds");
            assert_eq!(b.vectors::<3>(4).unwrap(), [[0.0; 3]; 2], "no view means zeros");
            let more = b.vectors::<1>(5).unwrap_err().what;
            assert!(more.contains("2 sparse values are more than its 1 elements"), "{more}");
        });
    }

    #[test]
    fn nothing_outside_a_view_is_read() {
        let views = json!([{"buffer": 0, "byteLength": 12}, {"buffer": 0, "byteOffset": 8, "byteLength": 12},
                           {"buffer": 0, "byteLength": 12, "byteStride": 8}, {"buffer": 7, "byteLength": 1}]);
        let accessor = |view: usize, offset: u64, count: u64| json!({"bufferView": view, "byteOffset": offset, "componentType": 5126, "count": count, "type": "VEC3"});
        let accessors = json!([
            accessor(0, 0, 2),
            accessor(0, 4, 1),
            accessor(0, u64::MAX, 1),
            accessor(0, 0, u64::MAX),
            accessor(1, 0, 1),
            accessor(2, 0, 1),
            accessor(3, 0, 1),
            accessor(9, 0, 1),
            accessor(0, 0, 1)
        ]);
        with(views, accessors, &[0; 16], |b| {
            for i in 0..8 {
                assert!(b.vectors::<3>(i).is_err(), "{i}");
            }
            assert!(b.vectors::<3>(8).is_ok());
            assert!(b.vectors::<3>(99).is_err());
        });
    }

    #[test]
    fn a_claimed_size_is_not_allocated() {
        let accessors = json!([{"componentType": 5126, "count": 4_000_000_000u64, "type": "VEC4"}]);
        with(json!([]), accessors, &[], |b| {
            let fault = b.vectors::<4>(0).unwrap_err();
            assert_eq!(fault.kind, crate::import::FaultKind::Limit, "{fault}");
        });
    }

    #[test]
    fn sparse_indices_are_paid_for() {
        // A byte in the file, 16 in memory; a million of them fit four times into the 64 MiB of a file without buffers.
        let count = 1_000_000;
        let views = json!([{"buffer": 0, "byteLength": count}]);
        let sparse = json!({"count": count, "values": {"bufferView": 0},
                            "indices": {"bufferView": 0, "componentType": 5121}});
        let accessors = json!([{"componentType": 5121, "count": count, "type": "SCALAR", "sparse": sparse}]);
        with(views, accessors, &vec![0; count], |b| {
            (0..4).for_each(|_| assert_eq!(b.elements(0).unwrap().count, count));
            let fault = b.elements(0).map(|_| ()).unwrap_err();
            assert_eq!(fault.kind, crate::import::FaultKind::Limit, "{fault}");
        });
    }

    #[test]
    fn indices_are_integers_without_restart() {
        let bin = [0, 1, 2, 255, 255, 0, 0, 0];
        let views = json!([{"buffer": 0, "byteLength": 8}]);
        let accessor = |offset: usize, component: u32, count: usize| json!({"bufferView": 0, "byteOffset": offset, "componentType": component, "count": count, "type": "SCALAR"});
        let accessors = json!([
            accessor(0, 5121, 3),
            accessor(0, 5121, 4),
            accessor(0, 5123, 2),
            accessor(4, 5125, 1),
            accessor(0, 5126, 1)
        ]);
        with(views, accessors, &bin, |b| {
            assert_eq!(b.indices(0).unwrap(), [0, 1, 2]);
            assert!(b.indices(1).unwrap_err().what.contains("restart"));
            assert_eq!(b.indices(2).unwrap(), [0x100, 0xff02]);
            assert_eq!(b.indices(3).unwrap(), [255]);
            assert!(b.indices(4).unwrap_err().what.contains("F32"));
        });
    }

    #[test]
    fn matrix_columns_are_padded() {
        assert_eq!(element_size(ComponentType::U8, Type::Mat2), 8);
        assert_eq!(element_size(ComponentType::U16, Type::Mat3), 24);
        assert_eq!(element_size(ComponentType::F32, Type::Mat4), 64);
        assert_eq!(element_size(ComponentType::U16, Type::Vec3), 6);
    }
}
