//! `luxel watch --preview`: the real binary, its page and its lightmaps.

use std::net::{SocketAddr, TcpStream};
use std::path::Path;

use serde_json::Value;

use super::browser::{self, Browser};
use super::tool::client::{Client, Listener};
use super::tool::watcher::Tool;
use super::{cornell, save};

/// A folder with the box, and a watch of it with a preview; the event that tells of it.
fn watched(folder: &Path) -> (Tool, Client, Value) {
    watched_with(folder, &[])
}

/// The same, with further options.
fn watched_with(folder: &Path, options: &[&str]) -> (Tool, Client, Value) {
    let mut tool = Tool::new(folder, &[&[".", "--preview", "--port", "0"], options].concat());
    let told = tool.next();
    assert_eq!(told["event"], "preview", "before all others");
    let address = told["url"].as_str().unwrap().trim_start_matches("http://").trim_end_matches('/');
    let address: SocketAddr = address.parse().unwrap();
    assert!(address.ip() == std::net::Ipv4Addr::LOCALHOST && address.port() != 0, "{address}");
    (tool, Client(address), told)
}

/// The outputs of the only scene when it is current, and they are not `old`.
fn current(listener: &mut Listener, old: &Value) -> Value {
    loop {
        let told = listener.told();
        let now = told.iter().rfind(|s| s["status"]["state"] == "current" && s["outputs"] != *old);
        if let Some(scene) = now.filter(|s| s["outputs"]["pending"] == false) {
            return scene["outputs"].clone();
        }
    }
}

/// The lightmap as it is served, which is the one on disk.
fn lightmap(client: Client, outputs: &Value, folder: &Path) -> Vec<u8> {
    let (status, served) = client.get(outputs["lightmaps"][0]["file"].as_str().unwrap());
    assert_eq!(status, 200);
    assert!(served == std::fs::read(folder.join("baked/box.lightmap.exr")).unwrap());
    let (status, texels) = client.get(outputs["lightmaps"][0]["texels"].as_str().unwrap());
    assert_eq!((status, texels.len()), (200, 16 + 64 * 64 * 8));
    served
}

#[cfg(unix)]
#[test]
fn the_tool_serves_the_page_and_every_new_lightmap() {
    let folder = tempfile::tempdir().unwrap();
    save(&cornell([17.0, 12.0, 4.0]), &folder.path().join("box.glb"));
    let (mut tool, client, told) = watched(folder.path());
    // The page, or what is to be done to have one: as the event says.
    let (status, page) = client.get("/");
    let page = String::from_utf8(page).unwrap();
    match told["notice"].as_str() {
        None => assert!(status == 200 && page.contains("<canvas"), "{status}: {page}"),
        Some(notice) => {
            assert!(notice.contains("npm run build"), "{notice}");
            assert!(status == 503 && page.contains("npm run build"), "{status}: {page}");
            super::browser::skipped("the page in the binary was not asked for: it was not built when luxel was");
        }
    }
    let host = |host: &str| client.raw(format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes()).0;
    assert_eq!(host(&client.0.to_string()), status);
    assert_eq!([host("luxel.example"), host(&format!("luxel.example:{}", client.0.port()))], [403, 403]);
    assert_eq!(client.get("/box.glb").0, 404, "the scene itself is no output");

    let mut listener = client.listen();
    let before = current(&mut listener, &Value::Null);
    let first = lightmap(client, &before, folder.path());
    tool.wait("idle");
    save(&cornell([3.0, 9.0, 20.0]), &folder.path().join("box.glb"));
    let after = current(&mut listener, &before);
    assert_ne!(lightmap(client, &after, folder.path()), first, "another lamp");
    assert_eq!(client.get(before["lightmaps"][0]["file"].as_str().unwrap()).0, 409, "the old one is no more");
    // What cannot be baked is told, and its last good bake stays.
    std::fs::write(folder.path().join("box.glb"), "glTF but not for long").unwrap();
    tool.wait("failed");
    let broken = std::iter::repeat_with(|| listener.told()).flatten().find(|s| s["status"]["state"] == "failed");
    assert_eq!(broken.unwrap()["outputs"], after);
    tool.signal("-TERM");
    tool.wait("stopped");
    assert_eq!(tool.end(), Some(1));
    assert!(TcpStream::connect(client.0).is_err(), "nobody listens any more");
}

