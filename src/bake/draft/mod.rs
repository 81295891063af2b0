//! A draft of a bake: the same files from the same unwrap, lit within a moment.
//!
//! | | bake | draft |
//! |---|---|---|
//! | direct and sky light | at every texel | at nodes |
//! | light that surfaces reflect | gathered | looked up at nodes, in coarser voxels lit at one point each |
//! | whether the scene is closed | probed, unless it is said | open, unless it is said |
//! | what is stored of the bake | taken | taken, group by group |
//! | buried texels | found by rays, texel by texel | as stored, or as their cell's node is |
//! | far sides of thin walls, backs | of all light | of groups that are stored whole |
//! | picture, bounds | as the settings say | none |
//! | images | stitched, compressed | neither |
//!
//! Nodes are few ([`nodes`]), and texels are interpolated between them. Nothing of this is stored but the surfels, which
//! the next draft needs; all else would only be in the way of what the bake is about to store.

mod nodes;

use std::borrow::Cow;
use std::sync::Arc;

use luxel_atlas::{Atlas, AtlasReport};
use luxel_export::Effort;
use luxel_transport::{
    Rgb,
    direct::Visibility,
    gather::{Field, Gather, Lookup},
    sky_light::{self, SkyLight, SkySettings},
};

use super::finish::{self, Seams};
use super::journal::Journal;
use super::light::Parts;
use super::receivers::{Receivers, Side};
use super::tracer::Tracer;
use super::transport::{Facts, Transport};
use super::{Baked, Baking, Lit, Outgoing, direct, foresee, texels};
use crate::Error;
use crate::plan::Stage;
use crate::settings::{
    Closed, GatherMode, Settings, Voxels,
    value::{Count, Samples, Tolerance},
};
use nodes::Nodes;

/// Surfels, and voxels along the longest side, that a draft has at most.
const SURFELS: u32 = 6_000;
const SIDE: u32 = 48;

/// Directions of the first bounce, and rays towards the sky, that it has at most.
const DIRECTIONS: u32 = 64;
const SKY_RAYS: u32 = 128;

/// The settings of a draft: those of layout and light stay.
fn settings(of: &Settings) -> Settings {
    let voxels = match of.voxels {
        Voxels::Budget(n) => Voxels::Budget(n.min(SURFELS)),
        Voxels::Side(n) => Voxels::Side(n.min(SIDE)),
        Voxels::Edge(_) => Voxels::Budget(SURFELS),
    };
    Settings {
        voxels,
        bound: false,
        directions: Samples(of.directions.0.min(DIRECTIONS)),
        tolerance: Tolerance(of.tolerance.0.max(3e-2)),
        refresh: Count(0),
        photons: Count(0),
        closed: if of.closed == Closed::Auto { Closed::No } else { of.closed },
        gather: GatherMode::Lookup,
        cut_error: Tolerance(of.cut_error.0.max(0.1)),
        cut_limit: Samples(of.cut_limit.0.min(200)),
        near_rays: Samples(of.near_rays.0.min(8)),
        shadow_samples: Samples(of.shadow_samples.0.min(16)),
        sky_rays: Samples(of.sky_rays.0.min(SKY_RAYS)),
        ..of.clone()
    }
}

/// Writes a draft of the bake that `whole` is told of.
pub fn bake(
    outgoing: &Outgoing,
    whole: &Baking,
    (atlas, atlas_report): (Arc<Atlas>, AtlasReport),
    journal: &mut Journal,
) -> Result<Baked, Error> {
    let tracer = outgoing.tracer;
    // Both need the rays: that belongs to the course of the bake.
    tracer.rays(whole.plan, journal)?;
    let settings = settings(whole.settings);
    let mut plan = whole.plan.with(&settings);
    plan.leave_out(Stage::Preview, "a draft has no picture");
    let mut keys = whole.keys.clone();
    keys.surfels = whole.keys.surfels(&settings);
    let own = Baking { settings: &settings, plan: &plan, keys: &keys, ..*whole };
    // Import and unwrap are behind it, too.
    let mut journal = journal.clone();
    let (parts, transport) = light(whole, &own, tracer, &atlas, &mut journal)?;
    let (texels, sums) = parts.merged(&atlas);
    let unkept = Baking { store: None, ..own };
    let scene = tracer.geometry.scene;
    let (lightmaps, bounds) =
        finish::run(&unkept, scene, &atlas, Cow::Owned(texels), (&sums, &transport), Seams::Left, &mut journal)?;
    journal.left_out(&plan, Stage::Preview);
    let lit = Lit { atlas, atlas_report, lightmaps, bounds, sums, transport, ..Lit::default() };
    let figures = (Vec::new(), outgoing.start.elapsed().as_secs_f64());
    outgoing.write(&own, &lit, None, Effort::Fast, figures, journal)
}

