//! From light to files: the picture, the scene with its lightmap, and everything written in one go.

use std::path::{Path, PathBuf};

use luxel_export::{
    Effort, Images, Original, OutputSet, Report, StagedImages, ToneMap, encode_png_with, report::Warning,
};
use luxel_scene::{Progress, Scene};

use super::journal::Journal;
use super::tracer::Tracer;
use super::{Baking, Lit, Request};
use crate::Error;
use crate::current::{self, Reason};
use crate::plan::{Plan, Stage};
use crate::render::light::ByLightmap;
use crate::render::march::Look;
use crate::render::preview;
use crate::render::studio::at;
use crate::store::TEMPORARY;
use crate::text;

/// The encoded preview picture; none where nothing receives light.
pub fn preview(baking: &Baking, tracer: &Tracer, lit: &Lit, journal: &mut Journal) -> Result<Option<Vec<u8>>, Error> {
    let Baking { plan, lighting, .. } = baking;
    let rays =
        if plan.runs(Stage::Preview) && plan.runs(Stage::Rays) { Some(tracer.rays(plan, journal)?) } else { None };
    let png = journal.run(plan, Stage::Preview, None, |progress, counters| {
        let picture = match rays {
            Some(rays) => {
                let irradiance = |instance, triangle, u, v| at(lit, instance, triangle, u, v);
                let look = Look { rays, emission: Some(&lighting.emission), sky: lighting.sky };
                let light = ByLightmap { geometry: tracer.geometry, lookup: &irradiance, mean: lit.sums.mean };
                preview::preview(&look, &light, progress)?
            }
            None => preview::black(tracer.geometry.scene),
        };
        counters.insert("pixels".into(), picture.radiance.len() as u64);
        let tone = ToneMap::auto(&picture.radiance, progress)?;
        let picture = tone.picture(picture.width, picture.height, &picture.radiance, progress)?;
        Ok(encode_png_with(&picture, Effort::Small, progress)?)
    })?;
    Ok(png)
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
fn can_write(folder: &Path) -> std::io::Result<()> {
    probe_file(folder)?.close()
}

/// A file under a name by which [`crate::store::sweep`] knows it, should nobody come to remove it.
fn probe_file(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let (prefix, suffix) = TEMPORARY;
    tempfile::Builder::new().prefix(prefix).suffix(suffix).tempfile_in(folder)
}

/// Sees that no bake lies where an export's files go: light as it was baked is not replaced by light that was weighed.
///
/// # Errors
/// A report lies there that is not that of an export, or that cannot be read and so may be that of a bake.
pub fn spare_bake(outputs: &OutputSet) -> Result<(), Error> {
    let over = |what: String| Err(Error::OverBake { folder: outputs.folder().into(), what });
    match current::report(outputs) {
        Err(Reason::Unbaked) => Ok(()),
        Err(reason) => over(format!("what may be a bake ({reason})")),
        Ok(report) if report.mix.is_empty() => over(format!("the bake of {}", text::plain(outputs.stem()))),
        Ok(_) => Ok(()),
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{LEFTOVER_AGE, sweep};
    use std::time::SystemTime;

    #[test]
    fn the_probe_of_a_killed_bake_is_swept() {
        let folder = tempfile::tempdir().unwrap();
        can_write(folder.path()).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let (_file, path) = probe_file(folder.path()).unwrap().keep().unwrap();
        let old = SystemTime::now() - 2 * LEFTOVER_AGE;
        std::fs::File::options().write(true).open(&path).unwrap().set_modified(old).unwrap();
        sweep(folder.path());
        assert!(!path.exists());
    }
}
