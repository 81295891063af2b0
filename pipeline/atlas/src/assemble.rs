//! The whole way from a scene to its atlas.

use std::collections::BTreeSet;

use glam::Vec2;
use luxel_scene::{Cancelled, Progress, Scene};
use rayon::prelude::*;

use crate::blocks::{self, Block};
use crate::charts::{Charts, NO_CHART};
use crate::layout::{Layout, MeshKey, Source, Unwraps};
use crate::mesh::mesh_key;
use crate::place::{self, Place, Placement};
use crate::settings::{AtlasError, AtlasReport, AtlasSettings};
use crate::texels;
use crate::unwrap::Unwrapper;
use crate::{Atlas, Chart, Page, Placed, Texel, authored};

/// Cells of blocks that are rasterised at a time, at least.
const WAVE: usize = 1 << 16;

/// Unwraps, packs and rasterises a scene.
///
/// # Errors
/// Settings out of range, charts that fit nowhere, an unwrapper that does not work, cancellation.
pub fn build(
    scene: &Scene,
    settings: &AtlasSettings,
    unwrapper: &dyn Unwrapper,
    progress: &dyn Progress,
) -> Result<(Atlas, AtlasReport), AtlasError> {
    settings.check()?;
    let layout = Layout::build(scene, progress)?;
    let mut unwraps = Unwraps::new();
    layout.complete(scene, &mut unwraps, unwrapper, progress)?;
    assemble(scene, settings, &layout, &unwraps, progress)
}

/// Packs and rasterises a scene whose unwraps are known.
///
/// # Errors
/// As [`build`], and when an unwrap is missing or belongs to another mesh.
pub fn assemble(
    scene: &Scene,
    settings: &AtlasSettings,
    layout: &Layout,
    unwraps: &Unwraps,
    progress: &dyn Progress,
) -> Result<(Atlas, AtlasReport), AtlasError> {
    let packing = Packing::new(scene, settings, layout, unwraps, progress)?;
    let placement = packing.place(progress)?;
    packing.fill(&placement, progress)
}

/// The charts of a scene, measured and ready to be placed.
pub struct Packing<'a> {
    scene: &'a Scene,
    settings: &'a AtlasSettings,
    layout: &'a Layout,
    unwraps: &'a Unwraps,
    blocks: Vec<Block>,
}

impl<'a> Packing<'a> {
    /// # Errors
    /// Settings out of range, an unwrap that is missing or belongs to another mesh, cancellation.
    pub fn new(
        scene: &'a Scene,
        settings: &'a AtlasSettings,
        layout: &'a Layout,
        unwraps: &'a Unwraps,
        progress: &dyn Progress,
    ) -> Result<Self, AtlasError> {
        settings.check()?;
        Ok(Self { scene, settings, layout, unwraps, blocks: blocks::blocks(scene, layout, unwraps, progress)? })
    }

    /// Finds a place for every chart: the long part.
    ///
    /// # Errors
    /// Charts that fit nowhere, cancellation.
    pub fn place(&self, progress: &dyn Progress) -> Result<Placement, AtlasError> {
        let name = |instance: u32| self.scene.instances[instance as usize].name.clone();
        place::place(&self.blocks, self.settings, &name, progress)
    }

    /// Whether a placement is one of these charts on these pages; to be asked of one that was stored.
    pub fn is_placed_by(&self, placement: &Placement) -> bool {
        placement.fits(&self.blocks, self.settings)
    }

    /// Rasterises the placed charts.
    ///
    /// # Errors
    /// Cancellation.
    pub fn fill(&self, placement: &Placement, progress: &dyn Progress) -> Result<(Atlas, AtlasReport), AtlasError> {
        let Self { scene, settings, layout, unwraps, blocks } = self;
        progress.begin("texels", blocks.len() as u64);
        let seeds = Seeds::new(scene, layout, progress)?;
        let side = settings.size;
        let mut atlas = Atlas {
            pages: vec![Page { width: side, height: side }; placement.pages as usize],
            placed: placed(scene, layout, unwraps, (blocks, placement), side, progress)?,
            ..Atlas::default()
        };
        rasterise(blocks, &placement.places, &seeds, progress, &mut atlas)?;
        progress.check()?;
        let mut report = report(scene, layout, unwraps, settings, &atlas, placement);
        report.enough = place::enough(blocks, placement, settings);
        Ok((atlas, report))
    }
}

