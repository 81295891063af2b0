//! Least-squares stitching of chart borders.
//!
//! Where two triangles of one mesh share an edge, meet smoothly and still lie apart on the page, a bilinear texture
//! reads two different values on the two sides of the edge, and the eye sees a line. With x the texels that such
//! edges read, x₀ their values, S one row per sample point (bilinear weights of the one side minus those of the
//! other) and T the trust in each texel, this minimises
//!
//!   Σ Tᵢ (xᵢ − x₀ᵢ)² + λ |S x|²
//!
//! by conjugate gradients on (T + λ SᵀS) δ = −λ SᵀS x₀, for the three bands at once, in f64 and in a fixed order. Padding
//! texels have little trust and carry most of the change. At last every texel is held within the range of the
//! values that meet in its own rows: stitching can neither overshoot nor go negative, and constants stay as
//! they are to the last bit. (After Iwanicki, "Lighting technology of The Last of Us", 2013.)

use glam::{DVec2, DVec3};
use luxel_scene::{Cancelled, Mesh, Progress, Scene};
use rayon::prelude::*;

use crate::canvas::Canvas;
use crate::finish::FinishReport;
use crate::mesh::{Joint, Solid};
use crate::{Atlas, Placed};

/// cos 20°: faces (or vertex normals) that differ by more are a real edge in the light.
const CONTINUOUS: f64 = 0.939_692_621;
/// λ: weight of a seam sample against a fully trusted texel.
const SEAM_WEIGHT: f64 = 8.0;
const ITERATIONS: usize = 96;
/// Residual, relative to the first one, at which nothing is left to do.
const DONE: f64 = 1e-16;
/// Sample points per texel of a seam, and at most so many along one edge.
const SAMPLES_PER_TEXEL: f64 = 2.0;
const MOST_SAMPLES: f64 = 32768.0;
/// Joints between two looks at the progress.
const LOOK: usize = 16;

/// A difference of two bilinear reads: texels of one page with signed weights.
struct Row {
    page: u32,
    cells: [(u32, f64); 8],
}

/// Stitches all pages; returns the texels that took part, ascending, per page.
pub(crate) fn stitch(
    scene: &Scene,
    atlas: &Atlas,
    canvases: &mut [Canvas],
    report: &mut FinishReport,
    progress: &dyn Progress,
) -> Result<Vec<Vec<usize>>, Cancelled> {
    let mut rows = rows(scene, atlas, canvases, progress)?;
    report.seam_samples = rows.len() as u32;
    let mut touched = vec![Vec::new(); canvases.len()];
    let (mut before, mut after) = (0.0, 0.0);
    for (page, canvas) in canvases.iter_mut().enumerate() {
        progress.check()?;
        let system = System::new(canvas, rows.extract_if(.., |row| row.page as usize == page).collect());
        let start: Vec<DVec3> = system.texels.iter().map(|&at| canvas.value[at].as_dvec3()).collect();
        before += system.jumps(&start);
        let end = system.solved(&start, progress)?;
        for (&at, value) in system.texels.iter().zip(&end) {
            canvas.value[at] = value.as_vec3();
        }
        after += system.jumps(&end);
        touched[page] = system.texels;
    }
    let count = f64::from(3 * report.seam_samples.max(1));
    report.jump_before = (before / count).sqrt();
    report.jump_after = (after / count).sqrt();
    Ok(touched)
}

fn rows(scene: &Scene, atlas: &Atlas, canvases: &[Canvas], progress: &dyn Progress) -> Result<Vec<Row>, Cancelled> {
    let mut used = vec![false; scene.meshes.len()];
    for (instance, placed) in scene.instances.iter().zip(&atlas.placed) {
        used[instance.mesh] |= placed.is_some();
    }
    let of_mesh = |(mesh, used): (&Mesh, &bool)| {
        progress.check()?;
        Ok(if *used { continuous(&Solid::new(mesh)) } else { Vec::new() })
    };
    let joints = scene.meshes.par_iter().zip(&used).map(of_mesh).collect::<Result<Vec<Vec<Joint>>, Cancelled>>()?;
    let of_instance = |(instance, placed): (&luxel_scene::Instance, &Option<Placed>)| {
        let mut rows = Vec::new();
        let Some(placed) = placed else { return Ok(rows) };
        let Some(canvas) = canvases.get(placed.page as usize) else { return Ok(rows) };
        for (i, joint) in joints[instance.mesh].iter().enumerate() {
            // A joint may be as long as its page.
            if i.is_multiple_of(LOOK) {
                progress.check()?;
            }
            rows.extend(along(joint, placed, canvas));
        }
        Ok(rows)
    };
    let parts = scene.instances.par_iter().zip(&atlas.placed).map(of_instance);
    let parts = parts.collect::<Result<Vec<Vec<Row>>, Cancelled>>()?;
    progress.check()?;
    Ok(parts.into_iter().flatten().collect())
}

