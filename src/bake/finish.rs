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
    let buried = buried(atlas, light);
    let lightmaps = images.into_iter().zip(&buried).map(|(i, b)| lightmap(i, b)).collect::<Result<_, _>>()?;
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

fn lightmap(image: Image, buried: &[usize]) -> Result<Lightmap, Error> {
    Ok(Lightmap::new(image.width, image.height, image.values, image.coverage)?.with_buried(buried)?)
}

/// Places of the buried texels of each page.
fn buried(atlas: &Atlas, light: &TexelLight) -> Vec<Vec<usize>> {
    let mut places = vec![Vec::new(); atlas.pages.len()];
    for (texel, _) in atlas.texels.iter().zip(&light.buried).filter(|(_, buried)| **buried) {
        let page = atlas.chart(texel).page as usize;
        places[page].push(usize::from(texel.y) * atlas.pages[page].width as usize + usize::from(texel.x));
    }
    places
}

fn bound(image: Image) -> Result<BoundMap, Error> {
    Ok(BoundMap::new(image.width, image.height, image.values.iter().map(|p| p.x).collect())?)
}
