//! One table of numbers per small fixture: a change of quality or size is a visible difference.
//! `UPDATE_GOLDEN=1 cargo test -p pb-lod --test golden` writes the table anew.

mod common;

use std::fmt::Write;
use std::path::Path;

use common::{baked, small_fixture};
use pb_lod::progressive_buffers::bake::BakeOptions;

const FIXTURES: [&str; 4] = ["parts.ply", "sphere.ply", "terrain.ply", "torus.ply"];

fn table() -> String {
    let mut out = String::from(
        "| fixture | clusters | level | vertices | triangles | max error | rms error | chunk bytes |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for name in FIXTURES {
        let model = baked(small_fixture(name), &BakeOptions { cluster_triangles: Some(500), ..BakeOptions::default() });
        let clusters = model.record().clusters;
        for (level, row) in (0..).zip(model.model_levels()) {
            let chunk = |c| model.archive().chunk(model.chunk_id(c, level).0).expect("a sound chunk").len();
            let bytes: usize = (0..clusters).map(chunk).sum();
            let (vertices, triangles) = (row.vertices, row.triangles);
            let (max, rms) = (row.max_error, row.rms_error);
            writeln!(
                out,
                "| {name} | {clusters} | {level} | {vertices} | {triangles} | {max:.3e} | {rms:.3e} | {bytes} |"
            )
            .expect("a string takes all");
        }
    }
    out
}

#[test]
fn levels_of_the_small_fixtures_are_those_of_the_golden_table() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data-fixtures/golden.md");
    let found = table();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, &found).expect("the table can be written");
    }
    let expected = std::fs::read_to_string(&path).expect("data-fixtures/golden.md");
    assert!(found == expected, "levels have changed; if that is meant, run with UPDATE_GOLDEN=1 and commit\n{found}");
}

#[test]
fn error_never_falls_towards_coarse() {
    for name in FIXTURES {
        let model = baked(small_fixture(name), &BakeOptions { cluster_triangles: Some(500), ..BakeOptions::default() });
        for cluster in 0..model.record().clusters {
            let errors: Vec<f32> = (0..model.levels()).map(|l| model.level(cluster, l).error).collect();
            assert!(errors.is_sorted(), "{name}, cluster {cluster}: {errors:?}");
        }
        assert!(model.model_levels().is_sorted_by(|fine, coarse| fine.vertices >= coarse.vertices), "{name}");
    }
}
