//! Shapes on pages: a bottom-left packer over a bit per texel.
//!
//! A shape is a pile of rows of spans (its texels, padding included), so charts nest into each other's slants and
//! holes. A row of a page is a bit string of free texels; the places where a span of length `len` fits are
//! found for all x at once by log₂ `len` shift-and-ands, and the places of a shape are the intersection over its
//! spans. Shapes go in order of size, each where it stays lowest; ties go to the left. No randomness, no clock: the
//! same shapes give the same places.

use std::collections::HashMap;

use luxel_scene::{Cancelled, Progress};

/// What a chart occupies, its padding included.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    pub width: u32,
    pub height: u32,
    /// None for a full rectangle.
    pub spans: Option<Spans>,
}

/// Half-open spans of one row or column, ascending and apart.
pub(crate) type Line = Vec<[u32; 2]>;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Spans {
    pub rows: Vec<Line>,
    pub columns: Vec<Line>,
}

/// Where a shape landed, after `turn` quarter turns that take (x, y) to (height − y, x).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Spot {
    pub x: u32,
    pub y: u32,
    pub turn: u8,
}

impl Shape {
    pub fn area(&self) -> u64 {
        match &self.spans {
            None => u64::from(self.width) * u64::from(self.height),
            Some(spans) => spans.rows.iter().flatten().map(|[a, b]| u64::from(b - a)).sum(),
        }
    }

    /// The shape after some quarter turns, as a rectangle or as rows.
    fn turned(&self, turn: u8) -> Variant {
        let (w, h) = (self.width, self.height);
        let (width, height) = if turn.is_multiple_of(2) { (w, h) } else { (h, w) };
        let mirrored = |lines: &[Line], n: u32| -> Vec<Line> {
            lines.iter().map(|line| line.iter().rev().map(|[a, b]| [n - b, n - a]).collect()).collect()
        };
        let rows = self.spans.as_ref().map(|spans| match turn {
            0 => spans.rows.clone(),
            // Row y of the turned shape is column y of the old one, read from the far end.
            1 => mirrored(&spans.columns, h),
            2 => mirrored(&spans.rows, w).into_iter().rev().collect(),
            _ => spans.columns.iter().rev().cloned().collect(),
        });
        Variant { turn, width, height, rows }
    }

    fn variants(&self) -> Vec<Variant> {
        match (&self.spans, self.width == self.height) {
            (None, true) => vec![self.turned(0)],
            (None, false) => vec![self.turned(0), self.turned(1)],
            (Some(_), _) => (0..4).map(|turn| self.turned(turn)).collect(),
        }
    }
}

struct Variant {
    turn: u8,
    width: u32,
    height: u32,
    rows: Option<Vec<Line>>,
}

/// Packs all shapes into one page, or says that they do not fit.
pub(crate) fn pack(shapes: &[Shape], side: u32, progress: &dyn Progress) -> Result<Option<Vec<Spot>>, Cancelled> {
    let area: u64 = shapes.iter().map(Shape::area).sum();
    if area > u64::from(side) * u64::from(side) {
        return Ok(None);
    }
    let mut order: Vec<usize> = (0..shapes.len()).collect();
    order.sort_by_key(|&i| {
        let shape = &shapes[i];
        (std::cmp::Reverse((shape.width.max(shape.height), shape.area())), i)
    });
    let mut page = Sheet::new(side);
    let mut spots = vec![Spot::default(); shapes.len()];
    for i in order {
        progress.check()?;
        let Some(spot) = page.place(&shapes[i]) else { return Ok(None) };
        spots[i] = spot;
    }
    Ok(Some(spots))
}

/// One page while it fills.
struct Sheet {
    side: u32,
    /// Words per row.
    words: usize,
    /// Rows of free texels, one bit each.
    free: Vec<u64>,
    /// Longest run of free texels in each row.
    longest: Vec<u32>,
    /// Below this row no rectangle of this size fits any more: places only ever fill.
    first_row: HashMap<(u32, u32), u32>,
    /// Where the last outline of this size ended up: a good row to go on from, if not the lowest possible.
    last_row: HashMap<(u32, u32), u32>,
}

