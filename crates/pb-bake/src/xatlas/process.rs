//! One running helper. Nothing here waits longer than its time limit, holds more than a bounded answer, or leaves a
//! process behind.
//!
//! Three threads serve the pipes: a full pipe must never block whoever watches the clock.

use super::fault::HelperFault;
use super::find::Helper;
use super::wire::{Charts, HEADER_BYTES, Header, Identity, Kind, MAX_TEXT_BYTES, Malformed, Request, VERSION, message};
use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time that a helper has for starting and saying who it is.
pub const PROBE_LIMIT: Duration = Duration::from_secs(10);
/// Bytes of standard error that are kept; the rest is read and dropped.
const MAX_STDERR_BYTES: usize = 2048;
/// Bytes that are taken from the pipe at once, and how many such pieces may wait.
const PIECE: (usize, usize) = (1 << 16, 4);
/// How long a helper that closed its output has for ending before it is ended.
const LAST_BREATH: Duration = Duration::from_millis(200);

/// A helper that has said who it is. Ends, and is waited for, when dropped.
pub struct Process {
    child: Child,
    requests: SyncSender<Vec<u8>>,
    answers: Incoming,
    complaints: Complaints,
    identity: Identity,
}

/// Why no bytes came.
enum Silence {
    Ended,
    TimeIsOver,
}

impl Process {
    /// Starts the program and probes it.
    pub fn start(helper: &Helper, limit: Duration) -> Result<Process, HelperFault> {
        let mut command = Command::new(&helper.path);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // A group of its own, so that whatever it starts ends with it.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let start = |source| HelperFault::Start { path: helper.path.clone(), source };
        let mut child = command.spawn().map_err(start)?;
        let pipes = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let (Some(stdin), Some(stdout), Some(stderr)) = pipes else { unreachable!("all three are piped") };
        let mut process = Process {
            child,
            requests: write_in_background(stdin),
            answers: Incoming::from(stdout),
            complaints: Complaints::from(stderr),
            identity: Identity { name: String::new(), xatlas: String::new() },
        };
        let deadline = Instant::now() + limit;
        let body = process.ask(Kind::Probe, &[], Kind::ProbeAnswer, 0..=Identity::MAX_BYTES, (limit, deadline))?;
        process.identity = Identity::decode(&body)?;
        Ok(process)
    }

    /// Who it is.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Charts for a cluster, not yet checked against it. After any fault but a refusal the process is of no use.
    pub fn charts(&mut self, request: &Request, limit: Duration) -> Result<Charts, HelperFault> {
        let body = request.encode().map_err(HelperFault::BadRequest)?;
        let bytes = Charts::answer_bytes(request.triangles.len());
        let time = (limit, Instant::now() + limit);
        Ok(Charts::decode(&self.ask(Kind::Charts, &body, Kind::ChartsAnswer, bytes..=bytes, time)?)?)
    }

    /// Sends a message and returns the body of the answer, whose length is in `expected`.
    fn ask(
        &mut self,
        kind: Kind,
        body: &[u8],
        answer: Kind,
        expected: std::ops::RangeInclusive<usize>,
        (limit, deadline): (Duration, Instant),
    ) -> Result<Vec<u8>, HelperFault> {
        // Where the helper is gone, so is its answer, which says more.
        if let Err(TrySendError::Full(_)) = self.requests.try_send(message(kind, body)) {
            return Err(Malformed("it answers before it has read what it is asked".into()).into());
        }
        let mut header = [0; HEADER_BYTES];
        self.answers.fill(&mut header, deadline).map_err(|s| self.fault(s, limit))?;
        let header = Header::parse(&header)?;
        if header.version != VERSION {
            return Err(HelperFault::WrongVersion { found: header.version });
        }
        let expected = if header.kind == Kind::Refusal { 0..=MAX_TEXT_BYTES } else { expected };
        let bytes = usize::try_from(header.body_bytes).unwrap_or(usize::MAX);
        if (header.kind != answer && header.kind != Kind::Refusal) || !expected.contains(&bytes) {
            let wanted = format!("{answer:?} of {expected:?} bytes");
            return Err(Malformed(format!("{:?} of {bytes} bytes instead of {wanted}", header.kind)).into());
        }
        let mut body = vec![0; bytes];
        self.answers.fill(&mut body, deadline).map_err(|s| self.fault(s, limit))?;
        if header.kind == Kind::Refusal {
            return Err(HelperFault::Refused(printable(&body)));
        }
        Ok(body)
    }

