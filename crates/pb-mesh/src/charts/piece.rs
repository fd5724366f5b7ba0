//! Connectivity: triangles across edges, and a part of a surface as a manifold of its own ([`Piece`]).

use glam::DVec3;

/// Marks a half-edge without a partner, or an index that is not set.
pub(super) const NONE: u32 = u32::MAX;

/// The half-edge after `h` in its triangle; half-edge `3 t + k` runs from corner k of triangle t to corner k + 1.
pub(super) fn next(h: u32) -> u32 {
    if h % 3 == 2 { h - 2 } else { h + 1 }
}

/// The half-edge before `h` in its triangle.
pub(super) fn prev(h: u32) -> u32 {
    if h.is_multiple_of(3) { h + 2 } else { h - 1 }
}

/// Partner of each half-edge. Edges of exactly two triangles that run along them in opposite directions and have the
/// same key are connected, others are borders. Triangles that use an index twice are connected to nothing.
pub(super) fn partners(triangles: &[[u32; 3]], key_of: impl Fn(usize) -> u32) -> Vec<u32> {
    let mut edges: Vec<(u64, u32)> = Vec::with_capacity(triangles.len() * 3);
    for (t, v) in triangles.iter().enumerate() {
        if v[0] == v[1] || v[1] == v[2] || v[2] == v[0] {
            continue;
        }
        for k in 0..3 {
            let (a, b) = (v[k], v[(k + 1) % 3]);
            edges.push(((u64::from(a.min(b)) << 32) | u64::from(a.max(b)), (3 * t + k) as u32));
        }
    }
    edges.sort_unstable();
    let mut partner = vec![NONE; triangles.len() * 3];
    for run in edges.chunk_by(|a, b| a.0 == b.0) {
        let [(_, h), (_, g)] = *run else { continue };
        let start = |h: u32| triangles[h as usize / 3][h as usize % 3];
        if start(h) != start(g) && key_of(h as usize / 3) == key_of(g as usize / 3) {
            partner[h as usize] = g;
            partner[g as usize] = h;
        }
    }
    partner
}

/// Parts that hang together over `partner`s, each ascending, in the order of their first triangle. Only triangles with
/// `label` equal across the edge are connected.
pub(super) fn components(partner: &[u32], label: impl Fn(u32) -> u32) -> Vec<Vec<u32>> {
    let mut seen = vec![false; partner.len() / 3];
    let mut parts = Vec::new();
    for first in 0..seen.len() {
        if std::mem::replace(&mut seen[first], true) {
            continue;
        }
        let mut part = vec![first as u32];
        let mut done = 0;
        while done < part.len() {
            let t = part[done];
            done += 1;
            for h in 3 * t..3 * t + 3 {
                let g = partner[h as usize];
                if g != NONE && label(g / 3) == label(t) && !std::mem::replace(&mut seen[g as usize / 3], true) {
                    part.push(g / 3);
                }
            }
        }
        part.sort_unstable();
        parts.push(part);
    }
    parts
}

/// A connected part of a surface with vertices of its own: where the part only touches itself, it has several vertices
/// at one position. So it is an orientable manifold with border.
pub(super) struct Piece {
    /// Triangles of the whole surface, in the order of `triangles`.
    pub faces: Vec<u32>,
    /// Vertices of the piece.
    pub triangles: Vec<[u32; 3]>,
    /// Partners inside the piece.
    pub partner: Vec<u32>,
    /// Per vertex.
    pub points: Vec<DVec3>,
    /// Vertices on the border.
    pub on_border: Vec<bool>,
}

impl Piece {
    /// `partner` and `triangles` are those of the whole surface, `faces` ascending; `scratch` has one [`NONE`] per
    /// triangle of the surface and is left so.
    pub fn new(faces: &[u32], partner: &[u32], point_of: impl Fn(u32, usize) -> DVec3, scratch: &mut [u32]) -> Piece {
        for (i, &f) in faces.iter().enumerate() {
            scratch[f as usize] = i as u32;
        }
        let local = |h: u32| match h {
            NONE => NONE,
            h if scratch[h as usize / 3] == NONE => NONE,
            h => scratch[h as usize / 3] * 3 + h % 3,
        };
        let partner = faces.iter().flat_map(|&f| (0..3).map(move |k| 3 * f + k)).map(|h| local(partner[h as usize]));
        let partner: Vec<u32> = partner.collect();
        for &f in faces {
            scratch[f as usize] = NONE;
        }
        let mut piece =
            Piece { faces: faces.to_vec(), triangles: Vec::new(), partner, points: Vec::new(), on_border: Vec::new() };
        let corners = piece.number_vertices();
        piece.points = corners.iter().map(|&c| point_of(faces[c as usize / 3], c as usize % 3)).collect();
        piece
    }

    /// Gives every fan of corners a vertex; returns a corner of each.
    fn number_vertices(&mut self) -> Vec<u32> {
        let partner = &self.partner;
        let mut vertex = vec![NONE; partner.len()];
        let mut corner_of = Vec::new();
        self.on_border.clear();
        for first in 0..partner.len() as u32 {
            if vertex[first as usize] != NONE {
                continue;
            }
            let v = corner_of.len() as u32;
            corner_of.push(first);
            let (mut corner, mut border) = (first, false);
            while vertex[corner as usize] == NONE {
                vertex[corner as usize] = v;
                match partner[corner as usize] {
                    NONE => border = true,
                    across => corner = next(across),
                }
            }
            // The other way round where the first way ended at the border.
            corner = first;
            while border && partner[prev(corner) as usize] != NONE {
                corner = partner[prev(corner) as usize];
                vertex[corner as usize] = v;
            }
            self.on_border.push(border);
        }
        self.triangles = vertex.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        corner_of
    }

    /// Cuts the piece open along half-edges (both sides of each are marked).
    pub fn cut(&mut self, marked: &[bool]) {
        let before = self.triangles.clone();
        let points = std::mem::take(&mut self.points);
        for (p, _) in self.partner.iter_mut().zip(marked).filter(|(_, m)| **m) {
            *p = NONE;
        }
        let corners = self.number_vertices();
        self.points = corners.iter().map(|&c| points[before[c as usize / 3][c as usize % 3] as usize]).collect();
    }

    /// Vertices - edges + triangles: 1 for a disc, 2 for a sphere, less for anything else that is connected.
    pub fn euler_characteristic(&self) -> i64 {
        let borders = self.partner.iter().filter(|&&p| p == NONE).count();
        let edges = (self.partner.len() + borders) / 2;
        self.points.len() as i64 - edges as i64 + self.triangles.len() as i64
    }

    /// Vertex that half-edge `h` starts from.
    pub fn start(&self, h: u32) -> u32 {
        self.triangles[h as usize / 3][h as usize % 3]
    }

    /// Twice the area of a triangle, and its normal with that length.
    pub fn normal2(&self, t: usize) -> DVec3 {
        let [a, b, c] = self.triangles[t].map(|v| self.points[v as usize]);
        (b - a).cross(c - a)
    }

    /// Border half-edges in order, from the lowest on. Only of a disc.
    pub fn outline(&self) -> Vec<u32> {
        let Some(first) = self.partner.iter().position(|&p| p == NONE) else { return Vec::new() };
        let mut outline = vec![first as u32];
        loop {
            let mut h = next(outline[outline.len() - 1]);
            while self.partner[h as usize] != NONE {
                h = next(self.partner[h as usize]);
            }
            if h == outline[0] || outline.len() > self.partner.len() {
                return outline;
            }
            outline.push(h);
        }
    }
}
