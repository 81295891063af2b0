//! As much of HTTP/1.1 (RFC 9112) as a page on the same machine needs: GET and HEAD, one request a connection.
//!
//! Whatever comes is refused unless it is in order: a head is at most [`MAX_HEAD`] bytes long and here within
//! [`HEAD_TIME`], has no body, and names as its host the address that is listened at. The last is what keeps pages of
//! other origins out: their browser sends the name that they were loaded by, also where that name has meanwhile come to
//! mean 127.0.0.1 (DNS rebinding). Browsers also say where a request comes from (Sec-Fetch-Site): pages of other origins
//! are not answered.

use std::io::{self, Read, Seek, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest head of a request [bytes].
pub const MAX_HEAD: usize = 8 << 10;
/// Most header lines of a request.
const MAX_HEADERS: usize = 64;
/// A head that takes longer is not waited for.
pub const HEAD_TIME: Duration = Duration::from_secs(5);
/// A client that takes nothing for so long is gone.
pub const WRITE_TIME: Duration = Duration::from_secs(10);
/// A whole answer is sent within this time, however often a little of it is taken: the largest one (512 MiB) is on its
/// way through this machine for a few seconds.
pub const ANSWER_TIME: Duration = Duration::from_secs(60);
/// What is read of a file at once [bytes].
const PIECE: usize = 256 << 10;
/// What a refused client still sends is read so far [bytes], so that it gets to see the refusal.
const DRAINED: u64 = 1 << 20;
const DRAIN_TIME: Duration = Duration::from_millis(300);

/// A request that may be answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// Only the head of the answer is wanted.
    pub head_only: bool,
    /// As it was sent: nothing in it is decoded.
    pub path: String,
    /// What follows `?`.
    pub query: Option<String>,
}

/// Why a request is not answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    Malformed,
    Method,
    Host,
    /// It comes from another site's page.
    Origin,
    Body,
    TooLong,
    Late,
    Busy,
    Missing,
    /// What was asked for has been replaced, or is being replaced now.
    Overtaken,
    /// A lightmap with more texels than are decoded.
    Large,
    Broken,
}

impl Refusal {
    /// The status line's number and words, and what a person reads.
    fn told(self) -> (&'static str, &'static str) {
        match self {
            Self::Malformed => ("400 Bad Request", "this is no HTTP request that luxel understands"),
            Self::Method => ("405 Method Not Allowed", "only GET and HEAD are answered"),
            Self::Host => {
                ("403 Forbidden", "only requests to 127.0.0.1, localhost or [::1] with this port are answered")
            }
            Self::Origin => ("403 Forbidden", "pages of other sites are not answered"),
            Self::Body => ("413 Content Too Large", "requests with a body are not answered"),
            Self::TooLong => ("431 Request Header Fields Too Large", "the head of the request is too long"),
            Self::Late => ("408 Request Timeout", "the request took too long"),
            Self::Busy => ("503 Service Unavailable", "too many connections at once"),
            Self::Missing => ("404 Not Found", "there is nothing here"),
            Self::Overtaken => ("409 Conflict", "this file has been replaced; the next event names the new one"),
            Self::Large => {
                ("501 Not Implemented", "this lightmap is larger than the preview shows: 8192 texels squared")
            }
            Self::Broken => ("500 Internal Server Error", "the file cannot be read"),
        }
    }
}

/// What is sent.
#[derive(Debug)]
pub enum Body {
    Static(&'static [u8]),
    Bytes(Vec<u8>),
    /// What others may be sending too.
    Shared(Arc<Vec<u8>>),
    /// A file from its beginning on, with its length.
    File(std::fs::File, u64),
}

/// An answer with a body of known length.
#[derive(Debug)]
pub struct Answer {
    pub status: &'static str,
    pub content_type: &'static str,
    pub body: Body,
}

impl Answer {
    pub fn ok(content_type: &'static str, body: Body) -> Self {
        Self { status: "200 OK", content_type, body }
    }
}

/// Header lines of every answer. Nothing is kept by the browser, no other origin may use anything, and a page runs
/// and loads only what comes from here; `blob:` is how pictures inside a .glb reach the browser's decoder, and WebAssembly
/// is the decoder of meshopt's vertices.
const COMMON: &str = "Connection: close\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
    Cross-Origin-Resource-Policy: same-origin\r\nReferrer-Policy: no-referrer\r\nX-Frame-Options: DENY\r\n\
    Content-Security-Policy: default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' blob: data:; \
    connect-src 'self' blob: data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n";

/// Reads and checks a request. `port` is the one that is listened at.
pub fn read(stream: &mut TcpStream, port: u16) -> Result<Request, Refusal> {
    let until = Instant::now() + HEAD_TIME;
    let mut head = Vec::with_capacity(1024);
    let mut part = [0; 1024];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() || stream.set_read_timeout(Some(left)).is_err() {
            return Err(Refusal::Late);
        }
        let count = match stream.read(&mut part) {
            Ok(0) => return Err(Refusal::Malformed),
            Ok(count) => count,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => return Err(Refusal::Late),
        };
        head.extend_from_slice(&part[..count]);
        // What lies beyond the limit is not even looked at.
        let cut = head.len().min(MAX_HEAD);
        if let Some(request) = parse(&head[..cut], port)? {
            return Ok(request);
        }
        if head.len() >= MAX_HEAD {
            return Err(Refusal::TooLong);
        }
    }
}

