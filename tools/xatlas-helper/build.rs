//! Compiles xatlas and src/charts.cpp. The source of xatlas is that of the crate xatlas-rs-v2, as Cargo downloaded it.

use std::path::{Path, PathBuf};
use std::process::Command;

const CRATE: &str = "xatlas-rs-v2";

fn main() {
    let (folder, version) = xatlas();
    let folder = folder.join("vendor/source/xatlas");
    keep_notices(&folder);
    cc::Build::new()
        .cpp(true)
        .std("c++14") // without threads, xatlas is no C++11
        .warnings(false)
        .debug(false)
        .opt_level(2)
        .define("NDEBUG", None)
        .include(&folder)
        .file("src/charts.cpp")
        .compile("pbxatlas");
    println!("cargo:rustc-env=XATLAS_SOURCE={CRATE} {version}");
    println!("cargo:rerun-if-changed=src/charts.cpp");
    println!("cargo:rerun-if-changed=Cargo.lock");
}

/// Folder and version of the crate that carries xatlas.
fn xatlas() -> (PathBuf, String) {
    let cargo = std::env::var_os("CARGO").expect("cargo runs build scripts");
    let mut command = Command::new(cargo);
    let output = command.args(["metadata", "--locked", "--format-version", "1"]).output().expect("cargo starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo metadata could not provide the source of xatlas:\n{said}");
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).expect("cargo writes JSON");
    let packages = metadata["packages"].as_array().expect("metadata lists packages");
    let package = packages.iter().find(|p| p["name"] == CRATE).expect("Cargo.lock names the crate");
    let text = |key: &str| package[key].as_str().expect("packages have names, versions and places").to_string();
    let manifest = PathBuf::from(text("manifest_path"));
    (manifest.parent().expect("a manifest is in a folder").to_owned(), text("version"))
}

/// Copyright notices and licences of xatlas and of what is in it, for `pb-xatlas --licences`: they go where the binary
/// goes.
fn keep_notices(folder: &Path) {
    let source = std::fs::read_to_string(folder.join("xatlas.cpp")).expect("xatlas is one file");
    let comments = source.split("/*").skip(1).filter_map(|rest| rest.split_once("*/")).map(|(comment, _)| comment);
    let notices: Vec<&str> = comments.filter(|c| c.contains("Copyright")).map(str::trim).collect();
    assert!(notices.len() >= 3, "xatlas, thekla_atlas and OpenNL each have a notice");
    let target = PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets it")).join("notices.txt");
    std::fs::write(target, notices.join("\n\n") + "\n").expect("OUT_DIR can be written");
}
