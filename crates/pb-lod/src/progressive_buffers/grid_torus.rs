//! A small closed model for tests, made without the bake: a torus of quads whose level i keeps every 2^i-th
//! grid line. All invariants I1 to I6 hold by construction: a vertex collapses to the grid point at or before
//! it, cluster borders lie on grid lines that every level keeps, and where four clusters meet, nothing moves.

use super::displayed_surface::DrawnCluster;
use super::layout::{ClusterRecord, LevelRecord, ModelRecord, NodeRecord, Vertex};
use super::select::SelectTables;
use super::textures::{MapFormat, MapKind, MapRecord, Textures, TileRecord};

/// Grid steps between two grid lines of the coarsest level, per cluster side.
const CELLS: u32 = 2;

pub struct GridTorus {
    pub model: ModelRecord,
    pub clusters: Vec<ClusterRecord>,
    pub levels: Vec<LevelRecord>,
    pub neighbours: Vec<u32>,
    pub nodes: Vec<NodeRecord>,
    pub maps: Vec<MapRecord>,
    pub tiles: Vec<TileRecord>,
    pub chunk_bytes: Vec<u64>,
    /// Per cluster: texture coordinates of the vertices, used by [`GridTorus::with_textures`].
    coordinates: Vec<Vec<[u16; 2]>>,
    /// Per cluster: all vertices, and the index buffer of each level.
    pub vertices: Vec<Vec<Vertex>>,
    pub indices: Vec<Vec<Vec<u16>>>,
}

/// Position of grid point (u, v) of a torus of `n` x `n` points: radii 24000 and 9000 quanta.
fn torus_point(u: u32, v: u32, n: u32) -> [i32; 3] {
    let angle = |i: u32| (i % n) as f64 / n as f64 * std::f64::consts::TAU;
    let (su, cu) = angle(u).sin_cos();
    let (sv, cv) = angle(v).sin_cos();
    let bump = 1.0 + 0.1 * ((u * 7 + v * 13) % 5) as f64 / 5.0 * ((u % n * (v % n)) % 2) as f64;
    let ring = 24000.0 + 9000.0 * cv * bump;
    [(ring * cu) as i32, (ring * su) as i32, (9000.0 * sv * bump) as i32]
}

impl GridTorus {
    /// `side * side` clusters (side 2 or more) and `levels` levels; grid step 1/1000, error of level i about
    /// 4^i / 100 with a different factor per cluster.
    pub fn new(side: u32, levels: u32) -> GridTorus {
        let width = CELLS << (levels - 1);
        let mut torus = GridTorus {
            model: bytemuck::Zeroable::zeroed(),
            clusters: Vec::new(),
            levels: Vec::new(),
            neighbours: Vec::new(),
            nodes: Vec::new(),
            maps: Vec::new(),
            tiles: Vec::new(),
            chunk_bytes: Vec::new(),
            coordinates: Vec::new(),
            vertices: Vec::new(),
            indices: Vec::new(),
        };
        torus.model.quantum = 1e-3;
        torus.model.levels = levels;
        torus.model.clusters = side * side;
        (0..side * side).for_each(|c| torus.add_cluster(c % side, c / side, side, width));
        torus.add_node(0, side * side);
        torus
    }

    /// The same with a colour map: tiles of `2^size_log2` texels, each texel `texel` world units wide.
    pub fn with_textures(mut self, size_log2: u8, texel: f32) -> GridTorus {
        self.maps = vec![MapRecord::new(MapKind::BaseColor, MapFormat::Bc7Srgb)];
        self.tiles = vec![TileRecord { size_log2, first: [0; 4], reserved: [0; 3], texel }; self.clusters.len()];
        self.model.flags = super::model::FLAG_TEXTURES;
        let places = (0..self.model.clusters).flat_map(|c| (0..self.model.levels).map(move |i| (c, i)));
        let bytes: Vec<u64> = places.map(|(c, i)| self.textures().chunk_bytes(c, i).into()).collect();
        self.chunk_bytes.extend(bytes);
        for (vertex, &uv) in self.vertices.iter_mut().flatten().zip(self.coordinates.iter().flatten()) {
            vertex.color = Vertex::pack_uv(uv);
        }
        self
    }

