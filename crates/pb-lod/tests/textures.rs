//! Baked textures: right colours everywhere, at every level and mip, and no triangle turned over in UV.

mod common;

use common::Random;
use glam::DVec3;
use pb_archive::{MemoryStorage, Writer};
use pb_lod::progressive_buffers::bake::{
    BakeOptions, BakeReport, ChartMode, ChartOptions, Outside, Stage, TexelOptions, TextureInput, bake_textured,
};
use pb_lod::progressive_buffers::layout::{SCHEME, Vertex};
use pb_lod::progressive_buffers::model::Model;
use pb_lod::progressive_buffers::textures::{MapFormat, MapKind, MapRecord};
use pb_lod::progressive_buffers::verify::verify;
use pb_lod::progressive_buffers::write::{BakedModel, write_model};
use pb_mesh::material::{Material, Slot, TextureRef};
use pb_mesh::mesh::{Soup, Texturing};
use pb_mesh::repair::{RepairOptions, repair};
use pb_mesh::texture::Texels;
use pb_mesh::texture::image::{Image, TexelFormat};
use pb_mesh::texture::{BlockFormat, NormalSpace, decode};
use std::path::Path;
use std::sync::{Arc, Mutex};

const LEVELS: u32 = 5;

fn height(u: f64, v: f64) -> f64 {
    0.05 * (u * 9.0).sin() * (v * 7.0).cos() + 0.004 * (u * 83.0).sin() * (v * 71.0).sin()
}

/// Hills of `2 cells^2` triangles over the unit square.
fn hills(cells: u32) -> Soup {
    let side = cells + 1;
    let mut soup = Soup::default();
    for (i, j) in (0..side).flat_map(|j| (0..side).map(move |i| (i, j))) {
        let (u, v) = (f64::from(i) / f64::from(cells), f64::from(j) / f64::from(cells));
        soup.positions.push([u, v, height(u, v)]);
    }
    for (i, j) in (0..cells).flat_map(|j| (0..cells).map(move |i| (i, j))) {
        let [a, b, c, d] = [j * side + i, j * side + i + 1, (j + 1) * side + i + 1, (j + 1) * side + i];
        soup.triangles.extend([[a, b, c], [a, c, d]]);
    }
    soup
}

/// Cuts the hills into `across * across` islands, each in its own field of the image with a wide margin.
fn islands(soup: Soup, across: u32, margin: f32) -> Soup {
    let mut out = Soup { uv_sets: vec![Vec::new()], ..Soup::default() };
    for t in &soup.triangles {
        let corners = t.map(|v| soup.positions[v as usize]);
        let middle = |k: usize| corners.iter().map(|p| p[k]).sum::<f64>() / 3.0;
        let field = [middle(0), middle(1)].map(|x| (x * f64::from(across)) as u32 as f32);
        let base = out.positions.len() as u32;
        for p in corners {
            let inside = |k: usize| (p[k] as f32 * across as f32 - field[k]) * (1.0 - 2.0 * margin) + margin;
            let uv = [0, 1].map(|k| (field[k] + inside(k)) / across as f32);
            out.positions.push(p);
            out.uv_sets[0].push(uv);
        }
        out.triangles.push([base, base + 1, base + 2]);
        out.material_of.push(0);
    }
    out
}

/// An image of `size` texels, each of what `color` says of its place in 0 to 1.
fn image(size: u32, color: impl Fn(f32, f32) -> [u8; 3]) -> Image {
    let at = |i: u32| (i as f32 + 0.5) / size as f32;
    let bytes: Vec<u8> = (0..size * size).flat_map(|i| color(at(i % size), at(i / size))).collect();
    Image::new(size, size, TexelFormat::Rgb8, Arc::new(bytes))
}

fn baked(soup: Soup, image: Image, mode: ChartMode, cluster_triangles: usize) -> (Model, BakeReport) {
    baked_before(soup, image, mode, cluster_triangles, &Outside::nothing())
}

