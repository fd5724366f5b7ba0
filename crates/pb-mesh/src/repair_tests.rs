//! Promises of `repair`, on meshes small enough to read.

use super::*;
use proptest::prelude::*;

fn tetrahedron() -> Soup {
    Soup {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        ..Soup::default()
    }
}

/// The same surface with own records for each triangle.
fn exploded(soup: &Soup) -> Soup {
    Soup {
        positions: soup.triangles.as_flattened().iter().map(|&i| soup.positions[i as usize]).collect(),
        triangles: (0..soup.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        ..Soup::default()
    }
}

fn repaired(soup: Soup) -> (Mesh, RepairReport) {
    repair(soup, &RepairOptions::default()).unwrap()
}

#[test]
fn separate_triangles_become_one_closed_surface() {
    let (mesh, report) = repaired(exploded(&tetrahedron()));
    assert_eq!((mesh.positions.len(), mesh.wedges.len(), mesh.triangles.len()), (4, 4, 4));
    assert_eq!((report.positions_welded, report.topology), (8, Topology::default()));
    assert_eq!(mesh.positions[0], [0.0; 3]);
    assert!(mesh.wedges.iter().enumerate().all(|(i, w)| w.position as usize == i && w.color == [255; 4]));
}

#[test]
fn minus_zero_welds_with_zero_and_never_remains() {
    let mut soup = exploded(&tetrahedron());
    soup.positions[0] = [-0.0, 0.0, -0.0];
    let (mesh, _) = repaired(soup);
    assert_eq!(mesh.positions.len(), 4);
    assert!(mesh.positions.as_flattened().iter().all(|x| x.to_bits() != (-0.0f64).to_bits()));
}

#[test]
fn degenerate_and_duplicate_triangles_go_and_the_first_stays() {
    let mut soup = tetrahedron();
    soup.triangles.insert(0, [1, 1, 2]);
    soup.triangles.extend([[1, 0, 2], [3, 2, 1], [2, 2, 2]]);
    let (mesh, report) = repaired(soup);
    assert_eq!((report.degenerate_removed, report.duplicates_removed, report.triangles_in), (2, 2, 8));
    assert_eq!(mesh.triangles, tetrahedron().triangles);
}

#[test]
fn a_flat_triangle_stays_because_its_neighbours_need_it() {
    // A square whose lower edge has a vertex in the middle; the flat triangle 0-1-2 closes the T.
    let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0]];
    let triangles = vec![[0, 2, 3], [0, 1, 2], [0, 4, 1], [1, 4, 2]];
    let (mesh, report) = repaired(Soup { positions, triangles, ..Soup::default() });
    assert_eq!((mesh.triangles.len(), report.zero_area_kept), (4, 1));
    assert_eq!(report.topology, Topology { boundary_edges: 4, ..Topology::default() });
}

#[test]
fn unreferenced_vertices_are_dropped_and_counted() {
    let mut soup = tetrahedron();
    soup.positions.push([9.0; 3]);
    soup.positions.insert(0, [8.0; 3]);
    soup.triangles.iter_mut().flatten().for_each(|i| *i += 1);
    let (mesh, report) = repaired(soup);
    assert_eq!((report.unreferenced_dropped, mesh.positions.len()), (2, 4));
    assert_eq!(mesh.triangles, tetrahedron().triangles);
}

#[test]
fn positions_with_several_normals_have_several_wedges_in_order() {
    let mut soup = exploded(&tetrahedron());
    soup.normals = (0..12).map(|i| if i == 3 { [0.0, 0.0, 2.0] } else { [1.0, 0.0, 0.0] }).collect();
    let (mesh, report) = repaired(soup);
    assert_eq!((mesh.positions.len(), mesh.wedges.len(), report.normals_made), (4, 5, 0));
    assert_eq!(mesh.wedges[1].normal, [0.0, 0.0, 1.0], "normalised, beside the other of position 0");
    let corners: Vec<_> = (0..4).map(|t| mesh.corner_positions(t)).collect();
    assert_eq!(corners, [[0, 1, 2], [0, 2, 3], [2, 1, 3], [1, 0, 3]]);
    assert!(mesh.wedges.is_sorted_by_key(|w| w.position));
}

#[test]
fn broken_normals_are_made_again_and_counted() {
    let mut soup = tetrahedron();
    soup.normals = vec![[1.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0], [0.0; 3], [0.0, f32::INFINITY, 0.0]];
    let (mesh, report) = repaired(soup);
    assert_eq!((report.normals_repaired, report.normals_made), (2, 1));
    for wedge in &mesh.wedges {
        let length: f32 = wedge.normal.iter().map(|x| x * x).sum();
        assert!((length - 1.0).abs() < 1e-5);
    }
}

