//! Texture coordinates of PLY faces: a vertex with several becomes several records.

use pb_mesh::mesh::Soup;

/// Most records of a vertex that are compared; further ones are not joined.
const MAX_COMPARED: usize = 64;
const NONE: u32 = u32::MAX;

/// Records by vertex and texture coordinate. The first of a vertex has the vertex's own index.
pub(super) struct Seams {
    uvs: Vec<[f32; 2]>,
    taken: Vec<bool>,
    /// The next record of the same vertex.
    next: Vec<u32>,
    /// The vertex of each record behind the vertices.
    more: Vec<u32>,
}

impl Seams {
    pub(super) fn new(vertex_count: usize) -> Seams {
        let (uvs, taken) = (vec![[0.0; 2]; vertex_count], vec![false; vertex_count]);
        Seams { uvs, taken, next: vec![NONE; vertex_count], more: Vec::new() }
    }

    /// The record of a vertex with a texture coordinate.
    pub(super) fn record(&mut self, vertex: u32, uv: [f32; 2]) -> u32 {
        let v = vertex as usize;
        if !std::mem::replace(&mut self.taken[v], true) {
            self.uvs[v] = uv;
            return vertex;
        }
        let mut at = vertex;
        for _ in 0..MAX_COMPARED {
            if at == NONE {
                break;
            }
            if self.uvs[at as usize].map(f32::to_bits) == uv.map(f32::to_bits) {
                return at;
            }
            at = self.next[at as usize];
        }
        let record = self.uvs.len() as u32;
        self.uvs.push(uv);
        self.next.push(self.next[v]);
        self.next[v] = record;
        self.more.push(vertex);
        record
    }

    /// Gives a soup the new records.
    pub(super) fn put_into(self, soup: &mut Soup) {
        let Soup { positions, normals, colors, .. } = soup;
        positions.reserve_exact(self.more.len());
        for v in self.more.iter().map(|&v| v as usize) {
            positions.push(positions[v]);
            if !normals.is_empty() {
                normals.push(normals[v]);
            }
            if !colors.is_empty() {
                colors.push(colors[v]);
            }
        }
        soup.uv_sets = vec![self.uvs];
    }
}
