//! After every edit of a sequence the incremental bake has the bytes of a clean one, whatever its store has seen.

use crate::baked::{Place, clean, plan, run};
use crate::edits::{Random, edit};
use crate::level::{Level, SCENE};

/// Sequences, and how often each is baked after its first bake.
const SEQUENCES: u64 = 30;
const BAKES: usize = 3;

/// Bakes a sequence; says what differs, and after which edits.
fn sequence(seed: u64) -> Result<usize, String> {
    let (place, mut random) = (Place::new(), Random::new(seed));
    let mut level = if seed.is_multiple_of(2) { Level::new() } else { Level::rich() };
    let mut history: Vec<Level> = Vec::new();
    let mut told = Vec::new();
    let mut reused = 0;
    for round in 0..=BAKES {
        let mut edits = Vec::new();
        if round > 0 {
            history.push(level.clone());
            if random.below(6) == 0 {
                level = random.one(&history).clone();
                edits.push("goes back".to_owned());
            } else {
                edits.extend((0..1 + random.below(3)).map(|_| edit(&mut level, &mut random)));
            }
        }
        told.push(edits);
        let scene = level.write(place.folder.path());
        assert_eq!(scene, place.at(SCENE));
        let planned = plan(&scene, &place.target());
        let baked = run(&scene, &place.target());
        let failed = |why: String| format!("seed {seed}, edits {told:#?}:\n{why}");
        baked.is_same(&clean(&scene)).map_err(&failed)?;
        baked.is_as(&planned).and_then(|()| baked.forgot_nothing()).map_err(&failed)?;
        if let Some(warning) = baked.warnings("store").first() {
            return Err(failed(warning.to_string()));
        }
        reused += planned.steps.iter().filter(|step| step.reused).count();
    }
    Ok(reused)
}

fn sequences(seeds: std::ops::Range<u64>) {
    let mut reused = 0;
    for seed in seeds.clone() {
        reused += sequence(seed).unwrap_or_else(|why| panic!("{why}"));
    }
    println!("{} sequences, {reused} stages reused", seeds.end - seeds.start);
    assert!(reused > 100, "only {reused} stages were reused: the sequences prove nothing");
}

#[test]
fn the_first_half_of_the_sequences_bakes_what_clean_bakes_do() {
    sequences(0..SEQUENCES / 2);
}

#[test]
fn the_second_half_of_the_sequences_bakes_what_clean_bakes_do() {
    sequences(SEQUENCES / 2..SEQUENCES);
}