/// The same while `outside` looks on.
fn baked_before(
    soup: Soup,
    image: Image,
    mode: ChartMode,
    cluster_triangles: usize,
    outside: &Outside,
) -> (Model, BakeReport) {
    let count = soup.triangles.len() as u64;
    let (mesh, _) = repair(soup, &RepairOptions::default()).expect("a sound mesh");
    let mut material = Material::default();
    material.textures[Slot::BaseColor as usize] = Some(TextureRef::plain(0));
    let textures = TextureInput {
        materials: &[material],
        images: &[Some(image)],
        charts: ChartOptions { mode, tile_size: 512, charter: None },
        texels: TexelOptions::default(),
    };
    let options = BakeOptions { levels: LEVELS, cluster_triangles: Some(cluster_triangles), ..BakeOptions::default() };
    let (model, report) = bake_textured(mesh, Some(&textures), count, &options, outside).expect("options in range");
    (opened(&model), report)
}

/// Through a file in memory.
fn opened(model: &BakedModel) -> Model {
    let storage = MemoryStorage::default();
    let writer = Writer::with_storage(storage.clone(), Path::new("textured.pb"), SCHEME).expect("in memory");
    write_model(writer, model).expect("in memory");
    Model::from_bytes(Path::new("textured.pb"), &storage.to_vec()).expect("sound")
}

/// Without images, with a normal map; `paint` gives vertices their colours.
fn baked_with_normals(mut soup: Soup, paint: Option<[u8; 4]>) -> Model {
    let count = soup.triangles.len();
    soup.colors = paint.map_or(Vec::new(), |c| vec![c; soup.positions.len()]);
    let (mut mesh, _) = repair(soup, &RepairOptions::default()).expect("a sound mesh");
    mesh.texturing = Some(Texturing::plain(mesh.triangles.len()));
    let textures = TextureInput {
        materials: &[],
        images: &[],
        charts: ChartOptions { mode: ChartMode::Best, tile_size: 4096, charter: None },
        texels: TexelOptions { normal_space: NormalSpace::Object, ..TexelOptions::default() },
    };
    let options = BakeOptions { levels: LEVELS, cluster_triangles: Some(4096), ..BakeOptions::default() };
    let baked = bake_textured(mesh, Some(&textures), count as u64, &options, &Outside::nothing());
    opened(&baked.expect("options in range").0)
}

#[test]
fn progress_goes_through_all_stages_and_texels_are_known_after_the_charts() {
    let told = Mutex::new((Vec::new(), None));
    let progress = |stage, share| told.lock().unwrap().0.push((stage, share));
    let texel_work = |work| {
        let mut told = told.lock().unwrap();
        let last = told.0.last().copied();
        assert!(told.1.replace((work, last)).is_none(), "told once");
    };
    let outside = Outside { progress: &progress, texel_work: &texel_work, ..Outside::nothing() };
    let soup = islands(hills(64), 3, 0.1);
    let image = image(256, |u, _| [(u * 255.0) as u8; 3]);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let (_, report) = one.install(|| baked_before(soup, image, ChartMode::Source, 1024, &outside));
    let (told, work) = told.into_inner().unwrap();
    let (work, last) = work.expect("told");
    assert_eq!(last, Some((Stage::Charts, 1.0)));
    let charts = report.charts.expect("textured");
    assert_eq!(work.tile_texels, charts.texels);
    let covered = charts.fill * charts.texels as f64;
    assert!((covered..covered * 1.5).contains(&(work.packed_texels as f64)), "{covered} {work:?}");
    assert!(told.is_sorted_by(|a, b| a.0 < b.0 || a.0 == b.0 && a.1 <= b.1), "{told:?}");
    for stage in [Stage::Charts, Stage::Measure, Stage::Textures] {
        let own = || told.iter().filter(|t| t.0 == stage);
        assert_eq!(own().next_back(), Some(&(stage, 1.0)));
        let step = own().zip(own().skip(1)).map(|(a, b)| b.1 - a.1).fold(0.0, f32::max);
        assert!(step < 0.3, "{stage:?} jumps by {step}");
    }
}

