//! Projection of triangles onto their mean plane: exact for flat parts, good for gently curved ones, and the last
//! resort for everything.

use glam::{DVec2, DVec3};

use crate::mesh::Solid;
use crate::segment::connected;
use crate::{overlap, shape};

/// cos 25°: a projected triangle loses at most 9 % of its area against the others.
const GENTLE: f64 = 0.906_307_787;
/// cos 35°: how far a group of the last resort grows from its first normal.
const SIMILAR: f64 = 0.819_152_044;
/// cos 45°: what a group of the last resort may have between a face and its mean.
const BEARABLE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// The part projected, if all its normals are within 25° of their mean and nothing overlaps (a spiral ramp does).
pub(crate) fn project_if_gentle(solid: &Solid, part: &[u32]) -> Option<Vec<[DVec2; 3]>> {
    project(solid, part, GENTLE)
}

fn project(solid: &Solid, part: &[u32], least_cosine: f64) -> Option<Vec<[DVec2; 3]>> {
    let mean = part.iter().map(|&t| solid.normals[t as usize] * solid.areas[t as usize]).sum::<DVec3>();
    let normal = mean.try_normalize()?;
    if part.iter().any(|&t| solid.normals[t as usize].dot(normal) < least_cosine) {
        return None;
    }
    let (u, v) = frame(normal);
    let origin = solid.corners(*part.first()?)[0];
    let uvs: Vec<[DVec2; 3]> =
        part.iter().map(|&t| solid.corners(t).map(|p| DVec2::new(u.dot(p - origin), v.dot(p - origin)))).collect();
    // A lone triangle or a quad has nothing to overlap with.
    if part.len() > 2 && overlap::check(&uvs).is_err() {
        return None;
    }
    Some(scaled(solid, part, shape::upright(uvs)))
}

/// Makes the UV area equal to the surface area.
fn scaled(solid: &Solid, part: &[u32], mut uvs: Vec<[DVec2; 3]>) -> Vec<[DVec2; 3]> {
    let area: f64 = part.iter().map(|&t| solid.areas[t as usize]).sum();
    let flat: f64 = uvs.iter().map(|t| overlap::signed_area(t).abs()).sum();
    let factor = (area / flat).sqrt();
    if factor.is_finite() {
        uvs.iter_mut().flatten().for_each(|p| *p *= factor);
    }
    uvs
}

/// Two unit vectors that span the plane under a unit normal (Duff et al. 2017).
fn frame(n: DVec3) -> (DVec3, DVec3) {
    let sign = if n.z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), DVec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// Charts that always work: connected groups of triangles whose normals are near the group's first one, projected;
/// a group that overlaps itself falls into single triangles.
pub(crate) fn groups(solid: &Solid, triangles: &[u32]) -> Vec<(Vec<u32>, Vec<[DVec2; 3]>)> {
    let mut out = Vec::new();
    for group in similar(solid, triangles) {
        if let Some(uvs) = project(solid, &group, BEARABLE) {
            out.push((group, uvs));
            continue;
        }
        for t in group {
            if let Some(uvs) = project(solid, &[t], BEARABLE) {
                out.push((vec![t], uvs));
            }
        }
    }
    out
}

/// Grows connected groups of triangles whose normals are within 35° of the group's first one.
fn similar(solid: &Solid, triangles: &[u32]) -> Vec<Vec<u32>> {
    let mut inside = vec![false; solid.areas.len()];
    triangles.iter().for_each(|&t| inside[t as usize] = true);
    let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); solid.areas.len()];
    for [a, b] in solid.joints().iter().map(|j| j.triangles) {
        if inside[a as usize] && inside[b as usize] {
            neighbours[a as usize].push(b);
            neighbours[b as usize].push(a);
        }
    }
    let mut seed_of = vec![u32::MAX; solid.areas.len()];
    for &seed in triangles {
        if seed_of[seed as usize] != u32::MAX {
            continue;
        }
        seed_of[seed as usize] = seed;
        let mut todo = vec![seed];
        while let Some(t) = todo.pop() {
            for &next in &neighbours[t as usize] {
                let near = solid.normals[next as usize].dot(solid.normals[seed as usize]) >= SIMILAR;
                if seed_of[next as usize] == u32::MAX && near {
                    seed_of[next as usize] = seed;
                    todo.push(next);
                }
            }
        }
    }
    let links: Vec<[u32; 2]> = triangles.iter().map(|&t| [seed_of[t as usize], t]).collect();
    let mut members = triangles.to_vec();
    members.sort_unstable();
    connected(solid.areas.len(), &members, &links)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_scene::Mesh;
    use luxel_scene::build::Builder;

    #[test]
    fn frames_are_orthonormal_and_right_handed() {
        for n in [DVec3::X, DVec3::NEG_Z, DVec3::new(0.48, -0.6, 0.64), DVec3::new(-0.6, 0.0, -0.8)] {
            let (u, v) = frame(n);
            assert!(u.cross(v).distance(n) < 1e-12 && u.dot(n).abs() < 1e-12);
        }
    }

    #[test]
    fn a_spiral_ramp_is_not_projected_onto_itself() {
        let mut mesh = Mesh::default();
        for i in 0..=48_u32 {
            let angle = f64::from(i) * std::f64::consts::TAU / 24.0;
            let (c, s) = (libm::cos(angle) as f32, libm::sin(angle) as f32);
            let y = i as f32 * 0.02;
            mesh.positions.extend([Vec3::new(c, y, s), Vec3::new(2.0 * c, y, 2.0 * s)]);
            if i > 0 {
                let k = 2 * i;
                mesh.triangles.extend([[k - 2, k, k - 1], [k - 1, k, k + 1]]);
            }
        }
        let solid = Solid::new(&mesh);
        let all: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
        assert!(project_if_gentle(&solid, &all[..40]).is_some());
        assert!(project_if_gentle(&solid, &all).is_none());
        assert_eq!(groups(&solid, &all).iter().map(|(g, _)| g.len()).sum::<usize>(), all.len());
    }

    #[test]
    fn groups_of_a_sphere_cover_it_without_overlap() {
        let mut b = Builder::new("t");
        b.sphere("s", Vec3::ZERO, 1.0, 12, 0, false);
        let scene = b.build();
        let solid = Solid::new(&scene.meshes[0]);
        let all: Vec<u32> = (0..solid.areas.len() as u32).collect();
        let groups = groups(&solid, &all);
        assert!(groups.len() < 60, "{}", groups.len());
        let area: f64 = groups.iter().flat_map(|(_, uvs)| uvs).map(|t| overlap::signed_area(t).abs()).sum();
        assert!((area / solid.areas.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        assert!(groups.iter().all(|(_, uvs)| overlap::check(uvs).is_ok()));
    }
}
