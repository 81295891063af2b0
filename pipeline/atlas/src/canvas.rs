//! A page while it is finished: which chart owns each texel, what it holds, and spreading values to neighbours.

use glam::{DVec3, Vec3};
use luxel_scene::{Cancelled, Progress, watched};
use rayon::prelude::*;

/// Texels that a thread looks at in one go.
const CHUNK: usize = 1 << 12;

/// Trust in a texel whose value was spread to it, against 1 for a whole computed one.
pub(crate) const SPREAD_TRUST: f32 = 0.05;

#[derive(Clone, Debug)]
pub(crate) struct Canvas {
    pub width: u32,
    pub height: u32,
    /// Chart plus one; 0 for nobody's texels.
    pub owner: Vec<u32>,
    pub value: Vec<Vec3>,
    /// How far the value may be trusted, 0 where there is none yet: the coverage of computed texels.
    pub trust: Vec<f32>,
}

impl Canvas {
    /// A page of these values, of which nobody owns and knows any yet.
    pub fn new(width: u32, height: u32, value: Vec<Vec3>) -> Self {
        let n = width as usize * height as usize;
        debug_assert_eq!(value.len(), n);
        Self { width, height, owner: vec![0; n], value, trust: vec![0.0; n] }
    }

    pub fn index(&self, x: u32, y: u32) -> usize {
        y as usize * self.width as usize + x as usize
    }

    pub fn is_known(&self, at: usize) -> bool {
        self.trust[at] > 0.0
    }

    /// The up to eight neighbours of a texel with their weights: 1 beside, ½ at the corner.
    fn neighbours(&self, at: usize) -> impl Iterator<Item = (usize, f64)> + use<> {
        let (w, h) = (self.width as usize, self.height as usize);
        let (x, y) = (at % w, at / w);
        (0..9).filter(|k| *k != 4).filter_map(move |k| {
            let (nx, ny) = ((x + k % 3).checked_sub(1)?, (y + k / 3).checked_sub(1)?);
            let weight = if k % 2 == 1 { 1.0 } else { 0.5 };
            (nx < w && ny < h).then_some((ny * w + nx, weight))
        })
    }

    /// Gives values to unknown texels of the candidates' charts from known neighbours of the same chart, ring by ring,
    /// as far as they are connected.
    pub fn fill(&mut self, mut candidates: Vec<usize>, progress: &dyn Progress) -> Result<(), Cancelled> {
        let may = |owner: u32, near: u32| owner == near;
        loop {
            candidates.sort_unstable();
            candidates.dedup();
            let ring = self.ring(&candidates, &may, progress)?;
            if ring.is_empty() {
                return Ok(());
            }
            self.take(&ring);
            candidates.clear();
            for item in watched(&ring, progress) {
                let &(at, owner, _) = item?;
                let open = |n: &usize| !self.is_known(*n) && may(self.owner[*n], owner);
                candidates.extend(self.neighbours(at).map(|n| n.0).filter(open));
            }
        }
    }

    /// Grows all charts by so many rings into nobody's texels; the new texels are owned by the chart that they
    /// continue. Returns them.
    pub fn dilate(&mut self, rings: u32, progress: &dyn Progress) -> Result<Vec<usize>, Cancelled> {
        let mut grown = Vec::new();
        for _ in 0..rings {
            let rim = self.rim(progress)?;
            let ring = self.ring(&rim, &|owner, _| owner == 0, progress)?;
            self.take(&ring);
            grown.extend(ring.iter().map(|(at, ..)| *at));
        }
        Ok(grown)
    }

    /// Nobody's texels with a known neighbour, in rising order.
    fn rim(&self, progress: &dyn Progress) -> Result<Vec<usize>, Cancelled> {
        let is_rim = |at: &usize| self.owner[*at] == 0 && self.neighbours(*at).any(|(n, _)| self.is_known(n));
        let width = self.width as usize;
        let rows = (0..self.height as usize).into_par_iter().map(|y| {
            progress.check()?;
            Ok((y * width..(y + 1) * width).filter(is_rim).collect::<Vec<usize>>())
        });
        Ok(rows.collect::<Result<Vec<_>, Cancelled>>()?.concat())
    }

