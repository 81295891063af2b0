//! Digests of what stages read.

use glam::{DAffine3, Vec3};

use crate::plan::Stage;
use crate::settings::{Field, Settings};
use crate::store::Key;

/// A BLAKE3 hash that grows value by value; texts and lists carry their lengths.
pub struct Digest(blake3::Hasher);

impl Digest {
    pub fn new(what: &str) -> Self {
        Self(blake3::Hasher::new()).text(what)
    }

    pub fn stage(stage: Stage) -> Self {
        Self::new(env!("CARGO_PKG_VERSION")).version(stage)
    }

    pub fn version(self, stage: Stage) -> Self {
        self.text(stage.name()).number(stage.version().into())
    }

    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.update(bytes);
        self
    }

    pub fn number(self, n: u64) -> Self {
        self.bytes(&n.to_le_bytes())
    }

    pub fn text(self, text: &str) -> Self {
        self.number(text.len() as u64).bytes(text.as_bytes())
    }

    pub fn slice<T: bytemuck::NoUninit>(self, items: &[T]) -> Self {
        self.number(items.len() as u64).bytes(bytemuck::cast_slice(items))
    }

    pub fn flag(self, flag: bool) -> Self {
        self.bytes(&[u8::from(flag)])
    }

    pub fn float(self, x: f32) -> Self {
        self.bytes(&x.to_le_bytes())
    }

    pub fn double(self, x: f64) -> Self {
        self.bytes(&x.to_le_bytes())
    }

    pub fn vec3(self, v: Vec3) -> Self {
        self.float(v.x).float(v.y).float(v.z)
    }

    pub fn affine(self, a: &DAffine3) -> Self {
        a.to_cols_array().into_iter().fold(self, Self::double)
    }

    pub fn setting(self, settings: &Settings, name: &str) -> Self {
        let value = Field::find(name).map(|field| (field.get)(settings));
        debug_assert!(value.is_some(), "there is no setting {name}");
        self.text(name).text(&value.unwrap_or_default())
    }

    pub fn done(self) -> Key {
        *self.0.finalize().as_bytes()
    }
}
