//! From light to files: the picture, the scene with its lightmap, and everything written in one go.

use std::path::{Path, PathBuf};

use luxel_export::{
    Effort, Images, Original, OutputSet, Report, StagedImages, ToneMap, encode_png_with, report::Warning,
    sample_lightmap,
};
use luxel_scene::{Progress, Scene};
use luxel_transport::Rgb;

use super::journal::Journal;
use super::tracer::Tracer;
use super::{Baking, Lit, Request};
use crate::Error;
use crate::plan::{Plan, Stage};
use crate::preview::{Picture, Preview};

/// The encoded preview picture; none where nothing receives light.
pub fn preview(baking: &Baking, tracer: &Tracer, lit: &Lit, journal: &mut Journal) -> Result<Option<Vec<u8>>, Error> {
    let Baking { plan, lighting, .. } = baking;
    let rays =
        if plan.runs(Stage::Preview) && plan.runs(Stage::Rays) { Some(tracer.rays(plan, journal)?) } else { None };
    let png = journal.run(plan, Stage::Preview, None, |progress, counters| {
        let picture = match rays {
            Some(rays) => {
                let irradiance = |instance, triangle, u, v| at(lit, instance, triangle, u, v);
                let (emission, sky) = (&lighting.emission[..], lighting.sky);
                Preview { rays, irradiance: &irradiance, mean: lit.sums.mean, emission, sky }.render(progress)?
            }
            None => Picture::black(tracer.geometry.scene),
        };
        counters.insert("pixels".into(), picture.radiance.len() as u64);
        let tone = ToneMap::auto(&picture.radiance, progress)?;
        let picture = tone.picture(picture.width, picture.height, &picture.radiance, progress)?;
        Ok(encode_png_with(&picture, Effort::Small, progress)?)
    })?;
    Ok(png)
}

/// The finished lightmap at a point of an instance.
fn at(lit: &Lit, instance: u32, triangle: u32, u: f32, v: f32) -> Option<Rgb> {
    let placed = lit.atlas.placed.get(instance as usize)?.as_ref()?;
    let corners = placed.triangles.get(triangle as usize)?;
    let [a, b, c] = corners.map(|i| placed.uvs[i as usize]);
    let uv = a * (1.0 - u - v) + b * u + c * v;
    Some(sample_lightmap(&lit.lightmaps, placed.page, uv))
}

/// The images, under temporary names, and at the same time the scene with its lightmap, over the file as it was.
pub fn encode(
    request: &Request,
    (original, scene): (&Original, &Scene),
    plan: &Plan,
    (lit, images): (&Lit, &Images),
    report: &mut Report,
    journal: &mut Journal,
) -> Result<(StagedImages, Vec<u8>), Error> {
    journal.always(Stage::Export, plan.reason(Stage::Export), Some(0), |progress, counters| {
        let names = request.outputs.lightmap_names(lit.lightmaps.len());
        let mut staged = Ok(StagedImages::default());
        let glb = rayon::in_place_scope(|beside| {
            beside.spawn(|_| staged = request.outputs.stage(images, progress));
            original.lightmapped(scene, &lit.atlas, &lit.lightmaps, &names, images.effort, progress)
        });
        let (staged, glb) = (staged?, glb?);
        report.warnings.extend(glb.notices.iter().map(Warning::from));
        let clipped: usize = glb.pages.iter().map(|p| p.clipped).sum();
        counters.insert("bytes".into(), glb.bytes.len() as u64);
        counters.insert("clipped_texels".into(), clipped as u64);
        Ok((staged, glb.bytes))
    })
}

/// Makes the folder of the outputs and sees that all files can be written there, before hours are spent on what goes
/// in.
pub fn probe(outputs: &OutputSet) -> Result<(), Error> {
    let folder = outputs.folder();
    let failed = |source| Error::Folder { path: folder.into(), source };
    std::fs::create_dir_all(folder).map_err(failed)?;
    can_write(folder).map_err(failed)?;
    Ok(outputs.check_names()?)
}

/// Sees that a file can be written into a folder.
pub fn can_write(folder: &Path) -> std::io::Result<()> {
    tempfile::NamedTempFile::new_in(folder)?.close()
}

/// Writes all files; returns them in the order of writing.
pub fn write(
    outputs: &OutputSet,
    (images, glb): (StagedImages, Vec<u8>),
    report: &mut Report,
    progress: &dyn Progress,
) -> Result<Vec<PathBuf>, Error> {
    outputs.write(images, &glb, report, progress)?;
    let listed = report.outputs.iter().map(|o| outputs.folder().join(&o.path));
    Ok(listed.chain([outputs.report()]).collect())
}
