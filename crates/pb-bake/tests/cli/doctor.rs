//! `pb-bake doctor` on machines with and without a helper.

use crate::harness::{Place, Run};
use std::process::Command;

/// pb-bake alone in a folder, where it finds no helper by chance.
pub struct Alone(pub Place);

impl Alone {
    pub fn new() -> Self {
        let place = Place::new();
        // By another process: a file open for writing here cannot be executed from another thread.
        let copied = Command::new("cp").arg(env!("CARGO_BIN_EXE_pb-bake")).arg(place.path("pb-bake")).status();
        assert!(copied.unwrap().success());
        Self(place)
    }

    fn command(&self, args: &[&str]) -> Command {
        let mut command = self.pb_bake();
        command.arg("doctor").args(args);
        command
    }

    /// The program, in the folder.
    pub fn pb_bake(&self) -> Command {
        let mut command = Command::new(self.0.path("pb-bake"));
        command.env_remove("PB_XATLAS").env("PATH", self.0.path("bin")).current_dir(self.0.path("."));
        command
    }

    fn run(&self, args: &[&str]) -> Run {
        Run::of(self.command(args).output().unwrap())
    }

    /// A program that answers the probe of a helper.
    fn helper(&self, name: &str) -> String {
        use pb_bake::xatlas::{Identity, wire};
        let identity = Identity { name: "stand-in 9".into(), xatlas: "no xatlas".into() };
        self.0.write("probe", &wire::message(wire::Kind::ProbeAnswer, &identity.encode()));
        let path = self.0.path(name);
        let text = format!("#!/bin/sh\nexec /bin/cat '{}'\n", self.0.path("probe").display());
        let write = "mkdir -p \"$(dirname \"$0\")\"; printf %s \"$1\" > \"$0\" && chmod +x \"$0\"";
        assert!(Command::new("sh").arg("-c").arg(write).arg(&path).arg(text).status().unwrap().success());
        path.to_str().unwrap().into()
    }
}

#[test]
fn without_a_helper_all_is_well_and_the_build_command_is_named() {
    let alone = Alone::new();
    let run = alone.run(&[]).succeeds();
    for text in ["threads: ", "temporary files: ", "OBJ", "PNG", "not found", "tools/xatlas-helper/build '"] {
        assert!(run.stdout.contains(text), "{text}: {}", run.stdout);
    }
    let json = alone.run(&["--json"]).succeeds().json();
    assert_eq!(json["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!((&json["xatlas"]["usable"], &json["xatlas"]["path"]), (&false.into(), &serde_json::Value::Null));
    assert!(json["xatlas"]["advice"].as_str().unwrap().contains("xatlas-helper"), "{json}");
    assert!(json["threads"].as_u64().unwrap() > 0 && json["temp_dir"]["problem"].is_null(), "{json}");
}

#[test]
fn a_helper_is_found_beside_the_program_before_path() {
    let alone = Alone::new();
    let found = || {
        let json = alone.run(&["--json"]).succeeds().json();
        (json["xatlas"]["found"].as_str().map(str::to_string), json["xatlas"]["name"].as_str().map(str::to_string))
    };
    alone.helper("bin/pb-xatlas");
    assert_eq!(found(), (Some("search_path".into()), Some("stand-in 9".into())));
    alone.helper("pb-xatlas");
    assert_eq!(found().0.unwrap(), "beside_program");
    assert!(alone.run(&[]).succeeds().stdout.contains("stand-in 9, no xatlas, answered"));
}

#[test]
fn a_named_helper_comes_first_and_must_work() {
    let alone = Alone::new();
    let helper = alone.helper("special");
    alone.0.write("broken", b"not executable");
    let json = alone.run(&["--json", "--xatlas-helper", &helper]).succeeds().json();
    assert_eq!((&json["xatlas"]["found"], &json["xatlas"]["usable"]), (&"option".into(), &true.into()));
    let by_variable = |path: &str| Run::of(alone.command(&["--json"]).env("PB_XATLAS", path).output().unwrap());
    assert_eq!(by_variable(&helper).succeeds().json()["xatlas"]["found"], "variable");
    let broken = alone.0.path("broken");
    let run = by_variable(broken.to_str().unwrap()).fails(2, "does not start");
    assert_eq!(run.json()["xatlas"]["usable"], false);
    by_variable("/nowhere/pb-xatlas").fails(2, "PB_XATLAS names it");
    alone.run(&["--xatlas-helper", "nowhere"]).fails(2, "--xatlas-helper names it");
    alone.run(&["--xatlas-helper", "/bin/true"]).fails(2, "ended early (exit status: 0)");
}