#[test]
fn colours_stay_with_their_records() {
    let mut soup = tetrahedron();
    soup.colors = vec![[1, 2, 3, 4], [5, 6, 7, 8], [9, 9, 9, 9], [0, 0, 0, 255]];
    let (mesh, _) = repaired(soup.clone());
    assert!(mesh.has_colors);
    let colors: Vec<_> = mesh.triangles.iter().map(|t| t.map(|w| mesh.wedges[w as usize].color)).collect();
    let expected: Vec<_> = tetrahedron().triangles.iter().map(|t| t.map(|i| soup.colors[i as usize])).collect();
    assert_ne!(mesh.positions.len(), 0);
    assert_eq!(colors, expected);
}

/// A tetrahedron in which every corner of every triangle has its own texture coordinate, and every triangle its own
/// material: `(triangle, corner)` and `10 + triangle`.
fn textured() -> Soup {
    let mut soup = exploded(&tetrahedron());
    soup.uv_sets = vec![(0..12).map(|i| [(i / 3) as f32, (i % 3) as f32]).collect()];
    soup.material_of = vec![10, 11, 12, 13];
    soup
}

#[test]
fn texture_coordinates_and_materials_follow_their_triangles() {
    let mut soup = textured();
    // A degenerate triangle in front, a duplicate of the second in the middle.
    soup.triangles.insert(0, [0, 0, 1]);
    soup.material_of.insert(0, 99);
    soup.triangles.insert(3, [4, 3, 5]);
    soup.material_of.insert(3, 98);
    let (mesh, report) = repaired(soup);
    assert_eq!((report.degenerate_removed, report.duplicates_removed), (1, 1));
    let texturing = mesh.texturing.unwrap();
    assert_eq!(texturing.material_of, [10, 11, 12, 13]);
    let expected: Vec<_> = (0..4).map(|t| [0, 1, 2].map(|k| [t as f32, k as f32])).collect();
    assert_eq!(texturing.corner_uvs, [expected]);
    assert_eq!(mesh.wedges.len(), 4, "texture coordinates make no wedges");
}

#[test]
fn splitting_sheets_moves_no_texture_coordinate() {
    // Three triangles around the edge 0-1: one of them gets positions of its own.
    let soup = Soup {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
        triangles: vec![[0, 1, 2], [1, 0, 3], [0, 1, 4]],
        uv_sets: vec![(0..5).map(|i| [i as f32, 0.5]).collect()],
        material_of: vec![7, 8, 9],
        ..Soup::default()
    };
    let places = soup.positions.clone();
    let (mesh, report) = repaired(soup);
    assert!(report.split.copies > 0);
    let texturing = mesh.texturing.as_ref().unwrap();
    assert_eq!(texturing.material_of, [7, 8, 9]);
    for t in 0..3 {
        for (uv, v) in texturing.corner_uvs[0][t].iter().zip(mesh.corner_positions(t)) {
            assert_eq!(places[uv[0] as usize], mesh.positions[v as usize]);
        }
    }
}

#[test]
fn unusable_texture_coordinates_become_zero_and_are_counted() {
    let mut soup = textured();
    soup.uv_sets[0][1] = [f32::NAN, 0.5];
    soup.uv_sets[0][2] = [0.5, f32::INFINITY];
    soup.uv_sets[0][3] = [-1e9, 4.0];
    let (mesh, report) = repaired(soup);
    let uvs = &mesh.texturing.unwrap().corner_uvs[0];
    assert_eq!(report.uvs_repaired, 3);
    assert_eq!((uvs[0], uvs[1][0]), ([[0.0, 0.0], [0.0, 0.5], [0.5, 0.0]], [0.0, 4.0]));
}

#[test]
fn materials_without_texture_coordinates_are_kept() {
    let soup = Soup { material_of: vec![0, 1, 0, 1], ..tetrahedron() };
    let texturing = repaired(soup).0.texturing.unwrap();
    assert_eq!((texturing.material_of, texturing.corner_uvs.len()), (vec![0, 1, 0, 1], 0));
    assert_eq!(repaired(tetrahedron()).0.texturing, None);
}

#[test]
fn tolerance_closes_small_gaps() {
    let mut soup = exploded(&tetrahedron());
    soup.positions[4][0] += 1e-4;
    let open = repaired(soup.clone()).1;
    assert!(open.topology.boundary_edges > 0);
    let options = RepairOptions { weld_tolerance: 1e-3, ..RepairOptions::default() };
    let (mesh, report) = repair(soup, &options).unwrap();
    assert_eq!((mesh.positions.len(), report.topology), (4, Topology::default()));
}

#[test]
fn unusable_coordinates_are_errors_that_name_the_first() {
    for (bad, text) in [(f64::NAN, "(NaN, 1, 0)"), (f64::NEG_INFINITY, "(-inf, 1, 0)"), (2e30, "vertex 2 ")] {
        let mut soup = tetrahedron();
        soup.positions[2][0] = bad;
        soup.positions[3][0] = bad;
        let message = repair(soup, &RepairOptions::default()).unwrap_err().to_string();
        assert!(message.contains(text) && message.contains("vertex 2"), "{message}");
    }
}

