//! Stated errors against sampled distances: computed here from nothing but triangles, in double precision, by trying
//! every triangle.

mod common;

use common::{Decoded, Random, baked, fixture, read_obj, small_fixture, torus};
use glam::DVec3;
use pb_lod::progressive_buffers::bake::BakeOptions;
use pb_mesh::mesh::Soup;

const SAMPLES: usize = 400;

type Triangle = [DVec3; 3];

fn distance_to_segment(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let along = b - a;
    let t = if along.length_squared() > 0.0 { (p - a).dot(along) / along.length_squared() } else { 0.0 };
    p.distance(a + along * t.clamp(0.0, 1.0))
}

fn distance_to_triangle(p: DVec3, [a, b, c]: Triangle) -> f64 {
    let normal = (b - a).cross(c - a);
    let inside = [(a, b), (b, c), (c, a)].iter().all(|(s, e)| (*e - *s).cross(p - *s).dot(normal) >= 0.0);
    if inside && normal.length() > 0.0 {
        return (p - a).dot(normal.normalize()).abs();
    }
    distance_to_segment(p, a, b).min(distance_to_segment(p, b, c)).min(distance_to_segment(p, c, a))
}

fn distance(p: DVec3, surface: &[Triangle]) -> f64 {
    surface.iter().map(|&t| distance_to_triangle(p, t)).fold(f64::INFINITY, f64::min)
}

/// Points spread over triangles, by turns, so that small ones are met too.
fn samples(surface: &[Triangle], count: usize, random: &mut Random) -> Vec<DVec3> {
    let point = |i: usize, random: &mut Random| {
        let [a, b, c] = surface[i * surface.len() / count];
        let (mut s, mut t) = (random.next(), random.next());
        if s + t > 1.0 {
            (s, t) = (1.0 - s, 1.0 - t);
        }
        a + (b - a) * s + (c - a) * t
    };
    (0..count).map(|i| point(i, random)).collect()
}

fn input_surface(soup: &Soup) -> Vec<Triangle> {
    soup.triangles.iter().map(|t| t.map(|v| DVec3::from_array(soup.positions[v as usize]))).collect()
}

/// Level triangles of a cluster, world space.
fn level_surface(d: &Decoded, cluster: u32, level: u32) -> Vec<Triangle> {
    let (record, model) = (&d.model.clusters()[cluster as usize], d.model.record());
    let prefix = &d.prefixes[(cluster * d.model.levels() + level) as usize];
    let at = |i: u16| {
        let offset = prefix.vertices[i as usize].offset;
        let grid = |k: usize| f64::from(record.origin[k] + (i32::from(offset[k]) << record.shift));
        DVec3::from_array(std::array::from_fn(|k| model.origin[k] + grid(k) * model.quantum))
    };
    prefix.indices.chunks_exact(3).map(|t| [at(t[0]), at(t[1]), at(t[2])]).collect()
}

fn bounds_hold(name: &str, soup: Soup, options: &BakeOptions) {
    let input = input_surface(&soup);
    let d = Decoded::new(baked(soup, options));
    let mut random = Random(0x9E37_79B9_7F4A_7C15);
    let from_input = samples(&input, SAMPLES, &mut random);
    for level in 0..d.model.levels() {
        let mut whole = Vec::new();
        for cluster in 0..d.clusters() {
            let surface = level_surface(&d, cluster, level);
            let bound = f64::from(d.model.level(cluster, level).error);
            for p in samples(&surface, SAMPLES.min(20 * surface.len()) / d.clusters() as usize, &mut random) {
                let found = distance(p, &input);
                assert!(found <= bound, "{name}, cluster {cluster}, level {level}: {found} is more than {bound}");
            }
            whole.extend(surface);
        }
        let bound = d.model.model_levels()[level as usize].max_error;
        let found = from_input.iter().map(|&p| distance(p, &whole)).fold(0.0, f64::max);
        assert!(found <= bound, "{name}, input to level {level}: {found} is more than {bound}");
        assert!(level < 2 || bound < 6.0 * found, "{name}, level {level}: {bound} says little about {found}");
    }
}

#[test]
fn no_sample_is_further_from_the_input_than_its_cluster_states() {
    let options = BakeOptions { cluster_triangles: Some(1500), ..BakeOptions::default() };
    bounds_hold("torus", torus(24), &options);
    for name in ["sphere.ply", "terrain.ply"] {
        bounds_hold(name, small_fixture(name), &options);
    }
}

#[test]
fn no_sample_is_further_from_a_scan_than_its_cluster_states() {
    for name in ["obj_spot/spot_triangulated.obj", "manifold_tests/self_intersectA.obj", "scan_ycb_chain/textured.obj"]
    {
        if let Some(path) = fixture(name) {
            bounds_hold(
                name,
                read_obj(&path),
                &BakeOptions { cluster_triangles: Some(4000), ..BakeOptions::default() },
            );
        }
    }
}

#[test]
fn each_level_of_a_closed_mesh_has_a_quarter_of_the_vertices() {
    // The torus is rough down to the edge length: its later levels would turn triangles over.
    let mut meshes = vec![("torus", torus(90), 2)];
    meshes.extend(fixture("scan_hammer/hammer.obj").map(|path| ("hammer", read_obj(&path), 4)));
    for (name, soup, last) in meshes {
        let model = baked(soup, &BakeOptions::default());
        let rows = model.model_levels();
        for level in 1..=last {
            let ratio = (rows[0].vertices as f64 / rows[level].vertices as f64).powf(1.0 / level as f64);
            assert!((ratio / 4.0 - 1.0).abs() < 0.02, "{name}, level {level}: {ratio} times fewer per level");
        }
    }
}

/// Tetrahedra by themselves, spread over a unit cube.
fn crumbs(count: u32) -> Soup {
    let (mut soup, mut random) = (Soup::default(), Random(77));
    for i in 0..count {
        let center: [f64; 3] = std::array::from_fn(|_| random.next());
        let size = 0.005 * (0.5 + random.next());
        let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
        soup.positions.extend(corners.map(|c: [f64; 3]| std::array::from_fn(|k| center[k] + c[k] * size)));
        soup.triangles.extend([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]].map(|t: [u32; 3]| t.map(|v| v + 4 * i)));
    }
    soup
}

#[test]
fn each_level_of_loose_parts_draws_a_quarter_of_them() {
    let model = baked(crumbs(8000), &BakeOptions { cluster_triangles: Some(8000), ..BakeOptions::default() });
    let rows = model.model_levels();
    for level in 1..rows.len() {
        let ratio = rows[level - 1].triangles as f64 / rows[level].triangles as f64;
        assert!((ratio / 4.0 - 1.0).abs() < 0.05, "level {level}: {ratio} times fewer triangles");
    }
}
