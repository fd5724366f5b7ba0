//! `--export-view` surfaces: closed models stay closed, whatever the frame shows and wherever the model lies.

use crate::support::{
    FAR, adapter, column, crowd, crowd_placements, far_torus, folder, pb_view_line, torus, write_flight,
};
use std::collections::HashMap;
use std::path::Path;

/// Positions and triangles of a binary PLY that pb-view wrote.
fn read_ply(path: &Path) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    assert!(header.starts_with("ply\nformat binary_little_endian 1.0\n"));
    assert!(header.contains("property double x"));
    let count = |what: &str| -> usize {
        let line = header.lines().find_map(|l| l.strip_prefix(&format!("element {what} "))).unwrap();
        line.parse().unwrap()
    };
    let (vertices, faces) = (count("vertex"), count("face"));
    let body = &bytes[end..];
    assert_eq!(body.len(), vertices * 28 + faces * 13);
    let double = |at: usize| f64::from_le_bytes(body[at..at + 8].try_into().unwrap());
    let positions = (0..vertices).map(|v| [0, 8, 16].map(|k| double(v * 28 + k))).collect();
    let face = |f: usize| {
        let at = vertices * 28 + f * 13;
        assert_eq!(body[at], 3);
        [1, 5, 9].map(|k| u32::from_le_bytes(body[at + k..at + k + 4].try_into().unwrap()))
    };
    (positions, (0..faces).map(face).collect())
}

/// Edges whose two directions are not used equally often.
fn unmatched_edges(triangles: &[[u32; 3]]) -> usize {
    let mut balance: HashMap<(u32, u32), i32> = HashMap::new();
    for t in triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            *balance.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
        }
    }
    balance.values().filter(|b| **b != 0).count()
}

fn check(name: &str, archive: &Path, center: [f64; 3], more: &str) {
    let on_the_torus = |p: [f64; 3]| {
        let radius = (0..3).map(|k| (p[k] - center[k]).powi(2)).sum::<f64>().sqrt();
        (1.5..5.0).contains(&radius)
    };
    check_places(name, archive, (center, &on_the_torus), more);
}

fn check_places(name: &str, archive: &Path, (center, is_right): ([f64; 3], &dyn Fn([f64; 3]) -> bool), more: &str) {
    let Some(_) = adapter(name) else { return };
    let out = folder(name);
    let (path, stats) = (out.join("flight.json"), out.join("stats.csv"));
    let at = |p: [f64; 3]| std::array::from_fn(|k| p[k] + center[k]);
    let keys = [(0.0, at([3.4, 1.4, 2.3]), at([1.0, 0.0, 0.0])), (1.0, at([9.0, 40.0, 5.0]), at([0.0; 3]))];
    write_flight(&path, 20.0, [0.0, 1.0, 0.0], 50.0, &keys);
    let files = [0, 1, 7, 13, 20].map(|frame| (frame, out.join(format!("{frame}.ply"))));
    let exports: Vec<String> = files.iter().map(|(f, _)| format!("--export-view {f}={{}}")).collect();
    let line = format!("{{}} --flypath {{}} --size 320x240 --stats {{}} {} {more}", exports.join(" "));
    let mut paths = vec![archive, &path, &stats];
    paths.extend(files.iter().map(|(_, file)| file.as_path()));
    let run = pb_view_line(&line, &paths);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(column(&stats, "frame").len(), 21);
    let mut sizes = Vec::new();
    for (frame, file) in &files {
        let (positions, triangles) = read_ply(file);
        assert_eq!(unmatched_edges(&triangles), 0, "frame {frame}");
        for p in &positions {
            assert!(is_right(*p), "frame {frame}: {p:?} is not on the surface");
        }
        sizes.push(triangles.len());
    }
    assert!(sizes.iter().all(|s| *s > 100), "{sizes:?}");
    assert!(sizes.iter().max() > sizes.iter().min(), "all frames show the same: {sizes:?}");
}

#[test]
fn settled_surfaces_of_a_closed_model_are_closed() {
    check("export_settled", torus(), [0.0; 3], "--settle --error-px 2");
}

#[test]
fn surfaces_with_late_data_and_little_vram_are_closed() {
    check("export_late", torus(), [0.0; 3], "--late-frames 3 --vram 400KiB --ram 400KiB");
}

#[test]
fn surfaces_with_bands_are_closed() {
    check("export_bands", torus(), [0.0; 3], "--settle --band 1.5,-0.3");
}

#[test]
fn surfaces_far_from_the_origin_are_closed() {
    check("export_far", far_torus(), FAR, "--settle --error-px 2");
}

/// All instances together, each on its torus.
fn check_crowd(name: &str, more: &str) {
    let placements = crowd_placements();
    let middles = [[0.0; 3], [0.0, 0.0, -12.0]].map(glam::DVec3::from);
    let on_a_torus = |p: [f64; 3]| {
        let p = glam::DVec3::from(p);
        let near = |from: f64| (1.5..5.0).contains(&from);
        near(p.distance(middles[0])) || placements.iter().any(|x| near(x.point_of(p).distance(middles[1])))
    };
    check_places(name, crowd(), ([0.0; 3], &on_a_torus), more);
}

#[test]
fn surfaces_of_instances_are_closed_and_stand_where_the_instances_do() {
    check_crowd("export_crowd", "--settle --error-px 2");
    check_crowd("export_crowd_bands", "--settle --band 1.5,-0.3");
    check_crowd("export_crowd_late", "--late-frames 3 --vram 600KiB --ram 300KiB");
}
