//! `luxel export`: outputs with other weights of the light groups.

use std::path::Path;

use luxel::bake::mix::Mix;
use luxel::settings::for_scene;
use luxel::watch::Finished;
use luxel::{Error, Request};
use luxel_export::OutputSet;

use super::args::{Bake, Export};
use super::{End, each, places, prepare, print};

/// The folder beside a scene in which mixes are written.
const FOLDER: &str = "mixed";

/// Weighs the groups of every scene.
pub fn export(args: &Export) -> anyhow::Result<u8> {
    let Bake { common, out, storing } = &args.bake;
    let mix = args.mix.iter().try_fold(Mix::default(), |sum, mix| sum.and(mix.clone()))?;
    let job = prepare(common, out.as_deref())?;
    let baked = places(&job.found, out.as_deref())?;
    each(&job, baked, |found, baked, reporter| {
        let settings = for_scene(&found.scene, job.config.as_ref(), &common.settings.0)?;
        let beside = found.scene.parent().unwrap_or(Path::new("")).join(FOLDER);
        let outputs = match &args.to {
            Some(to) => OutputSet::new(&found.scene, Some(to), found.root.as_deref())?,
            None => OutputSet::new(&found.scene, Some(&beside), None)?,
        };
        if outputs.folder() == baked.folder() {
            return Err(Error::OverBake { folder: baked.folder().into() });
        }
        let mut store = storing.options();
        // It lies where the bake put it.
        store.folder.get_or_insert_with(|| baked.folder().join(luxel::store::FOLDER));
        let request =
            Request { scene: found.scene.clone(), outputs, settings, worker: std::env::current_exe().ok(), store };
        let written = luxel::export(&request, &mix, reporter)?;
        reporter.finish();
        print::baked(job.style, &found.scene, Finished::from(written).done);
        Ok(End::Done)
    })
}
