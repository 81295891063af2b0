//! A bake of a level, what ran for it, and what of it has to be the same whatever ran.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::Vec3;
use luxel::plan::Plan;
use luxel::settings::{Layer, Origin, Resolved, for_scene};
use luxel::store::StoreOptions;
use luxel::{Kept, Request, bake, plan_file};
use luxel_export::OutputSet;
use luxel_scene::Silent;
use serde_json::Value;
use tempfile::TempDir;

use crate::level::{Level, SCENE};
use crate::tool::{files, lightmap};

/// A folder with a level in it and a store that stays.
pub struct Place {
    pub folder: TempDir,
    /// As a watch has it: what its bakes keep in memory for each other.
    kept: Kept,
}

/// The files of a bake.
#[derive(Clone, Debug)]
pub struct Baked {
    /// Without the report.
    pub files: BTreeMap<String, Vec<u8>>,
    pub report: Value,
    /// Irradiance of all pages [lux]. Files of other inputs are other files in any case: they hold a digest of them.
    pub light: Vec<Vec3>,
    /// What lies in the store after it, by its place there, as digests of the files.
    stored: BTreeMap<String, blake3::Hash>,
}

/// Where a bake writes and what it remembers.
pub struct Target {
    pub out: PathBuf,
    pub store: StoreOptions,
}

impl Target {
    /// Outputs in a folder, with the store in them.
    pub fn at(out: impl Into<PathBuf>) -> Self {
        Self { out: out.into(), store: StoreOptions::default() }
    }

    fn stored(&self) -> BTreeMap<String, blake3::Hash> {
        let digest = |(name, bytes): (String, Vec<u8>)| (name, blake3::hash(&bytes));
        files(self.store.open(&self.out).folder()).into_iter().map(digest).collect()
    }

    /// With a store elsewhere.
    pub fn with_store(self, folder: impl Into<PathBuf>) -> Self {
        Self { store: StoreOptions { folder: Some(folder.into()), ..self.store }, ..self }
    }
}

impl Place {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), kept: Kept::default() }
    }

    pub fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Where its bakes go unless something else is said.
    pub fn target(&self) -> Target {
        Target::at(self.at("baked"))
    }

    /// Writes the level and bakes it, with what was stored before.
    pub fn bake(&self, level: &Level) -> Baked {
        level.write(self.folder.path());
        run_on(&self.at(SCENE), &self.target(), &self.kept)
    }

    /// The same with a plan before; panics where the bake does something else than was foreseen.
    pub fn bake_as_planned(&self, level: &Level) -> Baked {
        level.write(self.folder.path());
        let scene = self.at(SCENE);
        let planned = plan(&scene, &self.target());
        let baked = run_on(&scene, &self.target(), &self.kept);
        if let Err(why) = baked.is_as(&planned) {
            panic!("{why}");
        }
        baked
    }
}

fn resolved(scene: &Path) -> Resolved {
    for_scene(scene, None, &Layer::new(Origin::CommandLine)).unwrap()
}

/// Bakes in this process, whether the scene is current or not.
pub fn run(scene: &Path, target: &Target) -> Baked {
    run_on(scene, target, &Kept::default())
}

/// The same with what is kept in memory of the bakes before.
fn run_on(scene: &Path, target: &Target, kept: &Kept) -> Baked {
    let outputs = OutputSet::new(scene, Some(&target.out), None).unwrap();
    let request = Request {
        scene: scene.into(),
        outputs,
        settings: resolved(scene),
        worker: None,
        store: target.store.clone(),
        kept: kept.clone(),
    };
    bake(&request, &Silent).unwrap_or_else(|e| panic!("{e:?}"));
    Baked { stored: target.stored(), ..Baked::read(&target.out) }
}

/// Bakes to a place where nothing was ever stored.
pub fn clean(scene: &Path) -> Baked {
    let folder = tempfile::tempdir().unwrap();
    run(scene, &Target::at(folder.path()))
}

pub fn plan(scene: &Path, target: &Target) -> Plan {
    let outputs = OutputSet::new(scene, Some(&target.out), None).unwrap();
    plan_file(scene, Some((&outputs, &target.store)), &resolved(scene), &Silent).unwrap()
}

impl Baked {
    /// The outputs of the only scene in a folder.
    pub fn read(out: &Path) -> Self {
        let mut files = files(out);
        let name = files.keys().find(|name| name.ends_with(".bake.json")).expect("there is a report").clone();
        let report = serde_json::from_slice(&files.remove(&name).unwrap()).unwrap();
        let pages = files.keys().filter(|name| name.contains(".lightmap."));
        let light = pages.flat_map(|name| lightmap(&out.join(name)).irradiance().to_vec()).collect();
        Self { files, report, light, stored: BTreeMap::new() }
    }