/// Fills in charts and texels, a wave of blocks at a time.
fn rasterise(
    blocks: &[Block],
    places: &[Place],
    seeds: &Seeds,
    progress: &dyn Progress,
    atlas: &mut Atlas,
) -> Result<(), AtlasError> {
    let cells = |place: &Place| place.size[0] as usize * place.size[1] as usize;
    // Charts fill most of their rectangles: little is reserved too much, and nothing moves.
    atlas.texels.reserve_exact(places.iter().map(cells).sum());
    let mut next = 0;
    while next < blocks.len() {
        let mut end = next;
        let mut wave = 0;
        while end < blocks.len() && wave < WAVE {
            wave += cells(&places[end]);
            end += 1;
        }
        let found: Vec<Vec<(u32, Texel)>> = blocks[next..end]
            .par_iter()
            .zip(&places[next..end])
            .map(|(block, place)| {
                progress.check()?;
                let found = texels::texels(block, place, progress)?;
                progress.advance(1);
                Ok(found)
            })
            .collect::<Result<_, AtlasError>>()?;
        for ((block, place), found) in blocks[next..end].iter().zip(&places[next..end]).zip(found) {
            for &instance in &block.instances {
                progress.check()?;
                let texels = found.iter().filter(|(of, _)| *of == instance).map(|(_, texel)| *texel);
                push_chart(atlas, instance, place, seeds.chart(instance, block.number), texels);
            }
        }
        next = end;
    }
    Ok(())
}

fn push_chart(atlas: &mut Atlas, instance: u32, place: &Place, seed: u64, texels: impl Iterator<Item = Texel>) {
    let first = atlas.texels.len();
    let chart = atlas.charts.len() as u32;
    atlas.texels.extend(texels.map(|mut texel| {
        texel.chart = chart;
        texel
    }));
    let [w, h] = place.size;
    let (width, height) = if place.turn.is_multiple_of(2) { (w, h) } else { (h, w) };
    atlas.charts.push(Chart {
        instance,
        page: place.page,
        x: place.x,
        y: place.y,
        width,
        height,
        turn: place.turn,
        first_texel: first as u32,
        texels: (atlas.texels.len() - first) as u32,
        seed,
    });
}

/// Chart seeds: hash of the mesh's content, the instance's name and the chart's number.
struct Seeds(Vec<blake3::Hasher>);

impl Seeds {
    fn new(scene: &Scene, layout: &Layout, progress: &dyn Progress) -> Result<Self, Cancelled> {
        let hasher = |(instance, source): (&luxel_scene::Instance, &Source)| {
            progress.check()?;
            let mut hasher = blake3::Hasher::new();
            match source {
                Source::None => {}
                Source::Unwrap(key) => _ = hasher.update(key),
                Source::Authored(_) => _ = hasher.update(&mesh_key(&scene.meshes[instance.mesh])),
            }
            hasher.update(instance.name.as_bytes());
            Ok(hasher)
        };
        let hashers = scene.instances.par_iter().zip(&layout.sources).map(hasher);
        Ok(Self(hashers.collect::<Result<_, Cancelled>>()?))
    }

    fn chart(&self, instance: u32, number: u32) -> u64 {
        let digest = self.0[instance as usize].clone().update(&number.to_le_bytes()).finalize();
        digest.as_bytes()[..8].iter().fold(0, |seed, &byte| seed << 8 | u64::from(byte))
    }
}

fn placed(
    scene: &Scene,
    layout: &Layout,
    unwraps: &Unwraps,
    (blocks, placement): (&[Block], &Placement),
    side: u32,
    progress: &dyn Progress,
) -> Result<Vec<Option<Placed>>, Cancelled> {
    // Blocks of each instance, ascending.
    let mut of: Vec<Vec<usize>> = vec![Vec::new(); scene.instances.len()];
    for (b, block) in blocks.iter().enumerate() {
        block.instances.iter().for_each(|&i| of[i as usize].push(b));
    }
    let one = |i: usize| -> Option<Placed> {
        let mesh = &scene.meshes[scene.instances[i].mesh];
        let on_page = |b: usize, uv: [f32; 2]| {
            (texels::placed(blocks[b].unit(uv), &placement.places[b]) / f64::from(side)).as_vec2()
        };
        let page = of[i].first().map_or(0, |&b| placement.places[b].page);
        match layout.sources[i] {
            Source::None => None,
            Source::Unwrap(key) => {
                let charts = unwraps.get(&key)?;
                let uvs = chart_uvs(charts, blocks, &of[i], on_page);
                Some(Placed { page, source: charts.source.clone(), uvs, triangles: charts.triangles.clone() })
            }
            Source::Authored(_) => {
                let set = &mesh.uvs[authored::LIGHTMAP_SET];
                let uvs = match of[i].first() {
                    Some(&b) => set.iter().map(|uv| on_page(b, uv.to_array())).collect(),
                    None => vec![Vec2::ZERO; set.len()],
                };
                let source = (0..set.len() as u32).collect();
                Some(Placed { page, source, uvs, triangles: mesh.triangles.clone() })
            }
        }
    };
    let checked = |i: usize| progress.check().map(|()| one(i));
    (0..scene.instances.len()).into_par_iter().map(checked).collect()
}

