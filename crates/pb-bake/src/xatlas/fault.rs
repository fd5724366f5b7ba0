//! What can go wrong with a helper.

use super::check::AnswerFault;
use super::wire::{Malformed, VERSION};
use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

/// Why the helper has no charts for a cluster.
#[derive(Debug, Error)]
pub enum HelperFault {
    /// No helper is installed.
    #[error("there is no pb-xatlas beside this program nor in PATH; `just xatlas-helper` builds it")]
    Absent,
    /// A helper that was asked for by name is not there.
    #[error("{}: {from} names it as the xatlas helper, but there is no such file", path.display())]
    NotThere {
        /// What was named.
        path: PathBuf,
        /// Who named it.
        from: &'static str,
    },
    /// The program does not start.
    #[error("{}: the xatlas helper does not start: {source}", path.display())]
    Start {
        /// The program.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It speaks another version of the protocol.
    #[error("the xatlas helper speaks protocol {found}, this program {VERSION}; build both from the same source")]
    WrongVersion {
        /// The helper's.
        found: u16,
    },
    /// It ended without an answer.
    #[error("the xatlas helper ended early ({how}){}", said(stderr))]
    Died {
        /// Exit code or signal.
        how: String,
        /// What it wrote on standard error, shortened.
        stderr: String,
    },
    /// It did not answer in time.
    #[error("the xatlas helper gave no answer in {limit:?}{}", said(stderr))]
    TimedOut {
        /// How long it was given.
        limit: Duration,
        /// What it wrote on standard error, shortened.
        stderr: String,
    },
    /// It wrote something that is no answer.
    #[error("the xatlas helper does not keep to the protocol: {0}")]
    Garbage(#[from] Malformed),
    /// It refused the cluster.
    #[error("the xatlas helper refuses: {0}")]
    Refused(String),
    /// The cluster is nothing to give to a helper.
    #[error("not given to the xatlas helper: {0}")]
    BadRequest(Malformed),
    /// The charts are unusable.
    #[error("the xatlas helper's charts are unusable: {0}")]
    BadCharts(#[from] AnswerFault),
    /// It failed too often in this bake.
    #[error("the xatlas helper is not asked any more: {0}")]
    GivenUp(String),
}

/// What a helper said, on one line, for the end of a message.
fn said(stderr: &str) -> String {
    let line = stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    if line.is_empty() { String::new() } else { format!("; it said: {line}") }
}
