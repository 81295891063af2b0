//! The artist's own lightmap UVs: TEXCOORD_1, kept when it can serve.
//!
//! It can when every vertex has a finite coordinate in [0, 1]², when triangles with surface have area in UV, and when
//! triangles do not lie on each other, checked over all primitives that share the layout. Mirrored charts are
//! fine.

use glam::{DVec2, Vec2};
use luxel_scene::Mesh;

use crate::mesh::Solid;
use crate::overlap::{self, Overlap};

/// The set that holds lightmap coordinates by convention.
pub const LIGHTMAP_SET: usize = 1;
/// Exporters round; so much outside [0, 1] is still inside.
const OUTSIDE: f32 = 1e-4;
/// UV area over surface area may be so much below the layout's mean before a triangle counts as left out …
const STARVED: f64 = 1e-6;
/// … if it has this share of the surface.
const NOTABLE: f64 = 1e-6;

/// What an authored layout came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    Valid,
    /// The file brings none: nothing to report.
    Absent,
    /// Why it cannot serve.
    Invalid(String),
}

/// Judges the layout that these meshes share.
pub fn judge(meshes: &[&Mesh]) -> Verdict {
    let has = |mesh: &&Mesh| mesh.uvs.get(LIGHTMAP_SET).is_some_and(|set| !set.is_empty());
    match meshes.iter().filter(|m| has(m)).count() {
        0 => Verdict::Absent,
        n if n < meshes.len() => {
            Verdict::Invalid(format!("{} of {} primitives have no TEXCOORD_1", meshes.len() - n, meshes.len()))
        }
        _ => flaw(meshes).map_or(Verdict::Valid, Verdict::Invalid),
    }
}

fn flaw(meshes: &[&Mesh]) -> Option<String> {
    let mut layout: Vec<[DVec2; 3]> = Vec::new();
    // Primitive, triangle and surface area of each entry of the layout.
    let mut origin: Vec<(usize, usize, f64)> = Vec::new();
    for (primitive, mesh) in meshes.iter().enumerate() {
        let set = &mesh.uvs[LIGHTMAP_SET];
        if set.len() != mesh.positions.len() {
            return Some(format!("TEXCOORD_1 has {} entries for {} vertices", set.len(), mesh.positions.len()));
        }
        if let Some((i, uv)) = set.iter().enumerate().find(|(_, uv)| !inside(**uv)) {
            return Some(if uv.is_finite() {
                format!("vertex {i} lies outside [0, 1] at ({}, {})", uv.x, uv.y)
            } else {
                format!("vertex {i} is not finite")
            });
        }
        let solid = Solid::new(mesh);
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            if solid.areas[t] > 0.0 {
                layout.push(triangle.map(|v| set[v as usize].as_dvec2()));
                origin.push((primitive, t, solid.areas[t]));
            }
        }
    }
    let name = |i: usize| {
        let (primitive, triangle, _) = origin[i];
        if meshes.len() == 1 { format!("{triangle}") } else { format!("{triangle} of primitive {primitive}") }
    };
    let area: f64 = layout.iter().map(|t| overlap::signed_area(t).abs()).sum();
    let surface: f64 = origin.iter().map(|o| o.2).sum();
    if area <= 0.0 {
        return Some("TEXCOORD_1 has no area".into());
    }
    let starved = |i: &usize| {
        let share = origin[*i].2 / surface;
        share > NOTABLE && overlap::signed_area(&layout[*i]).abs() / area < STARVED * share
    };
    if let Some(i) = (0..layout.len()).find(starved) {
        return Some(format!("triangle {} has no area in TEXCOORD_1", name(i)));
    }
    match overlap::check(&layout) {
        Ok(()) => None,
        Err(Overlap::Pair(a, b, share)) => {
            Some(format!("triangles {} and {} overlap by {:.0} %", name(a), name(b), (share * 100.0).ceil()))
        }
        Err(Overlap::Entangled) => Some("its triangles cross each other too much to be checked".into()),
    }
}

fn inside(uv: Vec2) -> bool {
    uv.is_finite() && uv.min_element() >= -OUTSIDE && uv.max_element() <= 1.0 + OUTSIDE
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn quad(uv: [Vec2; 4]) -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            uvs: vec![vec![], uv.to_vec()],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    const UNIT: [Vec2; 4] = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];

    #[test]
    fn good_and_mirrored_layouts_are_valid() {
        assert_eq!(judge(&[&quad(UNIT)]), Verdict::Valid);
        assert_eq!(judge(&[&quad(UNIT.map(|p| Vec2::new(1.0 - p.x, p.y)))]), Verdict::Valid);
    }

    #[test]
    fn no_layout_is_absent_and_half_a_layout_is_named() {
        let bare = Mesh { uvs: vec![], ..quad(UNIT) };
        assert_eq!(judge(&[&bare]), Verdict::Absent);
        assert_eq!(judge(&[&bare, &quad(UNIT)]), Verdict::Invalid("1 of 2 primitives have no TEXCOORD_1".into()));
    }

    #[test]
    fn every_flaw_is_named() {
        let says = |uv: [Vec2; 4], word: &str| match judge(&[&quad(uv)]) {
            Verdict::Invalid(why) => assert!(why.contains(word), "{why}"),
            other => panic!("{other:?}"),
        };
        says([Vec2::ZERO, Vec2::X * 1.5, Vec2::ONE, Vec2::Y], "outside");
        says([Vec2::ZERO, Vec2::NAN, Vec2::ONE, Vec2::Y], "not finite");
        says([Vec2::ZERO; 4], "no area");
        says([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::X], "overlap by 100 %");
        says([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::splat(0.5)], "triangle 1 has no area");
    }

    #[test]
    fn primitives_that_share_a_layout_must_not_overlap() {
        let half = |x: f32| quad(UNIT.map(|p| Vec2::new(x + 0.5 * p.x, p.y)));
        assert_eq!(judge(&[&half(0.0), &half(0.5)]), Verdict::Valid);
        let Verdict::Invalid(why) = judge(&[&half(0.0), &half(0.1)]) else { panic!() };
        assert!(why.contains("of primitive 1"), "{why}");
    }
}
