//! One cluster: its sphere (I4), its triangles and edges (I6), and what the tables say of both.

use super::shared::{Shared, clusters};
use super::{Breach, Promise, distance, position};
use crate::progressive_buffers::layout::Vertex;
use crate::progressive_buffers::model::{Model, ModelError};
use pb_mesh::charts::tile_area2;

/// All levels of one cluster.
pub(super) struct Decoded {
    /// Vertices of level 0, coarsest first.
    pub vertices: Vec<Vertex>,
    /// Their grid positions.
    pub grid: Vec<[i32; 3]>,
    /// Index buffer per level.
    pub indices: Vec<Vec<u16>>,
}

impl Decoded {
    pub fn read(model: &Model, cluster: u32) -> Result<Self, ModelError> {
        let mut vertices = Vec::with_capacity(model.level(cluster, 0).vertices as usize);
        let mut indices = vec![Vec::new(); model.levels() as usize];
        for level in (0..model.levels()).rev() {
            let chunk = model.read_chunk(model.chunk_id(cluster, level))?;
            vertices.extend(chunk.vertices);
            indices[level as usize] = chunk.indices;
        }
        let grid = vertices.iter().map(|v| model.grid(cluster, v)).collect();
        Ok(Self { vertices, grid, indices })
    }
}

/// What one cluster was found to hold, and what is wrong with it.
#[derive(Default)]
pub(super) struct ClusterReport {
    pub breaches: Vec<Breach>,
    pub levels: Vec<LevelReport>,
}

/// One level of one cluster or of the whole model.
#[derive(Clone, Debug, Default)]
pub(super) struct LevelReport {
    /// Distinct positions that triangles use; those of other clusters too are listed in `shared_used` until `finish`.
    pub used_positions: u64,
    /// Directed edges without an opposite.
    pub open_edges: u64,
    /// Where the first of them starts.
    pub open_example: Option<[i32; 3]>,
    /// How often the most frequent directed edge occurs.
    pub most_repeated: u64,
    shared_used: Vec<u32>,
    /// Edges between two positions of several clusters, as (group, group, start).
    shared_edges: Vec<(u32, u32, [i32; 3])>,
}

impl LevelReport {
    /// Adds a cluster's level to the model's.
    pub fn add(&mut self, other: LevelReport) {
        self.used_positions += other.used_positions;
        self.open_edges += other.open_edges;
        self.open_example = self.open_example.or(other.open_example);
        self.most_repeated = self.most_repeated.max(other.most_repeated);
        self.shared_used.extend(other.shared_used);
        self.shared_edges.extend(other.shared_edges);
    }

    /// Settles what several clusters share.
    pub fn finish(&mut self) {
        self.shared_used.sort_unstable();
        self.shared_used.dedup();
        self.used_positions += self.shared_used.len() as u64;
        let edges = std::mem::take(&mut self.shared_edges);
        self.match_edges(edges);
    }

    /// Counts edges and looks for their opposites.
    fn match_edges(&mut self, mut edges: Vec<(u32, u32, [i32; 3])>) {
        edges.sort_unstable();
        let count = |a: u32, b: u32| {
            let from = edges.partition_point(|e| (e.0, e.1) < (a, b));
            edges[from..].iter().take_while(|e| (e.0, e.1) == (a, b)).count() as u64
        };
        for run in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let (a, b, start) = run[0];
            self.most_repeated = self.most_repeated.max(run.len() as u64);
            let missing = (run.len() as u64).saturating_sub(count(b, a));
            if missing > 0 {
                self.open_edges += missing;
                self.open_example = self.open_example.or(Some(start));
            }
        }
    }
}

/// Where a vertex's position is known under.
struct Places {
    /// The first vertex of the cluster with the same position.
    canonical: Vec<u16>,
    /// Group number where other clusters use the position too, else `u32::MAX`.
    group: Vec<u32>,
}