/// The request of a head; none where it is not whole yet.
pub fn parse(head: &[u8], port: u16) -> Result<Option<Request>, Refusal> {
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut parsed = httparse::Request::new(&mut headers);
    match parsed.parse(head) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) => return Ok(None),
        Err(httparse::Error::TooManyHeaders) => return Err(Refusal::TooLong),
        Err(_) => return Err(Refusal::Malformed),
    }
    check_host(parsed.headers, port)?;
    let head_only = match parsed.method {
        Some("GET") => false,
        Some("HEAD") => true,
        _ => return Err(Refusal::Method),
    };
    check_origin(parsed.headers)?;
    let has_body =
        |h: &httparse::Header| is(h, "transfer-encoding") || is(h, "content-length") && h.value.trim_ascii() != b"0";
    if parsed.headers.iter().any(has_body) {
        return Err(Refusal::Body);
    }
    let target = local(parsed.path.ok_or(Refusal::Malformed)?, port)?;
    let (path, query) = match target.split_once('?') {
        Some((path, query)) => (path, Some(query.to_owned())),
        None => (target, None),
    };
    Ok(Some(Request { head_only, path: path.into(), query }))
}

fn is(header: &httparse::Header, name: &str) -> bool {
    header.name.eq_ignore_ascii_case(name)
}

/// The path and query of a target (RFC 9112, §3.2): as they are, or behind `http://` and this address, which clients of
/// proxies send. The Host line has to be right as well, which a client that follows the standard makes the same.
fn local(target: &str, port: u16) -> Result<&str, Refusal> {
    const SCHEME: &str = "http://";
    if target.starts_with('/') {
        return Ok(target);
    }
    let (scheme, rest) = target.split_at_checked(SCHEME.len()).ok_or(Refusal::Malformed)?;
    if !scheme.eq_ignore_ascii_case(SCHEME) {
        return Err(Refusal::Malformed);
    }
    let (authority, path) = rest.split_at(rest.find(['/', '?']).unwrap_or(rest.len()));
    if !is_own(authority.as_bytes(), port) {
        return Err(Refusal::Host);
    }
    // An empty path means the root.
    match path {
        "" => Ok("/"),
        path if path.starts_with('/') => Ok(path),
        _ => Err(Refusal::Malformed),
    }
}

/// Browsers say whose page a request comes from; who says nothing is none of those that a page could lead astray.
fn check_origin(headers: &[httparse::Header]) -> Result<(), Refusal> {
    let mut said = headers.iter().filter(|h| is(h, "sec-fetch-site")).map(|h| h.value.trim_ascii());
    let is_own = |site: &[u8]| [&b"same-origin"[..], b"none"].contains(&site);
    if said.all(is_own) { Ok(()) } else { Err(Refusal::Origin) }
}

/// There is one Host line, and it names this address.
fn check_host(headers: &[httparse::Header], port: u16) -> Result<(), Refusal> {
    let mut hosts = headers.iter().filter(|h| is(h, "host"));
    let (Some(host), None) = (hosts.next(), hosts.next()) else { return Err(Refusal::Host) };
    if is_own(host.value.trim_ascii(), port) { Ok(()) } else { Err(Refusal::Host) }
}

/// A name of this address.
fn is_own(host: &[u8], port: u16) -> bool {
    let named = |name: &str| {
        // Browsers leave 80 out.
        host.eq_ignore_ascii_case(format!("{name}:{port}").as_bytes())
            || port == 80 && host.eq_ignore_ascii_case(name.as_bytes())
    };
    ["127.0.0.1", "localhost", "[::1]"].into_iter().any(named)
}

