//! Whose fault it is when the program ends early; the exit code says it.

use std::fmt::{self, Display};
use std::process::ExitCode;

/// Who can do something about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Blame {
    /// Whoever made the input or the archive.
    Input = 1,
    /// Whoever typed the command or keeps the machine.
    Machine = 2,
}

/// A message and an exit code.
#[derive(Debug)]
pub struct Failure {
    blame: Blame,
    message: String,
}

impl Failure {
    /// 1 or 2.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(self.blame as u8)
    }

    /// Nothing but another input will do.
    pub fn is_of_input(&self) -> bool {
        self.blame == Blame::Input
    }
}

impl Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.message)
    }
}

/// The input or the archive is at fault.
pub fn blame_input(what: impl Display) -> Failure {
    Failure { blame: Blame::Input, message: what.to_string() }
}

/// The usage or the machine is at fault.
pub fn blame_machine(what: impl Display) -> Failure {
    Failure { blame: Blame::Machine, message: what.to_string() }
}
