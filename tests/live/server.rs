//! What the server refuses, what it serves, and how it tells what is new.

use std::io::Read;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use luxel::live::{Live, Options, Status};
use luxel::watch::event::{Done, Event, Fault};
use luxel_export::report::SceneInfo;
use luxel_export::{Depth, Effort, Images, Lightmap, OutputSet, Report};
use serde_json::Value;
use tempfile::TempDir;

use super::tool::client::{Client, LIMIT, Listener};
use super::{baked, cornell, start};

/// A folder that could be a page, with something beside it that is nobody's business.
fn page() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["index.html", "preview.js", "preview.css", "secret.txt"] {
        std::fs::write(folder.path().join(name), name).unwrap();
    }
    folder
}

/// What is told next when nothing of it is still to come.
fn settled(listener: &mut Listener) -> Vec<Value> {
    loop {
        let told = listener.told();
        if told.iter().all(|scene| scene["outputs"]["pending"] != true) {
            return told;
        }
    }
}

fn client(live: &Live) -> Client {
    Client(live.address())
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
    let mut listener = client(&live).listen();
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
    let as_host = |host: &str| client(&live).raw(format!("GET / HTTP/1.1\r\n{host}\r\n").as_bytes());
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
    assert_eq!(client(&live).get("/scenes/0/files/0").0, 200);
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
        assert_eq!(client(&live).get(path).0, 404, "{path}");
    }
    // The report itself is no output that a page needs, and the scene is none at all.
    let (_, glb) = client(&live).get("/scenes/0/files/0");
    assert_eq!(glb, std::fs::read(folder.path().join("baked/level.glb")).unwrap());
}

#[test]
fn a_file_that_is_not_what_the_report_says_is_not_served() {
    let page = page();
    let folder = tempfile::tempdir().unwrap();
    let (scene, report) = baked(&cornell([17.0, 12.0, 4.0]), folder.path(), 32);
    let live = start(page.path());
    live.changed(&scene, &report).unwrap();
    let told = client(&live).listen().told();
    let glb = told[0]["outputs"]["glb"].as_str().unwrap();
    assert_eq!(client(&live).get(glb).0, 200);
    assert_eq!(client(&live).get(&glb.replace("v=", "v=0")).0, 409, "another bake's");
    let path = folder.path().join("baked/level.glb");
    std::fs::write(&path, "somebody else's").unwrap();
    assert_eq!(client(&live).get(glb).0, 409);
    #[cfg(unix)]
    {
        std::fs::remove_file(&path).unwrap();
        std::os::unix::fs::symlink(page.path().join("secret.txt"), &path).unwrap();
        assert_eq!(client(&live).get(glb).0, 409);
    }
    let error = live.changed(&scene, &folder.path().join("none.bake.json")).unwrap_err();
    assert!(error.to_string().contains("none.bake.json"), "{error}");
}

#[test]
fn only_small_requests_without_body_are_answered() {
    let page = page();
    let live = start(page.path());
    let host = format!("Host: {}\r\n", live.address());
    let lines = |request: &str| client(&live).raw(format!("{request} HTTP/1.1\r\n{host}\r\n").as_bytes()).0;
    for method in ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT"] {
        assert_eq!(lines(&format!("{method} /")), 405, "{method}");
    }
    assert_eq!(client(&live).request("HEAD", "/"), (200, Vec::new()));
    assert_eq!(client(&live).request("HEAD", "/events"), (200, Vec::new()));
    let body = format!("GET / HTTP/1.1\r\n{host}Content-Length: 1000000\r\n\r\n{}", "x".repeat(1_000_000));
    assert_eq!(client(&live).raw(body.as_bytes()).0, 413);
    for long in [
        format!("GET /{} HTTP/1.1\r\n{host}\r\n", "a".repeat(100_000)),
        format!("GET / HTTP/1.1\r\n{host}X: {}\r\n\r\n", "a".repeat(100_000)),
        format!("GET / HTTP/1.1\r\n{host}{}\r\n", "X: y\r\n".repeat(100)),
    ] {
        assert_eq!(client(&live).raw(long.as_bytes()).0, 431);
    }
    for nonsense in
        [&b"\x16\x03\x01\x02\x00\x01\x00\r\n\r\n"[..], b"GET\r\n\r\n", b"GET / SPDY/9\r\n\r\n", b"\r\n\0\r\n"]
    {
        assert_eq!(client(&live).raw(nonsense).0, 400, "{nonsense:?}");
    }
    assert_eq!(client(&live).get("/").0, 200, "and it goes on");
}

