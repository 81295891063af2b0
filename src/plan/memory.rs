//! The memory that a bake takes beyond its scene, estimated before any work.

use luxel_atlas::AtlasSettings;
use luxel_scene::Scene;
use serde::Serialize;

use super::{Facts, Plan, Stage};
use crate::settings::{Gatherer, Settings, Voxels};

/// Estimated memory beyond the scene itself [bytes].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Memory {
    pub rays: u64,
    pub surfels: u64,
    pub texels: u64,
    pub images: u64,
    /// The scene's own buffers and images, which the export writes again.
    pub files: u64,
    /// A photon map; bakes have none.
    #[serde(skip)]
    pub photons: u64,
    /// Pictures of the scene; that of a bake is among the images.
    #[serde(skip)]
    pub picture: u64,
}

impl Memory {
    pub fn total(&self) -> u64 {
        self.parts().into_iter().fold(0, u64::saturating_add)
    }

    /// What the larger of two works takes, part by part: of those that are done one after the other.
    pub fn max(self, other: Self) -> Self {
        let [rays, surfels, texels, images, files, photons, picture] = self.parts();
        Self {
            rays: rays.max(other.rays),
            surfels: surfels.max(other.surfels),
            texels: texels.max(other.texels),
            images: images.max(other.images),
            files: files.max(other.files),
            photons: photons.max(other.photons),
            picture: picture.max(other.picture),
        }
    }

    fn parts(&self) -> [u64; 7] {
        let Self { rays, surfels, texels, images, files, photons, picture } = *self;
        [rays, surfels, texels, images, files, photons, picture]
    }
}

impl Plan {
    /// Takes the names of the light groups that are baked apart: the sum of some is held beside the next.
    pub fn part(&mut self, groups: Vec<String>, settings: &Settings) {
        self.light_groups = groups;
        if self.runs(Stage::Unwrap) {
            self.memory.texels = self.texel_bytes(pixels(&self.facts, settings), settings);
        }
    }

    fn texel_bytes(&self, pixels: u64, settings: &Settings) -> u64 {
        texel_bytes(pixels, settings, self.light_groups.len(), &|stage| self.runs(stage))
    }

    /// Counts the bytes of the files that the export writes again.
    pub fn weigh(&mut self, file_bytes: u64) {
        self.memory.files = file_bytes.saturating_mul(COPIES);
    }

    /// The memory of the trees of rays, whether or not the bake has a use for them.
    pub fn memory_of_rays(&self) -> u64 {
        rays_bytes(&self.facts)
    }

    /// The memory of the surfels and their light, whether or not the bake has a use for them.
    pub fn memory_of_surfels(&self, scene: &Scene, settings: &Settings) -> u64 {
        surfels_bytes(&self.facts, scene, settings)
    }

    /// The memory without what an atlas cannot have: no more pages than receivers, and no more than luxel makes. Objects
    /// that a texel density makes larger than a page get less of it.
    pub fn least_memory(&self, settings: &Settings) -> Memory {
        let side = u64::from(settings.size.0);
        let pages = (self.facts.receivers as u64).min(AtlasSettings::default().max_pages.into());
        let pixels = pages.saturating_mul(side * side);
        Memory {
            texels: self.memory.texels.min(self.texel_bytes(pixels, settings)),
            images: self.memory.images.min(image_bytes(pixels)),
            ..self.memory
        }
    }
}

// Bytes of the heap at the peak, as `cargo test --test memory -- --nocapture` measures them on two threads.
/// Per triangle: its geometry and the trees of rays, at the peak of their making.
const RAY_TRIANGLE: u64 = 410;
/// Per surfel: the surfel and its light while it is propagated.
const SURFEL: u64 = 145;
/// Per surfel and thread: the lines of a direction, where a slice of voxels may have as many as the scene has surfels;
/// a sweep has at most so many directions in flight that they stay below the second figure.
const LINES: u64 = 16;
const MOST_LINES: u64 = 64;
/// Per surfel, where a surface is so bright that bounces may not come to rest by themselves: the solver's history.
const STIFF: u64 = 125;
/// Per texel: where it is and its light, beside which its pages are made. While light is found its parts are still apart;
/// then there are no pages yet, and together they are less than this and [`PIXEL`].
const TEXEL: u64 = 38;
/// Per texel where light is interpolated between nodes, chart by chart: what a chart holds beside, for charts of up to a
/// sixth of all texels. Larger ones are rare and take more.
const CHARTED: u64 = 16;
/// Per texel: the stated bound, and its page.
const BOUND: u64 = 8;
/// Per texel while the light of one group of several is found: the sum of those before, which is gone when pages are
/// made; so it counts beside them only where light is interpolated, which takes as much as they do.
const GROUPS: u64 = 30;
/// Per pixel of a page: what is beside the texels while it is finished.
const PIXEL: u64 = 15;
/// Times that the bytes of the scene's files exist when they are written again: as read, laid out, and as a .glb.
const COPIES: u64 = 3;
/// The picture and what else does not grow with the scene.
const FIXED: u64 = 16 << 20;

