//! Progress for people: a bar per stage on a terminal, plain lines elsewhere, nothing when quiet; for programs, JSON. All
//! on standard error, so that standard output stays for results.

mod forecast;

use forecast::Forecast;
pub use forecast::Work;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Resolution of a bar.
const STEPS: f64 = 1000.0;
/// Without a terminal, a long stage says how far it is this often.
const LINE_INTERVAL: Duration = Duration::from_secs(10);
/// Bars and JSON say it this often.
const INTERVAL: Duration = Duration::from_millis(200);

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Not at all.
    Quiet,
    /// A line per stage.
    Lines,
    /// A bar per stage.
    Bars,
    /// A JSON object per line.
    Json,
}

impl Mode {
    /// What was asked for, else what suits standard error.
    pub fn of(quiet: bool, json: bool) -> Self {
        match (json, quiet, std::io::stderr().is_terminal()) {
            (true, _, _) => Mode::Json,
            (_, true, _) => Mode::Quiet,
            (_, false, true) => Mode::Bars,
            (_, false, false) => Mode::Lines,
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
    state: Arc<Mutex<State>>,
    /// Shows how far it is every so often, until the sender is dropped.
    ticker: Option<(Sender<()>, JoinHandle<()>)>,
}

struct State {
    mode: Mode,
    start: Instant,
    forecast: Forecast,
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
    pub fn new(mode: Mode, work: Work) -> Self {
        let forecast = Forecast::new(work, rayon::current_num_threads());
        let state = State { mode, start: Instant::now(), forecast, now: None, done: Vec::new() };
        let state = Arc::new(Mutex::new(state));
        let ticker = (mode != Mode::Quiet).then(|| {
            let (sender, end) = channel();
            let state = state.clone();
            let tick = move || {
                while end.recv_timeout(INTERVAL) == Err(RecvTimeoutError::Timeout) {
                    lock(&state).show();
                }
            };
            (sender, std::thread::spawn(tick))
        });
        Self { state, ticker }
    }

    /// Ends the stage that runs, if it is another one, and begins this one. A stage that ended does not begin again.
    pub fn stage(&self, name: &'static str) {
        let mut state = lock(&self.state);
        let known = |s: &State| s.now.as_ref().is_some_and(|r| r.name == name) || s.done.iter().any(|d| d.name == name);
        if known(&state) {
            return;
        }
        state.end();
        let start = Instant::now();
        let at = state.start.elapsed().as_secs_f64();
        state.forecast.begin(name, at);
        let bar = (state.mode == Mode::Bars).then(|| bar(name));
        state.now = Some(Running { name, start, last_line: start, bar });
        state.show();
    }

    /// How much of the running stage is done, 0 to 1.
    pub fn share(&self, share: f32) {
        let mut state = lock(&self.state);
        let at = state.start.elapsed().as_secs_f64();
        state.forecast.tell(share.into(), at);
    }

    /// What is known of the work by now.
    pub fn work(&self, learn: impl FnOnce(&mut Work)) {
        learn(&mut lock(&self.state).forecast.work);
    }

    /// Something that a person should know; not when quiet.
    pub fn note(&self, text: &str) {
        let state = lock(&self.state);
        match (state.mode, state.now.as_ref().and_then(|r| r.bar.as_ref())) {
            (Mode::Quiet, _) => {}
            (Mode::Json, _) => eprintln!("{}", serde_json::json!({ "note": text })),
            (_, Some(bar)) => bar.suspend(|| eprintln!("{text}")),
            (_, None) => eprintln!("{text}"),
        }
    }

    /// Ends the running stage; all stages in order.
    pub fn finish(self) -> Vec<StageTime> {
        let mut state = lock(&self.state);
        state.end();
        std::mem::take(&mut state.done)
    }
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl State {
    /// Shows how far the running stage is.
    fn show(&mut self) {
        let at = self.start.elapsed().as_secs_f64();
        let Some(running) = &mut self.now else { return };
        let (share, left) = (self.forecast.share(), self.forecast.remaining(at));
        let rate = self.forecast.rate();
        let in_words = || {
            let rate = rate.map(|(rate, unit)| format!("{:.2} M {unit}/s, ", rate / 1e6)).unwrap_or_default();
            format!("{rate}{} left, {} in all", time(left.stage), time(left.total))
        };
        match (self.mode, &running.bar) {
            (_, Some(bar)) => {
                bar.set_position((share.clamp(0.0, 1.0) * STEPS) as u64);
                bar.set_message(in_words());
            }
            (Mode::Lines, _) if running.last_line.elapsed() > LINE_INTERVAL => {
                running.last_line = Instant::now();
                eprintln!("{:>9} {:3.0} %, {}", running.name, share * 100.0, in_words());
            }
            (Mode::Json, _) => {
                let line = serde_json::json!({
                    "stage": running.name, "share": share, "seconds": at, "rate": rate.map(|r| r.0),
                    "stage_remaining_seconds": left.stage, "remaining_seconds": left.total,
                });
                eprintln!("{line}");
            }
            _ => {}
        }
    }

    fn end(&mut self) {
        let Some(running) = self.now.take() else { return };
        let seconds = running.start.elapsed().as_secs_f64();
        if let Some(bar) = running.bar {
            bar.finish_and_clear();
        }
        if matches!(self.mode, Mode::Lines | Mode::Bars) {
            eprintln!("{:>9} {seconds:8.2} s", running.name);
        }
        self.done.push(StageTime { name: running.name, seconds });
    }
}

/// As people say it.
fn time(seconds: f64) -> String {
    match seconds.round() as u64 {
        s @ 0..120 => format!("{s} s"),
        s @ 120..7200 => format!("{} min", s.div_ceil(60)),
        s => format!("{} h {} min", s / 3600, s % 3600 / 60),
    }
}

fn bar(name: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{prefix:>9} [{bar:30}] {percent:>3} % {elapsed}, {msg}");
    let bar = ProgressBar::new(STEPS as u64).with_style(style.expect("the template is right")).with_prefix(name);
    bar.enable_steady_tick(INTERVAL);
    bar
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some((sender, thread)) = self.ticker.take() {
            drop(sender);
            // It ends at once, and cannot have panicked in a way that matters here.
            let _ = thread.join();
        }
        if let Some(bar) = lock(&self.state).now.take().and_then(|r| r.bar) {
            bar.finish_and_clear(); // an error message follows
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_timed_in_order_and_never_twice() {
        let progress = Progress::new(Mode::Quiet, Work::default());
        ["read", "bake", "bake", "read", "write"].iter().for_each(|s| progress.stage(s));
        let names: Vec<&str> = progress.finish().iter().map(|s| s.name).collect();
        assert_eq!(names, ["read", "bake", "write"]);
    }

    #[test]
    fn times_are_said_as_people_do() {
        assert_eq!([0.4, 61.0, 150.0, 7300.0].map(time), ["0 s", "61 s", "3 min", "2 h 1 min"]);
    }
}
