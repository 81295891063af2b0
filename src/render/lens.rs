//! The camera: a pinhole in the frame of the scene, and pictures' sizes.

use glam::{DAffine3, DMat3, DVec3, Vec3};
use luxel_export::report::Warning;
use luxel_scene::Camera;
use luxel_transport::frame::Frame;

use crate::Error;

/// Longest side of a picture whose size nobody chose, in pixels.
pub const SIDE: u32 = 960;
/// Longest side of any picture, and most pixels of it.
pub const MOST_SIDE: u32 = 16_384;
pub const MOST_PIXELS: u64 = 1 << 25;

/// Vertical fields of view that a picture can have [degrees]; cameras beyond have the nearest of them.
pub const FIELD: std::ops::RangeInclusive<f64> = 0.1..=177.0;

/// Width over height where neither a camera nor anybody says it.
const ASPECT: f64 = 1.5;

/// A pinhole in frame space.
#[derive(Clone, Debug)]
pub struct Lens {
    pub eye: Vec3,
    right: Vec3,
    up: Vec3,
    ahead: Vec3,
}

impl Lens {
    /// The vertical field of view is the camera's, within [`FIELD`]; `aspect` is the width of the picture over its height.
    pub fn new(camera: &Camera, frame: &Frame, aspect: f64) -> Self {
        let m = camera.transform.matrix3;
        let unit = |v: DVec3| v.try_normalize().unwrap_or(DVec3::Y);
        let tan = libm::tan(0.5 * camera.yfov.clamp(FIELD.start().to_radians(), FIELD.end().to_radians()));
        Self {
            eye: frame.point(camera.transform.translation),
            right: (unit(m.x_axis) * tan * aspect).as_vec3(),
            up: (unit(m.y_axis) * tan).as_vec3(),
            ahead: (-unit(m.z_axis)).as_vec3(),
        }
    }

    /// Unit direction through (s, t) in [−1, 1]², t upwards.
    pub fn direction(&self, s: f32, t: f32) -> Vec3 {
        (self.ahead + self.right * s + self.up * t).normalize()
    }

    /// Side of a pixel at unit distance, when the picture is so many pixels high.
    pub fn pixel(&self, height: u32) -> f32 {
        2.0 * self.up.length() / height as f32
    }
}

/// A camera at `eye` that looks along `ahead` (unit), upright; its vertical field of view in radians.
pub fn camera(eye: DVec3, ahead: DVec3, yfov: f64) -> Camera {
    let right = ahead.cross(DVec3::Y).try_normalize().unwrap_or(DVec3::X);
    let rotation = DMat3::from_cols(right, right.cross(ahead), -ahead);
    Camera { name: "chosen".into(), transform: DAffine3::from_mat3_translation(rotation, eye), yfov, aspect: None }
}

/// Says that a picture shows another field of view than its camera has, where it does.
pub fn narrowed(camera: &Camera) -> Option<Warning> {
    let degrees = camera.yfov.to_degrees();
    // The field of view is a conversion away from what was written.
    let is_kept = degrees >= FIELD.start() * (1.0 - 1e-6) && degrees <= FIELD.end() * (1.0 + 1e-6);
    let message = || {
        let (name, shown) = (&camera.name, degrees.clamp(*FIELD.start(), *FIELD.end()));
        format!("the camera {name:?} has a field of view of {degrees:.3} degrees; the picture shows {shown} of them")
    };
    (!is_kept).then(|| Warning { code: "camera-field".into(), message: message() })
}

/// Sides of a picture that were chosen [pixels]; the aspect follows the camera where one is missing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Size {
    pub width: Option<u32>,
    pub height: Option<u32>,
}

