//! The goals by number, in one run: what was measured beside what must be and what is aimed at.
//!
//! `cargo bench --bench goals` prints the whole table, `-- quick` leaves out the bakes (the rows on errors, texels and
//! whole bakes and on edits). Others print a table of their own: `-- gaps`, how soon a bake stops, stage by stage,
//! `-- edits`, what edits of a scene cost beside its bake, by the wall clock (`--size 256` makes its lightmap smaller), and
//! `-- moved`, how much light changes when an object moves.
//! Rates of one thread are taken from that thread's processor time, so that they do not depend on what
//! else the machine does (but for shared caches and processors that share a core); only the comparison of two
//! threads with one needs the wall clock and two idle processors. Ratios compare work that was timed in turns.

mod bakes;
mod edits;
mod gaps;
mod heap;
mod meter;
mod moved;
mod rates;
#[path = "../support/mod.rs"]
mod support;
mod yardstick;

#[global_allocator]
static ALLOCATOR: meter::Counting = meter::Counting;

/// Which side of the goal a value has to be on.
#[derive(Clone, Copy)]
pub enum Goal {
    AtLeast {
        must: f64,
        aim: f64,
    },
    AtMost {
        must: f64,
        aim: f64,
    },
    /// Belongs to the table, but no goal is set for it here.
    Information,
}

/// Prints one row of the table; the last column says by how much the goal is met (at least 1) or missed.
pub fn row(what: &str, value: f64, unit: &str, goal: Goal) {
    let (must, aim, met) = match goal {
        Goal::AtLeast { must, aim } => (format!("≥ {must}"), format!("{aim}"), Some(value / must)),
        Goal::AtMost { must, aim } => (format!("≤ {must}"), format!("{aim}"), Some(must / value)),
        Goal::Information => (String::new(), String::new(), None),
    };
    let verdict = match met {
        Some(m) if m >= 1.0 => format!("{m:8.2}"),
        Some(m) => format!("{m:8.2} MISSED"),
        None => String::new(),
    };
    println!("{what:<58} {value:>9.2} {unit:<9} {must:>8} {aim:>7} {verdict}");
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let asked = |what: &str| args.iter().any(|a| a == what);
    let size = args.iter().skip_while(|a| *a != "--size").nth(1).map_or(1024, |a| a.parse().expect("a size"));
    println!("{:<58} {:>9} {:<9} {:>8} {:>7} {:>8}", "what", "value", "unit", "must", "aim", "met");
    if asked("gaps") {
        return gaps::measure();
    }
    if asked("moved") {
        return moved::measure();
    }
    if asked("edits") {
        return edits::measure(size);
    }
    rates::measure();
    bakes::start_up();
    if !asked("quick") {
        bakes::measure();
        edits::measure(size);
    }
}
