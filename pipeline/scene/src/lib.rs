//! What a scene is, and reading it from glTF.
//!
//! [`Scene`] is the one input of every later room. It keeps geometry in object space once per glTF primitive
//! ([`Mesh`]) and places it any number of times ([`Instance`]), so that unwraps and artefacts can be shared.
//!
//! This room knows nothing of light transport; it knows what surfaces, lights and skies *are*, in the units of
//! glTF: metres, radiance in cd/m² (nits), intensity in cd, illuminance in lux, linear Rec. 709 RGB.

pub mod build;
pub mod import;
pub mod light;
pub mod material;
pub mod progress;
mod pyramid;
pub mod scene;
pub mod sky;
pub mod texture;

pub use import::{ImportError, ImportOptions, Limits};
pub use light::{Light, LightKind};
pub use material::{Alpha, Material, Surface, TextureRef};
pub use progress::{Cancelled, Progress, Silent, Uncounted, Unwanted, Watched, watched};
pub use pyramid::Averages;
pub use scene::{Camera, InputFile, Instance, Mesh, Notice, Scene};
pub use sky::{Sky, SkyImage};
pub use texture::{AlphaUse, Texture, Wrap};
