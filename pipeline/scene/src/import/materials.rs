//! glTF materials, reduced to what a diffuse lightmap needs (§3.9 and the KHR_materials extensions).
//!
//! Only materials that a mesh of the scene wears are read, and of their textures only those whose content can change
//! the result: an emissive texture under a black factor is never decoded.

use glam::{Vec2, Vec3, Vec4};
use gltf_json::material::AlphaMode;
use gltf_json::texture::{Info, WrappingMode};
use gltf_json::validation::Checked as Valid;
use serde_json::Value;

use super::buffers::Buffers;
use super::error::{Checked, Fault};
use super::images::{Encoding, Images};
use super::notes::Notes;
use super::options::ImportOptions;
use super::power::BRIGHTEST;
use super::primitives::MAX_UV_SET;
use crate::material::MAX_ALBEDO;
use crate::{Alpha, AlphaUse, Material, Texture, TextureRef, Wrap};

/// The scene's materials as they are asked for.
#[derive(Default)]
pub struct Materials {
    pub list: Vec<Material>,
    /// Scene index by glTF index; the last slot is the default material's.
    known: Vec<Option<usize>>,
    pub images: Images,
}

impl Materials {
    /// Scene index of a primitive's material.
    pub fn index(
        &mut self,
        buffers: &Buffers,
        material: Option<usize>,
        options: &ImportOptions,
        notes: &mut Notes,
    ) -> Checked<usize> {
        let count = buffers.document().root.materials.len();
        self.known.resize(count + 1, None);
        let slot = material.unwrap_or(count);
        if let Some(known) = self.known.get(slot).copied().flatten() {
            return Ok(known);
        }
        let read = match material {
            Some(index) => read(buffers, index, &mut self.images, options, notes)?,
            None => {
                notes.add("no-material", "surfaces without a material are taken as light grey, albedo 0.8");
                Material { metal_diffuse: options.metal_diffuse, ..Material::default() }
            }
        };
        self.list.push(read);
        if let Some(known) = self.known.get_mut(slot) {
            *known = Some(self.list.len() - 1);
        }
        Ok(self.list.len() - 1)
    }
}

/// Reads one material.
fn read(
    buffers: &Buffers,
    index: usize,
    images: &mut Images,
    options: &ImportOptions,
    notes: &mut Notes,
) -> Checked<Material> {
    let document = buffers.document();
    let place = document.material_place(index);
    let source = document.root.materials.get(index);
    let source = source.ok_or_else(|| Fault::invalid(&place, "it does not exist"))?;
    let extension = |name: &str| source.extensions.as_ref().and_then(|e| e.others.get(name));
    let mut bounded = |what: &str, value: f32| {
        if !(0.0..=1.0).contains(&value) {
            notes.add("factor-out-of-range", format!("{place}: its {what} of {value} is brought into [0, 1]"));
        }
        value.clamp(0.0, 1.0)
    };
    let pbr = &source.pbr_metallic_roughness;
    let mut base = pbr.base_color_factor.0;
    let mut base_texture = pbr.base_color_texture.clone();
    let (mut metallic, roughness) = (pbr.metallic_factor.0, pbr.roughness_factor.0);
    if let Some(glossy) = extension("KHR_materials_pbrSpecularGlossiness") {
        base = array(glossy, "diffuseFactor", &place)?.unwrap_or([1.0; 4]);
        base_texture = info(glossy, "diffuseTexture", &place)?;
        metallic = 0.0;
    }
    let base = Vec4::from_array(base.map(|c| bounded("base colour", c)));
    let (metallic, roughness) = (bounded("metallic factor", metallic), bounded("roughness factor", roughness));
    let transmission = extension("KHR_materials_transmission");
    let transmission_factor = transmission.map_or(Ok(0.0), |t| number(t, "transmissionFactor", 0.0, &place))?;
    let transmission_factor = bounded("transmission factor", transmission_factor);
    let alpha = match source.alpha_mode {
        Valid::Valid(AlphaMode::Opaque) => Alpha::Opaque,
        Valid::Valid(AlphaMode::Mask) => Alpha::Mask(source.alpha_cutoff.map_or(0.5, |c| c.0)),
        Valid::Valid(AlphaMode::Blend) => Alpha::Blend,
        Valid::Invalid => return Err(Fault::invalid(place, "its alphaMode is unknown")),
    };
    let emission = emission(source, extension("KHR_materials_emissive_strength"), options, &place, notes)?;

    let mut out = Material {
        name: source.name.clone().unwrap_or_else(|| place.clone()),
        base_color: base,
        metallic,
        roughness,
        emission,
        alpha,
        transmission: transmission_factor,
        double_sided: source.double_sided,
        unlit: extension("KHR_materials_unlit").is_some(),
        metal_diffuse: options.metal_diffuse,
        ..Material::default()
    };
    let mut texture = |info: Option<&Info>, needed: bool, encoding: Encoding, alpha: AlphaUse| match info {
        Some(info) if needed => reference(buffers, info, encoding, alpha, images, &place).map(Some),
        _ => Ok(None),
    };
    let black = base.truncate() == Vec3::ZERO;
    let mapped = pbr.metallic_roughness_texture.as_ref();
    let transmitted = transmission.map_or(Ok(None), |t| info(t, "transmissionTexture", &place))?;
    let (srgb, linear, ignored) = (Encoding::Srgb, Encoding::Linear, AlphaUse::Ignored);
    out.base_color_texture = texture(base_texture.as_ref(), !black || alpha != Alpha::Opaque, srgb, out.alpha_use())?;
    out.metallic_roughness_texture = texture(mapped, metallic > 0.0 && !black, linear, ignored)?;
    out.emissive_texture = texture(source.emissive_texture.as_ref(), out.emits(), srgb, ignored)?;
    out.transmission_texture = texture(transmitted.as_ref(), transmission_factor > 0.0, linear, ignored)?;
    Ok(out)
}

