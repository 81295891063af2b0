//! Who talks to the preview's server: requests as they are, answers as they come.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use serde_json::Value;

/// Longer than anything here takes on a loaded machine.
pub const LIMIT: Duration = Duration::from_secs(60);

/// The address of a server.
#[derive(Clone, Copy)]
pub struct Client(pub SocketAddr);

impl Client {
    pub fn connect(self) -> TcpStream {
        let stream = TcpStream::connect(self.0).unwrap();
        stream.set_read_timeout(Some(LIMIT)).unwrap();
        stream
    }

    /// Sends bytes as they are; returns the status and the body of the answer.
    pub fn raw(self, request: &[u8]) -> (u16, Vec<u8>) {
        let mut stream = self.connect();
        stream.write_all(request).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").expect("an answer has a head");
        let status = std::str::from_utf8(&answer[9..12]).unwrap().parse().unwrap();
        (status, answer[end + 4..].to_vec())
    }

    pub fn request(self, method: &str, path: &str) -> (u16, Vec<u8>) {
        self.raw(format!("{method} {path} HTTP/1.1\r\nHost: {}\r\n\r\n", self.0).as_bytes())
    }

    pub fn get(self, path: &str) -> (u16, Vec<u8>) {
        self.request("GET", path)
    }

    /// Listens to events from now on.
    pub fn listen(self) -> Listener {
        let mut stream = self.connect();
        write!(stream, "GET /events HTTP/1.1\r\nHost: {}\r\n\r\n", self.0).unwrap();
        let mut reader = BufReader::new(stream);
        let mut line = String::new();
        while line != "\r\n" {
            line.clear();
            assert!(reader.read_line(&mut line).unwrap() > 0);
        }
        Listener(reader)
    }
}

/// Somebody who listens to events.
pub struct Listener(BufReader<TcpStream>);

impl Listener {
    /// The next event: its name and data. Comments are passed over.
    pub fn next(&mut self) -> Option<(String, Value)> {
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
    pub fn told(&mut self) -> Vec<Value> {
        let mut scenes = Vec::new();
        loop {
            match self.next().expect("the stream goes on") {
                (name, scene) if name == "scene" => scenes.push(scene),
                _ => return scenes,
            }
        }
    }
}
