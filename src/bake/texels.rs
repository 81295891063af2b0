//! The light at texels: direct, from the sky, and reflected, each by its own gather, for one light group at a time.
//!
//! What a gather found is a [`Layer`] for each side of the surfaces, and an artefact. At the end of a group its layers
//! are added up and its sides laid over each other.

use std::io::{self, Write};

use luxel_scene::Progress;
use luxel_transport::{
    Rgb,
    direct::Visibility,
    gather::{Field, FinalGather, Gather, Lightcuts, Lookup, lightcuts, nodes::NodeSettings},
    sky_light::{self, SkyLight, SkySettings},
};

use super::Baking;
use super::artefact::{self, head, put_slice, put_value};
use super::direct;
use super::groups::{Group, SKY};
use super::journal::{Counters, Journal};
use super::keys::GroupKeys;
use super::light::Parts;
use super::receivers::{Receivers, Side};
use super::record::Record;
use super::tracer::Tracer;
use super::transport::Transport;
use crate::Error;
use crate::plan::Stage;
use crate::settings::{DoubleSided, Gatherer, Settings};
use crate::store::{Key, Kind, Reader};

/// What a gather found on one side of the surfaces, in the order of its receivers.
#[derive(Clone, Debug, Default)]
pub struct Layer {
    /// [lux]
    irradiance: Vec<Rgb>,
    /// Stated bounds [lux], or empty.
    bound: Vec<f32>,
}

impl Layer {
    fn dark(side: &Side, bound: bool) -> Self {
        Self { irradiance: vec![Rgb::ZERO; side.len()], bound: vec![0.0; if bound { side.len() } else { 0 }] }
    }
}

/// Gathers the light of one group at every texel: at unit power, fronts, far sides and backs combined.
pub fn group(
    baking: &Baking,
    tracer: &Tracer,
    receivers: &Receivers,
    transport: &mut Transport,
    number: usize,
    journal: &mut Journal,
) -> Result<Parts, Error> {
    let (group, keys) = (&baking.lighting.groups[number], &baking.keys.groups[number]);
    let direct = direct_layers(baking, tracer, receivers, transport, (group, keys), journal)?;
    let mut indirect = reflected_layers(baking, tracer, receivers, transport, number, journal)?;
    if let Some(weight) = group.sky {
        let sky = sky_layers(baking, tracer, receivers, journal)?;
        for (layer, sky) in indirect.iter_mut().zip(sky) {
            layer.irradiance.iter_mut().zip(sky.irradiance).for_each(|(sum, e)| *sum += weight * e);
        }
    }
    Ok(combine_sides(receivers, direct, indirect, baking.settings.double_sided))
}

/// Light straight from lamps, suns and emissive surfaces.
fn direct_layers(
    baking: &Baking,
    tracer: &Tracer,
    receivers: &Receivers,
    transport: &mut Transport,
    (group, keys): (&Group, &GroupKeys),
    journal: &mut Journal,
) -> Result<Vec<Layer>, Error> {
    let Baking { settings, plan, .. } = baking;
    if !plan.runs(Stage::Direct) || group.sources.is_empty() {
        journal.left_out_unless_run(plan, Stage::Direct);
        return Ok(dark(receivers, false));
    }
    if let Some(layers) = stored_layers(baking, receivers, (Kind::Direct, &keys.direct), Stage::Direct, journal) {
        return Ok(layers);
    }
    baking.may_make(&group.name)?;
    let rays = tracer.rays(plan, journal)?;
    let emitters = group.emitters(transport.emitters(tracer.geometry));
    journal.always(Stage::Direct, plan.reason(Stage::Direct), Some(receivers.len()), |progress, counters| {
        let mut found = dark(receivers, false);
        direct::with(rays, &emitters, settings, Visibility::Shafts, progress, |direct| {
            gather(receivers, direct, None, &mut found, progress, counters)
        })?;
        baking.put(Kind::Direct, &keys.direct, progress, |out| {
            put_value(out, counters)?;
            write(out, &found)
        })?;
        Ok(found)
    })
}

/// What a stage without bounds gathered, if it is stored.
fn stored_layers(
    baking: &Baking,
    receivers: &Receivers,
    (kind, key): (Kind, &Key),
    stage: Stage,
    journal: &mut Journal,
) -> Option<Vec<Layer>> {
    let stored = |body: &mut Reader| Ok((head(body)?, layers(body, receivers, false)?));
    let (counters, layers) = baking.store?.get(kind, key, stored)?;
    journal.reused(baking.plan, stage, counters);
    Some(layers)
}

