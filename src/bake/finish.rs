//! From light at texels to images: buried texels filled, padding dilated, seams stitched.

use luxel_atlas::{Atlas, FinishReport, FinishSettings, Image, finish};
use luxel_export::{BoundMap, Lightmap};
use luxel_scene::{Progress, Scene};
use luxel_transport::Rgb;

use super::texels::TexelLight;
use crate::Error;
use crate::plan::Plan;
use crate::settings::Settings;

/// Steps of [`run`]: the lightmaps, and the bounds.
pub const STEPS: u64 = 2;

/// One lightmap per page, and one map of stated bounds where the settings ask for it and the gather states one.
pub fn run(
    scene: &Scene,
    atlas: &Atlas,
    light: &TexelLight,
    settings: &Settings,
    plan: &Plan,
    progress: &dyn Progress,
) -> Result<(Vec<Lightmap>, Vec<BoundMap>, FinishReport), Error> {
    let how = FinishSettings { padding: settings.padding.0, ..FinishSettings::default() };
    let open = |i: usize| !light.buried[i];
    let (images, report) = finish(scene, atlas, |i| open(i).then(|| light.total(i)), &how)?;
    let lightmaps = images.into_iter().map(lightmap).collect::<Result<_, _>>()?;
    progress.advance(1);
    progress.check()?;
    let mut bounds = Vec::new();
    // What states no bound, be it the mode or because nothing was gathered, must not seem to state that its error is
    // nothing.
    if plan.states_bound(settings) {
        // A bound is no light: a seam may show in it.
        let how = FinishSettings { stitch: false, ..how };
        let (images, _) = finish(scene, atlas, |i| open(i).then(|| Rgb::splat(light.bound[i])), &how)?;
        bounds = images.into_iter().map(bound).collect::<Result<_, _>>()?;
    }
    progress.advance(1);
    Ok((lightmaps, bounds, report))
}

fn lightmap(image: Image) -> Result<Lightmap, Error> {
    Ok(Lightmap::new(image.width, image.height, image.values, image.coverage)?)
}

fn bound(image: Image) -> Result<BoundMap, Error> {
    Ok(BoundMap::new(image.width, image.height, image.values.iter().map(|p| p.x).collect())?)
}
