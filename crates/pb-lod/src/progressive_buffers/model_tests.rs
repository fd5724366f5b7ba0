//! What `Model` refuses, and what it hands out.

use super::baked_torus::{archive, baked, open, torus};
use super::instances::{InstanceRecord, ObjectRecord, Placement};
use super::layout::*;
use super::model::{FLAG_COLORS, FLAG_INSTANCES, Model};
use super::write::BakedModel;
use crate::plan::ChunkId;
use std::path::Path;

type Damage = fn(&mut BakedModel);

#[test]
fn tables_that_contradict_one_another_are_refused_with_the_place() {
    let damages: &[(Damage, &str)] = &[
        (|m| m.record.levels = 0, "number of levels"),
        (|m| m.record.levels = 13, "number of levels"),
        (|m| m.record.origin[1] = f64::NAN, "origin is not finite"),
        (|m| m.record.quantum = 0.001, "quantum is not a power of two"),
        (|m| m.record.quantum = -1.0, "quantum is not a power of two"),
        (|m| m.record.quantum = 0.0, "quantum is not a power of two"),
        (|m| m.record.quantum = f64::INFINITY, "quantum is not a power of two"),
        (|m| m.record.bounds_min[2] = m.record.bounds_max[2] + 1, "bounds are empty"),
        (|m| m.record.bounds_max[2] = i32::MAX, "beyond 2^30"),
        (|m| m.clusters[3].origin[0] = i32::MIN, "cluster 3: its origin or centre"),
        (|m| m.clusters[3].center[0] = i32::MIN, "cluster 3: its origin or centre"),
        (|m| m.nodes[3].center[1] = i32::MIN, "hierarchy node 3: its centre"),
        (|m| m.record.flags = 16, "reserved bits"),
        (|m| m.record.flags = 8, "section \"OBJT\" is missing"),
        (|m| m.record.flags = 4, "cut-outs but no textures"),
        (|m| m.record.flags = 2, "section \"TMAP\" is missing"),
        (|m| m.clusters.truncate(8), "the cluster table: it has 8 entries instead of 9"),
        (|m| m.levels.truncate(17), "the level table: it has 17 entries"),
        (|m| m.model_levels.truncate(1), "the model level table"),
        (|m| m.nodes.truncate(16), "the hierarchy: it has 16 entries"),
        (|m| m.neighbours.truncate(35), "cluster 8: its neighbours run past"),
        (|m| m.neighbours.push(0), "belong to nobody"),
        (|m| m.neighbours[5] = 9, "cluster 1: a neighbour does not exist"),
        (|m| m.neighbours[5] = 1, "cluster 1: it is its own neighbour"),
        (|m| m.clusters[3].neighbours_first = 0, "cluster 3: its neighbours do not follow"),
        (|m| m.clusters[3].neighbours_count = 256, "cluster 3: it has more than 255"),
        (|m| m.clusters[3].shift = 16, "cluster 3: the shift"),
        (|m| m.clusters[3].radius = f32::NAN, "cluster 3: the radius"),
        (|m| m.clusters[3].reserved[1] = 1, "cluster 3: reserved"),
        (|m| m.levels[4].vertices = 0, "cluster 2 level 0: the vertices"),
        (|m| m.levels[4].vertices = 65_536, "cluster 2 level 0: the vertices"),
        (|m| m.levels[4].triangles = u32::MAX, "cluster 2 level 0: it has more than 2^20"),
        (|m| m.levels[4].triangles += 2, "cluster 2 level 0: the decoded size"),
        (|m| m.levels[5].vertices = 26, "cluster 2 level 0: the next coarser level has more"),
        (|m| m.levels[5].error = -1.0, "cluster 2 level 1: error or acmr"),
        (|m| m.levels[5].acmr = f32::INFINITY, "cluster 2 level 1: error or acmr"),
        (|m| m.model_levels[1].triangles += 1, "model level 1: its triangles"),
        (|m| m.model_levels[1].vertices = 0, "model level 1: it has more positions"),
        (|m| m.model_levels[1].rms_error = f64::NAN, "model level 1: an error"),
        (|m| m.nodes[0].left = 0, "hierarchy node 0: a child does not come behind it"),
        (|m| m.nodes[0].right = m.nodes[0].left, "hierarchy node 0: a child"),
        (|m| m.nodes[0].right = 17, "hierarchy node 0: a child"),
        (|m| m.nodes[0].first_cluster = 1, "hierarchy node 0: its children do not cover"),
        (|m| m.nodes[0].cluster_count = 1, "hierarchy node 0: one cluster, but it has children"),
        (|m| m.nodes[0].cluster_count = u32::MAX, "hierarchy node 0: its children do not cover"),
        (|m| m.nodes[1].radius = f32::INFINITY, "hierarchy node 1: a number in it"),
        (|m| m.nodes[1].error = -0.5, "hierarchy node 1: a number in it"),
    ];
    for (i, (damage, message)) in damages.iter().enumerate() {
        let mut model = baked(&torus(3, 2));
        damage(&mut model);
        let text = Model::from_bytes(Path::new("torus.pb"), &written(&model)).err();
        let text = text.unwrap_or_else(|| panic!("{i}: {message}")).to_string();
        assert!(text.starts_with("torus.pb: ") && text.contains(message), "{message}: {text}");
    }
}