impl Size {
    /// Width and height of a camera's picture in pixels.
    ///
    /// # Errors
    /// More pixels than [`MOST_PIXELS`].
    pub fn of(self, camera: &Camera) -> Result<(u32, u32), Error> {
        let aspect = aspect(camera);
        let (width, height) = match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, pixels(f64::from(width) / aspect)),
            (None, Some(height)) => (pixels(f64::from(height) * aspect), height),
            (None, None) => Self::usual(camera),
        };
        bound(width, height)?;
        Ok((width, height))
    }

    /// The size that nobody chose.
    pub fn usual(camera: &Camera) -> (u32, u32) {
        let (aspect, side) = (aspect(camera), f64::from(SIDE));
        if aspect >= 1.0 { (SIDE, pixels(side / aspect)) } else { (pixels(side * aspect), SIDE) }
    }
}

/// Sees that a picture is not too large.
///
/// # Errors
/// A side longer than [`MOST_SIDE`], or more pixels than [`MOST_PIXELS`].
pub fn bound(width: u32, height: u32) -> Result<(), Error> {
    let fits = u64::from(width) * u64::from(height) <= MOST_PIXELS && width.max(height) <= MOST_SIDE;
    if fits { Ok(()) } else { Err(Error::PictureSize { width, height }) }
}

/// Width over height of a camera's picture; one that no screen has is passed over.
fn aspect(camera: &Camera) -> f64 {
    camera.aspect.filter(|a| (0.1..=10.0).contains(a)).unwrap_or(ASPECT)
}

fn pixels(side: f64) -> u32 {
    (side.round() as u32).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_origin(aspect: Option<f64>) -> Camera {
        Camera { aspect, ..camera(DVec3::ZERO, DVec3::NEG_Z, 1.0) }
    }

    #[test]
    fn one_side_keeps_the_aspect_and_both_are_taken_as_they_are() {
        let of = |width, height, aspect| Size { width, height }.of(&at_origin(aspect)).unwrap();
        assert_eq!(of(None, None, None), (960, 640));
        assert_eq!(of(None, None, Some(0.5)), (480, 960));
        assert_eq!(of(Some(300), None, Some(2.0)), (300, 150));
        assert_eq!(of(None, Some(300), Some(2.0)), (600, 300));
        assert_eq!(of(Some(7), Some(5), Some(2.0)), (7, 5));
        assert_eq!(of(Some(300), None, Some(1e6)), (300, 200));
        let huge = Size { width: Some(16_000), height: Some(16_000) }.of(&at_origin(None));
        assert!(matches!(huge, Err(Error::PictureSize { .. })));
    }

    #[test]
    fn a_field_of_view_beyond_what_is_kept_is_told() {
        let frame = Frame::new(-DVec3::ONE, DVec3::ONE);
        for (degrees, shown, is_told) in
            [(0.01, 0.1, true), (0.1, 0.1, false), (90.0, 90.0, false), (177.0, 177.0, false), (179.0, 177.0, true)]
        {
            let camera = Camera { yfov: f64::to_radians(degrees), ..at_origin(None) };
            let top = Lens::new(&camera, &frame, 1.0).direction(0.0, 1.0);
            let found = 2.0 * f64::from(libm::atan2f(top.y, -top.z)).to_degrees();
            assert!((found / shown - 1.0).abs() < 1e-4, "{degrees}: {found}");
            assert_eq!(narrowed(&camera).is_some(), is_told, "{degrees}");
        }
    }

    #[test]
    fn the_corners_of_a_picture_are_where_the_field_of_view_says() {
        let lens = Lens::new(&at_origin(None), &Frame::new(-DVec3::ONE, DVec3::ONE), 2.0);
        let top = lens.direction(0.0, 1.0);
        assert!((libm::atan2f(top.y, -top.z) - 0.5).abs() < 1e-6, "{top}");
        let corner = lens.direction(1.0, 1.0);
        assert!((corner.x / corner.y - 2.0).abs() < 1e-5, "{corner}");
        assert!((lens.pixel(100) - 2.0 * libm::tanf(0.5) / 100.0).abs() < 1e-7);
    }
}