/// Emissive factor × strength [cd/m²].
fn emission(
    source: &gltf_json::Material,
    strength: Option<&Value>,
    options: &ImportOptions,
    place: &str,
    notes: &mut Notes,
) -> Checked<Vec3> {
    let strength = strength.map_or(Ok(1.0), |s| number(s, "emissiveStrength", 1.0, place))?;
    let emission = Vec3::from_array(source.emissive_factor.0) * strength * options.emissive_scale;
    if !emission.is_finite() {
        return Err(Fault::invalid(place, "its emission is not finite"));
    }
    if emission.max_element() > BRIGHTEST {
        let what = format!("its emission of {:e} cd/m² is beyond {BRIGHTEST:e}", emission.max_element());
        return Err(Fault::invalid(place, what));
    }
    if emission.min_element() < 0.0 {
        notes.add("negative-light", format!("{place}: its emission is negative and counts as 0"));
    }
    Ok(emission.max(Vec3::ZERO))
}

/// A texture as the material uses it, with its sampler and KHR_texture_transform.
fn reference(
    buffers: &Buffers,
    info: &Info,
    encoding: Encoding,
    alpha: AlphaUse,
    images: &mut Images,
    place: &str,
) -> Checked<TextureRef> {
    let root = &buffers.document().root;
    let mut out = images.request(buffers, info.index.value(), encoding, alpha)?;
    let mut set = info.tex_coord;
    if let Some(transform) = info.extensions.as_ref().and_then(|e| e.others.get("KHR_texture_transform")) {
        if let Some(value) = transform.get("texCoord") {
            let wrong = || Fault::invalid(place, "its texture transform has an improper texCoord");
            set = value.as_u64().and_then(|v| u32::try_from(v).ok()).ok_or_else(wrong)?;
        }
        let offset = array(transform, "offset", place)?.unwrap_or([0.0; 2]);
        let scale = array(transform, "scale", place)?.unwrap_or([1.0; 2]);
        let rotation = number(transform, "rotation", 0.0, place)?;
        (out.matrix, out.offset) = uv_transform(offset, rotation, scale);
    }
    if set > MAX_UV_SET {
        let what = format!("it uses TEXCOORD_{set}; luxel reads TEXCOORD_0 to TEXCOORD_{MAX_UV_SET}");
        return Err(Fault::unsupported(place, what, "use fewer texture coordinate sets"));
    }
    out.tex_coord = set as usize;
    let sampler = root.textures.get(info.index.value()).and_then(|t| t.sampler);
    if let Some(sampler) = sampler.and_then(|s| root.samplers.get(s.value())) {
        out.wrap = [wrap(sampler.wrap_s, place)?, wrap(sampler.wrap_t, place)?];
    }
    Ok(out)
}