/// Writes a model as it is, without using its counts.
fn written(model: &BakedModel) -> Vec<u8> {
    use super::write::CHUNK_CODEC;
    use pb_archive::{MemoryStorage, Writer};
    let storage = MemoryStorage::default();
    let mut writer = Writer::with_storage(storage.clone(), Path::new("torus.pb"), SCHEME).unwrap();
    writer.require(CHUNK_CODEC);
    for (id, chunk) in model.chunks.iter().enumerate() {
        writer.put_chunk(id as u32, &chunk.bytes.read().unwrap(), chunk.decoded_bytes).unwrap();
    }
    writer.add_section(MODEL, &[model.record]).unwrap();
    writer.add_section(CLUSTERS, &model.clusters).unwrap();
    writer.add_section(LEVELS, &model.levels).unwrap();
    writer.add_section(NEIGHBOURS, &model.neighbours).unwrap();
    writer.add_section(NODES, &model.nodes).unwrap();
    writer.add_section(MODEL_LEVELS, &model.model_levels).unwrap();
    writer.finish().unwrap();
    storage.to_vec()
}

#[test]
fn an_archive_of_another_scheme_is_refused_by_its_tag() {
    use pb_archive::{MemoryStorage, Writer};
    let storage = MemoryStorage::default();
    Writer::with_storage(storage.clone(), Path::new("x.pb"), *b"CLOD").unwrap().finish().unwrap();
    let text = Model::from_bytes(Path::new("x.pb"), &storage.to_vec()).err().unwrap().to_string();
    assert!(text.contains("\"CLOD\"") && text.contains("\"PBUF\""), "{text}");
}

#[test]
fn a_chunk_whose_vertices_leave_the_bounds_or_the_neighbour_list_is_refused() {
    let mut model = baked(&torus(3, 2));
    model.record.bounds_max[0] -= 1;
    let found = open(&model).unwrap();
    let refused = (0..18).filter_map(|c| found.read_chunk(ChunkId(c)).err()).map(|e| e.to_string());
    assert!(refused.into_iter().all(|e| e.contains("outside the model's bounds")));
    let mut model = baked(&torus(3, 2));
    model.clusters[8].neighbours_count -= 1;
    model.neighbours.pop();
    let text = open(&model).unwrap().read_chunk(ChunkId(16)).err().unwrap().to_string();
    assert!(text.contains("cluster 8 level 0 (chunk 16)") && text.contains("border slot 4"), "{text}");
}

#[test]
fn textures_come_back_as_they_were_written() {
    let torus = torus(3, 3).with_textures(7, 0.5);
    let model = open(&baked(&torus)).unwrap();
    let textures = model.textures().expect("it has some");
    assert_eq!((textures.maps, textures.tiles, model.chunk_count()), (&*torus.maps, &*torus.tiles, 54));
    for (cluster, level, bytes) in [(0, 0, 128 * 128), (8, 1, 64 * 64), (4, 2, 32 * 32 + 16 * 16 + 8 * 8 + 4 * 4)] {
        let chunk = model.texture_chunk_id(cluster, level);
        assert_eq!((model.is_texture(chunk), model.chunk_place(chunk)), (true, (cluster, level)));
        let read = model.read_texture(chunk).unwrap();
        assert!(read.len() == bytes && read.iter().enumerate().all(|(i, &b)| b == (i as u32 + cluster) as u8));
    }
    assert_eq!(model.needs(model.texture_chunk_id(2, 0)), Some(model.texture_chunk_id(2, 1)));
    assert_eq!(model.needs(model.texture_chunk_id(2, 1)), None, "the tail is always there");
}

