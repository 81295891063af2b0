//! What a report says of the light at surfels, kept with that light: a bake that reuses it reports the same figures.
//!
//! Only what follows from the input is kept. Times do not, so the stored bytes are the same on every machine.

use std::collections::BTreeMap;

use std::io::{self, Read, Write};

use bincode::error::EncodeError;
use bincode::serde::{decode_from_std_read, encode_into_std_write};
use luxel_export::report::EnergyLedger;
use luxel_transport::solve::SolveReport;
use serde::{Deserialize, Serialize};

use super::journal::Counters;

/// Most bytes that a stored record may take. A few hundred are usual.
const LARGEST: usize = 1 << 16;

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
        }
    }

    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        match encode_into_std_write(self, out, bincode::config::standard()) {
            Ok(_) => Ok(()),
            Err(EncodeError::Io { inner, .. }) => Err(inner),
            Err(error) => Err(io::Error::other(error)),
        }
    }

    /// Reads a record, and nothing of what follows it.
    pub fn read(input: &mut impl Read) -> Result<Self, String> {
        decode_from_std_read(input, bincode::config::standard().with_limit::<LARGEST>()).map_err(|e| e.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> Record {
        let solve = SolveReport { discrete_rays: 7, tail: 0.25, ..SolveReport::default() };
        let counters = Counters::from([("continuous_rays".into(), 3)]);
        Record { counters: BTreeMap::from([("shoot".into(), counters)]), ..Record::new(&solve, 2.0) }
    }

    #[test]
    fn a_record_comes_back_with_what_follows_it() {
        let mut bytes = Vec::new();
        record().write(&mut bytes).unwrap();
        let length = bytes.len();
        bytes.extend(b"octree");
        let mut rest = &bytes[..];
        assert_eq!(Record::read(&mut rest).unwrap(), record());
        assert_eq!(rest, b"octree");
        for n in 0..length {
            assert!(Record::read(&mut &bytes[..n]).is_err(), "{n}");
        }
    }

    #[test]
    fn a_claimed_size_is_not_believed() {
        // The first number is the count of stages.
        assert!(Record::read(&mut &[253, 255, 255, 255, 255, 255, 255, 255, 0, 1, 2, 3][..]).is_err());
        // One stage, whose name is said to be long.
        assert!(Record::read(&mut &[1, 252, 255, 255, 255, 127, b'x'][..]).is_err());
    }
}