#[test]
fn nothing_to_bake_is_an_error() {
    let empty = repair(Soup::default(), &RepairOptions::default()).unwrap_err();
    assert_eq!(empty, MeshError::NoTriangles { triangles_in: 0, degenerate: 0 });
    let point = Soup { triangles: vec![[1, 1, 1]], ..tetrahedron() };
    let message = repair(point, &RepairOptions::default()).unwrap_err().to_string();
    assert!(message.contains("no usable triangle: 1 in the input"), "{message}");
}

/// A closed grid-like torus: every vertex has six neighbours.
fn torus(n: u32) -> Soup {
    let at = |i: u32, j: u32| (i % n) * n + j % n;
    let turn = |i: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
    let positions = (0..n * n)
        .map(|v| {
            let (a, b) = (turn(v / n), turn(v % n));
            [(3.0 + b.cos()) * a.cos(), (3.0 + b.cos()) * a.sin(), b.sin()]
        })
        .collect();
    let triangles = (0..n * n)
        .flat_map(|v| {
            let (i, j) = (v / n, v % n);
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        })
        .collect();
    Soup { positions, triangles, ..Soup::default() }
}

/// The same surface with the normal of each triangle at its corners.
fn facetted(soup: &Soup) -> Soup {
    let mut soup = exploded(soup);
    for t in soup.triangles.clone() {
        let (_, _, cross) = spans(t.map(|i| soup.positions[i as usize]));
        soup.normals.extend([cross.map(|x| x as f32); 3]);
    }
    soup
}

#[test]
fn facet_normals_of_a_curved_surface_are_replaced_by_smooth_ones() {
    let (mesh, report) = repaired(facetted(&torus(60)));
    assert!(report.facet_normals_replaced);
    assert_eq!(mesh.wedges.len(), mesh.positions.len());
    let keep = RepairOptions { input_normals: InputNormals::Keep, ..RepairOptions::default() };
    let (kept, report) = repair(facetted(&torus(60)), &keep).unwrap();
    assert!(!report.facet_normals_replaced && kept.wedges.len() > 5 * kept.positions.len());
    let (small, _) = repaired(facetted(&torus(10)));
    assert!(small.wedges.len() > 5 * small.positions.len(), "a small mesh may be meant so");
}

#[test]
fn one_and_many_threads_make_the_same_mesh() {
    let mut soup = exploded(&torus(150));
    soup.colors = (0..soup.positions.len()).map(|i| [(i % 3) as u8; 4]).collect();
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| repaired(soup.clone()))
    };
    let one = on(1);
    assert_eq!(one.0.positions.len(), 22_500);
    assert!(one.0.wedges.len() > 22_500);
    assert_eq!(one, on(4));
}

proptest! {
    #[test]
    fn closed_in_closed_out_and_order_kept(order in Just((0..200u32).collect::<Vec<_>>()).prop_shuffle(), junk in 0..20u32) {
        let torus = torus(10);
        let mut soup = Soup { positions: torus.positions.clone(), ..Soup::default() };
        soup.triangles = order.iter().map(|&t| torus.triangles[t as usize]).collect();
        let wanted = soup.triangles.clone();
        soup.triangles.extend((0..junk).flat_map(|i| [[i, i, i + 1], torus.triangles[i as usize]]));
        let (mesh, report) = repaired(exploded(&soup));
        prop_assert_eq!(report.topology, Topology::default());
        prop_assert_eq!((report.degenerate_removed, report.duplicates_removed), (u64::from(junk), u64::from(junk)));
        let places = |t: [u32; 3], p: &[[f64; 3]]| t.map(|i| p[i as usize]);
        for (t, w) in wanted.iter().enumerate() {
            prop_assert_eq!(places(mesh.corner_positions(t), &mesh.positions), places(*w, &torus.positions));
        }
    }
}

#[test]
fn triangles_in_no_order_are_sorted_and_nothing_else_changes() {
    let side = 600u32;
    let squares: Vec<u32> = (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| y * side + x)).collect();
    let count = squares.len();
    let mesh = |step: usize| {
        let corners = |i: usize| squares[i * step % count];
        let soup = Soup {
            positions: (0..side * side).map(|i| [f64::from(i % side), f64::from(i / side), 0.0]).collect(),
            triangles: (0..count).map(corners).map(|v| [v, v + 1, v + side]).collect(),
            ..Soup::default()
        };
        repair(soup, &RepairOptions::default()).unwrap()
    };
    let ((plain, in_order), (sorted, in_none)) = (mesh(1), mesh(100_003));
    assert!(!in_order.sorted_along_curve && in_none.sorted_along_curve);
    assert_eq!(RepairReport { sorted_along_curve: false, ..in_none }, in_order);
    let places = |mesh: &Mesh| {
        let place = |v: u32| mesh.positions[v as usize].map(f64::to_bits);
        let mut all: Vec<_> = (0..mesh.triangles.len()).map(|t| mesh.corner_positions(t).map(place)).collect();
        all.sort_unstable();
        all
    };
    assert_eq!(places(&sorted), places(&plain));
    assert_ne!(sorted.triangles, plain.triangles);
}
