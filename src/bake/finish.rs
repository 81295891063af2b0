//! From light at texels to images: buried texels filled, padding dilated, seams stitched.

use std::borrow::Cow;

use luxel_atlas::{Atlas, FinishReport, FinishSettings, Image, finish};
use luxel_export::{BoundMap, Lightmap};
use luxel_scene::{Progress, Scene};
use luxel_transport::Rgb;

use super::light::TexelLight;
use crate::Error;
use crate::plan::Plan;
use crate::settings::Settings;

/// Steps of [`run`]: the bounds, and the lightmaps.
pub const STEPS: u64 = 2;

/// One lightmap per page, and one map of stated bounds where the settings ask for it and the gather states one. Light
/// that is given away lives until it lies in its page.
pub fn run(
    scene: &Scene,
    atlas: &Atlas,
    light: Cow<TexelLight>,
    settings: &Settings,
    plan: &Plan,
    progress: &dyn Progress,
) -> Result<(Vec<Lightmap>, Vec<BoundMap>, FinishReport), Error> {
    let (irradiance, bound, buried) = match light {
        Cow::Owned(l) => (Cow::Owned(l.irradiance), Cow::Owned(l.bound), Cow::Owned(l.buried)),
        Cow::Borrowed(l) => {
            (Cow::Borrowed(&l.irradiance[..]), Cow::Borrowed(&l.bound[..]), Cow::Borrowed(&l.buried[..]))
        }
    };
    let how = FinishSettings { padding: settings.padding.0, ..FinishSettings::default() };
    let mut bounds = Vec::new();
    // What states no bound, be it the mode or because nothing was gathered, must not seem to state that its error is
    // nothing. Its images are the smaller ones, so they are made before the others take their place.
    if plan.states_bound(settings) {
        // A bound is no light: a seam may show in it.
        let how = FinishSettings { stitch: false, ..how };
        let buried = &buried;
        let value = move |i: usize| (!buried[i]).then(|| Rgb::splat(bound[i]));
        let (images, _) = finish(scene, atlas, value, &how, progress)?;
        bounds = images.into_iter().map(bound_map).collect::<Result<_, _>>()?;
    }
    progress.advance(1);
    progress.check()?;
    let value = move |i: usize| (!buried[i]).then(|| irradiance[i]);
    let (images, report) = finish(scene, atlas, value, &how, progress)?;
    let lightmaps = images.into_iter().map(lightmap).collect::<Result<_, _>>()?;
    progress.advance(1);
    Ok((lightmaps, bounds, report))
}

fn lightmap(image: Image) -> Result<Lightmap, Error> {
    Ok(Lightmap::new(image.width, image.height, image.values, image.coverage)?)
}

fn bound_map(image: Image) -> Result<BoundMap, Error> {
    Ok(BoundMap::new(image.width, image.height, image.values.iter().map(|p| p.x).collect())?)
}