fn wrap(mode: Valid<WrappingMode>, place: &str) -> Checked<Wrap> {
    match mode {
        Valid::Valid(WrappingMode::ClampToEdge) => Ok(Wrap::Clamp),
        Valid::Valid(WrappingMode::MirroredRepeat) => Ok(Wrap::Mirror),
        Valid::Valid(WrappingMode::Repeat) => Ok(Wrap::Repeat),
        Valid::Invalid => Err(Fault::invalid(place, "a sampler has an unknown wrap mode")),
    }
}

/// KHR_texture_transform: translation · rotation · scale, the rotation counter-clockwise as seen with v pointing down,
/// which is how the extension's reference images and the common viewers have it.
pub fn uv_transform(offset: [f32; 2], rotation: f32, scale: [f32; 2]) -> ([Vec2; 2], Vec2) {
    let (sin, cos) = (libm::sinf(rotation), libm::cosf(rotation));
    ([Vec2::new(cos, -sin) * scale[0], Vec2::new(sin, cos) * scale[1]], Vec2::from_array(offset))
}

fn number(object: &Value, key: &str, default: f32, place: &str) -> Checked<f32> {
    let Some(value) = object.get(key) else { return Ok(default) };
    let number = value.as_f64().map(|n| n as f32).filter(|n| n.is_finite());
    number.ok_or_else(|| Fault::invalid(place, format!("its {key} is not a finite number")))
}

fn array<const N: usize>(object: &Value, key: &str, place: &str) -> Checked<Option<[f32; N]>> {
    let Some(value) = object.get(key) else { return Ok(None) };
    let wrong = || Fault::invalid(place, format!("its {key} is not an array of {N} finite numbers"));
    let values = value.as_array().filter(|a| a.len() == N).ok_or_else(wrong)?;
    let mut out = [0.0; N];
    for (slot, value) in out.iter_mut().zip(values) {
        *slot = value.as_f64().map(|n| n as f32).filter(|n| n.is_finite()).ok_or_else(wrong)?;
    }
    Ok(Some(out))
}

/// A texture info inside an extension.
fn info(object: &Value, key: &str, place: &str) -> Checked<Option<Info>> {
    use serde::Deserialize;
    let Some(value) = object.get(key) else { return Ok(None) };
    Info::deserialize(value).map(Some).map_err(|e| Fault::invalid(place, format!("its {key} is wrong: {e}")))
}

/// Names the materials whose albedo exceeds what transport accepts, on average over their texture.
pub fn note_clamped(materials: &[Material], textures: &[Texture], notes: &mut Notes) {
    for material in materials {
        // A texture can only darken.
        if material.base_color.truncate().max_element() <= MAX_ALBEDO || material.unlit {
            continue;
        }
        let mean = |t: &Option<TextureRef>, alpha| t.as_ref().map_or(Vec4::ONE, |t| t.mean(textures, alpha));
        let base = material.base_color * mean(&material.base_color_texture, material.alpha_use());
        let mr = mean(&material.metallic_roughness_texture, AlphaUse::Ignored);
        let metallic = material.metallic * mr.z;
        let diffuse = 1.0 - metallic + metallic * material.roughness * mr.y * material.metal_diffuse;
        let albedo = base.truncate().max_element() * diffuse * (1.0 - material.transmission);
        if albedo > MAX_ALBEDO {
            let name = super::error::quoted(&material.name);
            notes.add(
                "albedo-clamped",
                format!("material {name}: its albedo of {albedo:.3} is taken as {MAX_ALBEDO}; nothing real is whiter"),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texture_transform_turns_counter_clockwise_on_screen() {
        let quarter = std::f32::consts::FRAC_PI_2;
        let (m, offset) = uv_transform([0.5, 0.25], quarter, [2.0, 3.0]);
        let apply = |u: f32, v: f32| m[0] * u + m[1] * v + offset;
        // With v down, a counter-clockwise quarter turn takes "right" to "up" and "down" to "right".
        assert!((apply(1.0, 0.0) - Vec2::new(0.5, 0.25 - 2.0)).length() < 1e-6);
        assert!((apply(0.0, 1.0) - Vec2::new(0.5 + 3.0, 0.25)).length() < 1e-6);
    }

    #[test]
    fn clamped_materials_are_named() {
        let white = Material { name: "Snow".into(), base_color: Vec4::ONE, ..Material::default() };
        let mut notes = Notes::default();
        note_clamped(&[white, Material::default()], &[], &mut notes);
        let notices = notes.finish();
        assert!(notices.len() == 1 && notices[0].message.contains("\"Snow\""), "{notices:?}");
    }
}
