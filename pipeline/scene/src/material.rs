//! What a surface does with light: Lambertian albedo, emission, coverage and transmission.

use glam::{Vec2, Vec3, Vec4};

use crate::{Texture, Wrap};

/// Largest albedo that transport accepts; above it a closed room would never come to rest.
pub const MAX_ALBEDO: f32 = 0.999;

/// A glTF material, reduced to what a diffuse lightmap needs.
#[derive(Clone, Debug)]
pub struct Material {
    pub name: String,
    /// Base colour, linear RGB and alpha.
    pub base_color: Vec4,
    pub base_color_texture: Option<TextureRef>,
    pub metallic: f32,
    pub roughness: f32,
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Emitted radiance [cd/m²]: emissive factor × strength.
    pub emission: Vec3,
    pub emissive_texture: Option<TextureRef>,
    pub alpha: Alpha,
    /// KHR_materials_transmission factor [0, 1].
    pub transmission: f32,
    pub transmission_texture: Option<TextureRef>,
    pub double_sided: bool,
    /// KHR_materials_unlit: neither receives, reflects nor blocks.
    pub unlit: bool,
    /// Share of a fully rough metal's specular colour that counts as diffuse.
    pub metal_diffuse: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alpha {
    Opaque,
    /// Below the cut-off the surface is a hole.
    Mask(f32),
    Blend,
}

/// A texture as a material uses it.
#[derive(Clone, Debug)]
pub struct TextureRef {
    pub texture: usize,
    pub tex_coord: usize,
    pub wrap: [Wrap; 2],
    /// KHR_texture_transform as the affine map `uv' = matrix · uv + offset` (identity without it).
    pub matrix: [Vec2; 2],
    pub offset: Vec2,
}

impl TextureRef {
    pub fn new(texture: usize) -> Self {
        Self { texture, tex_coord: 0, wrap: [Wrap::Repeat; 2], matrix: [Vec2::X, Vec2::Y], offset: Vec2::ZERO }
    }

    fn sample(&self, textures: &[Texture], uv: &dyn Fn(usize) -> Vec2, footprint: f32) -> Vec4 {
        let p = uv(self.tex_coord);
        let p = self.matrix[0] * p.x + self.matrix[1] * p.y + self.offset;
        textures[self.texture].sample(p, self.wrap, footprint * self.stretch())
    }

    /// How much longer a length in the mesh's UV space is in the texture's.
    fn stretch(&self) -> f32 {
        (self.matrix[0].length() * self.matrix[1].length()).sqrt()
    }

    /// The average over this footprint holds, in its alpha, the share that passes the material's alpha test.
    fn is_tested(&self, textures: &[Texture], footprint: f32) -> bool {
        textures[self.texture].is_tested(footprint * self.stretch())
    }
}

/// A surface at one point (or averaged over a footprint).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Lambertian reflectance ρ of the covered part, in [0, MAX_ALBEDO].
    pub albedo: Vec3,
    /// Emitted radiance Lₑ [cd/m²] of the covered part.
    pub emission: Vec3,
    /// Share of the area that is there at all: 1 opaque, 0 a hole, α for BLEND.
    pub coverage: f32,
    /// Share of the light that goes straight through, coloured; 0 for opaque surfaces.
    pub transmittance: Vec3,
}

impl Default for Material {
    /// What a primitive without a material gets: white-ish plaster, ρ = 0.8.
    fn default() -> Self {
        Self {
            name: "default".into(),
            base_color: Vec4::new(0.8, 0.8, 0.8, 1.0),
            base_color_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            emission: Vec3::ZERO,
            emissive_texture: None,
            alpha: Alpha::Opaque,
            transmission: 0.0,
            transmission_texture: None,
            double_sided: false,
            unlit: false,
            metal_diffuse: 0.5,
        }
    }
}

impl Material {
    /// Evaluates the material; `uv(set)` gives the texture coordinates, `color` is the vertex colour.
    pub fn surface(&self, textures: &[Texture], uv: &dyn Fn(usize) -> Vec2, color: Vec4, footprint: f32) -> Surface {
        let fetch = |t: &Option<TextureRef>| t.as_ref().map_or(Vec4::ONE, |t| t.sample(textures, uv, footprint));
        let texel = fetch(&self.base_color_texture);
        let base = self.base_color * texel * color;
        let mr = fetch(&self.metallic_roughness_texture);
        let (metallic, roughness) = (self.metallic * mr.z, self.roughness * mr.y);
        let transmission = (self.transmission * fetch(&self.transmission_texture).x).clamp(0.0, 1.0);
        let tint = base.truncate().clamp(Vec3::ZERO, Vec3::ONE);
        let diffuse = 1.0 - metallic + metallic * roughness * self.metal_diffuse;
        let albedo = (tint * diffuse * (1.0 - transmission)).clamp(Vec3::ZERO, Vec3::splat(MAX_ALBEDO));
        let alpha = base.w.clamp(0.0, 1.0);
        let coverage = match self.alpha {
            Alpha::Opaque => 1.0,
            Alpha::Mask(cutoff) => match &self.base_color_texture {
                // The texture's own alpha is the share here; factor and vertex colour are part of its test or absent.
                Some(t) if color.w == 1.0 && t.is_tested(textures, footprint) => texel.w,
                _ => f32::from(alpha >= cutoff),
            },
            Alpha::Blend => alpha,
        };
        // A veil tints what passes the more the denser it is; a transmitting body tints by its base colour.
        let veil = match self.alpha {
            Alpha::Blend => (1.0 - coverage) * Vec3::ONE.lerp(tint, coverage),
            _ => Vec3::splat(1.0 - coverage),
        };
        Surface {
            albedo,
            emission: self.emission * fetch(&self.emissive_texture).truncate(),
            coverage,
            transmittance: veil + coverage * transmission * tint,
        }
    }

    /// Emits light somewhere.
    pub fn emits(&self) -> bool {
        self.emission.max_element() > 0.0
    }

    /// Every ray is either stopped or not touched at all: no holes, no veils.
    pub fn is_opaque(&self) -> bool {
        self.alpha == Alpha::Opaque && self.transmission == 0.0
    }
}
