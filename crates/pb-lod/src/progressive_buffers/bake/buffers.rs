//! One cluster's buffers: the order of its vertices, parents, and an index buffer per level.

use crate::progressive_buffers::codec::{Chunk, encode_chunk};
use crate::progressive_buffers::layout::{LevelRecord, SLOT_NONE, Vertex};
use crate::progressive_buffers::write::EncodedChunk;
use pb_archive::{ArchiveError, Spill};
use pb_mesh::mesh::Wedge;
use pb_mesh::numbering::Numbering;
use pb_mesh::simplify::Collapses;
use pb_mesh::topology::Kind;

/// Vertex cache that the order is made for and ACMR is reported for. The FIFO order takes a quarter of the time of the
/// table-driven one for a few percent more misses.
const ACMR_CACHE: u32 = 16;
/// Not numbered yet.
const NONE: u32 = u32::MAX;

/// What every cluster's buffers are made from.
pub(super) struct Source<'a> {
    pub wedges: &'a [Wedge],
    /// Wedge indices of the input triangles.
    pub triangles: &'a [[u32; 3]],
    pub points: &'a [[i32; 3]],
    pub kinds: &'a [Kind],
    pub collapses: &'a Collapses,
    /// Texture coordinates, where the mesh has textures; colours are not stored then.
    pub uv: Option<Coordinates<'a>>,
    pub levels: usize,
}

/// Texture coordinates of the whole mesh; see [`UvInput`](pb_mesh::simplify::UvInput).
#[derive(Clone, Copy)]
pub(super) struct Coordinates<'a> {
    /// Per triangle corner: UV wedge.
    pub corners: &'a [[u32; 3]],
    /// Tile coordinates per UV wedge.
    pub uv: &'a [[u16; 2]],
}

/// Where one cluster lies and who its neighbours are.
pub(super) struct Place<'a> {
    pub triangles: &'a [u32],
    pub origin: [i32; 3],
    pub shift: u32,
    /// Border slot of a border position of this cluster.
    pub slot_of: &'a (dyn Fn(u32) -> u8 + Sync),
}

/// Level records (error still 0) and packed chunks of one cluster, finest first. `numbering` is one for all positions.
pub(super) fn build(
    source: &Source,
    place: &Place,
    numbering: &mut Numbering,
    spill: &Spill,
) -> Result<(Vec<LevelRecord>, Vec<EncodedChunk>), ArchiveError> {
    let local = Local::new(source, place.triangles, numbering);
    let (order, starts, index_buffers) = local.number(source.levels);
    let vertices = local.vertices(source, place, &order);
    let mut records = Vec::with_capacity(source.levels);
    let mut chunks = Vec::with_capacity(source.levels);
    for level in 0..source.levels {
        let (end, first) = (starts[level], if level + 1 < source.levels { starts[level + 1] } else { 0 });
        let indices = &index_buffers[level];
        let acmr = match indices.is_empty() {
            true => 0.0,
            false => meshopt::analyze_vertex_cache(indices, end as usize, ACMR_CACHE, 0, 0).acmr,
        };
        records.push(LevelRecord { vertices: end, triangles: (indices.len() / 3) as u32, error: 0.0, acmr });
        let chunk = Chunk {
            first_vertex: first,
            vertices: vertices[first as usize..end as usize].to_vec(),
            indices: indices.iter().map(|&i| i as u16).collect(),
        };
        let bytes = spill.put(encode_chunk(&chunk))?;
        chunks.push(EncodedChunk { bytes, decoded_bytes: chunk.shape().decoded_bytes() });
    }
    Ok((records, chunks))
}

/// What becomes a vertex: a wedge, and its UV wedge where there are textures (else 0).
type Record = (u32, u32);

/// A cluster in local record indices.
struct Local {
    /// Record of each local index, ascending, so that those of one position are neighbours.
    records: Vec<Record>,
    /// Position of each local index.
    positions: Vec<u32>,
    last_level: Vec<u8>,
    parents: Vec<u32>,
    triangles: Vec<[u32; 3]>,
}

impl Local {
    fn new(source: &Source, triangles: &[u32], places: &mut Numbering) -> Self {
        let corners = |&t: &u32| source.records(t as usize);
        let position = |r: Record| source.wedges[r.0 as usize].position;
        places.assign(triangles.iter().flat_map(corners).map(position));
        let mut records: Vec<Record>;
        if source.uv.is_none() && source.wedges.len() == source.points.len() {
            records = places.items().map(|p| (p, 0)).collect();
        } else {
            records = triangles.iter().flat_map(corners).collect();
            records.sort_unstable();
            records.dedup();
        }
        let positions: Vec<u32> = records.iter().map(|&r| position(r)).collect();
        let mut starts = Vec::with_capacity(places.len() + 1);
        starts.extend((0..records.len()).filter(|&i| i == 0 || positions[i] != positions[i - 1]));
        starts.push(records.len());
        let at = |position: u32| {
            let place = places.of(position) as usize;
            starts[place]..starts[place + 1]
        };
        let local = |r: Record| at(position(r)).find(|&i| records[i] == r).expect("collected above") as u32;
        let parent = |i: usize| match source.collapses.parent[positions[i] as usize] {
            own if own == positions[i] => i as u32,
            parent => parent_record(source, &records, i, at(parent)),
        };
        Local {
            triangles: triangles.iter().map(|t| corners(t).map(local)).collect(),
            last_level: positions.iter().map(|&p| source.collapses.last_level[p as usize]).collect(),
            parents: (0..records.len()).map(parent).collect(),
            positions,
            records,
        }
    }

