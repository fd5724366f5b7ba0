//! pb-xatlas: cuts clusters of triangles into charts with xatlas, for `pb-bake --charts xatlas`.
//!
//! It reads requests on standard input and answers on standard output, one after the other, until the input ends:
//! docs/xatlas-helper.md. It is a process of its own because xatlas is C++ that may crash or run for ever; it ends
//! itself when a request's time is over or memory grows beyond a bound. It opens no file.

mod cut;
#[path = "../../../crates/pb-bake/src/xatlas/overlap.rs"]
mod overlap;
#[path = "../../../crates/pb-bake/src/xatlas/wire.rs"]
#[allow(dead_code)] // each program encodes what the other decodes
mod wire;
mod xatlas;

use std::io::{self, ErrorKind, IsTerminal, Read, Write};
use std::process::{ExitCode, exit};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;
use wire::{HEADER_BYTES, Header, Identity, Kind, MAX_REQUEST_BYTES, Request, VERSION, message, read_body};

/// A cluster of the most triangles that a request may have needs less than half of it.
const MAX_MEMORY_BYTES: u64 = 8 << 30;
/// Exit code where a request took longer than it was allowed to.
const TOO_SLOW: i32 = 4;

const NOTICES: &str = include_str!(concat!(env!("OUT_DIR"), "/notices.txt"));
const HELP: &str = "\
pb-xatlas cuts meshes into charts with xatlas. pb-bake starts it; there is nothing to do with it by hand.

  pb-xatlas --version     what it is
  pb-xatlas --licences    of xatlas and of what xatlas contains
  pb-bake doctor          whether pb-bake finds it

pb-bake looks for it beside itself, then in PATH; --xatlas-helper FILE or PB_XATLAS=FILE name another one.
";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let identity = identity();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] if io::stdin().is_terminal() => eprint!("{HELP}"),
        [] => return serve(),
        ["--version" | "-V"] => println!("{}, protocol {VERSION}, {}", identity.name, identity.xatlas),
        ["--licences" | "--licenses"] => print!("{NOTICES}"),
        ["--help" | "-h"] => print!("{HELP}"),
        _ => {
            eprint!("pb-xatlas: it takes no arguments\n\n{HELP}");
            return ExitCode::from(2);
        }
    }
    ExitCode::SUCCESS
}

fn identity() -> Identity {
    let name = concat!("pb-xatlas ", env!("CARGO_PKG_VERSION")).to_string();
    Identity { name, xatlas: concat!("xatlas of ", env!("XATLAS_SOURCE")).to_string() }
}

fn serve() -> ExitCode {
    xatlas::limit_memory(MAX_MEMORY_BYTES);
    loop {
        match exchange(&mut io::stdin().lock(), &mut io::stdout().lock()) {
            Ok(true) => {}
            Ok(false) => return ExitCode::SUCCESS,
            // Whoever asked is gone.
            Err(e) if e.kind() == ErrorKind::BrokenPipe => return ExitCode::SUCCESS,
            Err(e) => {
                eprintln!("pb-xatlas: {e}");
                return ExitCode::FAILURE;
            }
        }
    }
}

/// One message and its answer; false at the end of the input. After an error the stream cannot be followed further.
fn exchange(from: &mut impl Read, to: &mut impl Write) -> io::Result<bool> {
    let Some(header) = read_header(from)? else { return Ok(false) };
    let answer = match header.kind {
        Kind::Probe if header.body_bytes == 0 => message(Kind::ProbeAnswer, &identity().encode()),
        Kind::Charts if header.version == VERSION && header.body_bytes <= MAX_REQUEST_BYTES as u64 => {
            let body = read_body(from, header.body_bytes as usize)?;
            match Request::decode(&body).map_err(|e| e.to_string()).and_then(|r| cut_in_time(&r)) {
                Ok(charts) => message(Kind::ChartsAnswer, &charts),
                Err(why) => message(Kind::Refusal, why.as_bytes()),
            }
        }
        _ => return Err(invalid(format!("unexpected message {header:?}; this is protocol {VERSION}"))),
    };
    to.write_all(&answer)?;
    to.flush()?;
    Ok(true)
}

fn read_header(from: &mut impl Read) -> io::Result<Option<Header>> {
    let mut bytes = [0; HEADER_BYTES];
    let first = from.read(&mut bytes)?;
    if first == 0 {
        return Ok(None);
    }
    from.read_exact(&mut bytes[first..])?;
    Header::parse(&bytes).map(Some).map_err(invalid)
}

fn cut_in_time(request: &Request) -> Result<Vec<u8>, String> {
    let _watch = end_process_after(Duration::from_millis(request.time_limit_ms.into()));
    cut::cut(request).map(|charts| charts.encode())
}

/// Ends the process unless the returned value is dropped before.
fn end_process_after(limit: Duration) -> Sender<()> {
    let (sender, done) = channel();
    std::thread::spawn(move || {
        if done.recv_timeout(limit) == Err(RecvTimeoutError::Timeout) {
            eprintln!("pb-xatlas: no charts after {limit:?}");
            exit(TOO_SLOW);
        }
    });
    sender
}

fn invalid(what: impl ToString) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, what.to_string())
}