/// Figures beyond all measure saturate: what asks for that much is refused by its stage, not by the estimate.
pub fn estimate(facts: &Facts, scene: &Scene, settings: &Settings, runs: &dyn Fn(Stage) -> bool) -> Memory {
    let pixels = pixels(facts, settings);
    let when = |stage, bytes| if runs(stage) { bytes } else { 0 };
    Memory {
        rays: when(Stage::Rays, rays_bytes(facts)),
        surfels: when(Stage::Surfels, surfels_bytes(facts, scene, settings)),
        texels: when(Stage::Unwrap, texel_bytes(pixels, settings, 1, runs)),
        images: when(Stage::Finish, image_bytes(pixels)),
        ..Memory::default()
    }
}

fn rays_bytes(facts: &Facts) -> u64 {
    (facts.triangles as u64).saturating_mul(RAY_TRIANGLE)
}

fn surfels_bytes(facts: &Facts, scene: &Scene, settings: &Settings) -> u64 {
    let surfels = match settings.voxels {
        Voxels::Budget(n) => u64::from(n),
        Voxels::Side(n) => patches(facts, longest_side(scene) / f64::from(n)),
        Voxels::Edge(edge) => patches(facts, f64::from(edge)),
    };
    surfels.saturating_mul(surfel_bytes(facts, settings))
}

/// Pixels of whole pages, of which charts cover about three quarters.
fn pixels(facts: &Facts, settings: &Settings) -> u64 {
    let side = u64::from(settings.size.0);
    match settings.texel_density.0 {
        Some(density) => {
            let texels = facts.area * f64::from(density) * f64::from(density) / 0.75;
            (texels as u64).div_ceil(side * side).max(1).saturating_mul(side * side)
        }
        None => side * side,
    }
}

fn surfel_bytes(facts: &Facts, settings: &Settings) -> u64 {
    let threads = match settings.threads.0 {
        0 => std::thread::available_parallelism().map_or(1, std::num::NonZero::get) as u64,
        n => u64::from(n),
    };
    SURFEL + (LINES * threads).min(MOST_LINES) + if facts.bright { STIFF } else { 0 }
}

/// Nine tenths of the pixels of a page are texels, partly covered ones included.
fn texel_bytes(pixels: u64, settings: &Settings, groups: usize, runs: &dyn Fn(Stage) -> bool) -> u64 {
    let charted = runs(Stage::Sky) || runs(Stage::Gather) && settings.gatherer() != Gatherer::Lookup;
    let bound = settings.bound && settings.states_bound() && runs(Stage::Gather);
    let parted = groups > 1 && (runs(Stage::Direct) || runs(Stage::Sky) || runs(Stage::Gather));
    let sum = if charted { GROUPS } else { GROUPS - PIXEL };
    let extras = [(charted, CHARTED), (bound, BOUND), (parted, sum)];
    let each = TEXEL + extras.into_iter().filter_map(|(is, bytes)| is.then_some(bytes)).sum::<u64>();
    (pixels / 10 * 9).saturating_mul(each)
}

fn image_bytes(pixels: u64) -> u64 {
    pixels.saturating_mul(PIXEL).saturating_add(FIXED)
}

/// Surfels of edge `edge` on the scene's area; a plane cuts about 1.5 times as many voxels as its area would fill.
fn patches(facts: &Facts, edge: f64) -> u64 {
    if edge > 0.0 { (1.5 * facts.area / (edge * edge)) as u64 } else { 0 }
}

fn longest_side(scene: &Scene) -> f64 {
    scene.bounds().map_or(0.0, |(lo, hi)| (hi - lo).max_element())
}

#[cfg(test)]
mod tests {
    use super::super::tests::room;
    use super::*;
    use crate::settings::value::OrAuto;
    use glam::Vec3;

    #[test]
    fn an_estimate_beyond_all_measure_is_still_a_number() {
        let scene = room(Vec3::splat(0.5), Vec3::ONE);
        let total = |settings| Plan::new(&scene, &settings).memory.total();
        let texel_density = OrAuto(Some(1e30));
        assert_eq!(total(Settings { texel_density, ..Settings::default() }), u64::MAX);
        assert_eq!(total(Settings { voxels: Voxels::Edge(1e-30), ..Settings::default() }), u64::MAX);
        assert!(total(Settings { voxels: Voxels::Edge(1e30), ..Settings::default() }) < u64::MAX);
        let texel_density = OrAuto(Some(f32::MAX));
        assert_eq!(
            total(Settings { texel_density, voxels: Voxels::Edge(f32::MIN_POSITIVE), ..Settings::default() }),
            u64::MAX
        );
    }

    #[test]
    fn an_atlas_has_no_more_pages_than_receivers() {
        let scene = room(Vec3::splat(0.5), Vec3::ONE);
        let of = |density| {
            let settings = Settings { texel_density: OrAuto(Some(density)), ..Settings::default() };
            let plan = Plan::new(&scene, &settings);
            let pages = plan.texel_bytes(2 << 20, &settings);
            (plan.least_memory(&settings), plan.memory, pages)
        };
        let (least, estimate, _) = of(1.0);
        assert_eq!(least, estimate);
        // Two objects on a page each, whatever their density.
        let (least, estimate, pages) = of(1e9);
        assert!(least.texels < estimate.texels && least.texels == pages);
        assert_eq!(least.images, image_bytes(2 << 20));
    }
}