/// Direct light of a group on the fronts [lux], if it is stored.
pub fn stored_front(
    baking: &Baking,
    receivers: &Receivers,
    keys: &GroupKeys,
    journal: &mut Journal,
) -> Option<Vec<Rgb>> {
    let stored = stored_layers(baking, receivers, (Kind::Direct, &keys.direct), Stage::Direct, journal)?;
    stored.into_iter().next().map(|layer| layer.irradiance)
}

/// Light of the unit sky, straight from it.
fn sky_layers(
    baking: &Baking,
    tracer: &Tracer,
    receivers: &Receivers,
    journal: &mut Journal,
) -> Result<Vec<Layer>, Error> {
    let Baking { settings, plan, keys, .. } = baking;
    if !plan.runs(Stage::Sky) {
        journal.left_out_unless_run(plan, Stage::Sky);
        return Ok(Vec::new());
    }
    if let Some(layers) = stored_layers(baking, receivers, (Kind::Sky, &keys.sky), Stage::Sky, journal) {
        return Ok(layers);
    }
    baking.may_make(SKY)?;
    let rays = tracer.rays(plan, journal)?;
    journal.always(Stage::Sky, plan.reason(Stage::Sky), Some(receivers.len()), |progress, counters| {
        let sky = SkyLight::new(rays, SkySettings { rays: settings.sky_rays.0, ..SkySettings::default() });
        let mut found = dark(receivers, false);
        if sky.has_spots() {
            gather(receivers, &sky_light::Bright(&sky), None, &mut found, progress, counters)?;
        }
        gather(receivers, &sky_light::Smooth(&sky), nodes(settings), &mut found, progress, counters)?;
        baking.put(Kind::Sky, &keys.sky, progress, |out| {
            put_value(out, counters)?;
            write(out, &found)
        })?;
        Ok(found)
    })
}

/// Light that surfaces reflect, from the group's light at surfels.
fn reflected_layers(
    baking: &Baking,
    tracer: &Tracer,
    receivers: &Receivers,
    transport: &mut Transport,
    number: usize,
    journal: &mut Journal,
) -> Result<Vec<Layer>, Error> {
    let Baking { settings, plan, .. } = baking;
    let (key, bound) = (&baking.keys.groups[number].gather, plan.states_bound(settings));
    if !plan.runs(Stage::Gather) {
        transport.skip(plan, journal);
        journal.left_out(plan, Stage::Gather);
        return Ok(dark(receivers, bound));
    }
    // The record of the light at surfels is kept with it, so that this need not be read.
    let stored = |body: &mut Reader| -> Result<(Record, Counters, Vec<Layer>), String> {
        Ok((head(body)?, head(body)?, layers(body, receivers, bound)?))
    };
    if let Some((record, counters, layers)) = baking.store.and_then(|store| store.get(Kind::Gather, key, stored)) {
        baking.found(Kind::Gather, number);
        transport.recall(&record, plan, journal);
        transport.facts.add(record, baking.lighting.groups[number].factor);
        journal.reused(plan, Stage::Gather, counters);
        return Ok(layers);
    }
    baking.may_make(&baking.lighting.groups[number].name)?;
    let (surfels, solution, mut record) = transport.solution(baking, tracer, number, journal)?;
    let scale = tracer.geometry.frame.scale;
    let front = &receivers.sides[0];
    if baking.books {
        record.flows.receive(tracer.geometry, (&surfels, &solution), front, 1.0 / (scale * scale));
    }
    transport.facts.add(record.clone(), baking.lighting.groups[number].factor);
    let rays = tracer.rays(plan, journal)?;
    journal.always(Stage::Gather, plan.reason(Stage::Gather), Some(receivers.len()), |progress, counters| {
        let mut found = dark(receivers, bound);
        let field = Field::build(rays, &surfels, &solution, progress)?;
        let to = &mut found;
        match settings.gatherer() {
            Gatherer::Lookup => gather(receivers, &Lookup::new(&field), None, to, progress, counters)?,
            Gatherer::Final => {
                let gatherer = FinalGather::new(&field, settings.gather_rays.0);
                gather(receivers, &gatherer, nodes(settings), to, progress, counters)?;
            }
            Gatherer::Lightcuts => {
                let gatherer = Lightcuts::build(&field, lightcut_settings(settings), progress)?;
                gather(receivers, &gatherer, nodes(settings), to, progress, counters)?;
            }
        }
        baking.put(Kind::Gather, key, progress, |out| {
            put_value(out, &record)?;
            put_value(out, counters)?;
            write(out, &found)
        })?;
        Ok(found)
    })
}