    /// Those of some texels that can take a value, with what they take.
    fn ring(
        &self,
        candidates: &[usize],
        may: &(impl Fn(u32, u32) -> bool + Sync),
        progress: &dyn Progress,
    ) -> Result<Vec<(usize, u32, Vec3)>, Cancelled> {
        let continued = |at: &usize| self.continued(*at, may).map(|(owner, value)| (*at, owner, value));
        let parts = candidates.par_chunks(CHUNK).map(|part| {
            progress.check()?;
            Ok(part.iter().filter_map(continued).collect::<Vec<_>>())
        });
        Ok(parts.collect::<Result<Vec<_>, Cancelled>>()?.concat())
    }

    fn take(&mut self, ring: &[(usize, u32, Vec3)]) {
        for &(at, owner, value) in ring {
            (self.owner[at], self.value[at], self.trust[at]) = (owner, value, SPREAD_TRUST);
        }
    }

    /// Owner and value that an unknown texel would take: of the lowest chart around it, the mean of the texels beside it,
    /// or where there are none of those at its corners. A texel beside the border is continued straight on: across a
    /// corner may lie the far side of a wall, with light of its own.
    fn continued(&self, at: usize, may: &(impl Fn(u32, u32) -> bool + Sync)) -> Option<(u32, Vec3)> {
        if self.is_known(at) {
            return None;
        }
        let near = |n: &(usize, f64)| self.is_known(n.0) && may(self.owner[at], self.owner[n.0]);
        let owner = self.neighbours(at).filter(near).map(|(n, _)| self.owner[n]).min()?;
        let own = || self.neighbours(at).filter(near).filter(|(n, _)| self.owner[*n] == owner);
        let most = own().map(|(_, weight)| weight).fold(0.0, f64::max);
        let (mut sum, mut total) = (DVec3::ZERO, 0.0);
        for (n, weight) in own().filter(|(_, weight)| *weight == most) {
            sum += weight * self.value[n].as_dvec3();
            total += weight;
        }
        Some((owner, (sum / total).as_vec3()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::Silent;

    #[test]
    fn dilation_keeps_constants_and_stops_at_the_ring() {
        let mut canvas = Canvas::new(9, 9, vec![Vec3::ZERO; 81]);
        let at = canvas.index(4, 4);
        (canvas.owner[at], canvas.value[at], canvas.trust[at]) = (7, Vec3::splat(0.1), 1.0);
        let grown = canvas.dilate(2, &Silent).unwrap();
        assert_eq!(grown.len(), 24);
        assert!(grown.iter().all(|&n| canvas.value[n] == Vec3::splat(0.1) && canvas.owner[n] == 7));
        assert_eq!(canvas.owner.iter().filter(|&&o| o == 0).count(), 81 - 25);
    }

    #[test]
    fn a_border_is_continued_straight_on() {
        // A row of texels, bright on the left: what lies under the dark ones takes nothing across the corner.
        let mut canvas = Canvas::new(4, 2, vec![Vec3::ZERO; 8]);
        for x in 0..4 {
            (canvas.owner[x], canvas.trust[x]) = (1, 1.0);
            canvas.value[x] = Vec3::splat(if x < 2 { 9.0 } else { 1.0 });
        }
        canvas.dilate(1, &Silent).unwrap();
        assert_eq!(canvas.value[4..], canvas.value[..4]);
    }

    #[test]
    fn filling_stays_within_the_chart() {
        let mut canvas = Canvas::new(4, 1, vec![Vec3::ZERO; 4]);
        canvas.owner = vec![1, 1, 2, 2];
        canvas.value = vec![Vec3::ONE, Vec3::ZERO, Vec3::ZERO, Vec3::splat(5.0)];
        canvas.trust = vec![1.0, 0.0, 0.0, 1.0];
        canvas.fill(vec![1, 2], &Silent).unwrap();
        assert_eq!(canvas.value, [Vec3::ONE, Vec3::ONE, Vec3::splat(5.0), Vec3::splat(5.0)]);
    }
}
