//! The reference at some texels of an atlas.
//!
//! Texels are drawn in proportion to the area that they stand for, one from each of as many strata, so that a mean over
//! them is a mean over surfaces. Those that are covered by less than half, or whose point lies inside other geometry, do
//! not count. The reference walks in rounds of [`ROUND`] paths a texel, each with seeds of its own; what all rounds
//! together found is kept in a store after each, so that nothing is walked twice.

use luxel_atlas::Atlas;
use luxel_scene::Progress;
use luxel_transport::{
    Rgb,
    gather::Receiver,
    reference::{Options, Reference},
    sampling::{combine, mix, unit},
    validity,
};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::bake::{artefact, digest::Digest, lab::Lab};
use crate::store::{Key, Kind, Store};

/// Paths a texel and round.
pub const ROUND: u32 = 1024;

/// Mixed into the seeds of rounds, which have nothing to do with a bake's own.
const SEED: u64 = 0x7245_7468;

/// How exact the reference has to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exactness {
    /// Texels, about.
    pub texels: usize,
    /// Root mean square of the standard error over the mean irradiance at which no further round is walked.
    pub noise: f64,
    /// Most paths a texel.
    pub paths: u32,
}

/// What is known of a texel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Known {
    /// [lux]
    pub direct: Rgb,
    pub indirect: Rgb,
    /// Standard error of every band of both together [lux].
    pub band_error: Rgb,
    /// Variances of the band means [lux²]: of both together, and of each.
    pub variance: f64,
    pub direct_variance: f64,
    pub indirect_variance: f64,
}

impl Known {
    /// All light [lux].
    pub fn total(&self) -> Rgb {
        self.direct + self.indirect
    }
}

/// The reference at some texels.
#[derive(Clone, Debug, Default)]
pub struct Truth {
    /// Numbers in the atlas.
    pub texels: Vec<usize>,
    pub points: Vec<Known>,
    /// Paths a texel.
    pub paths: u32,
    /// Says which texels of which scene these are.
    pub key: Key,
}

impl Truth {
    /// Mean irradiance, over the bands [lux].
    pub fn mean(&self) -> f64 {
        let sum: f64 = self.points.iter().map(|t| f64::from(t.total().element_sum()) / 3.0).sum();
        sum / self.points.len().max(1) as f64
    }

    /// Root mean square of the standard error over the mean.
    pub fn noise(&self) -> f64 {
        let variance = self.points.iter().map(|t| t.variance).sum::<f64>() / self.points.len().max(1) as f64;
        if self.mean() > 0.0 { variance.sqrt() / self.mean() } else { 0.0 }
    }
}

/// Sums over rounds, by texel: of the estimates of direct and indirect light, and of their variances.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Sums {
    rounds: u32,
    direct: Vec<[f64; 3]>,
    indirect: Vec<[f64; 3]>,
    /// Of each band of both together, and of the band means of both, of direct, of indirect.
    variance: Vec<[f64; 6]>,
}

/// Texels that count, evenly by area.
pub fn texels(lab: &Lab, atlas: &Atlas, count: usize) -> Vec<usize> {
    let receivers = lab.receivers(atlas);
    let valid: Vec<usize> = (0..atlas.texels.len()).filter(|&i| atlas.texels[i].coverage() >= 0.5).collect();
    let area = |i: usize| f64::from(atlas.texels[i].footprint()).powi(2) * f64::from(atlas.texels[i].coverage());
    let total: f64 = valid.iter().map(|&i| area(i)).sum();
    let stratum = total / count.max(1) as f64;
    let (mut chosen, mut passed, mut next) = (Vec::new(), 0.0, 0u64);
    let place = |k: u64| (k as f64 + f64::from(unit(mix(k)))) * stratum;
    for i in valid {
        passed += area(i);
        let mut is_met = false;
        while next < count as u64 && place(next) < passed {
            (is_met, next) = (true, next + 1);
        }
        if is_met && !validity::is_buried(lab.rays, &receivers.receiver(i)) {
            chosen.push(i);
        }
    }
    chosen
}

