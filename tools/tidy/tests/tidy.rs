//! The rules of docs/architecture.md that the compiler does not know.

use pb_tidy::{Source, dependencies, files, root};

/// What each crate may use of the others.
const MAY_USE: [(&str, &[&str]); 7] = [
    ("pb-archive", &[]),
    ("pb-mesh", &[]),
    ("pb-stream", &["pb-archive"]),
    ("pb-lod", &["pb-archive", "pb-mesh"]),
    ("pb-render", &["pb-archive", "pb-lod", "pb-stream"]),
    ("pb-bake", &["pb-archive", "pb-mesh", "pb-lod"]),
    ("pb-view", &["pb-archive", "pb-lod", "pb-stream", "pb-render"]),
];

/// What a crate must never see, by the name of the library.
const NEVER: [(&str, &[&str]); 5] = [
    ("pb-archive", &["glam", "wgpu", "winit", "rayon", "meshopt"]),
    ("pb-mesh", &["wgpu", "winit", "memmap2"]),
    ("pb-lod", &["wgpu", "winit", "clap"]),
    ("pb-stream", &["wgpu", "winit", "glam"]),
    ("pb-render", &["winit", "clap", "memmap2"]),
];

/// Longest file of product code, lines; about 400 is the aim.
const MAX_LINES: usize = 520;

fn manifest(package: &str) -> String {
    std::fs::read_to_string(root().join("crates").join(package).join("Cargo.toml")).expect("a crate has a manifest")
}

fn sources() -> Vec<Source> {
    let mut all = files("crates", &["rs"]);
    all.extend(files("tools", &["rs"]));
    all
}

#[test]
fn crates_use_only_what_the_table_allows() {
    let mut folders: Vec<String> = std::fs::read_dir(root().join("crates"))
        .expect("there are crates")
        .map(|e| e.expect("readable").file_name().to_string_lossy().into_owned())
        .collect();
    folders.sort();
    let mut known: Vec<&str> = MAY_USE.iter().map(|(name, _)| *name).collect();
    known.sort_unstable();
    assert_eq!(folders, known, "a new crate needs a line in this table and in docs/architecture.md");
    for (package, allowed) in MAY_USE {
        for used in dependencies(&manifest(package)).iter().filter(|d| d.starts_with("pb-")) {
            assert!(allowed.contains(&used.as_str()), "{package} must not use {used}");
        }
    }
}

#[test]
fn crates_stay_away_from_what_they_must_never_know() {
    for (package, forbidden) in NEVER {
        for used in dependencies(&manifest(package)) {
            assert!(!forbidden.contains(&used.as_str()), "{package} must never know {used}");
        }
    }
}

#[test]
fn measurements_use_no_code_of_the_product() {
    let text = std::fs::read_to_string(root().join("tools/measure/Cargo.toml")).expect("a manifest");
    assert!(dependencies(&text).iter().all(|d| !d.starts_with("pb-")), "what measures must be independent");
}

#[test]
fn every_dependency_says_why_it_is_here() {
    let text = std::fs::read_to_string(root().join("Cargo.toml")).expect("a manifest");
    let section =
        text.lines().skip_while(|l| *l != "[workspace.dependencies]").skip(1).take_while(|l| !l.starts_with('['));
    for line in section.filter(|l| l.contains('=') && !l.contains("path =")) {
        assert!(line.contains(" # "), "no reason: {line}");
    }
}

#[test]
fn every_file_begins_with_what_it_does() {
    for file in sources().iter().filter(|f| !f.is_test()) {
        assert!(file.text.starts_with("//!"), "{}: no module doc", file.path);
    }
}

#[test]
fn files_stay_short() {
    for file in sources().iter().filter(|f| !f.is_test()) {
        let lines = file.product_lines().count();
        assert!(lines <= MAX_LINES, "{}: {lines} lines; split it by subject", file.path);
    }
}

#[test]
fn nothing_unwraps_outside_tests() {
    for file in sources().iter().filter(|f| !f.is_test() && f.path.starts_with("crates/")) {
        for (number, line) in file.product_lines().filter(|(_, l)| !l.trim_start().starts_with("//")) {
            assert!(!line.contains(".unwrap()"), "{}:{number}: use an error, or expect() with the reason", file.path);
        }
    }
}

#[test]
fn unsafe_code_says_why_it_is_sound() {
    for file in sources().iter().filter(|f| f.path.starts_with("crates/")) {
        let lines: Vec<&str> = file.text.lines().collect();
        for (i, _) in lines.iter().enumerate().filter(|(_, l)| l.contains("unsafe {")) {
            let before = &lines[i.saturating_sub(6)..=i];
            assert!(before.iter().any(|l| l.contains("SAFETY:")), "{}:{}: no SAFETY comment", file.path, i + 1);
        }
    }
}

#[test]
fn nothing_is_left_to_do() {
    for file in sources().iter().filter(|f| !f.path.contains("tools/tidy/")) {
        for (i, line) in file.text.lines().enumerate() {
            let stale = ["TODO", "FIXME", "XXX", "todo!(", "unimplemented!("].iter().find(|w| line.contains(**w));
            assert!(stale.is_none(), "{}:{}: {}", file.path, i + 1, line.trim());
        }
    }
}

#[test]
fn links_in_the_documents_lead_somewhere() {
    let mut pages = files("docs", &["md"]);
    pages.extend(files(".", &["md"]).into_iter().filter(|f| !f.path.contains('/')));
    assert!(!pages.is_empty());
    for page in pages {
        let folder = root().join(&page.path).parent().expect("a file is in a folder").to_owned();
        for link in page.text.split("](").skip(1).filter_map(|rest| rest.split([')', '#', ' ']).next()) {
            let local = !link.is_empty() && !link.contains("://");
            assert!(!local || folder.join(link).exists(), "{}: {link} is not there", page.path);
        }
    }
}
