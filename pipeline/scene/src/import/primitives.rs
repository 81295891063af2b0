//! One glTF primitive becomes one [`Mesh`] in object space.

use glam::{DVec3, Vec2, Vec3, Vec4};
use gltf_json::mesh::{Primitive, Semantic};
use gltf_json::validation::Checked as Valid;

use super::buffers::Buffers;
use super::document::refusal;
use super::error::{Checked, Fault};
use super::notes::Notes;
use super::topology;
use crate::Mesh;

/// Texture coordinate sets beyond this one are not read.
pub const MAX_UV_SET: u32 = 7;

/// Reads a primitive; None when it has nothing that could be lit. `material` is its index in the scene.
pub fn read(
    buffers: &Buffers,
    (mesh, index): (usize, usize),
    primitive: &Primitive,
    material: usize,
    notes: &mut Notes,
) -> Checked<Option<Mesh>> {
    let place = format!("{} primitive {index}", buffers.document().mesh_place(mesh));
    let Valid::Valid(mode) = primitive.mode else {
        return Err(Fault::invalid(place, "its mode is unknown"));
    };
    let Some(position) = attribute(primitive, &Semantic::Positions) else {
        notes.add("no-positions", format!("{place}: it has no POSITION and is left out"));
        return Ok(None);
    };
    refuse_draco(buffers, primitive, position, &place)?;
    if topology::triangles(mode, 0).is_none() {
        notes.add("points-and-lines", format!("{place}: points and lines cannot be lit and are left out"));
        return Ok(None);
    }
    let in_place = |fault: Fault| inside(fault, &place);
    let positions: Vec<Vec3> =
        buffers.vectors::<3>(position).map_err(in_place)?.into_iter().map(Vec3::from_array).collect();
    if let Some(vertex) = positions.iter().position(|p| !p.is_finite()) {
        return Err(Fault::invalid(place, format!("the position of vertex {vertex} is not finite")));
    }
    let triangles = triangles(buffers, primitive, mode, &positions, &place, notes)?;
    let mut mesh = Mesh {
        name: place.clone(),
        gltf_mesh: mesh,
        gltf_primitive: index,
        triangles,
        material,
        uvs: uv_sets(buffers, primitive, positions.len(), &place, notes)?,
        colors: colors(buffers, primitive, positions.len(), &place)?,
        ..Mesh::default()
    };
    if let Some(accessor) = attribute(primitive, &Semantic::Normals) {
        let normals = buffers.vectors::<3>(accessor).map_err(in_place)?;
        same_count("NORMAL", normals.len(), positions.len(), &place)?;
        mesh.normals = normals.into_iter().map(Vec3::from_array).collect();
    }
    mesh.positions = positions;
    repair_normals(&mut mesh, notes);
    Ok(Some(mesh))
}

/// Prefixes the place of a fault found in an accessor with the primitive that uses it.
fn inside(fault: Fault, place: &str) -> Fault {
    Fault { place: format!("{place}, {}", fault.place), ..fault }
}

/// The accessor of an attribute.
pub fn attribute(primitive: &Primitive, semantic: &Semantic) -> Option<usize> {
    primitive.attributes.get(&Valid::Valid(semantic.clone())).map(|index| index.value())
}

/// Draco geometry is refused unless the file brings uncompressed accessors along.
fn refuse_draco(buffers: &Buffers, primitive: &Primitive, position: usize, place: &str) -> Checked<()> {
    const DRACO: &str = "KHR_draco_mesh_compression";
    let compressed = primitive.extensions.as_ref().is_some_and(|e| e.others.contains_key(DRACO));
    let accessors = &buffers.document().root.accessors;
    let empty = |index: usize| accessors.get(index).is_some_and(|a| a.buffer_view.is_none() && a.sparse.is_none());
    if compressed && (empty(position) || primitive.indices.is_some_and(|i| empty(i.value()))) {
        let (what, hint) = refusal(DRACO);
        return Err(Fault::unsupported(place, what, hint));
    }
    Ok(())
}

