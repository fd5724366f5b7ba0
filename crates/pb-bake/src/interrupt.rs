//! Ctrl-C, and the signal that ends a program: nothing half-written stays, and the user learns how to go on.

use crate::failure::{Failure, blame_machine};
use pb_bake::traces;
use std::sync::{Mutex, PoisonError};

/// Exit code after an interruption: what shells report for it.
const EXIT_CODE: i32 = 130;

static ADVICE: Mutex<Option<String>> = Mutex::new(None);

/// From now on an interruption cleans up first.
///
/// # Errors
/// The system refuses the handler.
pub fn install() -> Result<(), Failure> {
    let end = || {
        traces::remove();
        let advice = advice().unwrap_or_else(|| "nothing was written".into());
        eprintln!("\npb-bake: interrupted; {advice}");
        std::process::exit(EXIT_CODE);
    };
    ctrlc::set_handler(end).map_err(|e| blame_machine(format!("cannot watch for interruptions: {e}")))
}

/// What to say then.
pub fn advise(text: Option<String>) {
    *ADVICE.lock().unwrap_or_else(PoisonError::into_inner) = text;
}

/// What would be said now.
pub fn advice() -> Option<String> {
    ADVICE.lock().unwrap_or_else(PoisonError::into_inner).clone()
}
