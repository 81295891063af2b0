//! From a scene to its atlas: unwraps and the place of every chart are read where they are stored.

use std::sync::Arc;

use luxel_atlas::layout::Source;
use luxel_atlas::{Atlas, AtlasReport, AtlasSettings, Charts, Layout, Packing, Placement, Unwrapper, Unwraps};
use luxel_export::report::StageState;
use luxel_scene::{Instance, Mesh, Progress, Scene};

use super::Baking;
use super::artefact::{body, put_value};
use super::digest::Digest;
use super::journal::{Counters, Journal};
use super::{foresee, keys, report};
use crate::Error;
use crate::plan::Stage;
use crate::settings::Settings;
use crate::store::{Key, Kind, Reader, Store};

/// The atlas of a scene in which something receives light; else one in which nothing has a place.
pub fn run(
    baking: &Baking,
    scene: &Scene,
    unwrapper: &dyn Unwrapper,
    journal: &mut Journal,
) -> Result<(Arc<Atlas>, AtlasReport), Error> {
    let plan = baking.plan;
    if !plan.runs(Stage::Unwrap) {
        journal.left_out(plan, Stage::Unwrap);
        // Without an unwrap no instance has a place, and the atlas still says so of every one of them.
        let atlas = Atlas { placed: vec![None; scene.instances.len()], ..Atlas::default() };
        return Ok((Arc::new(atlas), AtlasReport::default()));
    }
    let reason = plan.reason(Stage::Unwrap).to_owned();
    let mut layouts = String::new();
    let (atlas, report) = journal.made(Stage::Unwrap, &reason, None, |progress, counters| {
        let layout = Layout::build(scene, progress)?;
        if let Some((atlas, report)) = kept(baking, scene, &layout) {
            count(&atlas, &report, unwrapped(scene, &layout).len(), counters);
            return Ok(((atlas, report), StageState::Reused));
        }
        let mut unwraps = Unwraps::new();
        let stored = read_unwraps(baking.store, scene, &layout, &mut unwraps);
        for instance in missing(scene, &layout, &unwraps) {
            baking.may_make_part(|| foresee::unwrap_of(&instance.name))?;
        }
        layout.complete(scene, &mut unwraps, unwrapper, progress)?;
        let new = unwraps.len() - stored.len();
        write_unwraps(baking.store, scene, &layout, &unwraps, &stored, progress)?;
        let how = settings(baking.settings);
        let packing = Packing::new(scene, &how, &layout, &unwraps, progress)?;
        let (placement, is_stored) = placement(baking, &packing, progress)?;
        let (atlas, report) = packing.fill(&placement, progress)?;
        let atlas = Arc::new(atlas);
        if let Some(kept) = baking.kept.filter(|_| unwraps.values().all(Charts::is_reproducible)) {
            kept.keep_atlas(&drawn_from(baking, scene), &atlas, &report);
        }
        count(&atlas, &report, stored.len(), counters);
        layouts = report::layouts(&report, new, is_stored);
        let state = if new == 0 && is_stored { StageState::Reused } else { StageState::Ran };
        Ok(((atlas, report), state))
    })?;
    if journal.state(Stage::Unwrap) == Some(StageState::Ran) {
        journal.add(Stage::Unwrap, &layouts);
    }
    Ok((atlas, report))
}

/// The atlas that was kept in memory, where its artefacts are stored: they serve as if they had been read.
fn kept(baking: &Baking, scene: &Scene, layout: &Layout) -> Option<(Arc<Atlas>, AtlasReport)> {
    let kept = baking.kept?.atlas(&drawn_from(baking, scene))?;
    let unwraps = unwrapped(scene, layout).into_values().map(|mesh| (Kind::Unwrap, keys::unwrap(mesh)));
    let artefacts: Vec<(Kind, Key)> = unwraps.chain([(Kind::Layout, baking.keys.layout)]).collect();
    let store = baking.store?;
    if !artefacts.iter().all(|(kind, key)| store.has(*kind, key)) {
        return None;
    }
    artefacts.iter().for_each(|(kind, key)| store.touch(*kind, key));
    Some(kept)
}

/// What an atlas and its report follow from: the layout, and the names by which meshes are spoken of.
fn drawn_from(baking: &Baking, scene: &Scene) -> Key {
    let digest = Digest::new("atlas").bytes(&baking.keys.layout);
    scene.meshes.iter().fold(digest, |digest, mesh| digest.text(&mesh.name)).done()
}

