//! The rest pose of skinned and morphed meshes (glTF 2.0 §3.7.2.2 and §3.7.3), for those who ask to bake them.
//!
//! Morphing adds w·target to positions and normals; skinning then moves every vertex by Σ wᵢ Jᵢ Bᵢ, J the joint's world
//! transform and B its inverse bind matrix. A skinned mesh stands in the world, whatever its node's own transform is.

use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3};
use gltf_json::mesh::{Primitive, Semantic};

use super::buffers::Buffers;
use super::error::{Checked, Fault};
use super::notes::Notes;
use super::primitives::{attribute, repair_normals};
use crate::Mesh;

/// Joint indices and weights of all vertices, in one set.
type JointSet = (Vec<[f32; 4]>, Vec<[f32; 4]>);

/// Sets of joints (JOINTS_0, JOINTS_1, …) that are read.
const JOINT_SETS: u32 = 4;

/// Adds the morph targets with the given weights; does nothing when all weights are zero.
pub fn morph(buffers: &Buffers, primitive: &Primitive, weights: &[f32], mesh: &mut Mesh) -> Checked<()> {
    for (target, &weight) in primitive.targets.iter().flatten().zip(weights) {
        if weight == 0.0 {
            continue;
        }
        let add = |accessor: Option<usize>, values: &mut [Vec3]| -> Checked<()> {
            let Some(accessor) = accessor else { return Ok(()) };
            let offsets = buffers.vectors::<3>(accessor)?;
            if offsets.len() != values.len() && !values.is_empty() {
                return Err(Fault::invalid(&mesh.name, "a morph target differs in length from its base"));
            }
            for (value, offset) in values.iter_mut().zip(offsets) {
                *value += weight * Vec3::from_array(offset);
            }
            Ok(())
        };
        add(target.positions.map(|a| a.value()), &mut mesh.positions)?;
        add(target.normals.map(|a| a.value()), &mut mesh.normals)?;
    }
    Ok(())
}

/// Joint matrices of a skin: joint to world times inverse bind matrix.
pub fn joints(buffers: &Buffers, skin: usize, worlds: &[DAffine3]) -> Checked<Vec<DAffine3>> {
    let place = super::error::place("skin", skin, None);
    let found = buffers.document().root.skins.get(skin);
    let found = found.ok_or_else(|| Fault::invalid(&place, "it does not exist"))?;
    let inverse = match found.inverse_bind_matrices {
        Some(accessor) => buffers.vectors::<16>(accessor.value())?,
        None => vec![DMat4::IDENTITY.to_cols_array().map(|f| f as f32); found.joints.len()],
    };
    if inverse.len() < found.joints.len() {
        return Err(Fault::invalid(place, "it has fewer inverse bind matrices than joints"));
    }
    let joint = |(node, bind): (&gltf_json::Index<gltf_json::Node>, &[f32; 16])| {
        let bind = DMat4::from_cols_array(&bind.map(f64::from));
        let world = worlds.get(node.value()).copied().unwrap_or(DAffine3::IDENTITY);
        world * DAffine3::from_mat4(bind)
    };
    Ok(found.joints.iter().zip(&inverse).map(joint).collect())
}

/// Moves the mesh by its joints, into the world.
pub fn skin(buffers: &Buffers, primitive: &Primitive, joints: &[DAffine3], mesh: &mut Mesh) -> Checked<()> {
    let mut sets: Vec<JointSet> = Vec::new();
    for set in 0..JOINT_SETS {
        let pair = (attribute(primitive, &Semantic::Joints(set)), attribute(primitive, &Semantic::Weights(set)));
        if let (Some(joints), Some(weights)) = pair {
            sets.push((buffers.vectors::<4>(joints)?, buffers.vectors::<4>(weights)?));
        }
    }
    let vertices = mesh.positions.len();
    if sets.is_empty() || sets.iter().any(|(j, w)| j.len() != vertices || w.len() != vertices) {
        return Err(Fault::invalid(&mesh.name, "it is skinned, but lacks JOINTS_0 or WEIGHTS_0 for every vertex"));
    }
    for vertex in 0..vertices {
        let blend = blend(&sets, vertex, joints).ok_or_else(|| {
            Fault::invalid(&mesh.name, format!("vertex {vertex} has joints or weights that do not fit its skin"))
        })?;
        let moved = blend.transform_point3(mesh.positions[vertex].as_dvec3());
        mesh.positions[vertex] = moved.as_vec3();
        if let Some(normal) = mesh.normals.get_mut(vertex) {
            *normal = (cofactor(&blend.matrix3) * normal.as_dvec3()).normalize_or_zero().as_vec3();
        }
    }
    Ok(())
}

