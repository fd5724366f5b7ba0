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
        cause.is::<ModelError>()
            || cause.downcast_ref::<FlypathError>().is_some_and(|e| !matches!(e, FlypathError::Write { .. }))
    })
}

/// What went wrong, from the outside in; causes that repeat what was said already are left out.
pub fn message(error: &anyhow::Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |said, cause| match said.as_str() {
        "" => cause,
        _ if said.contains(&cause) => said,
        _ => format!("{said}: {cause}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_told_once() {
        let error = anyhow::anyhow!("the disk is full").context("a.csv: cannot write: the disk is full");
        assert_eq!(message(&error), "a.csv: cannot write: the disk is full");
        let error = anyhow::anyhow!("the disk is full").context("a.csv: cannot write");
        assert_eq!(message(&error), "a.csv: cannot write: the disk is full");
    }
}