fn nodes(settings: &Settings) -> Option<NodeSettings> {
    Some(NodeSettings { stride: settings.node_spacing.0, ..NodeSettings::default() })
}

/// How cuts are made.
pub fn lightcut_settings(settings: &Settings) -> lightcuts::Settings {
    lightcuts::Settings {
        threshold: settings.cut_error.0,
        limit: settings.cut_limit.0,
        near_rays: settings.near_rays.0,
        ..lightcuts::Settings::default()
    }
}

fn dark(receivers: &Receivers, bound: bool) -> Vec<Layer> {
    receivers.sides.iter().map(|side| Layer::dark(side, bound)).collect()
}

/// Adds what a gatherer finds to the layers.
fn gather(
    receivers: &Receivers,
    gatherer: &dyn Gather,
    nodes: Option<NodeSettings>,
    layers: &mut [Layer],
    progress: &dyn Progress,
    counters: &mut Counters,
) -> Result<(), Error> {
    let (mut rays, mut cut, mut longest, mut gathered) = (0u64, 0u64, 0u32, 0u64);
    for (side, Layer { irradiance, bound }) in receivers.sides.iter().zip(layers) {
        gathered += side.gather(gatherer, nodes, progress, |i, g| {
            irradiance[i] += g.irradiance;
            if let Some(bound) = bound.get_mut(i) {
                *bound += g.bound;
            }
            rays += u64::from(g.rays);
            cut += u64::from(g.cut);
            longest = longest.max(g.cut);
        })?;
    }
    *counters.entry("gathered_texels".into()).or_default() += gathered;
    *counters.entry("continuous_rays".into()).or_default() += rays;
    if cut > 0 {
        counters.insert("clusters".into(), cut);
        counters.insert("longest_cut".into(), u64::from(longest));
    }
    Ok(())
}

fn write(out: &mut impl Write, layers: &[Layer]) -> io::Result<()> {
    layers.iter().try_for_each(|layer| {
        put_slice(out, &layer.irradiance)?;
        put_slice(out, &layer.bound)
    })
}

fn layers(body: &mut Reader, receivers: &Receivers, bound: bool) -> Result<Vec<Layer>, String> {
    let one = |side: &Side| {
        let irradiance = artefact::light(body, side.len())?;
        Ok(Layer { irradiance, bound: artefact::bound(body, if bound { side.len() } else { 0 })? })
    };
    receivers.sides.iter().map(one).collect()
}

/// Lays the light of the far sides of walls over that of the fronts, then the backs' as the setting says.
///
/// A texel under a thin wall can hold the light of one side only, and is read on both. It takes the darker: too little
/// light in a bright place is lost over one texel, too much in a dark one is a line many times too bright.
fn combine_sides(receivers: &Receivers, direct: Vec<Layer>, indirect: Vec<Layer>, rule: DoubleSided) -> Parts {
    let mut layers = receivers.sides.iter().zip(direct.into_iter().zip(indirect));
    let Some((front, (direct, indirect))) = layers.next() else { return Parts::default() };
    let mut out = Parts {
        direct: direct.irradiance,
        indirect: indirect.irradiance,
        bound: indirect.bound,
        buried: front.buried.clone(),
    };
    for (side, (direct, indirect)) in layers {
        for (k, i) in side.numbers().enumerate() {
            let (d, n) = (direct.irradiance[k], indirect.irradiance[k]);
            let (other, own) = ((d + n).element_sum(), out.total(i).element_sum());
            let share = match rule {
                _ if !side.back => f32::from(other < own),
                // A side that lies within something has nothing to say.
                _ if side.buried[k] => 0.0,
                _ if out.buried[i] => 1.0,
                DoubleSided::Front => 0.0,
                DoubleSided::Average => 0.5,
                DoubleSided::Max => f32::from(other > own),
            };
            out.direct[i] = out.direct[i].lerp(d, share);
            out.indirect[i] = out.indirect[i].lerp(n, share);
            if let Some(bound) = out.bound.get_mut(i) {
                *bound += (indirect.bound[k] - *bound) * share;
            }
            out.buried[i] &= side.buried[k];
        }
    }
    out
}
