//! The small atlas on which settings are tried and errors mapped, as large as the scene needs.

use std::sync::Arc;

use luxel_atlas::{Atlas, AtlasError, AtlasReport};
use luxel_scene::{Progress, Scene};

use crate::Error;
use crate::bake::lab;
use crate::settings::{
    Settings,
    value::{OrAuto, Texels},
};
use crate::store::Store;

/// A scene's texels, and the settings with which they lie there.
pub struct Small {
    pub settings: Settings,
    pub atlas: Arc<Atlas>,
    pub report: AtlasReport,
}

/// The settings with an atlas of so many texels along a side, however dense.
pub fn sized(base: &Settings, side: u32) -> Settings {
    Settings { size: Texels(side), texel_density: OrAuto(None), ..base.clone() }
}

/// Lays a scene out on an atlas of `side` texels, doubled until every object has a place for its charts, but at most of
/// `most`.
///
/// # Errors
/// As a bake with an atlas of `most`.
pub fn lay_out(
    scene: &Scene,
    base: &Settings,
    (side, most): (u32, u32),
    store: Option<&Store>,
    progress: &dyn Progress,
) -> Result<Small, Error> {
    let mut side = side.min(most);
    loop {
        let settings = sized(base, side);
        match lab::lay_out(scene, &settings, store, progress) {
            Err(Error::Atlas(AtlasError::TooManyCharts { .. })) if side < most => side = (2 * side).min(most),
            found => return found.map(|(atlas, report)| Small { settings, atlas, report }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_scene::{Silent, build::Builder};

    #[test]
    fn an_atlas_grows_until_all_charts_have_a_place() {
        let mut b = Builder::new("many charts");
        let grey = b.matte(Vec3::splat(0.5));
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for i in 0..100u32 {
            // No two of them share an edge.
            let o = Vec3::new((i % 10) as f32, 0.3 * (i % 7) as f32, (i / 10) as f32);
            positions.extend([o, o + Vec3::Z * 0.5, o + Vec3::X * 0.5]);
            triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
        }
        b.mesh("shards", positions, triangles, grey);
        let scene = b.build();
        let small = |most| lay_out(&scene, &Settings::default(), (16, most), None, &Silent);
        let found = small(1024).unwrap();
        assert!(found.settings.size.0 > 16 && found.settings.size.0 < 1024, "{}", found.settings.size.0);
        assert_eq!(small(found.settings.size.0 / 2).err().map(|e| matches!(e, Error::Atlas(_))), Some(true));
    }
}
