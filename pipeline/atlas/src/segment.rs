//! Where charts must end: hard edges, and parts too large for one go.
//!
//! Light bends around a hard edge in no way that a bilinear texture could follow, so a chart ends there. An edge is
//! smooth when its faces meet within 40°, or within 75° if the vertex normals on both sides agree (a coarse
//! cylinder that is shaded round).

use crate::mesh::{Joint, Solid};

/// cos 40°
const SMOOTH_FACES: f64 = 0.766_044_443;
/// cos 75°
const SMOOTH_FACES_SHADED: f64 = 0.258_819_045;
/// cos 11°
const SAME_NORMAL: f64 = 0.981_627_183;

pub(crate) fn is_smooth(solid: &Solid, joint: &Joint) -> bool {
    let bend = solid.bend(joint);
    bend >= SMOOTH_FACES
        || (bend >= SMOOTH_FACES_SHADED && solid.shading_bend(joint).is_some_and(|cosine| cosine >= SAME_NORMAL))
}

/// The triangles of a mesh in parts connected over smooth edges, ordered by their first triangles. Triangles without
/// area are in no part.
pub(crate) fn smooth_parts(solid: &Solid) -> Vec<Vec<u32>> {
    let joints = solid.joints();
    let links: Vec<[u32; 2]> = joints.iter().filter(|j| is_smooth(solid, j)).map(|j| j.triangles).collect();
    let members: Vec<u32> = (0..solid.areas.len() as u32).filter(|&t| solid.areas[t as usize] > 0.0).collect();
    connected(solid.areas.len(), &members, &links)
}

/// Connected parts of `members` under `links`, each ascending, ordered by their first members.
pub(crate) fn connected(count: usize, members: &[u32], links: &[[u32; 2]]) -> Vec<Vec<u32>> {
    let mut parent: Vec<u32> = (0..count as u32).collect();
    for &[a, b] in links {
        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
        // The smaller number leads, so a part's root is its first member.
        parent[a.max(b) as usize] = a.min(b);
    }
    let mut number = vec![u32::MAX; count];
    let mut parts: Vec<Vec<u32>> = Vec::new();
    for &t in members {
        let root = root(&mut parent, t) as usize;
        if number[root] == u32::MAX {
            number[root] = parts.len() as u32;
            parts.push(Vec::new());
        }
        parts[number[root] as usize].push(t);
    }
    parts
}

fn root(parent: &mut [u32], mut t: u32) -> u32 {
    while parent[t as usize] != t {
        let up = parent[parent[t as usize] as usize];
        parent[t as usize] = up;
        t = up;
    }
    t
}

/// Halves a part across its longest side until no half has more than `limit` triangles.
pub(crate) fn chopped(solid: &Solid, part: Vec<u32>, limit: usize) -> Vec<Vec<u32>> {
    let mut done = Vec::new();
    let mut todo = vec![part];
    while let Some(mut part) = todo.pop() {
        if part.len() <= limit {
            part.sort_unstable();
            done.push(part);
            continue;
        }
        let (lo, hi) = solid.bounds(&part);
        let side = hi - lo;
        let axis = if side.x >= side.y && side.x >= side.z { 0 } else { 1 + usize::from(side.z > side.y) };
        let at = |t: &u32| solid.corners(*t).iter().map(|p| p[axis]).sum::<f64>();
        part.sort_by(|a, b| at(a).total_cmp(&at(b)).then(a.cmp(b)));
        let right = part.split_off(part.len() / 2);
        todo.extend([right, part]);
    }
    done
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_scene::build::Builder;

    fn parts_of(build: impl FnOnce(&mut Builder)) -> Vec<usize> {
        let mut b = Builder::new("t");
        build(&mut b);
        let scene = b.build();
        smooth_parts(&Solid::new(&scene.meshes[0])).iter().map(Vec::len).collect()
    }

    #[test]
    fn a_box_has_six_smooth_parts() {
        assert_eq!(parts_of(|b| _ = b.cuboid("c", Vec3::ZERO, Vec3::ONE, 0, false)), [2; 6]);
    }

    #[test]
    fn a_sphere_is_smooth_and_can_be_chopped() {
        assert_eq!(parts_of(|b| _ = b.sphere("s", Vec3::ZERO, 1.0, 16, 0, false)).len(), 1);
        let mut b = Builder::new("t");
        b.sphere("s", Vec3::ZERO, 1.0, 16, 0, false);
        let scene = b.build();
        let solid = Solid::new(&scene.meshes[0]);
        let part = smooth_parts(&solid).remove(0);
        let pieces = chopped(&solid, part.clone(), 100);
        assert!(pieces.iter().all(|p| p.len() <= 100));
        let mut all: Vec<u32> = pieces.concat();
        all.sort_unstable();
        assert_eq!(all, part);
    }
}
