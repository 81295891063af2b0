//! The page, looked at in a headless Chromium.

use std::f64::consts::FRAC_PI_2;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use glam::{DAffine3, DQuat, DVec3};
use image::Rgb;
use luxel::live::Status;
use serde_json::Value;

use super::{baked, cornell, start};

/// Said past the test's captured output: who runs all tests is to see it. Where LUXEL_NO_SKIP is 1 it is a failure.
pub fn skipped(what: &str) {
    assert!(std::env::var_os("LUXEL_NO_SKIP").is_none_or(|value| value != "1"), "LUXEL_NO_SKIP: {what}");
    // Nobody may be listening.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {what}");
}

/// Where the page's sources are.
fn sources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/preview")
}

/// A program on the path.
fn program(names: &[&str]) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
    names.iter().flat_map(|name| folders.iter().map(move |f| f.join(name))).find(|p| p.is_file())
}

/// Node, and a Chromium, where the page can be looked at; what is missing otherwise.
pub fn browser() -> Result<(PathBuf, PathBuf), &'static str> {
    let node = program(&["node"]).ok_or("there is no Node")?;
    let named = std::env::var_os("LUXEL_CHROMIUM").map(PathBuf::from);
    let chromium = named.or_else(|| program(&["chromium", "chromium-browser", "google-chrome"]));
    let chromium = chromium.ok_or("there is no Chromium (LUXEL_CHROMIUM names one)")?;
    if !sources().join("node_modules/playwright-core").is_dir() || !sources().join("dist/index.html").is_file() {
        return Err("the page was not built (npm ci && npm run build in assets/preview)");
    }
    Ok((node, chromium))
}

/// A browser that is ended whatever happens.
pub struct Browser(Child, BufReader<std::process::ChildStdout>);

impl Browser {
    /// Runs a script of the page's tests with an address.
    pub fn open(script: &str, url: &str, shots: &Path, (node, chromium): (PathBuf, PathBuf)) -> Self {
        let mut command = Command::new(node);
        command.arg(sources().join("test").join(script)).arg(url).arg(shots).arg(chromium);
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        Self(child, output)
    }

