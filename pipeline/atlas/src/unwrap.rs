//! Meshes to charts: which triangles lie together in one plane patch, and where in it.
//!
//! A mesh is cut at its hard edges into smooth parts (`segment`). Flat and gently curved parts are simply
//! projected onto their mean plane: exact, quick, and a wall stays a rectangle. Only truly curved parts go to an
//! [`Unwrapper`], normalised to unit size and in batches. Every chart that comes back is checked (finite,
//! not flipped, no overlap, not starved); what fails is projected in groups of similar normals, or, at the
//! last, triangle by triangle, and the report says so.

use luxel_scene::{Cancelled, Mesh, Progress};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::charts::{Charts, Corners};
use crate::mesh::Solid;
use crate::{AtlasError, planar, segment, shape};

/// A smooth, connected, curved part of a mesh, scaled to a fixed size, vertices welded.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Piece {
    pub positions: Vec<[f32; 3]>,
    /// One per position, or empty.
    pub normals: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

/// What an unwrapper made of a piece, triangle by triangle.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PieceCharts {
    /// Chart of each triangle; `u32::MAX` where it has none.
    pub chart_of: Vec<u32>,
    /// UV of each triangle's corners, in any unit.
    pub uvs: Vec<[[f32; 2]; 3]>,
}

/// One answer per piece: its charts, or why there are none.
pub type Answers = Vec<Result<PieceCharts, String>>;

/// The unwrapper as a whole cannot work (a worker that does not start, say).
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct UnwrapError(pub String);

/// Something that flattens curved pieces.
pub trait Unwrapper: Sync {
    /// Unwraps each piece for itself; a piece's answer depends on the piece alone.
    ///
    /// # Errors
    /// Only when the unwrapper itself does not work. A piece that it cannot flatten is an `Err` in its answer.
    fn unwrap(&self, pieces: &[Piece]) -> Result<Answers, UnwrapError>;

    /// [`Unwrapper::unwrap`] of pieces that may not be wanted to the end. It may then come to an early one, with
    /// whatever result: nobody looks at it.
    ///
    /// # Errors
    /// As [`Unwrapper::unwrap`].
    fn unwrap_while(&self, pieces: &[Piece], _: &dyn Progress) -> Result<Answers, UnwrapError> {
        self.unwrap(pieces)
    }
}

/// xatlas in this process: no protection from its aborts and hangs.
#[derive(Clone, Copy, Debug, Default)]
pub struct InProcess;

impl Unwrapper for InProcess {
    fn unwrap(&self, pieces: &[Piece]) -> Result<Answers, UnwrapError> {
        Ok(crate::xatlas::unwrap(pieces))
    }
}

impl Piece {
    /// Consistent lengths, indices in range, coordinates finite and of about unit size.
    pub(crate) fn check(&self) -> Result<(), String> {
        let finite = |v: &[f32; 3]| v.iter().all(|c| c.is_finite() && c.abs() <= 16.0);
        if self.triangles.is_empty() || self.triangles.len() > u32::MAX as usize / 3 {
            return Err("the piece has no triangles, or too many".into());
        }
        if !self.normals.is_empty() && self.normals.len() != self.positions.len() {
            return Err("the piece has normals for some vertices only".into());
        }
        if !self.positions.iter().chain(&self.normals).all(finite) {
            return Err("the piece has coordinates that are not of unit size".into());
        }
        if self.triangles.iter().flatten().any(|&i| i as usize >= self.positions.len()) {
            return Err("the piece has an index out of range".into());
        }
        Ok(())
    }
}

/// At most so many triangles go to the unwrapper in one piece: chart growing takes more than linear time. On the
/// Sponza atrium (66k triangles) pieces of 1024 gave 4703 charts, unwrapped, packed and finished in 5.0 s of CPU; pieces
/// of 8192 gave 4876 in 9.9 s.
const PIECE_LIMIT: usize = 1024;
/// Longest side of a piece. xatlas drops triangles of less than 1.2e-7 square units, so not too small.
const PIECE_SIZE: f64 = 8.0;
/// A batch is one round trip to a worker. Nothing interrupts xatlas but the end of its process, so within the bake's own
/// a batch goes on to its end: a thousand triangles take about 80 ms.
const BATCH_TRIANGLES: usize = 1024;
const BATCH_PIECES: usize = 64;

/// Unwraps meshes, each for itself: the charts of a mesh depend on its content alone.
///
/// # Errors
/// When the unwrapper cannot work at all, or when the work was cancelled.
pub fn unwrap_meshes(
    meshes: &[&Mesh],
    unwrapper: &dyn Unwrapper,
    progress: &dyn Progress,
) -> Result<Vec<Charts>, AtlasError> {
    progress.begin("unwrap", meshes.iter().map(|m| m.triangles.len() as u64).sum());
    let solids = meshes.par_iter().map(|mesh| {
        progress.check()?;
        Ok(Solid::new(mesh))
    });
    let solids = solids.collect::<Result<Vec<Solid>, Cancelled>>()?;
    let drafts = solids.par_iter().map(|solid| Draft::new(solid, progress));
    let mut drafts = drafts.collect::<Result<Vec<Draft>, Cancelled>>()?;
    let jobs: Vec<(usize, usize)> =
        drafts.iter().enumerate().flat_map(|(m, d)| (0..d.pieces.len()).map(move |p| (m, p))).collect();
    let batches = batched(&jobs, |&(m, p)| drafts[m].pieces[p].piece.triangles.len());
    let answers: Vec<Answers> = batches
        .par_iter()
        .map(|batch| {
            progress.check()?;
            let pieces: Vec<Piece> = batch.iter().map(|&(m, p)| drafts[m].pieces[p].piece.clone()).collect();
            let answers = unwrapper.unwrap_while(&pieces, progress);
            // What was cancelled is not at fault.
            progress.check()?;
            let answers = answers?;
            if answers.len() != pieces.len() {
                return Err(UnwrapError("the unwrapper lost a piece".into()).into());
            }
            progress.advance(pieces.iter().map(|p| p.triangles.len() as u64).sum());
            Ok(answers)
        })
        .collect::<Result<_, AtlasError>>()?;
    for (&(mesh, piece), answer) in jobs.iter().zip(answers.into_iter().flatten()) {
        progress.check()?;
        drafts[mesh].accept(&solids[mesh], piece, answer);
    }
    let charts = drafts.into_par_iter().zip(&solids).map(|(draft, solid)| {
        progress.check()?;
        Ok(draft.finish(solid))
    });
    charts.collect()
}

