//! One measurement: light at all texels of an atlas by one way, its cost, and its error where the truth is known.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::sync::Arc;

use luxel_atlas::Atlas;
use luxel_export::report::Table1;
use luxel_scene::Progress;
use luxel_transport::{direct::Visibility, gather::Receiver, methods::Light};
use serde::Serialize;

use super::keys;
use super::series::{Attempt, Series, Trial};
use super::truth::Truth;
use super::{Point, Score};
use crate::Error;
use crate::bake::{
    artefact,
    digest::Digest,
    lab::{self, Cost, Lab, Ready, Technique},
};
use crate::plan::Stage;
use crate::settings::Settings;
use crate::store::{Key, Kind, Reader, Store};

/// A scene with its texels and their truth.
pub struct Measure<'a> {
    lab: &'a Lab<'a>,
    atlas: &'a Arc<Atlas>,
    truth: &'a Truth,
    /// Where measurements are kept.
    store: Option<&'a Store>,
    /// On what it runs: seconds of one machine are not those of another. Empty where only errors matter.
    machine: &'a str,
    /// Where nothing of earlier runs counts: what this one has kept.
    anew: Option<RefCell<BTreeSet<Key>>>,
}

/// What was found at the texels of the truth, and what it took at all of them.
struct Found {
    light: Vec<Light>,
    cost: Cost,
    texel_seconds: f64,
    surfels: u64,
    continuous_rays: u64,
    discrete_rays: u64,
}

impl<'a> Measure<'a> {
    pub fn new(
        lab: &'a Lab<'a>,
        atlas: &'a Arc<Atlas>,
        truth: &'a Truth,
        store: Option<&'a Store>,
        machine: &'a str,
    ) -> Self {
        Self { lab, atlas, truth, store, machine, anew: None }
    }

    /// The same where everything is measured anew, and once.
    #[must_use]
    pub fn anew(self) -> Self {
        Self { anew: Some(RefCell::default()), ..self }
    }

    /// What is kept under a key, if it may be believed.
    fn kept<T>(&self, kind: Kind, key: &Key, read: impl FnOnce(&mut Reader) -> Result<T, String>) -> Option<T> {
        let counts = self.anew.as_ref().is_none_or(|own| own.borrow().contains(key));
        self.store.filter(|_| counts)?.get(kind, key, read)
    }

    fn keep<T: Serialize>(&self, kind: Kind, key: &Key, value: &T) {
        if let Some(store) = self.store {
            store.put(kind, key, |out| artefact::put_value(out, value));
        }
        if let Some(own) = &self.anew {
            own.borrow_mut().insert(*key);
        }
    }

    /// Measures a point, or reads what was measured of it before.
    ///
    /// # Errors
    /// As a bake.
    pub fn point(&self, series: &Series, attempt: &Attempt, progress: &dyn Progress) -> Result<Point, Error> {
        let key = self.key(attempt);
        let point = match self.kept(Kind::Measurement, &key, artefact::body::<Point>) {
            Some(point) => point,
            None => {
                let point = self.made(attempt, progress)?;
                self.keep(Kind::Measurement, &key, &point);
                point
            }
        };
        // One measurement may stand in several series.
        let name = self.lab.scene().name.clone();
        let (method, value) = (attempt.method.clone(), attempt.value.clone());
        Ok(Point { scene: name, series: series.name.clone(), method, value, x: attempt.x, ..point })
    }

    /// Digest of what a measurement follows from: the truth with its paths, the method, all settings, the machine.
    fn key(&self, attempt: &Attempt) -> Key {
        let (technique, settings) = match &attempt.trial {
            Trial::Bake(settings) => ("bake".to_owned(), settings),
            Trial::Method(technique, settings) => (format!("{technique:?}"), settings),
        };
        let digest = Digest::new("measurement");
        let digest = digest.bytes(&self.truth.key).number(self.truth.paths.into()).text(&technique).text(self.machine);
        keys::all(keys::versions(digest), settings).done()
    }