    fn fault(&mut self, silence: Silence, limit: Duration) -> HelperFault {
        let how = match silence {
            Silence::Ended => Some(self.end_of_child()),
            Silence::TimeIsOver => None,
        };
        let stderr = self.complaints.text(if how.is_some() { LAST_BREATH } else { Duration::ZERO });
        match how {
            Some(how) => HelperFault::Died { how, stderr },
            None => HelperFault::TimedOut { limit, stderr },
        }
    }

    /// How the child ended, after its output did.
    fn end_of_child(&mut self) -> String {
        let patience = Instant::now() + LAST_BREATH;
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return status.to_string(),
                Ok(None) if Instant::now() < patience => std::thread::sleep(Duration::from_millis(5)),
                Ok(None) => return "it closed its output".into(),
                Err(e) => return e.to_string(),
            }
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Errors mean that it has already ended.
        #[cfg(unix)]
        if let Some(group) = rustix::process::Pid::from_raw(self.child.id() as i32) {
            let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A writer that takes one message at a time.
fn write_in_background(mut stdin: impl Write + Send + 'static) -> SyncSender<Vec<u8>> {
    let (sender, messages) = sync_channel::<Vec<u8>>(1);
    std::thread::spawn(move || {
        for message in messages {
            if stdin.write_all(&message).and_then(|()| stdin.flush()).is_err() {
                return;
            }
        }
    });
    sender
}

/// The beginning of a helper's standard error.
struct Complaints {
    kept: Arc<Mutex<Vec<u8>>>,
    /// Says nothing, and closes where the stream ends.
    end: Receiver<()>,
}

impl Complaints {
    /// Reads all of a stream and keeps up to [`MAX_STDERR_BYTES`].
    fn from(mut stream: impl Read + Send + 'static) -> Complaints {
        let kept = Arc::new(Mutex::new(Vec::new()));
        let (here, (sender, end)) = (kept.clone(), sync_channel(0));
        std::thread::spawn(move || {
            let _ends_with_this_thread: SyncSender<()> = sender;
            let mut piece = [0; 4096];
            while let Ok(bytes @ 1..) = stream.read(&mut piece) {
                let mut kept = here.lock().unwrap_or_else(PoisonError::into_inner);
                let room = MAX_STDERR_BYTES - kept.len();
                kept.extend(&piece[..bytes.min(room)]);
            }
        });
        Complaints { kept, end }
    }

    /// What it said, waiting so long for the stream to end.
    fn text(&self, patience: Duration) -> String {
        let _ = self.end.recv_timeout(patience);
        printable(&self.kept.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Bytes of a helper's standard output, with a deadline.
struct Incoming {
    pieces: Receiver<Vec<u8>>,
    piece: Vec<u8>,
    used: usize,
}

impl Incoming {
    fn from(mut stdout: impl Read + Send + 'static) -> Incoming {
        let (sender, pieces) = sync_channel(PIECE.1);
        std::thread::spawn(move || {
            let mut buffer = vec![0; PIECE.0];
            while let Ok(bytes @ 1..) = stdout.read(&mut buffer) {
                if sender.send(buffer[..bytes].to_vec()).is_err() {
                    return;
                }
            }
        });
        Incoming { pieces, piece: Vec::new(), used: 0 }
    }

    /// Fills all of `out`, or says why not.
    fn fill(&mut self, mut out: &mut [u8], deadline: Instant) -> Result<(), Silence> {
        while !out.is_empty() {
            if self.used == self.piece.len() {
                let wait = deadline.saturating_duration_since(Instant::now());
                self.piece = self.pieces.recv_timeout(wait).map_err(|e| match e {
                    RecvTimeoutError::Timeout => Silence::TimeIsOver,
                    RecvTimeoutError::Disconnected => Silence::Ended,
                })?;
                self.used = 0;
            }
            let bytes = out.len().min(self.piece.len() - self.used);
            out[..bytes].copy_from_slice(&self.piece[self.used..self.used + bytes]);
            self.used += bytes;
            out = &mut out[bytes..];
        }
        Ok(())
    }
}

/// Text from outside for a message: no control characters, bounded.
fn printable(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(MAX_STDERR_BYTES)]);
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect::<String>().trim().to_string()
}