#[test]
#[allow(clippy::type_complexity)] // a table of damages
fn textures_that_contradict_the_tables_are_refused_with_the_place() {
    let damages: &[(fn(&mut BakedModel), &str)] = &[
        (|m| m.maps[0].format = 8, "the map table: a kind or format is not known"),
        (|m| m.maps.push(m.maps[0]), "the map table: the maps are not in the order"),
        (|m| m.tiles.truncate(8), "the tile table: it has not one entry per cluster"),
        (|m| m.tiles[3].size_log2 = 13, "the tile of cluster 3: the tile is not 4 to 4096"),
        (|m| m.tiles[3].size_log2 = 6, "the textures of cluster 3 level 0: the decoded size"),
        (|m| m.tiles[3].first[0] = 6, "the tile of cluster 3: a map begins after the last mip"),
        (|m| m.tiles[3].first[1] = 1, "the tile of cluster 3: a map that does not exist"),
        (|m| m.tiles[3].texel = 0.0, "the tile of cluster 3: the size of its texels"),
        (|m| m.record.flags |= FLAG_COLORS, "both textures and vertex colours"),
    ];
    for (damage, message) in damages {
        let mut model = baked(&torus(3, 3).with_textures(7, 0.5));
        damage(&mut model);
        let text = open(&model).err().unwrap_or_else(|| panic!("{message}")).to_string();
        assert!(text.contains(message), "{message}: {text}");
    }
    let mut model = baked(&torus(3, 3).with_textures(7, 0.5));
    let bytes = model.chunks[27].bytes.read().unwrap()[1..].to_vec();
    model.chunks[27].bytes = bytes.into();
    let model = open(&model).unwrap();
    let text = model.read_texture(ChunkId(27)).expect_err("too short").to_string();
    assert!(text.contains("16383 bytes of texels instead of 16384"), "{text}");
}

/// A torus that stands twice.
fn crowded() -> BakedModel {
    let mut model = baked(&torus(3, 2));
    model.record.flags |= FLAG_INSTANCES;
    model.objects = vec![ObjectRecord {
        first_cluster: 0,
        cluster_count: 9,
        node: 0,
        first_instance: 0,
        instance_count: 2,
        reserved: 0,
    }];
    let moved = Placement { translation: glam::DVec3::X * 64.0, scale: 0.5, ..Placement::IDENTITY };
    model.instances = [Placement::IDENTITY, moved].iter().map(InstanceRecord::new).collect();
    model
}

#[test]
fn instances_come_back_as_they_were_written_and_an_older_reader_refuses_them_by_name() {
    let model = crowded();
    let found = open(&model).unwrap();
    let instances = found.instances().unwrap();
    assert_eq!((instances.objects, instances.instances), (&*model.objects, &*model.instances));
    let [low, high] = found.world_bounds();
    let of_one = found.record().bounds_max.map(|x| f64::from(x) / 1024.0);
    assert!(low.distance(found.world(found.record().bounds_min)) < 1e-9, "{low}");
    assert!((high.x - (64.0 + 0.5 * of_one[0])).abs() < 1e-9 && high.y == of_one[1], "{high}");
    let older = (1 << 0) | (1 << 1);
    let refused = pb_archive::Archive::from_bytes(Path::new("torus.pb"), &archive(&model), older);
    let text = refused.err().expect("bit 2 is not known").to_string();
    assert!(text.contains("instances"), "{text}");
}