/// Walks until the reference is exact enough; what is stored of it is not walked again.
///
/// References of one purpose share what is stored, so one may come out more exact than was asked for. Where something is
/// decided by it that must not depend on earlier reports, the purpose is one that always asks for the same.
///
/// # Errors
/// When the work is cancelled: the rounds until then are stored.
pub fn truth(
    lab: &Lab,
    atlas: &Atlas,
    texels: Vec<usize>,
    (how, purpose): (&Exactness, &str),
    store: Option<&Store>,
    progress: &dyn Progress,
) -> Result<Truth, Error> {
    let receivers = lab.receivers(atlas);
    let receivers: Vec<Receiver> = texels.iter().map(|&i| receivers.receiver(i)).collect();
    let numbers: Vec<u64> = texels.iter().map(|&i| i as u64).collect();
    let key =
        Digest::new("reference").text(purpose).number(super::VERSION).bytes(&lab.identity()).slice(&numbers).done();
    let read = |body: &mut crate::store::Reader| artefact::body::<Sums>(body);
    let fits = |sums: &Sums| [sums.direct.len(), sums.indirect.len(), sums.variance.len()] == [texels.len(); 3];
    let stored = store.and_then(|store| store.get(Kind::Reference, &key, read)).filter(fits);
    let nothing = vec![[0.0; 3]; texels.len()];
    let mut sums = stored.unwrap_or_else(|| Sums {
        rounds: 0,
        direct: nothing.clone(),
        indirect: nothing.clone(),
        variance: vec![[0.0; 6]; texels.len()],
    });
    let reference = Reference::new(lab.rays, Options::default());
    let most = how.paths.div_ceil(ROUND).max(1);
    loop {
        let truth = sums.truth(&texels, key);
        // One round alone says nothing about a light that it may have missed.
        if texels.is_empty() || sums.rounds >= most || (sums.rounds >= 2 && truth.noise() <= how.noise) {
            return Ok(truth);
        }
        sums.walk(&reference, &receivers, progress)?;
        if let Some(store) = store {
            store.put(Kind::Reference, &key, |out| artefact::put_value(out, &sums));
        }
    }
}

impl Sums {
    fn walk(&mut self, reference: &Reference, receivers: &[Receiver], progress: &dyn Progress) -> Result<(), Error> {
        let seed = combine(SEED, u64::from(self.rounds));
        let seeded = |r: &Receiver| Receiver { seed: combine(r.seed, seed), ..*r };
        let receivers: Vec<Receiver> = receivers.iter().map(seeded).collect();
        for (i, e) in reference.irradiances(&receivers, ROUND, progress)?.into_iter().enumerate() {
            for band in 0..3 {
                self.direct[i][band] += f64::from(e.direct[band]);
                self.indirect[i][band] += f64::from(e.indirect[band]);
            }
            let [r, g, b] = e.band_error.to_array();
            let errors = [r, g, b, e.standard_error, e.direct_error, e.indirect_error];
            for (sum, error) in self.variance[i].iter_mut().zip(errors) {
                *sum += f64::from(error) * f64::from(error);
            }
        }
        self.rounds += 1;
        Ok(())
    }

    fn truth(&self, texels: &[usize], key: Key) -> Truth {
        let n = f64::from(self.rounds.max(1));
        let mean = |sums: &[f64; 3]| Rgb::from_array(sums.map(|sum| (sum / n) as f32));
        let point = |i: usize| {
            let [r, g, b, variance, direct_variance, indirect_variance] = self.variance[i].map(|sum| sum / (n * n));
            let band_error = Rgb::from_array([r, g, b].map(|variance| variance.sqrt() as f32));
            let (direct, indirect) = (mean(&self.direct[i]), mean(&self.indirect[i]));
            Known { direct, indirect, band_error, variance, direct_variance, indirect_variance }
        };
        let points = (0..texels.len()).map(point).collect();
        Truth { texels: texels.to_vec(), points, paths: self.rounds * ROUND, key }
    }
}