/// A cluster with the decoded mips of its first map.
struct Tile {
    vertices: Vec<Vertex>,
    indices: Vec<Vec<u16>>,
    /// Side and texels, finest first.
    mips: Vec<(u32, Vec<[u8; 4]>)>,
}

impl Tile {
    fn read(model: &Model, cluster: u32) -> Tile {
        let textures = model.textures().expect("textured");
        let prefix = model.read_prefix(cluster, 0).expect("sound");
        let indices = (0..LEVELS).map(|i| model.read_prefix(cluster, i).expect("sound").indices).collect();
        let mut mips = Vec::new();
        for level in 0..LEVELS {
            let bytes = model.read_texture(model.texture_chunk_id(cluster, level)).expect("sound");
            for place in textures.mips(cluster, level).filter(|m| m.map == 0) {
                let block = &bytes[place.offset as usize..][..place.bytes as usize];
                match decode(BlockFormat::Bc7, block, place.side).expect("whole blocks") {
                    Texels::Rgba8(texels) => mips.push((place.side, texels)),
                    _ => panic!("BC7 decodes to RGBA8"),
                }
            }
        }
        mips.sort_by_key(|m| std::cmp::Reverse(m.0));
        Tile { vertices: prefix.vertices, indices, mips }
    }

    /// Bilinear, clamped to the tile, in the encoding of the texels.
    fn sample(&self, mip: usize, uv: [f32; 2]) -> [f32; 3] {
        let (side, texels) = &self.mips[mip];
        let at = uv.map(|x| (x / 65_536.0 * *side as f32).clamp(0.5, *side as f32 - 0.5) - 0.5);
        let [x, y] = at.map(|x| (x as u32).min(side - 2));
        let [fx, fy] = [at[0] - x as f32, at[1] - y as f32];
        let texel = |x: u32, y: u32| texels[(y * side + x) as usize];
        std::array::from_fn(|k| {
            let row = |y: u32| f32::from(texel(x, y)[k]) * (1.0 - fx) + f32::from(texel(x + 1, y)[k]) * fx;
            row(y) * (1.0 - fy) + row(y + 1) * fy
        })
    }
}

/// Random points on a triangle: weights of its corners.
fn weights(random: &mut Random) -> [f32; 3] {
    let (a, b) = (random.next() as f32, random.next() as f32);
    let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
    [1.0 - a - b, a, b]
}

/// Red, green, blue and their mixtures: fields differ from their neighbours in every channel that they can.
fn loud(field: [u32; 2]) -> [u8; 3] {
    let n = field[0] * 3 + field[1] * 5;
    [n & 1, n >> 1 & 1, n >> 2 & 1].map(|bit| if bit == 1 { 255 } else { 0 })
}

/// The largest difference of any sample from its island's colour, over all mips at least `least_side` wide.
fn bleeding(model: &Model, across: u32, least_side: u32) -> f32 {
    let mut random = Random(7);
    let mut worst = 0f32;
    for cluster in 0..model.record().clusters {
        let tile = Tile::read(model, cluster);
        for indices in &tile.indices {
            for t in indices.chunks_exact(3) {
                let corners = [0, 1, 2].map(|k| tile.vertices[t[k] as usize]);
                let places = corners.map(|v| model.world(model.grid(cluster, &v)));
                // Corners of one island share a field; a corner on its edge may be counted to the next one.
                let middle = (places[0] + places[1] + places[2]) / 3.0;
                let field = [middle.x, middle.y].map(|x| (x * f64::from(across)) as u32);
                let color = loud(field).map(f32::from);
                for _ in 0..4 {
                    let w = weights(&mut random);
                    let uv = [0, 1].map(|k| (0..3).map(|i| w[i] * f32::from(corners[i].uv()[k])).sum::<f32>());
                    for mip in 0..tile.mips.len() {
                        if tile.mips[mip].0 >= least_side {
                            let found = tile.sample(mip, uv);
                            worst = (0..3).map(|k| (found[k] - color[k]).abs()).fold(worst, f32::max);
                        }
                    }
                }
            }
        }
    }
    worst
}

