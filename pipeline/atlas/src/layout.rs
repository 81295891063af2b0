//! Which instance gets its texels from what: the file's own TEXCOORD_1, or an unwrap of its mesh.

use std::collections::BTreeMap;

use luxel_scene::{Cancelled, Mesh, Progress, Scene, Silent};

use crate::AtlasError;
use crate::authored::{self, Verdict};
use crate::charts::Charts;
use crate::mesh::mesh_key;
use crate::unwrap::{Unwrapper, unwrap_meshes};

/// Content key of a mesh, as [`mesh_key`] gives it.
pub type MeshKey = [u8; 32];
/// Unwraps by mesh content.
pub type Unwraps = BTreeMap<MeshKey, Charts>;

/// Where an instance's UVs come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Gets no texels.
    None,
    /// The unwrap of its mesh.
    Unwrap(MeshKey),
    /// A group of primitives of one node that share an authored layout.
    Authored(usize),
}

/// The sources of a whole scene.
#[derive(Clone, Debug, Default)]
pub struct Layout {
    /// One per instance.
    pub sources: Vec<Source>,
    /// Instances of each authored group.
    pub groups: Vec<Vec<usize>>,
    /// Names of the meshes whose authored layout is kept.
    pub kept: Vec<String>,
    /// Names of meshes whose authored layout cannot serve, and why.
    pub refused: Vec<(String, String)>,
}

impl Layout {
    /// Judges every authored layout and decides for every instance.
    pub fn new(scene: &Scene) -> Self {
        match Self::build(scene, &Silent) {
            Ok(layout) => layout,
            Err(Cancelled) => unreachable!("nobody cancels"),
        }
    }

    /// [`Layout::new`] that can be cancelled.
    pub fn build(scene: &Scene, progress: &dyn Progress) -> Result<Self, Cancelled> {
        let mut nodes: BTreeMap<(usize, usize, Option<u32>), Vec<usize>> = BTreeMap::new();
        for (i, instance) in scene.instances.iter().enumerate().filter(|(_, instance)| instance.receives) {
            let mesh = &scene.meshes[instance.mesh];
            nodes.entry((instance.node, mesh.gltf_mesh, instance.gpu_instance)).or_default().push(i);
        }
        let mut layout = Self { sources: vec![Source::None; scene.instances.len()], ..Self::default() };
        let mut keys: BTreeMap<usize, MeshKey> = BTreeMap::new();
        let mut verdicts: BTreeMap<Vec<usize>, bool> = BTreeMap::new();
        let mut groups: Vec<Vec<usize>> = nodes.into_values().collect();
        // In the order of the instances, not of the nodes, so that neighbours in the file stay neighbours.
        groups.sort_unstable_by_key(|group| group[0]);
        for group in groups {
            progress.check()?;
            let meshes: Vec<usize> = group.iter().map(|&i| scene.instances[i].mesh).collect();
            let kept = match verdicts.get(&meshes) {
                Some(kept) => *kept,
                None => {
                    let kept = layout.judge(scene, &meshes);
                    verdicts.insert(meshes, kept);
                    kept
                }
            };
            for &i in &group {
                let mesh = scene.instances[i].mesh;
                layout.sources[i] = if kept {
                    Source::Authored(layout.groups.len())
                } else {
                    Source::Unwrap(*keys.entry(mesh).or_insert_with(|| mesh_key(&scene.meshes[mesh])))
                };
            }
            if kept {
                layout.groups.push(group);
            }
        }
        Ok(layout)
    }

    fn judge(&mut self, scene: &Scene, meshes: &[usize]) -> bool {
        let shared: Vec<&Mesh> = meshes.iter().map(|&m| &scene.meshes[m]).collect();
        let name = shared.first().map_or_else(String::new, |mesh| mesh.name.clone());
        match authored::judge(&shared) {
            Verdict::Absent => false,
            Verdict::Valid => {
                self.kept.push(name);
                true
            }
            Verdict::Invalid(why) => {
                self.refused.push((name, why));
                false
            }
        }
    }

    /// Adds to `unwraps` what this scene needs and it does not hold yet.
    ///
    /// # Errors
    /// When the unwrapper does not work at all, or when the work was cancelled.
    pub fn complete(
        &self,
        scene: &Scene,
        unwraps: &mut Unwraps,
        unwrapper: &dyn Unwrapper,
        progress: &dyn Progress,
    ) -> Result<(), AtlasError> {
        let mut missing: BTreeMap<MeshKey, usize> = BTreeMap::new();
        for (instance, source) in scene.instances.iter().zip(&self.sources) {
            if let Source::Unwrap(key) = source
                && !unwraps.contains_key(key)
            {
                missing.entry(*key).or_insert(instance.mesh);
            }
        }
        let meshes: Vec<&Mesh> = missing.values().map(|&m| &scene.meshes[m]).collect();
        let charts = unwrap_meshes(&meshes, unwrapper, progress)?;
        unwraps.extend(missing.into_keys().zip(charts));
        Ok(())
    }
}