/// Atlas coordinates of an unwrap's vertices. Vertices outside any placed chart (triangles without area) go to
/// the instance's first chart, where at least they read its own light.
fn chart_uvs(charts: &Charts, blocks: &[Block], own: &[usize], on_page: impl Fn(usize, [f32; 2]) -> Vec2) -> Vec<Vec2> {
    let mut block_of = vec![None; charts.charts as usize];
    own.iter().for_each(|&b| block_of[blocks[b].number as usize] = Some(b));
    charts
        .uvs
        .iter()
        .zip(&charts.vertex_chart)
        .map(|(&uv, &chart)| {
            let block = if chart == NO_CHART { None } else { block_of[chart as usize] };
            match (block, own.first()) {
                (Some(b), _) => on_page(b, uv),
                (None, Some(&b)) => on_page(b, blocks[b].origin.as_vec2().to_array()),
                (None, None) => Vec2::ZERO,
            }
        })
        .collect()
}

fn report(
    scene: &Scene,
    layout: &Layout,
    unwraps: &Unwraps,
    settings: &AtlasSettings,
    atlas: &Atlas,
    placement: &Placement,
) -> AtlasReport {
    let page_texels = f64::from(settings.size).powi(2) * f64::from(placement.pages.max(1));
    let mut named: Vec<(usize, &Charts)> = Vec::new();
    for (instance, source) in scene.instances.iter().zip(&layout.sources) {
        if let Source::Unwrap(key) = source
            && let Some(charts) = unwraps.get(key)
        {
            named.push((instance.mesh, charts));
        }
    }
    named.sort_by_key(|(mesh, _)| *mesh);
    named.dedup_by_key(|(mesh, _)| *mesh);
    let fallbacks = named.iter().flat_map(|(mesh, charts)| {
        charts.fallbacks.iter().map(|(why, n)| (scene.meshes[*mesh].name.clone(), why.clone(), *n))
    });
    let keys: Vec<MeshKey> = layout
        .sources
        .iter()
        .filter_map(|source| match source {
            Source::Unwrap(key) => Some(*key),
            _ => None,
        })
        .collect();
    let different: BTreeSet<MeshKey> = keys.iter().copied().collect();
    // A group is numbered by its turn among the receiving instances and authored groups.
    let leaders: Vec<usize> = (0..scene.instances.len())
        .filter(|&i| match layout.sources[i] {
            Source::None => false,
            Source::Unwrap(_) => true,
            Source::Authored(g) => layout.groups[g].first() == Some(&i),
        })
        .collect();
    // Once per group, with the lowest density of its charts.
    let mut lowest = placement.lowered.clone();
    lowest.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    lowest.dedup_by_key(|(group, _)| *group);
    let lowered = lowest.iter().filter_map(|&(group, density)| {
        leaders.get(group as usize).map(|&i| (scene.instances[i].name.clone(), density))
    });
    AtlasReport {
        pages: placement.pages,
        density: placement.reached(),
        wanted: placement.density,
        charts: atlas.charts.len() as u32,
        texels: atlas.texels.len() as u32,
        utilisation: atlas.texels.iter().map(|t| f64::from(t.coverage())).sum::<f64>() / page_texels,
        occupied: placement.occupied as f64 / page_texels,
        unwrapped: different.len() as u32,
        shared: (keys.len() - different.len()) as u32,
        kept: layout.kept.clone(),
        unwrapped_anew: layout.refused.clone(),
        fallbacks: fallbacks.collect(),
        lowered: lowered.collect(),
        enough: None,
    }
}
