//! The live preview: what the server refuses, what it serves, how soon pages learn of a change, and the page itself in
//! a headless browser.

use std::f64::consts::FRAC_PI_2;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use glam::{DAffine3, DQuat, DVec3};
use image::Rgb;
use luxel::live::{Bundle, Live, Options, Status};
use luxel::settings::{Preset, Resolved, Settings, value::Texels};
use luxel::watch::event::{Done, Event, Fault};
use luxel::{Request, bake};
use luxel_export::OutputSet;
use luxel_scene::{Scene, Silent};
use serde_json::Value;
use tempfile::TempDir;

/// Longer than anything here takes on a loaded machine.
const LIMIT: Duration = Duration::from_secs(60);

/// A folder that could be a page, with something beside it that is nobody's business.
fn page() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["index.html", "preview.js", "preview.css", "secret.txt"] {
        std::fs::write(folder.path().join(name), name).unwrap();
    }
    folder
}

fn start(bundle: &Path) -> Live {
    Live::start(Options { port: 0, bundle: Bundle::Folder(bundle.into()) }).unwrap()
}

fn connect(live: &Live) -> TcpStream {
    let stream = TcpStream::connect(live.address()).unwrap();
    stream.set_read_timeout(Some(LIMIT)).unwrap();
    stream
}

/// Sends bytes as they are; returns the status and the body of the answer.
fn raw(live: &Live, request: &[u8]) -> (u16, Vec<u8>) {
    let mut stream = connect(live);
    stream.write_all(request).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|w| w == b"\r\n\r\n").expect("an answer has a head");
    let status = std::str::from_utf8(&answer[9..12]).unwrap().parse().unwrap();
    (status, answer[end + 4..].to_vec())
}

fn request(live: &Live, method: &str, path: &str) -> (u16, Vec<u8>) {
    let host = live.address();
    raw(live, format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes())
}

fn get(live: &Live, path: &str) -> (u16, Vec<u8>) {
    request(live, "GET", path)
}

/// Somebody who listens to events.
struct Listener(BufReader<TcpStream>);

impl Listener {
    fn new(live: &Live) -> Self {
        let mut stream = connect(live);
        write!(stream, "GET /events HTTP/1.1\r\nHost: {}\r\n\r\n", live.address()).unwrap();
        let mut reader = BufReader::new(stream);
        let mut line = String::new();
        while line != "\r\n" {
            line.clear();
            assert!(reader.read_line(&mut line).unwrap() > 0);
        }
        Self(reader)
    }

    /// The next event: its name and data. Comments are passed over.
    fn next(&mut self) -> Option<(String, Value)> {
        let mut name = String::new();
        loop {
            let mut line = String::new();
            if self.0.read_line(&mut line).unwrap() == 0 {
                return None;
            }
            if let Some(event) = line.trim_end().strip_prefix("event: ") {
                name = event.into();
            } else if let Some(data) = line.strip_prefix("data: ") {
                return Some((name, serde_json::from_str(data).unwrap()));
            }
        }
    }

    /// Scenes up to the word that all is told.
    fn told(&mut self) -> Vec<Value> {
        let mut scenes = Vec::new();
        loop {
            match self.next().expect("the stream goes on") {
                (name, scene) if name == "scene" => scenes.push(scene),
                _ => return scenes,
            }
        }
    }
}

/// Saves a scene and bakes it, quickly; returns the scene file and its report.
fn baked(scene: &Scene, folder: &Path, side: u32) -> (PathBuf, PathBuf) {
    let path = folder.join("level.glb");
    std::fs::write(&path, luxel_assets::glb::write(scene).unwrap()).unwrap();
    let outputs = OutputSet::new(&path, None, None).unwrap();
    let settings = Settings { size: Texels(side), ..Settings::preset(Preset::Draft) };
    let settings = Resolved { settings, ..Resolved::default() };
    let request = Request { scene: path.clone(), outputs, settings, worker: None };
    let done = bake(&request, &Silent).unwrap();
    (path, done.files.last().unwrap().clone())
}

/// The Cornell box under a lamp of another colour.
fn cornell(lamp: [f32; 3]) -> Scene {
    let mut scene = luxel_assets::cornell();
    scene.materials.iter_mut().find(|m| m.name == "light").expect("the box has a lamp").emission = lamp.into();
    scene
}