impl Sheet {
    fn new(side: u32) -> Self {
        let words = (side as usize).div_ceil(64);
        let mut row = vec![u64::MAX; words];
        if !side.is_multiple_of(64) {
            row[words - 1] = (1 << (side % 64)) - 1;
        }
        Self {
            side,
            words,
            free: row.repeat(side as usize),
            longest: vec![side; side as usize],
            first_row: HashMap::new(),
            last_row: HashMap::new(),
        }
    }

    fn row(&self, y: u32) -> &[u64] {
        &self.free[y as usize * self.words..][..self.words]
    }

    fn place(&mut self, shape: &Shape) -> Option<Spot> {
        let mut best: Option<((u32, u32), Variant, u32, u32)> = None;
        for variant in shape.variants() {
            if variant.width > self.side || variant.height > self.side {
                continue;
            }
            let ceiling = best.as_ref().map_or(self.side, |(score, ..)| score.0);
            let Some((x, y)) = self.find(&variant, ceiling) else { continue };
            let score = (y + variant.height, x);
            if best.as_ref().is_none_or(|(other, ..)| score < *other) {
                best = Some((score, variant, x, y));
            }
        }
        let (_, variant, x, y) = best?;
        self.fill(&variant, x, y);
        Some(Spot { x, y, turn: variant.turn })
    }

    /// Lowest place, then leftmost, at which the variant ends no higher than row `ceiling`.
    fn find(&mut self, variant: &Variant, ceiling: u32) -> Option<(u32, u32)> {
        let last = ceiling.min(self.side).checked_sub(variant.height)?;
        let mut fits = vec![0; self.words];
        let mut scratch = vec![0; self.words];
        match &variant.rows {
            None => {
                let size = (variant.width, variant.height);
                let from = self.first_row.get(&size).copied().unwrap_or(0);
                let found = (from..=last).find_map(|y| {
                    self.fits_rectangle(variant, y, &mut fits).then(|| first_bit(&fits).map(|x| (x, y))).flatten()
                });
                let known = found.map_or(last + 1, |(_, y)| y);
                self.first_row.insert(size, known.max(from));
                found
            }
            Some(rows) => {
                let size = (variant.width, variant.height);
                let from = self.last_row.get(&size).map_or(0, |row| row.saturating_sub(variant.height));
                let mut at = |y: u32| {
                    let hit = self.fits_rows(rows, y, &mut fits, &mut scratch);
                    hit.then(|| first_bit(&fits).map(|x| (x, y))).flatten()
                };
                // The rows below are searched again only before giving up.
                let below = if ceiling < self.side { 0 } else { from.min(last + 1) };
                let found = (from..=last).find_map(&mut at).or_else(|| (0..below).find_map(&mut at));
                if let Some((_, y)) = found {
                    self.last_row.insert(size, y);
                }
                found
            }
        }
    }

    /// Marks every x at which the rectangle fits in rows y…; false when there is none.
    fn fits_rectangle(&self, variant: &Variant, y: u32, fits: &mut [u64]) -> bool {
        let rows = y..y + variant.height;
        if self.longest[rows.start as usize..rows.end as usize].iter().any(|&run| run < variant.width) {
            return false;
        }
        fits.copy_from_slice(self.row(y));
        for row in rows.skip(1) {
            fits.iter_mut().zip(self.row(row)).for_each(|(fit, free)| *fit &= free);
        }
        runs(fits, variant.width);
        fits.iter().any(|&word| word != 0)
    }

    /// The same for rows of spans.
    fn fits_rows(&self, rows: &[Line], y: u32, fits: &mut [u64], scratch: &mut [u64]) -> bool {
        let run_fits = |(r, line): (usize, &Line)| line.iter().all(|[a, b]| self.longest[y as usize + r] >= b - a);
        if !rows.iter().enumerate().all(run_fits) {
            return false;
        }
        fits.fill(u64::MAX);
        for (row, line) in (y..).zip(rows) {
            for &[a, b] in line {
                scratch.copy_from_slice(self.row(row));
                runs(scratch, b - a);
                shift_down(scratch, a);
                let mut any = 0;
                for (fit, word) in fits.iter_mut().zip(scratch.iter()) {
                    *fit &= word;
                    any |= *fit;
                }
                if any == 0 {
                    return false;
                }
            }
        }
        true
    }

