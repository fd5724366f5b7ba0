//! What the tests share: a closed mesh made on the spot, archives baked from it, runs of the program.

use glam::{DQuat, DVec3};
use pb_archive::{Overwrite, Writer};
use pb_lod::progressive_buffers::bake::{BakeOptions, bake};
use pb_lod::progressive_buffers::layout::SCHEME;
use pb_lod::progressive_buffers::write::write_model;
use pb_mesh::mesh::Soup;
use pb_mesh::objects::Placement;
use pb_mesh::repair::{RepairOptions, repair};
use pb_render::{Camera, Gpu, RenderError};
use pb_view::flypath::Keyframe;
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

/// A square of hills, 2 wide, of `2 * n * n` triangles, seen from +y: open, and rough from vertex to vertex.
pub fn hills(n: u32) -> Soup {
    let mut soup = Soup::default();
    for (i, j) in (0..=n).flat_map(|j| (0..=n).map(move |i| (i, j))) {
        let (x, z) = (i as f64 / n as f64 * 2.0 - 1.0, j as f64 / n as f64 * 2.0 - 1.0);
        let rough = (i.wrapping_mul(73_856_093) ^ j.wrapping_mul(19_349_663)).wrapping_mul(2_654_435_761) >> 16;
        let y = 0.03 * (9.0 * x + 2.0 * z).sin() * (7.0 * z).cos()
            + 0.008 * (31.0 * x - 5.0 * z).sin() * (27.0 * z).sin()
            + 0.012 * rough as f64 / 65536.0;
        soup.positions.push([x, y, z]);
    }
    let at = |i: u32, j: u32| j * (n + 1) + i;
    for (i, j) in (0..n).flat_map(|j| (0..n).map(move |i| (i, j))) {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        soup.triangles.extend([[a, c, b], [a, d, c]]);
    }
    soup
}

/// Bakes and writes an archive.
pub fn bake_to(path: &Path, soup: Soup, options: &BakeOptions) {
    let triangles_in = soup.triangles.len() as u64;
    let (mesh, _) = repair(soup, &RepairOptions::default()).expect("a clean mesh");
    let (model, _) = bake(mesh, triangles_in, options, &|_, _| {}).expect("plain options");
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
    PATH.get_or_init(|| baked("torus.pb", bumpy_torus(256, [0.0; 3]), 5))
}

/// The archive of a bumpy torus of 18 432 triangles, baked once per test run.
pub fn small_torus() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| baked("small_torus.pb", bumpy_torus(96, [0.0; 3]), 4))
}

/// The same torus at UTM coordinates, baked once per test run.
pub fn far_torus() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| baked("far_torus.pb", bumpy_torus(96, FAR), 4))
}

/// A torus of 18 432 triangles that stands once, and one of 8 192 that stands five times around it, turned, of several
/// sizes, one of them before a closer look's eye; baked once per test run.
pub fn crowd() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| baked("crowd.pb", crowd_soup(), 4))
}

/// The same with all instances as geometry.
pub fn crowd_written_out() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| baked("crowd_written_out.pb", written_out(&crowd_soup()), 4))
}

/// Where the instances of the crowd's second torus stand.
pub fn crowd_placements() -> Vec<Placement> {
    let turned = |scale: f64, x: f64, y: f64, z: f64, angle: f64| {
        let rotation = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, angle).normalize(), angle);
        let to = DVec3::new(x, y, z);
        // Turned around its middle.
        Placement { rotation, scale, translation: to - scale * (rotation * CROWD_MIDDLE) }
    };
    vec![
        Placement::IDENTITY,
        turned(0.5, 6.0, 1.0, 4.0, 1.3),
        turned(0.25, 4.5, 0.5, 5.0, 2.9),
        turned(1.0, -30.0, 4.0, -60.0, 0.4),
        turned(0.9, -9.0, -1.0, 3.0, 4.0),
    ]
}

/// Where the crowd's second torus is baked.
const CROWD_MIDDLE: DVec3 = DVec3::new(0.0, 0.0, -12.0);

fn crowd_soup() -> Soup {
    let mut soup = bumpy_torus(96, [0.0; 3]);
    let count = soup.positions.len();
    let mut second = bumpy_torus(64, CROWD_MIDDLE.to_array());
    second.objects.of = vec![1; second.positions.len()];
    second.objects.placements = vec![crowd_placements()];
    soup.append(second);
    assert_eq!(soup.objects.of[count - 1..count + 1], [0, 1]);
    soup
}

