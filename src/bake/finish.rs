//! From light at texels to images: buried texels filled, padding dilated, seams stitched.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::Arc;

use luxel_atlas::{Atlas, AtlasReport, FinishReport, FinishSettings, Image, finish};
use luxel_export::{BoundMap, Lightmap};
use luxel_scene::{Progress, Scene};
use luxel_transport::Rgb;
use serde::{Deserialize, Serialize};

use super::artefact::{head, put_slice, put_value, slice};
use super::journal::{Counters, Journal};
use super::light::{Sums, TexelLight};
use super::record::Record;
use super::transport::Facts;
use super::{Baking, Lit};
use crate::Error;
use crate::plan::{Plan, Stage};
use crate::settings::Settings;
use crate::store::{Kind, Reader};

/// Steps of the stage: the bounds, and the lightmaps.
const STEPS: u64 = 2;

/// The stages that finished images stand for.
const STANDS_FOR: [Stage; 11] = [
    Stage::Rays,
    Stage::Surfels,
    Stage::Shoot,
    Stage::Propagate,
    Stage::Refresh,
    Stage::Cache,
    Stage::Clear,
    Stage::Direct,
    Stage::Sky,
    Stage::Gather,
    Stage::Finish,
];

/// What a report says of the light in finished images.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Summary {
    sums: Sums,
    surfels: u64,
    record: Option<Record>,
    /// What the stages counted, by their names.
    counters: BTreeMap<String, Counters>,
    pages: u32,
    bounds: u32,
}

/// Images as they were stored.
pub struct Finished {
    summary: Summary,
    lightmaps: Vec<Lightmap>,
    bounds: Vec<BoundMap>,
}

impl Finished {
    /// The result of a bake for which nothing was gathered: its light lies in its images alone.
    pub fn lit(self, atlas: Arc<Atlas>, atlas_report: AtlasReport) -> Lit {
        let Self { summary: Summary { sums, surfels, record, .. }, lightmaps, bounds } = self;
        let transport = Facts { surfels, record };
        Lit { atlas, atlas_report, lightmaps, bounds, sums, transport, ..Lit::default() }
    }
}

/// The images, if they are stored.
pub fn stored(baking: &Baking, atlas: &Atlas, journal: &mut Journal) -> Option<Finished> {
    let finished = baking.store?.get(Kind::Finish, &baking.keys.finish, |body| read(body, atlas))?;
    for stage in STANDS_FOR {
        match finished.summary.counters.get(stage.name()) {
            Some(counters) if baking.plan.runs(stage) => journal.reused(baking.plan, stage, counters.clone()),
            _ => journal.left_out_unless_run(baking.plan, stage),
        }
    }
    (0..baking.keys.groups.len()).for_each(|group| baking.found(Kind::Finish, group));
    Some(finished)
}

/// How much is done about seams: a draft shows them anyway.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Seams {
    Stitched,
    Left,
}

/// Makes the images, one lightmap per page, and one map of stated bounds where the settings ask for it and the gather
/// states one.
pub fn run(
    baking: &Baking,
    scene: &Scene,
    atlas: &Atlas,
    light: Cow<TexelLight>,
    (sums, facts): (&Sums, &Facts),
    seams: Seams,
    journal: &mut Journal,
) -> Result<(Vec<Lightmap>, Vec<BoundMap>), Error> {
    let Baking { settings, plan, .. } = baking;
    let images = journal.run(plan, Stage::Finish, Some(STEPS), |progress, counters| {
        let (lightmaps, bounds, report) = images(scene, atlas, light, (settings, seams), plan, progress)?;
        counters.insert("filled_texels".into(), report.filled.into());
        counters.insert("lost_texels".into(), report.lost.into());
        counters.insert("seam_samples".into(), report.seam_samples.into());
        Ok((lightmaps, bounds))
    })?;
    let Some((lightmaps, bounds)) = images else { return Ok((Vec::new(), Vec::new())) };
    if baking.store.is_some() {
        let summary = Summary {
            sums: *sums,
            surfels: facts.surfels,
            record: facts.record.clone(),
            counters: journal.counted(plan, &STANDS_FOR),
            pages: lightmaps.len() as u32,
            bounds: bounds.len() as u32,
        };
        baking.put(Kind::Finish, &baking.keys.finish, journal.progress, |out| {
            write(out, &summary, &lightmaps, &bounds)
        })?;
    }
    Ok((lightmaps, bounds))
}

