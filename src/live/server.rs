//! Connections: taken, counted, answered.
//!
//! | path | answer |
//! |---|---|
//! | `/`, `/preview.js`, `/preview.css` | the page |
//! | `/events` | server-sent events, each of which is a scene as it is now |
//! | `/scenes/S/files/F?v=HASH` | output F of scene S, while it is the one with this hash |
//! | `/scenes/S/texels/F?v=HASH` | the same, a lightmap, decoded ([`texels`]) |
//!
//! A thread serves a connection, which carries one request: a page asks for a dozen files in all, and there are few
//! pages.

use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use super::bundle::Bundle;
use super::decoded::Decoded;
use super::http::{self, Answer, Body, Refusal, Request};
use super::outputs::Kind;
use super::scenes::{News, Scenes};

/// Most connections at once, and most of those that listen to events.
const MAX_CONNECTIONS: usize = 64;
const MAX_LISTENERS: usize = 24;
/// A listener hears a word at least so often, so that one that has gone is noticed.
const SILENCE: Duration = Duration::from_secs(5);

/// What all connections share.
#[derive(Debug)]
pub struct Shared {
    pub port: u16,
    pub bundle: Bundle,
    pub scenes: Scenes,
    connections: AtomicUsize,
    listeners: AtomicUsize,
    pub decoded: Decoded,
}

/// One of a limited number, given back when it is dropped.
struct Slot<'a>(&'a AtomicUsize);

impl<'a> Slot<'a> {
    fn take(counter: &'a AtomicUsize, most: usize) -> Option<Self> {
        let more = |count| (count < most).then_some(count + 1);
        counter.fetch_update(Ordering::AcqRel, Ordering::Acquire, more).ok().map(|_| Self(counter))
    }
}

impl Drop for Slot<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Shared {
    pub fn new(port: u16, bundle: Bundle) -> Self {
        Self {
            port,
            bundle,
            scenes: Scenes::default(),
            connections: AtomicUsize::new(0),
            listeners: AtomicUsize::new(0),
            decoded: Decoded::default(),
        }
    }

    /// Somebody hears what is told.
    pub fn is_heard(&self) -> bool {
        self.listeners.load(Ordering::Acquire) > 0
    }
}

/// Takes connections until the scenes are closed.
pub fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    for stream in listener.incoming() {
        if shared.scenes.is_closing() {
            return;
        }
        match stream {
            Ok(stream) => begin(stream, shared),
            // The system is out of something; others will give it back.
            Err(_) => std::thread::sleep(Duration::from_millis(50)),
        }
    }
}

/// Gives a connection its thread, where there is one to be had.
fn begin(mut stream: TcpStream, shared: &Arc<Shared>) {
    let count = shared.connections.fetch_add(1, Ordering::AcqRel);
    let own = Arc::clone(shared);
    if count >= MAX_CONNECTIONS {
        shared.connections.fetch_sub(1, Ordering::AcqRel);
        // Who cannot even be told so is gone.
        let _ = http::send_refusal(&stream, Refusal::Busy, false);
        return;
    }
    let work = move || {
        let _slot = Slot(&own.connections);
        // A client that goes away in the middle of an answer wants no other.
        let _ = serve(&mut stream, &own);
    };
    if std::thread::Builder::new().name("luxel preview".into()).spawn(work).is_err() {
        shared.connections.fetch_sub(1, Ordering::AcqRel);
    }
}

fn serve(stream: &mut TcpStream, shared: &Shared) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let request = match http::read(stream, shared.port) {
        Ok(request) => request,
        Err(refusal) => return http::refuse(stream, refusal),
    };
    if request.path == "/events" {
        return events(stream, shared, &request);
    }
    match answer(shared, &request) {
        Ok(answer) => http::send(stream, answer, request.head_only),
        Err(refusal) => http::send_refusal(stream, refusal, request.head_only),
    }
}

fn answer(shared: &Shared, request: &Request) -> Result<Answer, Refusal> {
    let parts: Vec<&str> = request.path.split('/').skip(1).collect();
    match parts[..] {
        ["scenes", scene, what @ ("files" | "texels"), file] => {
            let (scene, file) = (number(scene)?, number(file)?);
            output(shared, scene, what == "texels", file, request.query.as_deref())
        }
        _ => shared.bundle.answer(&request.path),
    }
}

/// A place in a list.
fn number(text: &str) -> Result<usize, Refusal> {
    let is_number = (1..=9).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_digit());
    is_number.then(|| text.parse().ok()).flatten().ok_or(Refusal::Missing)
}

fn output(shared: &Shared, scene: usize, decoded: bool, file: usize, query: Option<&str>) -> Result<Answer, Refusal> {
    let outputs = shared.scenes.outputs(scene).ok_or(Refusal::Missing)?;
    let file = outputs.files.get(file).ok_or(Refusal::Missing)?;
    if query.and_then(|q| q.strip_prefix("v=")).is_some_and(|version| version != file.hash) {
        return Err(Refusal::Overtaken);
    }
    if decoded && !matches!(file.kind, Kind::Lightmap(_)) {
        return Err(Refusal::Missing);
    }
    if !decoded {
        let (opened, length) = file.open().map_err(|_| Refusal::Overtaken)?.ok_or(Refusal::Overtaken)?;
        return Ok(Answer::ok(file.content_type(), Body::File(opened, length)));
    }
    Ok(Answer::ok("application/octet-stream", Body::Shared(shared.decoded.of(file)?)))
}

/// Tells every change until the listener goes or the server ends.
fn events(stream: &mut TcpStream, shared: &Shared, request: &Request) -> std::io::Result<()> {
    let Some(_slot) = Slot::take(&shared.listeners, MAX_LISTENERS) else {
        return http::refuse(stream, Refusal::Busy);
    };
    http::send_event_head(stream)?;
    if request.head_only {
        return Ok(());
    }
    let mut told = None;
    loop {
        match shared.scenes.wait(told, SILENCE) {
            News::Changes(changes, now) => {
                let mut stream = http::Timely::new(stream, http::ANSWER_TIME);
                for change in changes {
                    // JSON has no line breaks of its own.
                    stream.write_all(format!("event: scene\ndata: {change}\n\n").as_bytes())?;
                }
                // Without a word a page could not tell that there is no scene yet.
                stream.write_all(format!("event: told\ndata: {now}\n\n").as_bytes())?;
                told = Some(now);
            }
            News::Silence => http::Timely::new(stream, http::ANSWER_TIME).write_all(b": still here\n\n")?,
            News::Closing => return Ok(()),
        }
    }
}
