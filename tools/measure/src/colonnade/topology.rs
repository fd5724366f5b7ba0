//! How the vertices of a part are joined: grids, and caps of rings with ever fewer vertices that close a tube. Knows
//! no positions; so faces can be written without making the surface again.

/// A position with the place in the image that it has on one side of a seam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wedge {
    /// Index in the part.
    pub position: u32,
    /// 0 to 1, v downwards.
    pub uv: [f32; 2],
}

/// The faces of a part; triangles count wedges and face outwards.
#[derive(Clone, Debug)]
pub struct Topology {
    pub wedges: Vec<Wedge>,
    pub triangles: Vec<[u32; 3]>,
}

/// How much a part has of everything.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub positions: u64,
    pub wedges: u64,
    pub triangles: u64,
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Counts) {
        self.positions += other.positions;
        self.wedges += other.wedges;
        self.triangles += other.triangles;
    }
}

/// A ring of a cap has this share of the width of the one around it.
const CAP_STEP: f64 = 0.7;
/// A ring of so many vertices is closed by triangles to the middle.
const CAP_END: usize = 8;

/// Which end of a tube a cap closes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    First,
    Last,
}

/// Sizes of the rings of a cap, the outermost first.
fn rings(columns: usize) -> impl Iterator<Item = usize> {
    std::iter::successors(Some(columns), |n| (*n > CAP_END).then(|| n.div_ceil(2)))
}

/// What a cap adds to a tube of so many columns: no positions of the tube's last ring, but wedges for them.
pub fn cap_counts(columns: usize) -> Counts {
    let sizes: Vec<usize> = rings(columns).collect();
    let inner: usize = sizes[1..].iter().sum::<usize>() + 1;
    let strips: usize = sizes.windows(2).map(|w| w[0] + w[1]).sum();
    let triangles = strips + sizes[sizes.len() - 1];
    Counts { positions: inner as u64, wedges: (columns + inner) as u64, triangles: triangles as u64 }
}

/// The inner vertices of a cap: each as the vertex of the outermost ring that it lies below, and its share of that
/// one's distance from the middle. The middle itself comes last, as (0, 0).
pub fn cap_vertices(columns: usize) -> impl Iterator<Item = (usize, f64)> {
    let ring =
        move |(depth, size): (usize, usize)| (0..size).map(move |k| (k * columns / size, CAP_STEP.powi(depth as i32)));
    rings(columns).enumerate().skip(1).flat_map(ring).chain(std::iter::once((0, 0.0)))
}

impl Topology {
    /// Empty, with room for exactly so much.
    pub fn with_room_for(counts: Counts) -> Topology {
        Topology {
            wedges: Vec::with_capacity(counts.wedges as usize),
            triangles: Vec::with_capacity(counts.triangles as usize),
        }
    }

    /// Adds a grid of `columns` x `lines` quads; it faces to where columns turn into lines the left way round.
    pub fn grid(&mut self, columns: usize, lines: usize, wedge: impl Fn(usize, usize) -> Wedge) {
        let first = self.wedges.len() as u32;
        let corners = (0..=lines).flat_map(|j| (0..=columns).map(move |i| (i, j)));
        self.wedges.extend(corners.map(|(i, j)| wedge(i, j)));
        let at = |i: usize, j: usize| first + (j * (columns + 1) + i) as u32;
        for (i, j) in (0..lines).flat_map(|j| (0..columns).map(move |i| (i, j))) {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            self.triangles.extend(if (i + j) % 2 == 0 { [[a, d, c], [a, c, b]] } else { [[a, d, b], [d, c, b]] });
        }
    }

    /// Closes a tube. `outer` is the position index of a vertex of its last ring, `inner` that of the first inner
    /// vertex; `uv` is the place in the image of a vertex as [`cap_vertices`] gives it.
    pub fn cap(
        &mut self,
        columns: usize,
        end: End,
        (outer, inner): (impl Fn(usize) -> u32, u32),
        uv: impl Fn(usize, f64) -> [f32; 2],
    ) {
        let first = self.wedges.len();
        self.wedges.extend((0..columns).map(|k| Wedge { position: outer(k), uv: uv(k, 1.0) }));
        let below = cap_vertices(columns).enumerate();
        self.wedges.extend(below.map(|(i, (k, share))| Wedge { position: inner + i as u32, uv: uv(k, share) }));
        let mut triangle = |t: [usize; 3]| {
            let [a, b, c] = t.map(|i| (first + i) as u32);
            self.triangles.push(if end == End::Last { [a, b, c] } else { [a, c, b] });
        };
        let sizes: Vec<usize> = rings(columns).collect();
        let mut start = 0;
        for (&n, &m) in sizes.iter().zip(&sizes[1..]) {
            let (out, inn) = (|i: usize| start + i % n, |j: usize| start + n + j % m);
            let (mut i, mut j) = (0, 0);
            while i < n || j < m {
                if j == m || (i < n && (i + 1) * m <= (j + 1) * n) {
                    triangle([out(i), inn(j), out(i + 1)]);
                    i += 1;
                } else {
                    triangle([out(i), inn(j), inn(j + 1)]);
                    j += 1;
                }
            }
            start += n;
        }
        let last = sizes[sizes.len() - 1];
        (0..last).for_each(|i| triangle([start + i, start + last, start + (i + 1) % last]));
    }
}
