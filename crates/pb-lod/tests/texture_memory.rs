//! What a textured bake holds in memory at most.

use pb_archive::Spill;
use pb_lod::progressive_buffers::bake::{
    BakeOptions, ChartMode, ChartOptions, Outside, TexelOptions, TextureInput, bake_textured,
};
use pb_mesh::material::{Material, Slot, TextureRef};
use pb_mesh::mesh::{Mesh, Soup};
use pb_mesh::repair::{RepairOptions, repair};
use pb_mesh::texture::image::{Image, TexelFormat};
use pb_mesh::texture::{self, Coverage, MapKind, TileLayout, TileSource, bake_tile, scratch_bytes};
use peak_alloc::PeakAlloc;
use std::sync::{Arc, Mutex};

#[global_allocator]
static HEAP: PeakAlloc = PeakAlloc;

/// Tests measure one after the other.
static ALONE: Mutex<()> = Mutex::new(());

/// The most bytes of the heap that `work` had beyond what was there.
fn peak_of<T>(work: impl FnOnce() -> T) -> (usize, T) {
    let before = HEAP.current_usage();
    HEAP.reset_peak_usage();
    let result = work();
    (HEAP.peak_usage() - before, result)
}

fn image(size: u32) -> Image {
    let texel = |i: u32| [i as u8, (i >> 8) as u8, (i >> 16) as u8];
    Image::new(size, size, TexelFormat::Rgb8, Arc::new((0..size * size).flat_map(texel).collect::<Vec<u8>>()))
}

fn material() -> Material {
    let mut material = Material::default();
    material.textures[Slot::BaseColor as usize] = Some(TextureRef::plain(0));
    material
}

/// A flat square of `2 cells^2` triangles with an image over it.
fn sheet(cells: u32) -> Mesh {
    let side = cells + 1;
    let mut soup = Soup { uv_sets: vec![Vec::new()], ..Soup::default() };
    for (i, j) in (0..side).flat_map(|j| (0..side).map(move |i| (i, j))) {
        let (u, v) = (f64::from(i) / f64::from(cells), f64::from(j) / f64::from(cells));
        soup.positions.push([u, v, 0.0]);
        soup.uv_sets[0].push([u as f32, v as f32]);
    }
    for (i, j) in (0..cells).flat_map(|j| (0..cells).map(move |i| (i, j))) {
        let [a, b, c, d] = [j * side + i, j * side + i + 1, (j + 1) * side + i + 1, (j + 1) * side + i];
        soup.triangles.extend([[a, b, c], [a, c, d]]);
    }
    soup.material_of = vec![0; soup.triangles.len()];
    repair(soup, &RepairOptions::default()).expect("a sound mesh").0
}

/// Bytes of all texture chunks, and of the heap at most while they were made; about `across^2` clusters.
fn bake(across: u32, spill: &Spill) -> (usize, usize) {
    let (mesh, image) = (sheet(8 * across), image(256 * across));
    let textures = TextureInput {
        materials: &[material()],
        images: &[Some(image)],
        charts: ChartOptions { mode: ChartMode::Source, tile_size: 512, charter: None },
        texels: TexelOptions { compress: false, ..TexelOptions::default() },
    };
    let options = BakeOptions { cluster_triangles: Some(128), ..BakeOptions::default() };
    // On one thread: each more would have a tile at work.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("one thread");
    let outside = Outside { spill, ..Outside::nothing() };
    let work = || bake_textured(mesh, Some(&textures), 0, &options, &outside).expect("options in range").0;
    let (peak, model) = peak_of(|| pool.install(work));
    let geometry = (model.record.clusters * model.record.levels) as usize;
    (model.chunks[geometry..].iter().map(|c| c.bytes.len()).sum(), peak)
}

#[test]
fn packed_texels_do_not_pile_up_in_memory() {
    let _alone = ALONE.lock();
    let folder = tempfile::tempdir().expect("a folder");
    let spill = Spill::in_folder(folder.path()).expect("a file");
    // What else a bake holds grows with the mesh too, but not with the texels.
    let ((few, peak_few), (many, peak_many)) = (bake(2, &spill), bake(8, &spill));
    println!("{few} bytes: {peak_few}; {many} bytes: {peak_many}");
    assert!(many > 10 * few, "{few} {many}");
    assert!(peak_many < many / 2, "{peak_many} bytes held for {many} of chunks");
    let (many, peak_many) = bake(8, &Spill::in_memory());
    assert!(peak_many > many, "the measure sees what is kept: {peak_many} {many}");
}

#[test]
fn a_tile_at_work_holds_no_more_than_it_was_let_in_for() {
    let _alone = ALONE.lock();
    const SIZE: u32 = 1024;
    let (materials, images) = ([material()], [Some(image(256))]);
    for part in [0u16, 20_000, 45_000, 65_535] {
        let corners = [[[0, 0], [part, 0], [part, part]], [[0, 0], [part, part], [0, part]]];
        let layout = TileLayout { size: SIZE, corners: &corners, chart_of: &[0, 0], open_edges: &[] };
        let uvs = corners.map(|t| t.map(|c| c.map(|x| f32::from(x) / 65536.0)));
        let source = TileSource {
            materials: &materials,
            images: &images,
            material_of: &[0, 0],
            uv_sets: &[uvs.to_vec()],
            colors: &[],
            normals: &[],
            positions: &[],
        };
        for hdr in [false, true] {
            let options = texture::BakeOptions { hdr, ..texture::BakeOptions::default() };
            let (peak, _) = peak_of(|| {
                let coverage = Coverage::new(&layout);
                bake_tile(&source, &layout, &coverage, MapKind::BaseColor, options)
            });
            let admitted = scratch_bytes(SIZE, hdr) as usize;
            println!("{part} {hdr}: {:.1} of {:.1} per texel", peak as f64 / 1048576.0, admitted as f64 / 1048576.0);
            assert!(peak <= admitted, "{part}: {peak} bytes held, {admitted} admitted");
            assert!(part == 0 || peak > admitted / 2, "{part}: {peak} bytes held, {admitted} admitted");
        }
    }
}
