//! Importers and mesh writers, from files to the repaired mesh and back.

mod bad_inputs;
mod fixtures;
mod formats;
mod gltf_scenes;
mod hostile;
mod images;
mod instances;
mod round_trip;
mod textured;

use pb_bake::import::{Format, Import, ImportError, ImportOptions, load, load_bytes};
use pb_mesh::mesh::{Mesh, Soup};
use pb_mesh::repair::{RepairOptions, RepairReport, repair};
use std::path::{Path, PathBuf};

/// A folder of third-party data beside the checkout; none, loudly, where it is absent.
fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(name);
    if !path.is_dir() {
        eprintln!("SKIPPED: {} is not there, so its files are not tested", path.display());
        return None;
    }
    Some(path)
}

fn load_file(path: impl AsRef<Path>) -> Result<Import, ImportError> {
    load(&[path.as_ref().to_owned()], &ImportOptions::default(), &|_| {})
}

fn read(format: Format, bytes: impl AsRef<[u8]>) -> Soup {
    load_bytes(format, bytes.as_ref(), None).unwrap_or_else(|e| panic!("{e}")).0.soup
}

/// The message of a refusal; fails where there is none.
fn refusal(format: Format, bytes: impl AsRef<[u8]>) -> String {
    match load_bytes(format, bytes.as_ref(), None) {
        Ok((model, _)) => panic!("{} triangles instead of a refusal", model.soup.triangles.len()),
        Err(error) => error.to_string(),
    }
}

fn repaired(soup: Soup) -> (Mesh, RepairReport) {
    repair(soup, &RepairOptions::default()).unwrap()
}

/// Positions that the weld left, without those that splitting added.
fn welded_count(mesh: &Mesh, report: &RepairReport) -> u64 {
    mesh.positions.len() as u64 - report.split.copies - report.split.middles
}

/// Fails unless the message has all the parts.
#[track_caller]
fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "\"{part}\" is not in: {message}");
    }
}
