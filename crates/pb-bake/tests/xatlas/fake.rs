//! Helpers made of a few lines of shell, in a folder of their own.

use pb_bake::xatlas::wire::{Kind, message};
use pb_bake::xatlas::{Charts, Found, Helper, HelperFault, Identity, Options, Process, Request};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Enough for a shell on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(30);
/// For what never answers.
pub const SHORT: Duration = Duration::from_millis(300);

/// Words of the scripts: `hello` answers a probe, `answer` answers a request, each after reading it.
const WORDS: &str = "
hello() { head -c 16 > /dev/null; cat probe; }
answer() { head -c 112 > /dev/null; cat charts; }
";

/// A folder of programs and of the bytes that they write.
pub struct Workshop {
    folder: tempfile::TempDir,
}

impl Workshop {
    /// Holds `probe`, a good answer to the probe, and `charts`, good [`charts`] for [`request`].
    pub fn new() -> Self {
        let workshop = Self { folder: tempfile::tempdir().unwrap() };
        let identity = Identity { name: "fake 1".into(), xatlas: "none".into() };
        workshop.put("probe", &message(Kind::ProbeAnswer, &identity.encode()));
        workshop.put("charts", &message(Kind::ChartsAnswer, &charts().encode()));
        workshop
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn put(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).unwrap();
    }

    /// A helper that runs `script` in this folder. Another process writes the file: one that is open for writing here
    /// while another test starts a program could not be executed.
    pub fn helper(&self, script: &str) -> Helper {
        let path = self.path("helper");
        let text = format!("#!/bin/sh\ncd '{}' || exit 9\n{WORDS}{script}\n", self.folder.path().display());
        let write = "printf %s \"$1\" > \"$0\" && chmod +x \"$0\"";
        let status = Command::new("sh").arg("-c").arg(write).arg(&path).arg(text).stdin(Stdio::null()).status();
        assert!(status.unwrap().success());
        Helper { path, found: Found::Option }
    }

    /// What such a helper makes of [`request`].
    pub fn charts_of(&self, script: &str, limit: Duration) -> Result<Charts, HelperFault> {
        Process::start(&self.helper(script), PATIENCE)?.charts(&request(), limit)
    }
}

/// Two unit triangles that share an edge.
pub fn request() -> Request {
    Request {
        time_limit_ms: 30_000,
        options: Options::default(),
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

/// One chart for both.
pub fn charts() -> Charts {
    let uv = vec![[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]]];
    Charts { chart_of: vec![0, 0], count: 1, uv }
}
