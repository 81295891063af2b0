//! Pictures of a scene, from a camera: what `luxel render` makes, and the preview of a bake.
//!
//! Rays from the eye find the visible surfaces ([`march`]); their irradiance E comes from any method of transport or from
//! the finished lightmap ([`light`], [`method`]); pixels are means over adaptively placed samples ([`film`], [`differ`],
//! [`pattern`]) of the radiance L = Lₑ + ρE/π [cd/m²], Lambert only. Exposure and tone curve come last ([`exposure`]),
//! so that files hold radiance. Pictures side by side and their differences: [`compare`].
//!
//! The same scene and settings give the same bytes on any number of threads.

pub mod choose;
pub mod compare;
pub mod differ;
pub mod exposure;
pub mod film;
pub mod label;
pub mod lens;
pub mod light;
pub mod march;
pub mod memory;
pub mod method;
pub mod output;
pub mod pattern;
pub mod pixel;
pub mod preview;
pub mod studio;
pub mod view;

pub use film::Picture;
pub use lens::Size;
pub use method::Chosen;
pub use studio::{Order, Studio};
pub use view::View;