/// Writes until a time, and waits for a client that takes nothing for [`WRITE_TIME`] at most.
pub struct Timely<'a> {
    stream: &'a TcpStream,
    until: Instant,
}

impl<'a> Timely<'a> {
    /// All within `time` from now on.
    pub fn new(stream: &'a TcpStream, time: Duration) -> Self {
        Self { stream, until: Instant::now() + time }
    }
}

impl Write for Timely<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let left = self.until.saturating_duration_since(Instant::now()).min(WRITE_TIME);
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        self.stream.set_write_timeout(Some(left))?;
        // A part of it, so that the time is looked at again however slowly it is taken.
        (&mut &*self.stream).write(&bytes[..bytes.len().min(PIECE)])
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Sends an answer within [`ANSWER_TIME`].
pub fn send(stream: &TcpStream, answer: Answer, head_only: bool) -> io::Result<()> {
    send_with(stream, answer, "", head_only)
}

/// [`send`], with further lines of its head.
fn send_with(stream: &TcpStream, answer: Answer, lines: &str, head_only: bool) -> io::Result<()> {
    let mut stream = Timely::new(stream, ANSWER_TIME);
    let length = match &answer.body {
        Body::Static(bytes) => bytes.len() as u64,
        Body::Bytes(bytes) => bytes.len() as u64,
        Body::Shared(bytes) => bytes.len() as u64,
        Body::File(_, length) => *length,
    };
    let Answer { status, content_type, body } = answer;
    let head =
        format!("HTTP/1.1 {status}\r\nContent-Type: {content_type}\r\nContent-Length: {length}\r\n{lines}{COMMON}\r\n");
    stream.write_all(head.as_bytes())?;
    if head_only {
        return Ok(());
    }
    match body {
        Body::Static(bytes) => stream.write_all(bytes),
        Body::Bytes(bytes) => stream.write_all(&bytes),
        Body::Shared(bytes) => stream.write_all(&bytes),
        Body::File(mut file, length) => {
            file.rewind()?;
            io::copy(&mut io::BufReader::with_capacity(PIECE, file.take(length)), &mut stream).map(drop)
        }
    }
}

/// Sends the head of a stream of events, which ends with the connection.
pub fn send_event_head(stream: &TcpStream) -> io::Result<()> {
    Timely::new(stream, ANSWER_TIME)
        .write_all(format!("HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n{COMMON}\r\n").as_bytes())
}

/// Sends a refusal, and lets the client finish what it is saying so that it can hear it.
pub fn refuse(stream: &mut TcpStream, refusal: Refusal) -> io::Result<()> {
    send_refusal(stream, refusal, false)?;
    stream.shutdown(Shutdown::Write)?;
    let until = Instant::now() + DRAIN_TIME;
    let mut rest = stream.take(DRAINED);
    let mut part = [0; 4096];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(());
        }
        rest.get_ref().set_read_timeout(Some(left))?;
        if rest.read(&mut part)? == 0 {
            return Ok(());
        }
    }
}

