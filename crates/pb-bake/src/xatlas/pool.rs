//! Helpers for many clusters at once.

use super::check::check;
use super::fault::HelperFault;
use super::find::Helper;
use super::process::{PROBE_LIMIT, Process};
use super::wire::{Charts, Request};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// So many clusters may run out of time before the helper is not asked any more: a bake must end.
pub const MAX_HANGS: usize = 4;

/// Running helpers, one for each thread that asks. All end with the pool.
pub struct Pool {
    helper: Helper,
    idle: Mutex<Vec<Process>>,
    hangs: AtomicUsize,
    given_up: OnceLock<String>,
}

impl Pool {
    /// Starts and probes a first helper.
    pub fn new(helper: Helper) -> Result<Pool, HelperFault> {
        let first = Process::start(&helper, PROBE_LIMIT)?;
        Ok(Pool { helper, idle: Mutex::new(vec![first]), hangs: AtomicUsize::new(0), given_up: OnceLock::new() })
    }

    /// Charts of one cluster, checked. A helper that fails is ended, and the next cluster gets a fresh one; where that
    /// does not even start, or where [`MAX_HANGS`] clusters ran out of time, the pool asks no more.
    pub fn charts(&self, request: &Request, limit: Duration) -> Result<Charts, HelperFault> {
        if let Some(why) = self.given_up.get() {
            return Err(HelperFault::GivenUp(why.clone()));
        }
        let idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut process = match idle {
            Some(process) => process,
            None => Process::start(&self.helper, PROBE_LIMIT).inspect_err(|e| self.give_up(e))?,
        };
        let answer = process.charts(request, limit);
        if matches!(answer, Err(HelperFault::TimedOut { .. }))
            && self.hangs.fetch_add(1, Ordering::Relaxed) + 1 >= MAX_HANGS
        {
            self.give_up(&format!("{MAX_HANGS} clusters ran out of time"));
        }
        let still_good = matches!(answer, Ok(_) | Err(HelperFault::Refused(_) | HelperFault::BadRequest(_)));
        let charts = answer.and_then(|charts| {
            check(&request.positions, &request.triangles, &charts)?;
            Ok(charts)
        });
        if still_good {
            self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(process);
        }
        charts
    }

    fn give_up(&self, why: &impl ToString) {
        let _ = self.given_up.set(why.to_string());
    }
}