/// The charts of the hills under an even image, vertices coloured by their x and that of the triangle's middle.
fn charts_with_colors(color: impl Fn(f64, f64) -> [u8; 4]) -> u64 {
    let mut soup = hills(24);
    let whole = std::mem::take(&mut soup.triangles);
    let (places, mut out) = (soup.positions, Soup { uv_sets: vec![Vec::new()], ..Soup::default() });
    for t in whole {
        let corners = t.map(|v| places[v as usize]);
        let middle = corners.iter().map(|p| p[0]).sum::<f64>() / 3.0;
        let first = out.positions.len() as u32;
        for p in corners {
            out.positions.push(p);
            out.uv_sets[0].push([p[0] as f32, p[1] as f32]);
            out.colors.push(color(p[0], middle));
        }
        out.triangles.push([first, first + 1, first + 2]);
        out.material_of.push(0);
    }
    let (_, report) = baked(out, image(16, |_, _| [255; 3]), ChartMode::Best, 16_384);
    report.charts.expect("textured").charts
}

#[test]
fn charts_end_where_the_colours_of_vertices_jump_and_only_there() {
    let even = charts_with_colors(|_, _| [255; 4]);
    let gradual = charts_with_colors(|x, _| [(x * 255.0) as u8, 90, 0, 255]);
    let jump = charts_with_colors(|_, middle| if middle < 0.3 { [255, 0, 0, 255] } else { [0, 0, 255, 255] });
    assert_eq!(gradual, even);
    assert!(jump > even, "{jump} charts, {even} without a jump");
}

/// A map of halves on the hills, `size` texels wide: its format in the archive.
fn format_of_bright_image(size: u32) -> Option<MapFormat> {
    let texel = |i: u32| [0x3c00 + (i % 512) as u16, 0x4200, 0x3800];
    let bytes: Vec<u8> = (0..size * size).flat_map(texel).flat_map(u16::to_le_bytes).collect();
    let bright = Image::new(size, size, TexelFormat::RgbF16, Arc::new(bytes));
    let mut soup = hills(24);
    soup.uv_sets = vec![soup.positions.iter().map(|p| [p[0] as f32, p[1] as f32]).collect()];
    soup.material_of = vec![0; soup.triangles.len()];
    let (model, _) = baked(soup, bright, ChartMode::Source, 16_384);
    model.textures().expect("textured").maps[0].format()
}

#[test]
fn few_bright_texels_stay_halves_and_many_become_blocks() {
    assert_eq!(format_of_bright_image(64), Some(MapFormat::RgbaF16));
    // Four clusters with tiles of 512 x 512.
    assert_eq!(format_of_bright_image(900), Some(MapFormat::Bc6h));
}

#[test]
fn loud_islands_show_only_their_own_colour_at_every_level_and_mip() {
    for mode in [ChartMode::Source, ChartMode::Best] {
        let across = 3;
        let field = move |u: f32, v: f32| [u, v].map(|x| (x * across as f32) as u32);
        let image = image(256, |u, v| loud(field(u, v)));
        let soup = islands(hills(96), across, 0.1);
        let (model, report) = baked(soup, image, mode, 16_384);
        assert_eq!(report.charts.expect("textured").auto_clusters, 0);
        let worst = bleeding(&model, across, 32);
        assert!(worst <= 8.0, "{mode:?}: {worst} of 255 from the colour of its chart");
    }
}

#[test]
fn no_triangle_is_turned_over_in_its_texture_coordinates_at_any_level() {
    for (mode, across) in [(ChartMode::Source, 6), (ChartMode::Auto, 6), (ChartMode::Best, 48)] {
        let soup = islands(hills(96), across, 0.05);
        let (model, report) = baked(soup, image(512, |u, v| [(u * 255.0) as u8, (v * 255.0) as u8, 0]), mode, 2048);
        assert!(model.record().clusters > 4);
        let summary = verify(&model).unwrap_or_else(|b| panic!("{mode:?} {across}: {}", b[0]));
        assert!(summary.triangles[4] < summary.triangles[0] / 8, "{mode:?} {across}: {:?}", summary.triangles);
        let charts = report.charts.expect("textured");
        assert_eq!(charts.source_clusters > 0, mode == ChartMode::Source, "{charts:?}");
    }
}

