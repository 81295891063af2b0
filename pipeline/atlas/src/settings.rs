//! What can be asked of an atlas, what can go wrong, and what came of it.

use luxel_scene::Cancelled;

use crate::unwrap::UnwrapError;

/// Largest page side: texel coordinates are 16-bit.
pub const MAX_SIZE: u32 = 16384;

#[derive(Clone, Debug, PartialEq)]
pub struct AtlasSettings {
    /// Side of a page (texels).
    pub size: u32,
    /// Texels per scene unit; None fills one page.
    pub texel_density: Option<f32>,
    /// Texels around every chart that belong to it alone. Bilinear filtering needs 1, bicubic 2.
    pub padding: u32,
    /// More pages than this are an error, not a surprise.
    pub max_pages: u32,
}

impl Default for AtlasSettings {
    fn default() -> Self {
        Self { size: 1024, texel_density: None, padding: 2, max_pages: 64 }
    }
}

impl AtlasSettings {
    pub(crate) fn check(&self) -> Result<(), AtlasError> {
        let bad = |what: String| Err(AtlasError::Settings(what));
        if self.padding < 2 || self.padding > 64 {
            return bad(format!("padding must be 2 to 64 texels, not {}", self.padding));
        }
        if self.size <= 2 * self.padding || self.size > MAX_SIZE {
            let least = 2 * self.padding + 1;
            return bad(format!("the size of a page must be {least} to {MAX_SIZE} texels, not {}", self.size));
        }
        if self.texel_density.is_some_and(|d| !(d.is_finite() && d > 0.0)) {
            return bad(format!("texel density must be positive, not {:?}", self.texel_density));
        }
        if self.max_pages == 0 {
            return bad("at least one page must be allowed".into());
        }
        Ok(())
    }
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AtlasError {
    #[error("{0}")]
    Settings(String),
    #[error("the charts need more than {limit} pages: lower the texel density or make the pages larger")]
    TooManyPages { limit: u32 },
    #[error(
        "\"{instance}\" has {charts} charts, which do not fit on a page of {size} × {size} texels at one texel each, and \
         all charts of an object share a page: make the page larger, or split the object"
    )]
    TooManyCharts { instance: String, charts: usize, size: u32 },
    #[error("instance \"{instance}\" has the texel scale {scale}: it must be positive")]
    TexelScale { instance: String, scale: f32 },
    #[error("the scene's surfaces are too large or too small to be measured")]
    Extent,
    #[error("an unwrap is missing: complete the layout before placing it")]
    MissingUnwrap,
    #[error("the stored unwrap of {mesh} does not belong to it")]
    ForeignUnwrap { mesh: String },
    #[error("unwrapping failed: {0}")]
    Unwrap(#[from] UnwrapError),
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// What a person should know about the atlas.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AtlasReport {
    pub pages: u32,
    /// Texels per scene unit: what every chart has that is not lowered; where some are, the mean over the area
    /// (root of texels over area).
    pub density: f64,
    /// Texels per scene unit that charts have unless they are lowered: what was asked for, or what fills the pages.
    pub wanted: f64,
    pub charts: u32,
    pub texels: u32,
    /// Covered area over page area.
    pub utilisation: f64,
    /// The same with every chart's padding counted as used.
    pub occupied: f64,
    /// Different meshes that were unwrapped.
    pub unwrapped: u32,
    /// Further instances that share the unwrap of one of them.
    pub shared: u32,
    /// Meshes whose authored TEXCOORD_1 is kept.
    pub kept: Vec<String>,
    /// Meshes with an authored TEXCOORD_1 that cannot serve, and why.
    pub unwrapped_anew: Vec<(String, String)>,
    /// Meshes with triangles that the unwrapper could not flatten: name, reason, number of triangles projected.
    pub fallbacks: Vec<(String, String, u32)>,
    /// Instances with charts whose density was lowered so that they fit on a page: name and texels per scene unit.
    pub lowered: Vec<(String, f64)>,
    /// Side of a page at which none would be lowered (texels); None where no allowed one is known, or where no density
    /// was asked for and the charts grow with the page.
    pub enough: Option<u32>,
}
