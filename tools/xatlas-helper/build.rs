//! Compiles xatlas and src/charts.cpp. The source of xatlas is that of the crate xatlas-rs-v2, as Cargo downloaded it.

use std::path::PathBuf;
use std::process::Command;

const CRATE: &str = "xatlas-rs-v2";

fn main() {
    let (folder, version) = xatlas();
    cc::Build::new()
        .cpp(true)
        .std("c++14") // without threads, xatlas is no C++11
        .warnings(false)
        .debug(false)
        .opt_level(2)
        .define("NDEBUG", None)
        .include(folder.join("vendor/source/xatlas"))
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
