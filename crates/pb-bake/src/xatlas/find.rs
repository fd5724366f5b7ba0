//! Where the helper is.

use super::fault::HelperFault;
use super::process::{PROBE_LIMIT, Process};
use super::wire::Identity;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Name of the program, without `.exe`.
pub const PROGRAM: &str = "pb-xatlas";
/// Environment variable that names the helper.
const VARIABLE: &str = "PB_XATLAS";

/// How a helper was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Found {
    /// By `--xatlas-helper`.
    Option,
    /// By the variable `PB_XATLAS`.
    Variable,
    /// In the folder of the running program.
    BesideProgram,
    /// In PATH.
    SearchPath,
}

impl Found {
    /// Somebody named it, so its absence is a mistake and not a choice.
    pub fn asked_for(self) -> bool {
        matches!(self, Found::Option | Found::Variable)
    }
}

/// A program that is said to be pb-xatlas. Nothing runs yet.
#[derive(Clone, Debug)]
pub struct Helper {
    /// The program.
    pub path: PathBuf,
    /// How it was found.
    pub found: Found,
}

impl Helper {
    /// Looks for the helper: where `named` says, else where the variable `PB_XATLAS` says, else beside the running
    /// program, else in PATH. A name that leads nowhere is a fault; the other places are then not tried.
    pub fn find(named: Option<&Path>) -> Result<Helper, HelperFault> {
        let variable = std::env::var_os(VARIABLE).filter(|v| !v.is_empty()).map(PathBuf::from);
        let named = named.map(|p| (p.to_owned(), Found::Option, "--xatlas-helper"));
        if let Some((path, found, from)) = named.or(variable.map(|p| (p, Found::Variable, VARIABLE))) {
            return if path.is_file() { Ok(Helper { path, found }) } else { Err(HelperFault::NotThere { path, from }) };
        }
        let file = format!("{PROGRAM}{}", std::env::consts::EXE_SUFFIX);
        let beside = std::env::current_exe().ok().and_then(|p| p.parent().map(|f| f.join(&file)));
        if let Some(path) = beside.filter(|p| p.is_file()) {
            return Ok(Helper { path, found: Found::BesideProgram });
        }
        let folders = std::env::var_os("PATH").unwrap_or_default();
        let mut candidates = std::env::split_paths(&folders).filter(|f| f.is_absolute()).map(|f| f.join(&file));
        let path = candidates.find(|p| p.is_file()).ok_or(HelperFault::Absent)?;
        Ok(Helper { path, found: Found::SearchPath })
    }

    /// Starts it and asks who it is.
    pub fn probe(&self) -> Result<Identity, HelperFault> {
        self.probe_within(PROBE_LIMIT)
    }

    /// [`Helper::probe`] with a time limit of one's own.
    pub fn probe_within(&self, limit: Duration) -> Result<Identity, HelperFault> {
        Process::start(self, limit).map(|process| process.identity().clone())
    }
}
