//! The real binary under a time limit, and its outputs read back as a stranger would: by the names in the report, the
//! hashes, the .exr and the .glb.

#![allow(dead_code)] // Every test binary uses its part of this.

pub mod client;
pub mod skip;
pub mod watcher;

use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use glam::{DVec3, Vec2, Vec3};
use luxel_export::{Lightmap, sample_lightmap};
use luxel_scene::{ImportOptions, Scene, import};
use luxel_transport::{geometry::Geometry, rays::Rays, sampling::r2};
use serde_json::Value;
use tempfile::TempDir;

/// No bake of a test scene takes longer, on a loaded machine of two cores.
pub const LIMIT: Duration = Duration::from_secs(120);

/// What a run of the binary left behind.
pub struct Run {
    /// None when a signal ended it.
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

/// Runs the binary in a folder; panics when it takes longer than [`LIMIT`].
pub fn luxel(args: &[&str], folder: &Path) -> Run {
    let [mut out, mut err] = [tempfile::tempfile().unwrap(), tempfile::tempfile().unwrap()];
    let mut child = Command::new(env!("CARGO_BIN_EXE_luxel"))
        .args(args)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(out.try_clone().unwrap())
        .stderr(err.try_clone().unwrap())
        .spawn()
        .unwrap();
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if start.elapsed() > LIMIT {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("luxel {} hangs: {}", args.join(" "), read(&mut err));
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    Run { code: status.code(), stdout: read(&mut out), stderr: read(&mut err) }
}

fn read(file: &mut std::fs::File) -> String {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(0)).unwrap();
    file.read_to_end(&mut bytes).unwrap();
    String::from_utf8(bytes).unwrap()
}

impl Run {
    /// Ended by itself with this code, without an internal error.
    pub fn ended(self, code: i32) -> Self {
        assert!(self.code == Some(code), "exit code {:?}, not {code}: {}{}", self.code, self.stdout, self.stderr);
        assert!(!self.stderr.contains("internal error") && !self.stderr.contains("panicked"), "{}", self.stderr);
        self
    }
}

/// Settings with which a shipped scene bakes in a moment.
pub const QUICK: [&str; 8] = ["--preset", "draft", "--size", "64", "--voxels", "3000", "--directions", "64"];

/// Runs the binary with [`QUICK`].
pub fn quick(args: &[&str], folder: &Path) -> Run {
    luxel(&[args, &QUICK].concat(), folder)
}

/// A folder with copies of shipped scenes.
pub fn folder(scenes: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for scene in scenes {
        std::fs::copy(asset(scene), folder.path().join(scene)).unwrap();
    }
    folder
}

/// JSON and binary chunk of a shipped scene.
pub fn parts(name: &str) -> (Value, Vec<u8>) {
    let bytes = std::fs::read(asset(name)).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let (json, rest) = bytes[20..].split_at(length);
    (serde_json::from_slice(json).unwrap(), rest[8..].to_vec())
}

/// A scene that luxel ships.
pub fn asset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets").join(name)
}

/// Where the real scenes are, or None with a plain word about it.
pub fn scenes() -> Option<PathBuf> {
    let path = std::env::var_os("LUXEL_SCENES")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/scenes")), PathBuf::from);
    if path.join("expected.json").is_file() {
        return Some(path);
    }
    eprintln!("SKIPPED: no scenes at {} (set LUXEL_SCENES)", path.display());
    None
}

/// All .gltf and .glb below a folder, sorted, relative to it.
pub fn scene_files(root: &Path) -> Vec<String> {
    let is_scene = |p: &&String| p.ends_with(".gltf") || p.ends_with(".glb");
    files(root).keys().filter(is_scene).cloned().collect()
}

/// Name and content of every file below a folder, hidden ones left out.
pub fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(path) = open.pop() {
        for entry in std::fs::read_dir(path).unwrap() {
            let path = entry.unwrap().path();
            if path.file_name().unwrap().as_encoded_bytes().starts_with(b".") {
                continue;
            } else if path.is_dir() {
                open.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                files.insert(name, std::fs::read(&path).unwrap());
            }
        }
    }
    files
}

