//! Charts by xatlas, in a process of its own.
//!
//! xatlas is C++ that may crash, answer nonsense or run for ever on a hard mesh. So pb-bake never links it: it starts
//! the program pb-xatlas (tools/xatlas-helper), gives it one cluster at a time over pipes, waits for a limited time,
//! and checks the answer as it checks a file. Whatever goes wrong is a [`HelperFault`]; the caller then cuts this
//! cluster by the built-in method. docs/xatlas-helper.md has the protocol.

mod check;
mod cluster;
mod fault;
mod find;
mod overlap;
mod pool;
mod process;
pub mod wire;

pub use check::{AnswerFault, check};
pub use cluster::{HelperCharts, HelperSummary, MAX_TOLD_FAULTS};
pub use fault::HelperFault;
pub use find::{Found, Helper, PROGRAM};
pub use pool::{MAX_HANGS, Pool};
pub use process::{PROBE_LIMIT, Process};
pub use wire::{Charts, Identity, Options, Request};
