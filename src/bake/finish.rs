//! From light at texels to images: buried texels filled, padding dilated, seams stitched.

use luxel_atlas::{Atlas, FinishReport, FinishSettings, Image, finish};
use luxel_export::{BoundMap, Lightmap};
use luxel_scene::Scene;
use luxel_transport::Rgb;

use super::texels::TexelLight;
use crate::Error;
use crate::settings::Settings;

/// One lightmap per page, and one map of stated bounds where the settings ask for it and the gather states one.
pub fn run(
    scene: &Scene,
    atlas: &Atlas,
    light: &TexelLight,
    settings: &Settings,
) -> Result<(Vec<Lightmap>, Vec<BoundMap>, FinishReport), Error> {
    let valid: Vec<bool> = light.buried.iter().map(|b| !b).collect();
    let values: Vec<Rgb> = (0..atlas.texels.len()).map(|i| light.total(i)).collect();
    let how = FinishSettings { padding: settings.padding.0, ..FinishSettings::default() };
    let (images, report) = finish(scene, atlas, &values, &valid, &how)?;
    let lightmaps = images.iter().map(lightmap).collect::<Result<_, _>>()?;
    let mut bounds = Vec::new();
    // A mode that states no bound must not seem to state that its error is nothing.
    if settings.bound && settings.states_bound() {
        let values: Vec<Rgb> = light.bound.iter().map(|b| Rgb::splat(*b)).collect();
        // A bound is no light: a seam may show in it.
        let (images, _) = finish(scene, atlas, &values, &valid, &FinishSettings { stitch: false, ..how })?;
        bounds = images.iter().map(bound).collect::<Result<_, _>>()?;
    }
    Ok((lightmaps, bounds, report))
}

fn lightmap(image: &Image) -> Result<Lightmap, Error> {
    let irradiance = image.pixels.iter().map(|[r, g, b, _]| Rgb::new(*r, *g, *b)).collect();
    let coverage = image.pixels.iter().map(|p| p[3]).collect();
    Ok(Lightmap::new(image.width, image.height, irradiance, coverage)?)
}

fn bound(image: &Image) -> Result<BoundMap, Error> {
    Ok(BoundMap::new(image.width, image.height, image.pixels.iter().map(|p| p[0]).collect())?)
}
