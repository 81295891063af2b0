//! Emissive surfaces that may cover others: of several in one plane only what rays meet shines, which is the first. So
//! what a light group gives depends on the surfaces of other groups that come before one of its own and touch it.

use glam::DVec3;
use luxel_scene::Scene;
use luxel_transport::lights::Source;

use super::groups::Group;

/// What is closer touches, as a share of the scene's largest side: four times what transport takes for one plane.
const NEAR: f64 = 1e-6;

/// The boxes of all instances that shine.
pub struct Covers(Vec<(u32, DVec3, DVec3)>);

impl Covers {
    pub fn new(scene: &Scene) -> Self {
        let (lo, hi) = scene.bounds().unwrap_or_default();
        let near = DVec3::splat(NEAR * (hi - lo).max_element());
        let shining = (0..).zip(&scene.instances).filter(|(_, instance)| {
            let material = &scene.materials[scene.meshes[instance.mesh].material];
            material.emits() && !material.unlit && instance.casts
        });
        let boxes = shining.map(|(i, instance)| {
            let mesh = &scene.meshes[instance.mesh];
            let corners = mesh.triangles.iter().flatten().map(|&c| mesh.positions[c as usize].as_dvec3());
            let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
            let (lo, hi) = corners
                .map(|p| instance.transform.transform_point3(p))
                .fold(start, |(lo, hi), p| (lo.min(p), hi.max(p)));
            (i, lo, hi + near)
        });
        Self(boxes.collect())
    }

    /// Those of other groups that may cover something of a group, in their order.
    pub fn of<'a>(&'a self, group: &'a Group) -> impl Iterator<Item = u32> + 'a {
        let is_own = |i: u32| group.sources.contains_key(&Source::Instance(i));
        self.0.iter().filter(move |(i, ..)| !is_own(*i)).filter_map(move |(i, lo, hi)| {
            let touches = |(other, from, to): &(u32, DVec3, DVec3)| {
                other > i && is_own(*other) && lo.cmple(*to).all() && from.cmple(*hi).all()
            };
            self.0.iter().any(touches).then_some(*i)
        })
    }
}
