//! Triangles out of the primitive modes (glTF 2.0 §3.7.2.1).

use gltf_json::mesh::Mode;

/// The triangles of `count` consecutive vertices or indices, as positions in that list; None for points and lines.
///
/// Strips alternate their winding so that all triangles face the same way; fans turn about their first vertex. What
/// is left over of a list that is no multiple of three belongs to no triangle.
pub fn triangles(mode: Mode, count: usize) -> Option<Vec<[usize; 3]>> {
    let last = count.saturating_sub(2);
    match mode {
        Mode::Triangles => Some((0..count / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect()),
        Mode::TriangleStrip => Some((0..last).map(|i| [i, i + 1 + i % 2, i + 2 - i % 2]).collect()),
        Mode::TriangleFan => Some((0..last).map(|i| [i + 1, i + 2, 0]).collect()),
        Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_strips_and_fans() {
        assert_eq!(triangles(Mode::Triangles, 7).unwrap(), [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(triangles(Mode::TriangleStrip, 5).unwrap(), [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        assert_eq!(triangles(Mode::TriangleFan, 5).unwrap(), [[1, 2, 0], [2, 3, 0], [3, 4, 0]]);
        assert_eq!(triangles(Mode::Lines, 6), None);
    }

    #[test]
    fn too_few_vertices_make_no_triangle() {
        for mode in [Mode::Triangles, Mode::TriangleStrip, Mode::TriangleFan] {
            for count in 0..3 {
                assert_eq!(triangles(mode, count).unwrap().len(), 0, "{mode:?} {count}");
            }
        }
    }
}
