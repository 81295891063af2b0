//! The figures of the paper's Table 1 (Piwowar & Malgouyres 2009, §5), read off the course of a bake.

use luxel_export::report::Table1;

use super::journal::Journal;
use super::transport::Facts;
use crate::plan::Stage;

/// The stages that trace continuous rays.
const TRACING: [Stage; 5] = [Stage::Shoot, Stage::Refresh, Stage::Direct, Stage::Sky, Stage::Gather];

/// The figures of a bake of so many triangles that took so long. What was reused counts as when it was made; rates are
/// of what this bake itself traced.
pub fn table1(triangles: usize, facts: &Facts, journal: &Journal, seconds: f64) -> Table1 {
    let sum = |stages: &[Stage]| stages.iter().map(|s| journal.seconds(*s)).sum::<f64>();
    let traced = TRACING.iter().map(|s| journal.count_run(*s, "continuous_rays")).sum();
    let primary = journal.count(Stage::Shoot, "primary_photons");
    let (path_length, directions, discrete_rays) =
        facts.record.as_ref().map_or((0, 0, 0), |r| (r.path_length, r.directions, r.discrete_rays));
    Table1 {
        triangles: triangles as u64,
        voxels: facts.surfels,
        light_path_length: path_length,
        voxel_directions: directions,
        primary_photons: primary,
        direct_photons: journal.count(Stage::Shoot, "sent_photons").checked_div(primary).unwrap_or_default(),
        continuous_rays: TRACING.iter().map(|s| journal.count(*s, "continuous_rays")).sum(),
        discrete_rays,
        propagation_seconds: sum(&[Stage::Surfels, Stage::Shoot, Stage::Propagate, Stage::Refresh]),
        linear_method_seconds: journal.seconds(Stage::Propagate),
        reconstruction_seconds: sum(&[Stage::Direct, Stage::Sky, Stage::Gather]),
        overall_seconds: seconds,
        ..Table1::default()
    }
    .with_rates(traced, sum(&TRACING))
}
