//! Values per texel to images: buried texels filled, padding dilated, seams stitched.
//!
//! Buried (invalid) texels take the mean of valid neighbours of their own chart, ring by ring; padding continues its
//! chart alike; stitching then moves texels near chart borders so that both sides of a seam read the same.
//! Nothing is ever mixed across charts but along a seam of a continuous surface.

use glam::Vec3;
use luxel_scene::{Cancelled, Progress, Scene, watched};

use crate::canvas::Canvas;
use crate::{Atlas, Page, Texel, seams};

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
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Makes one image per page from the value of each texel, by its index; none where it lies inside other geometry.
///
/// # Errors
/// Values that are negative or not finite, an atlas whose texels lie outside their pages, and cancellation.
pub fn finish(
    scene: &Scene,
    atlas: &Atlas,
    value: impl Fn(usize) -> Option<Vec3>,
    settings: &FinishSettings,
    progress: &dyn Progress,
) -> Result<(Vec<Image>, FinishReport), FinishError> {
    let mut report = FinishReport::default();
    let (mut canvases, buried) = scattered(atlas, value, progress)?;
    fill(&mut canvases, buried, &mut report, progress)?;
    let grown = canvases.iter_mut().map(|canvas| canvas.dilate(settings.padding, progress));
    let padding = grown.collect::<Result<Vec<Vec<usize>>, Cancelled>>()?;
    if settings.stitch {
        let touched = seams::stitch(scene, atlas, &mut canvases, &mut report, progress)?;
        dilate_again(&mut canvases, &padding, &touched, settings.padding, progress)?;
    }
    let images = canvases.into_iter().zip(0..).map(|(canvas, page)| {
        progress.check()?;
        Ok(image(canvas, page))
    });
    let mut images = images.collect::<Result<Vec<Image>, Cancelled>>()?;
    for texel in watched(&atlas.texels, progress) {
        let texel = texel?;
        if let Some((page, at)) = place(atlas, texel) {
            images[page].coverage[at] = texel.coverage();
        }
    }
    Ok((images, report))
}

/// Pages with the values at their places, and the texels of each page that have none. The values come first and end
/// with `value`, so that what it reads is not kept beside the rest of the page.
fn scattered(
    atlas: &Atlas,
    value: impl Fn(usize) -> Option<Vec3>,
    progress: &dyn Progress,
) -> Result<(Vec<Canvas>, Vec<Vec<usize>>), FinishError> {
    let pixels = |page: &Page| page.width as usize * page.height as usize;
    let mut values: Vec<Vec<Vec3>> = atlas.pages.iter().map(|page| vec![Vec3::ZERO; pixels(page)]).collect();
    let mut buried = vec![Vec::new(); values.len()];
    for item in watched(atlas.texels.iter().enumerate(), progress) {
        let (number, texel) = item?;
        let (page, at) = place(atlas, texel).ok_or(FinishError::Atlas { texel: number })?;
        match value(number) {
            Some(value) if value.is_finite() && value.min_element() >= 0.0 => values[page][at] = value,
            Some(_) => return Err(FinishError::Value { texel: number }),
            None => buried[page].push(at),
        }
    }
    drop(value);
    let canvas = |(page, values): (&Page, Vec<Vec3>)| Canvas::new(page.width, page.height, values);
    let mut canvases: Vec<Canvas> = atlas.pages.iter().zip(values).map(canvas).collect();
    for texel in watched(&atlas.texels, progress) {
        let texel = texel?;
        // Every place was looked at above.
        let Some((page, at)) = place(atlas, texel) else { continue };
        canvases[page].owner[at] = texel.chart + 1;
        canvases[page].trust[at] = texel.coverage().max(0.01);
    }
    for (canvas, buried) in canvases.iter_mut().zip(&buried) {
        buried.iter().for_each(|&at| canvas.trust[at] = 0.0);
    }
    Ok((canvases, buried))
}

/// The page of a texel and its index there; none where it lies outside.
fn place(atlas: &Atlas, texel: &Texel) -> Option<(usize, usize)> {
    let number = atlas.charts.get(texel.chart as usize)?.page as usize;
    let page = atlas.pages.get(number)?;
    let inside = u32::from(texel.x) < page.width && u32::from(texel.y) < page.height;
    inside.then(|| (number, usize::from(texel.y) * page.width as usize + usize::from(texel.x)))
}

fn fill(
    canvases: &mut [Canvas],
    buried: Vec<Vec<usize>>,
    report: &mut FinishReport,
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    for (canvas, buried) in canvases.iter_mut().zip(buried) {
        canvas.fill(buried.clone(), progress)?;
        let known = buried.iter().filter(|&&at| canvas.is_known(at)).count();
        report.filled += known as u32;
        report.lost += (buried.len() - known) as u32;
    }
    Ok(())
}

/// Stitching changed the texels at chart borders; padding that it did not set itself follows them.
fn dilate_again(
    canvases: &mut [Canvas],
    padding: &[Vec<usize>],
    touched: &[Vec<usize>],
    rings: u32,
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    for ((canvas, padding), touched) in canvases.iter_mut().zip(padding).zip(touched) {
        if touched.is_empty() {
            continue;
        }
        for &at in padding.iter().filter(|at| touched.binary_search(at).is_err()) {
            (canvas.owner[at], canvas.trust[at]) = (0, 0.0);
        }
        canvas.dilate(rings, progress)?;
    }
    Ok(())
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