    fn ancestor(&self, mut v: u32, level: u8) -> u32 {
        while self.last_level[v as usize] < level {
            v = self.parents[v as usize];
        }
        v
    }

    /// Triangles of every level, finest first.
    fn level_triangles(&self, levels: usize) -> Vec<Vec<[u32; 3]>> {
        let mut list = vec![self.triangles.clone()];
        // Ancestors so far: every walk leaves them one step away.
        let mut up = self.parents.clone();
        for level in 1..levels as u8 {
            let finer = list.last().expect("level 0 is there");
            let mut ancestor = |v: u32| {
                let dead = |v: u32| self.last_level[v as usize] < level;
                let (mut root, mut at) = (v, v);
                while dead(root) {
                    root = up[root as usize];
                }
                while dead(at) {
                    at = std::mem::replace(&mut up[at as usize], root);
                }
                root
            };
            let coarse = finer.iter().map(|t| t.map(&mut ancestor));
            let p = |v: u32| self.positions[v as usize];
            let coarse = coarse.filter(|t| p(t[0]) != p(t[1]) && p(t[1]) != p(t[2]) && p(t[2]) != p(t[0])).collect();
            list.push(coarse);
        }
        list
    }

    /// Numbers the vertices coarsest level first, inside a level in the order of first use. Returns the local index
    /// of every vertex, `n_i` per level, and the index buffers.
    fn number(&self, levels: usize) -> (Vec<u32>, Vec<u32>, Vec<Vec<u32>>) {
        let count = self.records.len();
        let triangles = self.level_triangles(levels);
        let (mut number, mut order) = (vec![NONE; count], Vec::with_capacity(count));
        let mut starts = vec![0; levels];
        let mut buffers = vec![Vec::new(); levels];
        for level in (0..levels).rev() {
            let mut indices: Vec<u32> = triangles[level].as_flattened().to_vec();
            if !indices.is_empty() {
                meshopt::optimize_vertex_cache_fifo_in_place(&mut indices, count, ACMR_CACHE);
            }
            let alive = (0..count as u32).filter(|&v| self.last_level[v as usize] as usize >= level);
            for v in indices.iter().copied().chain(alive) {
                if number[v as usize] == NONE {
                    number[v as usize] = order.len() as u32;
                    order.push(v);
                }
            }
            indices.iter_mut().for_each(|v| *v = number[*v as usize]);
            starts[level] = order.len() as u32;
            buffers[level] = indices;
        }
        (order, starts, buffers)
    }

    fn vertices(&self, source: &Source, place: &Place, order: &[u32]) -> Vec<Vertex> {
        let mut number = vec![0u16; order.len()];
        for (i, &v) in order.iter().enumerate() {
            number[v as usize] = i as u16;
        }
        let vertex = |&v: &u32| {
            let (wedge, uv_wedge) = self.records[v as usize];
            let wedge = &source.wedges[wedge as usize];
            let point = source.points[wedge.position as usize];
            let last = self.last_level[v as usize];
            let parent = if last as usize + 1 < source.levels { self.ancestor(v, last + 1) } else { v };
            let slot = match source.kinds[wedge.position as usize] {
                Kind::Border => (place.slot_of)(wedge.position),
                _ => SLOT_NONE,
            };
            Vertex {
                offset: std::array::from_fn(|k| ((point[k] - place.origin[k]) >> place.shift) as u16),
                parent: number[parent as usize],
                normal_slot: Vertex::pack_normal_slot(wedge.normal, slot),
                color: match &source.uv {
                    Some(texture) => Vertex::pack_uv(texture.uv[uv_wedge as usize]),
                    None => wedge.color,
                },
            }
        };
        order.iter().map(vertex).collect()
    }
}

impl Source<'_> {
    /// What the corners of a triangle are.
    fn records(&self, t: usize) -> [Record; 3] {
        match &self.uv {
            Some(texture) => std::array::from_fn(|k| (self.same_look(self.triangles[t][k]), texture.corners[t][k])),
            None => self.triangles[t].map(|w| (w, 0)),
        }
    }

    /// The first wedge of the same position and normal: colours do not matter where there are textures.
    fn same_look(&self, wedge: u32) -> u32 {
        let own = &self.wedges[wedge as usize];
        let mut first = wedge;
        let mut w = wedge as usize;
        while w > 0 && self.wedges[w - 1].position == own.position {
            w -= 1;
            if self.wedges[w].normal == own.normal {
                first = w as u32;
            }
        }
        first
    }
}

/// Local index of the record that local record `i` becomes when its position collapses: of `candidates`, those that the
/// cluster has at the parent position, and of its UV wedge's parent, the one with the most similar normal and colour.
fn parent_record(source: &Source, records: &[Record], i: usize, candidates: std::ops::Range<usize>) -> u32 {
    if candidates.len() == 1 && source.uv.is_none() {
        return candidates.start as u32;
    }
    let (own, uv_wedge) = records[i];
    let own = &source.wedges[own as usize];
    let uv_parent = source.uv.map(|_| source.collapses.wedge_parent[uv_wedge as usize]);
    let difference = |w: &Wedge| {
        let bend = (0..3).map(|k| (w.normal[k] - own.normal[k]).powi(2)).sum::<f32>();
        let tint = (0..4).map(|k| ((f32::from(w.color[k]) - f32::from(own.color[k])) / 255.0).powi(2)).sum::<f32>();
        bend + tint
    };
    candidates
        .filter(|&j| uv_parent.is_none_or(|uv| records[j].1 == uv))
        .min_by(|&a, &b| {
            let d = |j: usize| difference(&source.wedges[records[j].0 as usize]);
            d(a).total_cmp(&d(b))
        })
        .expect("a position collapses only onto one of its own cluster (I2)") as u32
}
