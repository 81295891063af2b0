//! How much of a lightmap changes when one object moves: why all of a scene is gathered again then.
//!
//! A texel could be left out if its light were shown to change by less than a bound. The bound that a gather states is the
//! only one at hand, so the rows set it beside the change: Cornell box, low block moved by a centimetre.

use luxel::settings::{LightGroups, Preset, Settings, value::Texels};
use luxel::{Lit, bake_scene};
use luxel_scene::{Scene, Silent};

use crate::{Goal, row};

/// The object that is moved, and how far [scene units].
const OBJECT: &str = "low block";
const STEP: f64 = 0.01;

pub fn measure() {
    let settings =
        Settings { size: Texels(256), bound: true, light_groups: LightGroups::One, ..Settings::preset(Preset::Medium) };
    let bake = |scene: &Scene| bake_scene(scene, &settings, &Silent).expect("a bake");
    let mut scene = luxel_assets::cornell();
    let before = bake(&scene);
    scene.instances.iter_mut().find(|i| i.name == OBJECT).expect("the object").transform.translation.x += STEP;
    let after = bake(&scene);
    report(&before, &after);
}

fn report(before: &Lit, after: &Lit) {
    let (a, b) = (&before.texels, &after.texels);
    assert_eq!(a.irradiance.len(), b.irradiance.len(), "a moved object keeps its place on the pages");
    let open: Vec<usize> = (0..a.irradiance.len()).filter(|i| !a.buried[*i] && !b.buried[*i]).collect();
    let mean_of = |f: &dyn Fn(usize) -> f64| open.iter().map(|i| f(*i)).sum::<f64>() / open.len() as f64;
    let light = |i: usize| f64::from(a.irradiance[i].element_sum()) / 3.0;
    let change = |i: usize| f64::from((b.irradiance[i] - a.irradiance[i]).abs().element_sum()) / 3.0;
    let mean = mean_of(&light);
    let above = |most: &dyn Fn(usize) -> f64| 100.0 * mean_of(&|i| f64::from(u8::from(change(i) > most(i))));
    let told = |what: &str, value: f64| row(what, value, "%", Goal::Information);
    told("texels whose light changes at all", above(&|_| 0.0));
    told("  by more than 0.1 % of the mean light", above(&|_| 1e-3 * mean));
    told("  by more than 1 %", above(&|_| 1e-2 * mean));
    told("  by more than their stated bound", above(&|i| f64::from(a.bound[i])));
    told("stated bound of a texel, of the mean light", 100.0 * mean_of(&|i| f64::from(a.bound[i])) / mean);
}
