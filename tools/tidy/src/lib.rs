//! Reads the repository as text for the tests in tests/tidy.rs. Must never: change a file.

use std::path::{Path, PathBuf};

/// The root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().expect("the repository is where it was built")
}

/// A text file: path relative to the root, and contents.
pub struct Source {
    /// With forward slashes.
    pub path: String,
    /// The whole text.
    pub text: String,
    /// Declared under `#[cfg(test)]` by another file.
    test_only: bool,
}

/// All files below `folder` (relative to the root) with one of these extensions, in the order of their paths.
pub fn files(folder: &str, extensions: &[&str]) -> Vec<Source> {
    let (root, mut out) = (root(), Vec::new());
    collect(&root, &root.join(folder), extensions, &mut out);
    out.sort_by(|a, b| a.path.cmp(&b.path));
    let test_modules: Vec<String> = out.iter().flat_map(Source::test_modules).collect();
    out.iter_mut().for_each(|f| f.test_only = test_modules.contains(&f.path));
    out
}

fn collect(root: &Path, folder: &Path, extensions: &[&str], out: &mut Vec<Source>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for path in entries.filter_map(|e| e.ok().map(|e| e.path())) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() && name != "target" && name != "corpus" && !name.starts_with('.') {
            collect(root, &path, extensions, out);
        } else if path.extension().is_some_and(|e| extensions.iter().any(|x| e == *x)) {
            let relative = path.strip_prefix(root).expect("found below the root").to_string_lossy().replace('\\', "/");
            let text = std::fs::read_to_string(&path).unwrap_or_default();
            out.push(Source { path: relative, text, test_only: false });
        }
    }
}

impl Source {
    /// True for files that hold only tests.
    pub fn is_test(&self) -> bool {
        self.test_only
            || self.path.contains("/tests/")
            || self.path.ends_with("/tests.rs")
            || self.path.ends_with("_tests.rs")
            || self.path.contains("/benches/")
    }

    /// Paths of the modules beside this file that it declares for tests only.
    fn test_modules(&self) -> Vec<String> {
        let folder = self.path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let lines: Vec<&str> = self.text.lines().map(str::trim).collect();
        let module = |pair: &[&str]| -> Option<String> {
            let name = pair[1].trim_start_matches("pub(crate) ").strip_prefix("mod ")?.strip_suffix(';')?;
            (pair[0] == "#[cfg(test)]").then(|| format!("{folder}/{name}.rs"))
        };
        lines.windows(2).filter_map(module).collect()
    }

    /// The lines before the first `#[cfg(test)]` module, numbered from 1.
    pub fn product_lines(&self) -> impl Iterator<Item = (usize, &str)> {
        let lines: Vec<&str> = self.text.lines().collect();
        let test_module = |i: usize| {
            lines[i].trim() == "#[cfg(test)]" && lines.get(i + 1).is_some_and(|l| l.trim_end().ends_with('{'))
        };
        let end = (0..lines.len()).find(|&i| test_module(i)).unwrap_or(lines.len());
        lines.into_iter().take(end).enumerate().map(|(i, line)| (i + 1, line))
    }
}

/// Names of the packages under `[dependencies]` of a manifest.
pub fn dependencies(manifest: &str) -> Vec<String> {
    let section = manifest.lines().skip_while(|l| l.trim() != "[dependencies]").skip(1);
    section
        .take_while(|l| !l.starts_with('['))
        .filter_map(|l| l.split(['.', '=', ' ']).next())
        .filter(|name| !name.is_empty() && !name.starts_with('#'))
        .map(str::to_owned)
        .collect()
}
