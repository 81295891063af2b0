//! The finished images: irradiance of one atlas page, and its stated bound.

use glam::{Vec2, Vec3};

use crate::ExportError;

/// Largest side of a page in texels; atlas texels carry 16-bit coordinates.
pub const MAX_SIDE: u32 = 1 << 16;

/// Irradiance E (lux) of one atlas page: linear RGB, row-major, row 0 at v = 0.
///
/// Invariant: every value is finite and not negative, and the sizes agree. Only [`Lightmap::new`] makes one, so no
/// writer can meet a NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct Lightmap {
    width: u32,
    height: u32,
    irradiance: Vec<Vec3>,
    coverage: Vec<f32>,
    /// Empty where no texel is buried.
    buried: Vec<bool>,
}

/// The stated error bound of one atlas page (lux), one band, laid out as the page. The same invariant holds.
#[derive(Clone, Debug, PartialEq)]
pub struct BoundMap {
    width: u32,
    height: u32,
    bound: Vec<f32>,
}

impl Lightmap {
    /// `irradiance` and `coverage` have `width × height` entries; coverage is the share of a texel that its chart
    /// covers, 0 in the padding. Errors name the first texel that is no light.
    pub fn new(width: u32, height: u32, irradiance: Vec<Vec3>, coverage: Vec<f32>) -> Result<Self, ExportError> {
        let what = "lightmap";
        check_size(what, width, height, irradiance.len())?;
        check_size("coverage of a lightmap", width, height, coverage.len())?;
        let no_light = |e: &Vec3| !(e.is_finite() && e.min_element() >= 0.0);
        if let Some(i) = irradiance.iter().position(no_light) {
            return Err(bad_texel(what, width, i, format!("irradiance {}", irradiance[i])));
        }
        if let Some(i) = coverage.iter().position(|c| !(0.0..=1.0).contains(c)) {
            return Err(bad_texel(what, width, i, format!("coverage {}", coverage[i])));
        }
        Ok(Self { width, height, irradiance, coverage, buried: Vec::new() })
    }

    /// The same, with the places (row-major, in any order) of texels whose points lie inside or under other geometry:
    /// what they hold comes from their neighbours. An error names the first place that is none.
    pub fn with_buried(mut self, places: impl IntoIterator<Item = usize>) -> Result<Self, ExportError> {
        let all = self.irradiance.len();
        for place in places {
            // Most pages have none, and need no marks.
            self.buried.resize(all, false);
            let Some(mark) = self.buried.get_mut(place) else {
                let fault = format!("texel {place} is buried, and there are {all}");
                return Err(ExportError::Image { what: "lightmap".into(), fault });
            };
            *mark = true;
        }
        Ok(self)
    }

    pub fn width(&self) -> u32 {
        self.width
    }

    pub fn height(&self) -> u32 {
        self.height
    }

    /// E (lux), row-major.
    pub fn irradiance(&self) -> &[Vec3] {
        &self.irradiance
    }

    /// Share of every texel that a chart covers, row-major.
    pub fn coverage(&self) -> &[f32] {
        &self.coverage
    }

    /// Whether a texel's point lies inside or under other geometry, row-major; empty where none does.
    pub fn buried(&self) -> &[bool] {
        &self.buried
    }

    /// Bilinear E (lux) at `uv` ((0,0) is the upper left corner), clamped at the page's border as engines sample it.
    pub fn sample(&self, uv: Vec2) -> Vec3 {
        let uv = Vec2::new(clamp01(uv.x), clamp01(uv.y));
        let p = uv * Vec2::new(self.width as f32, self.height as f32) - 0.5;
        let (base, f) = (p.floor(), p - p.floor());
        let fetch = |dx: i64, dy: i64| {
            let x = (base.x as i64 + dx).clamp(0, i64::from(self.width) - 1);
            let y = (base.y as i64 + dy).clamp(0, i64::from(self.height) - 1);
            self.irradiance[(y * i64::from(self.width) + x) as usize]
        };
        let top = fetch(0, 0).lerp(fetch(1, 0), f.x);
        let bottom = fetch(0, 1).lerp(fetch(1, 1), f.x);
        top.lerp(bottom, f.y)
    }
}

