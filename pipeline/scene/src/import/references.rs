//! Do all references within the document lead somewhere?
//!
//! Checked once for the whole document, also where the bake needs nothing of it, because the outputs carry the whole
//! scene on. Whether the bytes behind an accessor suffice is checked where they are read.

use super::document::Document;
use super::error::{Checked, Fault, place};

/// Refuses the first reference that leads nowhere, by name.
pub fn check(document: &Document) -> Checked<()> {
    let root = &document.root;
    let within = |index: usize, count: usize, kind: &str, place: &dyn Fn() -> String| {
        if index < count {
            return Ok(());
        }
        Err(Fault::invalid(place(), format!("it refers to {kind} {index}, but there are {count}")))
    };
    let view = |index: usize, place: &dyn Fn() -> String| within(index, root.buffer_views.len(), "bufferView", place);
    let accessor = |index: usize, place: &dyn Fn() -> String| within(index, root.accessors.len(), "accessor", place);
    let node = |index: usize, place: &dyn Fn() -> String| within(index, root.nodes.len(), "node", place);

    if let Some(scene) = root.scene {
        within(scene.value(), root.scenes.len(), "scene", &|| "scene".into())?;
    }
    for (i, scene) in root.scenes.iter().enumerate() {
        for child in &scene.nodes {
            node(child.value(), &|| place("scene", i, scene.name.as_deref()))?;
        }
    }
    for (i, n) in root.nodes.iter().enumerate() {
        let at = || document.node_place(i);
        for child in n.children.iter().flatten() {
            node(child.value(), &at)?;
        }
        for (index, count, kind) in [
            (n.mesh.map(|m| m.value()), root.meshes.len(), "mesh"),
            (n.camera.map(|c| c.value()), root.cameras.len(), "camera"),
            (n.skin.map(|s| s.value()), root.skins.len(), "skin"),
        ] {
            index.map_or(Ok(()), |index| within(index, count, kind, &at))?;
        }
    }
    for (i, mesh) in root.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            let at = || format!("{} primitive {p}", document.mesh_place(i));
            for index in primitive.attributes.values().chain(&primitive.indices) {
                accessor(index.value(), &at)?;
            }
            for target in primitive.targets.iter().flatten() {
                for index in [target.positions, target.normals, target.tangents].into_iter().flatten() {
                    accessor(index.value(), &at)?;
                }
            }
            if let Some(material) = primitive.material {
                within(material.value(), root.materials.len(), "material", &at)?;
            }
        }
    }
    for (i, skin) in root.skins.iter().enumerate() {
        let at = || place("skin", i, skin.name.as_deref());
        for joint in &skin.joints {
            node(joint.value(), &at)?;
        }
        if let Some(matrices) = skin.inverse_bind_matrices {
            accessor(matrices.value(), &at)?;
        }
    }
    for (i, a) in root.accessors.iter().enumerate() {
        let at = || place("accessor", i, a.name.as_deref());
        let sparse = a.sparse.iter().flat_map(|s| [s.indices.buffer_view, s.values.buffer_view]);
        for index in a.buffer_view.into_iter().chain(sparse) {
            view(index.value(), &at)?;
        }
    }
    for (i, v) in root.buffer_views.iter().enumerate() {
        let at = || place("bufferView", i, v.name.as_deref());
        within(v.buffer.value(), root.buffers.len(), "buffer", &at)?;
        let end = v.byte_offset.map_or(0, |o| o.0).checked_add(v.byte_length.0);
        let size = root.buffers.get(v.buffer.value()).map_or(0, |b| b.byte_length.0);
        if end.is_none_or(|end| end > size) {
            let what = format!("it ends beyond buffer {} of {size} bytes", v.buffer.value());
            return Err(Fault::invalid(at(), what));
        }
    }
    for (i, texture) in root.textures.iter().enumerate() {
        let at = || place("texture", i, texture.name.as_deref());
        // The model spells a missing source as the largest index.
        if texture.source.value() != u32::MAX as usize {
            within(texture.source.value(), root.images.len(), "image", &at)?;
        }
        if let Some(sampler) = texture.sampler {
            within(sampler.value(), root.samplers.len(), "sampler", &at)?;
        }
    }
    for (i, image) in root.images.iter().enumerate() {
        if let Some(index) = image.buffer_view {
            view(index.value(), &|| document.image_place(i))?;
        }
    }
    material_textures(document)
}

fn material_textures(document: &Document) -> Checked<()> {
    let count = document.root.textures.len();
    for (i, m) in document.root.materials.iter().enumerate() {
        let pbr = &m.pbr_metallic_roughness;
        let infos = [&pbr.base_color_texture, &pbr.metallic_roughness_texture, &m.emissive_texture];
        let infos = infos.into_iter().flatten().map(|info| info.index);
        let maps = m.normal_texture.iter().map(|t| t.index).chain(m.occlusion_texture.iter().map(|t| t.index));
        if let Some(index) = infos.chain(maps).map(|index| index.value()).find(|&index| index >= count) {
            let what = format!("it refers to texture {index}, but there are {count}");
            return Err(Fault::invalid(document.material_place(i), what));
        }
    }
    Ok(())
}