fn same_count(name: &str, count: usize, vertices: usize, place: &str) -> Checked<()> {
    if count == vertices {
        return Ok(());
    }
    Err(Fault::invalid(place, format!("it has {vertices} positions, but {count} values of {name}")))
}

/// Triangles with valid indices and without those of zero area.
fn triangles(
    buffers: &Buffers,
    primitive: &Primitive,
    mode: gltf_json::mesh::Mode,
    positions: &[Vec3],
    place: &str,
    notes: &mut Notes,
) -> Checked<Vec<[u32; 3]>> {
    let indices = match primitive.indices {
        Some(index) => Some(buffers.indices(index.value()).map_err(|fault| inside(fault, place))?),
        None => None,
    };
    let vertices = positions.len();
    if let Some(bad) = indices.iter().flatten().find(|&&i| i as usize >= vertices) {
        return Err(Fault::invalid(place, format!("its index {bad} is beyond its {vertices} vertices")));
    }
    if u32::try_from(vertices).is_err() {
        return Err(Fault::invalid(place, format!("it has {vertices} vertices, more than indices can tell apart")));
    }
    let count = indices.as_ref().map_or(vertices, Vec::len);
    if mode == gltf_json::mesh::Mode::Triangles && !count.is_multiple_of(3) {
        notes.add(
            "incomplete-triangle",
            format!("{place}: its {count} corners are no whole triangles; the rest is ignored"),
        );
    }
    // Each triangle takes 12 bytes, and 24 while it is being made; strips and fans have one for nearly every corner.
    let most = if mode == gltf_json::mesh::Mode::Triangles { count / 3 } else { count };
    buffers.spend((most as u64).checked_mul(36), place)?;
    let corner = |i: usize| indices.as_ref().map_or(i as u32, |indices| indices[i]);
    let all = topology::triangles(mode, count).unwrap_or_default();
    let total = all.len();
    let kept: Vec<[u32; 3]> = all
        .into_iter()
        .map(|t| t.map(corner))
        .filter(|t| !is_degenerate(t.map(|i| positions[i as usize].as_dvec3())))
        .collect();
    if kept.len() < total {
        let dropped = total - kept.len();
        notes.add(
            "degenerate-triangles",
            format!("{place}: {dropped} of {total} triangles have no area and are left out"),
        );
    }
    Ok(kept)
}

/// No area within the precision of double arithmetic, relative to the triangle's own size.
pub fn is_degenerate([a, b, c]: [DVec3; 3]) -> bool {
    let (u, v) = (b - a, c - a);
    let longest = u.length_squared().max(v.length_squared()).max((c - b).length_squared());
    // Scaled first, so that neither tiny nor huge coordinates leave the range of the products.
    let scale = longest.sqrt();
    scale == 0.0 || (u / scale).cross(v / scale).length() <= 1e-14
}

fn uv_sets(
    buffers: &Buffers,
    primitive: &Primitive,
    vertices: usize,
    place: &str,
    notes: &mut Notes,
) -> Checked<Vec<Vec<Vec2>>> {
    let mut sets: Vec<Vec<Vec2>> = Vec::new();
    for set in 0..=MAX_UV_SET {
        let Some(accessor) = attribute(primitive, &Semantic::TexCoords(set)) else { continue };
        let uvs = buffers.vectors::<2>(accessor).map_err(|fault| inside(fault, place))?;
        same_count(&format!("TEXCOORD_{set}"), uvs.len(), vertices, place)?;
        let mut uvs: Vec<Vec2> = uvs.into_iter().map(Vec2::from_array).collect();
        let mut bad = 0;
        for uv in uvs.iter_mut().filter(|uv| !uv.is_finite()) {
            *uv = Vec2::ZERO;
            bad += 1;
        }
        if bad > 0 {
            notes.add("non-finite-uv", format!("{place}: {bad} values of TEXCOORD_{set} are not finite and become 0"));
        }
        sets.resize(set as usize + 1, Vec::new());
        sets[set as usize] = uvs;
    }
    Ok(sets)
}

