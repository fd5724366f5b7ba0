//! The xatlas helper as pb-bake sees it: one that works, and all the ways in which one can fail. The failing ones are
//! shell scripts that write prepared bytes.
#![cfg(unix)]

mod answers;
mod fake;
mod faults;
mod pool;
mod real;
mod scans;
