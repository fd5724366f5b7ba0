//! Runs the program in a folder of its own.

use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

/// A folder with meshes in it, gone at the end.
pub struct Place {
    folder: tempfile::TempDir,
}

/// What a run left.
pub struct Run {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Place {
    /// Holds `wave.obj`, an open wavy sheet of 2 * 40 * 40 triangles.
    pub fn new() -> Self {
        let place = Self { folder: tempfile::tempdir().unwrap() };
        place.write("wave.obj", wave(40).as_bytes());
        place
    }

    /// The same with `wave.pb` baked from it.
    pub fn baked() -> Self {
        let place = Self::new();
        place.run(&["wave.obj", "wave.pb", "--levels", "3", "--cluster-triangles", "400"]).succeeds();
        place
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).unwrap();
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap()
    }

    /// Names of all files, sorted.
    pub fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder.path()).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pb-bake"));
        command.args(args).current_dir(self.folder.path()).stdin(Stdio::null());
        command
    }

    pub fn run(&self, args: &[&str]) -> Run {
        Run::of(self.command(args).output().unwrap())
    }
}

impl Run {
    pub fn of(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Self { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
    }

    #[track_caller]
    pub fn succeeds(self) -> Self {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        self
    }

    /// Exits with `code` and says `what` on standard error, without a panic.
    #[track_caller]
    pub fn fails(self, code: i32, what: &str) -> Self {
        assert_eq!(self.code, Some(code), "{}", self.stderr);
        assert!(self.stderr.contains(what), "{}", self.stderr);
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
        self
    }

    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap()
    }
}

/// An OBJ of `side * side` quads.
pub fn wave(side: usize) -> String {
    let point = |i: usize| (i % (side + 1), i / (side + 1));
    let vertex = |(x, y): (usize, usize)| format!("v {x} {y} {}\n", (x as f64 / 5.0).sin() + (y as f64 / 7.0).cos());
    let mut text: String = (0..(side + 1) * (side + 1)).map(|i| vertex(point(i))).collect();
    for (x, y) in (0..side * side).map(|i| (i % side, i / side)) {
        let a = y * (side + 1) + x + 1;
        text += &format!("f {} {} {} {}\n", a, a + 1, a + side + 2, a + side + 1);
    }
    text
}