/// COLOR_0 as linear RGBA in [0, 1]; three components mean opaque.
fn colors(buffers: &Buffers, primitive: &Primitive, vertices: usize, place: &str) -> Checked<Vec<Vec4>> {
    let Some(accessor) = attribute(primitive, &Semantic::Colors(0)) else { return Ok(Vec::new()) };
    let three = buffers.document().root.accessors.get(accessor).map(|a| a.type_);
    let three = matches!(three, Some(Valid::Valid(gltf_json::accessor::Type::Vec3)));
    let colors: Checked<Vec<Vec4>> = if three {
        buffers.vectors::<3>(accessor).map(|c| c.into_iter().map(|c| Vec3::from_array(c).extend(1.0)).collect())
    } else {
        buffers.vectors::<4>(accessor).map(|c| c.into_iter().map(Vec4::from_array).collect())
    };
    let mut colors = colors.map_err(|fault| inside(fault, place))?;
    same_count("COLOR_0", colors.len(), vertices, place)?;
    for (vertex, color) in colors.iter_mut().enumerate() {
        if color.is_nan() {
            return Err(Fault::invalid(place, format!("the colour of vertex {vertex} is not a number")));
        }
        *color = color.clamp(Vec4::ZERO, Vec4::ONE);
    }
    Ok(colors)
}

/// Makes normals unit vectors. A vertex whose normal has no direction takes that of its faces, weighted by area; if no
/// vertex has a usable one, the mesh is shaded flat, as the specification asks for meshes without normals.
pub fn repair_normals(mesh: &mut Mesh, notes: &mut Notes) {
    let mut bad = Vec::new();
    for (vertex, normal) in mesh.normals.iter_mut().enumerate() {
        let unit = normal.as_dvec3().try_normalize().filter(|_| normal.length_squared() > 1e-12);
        match unit {
            Some(unit) => *normal = unit.as_vec3(),
            None => bad.push(vertex),
        }
    }
    if bad.is_empty() {
        return;
    }
    let (count, total) = (bad.len(), mesh.normals.len());
    if count == total {
        mesh.normals.clear();
        notes.add("bad-normals", format!("{}: none of its normals has a direction; it is shaded flat", mesh.name));
        return;
    }
    let mut sums = vec![DVec3::ZERO; total];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize].as_dvec3());
        let area = (b - a).cross(c - a);
        t.iter().for_each(|&i| sums[i as usize] += area);
    }
    for vertex in bad {
        // A vertex of no triangle, or of opposite ones, is never shaded alone; any unit vector will do.
        mesh.normals[vertex] = sums[vertex].try_normalize().unwrap_or(DVec3::Y).as_vec3();
    }
    notes.add(
        "bad-normals",
        format!("{}: {count} of {total} normals have no direction; those of the faces take their place", mesh.name),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degenerate_is_relative_to_size() {
        for scale in [1e-30, 1e-6, 1.0, 1e6, 1e30] {
            let at = |x: f64, y: f64| DVec3::new(x, y, 0.0) * scale;
            assert!(!is_degenerate([at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1e-6)]), "{scale}");
            assert!(is_degenerate([at(0.0, 0.0), at(1.0, 1.0), at(3.0, 3.0)]), "{scale}");
            assert!(is_degenerate([at(1.0, 2.0), at(1.0, 2.0), at(3.0, 3.0)]), "{scale}");
        }
        assert!(is_degenerate([DVec3::ZERO; 3]));
    }

    #[test]
    fn bad_normals_take_the_faces_direction() {
        let mut mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            triangles: vec![[0, 1, 2]],
            normals: vec![Vec3::new(0.0, 0.0, 3.0), Vec3::NAN, Vec3::ZERO, Vec3::ZERO],
            ..Mesh::default()
        };
        let mut notes = Notes::default();
        repair_normals(&mut mesh, &mut notes);
        assert_eq!(mesh.normals, [Vec3::Z, Vec3::Z, Vec3::Z, Vec3::Y]);
        assert_eq!(notes.finish().len(), 1);
        mesh.normals = vec![Vec3::ZERO; 4];
        repair_normals(&mut mesh, &mut Notes::default());
        assert!(mesh.normals.is_empty());
    }
}