    fn fill(&mut self, variant: &Variant, x: u32, y: u32) {
        let whole = vec![[0, variant.width]];
        for r in 0..variant.height {
            let line = variant.rows.as_ref().map_or(&whole, |rows| &rows[r as usize]);
            let row = &mut self.free[(y + r) as usize * self.words..][..self.words];
            for bit in line.iter().flat_map(|[a, b]| x + a..x + b) {
                row[bit as usize / 64] &= !(1 << (bit % 64));
            }
            self.longest[(y + r) as usize] = longest_run(row);
        }
    }
}

/// Keeps the bits that start a run of at least `len` ones.
fn runs(bits: &mut [u64], len: u32) {
    let mut have = 1;
    while have < len {
        let step = have.min(len - have);
        and_shifted(bits, step);
        have += step;
    }
}

/// bits &= bits >> shift
fn and_shifted(bits: &mut [u64], shift: u32) {
    let (skip, part) = ((shift / 64) as usize, shift % 64);
    for i in 0..bits.len() {
        bits[i] &= word_at(bits, i + skip, part);
    }
}

/// bits >>= shift
fn shift_down(bits: &mut [u64], shift: u32) {
    let (skip, part) = ((shift / 64) as usize, shift % 64);
    for i in 0..bits.len() {
        bits[i] = word_at(bits, i + skip, part);
    }
}

/// 64 bits from bit `part` of word `i` on; zeros beyond the end.
fn word_at(bits: &[u64], i: usize, part: u32) -> u64 {
    let word = |i: usize| bits.get(i).copied().unwrap_or(0);
    if part == 0 { word(i) } else { (word(i) >> part) | (word(i + 1) << (64 - part)) }
}

fn first_bit(bits: &[u64]) -> Option<u32> {
    bits.iter().position(|&word| word != 0).map(|i| i as u32 * 64 + bits[i].trailing_zeros())
}

