//! What a report says of the light at surfels, kept with that light: a bake that reuses it reports the same figures.
//!
//! Only what follows from the input is kept. Times do not, so the stored bytes are the same on every machine.

use std::collections::BTreeMap;

use luxel_export::report::EnergyLedger;
use luxel_transport::Rgb;
use luxel_transport::solve::SolveReport;
use serde::{Deserialize, Serialize};

use super::energy::{self, Flows};
use super::journal::Counters;

/// How the light at surfels came about.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// What the stages counted, by their names.
    pub counters: BTreeMap<String, Counters>,
    /// Length of the light paths, direct light included.
    pub path_length: u64,
    /// Directions of the first bounce.
    pub directions: u64,
    pub discrete_rays: u64,
    /// Remaining share of the indirect light when the bounces stopped.
    pub tail: f64,
    /// Mean row sum and row-sum defect, where they were measured.
    pub rows: Option<[f64; 2]>,
    /// In lumens.
    pub energy: EnergyLedger,
    /// By which the stages after the propagation are booked.
    pub flows: Flows,
}

impl Record {
    /// The solver's figures; `scale` is frame units per scene unit.
    pub fn new(solve: &SolveReport, scale: f64) -> Self {
        let ledger = solve.ledger.scaled(1.0 / (scale * scale));
        Self {
            counters: BTreeMap::new(),
            path_length: solve.path_length() as u64,
            directions: solve.bounces.first().map_or(0, |b| u64::from(b.directions)),
            discrete_rays: solve.discrete_rays,
            tail: solve.tail,
            rows: solve.rows.as_ref().map(|r| [r.mean, r.defect()]),
            energy: EnergyLedger {
                emitted: ledger.shot.to_array(),
                from_sky: ledger.sky.to_array(),
                absorbed: ledger.absorbed.to_array(),
                escaped: ledger.escaped.to_array(),
                remaining: ledger.in_flight.to_array(),
                defect: ledger.imbalance.to_array(),
                ..EnergyLedger::default()
            },
            flows: Flows::default(),
        }
    }

    /// The record of lights that are stronger, by band. The figures of the operator and of its convergence stay.
    pub fn scaled(self, factor: Rgb) -> Self {
        let factor = factor.as_dvec3().to_array();
        let scaled = |flux: [f64; 3]| [0, 1, 2].map(|band| flux[band] * factor[band]);
        let EnergyLedger { state, emitted, from_sky, absorbed, escaped, remaining, defect, stages } = self.energy;
        let energy = EnergyLedger {
            emitted: scaled(emitted),
            from_sky: scaled(from_sky),
            absorbed: scaled(absorbed),
            escaped: scaled(escaped),
            remaining: scaled(remaining),
            defect: scaled(defect),
            state,
            stages: energy::scaled(&stages, factor),
        };
        Self { energy, flows: self.flows.scaled(factor), ..self }
    }

    /// The record of two light groups: their sums, and the worse of what converged.
    pub fn joined(self, other: Self) -> Self {
        let sum = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|band| a[band] + b[band]);
        let (a, b) = (&self.energy, &other.energy);
        let energy = EnergyLedger {
            emitted: sum(a.emitted, b.emitted),
            from_sky: sum(a.from_sky, b.from_sky),
            absorbed: sum(a.absorbed, b.absorbed),
            escaped: sum(a.escaped, b.escaped),
            remaining: sum(a.remaining, b.remaining),
            defect: sum(a.defect, b.defect),
            state: a.state,
            stages: energy::joined(&a.stages, &b.stages),
        };
        Self {
            path_length: self.path_length.max(other.path_length),
            directions: self.directions.max(other.directions),
            discrete_rays: self.discrete_rays + other.discrete_rays,
            tail: self.tail.max(other.tail),
            rows: self.rows.or(other.rows),
            energy,
            flows: self.flows.joined(&other.flows),
            counters: self.counters,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::artefact::{head, put_value};

    fn record() -> Record {
        let solve = SolveReport { discrete_rays: 7, tail: 0.25, ..SolveReport::default() };
        let counters = Counters::from([("continuous_rays".into(), 3)]);
        Record { counters: BTreeMap::from([("shoot".into(), counters)]), ..Record::new(&solve, 2.0) }
    }

    #[test]
    fn a_record_comes_back_with_what_follows_it() {
        let mut bytes = Vec::new();
        put_value(&mut bytes, &record()).unwrap();
        let length = bytes.len();
        bytes.extend(b"octree");
        let mut rest = &bytes[..];
        assert_eq!(head::<Record>(&mut rest).unwrap(), record());
        assert_eq!(rest, b"octree");
        for n in 0..length {
            assert!(head::<Record>(&mut &bytes[..n]).is_err(), "{n}");
        }
    }

    #[test]
    fn a_claimed_size_is_not_believed() {
        // The first number is the count of stages.
        assert!(head::<Record>(&mut &[253, 255, 255, 255, 255, 255, 255, 255, 0, 1, 2, 3][..]).is_err());
        // One stage, whose name is said to be long.
        assert!(head::<Record>(&mut &[1, 252, 255, 255, 255, 127, b'x'][..]).is_err());
    }

    #[test]
    fn records_of_groups_add_up_at_the_strength_of_their_lights() {
        let mut lamp = record();
        lamp.energy.emitted = [1.0, 2.0, 3.0];
        let sun = Record { tail: 0.5, path_length: 9, ..lamp.clone() }.scaled(Rgb::new(2.0, 0.0, 1.0));
        assert_eq!(sun.energy.emitted, [2.0, 0.0, 3.0]);
        let both = lamp.joined(sun);
        assert_eq!((both.energy.emitted, both.discrete_rays), ([3.0, 2.0, 6.0], 14));
        assert_eq!((both.tail, both.path_length), (0.5, 9));
    }
}