/// The joints over which light is continuous: shading normals agree, or faces where there are none.
fn continuous(solid: &Solid) -> Vec<Joint> {
    let smooth = |j: &Joint| solid.shading_bend(j).unwrap_or_else(|| solid.bend(j)) >= CONTINUOUS;
    solid.joints().into_iter().filter(|j| solid.bend(j) > 0.0 && smooth(j)).collect()
}

/// The rows of one shared edge; none where both sides lie together on the page.
fn along(joint: &Joint, placed: &Placed, canvas: &Canvas) -> Vec<Row> {
    let size = DVec2::new(canvas.width.into(), canvas.height.into());
    let [s, t] = joint.triangles.map(|t| placed.triangles[t as usize]);
    let [i, j] = joint.starts;
    let at = |vertex: u32| placed.uvs[vertex as usize].as_dvec2() * size;
    let (a, b) = ([at(s[i]), at(s[(i + 1) % 3])], [at(t[(j + 1) % 3]), at(t[j])]);
    if a[0].distance(b[0]).max(a[1].distance(b[1])) < 1e-3 {
        return Vec::new();
    }
    let length = a[0].distance(a[1]).max(b[0].distance(b[1]));
    let count = (length * SAMPLES_PER_TEXEL).ceil().clamp(1.0, MOST_SAMPLES);
    let sample = |k: u32| {
        let f = (f64::from(k) + 0.5) / count;
        let (one, other) = (bilinear(canvas, a[0].lerp(a[1], f))?, bilinear(canvas, b[0].lerp(b[1], f))?);
        let mut cells = [(0, 0.0); 8];
        for k in 0..4 {
            cells[k] = one[k];
            cells[4 + k] = (other[k].0, -other[k].1);
        }
        Some(Row { page: placed.page, cells })
    };
    (0..count as u32).filter_map(sample).collect()
}

/// The four texels that a bilinear read takes, with their weights. None where they are not all known and of one
/// chart.
fn bilinear(canvas: &Canvas, p: DVec2) -> Option<[(u32, f64); 4]> {
    let p = p - 0.5;
    let (base, f) = (p.floor(), p - p.floor());
    let (mut owner, mut total) = (0, 0.0);
    let mut cells = [(u32::MAX, 0.0); 4];
    for (k, cell) in cells.iter_mut().enumerate() {
        let (dx, dy) = ((k % 2) as f64, (k / 2) as f64);
        let weight = (if k % 2 == 1 { f.x } else { 1.0 - f.x }) * (if k / 2 == 1 { f.y } else { 1.0 - f.y });
        let q = base + DVec2::new(dx, dy);
        // A texel that is hardly read does not count; it repeats one that does, with weight zero.
        if weight < 1e-4 {
            continue;
        }
        if q.min_element() < 0.0 || q.x >= f64::from(canvas.width) || q.y >= f64::from(canvas.height) {
            return None;
        }
        let at = canvas.index(q.x as u32, q.y as u32);
        if !canvas.is_known(at) || (owner != 0 && owner != canvas.owner[at]) {
            return None;
        }
        owner = canvas.owner[at];
        *cell = (at as u32, weight);
        total += weight;
    }
    let some = cells.iter().find(|c| c.0 != u32::MAX)?.0;
    cells.iter_mut().filter(|c| c.0 == u32::MAX).for_each(|c| c.0 = some);
    cells.iter_mut().for_each(|c| c.1 /= total);
    Some(cells)
}

/// The equations of one page over the texels that its seams read.
struct System {
    /// Texels that take part, ascending: the unknowns.
    texels: Vec<usize>,
    trust: Vec<f64>,
    rows: Vec<[(u32, f64); 8]>,
}

