//! `luxel export`: outputs with other weights of the light groups.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use luxel::bake::mix::Mix;
use luxel::discover::Found;
use luxel::settings::for_scene;
use luxel::text::plain;
use luxel::watch::Finished;
use luxel::{Error, Request};
use luxel_export::{ExportError, OutputSet};

use super::args::{Bake, Export};
use super::{End, each, places, places_by, prepare, print, real};

/// The folder beside a scene in which mixes are written.
const FOLDER: &str = "mixed";

/// Weighs the groups of every scene.
pub fn export(args: &Export) -> anyhow::Result<u8> {
    let Bake { common, out, storing } = &args.bake;
    let mix = args.mix.iter().try_fold(Mix::default(), |sum, mix| sum.and(mix.clone()))?;
    let job = prepare(common, out.as_deref())?;
    let baked = places(&job.found, out.as_deref())?;
    let targets = places_by(&job.found, "--to", |found| target(found, args.to.as_deref()))?;
    // Where bakes go nothing else goes, whether they have been made or not.
    let bakes: BTreeSet<PathBuf> = baked.iter().flatten().map(|place| real(&place.glb())).collect();
    let pairs = baked.into_iter().zip(targets).map(|(baked, target)| Ok((baked?, target?))).collect();
    each(&job, pairs, |found, (baked, outputs), reporter| {
        if bakes.contains(&real(&outputs.glb())) {
            let what = format!("the bake of {}", plain(outputs.stem()));
            return Err(Error::OverBake { folder: outputs.folder().into(), what });
        }
        let settings = for_scene(&found.scene, job.config.as_ref(), &common.settings.0)?;
        let mut store = storing.options();
        // It lies where the bake put it.
        store.folder.get_or_insert_with(|| baked.folder().join(luxel::store::FOLDER));
        let request = Request {
            scene: found.scene.clone(),
            outputs,
            settings,
            worker: std::env::current_exe().ok(),
            store,
            kept: Default::default(),
        };
        let written = luxel::export(&request, &mix, reporter)?;
        reporter.finish();
        print::baked(job.style, &found.scene, Finished::from(written).done);
        Ok(End::Done)
    })
}

/// Where a scene's mix goes: below the folder that is named, or beside the scene.
fn target(found: &Found, to: Option<&Path>) -> Result<OutputSet, ExportError> {
    let beside = found.scene.parent().unwrap_or(Path::new("")).join(FOLDER);
    let (to, root) = to.map_or((&*beside, None), |to| (to, found.root.as_deref()));
    OutputSet::new(&found.scene, Some(to), root).map_err(|error| match error {
        ExportError::Place { path, fault } => ExportError::Place { path, fault: fault.replace("--out", "--to") },
        error => error,
    })
}