/// Objects as geometry, wherever they stand.
fn written_out(soup: &Soup) -> Soup {
    let mut out = Soup::default();
    for (object, placements) in [vec![Placement::IDENTITY]].iter().chain(&soup.objects.placements).enumerate() {
        for placement in placements {
            let first = soup.objects.of.iter().position(|&o| o == object as u32).expect("each object is there");
            let records = (first..soup.positions.len()).filter(|&r| soup.objects.of[r] == object as u32);
            let mut part = Soup::default();
            for r in records {
                part.positions.push(placement.point(DVec3::from(soup.positions[r])).to_array());
                part.colors.push(soup.colors[r]);
            }
            let own = soup.triangles.iter().filter(|t| soup.objects.of[t[0] as usize] == object as u32);
            part.triangles = own.map(|t| t.map(|i| i - first as u32)).collect();
            out.append(part);
        }
    }
    out
}

/// Where the far torus lies.
pub const FAR: [f64; 3] = [500_000.0, 100.0, 4_500_000.0];

/// The archive of 33 800 triangles of hills, baked once per test run.
pub fn hilly() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| baked("hills.pb", hills(130), 3))
}

fn baked(name: &str, soup: Soup, levels: u32) -> PathBuf {
    let path = folder("archives").join(name);
    bake_to(&path, soup, &BakeOptions { levels, cluster_triangles: Some(2048), ..BakeOptions::default() });
    path
}

/// Writes a flypath of these keyframes (time, eye, target) with one up vector and field of view.
pub fn write_flight(path: &Path, fps: f64, up: [f64; 3], fov_deg: f64, keys: &[(f64, [f64; 3], [f64; 3])]) {
    let keyframes: Vec<String> = keys
        .iter()
        .map(|(t, eye, target)| format!(r#"{{"t":{t},"eye":{eye:?},"target":{target:?},"up":{up:?}}}"#))
        .collect();
    let keyframes = keyframes.join(",\n");
    let text = format!(r#"{{"version":1,"fps":{fps},"fov_deg":{fov_deg},"keyframes":[{keyframes}]}}"#);
    std::fs::write(path, text).expect("the target folder can be written");
}

/// The camera that the program uses for a keyframe.
pub fn camera(key: &Keyframe) -> Camera {
    Camera { eye: key.eye, target: key.target, up: key.up, fov_deg: key.fov_deg, near: 1e-4 }
}

/// Frame `frame` of a folder that the program wrote: width, height, RGB.
pub fn read_frame(folder: &Path, frame: u32) -> image::RgbImage {
    image::open(folder.join(format!("frame_{frame:05}.png"))).expect("the frame was written").to_rgb8()
}

/// A column of a statistics file.
pub fn column(stats: &Path, name: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(stats).expect("the statistics were written");
    let at = text.lines().next().and_then(|l| l.split(',').position(|c| c == name)).expect("the column is there");
    let value = |line: &str| line.split(',').nth(at).and_then(|v| v.parse().ok()).expect("a number");
    text.lines().skip(1).map(value).collect()
}

/// A finished run of the program.
pub struct Run {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

/// A path as a word of a command line.
pub fn text(path: &Path) -> String {
    path.to_str().expect("the target folder has a plain name").to_owned()
}

/// A scan from the shared fixtures, baked by pb-bake beside pb-view; none, after saying so, where one is absent.
pub fn scan(test: &str, input: &str) -> Option<PathBuf> {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/fixtures").join(input);
    let program = Path::new(env!("CARGO_BIN_EXE_pb-view")).with_file_name("pb-bake");
    for needed in [&fixture, &program] {
        if !needed.exists() {
            eprintln!("SKIPPED: {} is absent: {test} did not run", needed.display());
            return None;
        }
    }
    let archive = folder("archives").join(format!("{test}.pb"));
    // Several clusters: alone, one of the usual size would be a small scan.
    let options = ["--force", "--quiet", "--cluster-triangles", "16384"];
    let bake = Command::new(program).arg(&fixture).arg(&archive).args(options).output();
    let bake = bake.expect("the program starts");
    assert!(bake.status.success(), "{}", String::from_utf8_lossy(&bake.stderr));
    Some(archive)
}

/// Runs pb-view with the words of this line; words that name files follow as `{}`, in order.
pub fn pb_view_line(line: &str, paths: &[&Path]) -> Run {
    let mut paths = paths.iter();
    let words = line.split_whitespace().map(|word| match word.split_once("{}") {
        Some((before, after)) => format!("{before}{}{after}", text(paths.next().expect("a path for each {}"))),
        None => word.to_owned(),
    });
    pb_view(&words.collect::<Vec<_>>())
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

/// The adapter, or none after saying loudly that a test did not run.
pub fn adapter(test: &str) -> Option<Gpu> {
    match Gpu::headless() {
        Ok(gpu) => Some(gpu),
        Err(RenderError::NoAdapter(reason)) => {
            eprintln!("SKIPPED: no Vulkan adapter: {test} did not run ({reason})");
            None
        }
        Err(e) => panic!("the adapter cannot be opened: {e}"),
    }
}
