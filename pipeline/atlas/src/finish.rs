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
    /// Row-major from the top: linear RGB in the unit of the values.
    pub values: Vec<Vec3>,
    /// In the same order: the share of each texel that its chart covers, 0 in the padding.
    pub coverage: Vec<f32>,
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
    #[error("the value of texel {texel} is negative or not finite")]
    Value { texel: usize },
    #[error("the atlas does not fit together: texel {texel} lies outside its page")]
    Atlas { texel: usize },
}

/// Makes one image per page from the value of each texel, by its index; none where it lies inside other geometry.
///
/// # Errors
/// Values that are negative or not finite, and an atlas whose texels lie outside their pages.
pub fn finish(
    scene: &Scene,
    atlas: &Atlas,
    value: impl Fn(usize) -> Option<Vec3>,
    settings: &FinishSettings,
) -> Result<(Vec<Image>, FinishReport), FinishError> {
    let mut report = FinishReport::default();
    let (mut canvases, buried) = scattered(atlas, value)?;
    fill(&mut canvases, buried, &mut report);
    let padding: Vec<Vec<usize>> = canvases.iter_mut().map(|canvas| canvas.dilate(settings.padding)).collect();
    if settings.stitch {
        let touched = seams::stitch(scene, atlas, &mut canvases, &mut report);
        dilate_again(&mut canvases, &padding, &touched, settings.padding);
    }
    let images = canvases.into_iter().zip(0..).map(|(canvas, page)| image(canvas, page));
    let mut images: Vec<Image> = images.collect();
    for texel in &atlas.texels {
        let image = &mut images[atlas.chart(texel).page as usize];
        image.coverage[usize::from(texel.y) * image.width as usize + usize::from(texel.x)] = texel.coverage();
    }
    Ok((images, report))
}

/// Pages with the values at their places, and the texels of each page that have none.
fn scattered(
    atlas: &Atlas,
    value: impl Fn(usize) -> Option<Vec3>,
) -> Result<(Vec<Canvas>, Vec<Vec<usize>>), FinishError> {
    let mut canvases: Vec<Canvas> = atlas.pages.iter().map(|p| Canvas::new(p.width, p.height)).collect();
    let mut buried = vec![Vec::new(); canvases.len()];
    for (number, texel) in atlas.texels.iter().enumerate() {
        let page = atlas.charts.get(texel.chart as usize).map(|chart| chart.page as usize);
        let page = page.filter(|page| *page < canvases.len()).ok_or(FinishError::Atlas { texel: number })?;
        let canvas = &mut canvases[page];
        if u32::from(texel.x) >= canvas.width || u32::from(texel.y) >= canvas.height {
            return Err(FinishError::Atlas { texel: number });
        }
        let at = canvas.index(texel.x.into(), texel.y.into());
        canvas.owner[at] = texel.chart + 1;
        match value(number) {
            Some(value) if value.is_finite() && value.min_element() >= 0.0 => {
                canvas.value[at] = value;
                canvas.trust[at] = texel.coverage().max(0.01);
            }
            Some(_) => return Err(FinishError::Value { texel: number }),
            None => buried[page].push(at),
        }
    }
    Ok((canvases, buried))
}

fn fill(canvases: &mut [Canvas], buried: Vec<Vec<usize>>, report: &mut FinishReport) {
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

/// Takes the memory of the canvas.
fn image(canvas: Canvas, page: u32) -> Image {
    let Canvas { width, height, owner, value: mut values, trust: mut coverage } = canvas;
    drop(owner);
    for (value, trust) in values.iter_mut().zip(&mut coverage) {
        if *trust <= 0.0 {
            *value = Vec3::ZERO;
        }
        *trust = 0.0;
    }
    Image { page, width, height, values, coverage }
}
