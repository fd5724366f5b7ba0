//! What the tests share: a closed mesh made on the spot, archives baked from it, runs of the program.

use pb_archive::{Overwrite, Writer};
use pb_lod::progressive_buffers::bake::{BakeOptions, bake};
use pb_lod::progressive_buffers::layout::SCHEME;
use pb_lod::progressive_buffers::write::write_model;
use pb_mesh::mesh::Soup;
use pb_mesh::repair::{RepairOptions, repair};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// A bumpy torus of `2 * n * n` triangles around `center`: closed, counter-clockwise from outside, with colours.
/// Radii about 3 and 1; bumps of several sizes, so that every level has something to lose.
pub fn bumpy_torus(n: u32, center: [f64; 3]) -> Soup {
    let angle = |i: u32| i as f64 / n as f64 * std::f64::consts::TAU;
    let mut soup = Soup::default();
    for v in 0..n {
        for u in 0..n {
            let (a, b) = (angle(u), angle(v));
            let bump = 1.0
                + 0.08 * (5.0 * a).sin() * (4.0 * b).cos()
                + 0.02 * (23.0 * a + 3.0 * b).sin()
                + 0.006 * (61.0 * b).sin() * (97.0 * a).sin();
            let ring = 3.0 + bump * b.cos();
            soup.positions.push([center[0] + ring * a.cos(), center[1] + bump * b.sin(), center[2] - ring * a.sin()]);
            let shade = |x: f64| (150.0 + 80.0 * x.sin()) as u8;
            soup.colors.push([shade(3.0 * a), shade(2.0 * b + 1.0), shade(a + b), 255]);
        }
    }
    let at = |u: u32, v: u32| (v % n) * n + u % n;
    for (u, v) in (0..n).flat_map(|v| (0..n).map(move |u| (u, v))) {
        let [a, b, c, d] = [at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)];
        soup.triangles.extend([[a, b, c], [a, c, d]]);
    }
    soup
}

/// Bakes and writes an archive.
pub fn bake_to(path: &Path, soup: Soup, options: &BakeOptions) {
    let triangles_in = soup.triangles.len() as u64;
    let (mesh, _) = repair(soup, &RepairOptions::default()).expect("a clean mesh");
    let (model, _) = bake(&mesh, triangles_in, options, &|_, _| {}).expect("plain options");
    let writer = Writer::create(path, SCHEME, Overwrite::Force).expect("the target can be written");
    write_model(writer, &model).expect("the disk has room");
}

/// A folder of the test run's own, under cargo's.
pub fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&path).expect("the target folder can be written");
    path
}

/// The archive of a bumpy torus of 131 072 triangles in small clusters, baked once per test run.
pub fn torus() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| {
        let path = folder("archives").join("torus.pb");
        let options = BakeOptions { cluster_triangles: 2048, ..BakeOptions::default() };
        bake_to(&path, bumpy_torus(256, [0.0; 3]), &options);
        path
    })
}

/// A finished run of the program.
pub struct Run {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

/// Runs pb-view with these words.
pub fn pb_view<S: AsRef<std::ffi::OsStr>>(words: &[S]) -> Run {
    let Output { status, stdout, stderr } =
        Command::new(env!("CARGO_BIN_EXE_pb-view")).args(words).output().expect("the program starts");
    Run {
        code: status.code().expect("the program ends by itself"),
        stdout: String::from_utf8_lossy(&stdout).into_owned(),
        stderr: String::from_utf8_lossy(&stderr).into_owned(),
    }
}

/// True after saying loudly that a test did not run, where there is no adapter.
pub fn no_adapter(test: &str) -> bool {
    match pb_render::Gpu::headless() {
        Err(pb_render::RenderError::NoAdapter(reason)) => {
            eprintln!("SKIPPED: no Vulkan adapter: {test} did not run ({reason})");
            true
        }
        _ => false,
    }
}