impl BoundMap {
    /// `bound` has `width × height` entries.
    pub fn new(width: u32, height: u32, bound: Vec<f32>) -> Result<Self, ExportError> {
        let what = "bound image";
        check_size(what, width, height, bound.len())?;
        if let Some(i) = bound.iter().position(|b| !(b.is_finite() && *b >= 0.0)) {
            return Err(bad_texel(what, width, i, format!("bound {}", bound[i])));
        }
        Ok(Self { width, height, bound })
    }

    pub fn width(&self) -> u32 {
        self.width
    }

    pub fn height(&self) -> u32 {
        self.height
    }

    pub fn bound(&self) -> &[f32] {
        &self.bound
    }
}

/// Bilinear E (lux) on a page of a set of pages; zero where there is no such page.
pub fn sample_lightmap(pages: &[Lightmap], page: u32, uv: Vec2) -> Vec3 {
    pages.get(page as usize).map_or(Vec3::ZERO, |p| p.sample(uv))
}

/// Clamps to [0, 1]; NaN becomes 0.
fn clamp01(x: f32) -> f32 {
    if x > 0.0 { x.min(1.0) } else { 0.0 }
}

fn check_size(what: &str, width: u32, height: u32, len: usize) -> Result<(), ExportError> {
    let sane = (1..=MAX_SIDE).contains(&width) && (1..=MAX_SIDE).contains(&height);
    if sane && u64::from(width) * u64::from(height) == len as u64 {
        return Ok(());
    }
    Err(ExportError::Image { what: what.into(), fault: format!("{len} texels do not make {width} × {height}") })
}

fn bad_texel(what: &str, width: u32, i: usize, value: String) -> ExportError {
    let (x, y) = (i % width as usize, i / width as usize);
    ExportError::Image { what: what.into(), fault: format!("texel ({x}, {y}) has {value}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> Lightmap {
        let e = (0..12).map(|i| Vec3::new((i % 4) as f32, (i / 4) as f32, 7.0)).collect();
        Lightmap::new(4, 3, e, vec![1.0; 12]).unwrap()
    }

    #[test]
    fn bilinear_sampling_reproduces_a_linear_image_between_texel_centres() {
        let map = gradient();
        for (u, v) in [(0.5, 0.5), (0.125, 1.0 / 6.0), (0.3, 0.8), (0.8, 0.7)] {
            let e = map.sample(Vec2::new(u, v));
            let expected = Vec3::new((u * 4.0 - 0.5).clamp(0.0, 3.0), (v * 3.0 - 0.5).clamp(0.0, 2.0), 7.0);
            assert!((e - expected).length() < 1e-5, "{u} {v}: {e} {expected}");
        }
    }

    #[test]
    fn sampling_clamps_at_the_border_and_survives_absurd_coordinates() {
        let map = gradient();
        assert_eq!(map.sample(Vec2::ZERO), Vec3::new(0.0, 0.0, 7.0));
        assert_eq!(map.sample(Vec2::ONE), Vec3::new(3.0, 2.0, 7.0));
        assert_eq!(map.sample(Vec2::new(1e30, -1e30)), Vec3::new(3.0, 0.0, 7.0));
        assert_eq!(map.sample(Vec2::new(f32::NAN, f32::INFINITY)), Vec3::new(0.0, 2.0, 7.0));
        assert_eq!(sample_lightmap(&[map], 1, Vec2::ZERO), Vec3::ZERO);
    }

    #[test]
    fn what_is_no_light_is_refused_by_its_texel() {
        for bad in [f32::NAN, f32::INFINITY, -1e-20] {
            let mut e = vec![Vec3::ONE; 6];
            e[4].y = bad;
            let error = Lightmap::new(3, 2, e, vec![1.0; 6]).unwrap_err().to_string();
            assert!(error.contains("(1, 1)"), "{error}");
            assert!(BoundMap::new(1, 1, vec![bad]).is_err());
        }
        assert!(Lightmap::new(1, 1, vec![Vec3::ONE], vec![1.5]).is_err());
        assert!(Lightmap::new(2, 2, vec![Vec3::ONE; 3], vec![1.0; 3]).is_err());
        assert!(Lightmap::new(0, 0, vec![], vec![]).is_err());
    }
}