/// Light at all texels: what is stored of the bake, and the rest from nodes.
fn light(
    whole: &Baking,
    own: &Baking,
    tracer: &Tracer,
    atlas: &Atlas,
    journal: &mut Journal,
) -> Result<(Parts, Facts), Error> {
    let (mut stored, mut made) = (Transport::default(), Transport::default());
    let store = whole.store.map(|store| (store, &whole.keys.clear));
    let receivers =
        store.and_then(|store| Receivers::stored(tracer, atlas, whole.settings, whole.plan, store, journal));
    let mut bare = None;
    let side = match &receivers {
        Some(receivers) => &receivers.sides[0],
        None => &*bare.insert(Side::front(tracer.geometry, atlas)),
    };
    let mut sum: Option<Parts> = None;
    let mut sparse: Option<Sparse> = None;
    for (number, group) in whole.lighting.groups.iter().enumerate() {
        journal.group = (whole.lighting.groups.len() > 1).then(|| group.name.clone());
        let keys = &whole.keys.groups[number];
        let is_stored =
            whole.store.is_some_and(|store| foresee::is_stored(whole.plan, store, (group, keys), whole.keys));
        if let Some(receivers) = receivers.as_ref().filter(|_| is_stored) {
            let parts = texels::group(whole, tracer, receivers, &mut stored, number, journal)?.scaled(group.factor);
            add(&mut sum, parts);
            continue;
        }
        let front = receivers.as_ref().and_then(|r| texels::stored_front(whole, r, keys, journal));
        let sparse = match &mut sparse {
            Some(sparse) => sparse,
            none => none.insert(Sparse::new((side, receivers.is_some()), own, tracer, journal)?),
        };
        if let Some(direct) = front {
            let parts = Parts { direct, ..Parts::dark(atlas.texels.len(), false) };
            add(&mut sum, parts.scaled(group.factor));
        } else {
            sparse.direct(own, tracer, &mut made, number, journal)?;
        }
        sparse.indirect(own, tracer, &mut made, number, journal)?;
    }
    journal.group = None;
    for stage in Stage::ALL.into_iter().filter(|stage| (Stage::Rays..=Stage::Gather).contains(stage)) {
        journal.left_out_unless_run(own.plan, stage);
    }
    let mut facts = stored.facts;
    facts += made.facts;
    let mut parts = sum.unwrap_or_else(|| Parts::dark(atlas.texels.len(), false));
    if let Some(sparse) = sparse {
        sparse.add_to(&mut parts);
    }
    // A draft states none.
    parts.bound = Vec::new();
    Ok((parts, facts))
}

fn add(sum: &mut Option<Parts>, parts: Parts) {
    match sum {
        Some(sum) => sum.add(&parts),
        None => *sum = Some(parts),
    }
}

/// Light at nodes, of all groups that are not stored, at the strength of their lights [lux].
struct Sparse<'a> {
    side: &'a Side<'a>,
    nodes: Nodes,
    direct: Vec<Rgb>,
    indirect: Vec<Rgb>,
}

impl<'a> Sparse<'a> {
    fn new(
        (side, is_cleared): (&'a Side<'a>, bool),
        own: &Baking,
        tracer: &Tracer,
        journal: &mut Journal,
    ) -> Result<Self, Error> {
        let rays = tracer.rays(own.plan, journal)?;
        let group = journal.group.take();
        let nodes = if is_cleared {
            Nodes::new(side, true, rays, journal.progress)?
        } else {
            journal.always(Stage::Clear, "texels at which the draft gathers", Some(0), |progress, _| {
                Nodes::new(side, false, rays, progress)
            })?
        };
        journal.group = group;
        let dark = vec![Rgb::ZERO; nodes.receivers.len()];
        Ok(Self { side, nodes, direct: dark.clone(), indirect: dark })
    }

    fn direct(
        &mut self,
        own: &Baking,
        tracer: &Tracer,
        transport: &mut Transport,
        number: usize,
        journal: &mut Journal,
    ) -> Result<(), Error> {
        let group = &own.lighting.groups[number];
        if !own.plan.runs(Stage::Direct) || group.sources.is_empty() {
            journal.left_out_unless_run(own.plan, Stage::Direct);
            return Ok(());
        }
        let rays = tracer.rays(own.plan, journal)?;
        let emitters = group.emitters(transport.emitters(tracer.geometry));
        let (nodes, sum) = (&self.nodes, &mut self.direct);
        journal.always(Stage::Direct, own.plan.reason(Stage::Direct), Some(nodes.len()), |progress, counters| {
            let to = |direct: &dyn Gather| nodes.gather(direct, group.factor, sum, progress, counters);
            direct::with(rays, &emitters, own.settings, Visibility::Rays, progress, to)
        })
    }

    /// What surfaces reflect, and what comes from the sky.
    fn indirect(
        &mut self,
        own: &Baking,
        tracer: &Tracer,
        transport: &mut Transport,
        number: usize,
        journal: &mut Journal,
    ) -> Result<(), Error> {
        let (plan, group) = (own.plan, &own.lighting.groups[number]);
        let (nodes, sum) = (&self.nodes, &mut self.indirect);
        if plan.runs(Stage::Gather) {
            let (surfels, solution, record) = transport.draft(own, tracer, number, journal)?;
            transport.facts.add(record, group.factor);
            let rays = tracer.rays(plan, journal)?;
            journal.always(Stage::Gather, plan.reason(Stage::Gather), Some(nodes.len()), |progress, counters| {
                let field = Field::new(rays, &surfels, &solution)?;
                nodes.gather(&Lookup::new(&field), group.factor, sum, progress, counters)
            })?;
        }
        if let Some(weight) = group.sky.filter(|_| plan.runs(Stage::Sky)) {
            let rays = tracer.rays(plan, journal)?;
            journal.always(Stage::Sky, plan.reason(Stage::Sky), Some(nodes.len()), |progress, counters| {
                let how = SkySettings { rays: own.settings.sky_rays.0, ..SkySettings::default() };
                let (sky, factor) = (SkyLight::new(rays, how), weight * group.factor);
                if sky.has_spots() {
                    nodes.gather(&sky_light::Bright(&sky), factor, sum, progress, counters)?;
                }
                nodes.gather(&sky_light::Smooth(&sky), factor, sum, progress, counters)
            })?;
        }
        Ok(())
    }

    /// Adds the light to that of all texels, which take it from their nodes.
    fn add_to(self, parts: &mut Parts) {
        let sums = [&mut parts.direct[..], &mut parts.indirect[..]];
        self.nodes.spread(self.side, [&self.direct, &self.indirect], sums);
        parts.buried = self.nodes.buried;
    }
}
