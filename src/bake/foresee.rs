//! What a bake would reuse, found out without baking: by the keys that the bake asks the store for.

use luxel_atlas::{Layout, layout::Source};
use luxel_scene::Scene;

use super::cause::Cause;
use super::groups::{Group, Lighting};
use super::keys::{self, GroupKeys, Keys};
use crate::plan::{Plan, Stage};
use crate::store::{Kind, Store};

/// Marks the stages in a plan that stored artefacts will stand for, and says why the others have to run.
pub fn mark(plan: &mut Plan, store: &Store, scene: &Scene, lighting: &Lighting, keys: &Keys, why: &Cause) {
    let run = Run::new(plan, store, lighting, keys);
    let reason = format!("stored: {}", why.of_reuse());
    let unwraps = || {
        let layout = Layout::new(scene);
        let mut sources = scene.instances.iter().zip(&layout.sources);
        sources.all(|(instance, source)| match source {
            Source::Unwrap(_) => store.has(Kind::Unwrap, &keys::unwrap(&scene.meshes[instance.mesh])),
            Source::None | Source::Authored(_) => true,
        })
    };
    let reused = [
        (Stage::Unwrap, plan.runs(Stage::Unwrap) && store.has(Kind::Layout, &keys.layout) && unwraps()),
        (Stage::Surfels, !run.surfels),
        (Stage::Shoot, !run.shoot),
        (Stage::Propagate, !run.solution),
        (Stage::Refresh, !run.solution),
        (Stage::Cache, !run.solution),
        (Stage::Clear, !run.clear),
        (Stage::Direct, !run.direct),
        (Stage::Sky, !run.sky),
        (Stage::Gather, !run.gather),
        (Stage::Finish, !run.finish),
    ];
    for (stage, reused) in reused {
        match why.of_run(stage) {
            _ if reused => plan.reuse(stage, &reason),
            Some(why) => plan.explain(stage, &why),
            None => {}
        }
    }
}

/// Whether light would have to be gathered at texels, which is what takes long.
pub fn gathers(plan: &Plan, store: &Store, lighting: &Lighting, keys: &Keys) -> bool {
    let run = Run::new(plan, store, lighting, keys);
    let sky = run.sky && plan.runs(Stage::Sky);
    plan.runs(Stage::Clear) && !lighting.groups.is_empty() && (run.clear || run.direct || sky || run.gather)
}

/// All light of a group at texels is stored, and where these are.
pub fn is_stored(plan: &Plan, store: &Store, (group, own): (&Group, &GroupKeys), keys: &Keys) -> bool {
    let mut run = Run { clear: !store.has(Kind::Clear, &keys.clear), ..Run::default() };
    run.sky = group.sky.is_some() && plan.runs(Stage::Sky) && !store.has(Kind::Sky, &keys.sky);
    run.group(plan, store, group, own, keys);
    !(run.clear || run.direct || run.sky || run.gather)
}

/// Which stages would run, for one light group at least.
#[derive(Default)]
struct Run {
    surfels: bool,
    shoot: bool,
    solution: bool,
    clear: bool,
    direct: bool,
    sky: bool,
    gather: bool,
    finish: bool,
}

impl Run {
    fn new(plan: &Plan, store: &Store, lighting: &Lighting, keys: &Keys) -> Self {
        let mut run = Self::default();
        if !plan.runs(Stage::Finish) || store.has(Kind::Finish, &keys.finish) {
            return run;
        }
        run.finish = true;
        run.clear = !store.has(Kind::Clear, &keys.clear);
        run.sky = lighting.groups.iter().any(|g| g.sky.is_some()) && !store.has(Kind::Sky, &keys.sky);
        for (group, own) in lighting.groups.iter().zip(&keys.groups) {
            run.group(plan, store, group, own, keys);
        }
        run
    }

    fn group(&mut self, plan: &Plan, store: &Store, group: &Group, own: &GroupKeys, keys: &Keys) {
        let shines = !group.sources.is_empty();
        self.direct |= shines && plan.runs(Stage::Direct) && !store.has(Kind::Direct, &own.direct);
        if !plan.runs(Stage::Gather) || store.has(Kind::Gather, &own.gather) {
            return;
        }
        self.gather = true;
        if store.has(Kind::Solution, &own.solution) {
            return;
        }
        self.solution = true;
        self.surfels |= !store.has(Kind::Surfels, &keys.surfels);
        self.shoot |= shines && plan.runs(Stage::Shoot) && !store.has(Kind::Shoot, &own.shoot);
    }
}