/// The outputs of one bake, read back and checked against each other.
pub struct Outputs {
    pub report: Value,
    /// The .glb's JSON.
    pub document: Value,
    /// The .glb through luxel's own import.
    pub scene: Scene,
    /// By page.
    pub lightmaps: Vec<Lightmap>,
}

impl Outputs {
    /// Reads `stem`'s outputs from a folder. Panics where the contract is broken: a file that the report does not
    /// name or names wrongly, a wrong hash, a lightmap with something that is no light.
    pub fn read(folder: &Path, stem: &str) -> Self {
        let report = std::fs::read(folder.join(format!("{stem}.bake.json"))).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        let listed: Vec<&str> =
            report["outputs"].as_array().unwrap().iter().map(|o| o["path"].as_str().unwrap()).collect();
        for output in report["outputs"].as_array().unwrap() {
            let bytes = std::fs::read(folder.join(output["path"].as_str().unwrap())).unwrap();
            assert_eq!(output["blake3"], blake3::hash(&bytes).to_hex().as_str(), "{stem}: {}", output["path"]);
            assert_eq!(output["bytes"], bytes.len(), "{stem}: {}", output["path"]);
        }
        let is_lightmap = |name: &&&str| name.contains(".lightmap.");
        let pages = listed.iter().filter(is_lightmap).count();
        let names: Vec<String> = match pages {
            1 => vec![format!("{stem}.lightmap.exr")],
            _ => (0..pages).map(|i| format!("{stem}.lightmap.{i}.exr")).collect(),
        };
        assert!(listed.iter().filter(is_lightmap).eq(names.iter()), "{stem}: {listed:?}");
        // A scene in which nothing receives light has no lightmap and no picture of it.
        let receives = report["counters"]["texels"].as_u64().unwrap() > 0;
        let preview = format!("{stem}.preview.png");
        assert!(listed.contains(&format!("{stem}.glb").as_str()), "{stem}: {listed:?}");
        let shows = listed.contains(&preview.as_str());
        assert_eq!((receives, receives && report["draft"] != true), (pages > 0, shows), "{stem}: {listed:?}");
        let lightmaps = names.iter().map(|n| lightmap(&folder.join(n))).collect();
        let glb = folder.join(format!("{stem}.glb"));
        let scene = import::load(&glb, &import_all()).unwrap_or_else(|e| panic!("{e}"));
        let bytes = std::fs::read(&glb).unwrap();
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let document = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        if shows {
            let preview = image::open(folder.join(preview)).unwrap();
            assert!(preview.width() >= 16 && preview.height() >= 16, "{stem}");
        }
        Self { report, document, scene, lightmaps }
    }

    /// Messages of all warnings with this code.
    pub fn warnings(&self, code: &str) -> Vec<&str> {
        let list = self.report["warnings"].as_array().unwrap();
        list.iter().filter(|w| w["code"] == code).map(|w| w["message"].as_str().unwrap()).collect()
    }

    /// State and reason of a stage.
    pub fn stage(&self, name: &str) -> (&str, &str) {
        let stages = self.report["stages"].as_array().unwrap();
        let stage = stages.iter().find(|s| s["name"] == name).unwrap_or_else(|| panic!("no stage {name}"));
        (stage["state"].as_str().unwrap(), stage["reason"].as_str().unwrap())
    }

    /// The page of an instance's texels.
    fn page(&self, instance: usize) -> u32 {
        let instance = &self.scene.instances[instance];
        match &self.document["nodes"][instance.node]["extras"]["lightmap"] {
            Value::Number(n) => n.as_u64().unwrap() as u32,
            Value::Array(list) => {
                let primitive = self.scene.meshes[instance.mesh].gltf_primitive;
                list[primitive].as_u64().unwrap() as u32
            }
            _ => 0,
        }
    }