fn write(out: &mut impl Write, summary: &Summary, lightmaps: &[Lightmap], bounds: &[BoundMap]) -> io::Result<()> {
    put_value(out, summary)?;
    for lightmap in lightmaps {
        put_slice(out, lightmap.irradiance())?;
        put_slice(out, lightmap.coverage())?;
        let buried = (0u32..).zip(lightmap.buried()).filter(|(_, buried)| **buried).map(|(i, _)| i);
        put_slice(out, &buried.collect::<Vec<u32>>())?;
    }
    bounds.iter().try_for_each(|bound| put_slice(out, bound.bound()))
}

fn read(body: &mut Reader, atlas: &Atlas) -> Result<Finished, String> {
    let summary: Summary = head(body)?;
    let pages = atlas.pages.len();
    if summary.pages as usize != pages || ![0, pages].contains(&(summary.bounds as usize)) {
        return Err("it has other pages".into());
    }
    let lightmap = |page: &luxel_atlas::Page, body: &mut Reader| {
        let (irradiance, coverage) = (slice(body)?, slice(body)?);
        let buried: Vec<u32> = slice(body)?;
        Lightmap::new(page.width, page.height, irradiance, coverage)
            .and_then(|lightmap| lightmap.with_buried(buried.into_iter().map(|i| i as usize)))
            .map_err(|e| e.to_string())
    };
    let lightmaps = atlas.pages.iter().map(|page| lightmap(page, body)).collect::<Result<_, String>>()?;
    let bound = |page: &luxel_atlas::Page, body: &mut Reader| {
        BoundMap::new(page.width, page.height, slice(body)?).map_err(|e| e.to_string())
    };
    let with_bound = &atlas.pages[..summary.bounds as usize];
    let bounds = with_bound.iter().map(|page| bound(page, body)).collect::<Result<_, String>>()?;
    Ok(Finished { summary, lightmaps, bounds })
}

/// Light that is given away lives until it lies in its page.
fn images(
    scene: &Scene,
    atlas: &Atlas,
    light: Cow<TexelLight>,
    (settings, seams): (&Settings, Seams),
    plan: &Plan,
    progress: &dyn Progress,
) -> Result<(Vec<Lightmap>, Vec<BoundMap>, FinishReport), Error> {
    let (irradiance, bound, buried) = match light {
        Cow::Owned(l) => (Cow::Owned(l.irradiance), Cow::Owned(l.bound), Cow::Owned(l.buried)),
        Cow::Borrowed(l) => {
            (Cow::Borrowed(&l.irradiance[..]), Cow::Borrowed(&l.bound[..]), Cow::Borrowed(&l.buried[..]))
        }
    };
    let how = FinishSettings { padding: settings.padding.0, stitch: seams == Seams::Stitched };
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
    let is_buried = &buried;
    let value = move |i: usize| (!is_buried[i]).then(|| irradiance[i]);
    let (images, report) = finish(scene, atlas, value, &how, progress)?;
    let places = places(atlas, &buried);
    let lightmaps = images.into_iter().zip(places).map(|(i, p)| lightmap(i, p)).collect::<Result<_, _>>()?;
    progress.advance(1);
    Ok((lightmaps, bounds, report))
}

/// Where the buried texels of each page are, row-major.
fn places(atlas: &Atlas, buried: &[bool]) -> Vec<Vec<usize>> {
    let mut places = vec![Vec::new(); atlas.pages.len()];
    for (texel, _) in atlas.texels.iter().zip(buried).filter(|(_, buried)| **buried) {
        let page = atlas.chart(texel).page as usize;
        places[page].push(usize::from(texel.y) * atlas.pages[page].width as usize + usize::from(texel.x));
    }
    places
}

fn lightmap(image: Image, buried: Vec<usize>) -> Result<Lightmap, Error> {
    Ok(Lightmap::new(image.width, image.height, image.values, image.coverage)?.with_buried(buried)?)
}

fn bound_map(image: Image) -> Result<BoundMap, Error> {
    Ok(BoundMap::new(image.width, image.height, image.values.iter().map(|p| p.x).collect())?)
}
