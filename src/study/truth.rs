//! The reference at some texels of an atlas, kept in a store.
//!
//! Texels are drawn and walked as by a verification ([`crate::verify::sample`]), in rounds of [`ROUND`] paths a texel,
//! each with seeds of its own. What all rounds together found is kept after each, so that nothing is walked twice.

use luxel_atlas::Atlas;
use luxel_scene::Progress;
use luxel_transport::reference::{Estimate, Options, Reference};

use super::keys;
use crate::Error;
use crate::bake::{artefact, digest::Digest, lab::Lab};
use crate::settings::{DoubleSided, Only};
use crate::store::{Key, Kind, Reader, Store};
use crate::verify::sample::{Drawn, Holds, Population, Sum, walk};
use crate::verify::y;

/// Paths a texel and round; the last one may have fewer.
pub const ROUND: u32 = 1024;

/// Mixed into the seeds of draws and rounds, which have nothing to do with a bake's own or a verification's.
const SEED: u64 = 0x7245_7468;

/// Errors are those of all light, on fronts.
const HOLDS: Holds = Holds { double_sided: DoubleSided::Front, only: Only::All };

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
#[derive(Clone, Copy, Debug, Default)]
pub struct Known {
    /// Number in the atlas.
    pub texel: usize,
    /// 1 where the draw follows area, else the area that it stands for.
    pub weight: f64,
    pub light: Estimate,
}

/// The reference at some texels.
#[derive(Clone, Debug, Default)]
pub struct Truth {
    /// In the order of the draw, which is that of the atlas.
    pub points: Vec<Known>,
    /// Paths a texel.
    pub paths: u32,
    /// Says which texels of which scene these are.
    pub key: Key,
}

impl Truth {
    /// Mean irradiance, over the bands [lux].
    pub fn mean(&self) -> f64 {
        self.average(|light| y(light.total))
    }

    /// Root mean square of the standard error over the mean.
    pub fn noise(&self) -> f64 {
        let (mean, square) = (self.mean(), self.average(|light| f64::from(light.standard_error).powi(2)));
        if mean > 0.0 { square.sqrt() / mean } else { 0.0 }
    }

    fn average(&self, of: impl Fn(&Estimate) -> f64) -> f64 {
        let weight: f64 = self.points.iter().map(|point| point.weight).sum();
        let sum: f64 = self.points.iter().map(|point| point.weight * of(&point.light)).sum();
        if weight > 0.0 { sum / weight } else { 0.0 }
    }
}

/// So many texels that count, by area; all of them where there are no more.
pub fn texels(lab: &Lab, atlas: &Atlas, count: usize) -> Vec<Drawn> {
    let drawn = Population::new(atlas, |_| false).draw(count, SEED);
    Drawn::all(atlas, lab.rays, drawn, HOLDS)
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
    mut texels: Vec<Drawn>,
    (how, purpose): (&Exactness, &str),
    store: Option<&Store>,
    progress: &dyn Progress,
) -> Result<Truth, Error> {
    let numbers: Vec<u64> = texels.iter().map(|d| d.texel as u64).collect();
    let key = keys::version(Digest::new("reference")).text(purpose).bytes(&lab.identity()).slice(&numbers).done();
    let read = |body: &mut Reader| artefact::body::<(u32, Vec<Sum>)>(body);
    let stored = store.and_then(|store| store.get(Kind::Reference, &key, read));
    let mut walked = 0;
    if let Some((paths, sums)) = stored.filter(|(_, sums)| sums.len() == texels.len()) {
        walked = paths;
        texels.iter_mut().zip(sums).for_each(|(d, sum)| d.sums[0] = sum);
    }
    let reference = Reference::new(lab.rays, Options::default());
    let most = how.paths.max(1);
    loop {
        let known = |d: &Drawn| Known { texel: d.texel, weight: d.weight, light: d.expected(HOLDS) };
        let truth = Truth { points: texels.iter().map(known).collect(), paths: walked, key };
        // One round alone says nothing about a light that it may have missed.
        if texels.is_empty() || walked >= most || (walked >= 2 * ROUND && truth.noise() <= how.noise) {
            return Ok(truth);
        }
        progress.begin("reference", texels.len() as u64);
        // Rounds are told apart by the paths before them.
        let paths = ROUND.min(most - walked);
        walk(&reference, &mut texels, (paths, SEED + u64::from(walked)), progress)?;
        walked += paths;
        if let Some(store) = store {
            let sums: Vec<Sum> = texels.iter().map(|d| d.sums[0]).collect();
            store.put(Kind::Reference, &key, |out| artefact::put_value(out, &(walked, &sums)));
        }
    }
}