#[test]
fn it_listens_on_this_machine_only_and_ends_when_dropped() {
    let page = page();
    let live = start(page.path());
    let address = live.address();
    assert_eq!(address.ip(), IpAddr::V4(Ipv4Addr::LOCALHOST));
    assert_eq!(live.url(), format!("http://127.0.0.1:{}/", address.port()));
    assert_eq!(live.notice(), None);
    // All of 127/8 is this machine; what listened at every address would answer here.
    let other = SocketAddr::from((Ipv4Addr::new(127, 0, 0, 2), address.port()));
    assert!(TcpStream::connect_timeout(&other, Duration::from_secs(2)).is_err());
    let mut listener = Listener::new(&live);
    assert!(listener.told().is_empty());
    drop(live);
    assert_eq!(listener.next(), None, "streams end");
    assert!(TcpStream::connect(address).is_err(), "nobody listens any more");
    // The port is free again, and a port that is taken is told.
    let second = Live::start(Options { port: address.port(), ..Options::default() }).unwrap();
    let error = Live::start(Options { port: second.address().port(), ..Options::default() }).unwrap_err();
    assert!(error.to_string().contains(&address.port().to_string()), "{error}");
}

#[test]
fn only_its_own_address_is_answered() {
    let page = page();
    let live = start(page.path());
    let port = live.address().port();
    let as_host = |host: &str| raw(&live, format!("GET / HTTP/1.1\r\n{host}\r\n").as_bytes());
    for good in ["127.0.0.1", "localhost", "[::1]"] {
        assert_eq!(as_host(&format!("Host: {good}:{port}\r\n")), (200, b"index.html".to_vec()));
    }
    let other = port ^ 1;
    for bad in ["evil.example", &format!("evil.example:{port}"), "127.0.0.1", &format!("localhost:{other}"), ""] {
        let (status, body) = as_host(&format!("Host: {bad}\r\n"));
        assert_eq!(status, 403, "{bad}");
        assert!(!String::from_utf8_lossy(&body).contains("index.html"));
    }
    assert_eq!(as_host("").0, 403, "no host at all");
}

#[test]
fn paths_lead_nowhere_else() {
    let page = page();
    let folder = tempfile::tempdir().unwrap();
    let (scene, report) = baked(&cornell([17.0, 12.0, 4.0]), folder.path(), 32);
    let live = start(page.path());
    live.changed(&scene, &report).unwrap();
    assert_eq!(get(&live, "/scenes/0/files/0").0, 200);
    for path in [
        "/secret.txt",
        "/../secret.txt",
        "/%2e%2e/secret.txt",
        "/./secret.txt",
        "//etc/passwd",
        "/etc/passwd",
        "/..%2f..%2fetc%2fpasswd",
        "/..\\..\\secret.txt",
        "/index.html/../secret.txt",
        "/scenes",
        "/scenes/0",
        "/scenes/0/files",
        "/scenes/0/files/",
        "/scenes/0/files/../../../level.glb",
        "/scenes/0/files/level.glb",
        "/scenes/0/files/0/",
        "/scenes/0/files/-1",
        "/scenes/0/files/+0",
        "/scenes/0/files/99",
        "/scenes/0/files/99999999999999999999999",
        "/scenes/1/files/0",
        "/scenes/0/texels/0",
        "/scenes/0/secrets/0",
        "/scenes/../files/0",
    ] {
        assert_eq!(get(&live, path).0, 404, "{path}");
    }
    // The report itself is no output that a page needs, and the scene is none at all.
    let (_, glb) = get(&live, "/scenes/0/files/0");
    assert_eq!(glb, std::fs::read(folder.path().join("baked/level.glb")).unwrap());
}

#[test]
fn a_file_that_is_not_what_the_report_says_is_not_served() {
    let page = page();
    let folder = tempfile::tempdir().unwrap();
    let (scene, report) = baked(&cornell([17.0, 12.0, 4.0]), folder.path(), 32);
    let live = start(page.path());
    live.changed(&scene, &report).unwrap();
    let told = Listener::new(&live).told();
    let glb = told[0]["outputs"]["glb"].as_str().unwrap();
    assert_eq!(get(&live, glb).0, 200);
    assert_eq!(get(&live, &glb.replace("v=", "v=0")).0, 409, "another bake's");
    let path = folder.path().join("baked/level.glb");
    std::fs::write(&path, "somebody else's").unwrap();
    assert_eq!(get(&live, glb).0, 409);
    #[cfg(unix)]
    {
        std::fs::remove_file(&path).unwrap();
        std::os::unix::fs::symlink(page.path().join("secret.txt"), &path).unwrap();
        assert_eq!(get(&live, glb).0, 409);
    }
    let error = live.changed(&scene, &folder.path().join("none.bake.json")).unwrap_err();
    assert!(error.to_string().contains("none.bake.json"), "{error}");
}