    pub fn textures(&self) -> Textures<'_> {
        Textures { maps: &self.maps, tiles: &self.tiles, levels: self.model.levels }
    }

    fn add_cluster(&mut self, cu: u32, cv: u32, side: u32, width: u32) {
        let levels = self.model.levels;
        let points: Vec<(u32, u32)> = (0..=width).flat_map(|v| (0..=width).map(move |u| (u, v))).collect();
        let dies = |&(u, v): &(u32, u32)| (u | v | 1 << (levels - 1)).trailing_zeros();
        let mut order = points.clone();
        order.sort_by_key(|p| std::cmp::Reverse(dies(p)));
        let index = |p: (u32, u32)| order.iter().position(|q| *q == p).expect("a point of this cluster") as u16;
        let grid = |&(u, v): &(u32, u32)| torus_point(cu * width + u, cv * width + v, side * width);
        let origin: [i32; 3] = std::array::from_fn(|k| points.iter().map(|p| grid(p)[k]).min().expect("not empty"));
        let vertex = |p: &(u32, u32)| {
            let step = 2 << dies(p);
            let parent = if dies(p) == levels - 1 { *p } else { (p.0 / step * step, p.1 / step * step) };
            let at = grid(p);
            Vertex {
                offset: std::array::from_fn(|k| (at[k] - origin[k]) as u16),
                parent: index(parent),
                normal_slot: Vertex::pack_normal_slot([0.0, 0.0, 1.0], slot(*p, width)),
                color: [255; 4],
            }
        };
        let coordinate = |&(u, v): &(u32, u32)| [u, v].map(|x| (x * 65_535 / width) as u16);
        self.coordinates.push(order.iter().map(coordinate).collect());
        let vertices: Vec<Vertex> = order.iter().map(vertex).collect();
        let cells = |i: u32| (0..width).step_by(1 << i);
        for i in 0..levels {
            let step = 1 << i;
            let quads = cells(i).flat_map(|v| cells(i).map(move |u| (u, v)));
            let corners =
                |(u, v)| [(u, v), (u + step, v), (u + step, v + step), (u, v), (u + step, v + step), (u, v + step)];
            let indices: Vec<u16> = quads.flat_map(corners).map(index).collect();
            let count = order.iter().filter(|p| dies(p) >= i).count() as u32;
            let error = if i == 0 { 0.0 } else { 0.01 * 4f32.powi(i as i32) * (1.0 + (cu + 2 * cv) as f32 % 3.0) };
            self.levels.push(LevelRecord { vertices: count, triangles: indices.len() as u32 / 3, error, acmr: 1.0 });
            self.chunk_bytes.push(count as u64 * 16 + indices.len() as u64 * 2);
            if i == 0 {
                self.indices.push(vec![indices])
            } else {
                self.indices.last_mut().expect("pushed").push(indices)
            }
        }
        let (left, right) = ((cu + side - 1) % side, (cu + 1) % side);
        let (below, above) = ((cv + side - 1) % side, (cv + 1) % side);
        let first = self.neighbours.len() as u32;
        self.neighbours.extend([cv * side + left, cv * side + right, below * side + cu, above * side + cu]);
        let (center, radius) = sphere(&points.iter().map(grid).collect::<Vec<_>>());
        let mut record: ClusterRecord = bytemuck::Zeroable::zeroed();
        (record.origin, record.center, record.radius) = (origin, center, radius);
        (record.neighbours_first, record.neighbours_count) = (first, 4);
        self.clusters.push(record);
        self.vertices.push(vertices);
    }

    fn add_node(&mut self, first: u32, count: u32) -> u32 {
        let clusters = &self.clusters[first as usize..(first + count) as usize];
        let (center, _) = sphere(&clusters.iter().map(|c| c.center).collect::<Vec<_>>());
        let radius = clusters.iter().map(|c| distance(c.center, center) + c.radius as f64).fold(0.0, f64::max);
        let mut node: NodeRecord = bytemuck::Zeroable::zeroed();
        (node.center, node.radius) = (center, radius.ceil() as f32);
        (node.first_cluster, node.cluster_count) = (first, count);
        (node.left, node.right) = (u32::MAX, u32::MAX);
        let index = self.nodes.len();
        self.nodes.push(node);
        if count > 1 {
            let left = self.add_node(first, count / 2);
            let right = self.add_node(first + count / 2, count - count / 2);
            (self.nodes[index].left, self.nodes[index].right) = (left, right);
        }
        index as u32
    }

    pub fn tables(&self) -> SelectTables<'_> {
        SelectTables {
            instances: None,
            textures: (!self.maps.is_empty()).then(|| self.textures()),
            model: &self.model,
            clusters: &self.clusters,
            levels: &self.levels,
            neighbours: &self.neighbours,
            nodes: &self.nodes,
            chunk_bytes: &self.chunk_bytes,
        }
    }

    pub fn chunks(&self) -> usize {
        self.chunk_bytes.len()
    }

    /// Cluster `cluster` with the data of `level`.
    pub fn drawn(&self, cluster: u32, level: u32) -> DrawnCluster {
        let (c, l) = (cluster as usize, self.model.levels as usize);
        let record = &self.clusters[c];
        let counts: Vec<u32> = self.levels[c * l..][..l].iter().map(|r| r.vertices).collect();
        let list = record.neighbours_first as usize..(record.neighbours_first + record.neighbours_count) as usize;
        DrawnCluster {
            origin: record.origin,
            shift: record.shift,
            neighbours: self.neighbours[list].to_vec(),
            level,
            vertices: self.vertices[c][..counts[level as usize] as usize].to_vec(),
            indices: self.indices[c][level as usize].clone(),
            counts,
        }
    }
}

/// Border slot of a point: left 1, right 2, below 3, above 4; corners and interior points have none.
fn slot((u, v): (u32, u32), width: u32) -> u8 {
    match (u, v) {
        (u, v) if u % width == 0 && v % width == 0 => 0,
        (0, _) => 1,
        (u, _) if u == width => 2,
        (_, 0) => 3,
        (_, v) if v == width => 4,
        _ => 0,
    }
}

fn distance(a: [i32; 3], b: [i32; 3]) -> f64 {
    a.iter().zip(b).map(|(x, y)| ((x - y) as f64).powi(2)).sum::<f64>().sqrt()
}

/// Centre of the bounding box, and a radius that holds all points.
fn sphere(points: &[[i32; 3]]) -> ([i32; 3], f32) {
    let bound = |k: usize| {
        let values = points.iter().map(|p| p[k]);
        values.clone().min().expect("not empty").midpoint(values.max().expect("not empty"))
    };
    let center: [i32; 3] = std::array::from_fn(bound);
    let radius = points.iter().map(|p| distance(*p, center)).fold(0.0, f64::max);
    (center, radius.ceil() as f32)
}
