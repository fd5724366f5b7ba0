use super::*;
use crate::mesh::Mesh;
use crate::reference::scene::Scene as Read;
use crate::watertight::check;
use glam::DVec2;

fn make(folder: &Path, name: &str, triangles: u64, seed: u64) -> PathBuf {
    let out = folder.join(name);
    run(&Arguments { out: out.clone(), triangles, texture: Some(128), seed }).unwrap();
    out
}

fn bytes_of(folder: &Path) -> Vec<(std::ffi::OsString, Vec<u8>)> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap());
    let mut all: Vec<_> = entries.map(|e| (e.file_name(), std::fs::read(e.path()).unwrap())).collect();
    all.sort();
    all
}

/// Triangles of one part alone, in double precision.
fn mesh_of(part: &Part) -> Mesh {
    let topology = part.topology();
    let triangles = topology.triangles.iter().map(|t| t.map(|w| topology.wedges[w as usize].position)).collect();
    Mesh { positions: part.positions().iter().map(|p| p.map(f64::from)).collect(), triangles }
}

fn corners(mesh: &Mesh, t: &[u32; 3]) -> [DVec3; 3] {
    t.map(|i| DVec3::from_array(mesh.positions[i as usize]))
}

#[test]
fn any_number_of_triangles_is_met_within_one_percent() {
    for triangles in [10_000, 20_000, 77_777, 1_000_000, 14_400_000, 400_000_000] {
        let made = Scene::new(triangles, None, 3).counts().triangles;
        assert!(made.abs_diff(triangles) * 100 <= triangles, "{triangles}: {made}");
    }
}

#[test]
fn parts_hold_what_they_count_and_no_part_is_large() {
    for part in Scene::new(30_000, None, 1).units.iter().flat_map(|u| &u.parts) {
        let topology = part.topology();
        let found = Counts {
            positions: part.positions().len() as u64,
            wedges: topology.wedges.len() as u64,
            triangles: topology.triangles.len() as u64,
        };
        assert_eq!(found, part.counts());
    }
    // Positions, wedges and triangles of a part are held while it is written.
    let scene = Scene::new(TRIANGLES[1], None, 1);
    let largest = scene.units.iter().flat_map(|u| &u.parts).map(|p| {
        let counts = p.counts();
        counts.positions * 12 + counts.wedges * 12 + counts.triangles * 12
    });
    let largest = largest.max().unwrap();
    assert!(largest < 48 << 20, "{largest}");
}

#[test]
fn a_seed_gives_the_same_bytes_and_another_seed_others() {
    let [a, b, c] = [4, 4, 5].map(|seed| {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path(), "a.ply", 10_000, seed);
        bytes_of(folder.path())
    });
    assert!(a == b);
    for ((name, a), (_, c)) in a.iter().zip(&c) {
        assert_eq!(a == c, name == "a.flight.json", "{name:?}");
    }
}

#[test]
fn all_parts_are_closed_and_face_outwards() {
    for triangles in [10_000, 150_000] {
        for (i, part) in Scene::new(triangles, None, 2).units.iter().flat_map(|u| &u.parts).enumerate() {
            let mesh = mesh_of(part);
            let found = check(&mesh);
            assert_eq!((found.unmatched_edges, found.non_manifold_edges), (0, 0), "part {i}");
            assert_eq!((found.triangles, found.vertices), (mesh.triangles.len(), mesh.positions.len()), "part {i}");
            let volume: f64 = mesh.triangles.iter().map(|t| corners(&mesh, t)).map(|[a, b, c]| a.cross(b).dot(c)).sum();
            assert!(volume > 0.0, "part {i}: {volume}");
        }
    }
}

#[test]
fn no_triangle_is_without_area_in_space_or_in_its_image() {
    for part in Scene::new(150_000, None, 2).units.iter().flat_map(|u| &u.parts) {
        let (mesh, topology) = (mesh_of(part), part.topology());
        for (t, wedges) in mesh.triangles.iter().zip(&topology.triangles) {
            let [a, b, c] = corners(&mesh, t);
            let long = (b - a).length_squared().max((c - a).length_squared()).max((c - b).length_squared());
            assert!((b - a).cross(c - a).length() > 1e-3 * long, "{a} {b} {c}");
            let [a, b, c] = wedges.map(|w| DVec2::from_array(topology.wedges[w as usize].uv.map(f64::from)));
            assert!((b - a).perp_dot(c - a).abs() > 1e-10, "{a} {b} {c}");
        }
    }
}

