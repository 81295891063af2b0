//! What a bake would reuse, found out without baking: by the keys that the bake asks the store for.

use luxel_atlas::{Layout, layout::Source};
use luxel_scene::{Progress, Scene};

use super::cause::Cause;
use super::groups::{Group, Lighting};
use super::keys::{self, GroupKeys, Keys};
use super::light_of;
use crate::Error;
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

/// What an export says where it is not stored which texels are buried.
pub const CLEARED: &str = "which texels are buried (the stage clear)";

/// What an export of stored light needs and would not find, the first of it; nothing is made or written.
///
/// # Errors
/// It was cancelled.
pub fn missing(
    plan: &Plan,
    store: &Store,
    scene: &Scene,
    lighting: &Lighting,
    keys: &Keys,
    progress: &dyn Progress,
) -> Result<Option<String>, Error> {
    let is_finished = !plan.runs(Stage::Finish) || store.has(Kind::Finish, &keys.finish);
    if plan.runs(Stage::Clear) && !lighting.groups.is_empty() && !is_finished {
        for (group, own) in lighting.groups.iter().zip(&keys.groups) {
            progress.check()?;
            if !is_lit(plan, store, (group, own), keys) {
                return Ok(Some(light_of(&group.name)));
            }
        }
        if !store.has(Kind::Clear, &keys.clear) {
            return Ok(Some(CLEARED.into()));
        }
    }
    if !plan.runs(Stage::Unwrap) {
        return Ok(None);
    }
    let layout = Layout::build(scene, progress)?;
    for (instance, source) in scene.instances.iter().zip(&layout.sources) {
        progress.check()?;
        let mesh = &scene.meshes[instance.mesh];
        if matches!(source, Source::Unwrap(_)) && !store.has(Kind::Unwrap, &keys::unwrap(mesh)) {
            return Ok(Some(unwrap_of(&instance.name)));
        }
    }
    Ok((!store.has(Kind::Layout, &keys.layout)).then(|| LAYOUT.into()))
}

/// What an export says of an object whose unwrap it misses.
pub fn unwrap_of(object: &str) -> String {
    format!("the unwrap of {object:?}")
}

/// What an export says where it is not stored how the atlas is laid out.
pub const LAYOUT: &str = "the layout of the atlas (the stage unwrap)";

/// All light of a group at texels is stored, and where these are.
pub fn is_stored(plan: &Plan, store: &Store, (group, own): (&Group, &GroupKeys), keys: &Keys) -> bool {
    store.has(Kind::Clear, &keys.clear) && is_lit(plan, store, (group, own), keys)
}

/// All light of a group at texels is stored.
fn is_lit(plan: &Plan, store: &Store, (group, own): (&Group, &GroupKeys), keys: &Keys) -> bool {
    let sky = group.sky.is_some() && plan.runs(Stage::Sky) && !store.has(Kind::Sky, &keys.sky);
    let mut run = Run { sky, ..Run::default() };
    run.group(plan, store, group, own, keys);
    !(run.direct || run.sky || run.gather)
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