    pub fn event(&mut self, name: &str) -> Value {
        let mut line = String::new();
        self.1.read_line(&mut line).unwrap();
        let event: Value = serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:?}"));
        assert_eq!(event["event"], name, "{event}");
        event
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It has ended already where all went well.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Mean colour of a part of a picture, given by shares of its sides.
pub fn mean(picture: &image::RgbImage, x: [f64; 2], y: [f64; 2]) -> [f64; 3] {
    let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
    let inside = |(px, py, _): &(u32, u32, &Rgb<u8>)| {
        (x[0]..x[1]).contains(&(f64::from(*px) / width)) && (y[0]..y[1]).contains(&(f64::from(*py) / height))
    };
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for (_, _, pixel) in picture.enumerate_pixels().filter(inside) {
        (0..3).for_each(|c| sum[c] += f64::from(pixel.0[c]));
        count += 1.0;
    }
    sum.map(|s| s / count)
}

#[test]
fn the_page_shows_the_cornell_box_and_a_changed_lamp_without_being_loaded_again() {
    let tools = match browser() {
        Ok(tools) => tools,
        Err(missing) => return skipped(&format!("the page was not looked at: {missing}")),
    };
    let folder = tempfile::tempdir().unwrap();
    // Where a person may look at what the browser saw.
    let shots = std::env::var_os("LUXEL_SHOTS").map_or_else(|| folder.path().to_path_buf(), PathBuf::from);
    let live = start(&sources().join("dist"));
    let (first, first_report) = baked(&cornell([17.0, 12.0, 4.0]), folder.path(), 256);
    live.tell(&first, Status::Baking);
    // The same from within the high block, whose back sides are not drawn: one sees the floor on which it stands.
    let mut within = cornell([17.0, 12.0, 4.0]);
    let floor = DVec3::new(-0.0925, 0.0, -0.0725);
    let looking_down = DAffine3::from_rotation_translation(DQuat::from_rotation_x(-FRAC_PI_2), floor + 0.08 * DVec3::Y);
    within.cameras[0].transform = looking_down;
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    let (second, report) = baked(&within, &other, 64);
    // Who opens the page before anything was baked sees it as well.
    let mut browser = Browser::open("browser.mjs", &live.url(), &shots, tools);
    browser.event("waiting");
    live.changed(&first, &first_report).unwrap();
    live.changed(&second, &report).unwrap();
    let shown = browser.event("shown");
    let (scene, report) = baked(&cornell([3.0, 9.0, 20.0]), folder.path(), 256);
    let changed = Instant::now();
    live.changed(&scene, &report).unwrap();
    let updated = browser.event("updated");
    eprintln!("drawn {:.0} ms after the files were in place", changed.elapsed().as_secs_f64() * 1e3);
    assert!(updated["revision"].as_u64() > shown["revision"].as_u64());
    let done = browser.event("done");
    assert_eq!(done["kept"], "since the beginning", "the page was not loaded again");
    assert_eq!(done["trouble"], Value::Null);
    assert_eq!(done["errors"], serde_json::json!([]));

    let picture = |name: &str| image::open(shots.join(format!("{name}.png"))).unwrap().to_rgb8();
    let [lit, bytes, albedo, lightmap] = ["lit", "bytes", "albedo", "lightmap"].map(picture);
    // Places in the picture, all free of the panel: two walls, and the back wall above the blocks.
    let left = |p: &_| mean(p, [0.19, 0.27], [0.60, 0.75]);
    let right = |p: &_| mean(p, [0.72, 0.80], [0.35, 0.65]);
    let back = |p: &_| mean(p, [0.36, 0.65], [0.25, 0.35]);
    for colours in [&lit, &albedo, &bytes] {
        let (red, green) = (left(colours), right(colours));
        assert!(red[0] > 2.0 * red[1] && green[1] > 1.3 * green[0], "{red:?} {green:?}");
    }
    let (lit_back, bytes_back) = (back(&lit), back(&bytes));
    assert!(lit_back[0] > 1.3 * lit_back[2], "the lamp is yellow: {lit_back:?}");
    assert!((0..3).all(|c| (lit_back[c] - bytes_back[c]).abs() < 3.0), "{lit_back:?} {bytes_back:?}");
    let white = right(&lightmap);
    assert!(white[0] > white[1] && white[1] > white[2], "light without the wall's green: {white:?}");

    let (density, charts, invalid) = (picture("density"), picture("charts"), picture("invalid"));
    let grey = |colour: [f64; 3]| (0..3).all(|c| (colour[c] - colour[0]).abs() < 3.0);
    assert!(grey(back(&density)) && grey(back(&invalid)), "the density is as usual, and all texels are valid");
    assert!(back(&invalid)[0] > 30.0);
    assert_eq!(colours(&density, 0.02).len(), 2 + 1, "checks of two greys, and nothing around the box");
    assert!(colours(&charts, 0.002).len() > 12, "{:?}", colours(&charts, 0.002));

    let changed_back = back(&picture("changed"));
    assert!(changed_back[2] > 1.3 * changed_back[0], "the lamp is blue: {changed_back:?}");
    let red = mean(&picture("buried"), [0.45, 0.65], [0.4, 0.6]);
    let legend = [237.0, 69.0, 55.0];
    assert!((0..3).all(|c| (red[c] - legend[c]).abs() < 2.0), "the floor below a block is buried: {red:?}");
}

/// Colours, in steps of sixteen, that have at least a share of a picture's right half, where no panel is.
fn colours(picture: &image::RgbImage, share: f64) -> Vec<[u8; 3]> {
    let mut counts = std::collections::BTreeMap::<[u8; 3], u32>::new();
    for (_, _, pixel) in picture.enumerate_pixels().filter(|(x, ..)| *x > picture.width() / 2) {
        *counts.entry(pixel.0.map(|c| c / 16)).or_default() += 1;
    }
    let least = share * f64::from(picture.width() / 2) * f64::from(picture.height());
    counts.into_iter().filter(|(_, count)| f64::from(*count) >= least).map(|(colour, _)| colour).collect()
}