pub fn settings(settings: &Settings) -> AtlasSettings {
    AtlasSettings {
        size: settings.size.0,
        texel_density: settings.texel_density.0,
        padding: settings.padding.0,
        ..AtlasSettings::default()
    }
}

/// `unwrapped_meshes` counts meshes with an unwrap; `stored_unwraps` those of them that nobody had to unwrap now.
fn count(atlas: &Atlas, report: &AtlasReport, stored: usize, counters: &mut Counters) {
    counters.insert("pages".into(), atlas.pages.len() as u64);
    counters.insert("charts".into(), atlas.charts.len() as u64);
    counters.insert("texels".into(), atlas.texels.len() as u64);
    counters.insert("unwrapped_meshes".into(), u64::from(report.unwrapped));
    counters.insert("stored_unwraps".into(), stored as u64);
    counters.insert("shared_unwraps".into(), u64::from(report.shared));
    counters.insert("kept_layouts".into(), report.kept.len() as u64);
}

/// The meshes that a layout unwraps, each once, by their keys.
fn unwrapped<'a>(scene: &'a Scene, layout: &Layout) -> std::collections::BTreeMap<[u8; 32], &'a Mesh> {
    let meshes = scene.instances.iter().zip(&layout.sources).filter_map(|(instance, source)| match source {
        Source::Unwrap(key) => Some((*key, &scene.meshes[instance.mesh])),
        Source::None | Source::Authored(_) => None,
    });
    meshes.collect()
}

/// Objects whose meshes are still to be unwrapped.
fn missing<'a>(scene: &'a Scene, layout: &'a Layout, unwraps: &'a Unwraps) -> impl Iterator<Item = &'a Instance> {
    let open = |(_, source): &(&Instance, &Source)| matches!(source, Source::Unwrap(key) if !unwraps.contains_key(key));
    scene.instances.iter().zip(&layout.sources).filter(open).map(|(instance, _)| instance)
}

/// Adds stored unwraps; returns the meshes that have one.
fn read_unwraps(store: Option<&Store>, scene: &Scene, layout: &Layout, unwraps: &mut Unwraps) -> Vec<[u8; 32]> {
    let Some(store) = store else { return Vec::new() };
    for (key, mesh) in unwrapped(scene, layout) {
        let read = |bytes: &mut Reader| -> Result<Charts, String> {
            let charts: Charts = body(bytes)?;
            let is_own = charts.is_consistent(mesh.positions.len(), mesh.triangles.len());
            if is_own { Ok(charts) } else { Err("they are not the charts of this mesh".into()) }
        };
        if let Some(charts) = store.get(Kind::Unwrap, &keys::unwrap(mesh), read) {
            unwraps.insert(key, charts);
        }
    }
    unwraps.keys().copied().collect()
}

fn write_unwraps(
    store: Option<&Store>,
    scene: &Scene,
    layout: &Layout,
    unwraps: &Unwraps,
    stored: &[[u8; 32]],
    progress: &dyn Progress,
) -> Result<(), Error> {
    let Some(store) = store else { return Ok(()) };
    for (key, mesh) in unwrapped(scene, layout) {
        progress.check()?;
        let charts = unwraps.get(&key).filter(|charts| !stored.contains(&key) && charts.is_reproducible());
        if let Some(charts) = charts {
            store.put(Kind::Unwrap, &keys::unwrap(mesh), |out| put_value(out, charts));
        }
    }
    Ok(())
}

/// Where the charts lie, and whether that was stored.
fn placement(baking: &Baking, packing: &Packing, progress: &dyn Progress) -> Result<(Placement, bool), Error> {
    let key = &baking.keys.layout;
    let read = |bytes: &mut Reader| -> Result<Placement, String> {
        let placement = body(bytes)?;
        if packing.is_placed_by(&placement) { Ok(placement) } else { Err("it is not one of these charts".into()) }
    };
    if let Some(placement) = baking.store.and_then(|store| store.get(Kind::Layout, key, read)) {
        return Ok((placement, true));
    }
    baking.may_make_part(|| foresee::LAYOUT.into())?;
    let placement = packing.place(progress)?;
    if let Some(store) = baking.store {
        store.put(Kind::Layout, key, |out| put_value(out, &placement));
    }
    Ok((placement, false))
}