/// Sends a refusal and waits for nothing.
pub fn send_refusal(stream: &TcpStream, refusal: Refusal, head_only: bool) -> io::Result<()> {
    let (status, words) = refusal.told();
    let body = Body::Bytes(format!("{words}\n").into_bytes());
    let lines = if refusal == Refusal::Method { "Allow: GET, HEAD\r\n" } else { "" };
    send_with(stream, Answer { status, content_type: "text/plain; charset=utf-8", body }, lines, head_only)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<Option<Request>, Refusal> {
        parse(text.replace('\n', "\r\n").as_bytes(), 8080)
    }

    fn get(path: &str) -> Result<Option<Request>, Refusal> {
        parsed(&format!("GET {path} HTTP/1.1\nHost: localhost:8080\n\n"))
    }

    #[test]
    fn a_request_is_taken_as_it_was_sent() {
        let request = |path: &str, query: Option<&str>| Request {
            head_only: false,
            path: path.into(),
            query: query.map(str::to_owned),
        };
        assert_eq!(get("/a/%2e%2e/b?v=1?2"), Ok(Some(request("/a/%2e%2e/b", Some("v=1?2")))));
        assert_eq!(get("/"), Ok(Some(request("/", None))));
        let head = parsed("HEAD / HTTP/1.1\nhOST:  LocalHost:8080 \nContent-Length: 0\n\n");
        assert_eq!(head, Ok(Some(Request { head_only: true, ..request("/", None) })));
        let whole = "GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n";
        for cut in 0..whole.len() {
            assert_eq!(parse(&whole.as_bytes()[..cut], 8080), Ok(None), "{cut}");
        }
    }

    #[test]
    fn other_hosts_are_refused() {
        let host = |lines: &str| parsed(&format!("GET / HTTP/1.1\n{lines}\n")).map(|_| ());
        for good in ["127.0.0.1:8080", "localhost:8080", "[::1]:8080"] {
            assert_eq!(host(&format!("Host: {good}\n")), Ok(()));
        }
        for bad in [
            "localhost",
            "127.0.0.1",
            "localhost:8081",
            "evil.example:8080",
            "localhost.evil.example:8080",
            "127.0.0.1:8080.evil.example",
            "127.0.0.2:8080",
            "0.0.0.0:8080",
            "user@localhost:8080",
            "",
        ] {
            assert_eq!(host(&format!("Host: {bad}\n")), Err(Refusal::Host), "{bad}");
        }
        assert_eq!(host(""), Err(Refusal::Host));
        assert_eq!(host("Host: localhost:8080\nHost: evil.example\n"), Err(Refusal::Host));
        assert_eq!(parse(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", 80).map(|r| r.is_some()), Ok(true));
    }

    #[test]
    fn targets_with_an_address_lead_to_this_one_only() {
        let request = |path: &str, query: Option<&str>| {
            Ok(Some(Request { head_only: false, path: path.into(), query: query.map(str::to_owned) }))
        };
        assert_eq!(get("http://localhost:8080/a?v=1"), request("/a", Some("v=1")));
        assert_eq!(get("HTTP://127.0.0.1:8080"), request("/", None));
        for bad in ["http://evil.example:8080/", "http://localhost:8081/", "http://localhost/", "http:///"] {
            assert_eq!(get(bad), Err(Refusal::Host), "{bad}");
        }
        let other = parsed("GET http://localhost:8080/ HTTP/1.1\nHost: evil.example\n\n");
        assert_eq!(other, Err(Refusal::Host));
    }

    #[test]
    fn pages_of_other_sites_are_refused() {
        let from = |lines: &str| parsed(&format!("GET / HTTP/1.1\nHost: localhost:8080\n{lines}\n")).map(|_| ());
        for good in ["", "Sec-Fetch-Site: none\n", "sec-fetch-site: same-origin\n"] {
            assert_eq!(from(good), Ok(()), "{good}");
        }
        for bad in ["cross-site", "same-site", "", "none, cross-site", "none\nSec-Fetch-Site: cross-site"] {
            assert_eq!(from(&format!("Sec-Fetch-Site: {bad}\n")), Err(Refusal::Origin), "{bad}");
        }
    }

    #[test]
    fn an_answer_ends_in_time_however_it_is_taken() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let mut client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (server, _) = listener.accept().unwrap();
        let begin = Instant::now();
        let is_over = std::sync::atomic::AtomicBool::new(false);
        let error = std::thread::scope(|scope| {
            // A little is taken all the time.
            scope.spawn(|| {
                let mut part = [0; 1024];
                while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
                    client.read_exact(&mut part).unwrap();
                    std::thread::sleep(Duration::from_millis(5));
                }
            });
            let error = Timely::new(&server, Duration::from_millis(300)).write_all(&vec![0; 64 << 20]).unwrap_err();
            is_over.store(true, std::sync::atomic::Ordering::Relaxed);
            error
        });
        assert!(matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock), "{error}");
        assert!(begin.elapsed() < WRITE_TIME, "not by the other limit");
    }

    #[test]
    fn everything_else_than_get_without_body_is_refused() {
        let with = |method: &str, line: &str| parsed(&format!("{method} / HTTP/1.1\nHost: localhost:8080\n{line}\n"));
        for method in ["POST", "PUT", "DELETE", "OPTIONS", "CONNECT", "TRACE", "get"] {
            assert_eq!(with(method, ""), Err(Refusal::Method), "{method}");
        }
        for line in ["Content-Length: 5\n", "Content-Length: x\n", "Transfer-Encoding: chunked\n"] {
            assert_eq!(with("GET", line), Err(Refusal::Body), "{line}");
        }
        assert_eq!(with("GET", &"X: y\n".repeat(70)), Err(Refusal::TooLong));
        for target in ["*", "..", "C:/", "https://localhost:8080/", "http:/", "http://localhost:8080?v=1"] {
            assert_eq!(get(target), Err(Refusal::Malformed), "{target}");
        }
        assert_eq!(parsed("\u{1}\u{2}\u{3} nonsense\n\n"), Err(Refusal::Malformed));
    }
}