#[test]
fn thousands_of_islands_get_new_charts_and_coarse_levels_and_keep_their_colours() {
    // 2,304 islands on 18,432 triangles; with the source's seams hardly a vertex could go.
    let across = 48;
    let shade = |u: f32, v: f32| [(u * 255.0) as u8, (v * 255.0) as u8, 0];
    let (model, report) = baked(islands(hills(96), across, 0.05), image(1024, shade), ChartMode::Best, 16_384);
    let charts = report.charts.expect("textured");
    assert_eq!((charts.source_clusters, charts.reasons[0].0.as_str()), (0, "fragmented"));
    let summary = verify(&model).unwrap_or_else(|b| panic!("{}", b[0]));
    assert!(summary.triangles[4] < summary.triangles[0] / 100, "{:?}", summary.triangles);
    let mut random = Random(5);
    let (mut sum, mut count) = (0.0, 0.0);
    for cluster in 0..model.record().clusters {
        let tile = Tile::read(&model, cluster);
        for t in tile.indices[0].chunks_exact(3) {
            let corners = [0, 1, 2].map(|k| tile.vertices[t[k] as usize]);
            let w = weights(&mut random);
            let uv = [0, 1].map(|k| (0..3).map(|i| w[i] * f32::from(corners[i].uv()[k])).sum::<f32>());
            let places = (0..3).map(|i| model.world(model.grid(cluster, &corners[i])) * f64::from(w[i]));
            let place = places.reduce(|a, b| a + b).expect("three");
            let found = tile.sample(0, uv);
            sum += (0..2).map(|k| (f64::from(found[k]) - place[k] * 255.0).abs()).fold(0.0, f64::max);
            count += 1.0;
        }
    }
    // An island's margin shifts its colours by up to 0.05 / 48 of the image; 8-bit steps come on top.
    assert!(sum / count < 1.0, "mean {:.2} of 255", sum / count);
}

#[test]
fn colours_stay_where_they_belong_on_the_surface_at_every_level() {
    // Colour is a smooth function of the place on the ground, so every level can be asked for it.
    // The image has a margin, because it repeats beyond its border.
    let shade = |u: f32| ((u - 0.05) / 0.9 * 255.0) as u8;
    let image = image(1024, |u, v| [shade(u), shade(v), (128.0 + 100.0 * (u * 25.0).sin()) as u8]);
    for mode in [ChartMode::Source, ChartMode::Auto] {
        let mut soup = hills(128);
        soup.uv_sets = vec![soup.positions.iter().map(|p| [p[0], p[1]].map(|x| 0.05 + 0.9 * x as f32)).collect()];
        soup.material_of = vec![0; soup.triangles.len()];
        let (model, _) = baked(soup, image.clone(), mode, 4096);
        let mut random = Random(99);
        let (mut sum, mut count, mut worst) = (0.0, 0.0, 0f32);
        for cluster in 0..model.record().clusters {
            let tile = Tile::read(&model, cluster);
            for (level, indices) in tile.indices.iter().enumerate() {
                for t in indices.chunks_exact(3) {
                    let corners = [0, 1, 2].map(|k| tile.vertices[t[k] as usize]);
                    let w = weights(&mut random);
                    let uv = [0, 1].map(|k| (0..3).map(|i| w[i] * f32::from(corners[i].uv()[k])).sum::<f32>());
                    let place = (0..3).map(|i| model.world(model.grid(cluster, &corners[i])) * f64::from(w[i]));
                    let place = place.reduce(|a, b| a + b).expect("three");
                    let found = tile.sample(level.min(2), uv);
                    let wanted = [place.x, place.y].map(|x| x as f32 * 255.0);
                    let off = (0..2).map(|k| (found[k] - wanted[k]).abs()).fold(0.0, f32::max);
                    (sum, count, worst) = (sum + f64::from(off), count + 1.0, worst.max(off));
                }
            }
        }
        assert!(sum / count < 1.5 && worst < 30.0, "{mode:?}: mean {:.2}, worst {worst:.1} of 255", sum / count);
    }
}

