//! Which exit code an error gets.

use pb_lod::progressive_buffers::model::ModelError;

use crate::flypath::FlypathError;

/// How a run ended that did not fail half-way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All is well.
    Done,
    /// All was drawn, but with chunks left out because they are damaged.
    Damaged,
}

/// Exit code of a run: 0 done, 1 the archive or the flypath is at fault, 2 the command line or the machine is.
pub fn exit_code(result: &anyhow::Result<Outcome>) -> u8 {
    match result {
        Ok(Outcome::Done) => 0,
        Ok(Outcome::Damaged) => 1,
        Err(error) if is_input(error) => 1,
        Err(_) => 2,
    }
}

fn is_input(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause.downcast_ref::<ModelError>().is_some_and(|e| !e.is_machine())
            || cause.downcast_ref::<FlypathError>().is_some_and(|e| !matches!(e, FlypathError::Write { .. }))
    })
}
