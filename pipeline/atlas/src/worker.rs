//! A process between xatlas and the bake.
//!
//! The worker is any program that calls [`worker_main`] on its standard input and output: the `luxel` binary does,
//! under a hidden subcommand. Messages are a 32-bit little-endian length and a bincode body: a list of pieces one way,
//! a list of answers the other. A worker that dies, talks nonsense or takes too long is killed; the pieces of its
//! batch are then tried one by one, and the one at fault is left to the fallback. One whose answer is not wanted any
//! more is killed too. What is done depends on the
//! pieces, except where a time limit strikes, which the report then names.

use std::ffi::OsString;
use std::io::{self, Read, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use luxel_scene::{Progress, Silent};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::unwrap::{Answers, InProcess, Piece, UnwrapError, Unwrapper};

/// How the reasons begin for which a piece has no charts because of the worker, not of the piece.
pub(crate) const FAILED: &str = "the unwrap worker";

/// No message is larger, in either direction [bytes].
const MESSAGE_LIMIT: usize = 1 << 27;

/// Between two looks whether an answer is still wanted.
const LOOK: Duration = Duration::from_millis(20);

/// Serves unwrap requests until the input ends.
///
/// # Errors
/// A broken pipe or a message that does not follow the protocol.
pub fn worker_main(mut input: impl Read, mut output: impl Write) -> io::Result<()> {
    while let Some(message) = receive(&mut input)? {
        let pieces: Vec<Piece> = decoded(&message)?;
        let answers = InProcess.unwrap(&pieces).map_err(io::Error::other)?;
        send(&mut output, &encoded(&answers)?)?;
    }
    Ok(())
}

fn config() -> impl bincode::config::Config {
    bincode::config::standard().with_limit::<MESSAGE_LIMIT>()
}

fn encoded<T: Serialize>(value: &T) -> io::Result<Vec<u8>> {
    bincode::serde::encode_to_vec(value, config()).map_err(io::Error::other)
}

fn decoded<T: DeserializeOwned>(bytes: &[u8]) -> io::Result<T> {
    match bincode::serde::decode_from_slice(bytes, config()) {
        Ok((value, used)) if used == bytes.len() => Ok(value),
        Ok(_) => Err(io::Error::new(io::ErrorKind::InvalidData, "a message with a tail")),
        Err(error) => Err(io::Error::new(io::ErrorKind::InvalidData, error)),
    }
}

fn send(output: &mut impl Write, body: &[u8]) -> io::Result<()> {
    let len = u32::try_from(body.len()).ok().filter(|&len| len as usize <= MESSAGE_LIMIT);
    let len = len.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the message is too large"))?;
    output.write_all(&len.to_le_bytes())?;
    output.write_all(body)?;
    output.flush()
}

/// The next message; None at a clean end.
fn receive(input: &mut impl Read) -> io::Result<Option<Vec<u8>>> {
    let mut len = [0; 4];
    let mut have = 0;
    while have < len.len() {
        match input.read(&mut len[have..])? {
            0 if have == 0 => return Ok(None),
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            n => have += n,
        }
    }
    let len = u32::from_le_bytes(len) as usize;
    if len > MESSAGE_LIMIT {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "the message is too large"));
    }
    // Grows with what arrives, not with what the length promises.
    let mut body = Vec::new();
    input.take(len as u64).read_to_end(&mut body)?;
    if body.len() == len { Ok(Some(body)) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
}

/// Unwraps through worker processes, one per thread that asks.
pub struct Worker {
    program: PathBuf,
    arguments: Vec<OsString>,
    /// Time for any request, and besides for each of its triangles.
    limit: Duration,
    limit_per_triangle: Duration,
    idle: Mutex<Vec<Process>>,
}

impl Worker {
    /// A worker program with its arguments, and a time limit that only a hang can reach.
    pub fn new(program: impl Into<PathBuf>, arguments: impl IntoIterator<Item = impl Into<OsString>>) -> Self {
        Self {
            program: program.into(),
            arguments: arguments.into_iter().map(Into::into).collect(),
            limit: Duration::from_secs(30),
            limit_per_triangle: Duration::from_millis(10),
            idle: Mutex::default(),
        }
    }