    /// The figures of the paper's Table 1 of a bake with these settings, measured or read.
    ///
    /// # Errors
    /// As a bake.
    pub fn table1(&self, settings: &Settings, progress: &dyn Progress) -> Result<Table1, Error> {
        let key = self.figures_key(settings);
        if let Some(stored) = self.kept(Kind::Figures, &key, artefact::body::<Table1>) {
            return Ok(stored);
        }
        let trial = lab::attempt(self.lab.scene(), settings, self.atlas, progress)?;
        self.keep(Kind::Figures, &key, &trial.table1);
        Ok(trial.table1)
    }

    /// Digest of what the figures of a bake follow from: the scene with its texels, all settings, the machine.
    fn figures_key(&self, settings: &Settings) -> Key {
        let digest = Digest::new("figures").bytes(&self.lab.identity()).text(self.machine);
        keys::all(keys::versions(digest), settings).done()
    }

    fn made(&self, attempt: &Attempt, progress: &dyn Progress) -> Result<Point, Error> {
        let found = match &attempt.trial {
            Trial::Bake(settings) => self.bake(settings, progress)?,
            Trial::Method(technique, settings) => self.method(*technique, settings, progress)?,
        };
        Ok(Point {
            texels: self.atlas.texels.len() as u64,
            surfels: found.surfels,
            seconds: found.cost.seconds,
            texel_seconds: found.texel_seconds,
            cpu_seconds: found.cost.cpu_seconds,
            continuous_rays: found.continuous_rays,
            discrete_rays: found.discrete_rays,
            reference_paths: self.truth.paths,
            score: Score::of(&found.light, self.truth),
            ..Point::default()
        })
    }

    fn bake(&self, settings: &Settings, progress: &dyn Progress) -> Result<Found, Error> {
        let trial = lab::attempt(self.lab.scene(), settings, self.atlas, progress)?;
        let light = |i: &usize| Light {
            direct: trial.parts.direct[*i],
            indirect: trial.parts.indirect[*i],
            ..Light::default()
        };
        // Every bake that is measured has the figures of Table 1.
        self.keep(Kind::Figures, &self.figures_key(settings), &trial.table1);
        Ok(Found {
            light: self.truth.points.iter().map(|known| light(&known.texel)).collect(),
            cost: trial.cost,
            texel_seconds: trial.seconds(&[Stage::Clear, Stage::Direct, Stage::Sky, Stage::Gather]),
            surfels: trial.facts.surfels,
            continuous_rays: trial.table1.continuous_rays,
            discrete_rays: trial.table1.discrete_rays,
        })
    }

    fn method(&self, technique: Technique, settings: &Settings, progress: &dyn Progress) -> Result<Found, Error> {
        let side = self.lab.receivers(self.atlas);
        let receivers: Vec<Receiver> = (0..side.len()).map(|i| side.receiver(i)).collect();
        let lab = self.lab.tuned(settings);
        // What the solution took was measured when it was made; here it is only asked for.
        let cache = if technique.is_cached() { Some(lab.cache(progress)?) } else { None };
        let work = |Ready { method, rays }: Ready| Ok((method.light(&receivers, progress)?, rays));
        let (found, cost) = Cost::of(|| lab.method(technique, Visibility::Shafts, progress, work));
        let (all, prepared): (Vec<Light>, u64) = found?;
        let record = cache.and_then(|cache| cache.record.as_ref());
        let traced = |light: &Light| u64::from(light.rays);
        Ok(Found {
            light: self.truth.points.iter().map(|known| all[known.texel]).collect(),
            texel_seconds: cost.seconds,
            cost: cost + lab.rays_cost + cache.map_or(Cost::default(), |cache| cache.cost),
            surfels: cache.map_or(0, |cache| cache.surfels.list.len() as u64),
            continuous_rays: all.iter().map(traced).sum::<u64>() + prepared,
            discrete_rays: record.map_or(0, |record| record.discrete_rays),
        })
    }
}
