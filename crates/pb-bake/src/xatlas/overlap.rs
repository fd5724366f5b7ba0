//! Where does a chart lie over itself? Both programs compile this file: the helper takes such triangles out of the chart,
//! pb-bake refuses it. xatlas leaves such places at vertices whose triangles fill more than a full turn.

/// How deep two triangles must lie in each other to count, as a share of the shorter of their longest edges.
const DEPTH: f64 = 1e-3;
/// Grid cells that triangles may cover, and pairs of them that are compared, per triangle of the chart: bounds the
/// time that a chart of needles or of triangles all in one place can take.
const PER_TRIANGLE: (usize, usize) = (16, 256);

/// Pairs of triangles of a chart that lie over each other, in no special but always the same order; not all of them
/// where the chart is too crowded for the bounds. Numbers must be finite.
pub fn overlaps(uv: &[[[f32; 2]; 3]]) -> Vec<(usize, usize)> {
    let triangles: Vec<[[f64; 2]; 3]> = uv.iter().map(|t| t.map(|p| p.map(f64::from))).collect();
    let grid = Grid::new(&triangles);
    let mut entries: Vec<([u32; 2], u32)> = Vec::new();
    for (t, corners) in triangles.iter().enumerate() {
        let (low, high) = grid.cells(corners);
        let columns = low[0]..=high[0];
        entries.extend(columns.flat_map(|x| (low[1]..=high[1]).map(move |y| ([x, y], t as u32))));
    }
    entries.sort_unstable();
    let (mut pairs, mut compared) = (Vec::new(), 0);
    for cell in entries.chunk_by(|a, b| a.0 == b.0) {
        for (i, &(place, first)) in cell.iter().enumerate() {
            for &(_, second) in &cell[i + 1..] {
                compared += 1;
                if compared > PER_TRIANGLE.1 * triangles.len() {
                    return pairs;
                }
                let (a, b) = (&triangles[first as usize], &triangles[second as usize]);
                let ((low_a, _), (low_b, _)) = (grid.cells(a), grid.cells(b));
                // Two triangles may share cells; they meet in the first one.
                let meet = [low_a[0].max(low_b[0]), low_a[1].max(low_b[1])];
                if meet == place && lie_over_each_other(a, b) {
                    pairs.push((first as usize, second as usize));
                }
            }
        }
    }
    pairs
}

/// Square cells over a chart.
struct Grid {
    low: [f64; 2],
    side: f64,
}

impl Grid {
    fn new(triangles: &[[[f64; 2]; 3]]) -> Grid {
        let bound =
            |k: usize, pick: fn(f64, f64) -> f64, from: f64| triangles.iter().flatten().map(|p| p[k]).fold(from, pick);
        let low = [bound(0, f64::min, f64::MAX), bound(1, f64::min, f64::MAX)];
        let high = [bound(0, f64::max, f64::MIN), bound(1, f64::max, f64::MIN)];
        let extent = (high[0] - low[0]).max(high[1] - low[1]);
        let side = extent / (triangles.len() as f64).sqrt().ceil();
        let mut grid = Grid { low, side: if side > 0.0 { side } else { 1.0 } };
        let covered = |grid: &Grid| -> usize {
            let cells = |t| {
                let (low, high) = grid.cells(t);
                ((high[0] - low[0] + 1) as usize) * ((high[1] - low[1] + 1) as usize)
            };
            triangles.iter().map(cells).sum()
        };
        while covered(&grid) > PER_TRIANGLE.0 * triangles.len() {
            grid.side *= 2.0;
        }
        grid
    }

    /// First and last cell of a triangle's bounding box.
    fn cells(&self, corners: &[[f64; 2]; 3]) -> ([u32; 2], [u32; 2]) {
        let cell = |k: usize, x: f64| ((x - self.low[k]) / self.side) as u32;
        let range =
            |k: usize, pick: fn(f64, f64) -> f64| cell(k, pick(pick(corners[0][k], corners[1][k]), corners[2][k]));
        ([range(0, f64::min), range(1, f64::min)], [range(0, f64::max), range(1, f64::max)])
    }
}

/// By the separating axis theorem, with a little room for rounding.
fn lie_over_each_other(a: &[[f64; 2]; 3], b: &[[f64; 2]; 3]) -> bool {
    let edges = |t: &[[f64; 2]; 3]| [0, 1, 2].map(|i| [0, 1].map(|k| t[(i + 1) % 3][k] - t[i][k]));
    let longest = |t| edges(t).map(|e| e[0].hypot(e[1])).into_iter().fold(0.0, f64::max);
    let least = DEPTH * longest(a).min(longest(b));
    edges(a).into_iter().chain(edges(b)).all(|edge| {
        let length = edge[0].hypot(edge[1]);
        if length == 0.0 {
            return true;
        }
        let along = |p: &[f64; 2]| (p[1] * edge[0] - p[0] * edge[1]) / length;
        let span = |t: &[[f64; 2]; 3]| {
            let places = [along(&t[0]), along(&t[1]), along(&t[2])];
            (places.into_iter().fold(f64::MAX, f64::min), places.into_iter().fold(f64::MIN, f64::max))
        };
        let ((low_a, high_a), (low_b, high_b)) = (span(a), span(b));
        high_a.min(high_b) - low_a.max(low_b) > least
    })
}
