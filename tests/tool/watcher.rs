//! A running `luxel watch`, followed by its events.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError};

use serde_json::Value;

/// A running `luxel watch --json`.
pub struct Tool {
    child: Child,
    events: Receiver<Value>,
}

impl Tool {
    pub fn new(folder: &Path, args: &[&str]) -> Self {
        Self::start(Command::new(env!("CARGO_BIN_EXE_luxel")), folder, args)
    }

    /// With a command that runs luxel with the arguments that it is given.
    pub fn start(mut command: Command, folder: &Path, args: &[&str]) -> Self {
        let mut child = command
            .args([&["watch", "--json"], args, &super::QUICK].concat())
            .current_dir(folder)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let (sender, events) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            lines.for_each(|line| drop(sender.send(serde_json::from_str(&line.unwrap()).unwrap())));
        });
        Self { child, events }
    }

    /// The next event.
    pub fn next(&mut self) -> Value {
        self.events.recv_timeout(super::LIMIT).unwrap_or_else(|error| panic!("no event: {error}"))
    }

    /// The next event of this name.
    pub fn wait(&mut self, name: &str) -> Value {
        loop {
            match self.events.recv_timeout(super::LIMIT) {
                Ok(event) if event["event"] == name => return event,
                Ok(_) => {}
                Err(error) => panic!("no `{name}`: {error}"),
            }
        }
    }

    pub fn signal(&self, name: &str) {
        assert!(Command::new("kill").args([name, &self.child.id().to_string()]).status().unwrap().success());
    }

    /// Its exit code, after the last event.
    pub fn end(mut self) -> Option<i32> {
        let rest = self.events.recv_timeout(super::LIMIT);
        assert_eq!(rest, Err(RecvTimeoutError::Disconnected), "nothing follows the last event");
        self.child.wait().unwrap().code()
    }
}

impl Drop for Tool {
    fn drop(&mut self) {
        // It has ended already, unless the test failed.
        drop(self.child.kill());
        drop(self.child.wait());
    }
}