#[test]
fn idle_and_too_many_connections_do_not_stop_it() {
    let page = page();
    let live = start(page.path());
    let begun = Instant::now();
    let mut idle: Vec<TcpStream> = (0..80).map(|_| client(&live).connect()).collect();
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
    let served = || client(&live).get("/").0 == 200;
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
    let mut early = client(&live).listen();
    assert!(early.told().is_empty());
    let scene = folder.path().join("level.glb");
    live.tell(&scene, Status::Baking);
    let told = early.told();
    assert_eq!((&told[0]["status"]["state"], &told[0]["outputs"]), (&"baking".into(), &Value::Null));

    let (scene, report) = baked(&cornell([17.0, 12.0, 4.0]), folder.path(), 32);
    live.changed(&scene, &report).unwrap();
    let first = settled(&mut early).remove(0);
    assert_eq!(client(&live).listen().told()[..], *std::slice::from_ref(&first), "who comes later hears the same");
    assert_eq!(first["status"]["state"], "current");
    let outputs = &first["outputs"];
    assert!(outputs["facts"]["mean_irradiance_lux"].as_f64().unwrap() > 0.0);
    assert_eq!(outputs["facts"]["metal_diffuse"], 0.5);
    let (status, texels) = client(&live).get(outputs["lightmaps"][0]["texels"].as_str().unwrap());
    assert_eq!((status, texels.len()), (200, 16 + 32 * 32 * 8));
    let (status, exr) = client(&live).get(outputs["lightmaps"][0]["file"].as_str().unwrap());
    assert_eq!((status, exr), (200, std::fs::read(folder.path().join("baked/level.lightmap.exr")).unwrap()));

    // Another lamp: the layout stays, what shines does not.
    let (scene, report) = baked(&cornell([4.0, 12.0, 17.0]), folder.path(), 32);
    live.changed(&scene, &report).unwrap();
    let second = settled(&mut early).remove(0);
    assert!(second["revision"].as_u64() > first["revision"].as_u64());
    assert_eq!(second["outputs"]["layout"], first["outputs"]["layout"]);
    assert_ne!(second["outputs"]["content"], first["outputs"]["content"]);
    assert_ne!(second["outputs"]["lightmaps"], first["outputs"]["lightmaps"]);
    // The same light again is nothing new.
    live.changed(&scene, &report).unwrap();
    assert_eq!(settled(&mut early)[0]["outputs"], second["outputs"]);

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
    let mut listener = client(&live).listen();
    listener.told();
    let outputs = vec![folder.path().join("baked/level.glb"), report];
    let (done, waiting) = (Done { outputs: outputs.clone(), ..Done::default() }, outputs[1..].to_vec());
    let fault = Fault { error: "broken".into(), causes: Vec::new() };
    for (event, state, shows) in [
        (Event::Found { scene: scene.clone() }, "waiting", false),
        (Event::Baking { scene: scene.clone() }, "baking", false),
        (Event::Drafted { scene: scene.clone(), done: done.clone() }, "baking", true),
        (Event::Baked { scene: scene.clone(), done }, "current", true),
        (Event::Failed { scene: scene.clone(), fault, draft: Some(false) }, "failed", true),
        (Event::Overtaken { scene: scene.clone() }, "waiting", true),
        (Event::Idle { scenes: 1, failed: Vec::new(), draft: Vec::new() }, "current", true),
        (Event::Current { scene: scene.clone(), outputs }, "current", true),
        (Event::Removed { scene: scene.clone() }, "removed", false),
        (Event::Waiting { scene: scene.clone(), outputs: waiting }, "waiting", true),
    ] {
        live.follow(&event).unwrap();
        let told = settled(&mut listener);
        assert_eq!((told.len(), &told[0]["status"]["state"]), (1, &state.into()), "{event:?}");
        assert_eq!(told[0]["outputs"].is_object(), shows, "{event:?}");
    }
    // What cannot be shown is an error, and the bake has ended well all the same.
    let gone = Done { outputs: vec![folder.path().join("none.bake.json")], ..Done::default() };
    let error = live.follow(&Event::Baked { scene: scene.clone(), done: gone }).unwrap_err();
    assert!(error.to_string().contains("none.bake.json"), "{error}");
    let told = listener.told();
    assert!(told[0]["status"]["state"] == "current" && told[0]["outputs"].is_object(), "{told:?}");
    live.follow(&Event::Idle { scenes: 1, failed: Vec::new(), draft: Vec::new() }).unwrap();
    live.tell(&scene, Status::Waiting);
    assert_eq!(listener.told()[0]["status"]["state"], "waiting", "of the others nothing is told");
}