#[test]
fn instances_that_contradict_the_tables_or_stand_nowhere_are_refused_with_the_place() {
    let damages: &[(Damage, &str)] = &[
        (|m| m.objects[0].cluster_count = 8, "object 0: its node has not its clusters"),
        (
            |m| (m.objects[0].cluster_count, m.objects[0].node) = (m.nodes[1].cluster_count, 1),
            "the objects: they have 4",
        ),
        (|m| m.objects[0].node = 17, "object 0: its node has not"),
        (|m| m.objects[0].first_cluster = 1, "object 0: it does not begin"),
        (|m| m.objects[0].instance_count = u32::MAX, "the objects: they have 9 clusters and 4294967295 instances"),
        (|m| m.objects[0].instance_count = 0, "object 0: it has no clusters or no instances"),
        (|m| m.objects[0].reserved = 1, "reserved bytes"),
        (|m| m.instances.truncate(1), "the objects: they have 9 clusters and 2 instances"),
        (|m| m.instances[1].scale = 0.0, "instance 1: its scale"),
        (|m| m.instances[1].scale = f64::NAN, "instance 1: its scale"),
        (|m| m.instances[1].scale = -1.0, "instance 1: its scale"),
        (|m| m.instances[1].translation[2] = f64::INFINITY, "instance 1: its place"),
        (|m| m.instances[1].translation[2] = f64::NAN, "instance 1: its place"),
        (|m| m.instances[0].rotation = [0.0; 4], "instance 0: its rotation"),
        (|m| m.instances[0].rotation[3] = f64::NAN, "instance 0: its rotation"),
    ];
    for (damage, message) in damages {
        let mut model = crowded();
        damage(&mut model);
        let text = open(&model).err().unwrap_or_else(|| panic!("{message}")).to_string();
        assert!(text.starts_with("torus.pb: ") && text.contains(message), "{message}: {text}");
    }
    // A border between two objects.
    let mut model = crowded();
    let (left, right) = (model.nodes[0].left, model.nodes[0].right);
    let part = |node: u32, first: u32| {
        let n = &model.nodes[node as usize];
        ObjectRecord {
            first_cluster: n.first_cluster,
            cluster_count: n.cluster_count,
            node,
            first_instance: first,
            instance_count: 1,
            reserved: 0,
        }
    };
    model.objects = vec![part(left, 0), part(right, 1)];
    let text = open(&model).err().expect("a border between objects").to_string();
    assert!(text.contains("a neighbour in another object"), "{text}");
}

#[test]
fn prefixes_are_the_chunks_in_order() {
    let torus = torus(3, 4);
    let model = open(&baked(&torus)).unwrap();
    for (cluster, level) in [(0, 0), (4, 2), (8, 3)] {
        let prefix = model.read_prefix(cluster, level).unwrap();
        let count = model.level(cluster, level).vertices as usize;
        assert_eq!(prefix.vertices, torus.vertices[cluster as usize][..count]);
        assert_eq!(prefix.indices.len(), model.level(cluster, level).triangles as usize * 3);
        let chunk = model.chunk_id(cluster, level);
        assert_eq!(model.chunk_place(chunk), (cluster, level));
        assert_eq!(model.coarser(chunk), (level < 3).then_some(ChunkId(chunk.0 + 1)));
    }
}

#[test]
fn an_exported_level_is_welded_and_closed() {
    let mut model = baked(&torus(3, 4));
    model.record.flags = FLAG_COLORS;
    model.record.origin = [500_000.0, 4_500_000.0, 100.0];
    let model = open(&model).unwrap();
    for (level, record) in model.model_levels().iter().enumerate() {
        let mesh = model.export_level(level as u32).unwrap();
        assert_eq!((mesh.positions.len() as u64, mesh.triangles.len() as u64), (record.vertices, record.triangles));
        let mut edges: Vec<(u32, u32)> =
            mesh.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
        edges.sort_unstable();
        assert!(edges.iter().all(|&(a, b)| edges.binary_search(&(b, a)).is_ok()));
        assert_eq!(mesh.colors.unwrap().len(), mesh.positions.len());
        assert!(mesh.normals.iter().all(|n| (n[2] - 1.0).abs() < 1e-3));
    }
    let corner = model.world(model.record().bounds_max).to_array();
    let mesh = model.export_level(0).unwrap();
    assert!(mesh.positions.iter().any(|p| p[0] == corner[0]));
}

#[test]
fn an_archive_cut_anywhere_is_refused() {
    let bytes = archive(&baked(&torus(3, 2)));
    for length in (0..bytes.len()).step_by(13) {
        assert!(Model::from_bytes(Path::new("cut.pb"), &bytes[..length]).is_err(), "{length}");
    }
}
