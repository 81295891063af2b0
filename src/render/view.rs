//! From where a scene is seen.

use glam::DVec3;
use luxel_scene::{Camera, Scene};

use super::lens::{FIELD, camera};
use crate::Error;

/// The field of view of a chosen place, where nobody says it [degrees].
pub const USUAL_FIELD: f64 = 50.0;

/// Whose view a picture shows.
#[derive(Clone, Debug, Default)]
pub enum View {
    /// The scene's first camera, or a view that shows much of the lit scene.
    #[default]
    Scene,
    /// The scene's camera of this name, or of this number, from 0.
    Camera(String),
    /// From a place to another, upright; made by [`View::from`].
    Place(Box<Camera>),
}

impl View {
    /// From `eye` to `target` [scene units], with a vertical field of view in degrees.
    ///
    /// # Errors
    /// What is wrong with them, in words.
    pub fn from(eye: DVec3, target: DVec3, field: f64) -> Result<Self, String> {
        if !(eye.is_finite() && target.is_finite()) {
            return Err("the eye and its target have to be finite".into());
        }
        let Some(ahead) = (target - eye).try_normalize() else {
            return Err("the eye is where its target is: it has to look somewhere".into());
        };
        // NaN is not in the range either.
        if !FIELD.contains(&field) {
            return Err(format!("the field of view has to be from {} to {} degrees", FIELD.start(), FIELD.end()));
        }
        Ok(Self::Place(Box::new(camera(eye, ahead, field.to_radians()))))
    }

    /// The camera, unless it is yet to be chosen.
    ///
    /// # Errors
    /// The scene has no camera of this name or number.
    pub fn camera(&self, scene: &Scene) -> Result<Option<Camera>, Error> {
        match self {
            Self::Scene => Ok(scene.cameras.first().cloned()),
            Self::Place(camera) => Ok(Some((**camera).clone())),
            Self::Camera(name) => {
                let named = scene.cameras.iter().find(|c| c.name == *name);
                let numbered = || name.parse().ok().and_then(|n: usize| scene.cameras.get(n));
                named.or_else(numbered).cloned().map(Some).ok_or_else(|| {
                    let cameras: Vec<String> = scene.cameras.iter().map(|c| format!("{:?}", c.name)).collect();
                    let cameras = if cameras.is_empty() { "none".into() } else { cameras.join(", ") };
                    Error::Camera { name: name.clone(), cameras }
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_from_nowhere_are_refused() {
        let from = |eye: DVec3, field: f64| View::from(eye, DVec3::ZERO, field);
        assert!(from(DVec3::ZERO, 50.0).unwrap_err().contains("look somewhere"));
        assert!(from(DVec3::new(f64::NAN, 0.0, 0.0), 50.0).unwrap_err().contains("finite"));
        for field in [0.0, -1.0, 0.09, 177.1, 180.0, f64::NAN, f64::INFINITY] {
            assert!(from(DVec3::Z, field).unwrap_err().contains("from 0.1 to 177 degrees"), "{field}");
        }
        let View::Place(camera) = from(DVec3::Z * 2.0, 90.0).unwrap() else { panic!() };
        assert!((camera.transform.matrix3.z_axis - DVec3::Z).length() < 1e-12, "it looks along −Z");
        // Straight down there is no upright, and still a view.
        let View::Place(down) = View::from(DVec3::Y, DVec3::ZERO, 50.0).unwrap() else { panic!() };
        assert!(down.transform.matrix3.determinant() > 0.99);
    }

    #[test]
    fn cameras_have_names_and_numbers() {
        let mut scene = Scene::default();
        for name in ["door", "1", "roof"] {
            scene.cameras.push(Camera { name: name.into(), ..camera(DVec3::ZERO, DVec3::NEG_Z, 1.0) });
        }
        let name = |which: &str| View::Camera(which.into()).camera(&scene).unwrap().unwrap().name;
        assert_eq!([name("roof"), name("0"), name("1"), name("2")], ["roof", "door", "1", "roof"]);
        let said = View::Camera("3".into()).camera(&scene).unwrap_err().to_string();
        assert!(said.contains("\"3\"") && said.contains("\"door\", \"1\", \"roof\""), "{said}");
        assert_eq!(View::Scene.camera(&scene).unwrap().unwrap().name, "door");
        assert!(View::Scene.camera(&Scene::default()).unwrap().is_none());
    }
}