fn longest_run(row: &[u64]) -> u32 {
    let (mut best, mut run) = (0, 0);
    for &word in row {
        match word {
            u64::MAX => run += 64,
            0 => run = 0,
            mut word => {
                let mut left = 64;
                while left > 0 {
                    let ones = word.trailing_ones().min(left);
                    run += ones;
                    best = best.max(run);
                    left -= ones;
                    if left == 0 {
                        break;
                    }
                    run = 0;
                    word = word.checked_shr(ones).unwrap_or(0);
                    let zeros = word.trailing_zeros().min(left);
                    left -= zeros;
                    word = word.checked_shr(zeros).unwrap_or(0);
                }
            }
        }
        best = best.max(run);
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::Silent;

    fn pack(shapes: &[Shape], side: u32) -> Option<Vec<Spot>> {
        super::pack(shapes, side, &Silent).unwrap()
    }
    use proptest::prelude::*;

    fn rectangle(width: u32, height: u32) -> Shape {
        Shape { width, height, spans: None }
    }

    /// A right triangle of side n: row r spans [0, r + 1).
    fn triangle(n: u32) -> Shape {
        let rows = (0..n).map(|r| vec![[0, r + 1]]).collect();
        let columns = (0..n).map(|c| vec![[c, n]]).collect();
        Shape { width: n, height: n, spans: Some(Spans { rows, columns }) }
    }

    fn texels(shape: &Shape, spot: &Spot) -> Vec<(u32, u32)> {
        let variant = shape.turned(spot.turn);
        let whole = vec![[0, variant.width]];
        let line = |r: u32| variant.rows.as_ref().map_or(whole.clone(), |rows| rows[r as usize].clone());
        let at = |r: u32, x: u32| (spot.x + x, spot.y + r);
        (0..variant.height)
            .flat_map(|r| line(r).into_iter().flat_map(move |[a, b]| (a..b).map(move |x| at(r, x))))
            .collect()
    }

    /// A square frame one texel wide.
    fn frame(n: u32) -> Shape {
        let line = |i: u32| if i == 0 || i == n - 1 { vec![[0, n]] } else { vec![[0, 1], [n - 1, n]] };
        let rows: Vec<Line> = (0..n).map(line).collect();
        Shape { width: n, height: n, spans: Some(Spans { columns: rows.clone(), rows }) }
    }

    #[test]
    fn a_hole_is_filled() {
        assert!(pack(&[frame(64), rectangle(62, 62)], 64).is_some());
        assert!(pack(&[frame(64), rectangle(62, 63)], 64).is_none());
    }

    #[test]
    fn sixteen_squares_fill_a_page() {
        assert!(pack(&vec![rectangle(16, 16); 16], 64).is_some());
        assert!(pack(&vec![rectangle(16, 16); 17], 64).is_none());
    }

    #[test]
    fn two_triangles_make_a_rectangle() {
        let spots = pack(&[triangle(32), triangle(31)], 33).expect("nested");
        assert_eq!(spots.len(), 2);
    }

    #[test]
    fn a_long_rectangle_is_turned() {
        for standing in [rectangle(4, 64), rectangle(64, 4)] {
            assert!(pack(&[rectangle(64, 60), standing.clone()], 64).is_some());
            assert!(pack(&[rectangle(60, 64), standing.clone()], 64).is_some());
            assert!(pack(&[rectangle(61, 64), standing], 64).is_none());
        }
    }

    #[test]
    fn turns_agree_between_rows_and_points() {
        let shape = Shape {
            width: 3,
            height: 2,
            spans: Some(Spans {
                rows: vec![vec![[0, 1], [2, 3]], vec![[0, 1]]],
                columns: vec![vec![[0, 2]], vec![], vec![[0, 1]]],
            }),
        };
        let cells = [(0, 0), (2, 0), (0, 1)];
        for turn in 0..4 {
            let mut expected: Vec<(u32, u32)> = cells
                .iter()
                .map(|&(x, y)| {
                    let (mut x, mut y, mut w, mut h) = (x, y, 3, 2);
                    for _ in 0..turn {
                        (x, y) = (h - 1 - y, x);
                        (w, h) = (h, w);
                    }
                    (x, y)
                })
                .collect();
            expected.sort_unstable();
            let mut got = texels(&shape, &Spot { x: 0, y: 0, turn });
            got.sort_unstable();
            assert_eq!(got, expected, "turn {turn}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn nothing_overlaps_and_nothing_sticks_out(
            sizes in prop::collection::vec((2_u32..24, 1_u32..24, 0_u32..3), 1..60),
            side in 100_u32..140,
        ) {
            let shapes: Vec<Shape> =
                sizes
                .iter()
                .map(|&(w, h, kind)| match kind {
                    0 => triangle(w),
                    1 => frame(w),
                    _ => rectangle(w, h),
                })
                .collect();
            if let Some(spots) = pack(&shapes, side) {
                let mut used = vec![false; (side * side) as usize];
                for (x, y) in shapes.iter().zip(&spots).flat_map(|(shape, spot)| texels(shape, spot)) {
                    prop_assert!(x < side && y < side);
                    prop_assert!(!std::mem::replace(&mut used[(y * side + x) as usize], true));
                }
            }
        }

        #[test]
        fn the_longest_run_is_found(words in prop::collection::vec(any::<u64>(), 1..4), mask in any::<u64>()) {
            let row: Vec<u64> = words.iter().map(|w| w | mask).collect();
            let bits: Vec<bool> = row.iter().flat_map(|w| (0..64).map(move |b| w >> b & 1 == 1)).collect();
            let naive = bits.split(|b| !b).map(<[bool]>::len).max().unwrap_or(0);
            prop_assert_eq!(longest_run(&row) as usize, naive);
        }
    }
}
