//! What a surface does with light: Lambertian albedo, emission, coverage and transmission.

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};

use crate::{AlphaUse, Averages, Texture, Wrap};

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
    /// Averages of the texture in this use of it; uses that read its alpha alike may share them.
    pub averages: Arc<Averages>,
}

impl TextureRef {
    pub fn new(texture: usize) -> Self {
        Self {
            texture,
            tex_coord: 0,
            wrap: [Wrap::Repeat; 2],
            matrix: [Vec2::X, Vec2::Y],
            offset: Vec2::ZERO,
            averages: Arc::default(),
        }
    }

    /// The texture at the mesh's coordinates, averaged over a square of side `footprint` in the mesh's UV space.
    pub fn sample(&self, textures: &[Texture], alpha: AlphaUse, uv: &dyn Fn(usize) -> Vec2, footprint: f32) -> Vec4 {
        let p = uv(self.tex_coord);
        let p = self.matrix[0] * p.x + self.matrix[1] * p.y + self.offset;
        textures[self.texture].sample(&self.averages, alpha, p, self.wrap, footprint * self.stretch())
    }

    /// The average of the whole texture.
    pub fn mean(&self, textures: &[Texture], alpha: AlphaUse) -> Vec4 {
        textures[self.texture].mean(&self.averages, alpha)
    }

    /// How much longer a length in the mesh's UV space is in the texture's.
    fn stretch(&self) -> f32 {
        (self.matrix[0].length() * self.matrix[1].length()).sqrt()
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
        let sample =
            |t: &Option<TextureRef>, alpha| t.as_ref().map_or(Vec4::ONE, |t| t.sample(textures, alpha, uv, footprint));
        let fetch = |t: &Option<TextureRef>| sample(t, AlphaUse::Ignored);
        let texel = sample(&self.base_color_texture, self.alpha_use());
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
                // The texel's alpha is the share that passed; the factor is part of the test, a vertex colour cannot be.
                Some(t) if color.w == 1.0 && textures[t.texture].is_tested(footprint * t.stretch()) => texel.w,
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

    /// What the alpha of the base colour texture means.
    pub fn alpha_use(&self) -> AlphaUse {
        match self.alpha {
            Alpha::Opaque => AlphaUse::Ignored,
            Alpha::Blend => AlphaUse::Coverage,
            // The test `factor × texel ≥ cut-off` in terms of the texel alone.
            Alpha::Mask(cutoff) => AlphaUse::Test(match (cutoff <= 0.0, self.base_color.w > 0.0) {
                (true, _) => 0.0,
                (false, true) => cutoff / self.base_color.w,
                (false, false) => f32::INFINITY,
            }),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn checker(on: u8, off: u8) -> Texture {
        let texels = (0..64 * 64).map(|i| [255, 0, 0, if (i + i / 64) % 2 == 0 { on } else { off }]).collect();
        Texture { name: "checker".into(), width: 64, height: 64, srgb: true, texels }
    }

    fn surface(material: &Material, texture: &Texture, footprint: f32) -> Surface {
        let textures = std::slice::from_ref(texture);
        material.surface(textures, &|_| Vec2::new(0.5078125, 0.5078125), Vec4::ONE, footprint)
    }

    #[test]
    fn a_mask_covers_the_share_of_texels_that_pass() {
        let texture = checker(200, 100);
        for (factor, cutoff, expected) in
            [(1.0, 0.5, 0.5), (1.0, 0.3, 1.0), (1.0, 0.9, 0.0), (0.5, 0.3, 0.5), (0.0, 0.0, 1.0)]
        {
            let material = Material {
                base_color: Vec4::new(1.0, 1.0, 1.0, factor),
                base_color_texture: Some(TextureRef::new(0)),
                alpha: Alpha::Mask(cutoff),
                ..Material::default()
            };
            let wide = surface(&material, &texture, 0.5);
            assert!((wide.coverage - expected).abs() < 1e-6, "{factor} {cutoff}: {}", wide.coverage);
            let point = surface(&material, &texture, 0.0);
            assert_eq!(point.coverage, f32::from(200.0 / 255.0 * factor >= cutoff), "{factor} {cutoff}");
        }
    }

    #[test]
    fn alpha_of_opaque_materials_means_nothing() {
        let texels = (0..16 * 16).map(|i| if i % 2 == 0 { [255, 255, 255, 0] } else { [0, 0, 0, 255] }).collect();
        let texture = Texture { width: 16, height: 16, texels, ..Texture::default() };
        let material =
            Material { base_color: Vec4::ONE, base_color_texture: Some(TextureRef::new(0)), ..Material::default() };
        let wide = surface(&material, &texture, 1.0);
        assert_eq!((wide.albedo, wide.coverage), (Vec3::splat(0.5), 1.0));
    }

    #[test]
    fn rough_metals_reflect_a_share_and_veils_tint() {
        let metal = Material { base_color: Vec4::ONE, metallic: 1.0, roughness: 0.8, ..Material::default() };
        let surface = metal.surface(&[], &|_| Vec2::ZERO, Vec4::new(0.5, 1.0, 1.0, 1.0), 0.0);
        assert!((surface.albedo - Vec3::new(0.2, 0.4, 0.4)).abs().max_element() < 1e-6);
        let glass = Material { base_color: Vec4::new(1.0, 0.0, 0.0, 0.25), alpha: Alpha::Blend, ..Material::default() };
        let surface = glass.surface(&[], &|_| Vec2::ZERO, Vec4::ONE, 0.0);
        assert_eq!((surface.coverage, surface.transmittance.x), (0.25, 0.75));
        assert!(surface.transmittance.y < 0.75, "a veil takes some of the other colours away");
    }
}