/// The weighted sum of a vertex's joint matrices; weights that do not add up to 1 are scaled.
fn blend(sets: &[JointSet], vertex: usize, joints: &[DAffine3]) -> Option<DAffine3> {
    let (mut sum, mut shift, mut total) = (DMat3::ZERO, DVec3::ZERO, 0.0);
    for (indices, weights) in sets {
        for (index, weight) in indices.get(vertex)?.iter().zip(weights.get(vertex)?) {
            let weight = f64::from(*weight);
            if weight == 0.0 {
                continue;
            }
            // Indices are small integers that were read as numbers.
            let joint = joints.get(*index as usize).filter(|_| weight > 0.0)?;
            sum += joint.matrix3 * weight;
            shift += joint.translation * weight;
            total += weight;
        }
    }
    let blend = DAffine3 { matrix3: sum * (1.0 / total), translation: shift / total };
    blend.is_finite().then_some(blend)
}

/// What normals transform by: the inverse transpose up to a positive factor, also where there is no inverse. Its sign
/// follows the determinant so that mirrored normals stay outside.
pub fn cofactor(m: &DMat3) -> DMat3 {
    let matrix = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    if m.determinant() < 0.0 { matrix * -1.0 } else { matrix }
}

/// After a pose: what must hold for every mesh holds again.
pub fn finish(mesh: &mut Mesh, notes: &mut Notes) -> Checked<()> {
    if let Some(vertex) = mesh.positions.iter().position(|p| !p.is_finite()) {
        return Err(Fault::invalid(&mesh.name, format!("the position of vertex {vertex} is not finite in its pose")));
    }
    let positions = &mesh.positions;
    let corner = |i: u32| positions.get(i as usize).map_or(DVec3::ZERO, |p| p.as_dvec3());
    mesh.triangles.retain(|t| !super::primitives::is_degenerate(t.map(corner)));
    repair_normals(mesh, notes);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blending_weights_joints() {
        let joints = [DAffine3::IDENTITY, DAffine3::from_translation(DVec3::X * 4.0)];
        let sets = [(vec![[0.0, 1.0, 0.0, 9.0]], vec![[1.0, 3.0, 0.0, 0.0]])];
        let blend_ = blend(&sets, 0, &joints).unwrap();
        assert_eq!(blend_.transform_point3(DVec3::ZERO), DVec3::X * 3.0, "weights are scaled to 1");
        let wrong = [(vec![[7.0, 0.0, 0.0, 0.0]], vec![[1.0, 0.0, 0.0, 0.0]])];
        assert!(blend(&wrong, 0, &joints).is_none(), "no such joint");
        let none = [(vec![[0.0; 4]], vec![[0.0; 4]])];
        assert!(blend(&none, 0, &joints).is_none(), "no weight at all");
    }

    #[test]
    fn normals_follow_the_surface() {
        let flat = DMat3::from_diagonal(DVec3::new(1.0, 4.0, 1.0));
        // The plane x + y = 0 becomes x + y/4 = 0.
        let normal = (cofactor(&flat) * DVec3::new(1.0, 1.0, 0.0)).normalize();
        assert!((normal - DVec3::new(1.0, 0.25, 0.0).normalize()).length() < 1e-12);
        let mirror = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        assert_eq!(cofactor(&mirror) * DVec3::X, DVec3::NEG_X);
    }
}
