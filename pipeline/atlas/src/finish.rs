//! Values per texel to images: buried texels filled, padding dilated, seams stitched.
//!
//! Buried (invalid) texels take the mean of valid neighbours of their own chart, ring by ring; padding continues its
//! chart alike; stitching then moves texels near chart borders so that both sides of a seam read the same.
//! Nothing is ever mixed across charts but along a seam of a continuous surface.

use glam::Vec3;
use luxel_scene::Scene;

use crate::canvas::Canvas;
use crate::{Atlas, seams};

/// One finished page.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    pub page: u32,
    pub width: u32,
    pub height: u32,
    /// Row-major from the top: linear RGB in the unit of the values, and coverage in [0, 1].
    pub pixels: Vec<[f32; 4]>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct FinishSettings {
    /// Rings of padding to fill: the padding that the atlas was packed with.
    pub padding: u32,
    /// Stitch seams of continuous surfaces.
    pub stitch: bool,
}

impl Default for FinishSettings {
    fn default() -> Self {
        Self { padding: 2, stitch: true }
    }
}

/// What finishing did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FinishReport {
    /// Invalid texels that took their neighbours' values.
    pub filled: u32,
    /// Invalid texels on charts without any valid one: left black.
    pub lost: u32,
    /// Points along seams at which both sides were compared.
    pub seam_samples: u32,
    /// Root mean square difference of the two sides there, over the three bands, before and after.
    pub jump_before: f64,
    pub jump_after: f64,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FinishError {
    #[error("{values} values and {valid} flags for {texels} texels")]
    Count { values: usize, valid: usize, texels: usize },
    #[error("the value of texel {texel} is negative or not finite")]
    Value { texel: usize },
    #[error("the atlas does not fit together: texel {texel} lies outside its page")]
    Atlas { texel: usize },
}

/// Makes one image per page from values per texel; `valid` is false where a texel lies inside other geometry.
///
/// # Errors
/// Lengths that do not match the atlas, and valid values that are negative or not finite.
pub fn finish(
    scene: &Scene,
    atlas: &Atlas,
    values: &[Vec3],
    valid: &[bool],
    settings: &FinishSettings,
) -> Result<(Vec<Image>, FinishReport), FinishError> {
    let texels = atlas.texels.len();
    if values.len() != texels || valid.len() != texels {
        return Err(FinishError::Count { values: values.len(), valid: valid.len(), texels });
    }
    let mut report = FinishReport::default();
    let mut canvases = scattered(atlas, values, valid)?;
    fill(atlas, valid, &mut canvases, &mut report);
    let padding: Vec<Vec<usize>> = canvases.iter_mut().map(|canvas| canvas.dilate(settings.padding)).collect();
    if settings.stitch {
        let touched = seams::stitch(scene, atlas, &mut canvases, &mut report);
        dilate_again(&mut canvases, &padding, &touched, settings.padding);
    }
    let images = canvases.iter().zip(0..).map(|(canvas, page)| image(canvas, page));
    let mut images: Vec<Image> = images.collect();
    for texel in &atlas.texels {
        let image = &mut images[usize::from(texel.page)];
        image.pixels[usize::from(texel.y) * image.width as usize + usize::from(texel.x)][3] = texel.coverage;
    }
    Ok((images, report))
}

fn scattered(atlas: &Atlas, values: &[Vec3], valid: &[bool]) -> Result<Vec<Canvas>, FinishError> {
    let mut canvases: Vec<Canvas> = atlas.pages.iter().map(|p| Canvas::new(p.width, p.height)).collect();
    for (number, ((texel, value), valid)) in atlas.texels.iter().zip(values).zip(valid).enumerate() {
        let canvas = canvases.get_mut(usize::from(texel.page)).ok_or(FinishError::Atlas { texel: number })?;
        if u32::from(texel.x) >= canvas.width || u32::from(texel.y) >= canvas.height {
            return Err(FinishError::Atlas { texel: number });
        }
        let at = canvas.index(texel.x.into(), texel.y.into());
        canvas.owner[at] = texel.chart + 1;
        if *valid {
            if !value.is_finite() || value.min_element() < 0.0 {
                return Err(FinishError::Value { texel: number });
            }
            canvas.value[at] = *value;
            canvas.trust[at] = texel.coverage.max(0.01);
        }
    }
    Ok(canvases)
}

fn fill(atlas: &Atlas, valid: &[bool], canvases: &mut [Canvas], report: &mut FinishReport) {
    let mut buried: Vec<Vec<usize>> = vec![Vec::new(); canvases.len()];
    for (texel, _) in atlas.texels.iter().zip(valid).filter(|(_, valid)| !**valid) {
        let page = usize::from(texel.page);
        buried[page].push(canvases[page].index(texel.x.into(), texel.y.into()));
    }
    for (canvas, buried) in canvases.iter_mut().zip(buried) {
        canvas.fill(buried.clone());
        let known = buried.iter().filter(|&&at| canvas.is_known(at)).count();
        report.filled += known as u32;
        report.lost += (buried.len() - known) as u32;
    }
}

/// Stitching changed the texels at chart borders; padding that it did not set itself follows them.
fn dilate_again(canvases: &mut [Canvas], padding: &[Vec<usize>], touched: &[Vec<usize>], rings: u32) {
    for ((canvas, padding), touched) in canvases.iter_mut().zip(padding).zip(touched) {
        if touched.is_empty() {
            continue;
        }
        for &at in padding.iter().filter(|at| touched.binary_search(at).is_err()) {
            (canvas.owner[at], canvas.trust[at]) = (0, 0.0);
        }
        canvas.dilate(rings);
    }
}

fn image(canvas: &Canvas, page: u32) -> Image {
    let pixel = |at: usize| {
        let v = if canvas.is_known(at) { canvas.value[at] } else { Vec3::ZERO };
        [v.x, v.y, v.z, 0.0]
    };
    let pixels = (0..canvas.value.len()).map(pixel).collect();
    Image { page, width: canvas.width, height: canvas.height, pixels }
}