#[test]
fn only_small_requests_without_body_are_answered() {
    let page = page();
    let live = start(page.path());
    let host = format!("Host: {}\r\n", live.address());
    let lines = |request: &str| raw(&live, format!("{request} HTTP/1.1\r\n{host}\r\n").as_bytes()).0;
    for method in ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT"] {
        assert_eq!(lines(&format!("{method} /")), 405, "{method}");
    }
    assert_eq!(request(&live, "HEAD", "/"), (200, Vec::new()));
    assert_eq!(request(&live, "HEAD", "/events"), (200, Vec::new()));
    let body = format!("GET / HTTP/1.1\r\n{host}Content-Length: 1000000\r\n\r\n{}", "x".repeat(1_000_000));
    assert_eq!(raw(&live, body.as_bytes()).0, 413);
    for long in [
        format!("GET /{} HTTP/1.1\r\n{host}\r\n", "a".repeat(100_000)),
        format!("GET / HTTP/1.1\r\n{host}X: {}\r\n\r\n", "a".repeat(100_000)),
        format!("GET / HTTP/1.1\r\n{host}{}\r\n", "X: y\r\n".repeat(100)),
    ] {
        assert_eq!(raw(&live, long.as_bytes()).0, 431);
    }
    for nonsense in
        [&b"\x16\x03\x01\x02\x00\x01\x00\r\n\r\n"[..], b"GET\r\n\r\n", b"GET / SPDY/9\r\n\r\n", b"\r\n\0\r\n"]
    {
        assert_eq!(raw(&live, nonsense).0, 400, "{nonsense:?}");
    }
    assert_eq!(get(&live, "/").0, 200, "and it goes on");
}

#[test]
fn idle_and_too_many_connections_do_not_stop_it() {
    let page = page();
    let live = start(page.path());
    let begun = Instant::now();
    let mut idle: Vec<TcpStream> = (0..80).map(|_| connect(&live)).collect();
    // Those beyond the limit are told so at once.
    let last = idle.last_mut().unwrap();
    let mut answer = String::new();
    last.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 503"), "{answer}");
    // The others say nothing, and are dropped in time.
    let mut answer = String::new();
    idle[0].read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 408"), "{answer}");
    assert!(begun.elapsed() < LIMIT);
    drop(idle);
    let served = || get(&live, "/").0 == 200;
    assert!((0..200).any(|_| served() || {
        std::thread::sleep(Duration::from_millis(20));
        false
    }));
}

#[test]
fn events_tell_how_scenes_stand_and_what_is_new() {
    let page = page();
    let folder = tempfile::tempdir().unwrap();
    let live = start(page.path());
    let mut early = Listener::new(&live);
    assert!(early.told().is_empty());
    let scene = folder.path().join("level.glb");
    live.tell(&scene, Status::Baking);
    let told = early.told();
    assert_eq!((&told[0]["status"]["state"], &told[0]["outputs"]), (&"baking".into(), &Value::Null));

    let (scene, report) = baked(&cornell([17.0, 12.0, 4.0]), folder.path(), 32);
    live.changed(&scene, &report).unwrap();
    let first = early.told().remove(0);
    assert_eq!(Listener::new(&live).told()[..], *std::slice::from_ref(&first), "who comes later hears the same");
    assert_eq!(first["status"]["state"], "current");
    let outputs = &first["outputs"];
    assert!(outputs["facts"]["mean_irradiance_lux"].as_f64().unwrap() > 0.0);
    assert_eq!(outputs["facts"]["metal_diffuse"], 0.5);
    let (status, texels) = get(&live, outputs["lightmaps"][0]["texels"].as_str().unwrap());
    assert_eq!((status, texels.len()), (200, 16 + 32 * 32 * 8));
    let (status, exr) = get(&live, outputs["lightmaps"][0]["file"].as_str().unwrap());
    assert_eq!((status, exr), (200, std::fs::read(folder.path().join("baked/level.lightmap.exr")).unwrap()));

    // Another lamp: the layout stays, what shines does not.
    let (scene, report) = baked(&cornell([4.0, 12.0, 17.0]), folder.path(), 32);
    live.changed(&scene, &report).unwrap();
    let second = early.told().remove(0);
    assert!(second["revision"].as_u64() > first["revision"].as_u64());
    assert_eq!(second["outputs"]["layout"], first["outputs"]["layout"]);
    assert_ne!(second["outputs"]["content"], first["outputs"]["content"]);
    assert_ne!(second["outputs"]["lightmaps"], first["outputs"]["lightmaps"]);
    // The same light again is nothing new.
    live.changed(&scene, &report).unwrap();
    assert_eq!(early.told()[0]["outputs"], second["outputs"]);

    live.tell(&scene, Status::Failed { error: "broken".into(), causes: vec!["no mesh".into()] });
    let told = early.told().remove(0);
    assert_eq!((&told["status"]["error"], &told["status"]["causes"][0]), (&"broken".into(), &"no mesh".into()));
    assert_eq!(told["outputs"], second["outputs"], "the last good bake stays");
}