/// Checks one cluster.
pub(super) fn check(model: &Model, cluster: u32, decoded: &Decoded, shared: &Shared) -> ClusterReport {
    let mut report = ClusterReport::default();
    check_sphere(model, cluster, decoded, &mut report.breaches);
    let places = places(model, cluster, decoded, shared, &mut report.breaches);
    for level in 0..model.levels() {
        let reported = check_level(model, (cluster, level), decoded, &places, &mut report.breaches);
        report.levels.push(reported);
    }
    report
}

fn check_sphere(model: &Model, cluster: u32, decoded: &Decoded, breaches: &mut Vec<Breach>) {
    let record = &model.clusters()[cluster as usize];
    let outside = |&g: &[i32; 3]| distance(g, record.center) > record.radius as f64 * (1.0 + 1e-12);
    if let Some(vertex) = decoded.grid.iter().position(outside) {
        breaches.push(Breach {
            promise: Promise::I4,
            place: format!("cluster {cluster} vertex {vertex} at {}", position(model, decoded.grid[vertex])),
            what: "lies outside the cluster's bounding sphere".into(),
        });
    }
}

fn places(model: &Model, cluster: u32, decoded: &Decoded, shared: &Shared, breaches: &mut Vec<Breach>) -> Places {
    let count = decoded.vertices.len();
    let mut places = Places { canonical: (0..count).map(|v| v as u16).collect(), group: vec![u32::MAX; count] };
    let mut alone = vec![true; count];
    for (vertex, number) in shared.of_cluster(cluster) {
        let group = shared.group(number);
        let first = group.iter().find(|r| r.cluster == cluster).expect("the group has this vertex");
        places.canonical[vertex as usize] = first.vertex;
        if clusters(group).nth(1).is_some() {
            places.group[vertex as usize] = number;
            alone[vertex as usize] = false;
        }
    }
    for (vertex, v) in decoded.vertices.iter().enumerate() {
        // Groups with other clusters are checked where all their records are at hand.
        if alone[vertex] && places.canonical[vertex] as usize == vertex && v.slot() != 0 {
            breaches.push(Breach {
                promise: Promise::I1,
                place: format!("cluster {cluster} vertex {vertex} at {}", position(model, decoded.grid[vertex])),
                what: format!("has border slot {}, but no other cluster uses its position", v.slot()),
            });
        }
    }
    places
}

fn check_level(
    model: &Model,
    (cluster, level): (u32, u32),
    decoded: &Decoded,
    places: &Places,
    breaches: &mut Vec<Breach>,
) -> LevelReport {
    let mut report = LevelReport::default();
    let vertices = model.level(cluster, level).vertices as usize;
    let mut used = vec![false; vertices];
    let mut edges = Vec::new();
    for (number, t) in decoded.indices[level as usize].chunks_exact(3).enumerate() {
        let corners = [t[0], t[1], t[2]].map(|i| places.canonical[i as usize] as usize);
        if corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0] {
            breaches.push(Breach {
                promise: Promise::I6,
                place: format!("cluster {cluster} level {level} triangle {number}"),
                what: format!("two of its corners {t:?} have one position"),
            });
        }
        if model.textures().is_some() && tile_area2([t[0], t[1], t[2]].map(|i| decoded.vertices[i as usize].uv())) < 0 {
            breaches.push(Breach {
                promise: Promise::I6,
                place: format!("cluster {cluster} level {level} triangle {number}"),
                what: format!("it is turned over in its texture coordinates, corners {t:?}"),
            });
        }
        corners.iter().for_each(|&c| used[c] = true);
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let start = decoded.grid[a];
            match (places.group[a], places.group[b]) {
                (u32::MAX, _) | (_, u32::MAX) => edges.push((a as u32, b as u32, start)),
                (a, b) => report.shared_edges.push((a, b, start)),
            }
        }
    }
    report.match_edges(edges);
    for vertex in (0..vertices).filter(|&v| places.canonical[v] as usize == v && used[v]) {
        match places.group[vertex] {
            u32::MAX => report.used_positions += 1,
            group => report.shared_used.push(group),
        }
    }
    report
}