/// Per level: how far light from the side is off on average, by the normals of the vertices and by those of the map.
fn light_off(model: &Model) -> Vec<[f64; 2]> {
    let sun = DVec3::new(0.6, 0.5, 0.62).normalize();
    let truth = |at: DVec3| {
        let slope = |d: f64, e: f64| (height(at.x + d, at.y + e) - height(at.x - d, at.y - e)) / 2e-4;
        DVec3::new(-slope(1e-4, 0.0), -slope(0.0, 1e-4), 1.0).normalize()
    };
    let mut random = Random(5);
    let mut sums = vec![[0.0; 3]; LEVELS as usize];
    for cluster in 0..model.record().clusters {
        let tile = Tile::read(model, cluster);
        for (level, indices) in tile.indices.iter().enumerate() {
            for t in indices.chunks_exact(3) {
                let corners = [0, 1, 2].map(|k| tile.vertices[t[k] as usize]);
                let places = corners.map(|v| model.world(model.grid(cluster, &v)));
                let area = (places[1] - places[0]).cross(places[2] - places[0]).length();
                for _ in 0..4 {
                    let w = weights(&mut random);
                    let mix = |of: &dyn Fn(usize) -> DVec3| (0..3).map(|i| of(i) * f64::from(w[i])).sum::<DVec3>();
                    let uv = [0, 1].map(|k| (0..3).map(|i| w[i] * f32::from(corners[i].uv()[k])).sum::<f32>());
                    let stored = DVec3::from(tile.sample(0, uv).map(|c| f64::from(c) / 127.5 - 1.0)).normalize();
                    let vertices = mix(&|i| DVec3::from(corners[i].normal().map(f64::from))).normalize();
                    let light = |n: DVec3| n.dot(sun).max(0.0);
                    let wanted = light(truth(mix(&|i| places[i])));
                    let sum = &mut sums[level];
                    sum[0] += area * (light(vertices) - wanted).abs();
                    sum[1] += area * (light(stored) - wanted).abs();
                    sum[2] += area;
                }
            }
        }
    }
    sums.iter().map(|s| [s[0] / s[2], s[1] / s[2]]).collect()
}

#[test]
fn coarse_levels_are_lit_like_the_finest_by_its_normals() {
    let model = baked_with_normals(hills(128), None);
    verify(&model).unwrap_or_else(|b| panic!("{}", b[0]));
    let normals = MapRecord::new(MapKind::Normal, MapFormat::Bc7Linear);
    assert_eq!(model.textures().expect("tiles").maps, [normals], "no colour, so surfaces stay as they are without");
    let off = light_off(&model);
    for level in 2..LEVELS as usize {
        let [vertices, map] = off[level];
        assert!(map < 0.5 * vertices, "level {level}: {off:.4?}");
    }
    assert!(off[0][1] < 1.4 * off[0][0], "{off:.4?}");
}

#[test]
fn a_normal_map_beside_one_colour_costs_that_colour_one_block() {
    let model = baked_with_normals(hills(64), Some([200, 100, 50, 255]));
    verify(&model).unwrap_or_else(|b| panic!("{}", b[0]));
    let textures = model.textures().expect("tiles");
    let maps = [(MapKind::BaseColor, MapFormat::Bc7Srgb), (MapKind::Normal, MapFormat::Bc7Linear)];
    assert_eq!(textures.maps, maps.map(|(kind, format)| MapRecord::new(kind, format)));
    for tile in textures.tiles {
        assert!(tile.size_log2 > 5 && tile.first[..2] == [tile.size_log2 - 2, 0], "{tile:?}");
    }
    let tile = Tile::read(&model, 0);
    assert!(tile.mips[0].1.iter().all(|t| t[..3].iter().zip([200u8, 100, 50]).all(|(a, b)| a.abs_diff(b) <= 2)));
}