#[test]
fn the_whole_scene_is_closed_in_all_formats_and_textured_alike() {
    let folder = tempfile::tempdir().unwrap();
    let [ply, obj, glb] = ["a.ply", "b.obj", "c.glb"].map(|n| make(folder.path(), n, 20_000, 1));
    let found = check(&Mesh::read(&ply).unwrap());
    assert_eq!((found.unmatched_edges, found.non_manifold_edges), (0, 0));
    let [a, b] = [&ply, &obj].map(|p| Mesh::read(p).unwrap());
    let single = |m: &Mesh| m.positions.iter().map(|p| p.map(|x| x as f32)).collect::<Vec<_>>();
    assert!(single(&a) == single(&b) && a.triangles == b.triangles);
    let [obj, glb] = [obj, glb].map(|p| Read::read(&p).unwrap());
    assert_eq!(obj.triangles.len(), glb.triangles.len());
    assert_eq!(obj.texels(), glb.texels());
    for (a, b) in obj.triangles.iter().zip(&glb.triangles) {
        for k in 0..3 {
            assert!((obj.corners(a)[k] - glb.corners(b)[k]).length() < 1e-5);
            assert!((0..2).all(|i| (a.uv[k][i] - b.uv[k][i]).abs() < 1e-5));
        }
    }
}

#[test]
fn charts_of_a_unit_do_not_overlap_and_stay_inside() {
    for unit in &Scene::new(100_000, None, 6).units {
        let cells: Vec<Rect> = unit.parts.iter().flat_map(|p| p.cells.clone()).collect();
        for (i, a) in cells.iter().enumerate() {
            assert!((0..2).all(|k| a.start[k] >= 0.0 && a.start[k] + a.size[k] <= 1.0 + 1e-12), "{a:?}");
            for b in &cells[..i] {
                let apart = |k: usize| {
                    a.start[k] + a.size[k] <= b.start[k] + 1e-12 || b.start[k] + b.size[k] <= a.start[k] + 1e-12
                };
                assert!(apart(0) || apart(1), "{a:?} {b:?}");
            }
        }
        for part in &unit.parts {
            let wedges = part.topology().wedges;
            assert!(wedges.iter().flat_map(|w| w.uv).all(|x| (0.0..=1.0).contains(&x)));
        }
    }
}

#[test]
fn pillars_differ_in_shape_and_in_texture() {
    let layout = Layout { columns: 3, rows: 2 };
    let all: Vec<(Vec<DVec3>, [f64; 3])> = (0..3)
        .map(|column| {
            let (foot, seed) = (layout.foot(column, 0), layout.seed(column, 0, 1));
            let pillar = lathe::pillar(foot, seed, false);
            let places =
                pillar.positions([40, 100]).iter().map(|p| DVec3::from_array(p.map(f64::from)) - foot).collect();
            (places, pillar.color(100, 1, [0.3, 0.6]))
        })
        .collect();
    for (a, b) in [(&all[0], &all[1]), (&all[1], &all[2]), (&all[0], &all[2])] {
        let moved = a.0.iter().zip(&b.0).filter(|(a, b)| (**a - **b).length() > 1e-3).count();
        assert!(moved * 2 > a.0.len(), "{moved}");
        assert!((0..3).any(|k| (a.1[k] - b.1[k]).abs() > 0.01), "{:?} {:?}", a.1, b.1);
    }
}

#[test]
fn what_a_glb_file_cannot_hold_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("large.glb");
    let error = run(&Arguments { out, triangles: 400_000_000, texture: None, seed: 1 }).unwrap_err().to_string();
    assert!(error.contains("write .ply or .obj"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn the_flight_has_no_cut_and_passes_between_the_pillars() {
    for triangles in [10_000, 1_000_000, 14_400_000, 400_000_000] {
        let layout = Layout::new(triangles);
        let flight = flight::flight(&layout, 60.0, 30.0);
        let cameras: Vec<_> = (0..flight.frames()).map(|f| flight.camera(f, [64, 36])).collect();
        assert_eq!(cameras.len(), 1801);
        // A few times the average over the whole way.
        let step = (3.0 * f64::from(layout.columns + 6) * BAY[0] / 1800.0).max(0.15);
        for w in cameras.windows(2) {
            assert!((w[1].eye - w[0].eye).length() < step, "{} {}", w[0].eye, w[1].eye);
            let [a, b] = [&w[0], &w[1]].map(|c| c.ray(0.0, 0.0).normalize());
            assert!(a.angle_between(b) < 0.12, "{a} {b}");
        }
        for camera in &cameras {
            let eye = DVec2::new(camera.eye.x, camera.eye.z);
            for (column, row) in (0..layout.columns).flat_map(|c| (0..layout.rows).map(move |r| (c, r))) {
                let foot = layout.foot(column, row);
                assert!((eye - DVec2::new(foot.x, foot.z)).length() > 1.0, "{eye} {foot}");
            }
        }
    }
}

#[test]
fn stills_stand_for_two_seconds_each_and_then_jump() {
    let layout = Layout::new(1_000_000);
    let [flight, other] = [1, 2].map(|seed| flight::stills(&layout, 5, 30.0, seed));
    assert_eq!(flight.frames(), 300);
    let eye = |frame: usize| flight.camera(frame, [64, 36]).eye;
    let jumps: Vec<usize> = (0..299).filter(|&f| eye(f).distance(eye(f + 1)) > 1e-6).collect();
    assert_eq!(jumps, [59, 119, 179, 239]);
    assert!(other.camera(0, [64, 36]).eye != eye(0));
}