#[cfg(unix)]
#[test]
fn what_was_baked_by_an_earlier_watch_is_shown_without_a_bake() {
    let folder = tempfile::tempdir().unwrap();
    save(&cornell([17.0, 12.0, 4.0]), &folder.path().join("box.glb"));
    let end = |tool: Tool| {
        tool.signal("-TERM");
        drop(tool);
    };
    let (mut tool, client, _) = watched(folder.path());
    let baked = tool.wait("baked");
    let before = current(&mut client.listen(), &Value::Null);
    end(tool);
    let (mut tool, client, _) = watched(folder.path());
    let told =
        std::iter::repeat_with(|| tool.next()).find(|e| ["baking", "current"].contains(&e["event"].as_str().unwrap()));
    let told = told.unwrap();
    assert_eq!((&told["event"], &told["outputs"]), (&"current".into(), &baked["outputs"]));
    let after = current(&mut client.listen(), &Value::Null);
    assert_eq!(after, before);
    lightmap(client, &after, folder.path());
    end(tool);
}

#[cfg(unix)]
#[test]
fn the_page_follows_a_watch_without_being_loaded_again() {
    let tools = match browser::browser() {
        Ok(tools) => tools,
        Err(missing) => return browser::skipped(&format!("the page did not follow a watch: {missing}")),
    };
    let folder = tempfile::tempdir().unwrap();
    save(&cornell([17.0, 12.0, 4.0]), &folder.path().join("box.glb"));
    let (mut tool, _, told) = watched(folder.path());
    if !told["notice"].is_null() {
        return browser::skipped("the page did not follow a watch: it was not built when luxel was");
    }
    let shots = tempfile::tempdir().unwrap();
    tool.wait("idle");
    let mut page = Browser::open("follow.mjs", told["url"].as_str().unwrap(), shots.path(), tools);
    page.event("shown");
    save(&cornell([3.0, 9.0, 20.0]), &folder.path().join("box.glb"));
    let done = page.event("done");
    assert_eq!((&done["kept"], &done["trouble"]), (&"since the beginning".into(), &Value::Null));
    let back = |name: &str| {
        let picture = image::open(shots.path().join(format!("{name}.png"))).unwrap().to_rgb8();
        browser::mean(&picture, [0.36, 0.65], [0.25, 0.35])
    };
    let (first, second) = (back("first"), back("second"));
    assert!(first[0] > 1.3 * first[2] && second[2] > 1.3 * second[0], "yellow, then blue: {first:?} {second:?}");
    tool.signal("-TERM");
    tool.wait("stopped");
    assert_eq!(tool.end(), Some(0));
}

#[cfg(unix)]
#[test]
fn broken_and_stale_scenes_are_there_from_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    save(&cornell([17.0, 12.0, 4.0]), &at("a.glb"));
    save(&cornell([17.0, 12.0, 4.0]), &at("b.glb"));
    super::tool::quick(&["bake", "a.glb", "b.glb"], folder.path()).ended(0);
    std::fs::write(at("a.glb"), "glTF but not for long").unwrap();
    // A bake of b, which comes first, would take minutes; c is not reached, and was never baked.
    std::fs::write(at("luxel.toml"), "refresh = 100000").unwrap();
    save(&cornell([3.0, 9.0, 20.0]), &at("c.glb"));
    let (mut tool, client, _) = watched_with(folder.path(), &["--no-draft"]);
    while tool.wait("started")["stage"] != "refresh" {}
    let mut told = client.listen().told();
    told.sort_by_key(|scene| scene["name"].to_string());
    let seen: Vec<_> = told.iter().map(|s| (s["name"].as_str().unwrap(), s["outputs"].is_object())).collect();
    assert_eq!(seen, [("a.glb", true), ("b.glb", true), ("c.glb", false)]);
    assert_eq!(told[2]["status"]["state"], "waiting");
    for scene in &told[..2] {
        assert_eq!(client.get(scene["outputs"]["glb"].as_str().unwrap()).0, 200, "{scene}");
    }
    tool.signal("-TERM");
    tool.wait("stopped");
}

#[cfg(unix)]
#[test]
fn who_wants_quiet_is_told_where_the_page_is() {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
    command.args(["watch", ".", "--quiet", "--preview"]).current_dir(folder.path());
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stderr.take().unwrap()).read_line(&mut line).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(line.starts_with("preview: http://127.0.0.1:"), "{line}");
}

#[test]
fn a_port_that_is_taken_is_wrong_usage_with_a_word_of_advice() {
    let folder = tempfile::tempdir().unwrap();
    save(&cornell([17.0, 12.0, 4.0]), &folder.path().join("box.glb"));
    let taken = std::net::TcpListener::bind((std::net::Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let run = super::tool::luxel(&["watch", ".", "--preview", "--port", &port], folder.path()).ended(2);
    assert!(run.stderr.contains(&port) && run.stderr.contains("--port"), "{}", run.stderr);
}