    /// Another time limit: for any request, and besides for each of its triangles.
    #[must_use]
    pub fn with_limit(self, limit: Duration, per_triangle: Duration) -> Self {
        Self { limit, limit_per_triangle: per_triangle, ..self }
    }

    fn process(&self) -> Result<Process, UnwrapError> {
        let idle = self.idle.lock().unwrap_or_else(std::sync::PoisonError::into_inner).pop();
        match idle {
            Some(process) => Ok(process),
            None => Process::start(&self.program, &self.arguments).map_err(|error| {
                UnwrapError(format!("the unwrap worker {} does not start: {error}", self.program.display()))
            }),
        }
    }

    /// One round trip; the process goes back to the idle ones if it behaved, else it is killed.
    fn ask(&self, pieces: &[Piece], progress: &dyn Progress) -> Result<Result<Answers, String>, UnwrapError> {
        let request = match encoded(&pieces) {
            Ok(request) => request,
            Err(error) => return Ok(Err(format!("the piece cannot be sent: {error}"))),
        };
        let triangles: usize = pieces.iter().map(|p| p.triangles.len()).sum();
        let limit = self.limit + self.limit_per_triangle * u32::try_from(triangles).unwrap_or(u32::MAX);
        let process = self.process()?;
        let answers = process.exchange(request, limit, progress).and_then(|reply| {
            decoded::<Answers>(&reply)
                .ok()
                .filter(|answers| answers.len() == pieces.len())
                .ok_or_else(|| "the unwrap worker answered nonsense".into())
        });
        if answers.is_ok() {
            self.idle.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(process);
        }
        Ok(answers)
    }
}

impl Unwrapper for Worker {
    fn unwrap(&self, pieces: &[Piece]) -> Result<Answers, UnwrapError> {
        self.unwrap_while(pieces, &Silent)
    }

    fn unwrap_while(&self, pieces: &[Piece], progress: &dyn Progress) -> Result<Answers, UnwrapError> {
        match self.ask(pieces, progress)? {
            Ok(answers) => Ok(answers),
            Err(why) if pieces.len() == 1 => Ok(vec![Err(why)]),
            Err(why) if progress.is_cancelled() => Err(UnwrapError(why)),
            Err(_) => {
                let alone = |piece| self.ask(std::slice::from_ref(piece), progress);
                let one = |piece| Ok(alone(piece)?.map(|mut answers| answers.remove(0)));
                pieces.iter().map(|piece| Ok(one(piece)?.and_then(|answer| answer))).collect()
            }
        }
    }
}

/// A running worker with a thread on either pipe, so that a worker that neither reads nor writes cannot block us.
struct Process {
    child: Child,
    requests: Option<Sender<Vec<u8>>>,
    replies: Receiver<io::Result<Option<Vec<u8>>>>,
    threads: Vec<JoinHandle<()>>,
}

impl Process {
    fn start(program: &PathBuf, arguments: &[OsString]) -> io::Result<Self> {
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let (Some(mut stdin), Some(mut stdout)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(io::Error::other("no pipes"));
        };
        let (requests, outbox) = channel::<Vec<u8>>();
        let (inbox, replies) = channel();
        let writer = std::thread::spawn(move || {
            for request in outbox {
                // A worker that is gone shows at the reading end.
                if send(&mut stdin, &request).is_err() {
                    break;
                }
            }
        });
        let reader = std::thread::spawn(move || {
            loop {
                let reply = receive(&mut stdout);
                let last = !matches!(reply, Ok(Some(_)));
                if inbox.send(reply).is_err() || last {
                    break;
                }
            }
        });
        Ok(Self { child, requests: Some(requests), replies, threads: vec![writer, reader] })
    }

