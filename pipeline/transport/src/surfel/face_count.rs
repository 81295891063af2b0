//! The paper's area of a voxel, equation (1): ΔA(x) = Σ_{y ∈ N₆(x) ∩ Ō} xy · N, kept for comparison.

use glam::IVec3;

use super::Surfels;

/// Replaces every surfel's area by the free faces of its voxel, each weighted by its cosine with the normal. Where
/// no free face looks the surfel's way, nothing is left of it.
pub fn replace_areas(surfels: &mut Surfels) {
    let face = surfels.grid.edge * surfels.grid.edge;
    let areas: Vec<f32> = (0..surfels.list.len())
        .map(|i| {
            let s = &surfels.list[i];
            let free = |step: &IVec3| surfels.in_voxel(s.voxel() + *step).is_empty();
            let steps = [IVec3::X, IVec3::Y, IVec3::Z, IVec3::NEG_X, IVec3::NEG_Y, IVec3::NEG_Z];
            steps.iter().filter(|step| free(step)).map(|step| step.as_vec3().dot(s.normal).max(0.0) * face).sum()
        })
        .collect();
    for (s, area) in surfels.list.iter_mut().zip(areas) {
        s.area = area;
    }
}
