//! Progress for people: a bar per stage on a terminal, plain lines elsewhere, nothing when quiet. All on standard
//! error, so that standard output stays for results.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Resolution of a bar.
const STEPS: f32 = 1000.0;
/// Without a terminal, a long stage says how far it is this often.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Not at all.
    Quiet,
    /// A line per stage.
    Lines,
    /// A bar per stage.
    Bars,
}

impl Mode {
    /// What suits standard error.
    pub fn of(quiet: bool) -> Self {
        match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => Mode::Quiet,
            (false, true) => Mode::Bars,
            (false, false) => Mode::Lines,
        }
    }
}

/// A finished stage.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct StageTime {
    /// Its name.
    pub name: &'static str,
    /// How long it took.
    pub seconds: f64,
}

/// Shows stages one after the other. May be called from any thread.
pub struct Progress {
    mode: Mode,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    now: Option<Running>,
    done: Vec<StageTime>,
}

struct Running {
    name: &'static str,
    start: Instant,
    last_line: Instant,
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Nothing runs yet.
    pub fn new(mode: Mode) -> Self {
        Self { mode, state: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the stage that runs, if it is another one, and begins this one. A stage that ended does not begin again.
    pub fn stage(&self, name: &'static str) {
        let mut state = self.lock();
        let known = |s: &State| s.now.as_ref().is_some_and(|r| r.name == name) || s.done.iter().any(|d| d.name == name);
        if known(&state) {
            return;
        }
        self.end(&mut state);
        let start = Instant::now();
        let bar = (self.mode == Mode::Bars).then(|| bar(name));
        state.now = Some(Running { name, start, last_line: start, bar });
    }

    /// How much of the running stage is done, 0 to 1.
    pub fn share(&self, share: f32) {
        let mut state = self.lock();
        let Some(running) = &mut state.now else { return };
        if let Some(bar) = &running.bar {
            bar.set_position((share.clamp(0.0, 1.0) * STEPS) as u64);
        } else if self.mode == Mode::Lines && running.last_line.elapsed() > LINE_INTERVAL {
            running.last_line = Instant::now();
            eprintln!("{:>9} {:3.0} %", running.name, share * 100.0);
        }
    }

    /// Something that a person should know; not when quiet.
    pub fn note(&self, text: &str) {
        match (self.mode, self.lock().now.as_ref().and_then(|r| r.bar.as_ref())) {
            (Mode::Quiet, _) => {}
            (_, Some(bar)) => bar.suspend(|| eprintln!("{text}")),
            (_, None) => eprintln!("{text}"),
        }
    }

    /// Ends the running stage; all stages in order.
    pub fn finish(self) -> Vec<StageTime> {
        let mut state = self.lock();
        self.end(&mut state);
        std::mem::take(&mut state.done)
    }

    fn end(&self, state: &mut State) {
        let Some(running) = state.now.take() else { return };
        let seconds = running.start.elapsed().as_secs_f64();
        if let Some(bar) = running.bar {
            bar.finish_and_clear();
        }
        if self.mode != Mode::Quiet {
            eprintln!("{:>9} {seconds:8.2} s", running.name);
        }
        state.done.push(StageTime { name: running.name, seconds });
    }
}

fn bar(name: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{prefix:>9} [{bar:40}] {percent:>3} % {elapsed}");
    let bar = ProgressBar::new(STEPS as u64).with_style(style.expect("the template is right")).with_prefix(name);
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = self.lock().now.take().and_then(|r| r.bar) {
            bar.finish_and_clear(); // an error message follows
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_timed_in_order_and_never_twice() {
        let progress = Progress::new(Mode::Quiet);
        ["read", "bake", "bake", "read", "write"].iter().for_each(|s| progress.stage(s));
        let names: Vec<&str> = progress.finish().iter().map(|s| s.name).collect();
        assert_eq!(names, ["read", "bake", "write"]);
    }
}