    fn exchange(&self, request: Vec<u8>, limit: Duration, progress: &dyn Progress) -> Result<Vec<u8>, String> {
        let sent = self.requests.as_ref().is_some_and(|requests| requests.send(request).is_ok());
        if !sent {
            return Err(format!("{FAILED} died"));
        }
        let until = Instant::now().checked_add(limit);
        let reply = loop {
            let left = until.map_or(LOOK, |until| until.saturating_duration_since(Instant::now()));
            let reply = self.replies.recv_timeout(left.min(LOOK));
            if progress.is_cancelled() {
                return Err("the answer is not wanted any more".into());
            }
            if left <= LOOK && until.is_some() || !matches!(reply, Err(RecvTimeoutError::Timeout)) {
                break reply;
            }
        };
        match reply {
            Ok(Ok(Some(reply))) => Ok(reply),
            Ok(Err(error)) if error.kind() == io::ErrorKind::InvalidData => Err(format!("{FAILED} answered nonsense")),
            Ok(_) | Err(RecvTimeoutError::Disconnected) => Err(format!("{FAILED} died")),
            Err(RecvTimeoutError::Timeout) => Err(format!("{FAILED} took too long")),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Killing first closes both pipes, so that the threads end. Either call fails only if the worker has ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.requests = None;
        // A grandchild may hold the pipes open for as long as it likes: only ended threads are joined.
        for thread in self.threads.drain(..).filter(JoinHandle::is_finished) {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> Piece {
        Piece {
            positions: vec![[-4.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]],
            normals: vec![],
            triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        }
    }

    #[test]
    fn the_protocol_goes_both_ways() {
        let mut input = Vec::new();
        send(&mut input, &encoded(&vec![tetrahedron()]).unwrap()).unwrap();
        let mut output = Vec::new();
        worker_main(&input[..], &mut output).unwrap();
        let answers: Answers = decoded(&receive(&mut &output[..]).unwrap().unwrap()).unwrap();
        assert_eq!(answers, InProcess.unwrap(&[tetrahedron()]).unwrap());
        assert_eq!(answers[0].as_ref().unwrap().uvs.len(), 4);
    }

    #[test]
    fn cut_and_forged_messages_are_errors() {
        let mut input = Vec::new();
        send(&mut input, &encoded(&vec![tetrahedron()]).unwrap()).unwrap();
        for cut in 1..input.len() {
            assert!(worker_main(&input[..cut], io::sink()).is_err(), "{cut}");
        }
        assert!(worker_main(&[255; 9][..], io::sink()).is_err());
        // A list of 2^60 pieces in a short message.
        assert!(worker_main(&[9, 0, 0, 0, 253, 0, 0, 0, 0, 0, 0, 0, 16][..], io::sink()).is_err());
    }

    #[cfg(unix)]
    fn shell(script: &str) -> Worker {
        Worker::new("/bin/sh", ["-c", script]).with_limit(Duration::from_millis(300), Duration::ZERO)
    }

    #[cfg(unix)]
    #[test]
    fn a_worker_that_fails_in_any_way_is_told_and_survived() {
        for (script, word) in [
            ("exec sleep 60", "too long"),
            ("kill -ABRT $$", "died"),
            ("exit 3", "died"),
            ("cat", "nonsense"),
            ("printf '\\377\\377\\377\\377'", "nonsense"),
            ("printf '\\004\\000\\000\\000ab'", "died"),
        ] {
            let answers = shell(script).unwrap(&[tetrahedron(), tetrahedron()]).unwrap();
            assert_eq!(answers.len(), 2);
            for answer in answers {
                assert!(answer.clone().is_err_and(|why| why.contains(word)), "{script}: {answer:?}");
            }
        }
    }

    #[test]
    fn a_worker_that_cannot_start_is_an_error() {
        let error = Worker::new("no/such/program", [""; 0]).unwrap(&[tetrahedron()]).unwrap_err();
        assert!(error.0.contains("no/such/program"));
    }

    /// A worker that never answers: only its limit of half a minute or the cancellation ends it.
    #[cfg(unix)]
    #[test]
    fn a_worker_whose_answer_is_not_wanted_is_killed() {
        use std::sync::atomic::{AtomicU32, Ordering};
        struct Third(AtomicU32);
        impl Progress for Third {
            fn begin(&self, _: &'static str, _: u64) {}
            fn advance(&self, _: u64) {}
            fn is_cancelled(&self) -> bool {
                self.0.fetch_add(1, Ordering::Relaxed) >= 2
            }
        }
        let worker = Worker::new("sleep", ["600"]);
        let progress = Third(AtomicU32::new(0));
        let error = worker.unwrap_while(&[tetrahedron(), tetrahedron()], &progress).unwrap_err();
        assert!(error.0.contains("not wanted"), "{error}");
        assert_eq!(progress.0.load(Ordering::Relaxed), 4, "it is not asked again, piece by piece");
        assert!(worker.idle.lock().unwrap().is_empty());
    }
}