    fn stages(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.report["stages"].as_array().unwrap().iter().map(|s| (s["name"].as_str().unwrap(), s))
    }

    pub fn stage(&self, name: &str) -> &Value {
        self.stages().find(|(n, _)| *n == name).unwrap_or_else(|| panic!("no stage {name}")).1
    }

    pub fn count(&self, stage: &str, counter: &str) -> u64 {
        self.stage(stage)["counters"][counter].as_u64().unwrap_or_else(|| panic!("{stage} does not count {counter}"))
    }

    /// The names of the stages that ran.
    pub fn ran(&self) -> Vec<&str> {
        self.stages().filter(|(_, stage)| stage["state"] == "ran").map(|(name, _)| name).collect()
    }

    /// Messages of all warnings with this code.
    pub fn warnings(&self, code: &str) -> Vec<&str> {
        let list = self.report["warnings"].as_array().unwrap();
        list.iter().filter(|w| w["code"] == code).map(|w| w["message"].as_str().unwrap()).collect()
    }

    /// Whether the bake did what was planned, stage by stage, and for the same reasons.
    pub fn is_as(&self, plan: &Plan) -> Result<(), String> {
        for step in &plan.steps {
            let name = step.stage.name();
            let planned = match (step.runs, step.reused) {
                (false, _) => "left out",
                (true, true) => "reused",
                (true, false) => "ran",
            };
            let Some((_, stage)) = self.stages().find(|(n, _)| *n == name) else {
                return Err(format!("{name} was planned as {planned} and is not in the report"));
            };
            // Of what ran the bake knows more in the end.
            let reason = stage["reason"].as_str().unwrap();
            let is_told = reason == step.reason || planned == "ran" && reason.starts_with(&step.reason);
            if stage["state"] != planned || !is_told {
                return Err(format!("{name} was planned as {planned} ({}) and was {stage}", step.reason));
            }
        }
        Ok(())
    }

    /// Where nothing is removed from the store, no stage runs because it was.
    pub fn forgot_nothing(&self) -> Result<(), String> {
        let forgot = self.stages().find(|(_, stage)| stage["reason"].as_str().unwrap().contains("not stored any more"));
        forgot.map_or(Ok(()), |(name, stage)| Err(format!("{name} ran for another reason than it says: {stage}")))
    }

    /// Whether it is the same bake, whatever ran for it.
    pub fn is_same(&self, other: &Self) -> Result<(), String> {
        let names = |baked: &Self| baked.files.keys().cloned().collect::<Vec<_>>();
        if names(self) != names(other) {
            return Err(format!("files {:?} and not {:?}", names(self), names(other)));
        }
        let (mine, others) = (self.lasting(), other.lasting());
        let differs = self.files.iter().filter(|(name, bytes)| other.files[*name] != **bytes);
        let mut different: Vec<String> = differs.map(|(name, _)| name.clone()).collect();
        for (key, value) in mine.as_object().unwrap() {
            if others[key] != *value {
                different.push(format!("{key} of the report: {value}\n  and not {}", others[key]));
            }
        }
        // What lies under one key has one content, whatever of it was reused.
        for (name, digest) in &other.stored {
            let mine = self.stored.get(name);
            if mine.map_or(name.starts_with("finish"), |mine| mine != digest) {
                different.push(format!("stored {name}: {}", mine.map_or("not there", |_| "another content")));
            }
        }
        if different.is_empty() && mine == others { Ok(()) } else { Err(different.join("\n")) }
    }

    /// The report without times and without what only tells what ran in this very bake.
    fn lasting(&self) -> Value {
        let mut report = self.report.clone();
        let leave_out = |of: &mut Value, names: &[&str]| {
            if let Some(map) = of.as_object_mut() {
                map.retain(|name, _| !names.contains(&name.as_str()));
            }
        };
        for stage in report["stages"].as_array_mut().unwrap() {
            leave_out(stage, &["state", "reason", "seconds"]);
            leave_out(&mut stage["counters"], &["stored_unwraps", "bytes"]);
        }
        // Rays that this bake traced.
        let traced = ["primary_photons", "arrived_photons", "continuous_rays", "discrete_rays"];
        leave_out(&mut report["counters"], &traced);
        if let Some(table) = report["table1"].as_object_mut() {
            table.retain(|name, _| {
                !(name == "state" || name.ends_with("seconds") || name.ends_with("_second") || name.contains("_over_"))
            });
        }
        leave_out(&mut report["energy"], &["state"]);
        report
    }
}
