//! `luxel watch --preview`: the real binary, its page and its lightmaps.

use std::net::{SocketAddr, TcpStream};
use std::path::Path;

use serde_json::Value;

use super::tool::client::{Client, Listener};
use super::tool::watcher::Tool;
use super::{cornell, save};

/// A folder with the box, and a watch of it with a preview; the event that tells of it.
fn watched(folder: &Path) -> (Tool, Client, Value) {
    let mut tool = Tool::new(folder, &[".", "--preview", "--port", "0"]);
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
        if let Some(scene) = now.filter(|s| s["outputs"].is_object()) {
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

#[test]
fn a_port_that_is_taken_is_wrong_usage_with_a_word_of_advice() {
    let folder = tempfile::tempdir().unwrap();
    save(&cornell([17.0, 12.0, 4.0]), &folder.path().join("box.glb"));
    let taken = std::net::TcpListener::bind((std::net::Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let run = super::tool::luxel(&["watch", ".", "--preview", "--port", &port], folder.path()).ended(2);
    assert!(run.stderr.contains(&port) && run.stderr.contains("--port"), "{}", run.stderr);
}