fn batched<T: Copy>(jobs: &[T], weight: impl Fn(&T) -> usize) -> Vec<Vec<T>> {
    let mut batches: Vec<Vec<T>> = Vec::new();
    let mut load = usize::MAX;
    for job in jobs {
        let weight = weight(job);
        match batches.last_mut() {
            Some(batch) if batch.len() < BATCH_PIECES && load.saturating_add(weight) <= BATCH_TRIANGLES => {
                batch.push(*job);
                load += weight;
            }
            _ => {
                batches.push(vec![*job]);
                load = weight;
            }
        }
    }
    batches
}

/// A piece and the triangles of the mesh that it holds.
struct Pending {
    piece: Piece,
    triangles: Vec<u32>,
}

/// The unwrap of one mesh, while it grows.
struct Draft {
    corners: Corners,
    pieces: Vec<Pending>,
    /// Triangles that nobody could unwrap.
    fallen: Vec<u32>,
}

impl Draft {
    fn new(solid: &Solid, progress: &dyn Progress) -> Result<Self, Cancelled> {
        let mut draft =
            Draft { corners: Corners::new(solid.mesh.triangles.len()), pieces: Vec::new(), fallen: Vec::new() };
        progress.check()?;
        for part in segment::smooth_parts(solid) {
            progress.check()?;
            if let Some(uvs) = planar::project_if_gentle(solid, &part) {
                draft.corners.add_chart(&part, &uvs);
                continue;
            }
            for part in segment::chopped(solid, part, PIECE_LIMIT) {
                progress.check()?;
                draft.pieces.push(Pending { piece: piece_of(solid, &part), triangles: part });
            }
        }
        Ok(draft)
    }

    /// Takes an unwrapper's answer, chart by chart; refused charts are projected.
    fn accept(&mut self, solid: &Solid, piece: usize, answer: Result<PieceCharts, String>) {
        let triangles = std::mem::take(&mut self.pieces[piece].triangles);
        self.pieces[piece].piece = Piece::default();
        let charts = match answer {
            Ok(charts) if charts.chart_of.len() == triangles.len() && charts.uvs.len() == triangles.len() => charts,
            Ok(_) => return self.fall_back(&triangles, "the unwrapper lost triangles"),
            Err(why) => return self.fall_back(&triangles, &why),
        };
        let mut order: Vec<usize> = (0..triangles.len()).collect();
        order.sort_by_key(|&t| charts.chart_of[t]);
        for chart in order.chunk_by(|&a, &b| charts.chart_of[a] == charts.chart_of[b]) {
            let members: Vec<u32> = chart.iter().map(|&t| triangles[t]).collect();
            let uvs: Vec<_> =
                chart.iter().map(|&t| charts.uvs[t].map(|[u, v]| glam::DVec2::new(u.into(), v.into()))).collect();
            if charts.chart_of[chart[0]] == u32::MAX {
                self.fall_back(&members, "the unwrapper left triangles out");
                continue;
            }
            match shape::checked(solid, &members, uvs) {
                Ok(uvs) => self.corners.add_chart(&members, &uvs),
                Err(why) => self.fall_back(&members, why),
            }
        }
    }

    fn fall_back(&mut self, triangles: &[u32], why: &str) {
        self.corners.fallback(triangles.len(), why);
        self.fallen.extend(triangles);
    }

    fn finish(mut self, solid: &Solid) -> Charts {
        if !self.fallen.is_empty() {
            self.fallen.sort_unstable();
            for (group, uvs) in planar::groups(solid, &self.fallen) {
                self.corners.add_chart(&group, &uvs);
            }
        }
        self.corners.finish(solid)
    }
}

/// The part as a piece of its own: welded vertices, fixed size, centred at the origin.
fn piece_of(solid: &Solid, part: &[u32]) -> Piece {
    let (lo, hi) = solid.bounds(part);
    let scale = PIECE_SIZE / (hi - lo).max_element();
    let centre = 0.5 * (lo + hi);
    // A vertex of the piece for each pair of place and normal: xatlas sees by itself which lie together.
    let mut keys: Vec<u32> = part.iter().flat_map(|&t| solid.mesh.triangles[t as usize]).collect();
    let key_of = |v: u32| (solid.weld[v as usize], solid.normal_bits(v));
    keys.sort_by_key(|&v| (key_of(v), v));
    keys.dedup_by_key(|v| key_of(*v));
    let number = |v: u32| keys.partition_point(|&k| key_of(k) < key_of(v)) as u32;
    Piece {
        positions: keys.iter().map(|&v| ((solid.position(v) - centre) * scale).as_vec3().to_array()).collect(),
        normals: if solid.has_normals() {
            keys.iter().map(|&v| solid.normal(v).as_vec3().to_array()).collect()
        } else {
            Vec::new()
        },
        triangles: part.iter().map(|&t| solid.mesh.triangles[t as usize].map(number)).collect(),
    }
}