#[test]
fn a_page_that_was_not_built_says_what_to_do() {
    let empty = tempfile::tempdir().unwrap();
    let live = start(empty.path());
    assert!(live.notice().unwrap().contains("npm ci && npm run build"));
    let (status, body) = client(&live).get("/");
    assert_eq!(status, 503);
    assert!(String::from_utf8(body).unwrap().contains("npm run build"));
    assert!(client(&live).listen().told().is_empty(), "the rest works");
}

/// How long it takes from the outputs' being in place until a page that listens has the texels, as a figure to read; that
/// all readers get the same, and each of two lights in turn.
#[test]
fn many_readers_get_the_texels_of_a_large_atlas() {
    let page = page();
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("a.gltf");
    let live = start(page.path());
    let mut listener = client(&live).listen();
    listener.told();
    for (n, side) in [1024, 1024, 2048, 2048].into_iter().enumerate() {
        let report = atlas(&scene, side, n as f32);
        let begin = Instant::now();
        live.changed(&scene, &report).unwrap();
        let told = listener.told().remove(0);
        let heard = begin.elapsed();
        let address = told["outputs"]["lightmaps"][0]["texels"].as_str().unwrap().to_owned();
        let (status, first) = client(&live).get(&address);
        let took = begin.elapsed();
        eprintln!(
            "{side}²: told after {:.1} ms, there after {:.0} ms",
            1e3 * heard.as_secs_f64(),
            1e3 * took.as_secs_f64()
        );
        assert_eq!((status, first.len()), (200, 16 + 8 * (side * side) as usize));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| assert!(client(&live).get(&address) == (200, first.clone())));
            }
        });
        // The .glb has been looked into meanwhile, or is being.
        if told["outputs"]["pending"] == true {
            assert_eq!(settled(&mut listener)[0]["outputs"]["lightmaps"], told["outputs"]["lightmaps"]);
        }
    }
}

/// Writes outputs with light that is as hard to pack as that of a bake; returns the report.
fn atlas(scene: &Path, side: u32, brighter: f32) -> PathBuf {
    let texels = side as usize * side as usize;
    let noise = |i: usize| ((i as u32).wrapping_mul(2_654_435_761) >> 20) as f32 / 4096.0;
    let light =
        (0..texels).map(|i| glam::Vec3::splat(100.0 + brighter + (i % side as usize) as f32 + noise(i))).collect();
    let map = Lightmap::new(side, side, light, vec![1.0; texels]).unwrap();
    let set = OutputSet::new(scene, None, None).unwrap();
    std::fs::create_dir_all(set.folder()).unwrap();
    let glb = luxel_assets::glb::write(&luxel_assets::cornell()).unwrap();
    let (depth, effort) = (Depth::Half, Effort::Small);
    let images = Images { lightmaps: &[map], bounds: &[], depth, effort, key: "k", preview_png: None };
    let images = set.stage(&images, &luxel_scene::Silent).unwrap();
    set.write(images, &glb, &mut Report::new(SceneInfo::default()), &luxel_scene::Silent).unwrap();
    set.report()
}

#[test]
fn other_methods_hear_which_there_are() {
    let page = page();
    let live = start(page.path());
    let mut stream = client(&live).connect();
    std::io::Write::write_all(&mut stream, format!("PUT / HTTP/1.1\r\nHost: {}\r\n\r\n", live.address()).as_bytes())
        .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 405 ") && answer.contains("\r\nAllow: GET, HEAD\r\n"), "{answer}");
}
