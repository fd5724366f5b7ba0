//! Why an input cannot be read: where, what, and what to do about it.

use std::io;

/// The class of a refusal, for programs that treat them differently.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The bytes contradict their own format, or the file is cut short.
    Damaged,
    /// A sound file, or nearly, of a kind or with a feature that is not read.
    Unsupported,
    /// More than this program, or its memory, can take.
    TooLarge,
    /// A coordinate is NaN, infinite or absurdly large.
    NotFinite,
    /// There is no triangle in it.
    NoFaces,
}

/// Why an input cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The operating system refuses.
    #[error("{path}: cannot be read: {source}; check the name and the permissions")]
    Io {
        /// As given.
        path: String,
        /// What the system says.
        source: io::Error,
    },
    /// The content is refused.
    #[error("{place}: {what}; {remedy}")]
    Refused {
        /// Its class.
        refusal: Refusal,
        /// File, and line or part where that is known.
        place: String,
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
}

impl ImportError {
    /// The class of a refusal; none when the operating system is at fault.
    pub fn refusal(&self) -> Option<Refusal> {
        match self {
            ImportError::Io { .. } => None,
            ImportError::Refused { refusal, .. } => Some(*refusal),
        }
    }
}

/// Builds [`ImportError::Refused`].
pub(super) fn refused(
    refusal: Refusal,
    place: impl Into<String>,
    what: impl Into<String>,
    remedy: impl Into<String>,
) -> ImportError {
    ImportError::Refused { refusal, place: place.into(), what: what.into(), remedy: remedy.into() }
}

/// A [`Refusal::Damaged`] with the remedy that all damaged files share.
pub(super) fn damaged(place: impl Into<String>, what: impl Into<String>) -> ImportError {
    refused(
        Refusal::Damaged,
        place,
        what,
        "the file is cut short, damaged or exported wrongly: fetch or export it again",
    )
}