#[test]
fn what_a_watch_tells_is_shown() {
    let page = page();
    let folder = tempfile::tempdir().unwrap();
    let (scene, report) = baked(&cornell([17.0, 12.0, 4.0]), folder.path(), 32);
    let live = start(page.path());
    let mut listener = Listener::new(&live);
    listener.told();
    let done = Done { outputs: vec![folder.path().join("baked/level.glb"), report], ..Done::default() };
    let fault = Fault { error: "broken".into(), causes: Vec::new() };
    for (event, state, shows) in [
        (Event::Found { scene: scene.clone() }, "waiting", false),
        (Event::Baking { scene: scene.clone() }, "baking", false),
        (Event::Baked { scene: scene.clone(), done }, "current", true),
        (Event::Failed { scene: scene.clone(), fault }, "failed", true),
        (Event::Current { scene: scene.clone() }, "current", true),
        (Event::Removed { scene: scene.clone() }, "removed", true),
    ] {
        live.follow(&event).unwrap();
        let told = listener.told();
        assert_eq!((told.len(), &told[0]["status"]["state"]), (1, &state.into()), "{event:?}");
        assert_eq!(told[0]["outputs"].is_object(), shows, "{event:?}");
    }
    live.follow(&Event::Idle { scenes: 1, failed: Vec::new() }).unwrap();
    live.tell(&scene, Status::Waiting);
    assert_eq!(listener.told()[0]["status"]["state"], "waiting", "of the others nothing is told");
}

#[test]
fn a_page_that_was_not_built_says_what_to_do() {
    let empty = tempfile::tempdir().unwrap();
    let live = start(empty.path());
    assert!(live.notice().unwrap().contains("npm ci && npm run build"));
    let (status, body) = get(&live, "/");
    assert_eq!(status, 503);
    assert!(String::from_utf8(body).unwrap().contains("npm run build"));
    assert!(Listener::new(&live).told().is_empty(), "the rest works");
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
fn browser() -> Result<(PathBuf, PathBuf), &'static str> {
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
struct Browser(Child, BufReader<std::process::ChildStdout>);

impl Browser {
    fn open(live: &Live, shots: &Path, (node, chromium): (PathBuf, PathBuf)) -> Self {
        let mut command = Command::new(node);
        command.arg(sources().join("test/browser.mjs")).arg(live.url()).arg(shots).arg(chromium);
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        Self(child, output)
    }

    fn event(&mut self, name: &str) -> Value {
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
fn mean(picture: &image::RgbImage, x: [f64; 2], y: [f64; 2]) -> [f64; 3] {
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
        Err(missing) => return eprintln!("SKIPPED: the page was not looked at: {missing}"),
    };
    let folder = tempfile::tempdir().unwrap();
    // Where a person may look at what the browser saw.
    let shots = std::env::var_os("LUXEL_SHOTS").map_or_else(|| folder.path().to_path_buf(), PathBuf::from);
    let live = start(&sources().join("dist"));
    let (scene, report) = baked(&cornell([17.0, 12.0, 4.0]), folder.path(), 256);
    live.changed(&scene, &report).unwrap();
    // The same from within the high block, whose back sides are not drawn: one sees the floor on which it stands.
    let mut within = cornell([17.0, 12.0, 4.0]);
    let floor = DVec3::new(-0.0925, 0.0, -0.0725);
    let looking_down = DAffine3::from_rotation_translation(DQuat::from_rotation_x(-FRAC_PI_2), floor + 0.08 * DVec3::Y);
    within.cameras[0].transform = looking_down;
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    let (second, report) = baked(&within, &other, 64);
    live.changed(&second, &report).unwrap();
    let mut browser = Browser::open(&live, &shots, tools);
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