impl System {
    fn new(canvas: &Canvas, rows: Vec<Row>) -> Self {
        let mut read: Vec<u32> = rows.iter().flat_map(|row| row.cells.map(|cell| cell.0)).collect();
        read.sort_unstable();
        read.dedup();
        let number = |at: u32| read.partition_point(|other| *other < at) as u32;
        let rows = rows.into_iter().map(|row| row.cells.map(|(at, w)| (number(at), w))).collect();
        let texels: Vec<usize> = read.iter().map(|&at| at as usize).collect();
        let trust = texels.iter().map(|&at| f64::from(canvas.trust[at])).collect();
        Self { texels, trust, rows }
    }

    fn apply(row: &[(u32, f64); 8], x: &[DVec3]) -> DVec3 {
        row.iter().map(|&(i, w)| w * x[i as usize]).sum()
    }

    /// |S x|² over all bands.
    fn jumps(&self, x: &[DVec3]) -> f64 {
        self.rows.iter().map(|row| Self::apply(row, x).length_squared()).sum()
    }

    /// λ SᵀS x
    fn pulled(&self, x: &[DVec3]) -> Vec<DVec3> {
        let mut out = vec![DVec3::ZERO; x.len()];
        for row in &self.rows {
            let jump = SEAM_WEIGHT * Self::apply(row, x);
            row.iter().for_each(|&(i, w)| out[i as usize] += w * jump);
        }
        out
    }

    fn solved(&self, start: &[DVec3], progress: &dyn Progress) -> Result<Vec<DVec3>, Cancelled> {
        let change = self.change(start, progress)?;
        let (mut lo, mut hi) = (start.to_vec(), start.to_vec());
        for row in &self.rows {
            let values = || row.iter().filter(|cell| cell.1 != 0.0).map(|cell| start[cell.0 as usize]);
            let (least, most) = (values().fold(DVec3::INFINITY, DVec3::min), values().fold(DVec3::ZERO, DVec3::max));
            for &(i, _) in row {
                lo[i as usize] = lo[i as usize].min(least);
                hi[i as usize] = hi[i as usize].max(most);
            }
        }
        Ok((0..start.len()).map(|i| (start[i] + change[i]).clamp(lo[i], hi[i])).collect())
    }

    /// Conjugate gradients with the diagonal as preconditioner; the bands have their own step lengths.
    fn change(&self, start: &[DVec3], progress: &dyn Progress) -> Result<Vec<DVec3>, Cancelled> {
        let mut diagonal = self.trust.clone();
        for &(i, w) in self.rows.iter().flatten() {
            diagonal[i as usize] += SEAM_WEIGHT * w * w;
        }
        let mut x = vec![DVec3::ZERO; start.len()];
        let mut r: Vec<DVec3> = self.pulled(start).into_iter().map(|p| -p).collect();
        let scaled = |r: &[DVec3]| -> Vec<DVec3> { r.iter().zip(&diagonal).map(|(r, d)| *r / *d).collect() };
        let dot = |a: &[DVec3], b: &[DVec3]| -> DVec3 { a.iter().zip(b).map(|(a, b)| *a * *b).sum() };
        let mut z = scaled(&r);
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        let enough = rz * DONE;
        for _ in 0..ITERATIONS {
            progress.check()?;
            if rz.cmple(enough).all() {
                break;
            }
            let mut ap = self.pulled(&p);
            ap.iter_mut().zip(&p).zip(&self.trust).for_each(|((ap, p), t)| *ap += *t * *p);
            let alpha = ratio(rz, dot(&p, &ap));
            for i in 0..x.len() {
                x[i] += alpha * p[i];
                r[i] -= alpha * ap[i];
            }
            z = scaled(&r);
            let next = dot(&r, &z);
            let beta = ratio(next, rz);
            rz = next;
            p.iter_mut().zip(&z).for_each(|(p, z)| *p = *z + beta * *p);
        }
        Ok(x)
    }
}

/// Band-wise quotient; a band that is at rest stays there.
fn ratio(a: DVec3, b: DVec3) -> DVec3 {
    let one = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
    DVec3::new(one(a.x, b.x), one(a.y, b.y), one(a.z, b.z))
}