    /// The lightmap where a barycentric point of a triangle is.
    pub fn at(&self, instance: usize, triangle: usize, u: f32, v: f32) -> Option<Vec3> {
        let mesh = &self.scene.meshes[self.scene.instances[instance].mesh];
        let uvs = mesh.uvs.get(1).filter(|uvs| !uvs.is_empty())?;
        let [a, b, c]: [Vec2; 3] = mesh.triangles[triangle].map(|i| uvs[i as usize]);
        Some(sample_lightmap(&self.lightmaps, self.page(instance), a * (1.0 - u - v) + b * u + c * v))
    }
}

/// Everything is read, also what moves: a bake's outputs keep it.
pub fn import_all() -> ImportOptions {
    ImportOptions { bake_animated: true, ..ImportOptions::default() }
}

/// A lightmap file. Panics where a texel is no light.
pub fn lightmap(path: &Path) -> Lightmap {
    use exr::prelude::*;
    type Pixels = (usize, Vec<Vec3>, Vec<f32>);
    let image = read_first_rgba_layer_from_file(
        path,
        |size, _| -> Pixels { (size.width(), vec![Vec3::ZERO; size.area()], vec![0.0; size.area()]) },
        |(width, light, coverage): &mut Pixels, at, (r, g, b, a): (f32, f32, f32, f32)| {
            let i = at.y() * *width + at.x();
            (light[i], coverage[i]) = (Vec3::new(r, g, b), a);
        },
    )
    .unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let size = image.layer_data.size;
    let (_, light, coverage) = image.layer_data.channel_data.pixels;
    Lightmap::new(size.width() as u32, size.height() as u32, light, coverage)
        .unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// How far two bakes are apart, over the mean.
#[derive(Clone, Copy, Debug)]
pub struct Difference {
    pub points: usize,
    pub rmse: f64,
    pub bias: f64,
    pub median: f64,
}

/// Compares two bakes of one scene at equal places of its surfaces, whatever their meshes, charts and texels. Places
/// of `b` are those of `a` times `scale`. Places that are not surely the same surface in both are left out.
pub fn difference(a: &Outputs, b: &Outputs, scale: f64, points: u32) -> Difference {
    let geometries = [a, b].map(|o| Geometry::new(&o.scene));
    let rays = [Rays::new(&geometries[0]), Rays::new(&geometries[1])];
    let mut ends = Vec::new();
    let mut total = 0.0f64;
    for t in &geometries[0].triangles {
        total += f64::from(t.area());
        ends.push(total);
    }
    let find = |i: usize, p: DVec3, normal: Vec3| {
        let above = geometries[i].frame.point(p) + normal;
        // One frame unit is a four-thousandth of the scene.
        let hit = rays[i].closest(above, -normal, 2.0)?;
        let t = &geometries[i].triangles[hit.triangle as usize];
        let same = !hit.back && t.normal.dot(normal) > 0.999 && (hit.distance - 1.0).abs() < 0.1;
        same.then(|| [a, b][i].at(t.instance as usize, t.index as usize, hit.u, hit.v))?
    };
    let (mut square, mut sum, mut mean, mut count) = (0.0, 0.0, 0.0, 0);
    let mut relative = Vec::new();
    for i in 0..points {
        let wanted = total * (f64::from(i) + 0.5) / f64::from(points);
        let triangle = ends.partition_point(|e| *e < wanted).min(ends.len() - 1);
        let t = &geometries[0].triangles[triangle];
        let (u, v) = luxel_transport::sampling::triangle(r2(i, Vec2::ZERO));
        let p = geometries[0].frame.world(t.at(u, v));
        let (Some(x), Some(y)) = (find(0, p, t.normal), find(1, p * scale, t.normal)) else { continue };
        let d = (y - x).as_dvec3();
        square += d.length_squared() / 3.0;
        sum += d.element_sum() / 3.0;
        mean += x.as_dvec3().element_sum() / 3.0;
        count += 1;
        relative.push(f64::from((y - x).abs().element_sum() / x.element_sum().max(1e-9)));
    }
    assert!(count * 2 > points, "only {count} of {points} places are the same");
    relative.sort_by(f64::total_cmp);
    let n = f64::from(count);
    let mean = mean / n;
    Difference {
        points: count as usize,
        rmse: (square / n).sqrt() / mean,
        bias: sum / n / mean,
        median: relative[relative.len() / 2],
    }
}
