//! Laying a disc out flat: the coarsest version on a circle (Tutte 1963), then vertex by vertex back to the finest, with
//! the symmetric Dirichlet energy relaxed in every version. What is smooth and large is settled where it costs nothing.

use super::hierarchy::{Hierarchy, Level, Removal};
use super::notch::Disc;
use super::piece::Piece;
use super::relax::{Rest, Seen, energy_at, measure, step};
use super::stretch::Stretch;
use glam::{DVec2, DVec3};

/// Versions are relaxed when they have this many times the vertices of the last that was.
const RELAX_GROWTH: f64 = 1.6;
/// Sweeps over the finest version.
const FINEST_SWEEPS: usize = 3;
/// Sweeps over the coarsest, at most.
const COARSEST_SWEEPS: usize = 100;
/// Sweeps end when one lowers the energy by less than this share.
const CONVERGED: f64 = 1e-4;
/// A version of this many vertices tells whether the stretch is hopeless.
const TELLING: usize = 96;
/// How much more stretch than allowed is hopeless in a coarser version.
const HOPELESS: f64 = 1.08;
/// Weight of air, which only has to stay upright.
const AIR: f64 = 0.1;
/// Gauss-Seidel rounds of the first layout.
const TUTTE_ROUNDS: usize = 400;

/// Why a part cannot be one chart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Failure {
    /// It is closed, or could not be cut to a disc.
    NoDisc,
    /// It would be stretched too much.
    Stretched,
    /// Triangles would be turned over.
    Turned,
    /// It would lie on itself.
    Overlap,
}

/// Coordinates per vertex of `disc`, all areas positive. `max_stretch`: of [`Stretch::l2`].
pub(super) fn flatten(disc: &Disc, max_stretch: f64) -> Result<(Vec<DVec2>, Stretch), Failure> {
    let unit = typical_edge(&disc.triangles, &disc.points);
    let hierarchy = Hierarchy::new(disc);
    let mut layout = Layout { points: &disc.points, unit, uv: vec![DVec2::ZERO; disc.points.len()], seen: Vec::new() };
    let coarsest = hierarchy.levels.len() - 1;
    layout.on_circle(&hierarchy.levels[coarsest], disc)?;
    let mut relaxed = 0;
    let mut stretch = Stretch::default();
    for (i, level) in hierarchy.levels.iter().enumerate().rev() {
        for removal in level.removals.iter().rev() {
            layout.insert(removal, &hierarchy.rings[removal.ring.clone()])?;
        }
        let n = level.vertices.len();
        if i > 0 && (n as f64) < RELAX_GROWTH * relaxed as f64 {
            continue;
        }
        let sweeps = FINEST_SWEEPS + (disc.points.len() as f64 / n as f64).log2().max(0.0) as usize;
        let sweeps = if relaxed == 0 { COARSEST_SWEEPS } else { sweeps };
        stretch = layout.relax(level, sweeps);
        if i == 0 {
            stretch = layout.stretch(&disc.triangles[..disc.real]);
        }
        relaxed = n;
        let limit = if i > 0 { HOPELESS * max_stretch } else { max_stretch };
        if (n >= TELLING || i == 0) && stretch.l2() > limit {
            return Err(Failure::Stretched);
        }
    }
    Ok((layout.uv, stretch))
}

/// Stretch of each triangle of a piece at `uv`, all areas positive.
pub(super) fn stretches(piece: &Piece, uv: &[DVec2]) -> Vec<Stretch> {
    let unit = typical_edge(&piece.triangles, &piece.points);
    let stretch = |t: &[u32; 3]| {
        let rest = Rest::new(t.map(|v| piece.points[v as usize]), unit);
        let (d, a) = measure(&rest, t.map(|v| uv[v as usize]));
        let mut stretch = Stretch::default();
        stretch.add(d, a, rest.area2);
        stretch
    };
    piece.triangles.iter().map(stretch).collect()
}

/// Root of the mean triangle area, about an edge length; positive.
fn typical_edge(triangles: &[[u32; 3]], points: &[DVec3]) -> f64 {
    let normal2 = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length();
    let area: f64 = triangles.iter().map(|t| normal2(t.map(|v| points[v as usize]))).sum();
    (area / triangles.len() as f64).sqrt().max(1e-30)
}

/// Coordinates that are being found.
struct Layout<'a> {
    points: &'a [DVec3],
    unit: f64,
    uv: Vec<DVec2>,
    seen: Vec<Seen>,
}

impl Layout<'_> {
    fn rest(&self, t: &[u32; 3]) -> Rest {
        Rest::new(t.map(|v| self.points[v as usize]), self.unit)
    }

    /// The border on a circle, other vertices in the middle of their neighbours.
    fn on_circle(&mut self, level: &Level, disc: &Disc) -> Result<(), Failure> {
        let mut after = std::collections::BTreeMap::new();
        let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); self.points.len()];
        let edges: std::collections::BTreeSet<(u32, u32)> =
            level.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
        for &(a, b) in &edges {
            neighbours[a as usize].push(b);
            if !edges.contains(&(b, a)) {
                neighbours[b as usize].push(a);
                after.insert(a, b);
            }
        }
        let Some(&first) = after.keys().next() else { return Err(Failure::NoDisc) };
        let mut around = vec![first];
        while let Some(&v) = after.get(&around[around.len() - 1]).filter(|v| **v != first) {
            around.push(v);
            if around.len() > after.len() {
                return Err(Failure::NoDisc);
            }
        }
        let length = |a: u32, b: u32| self.points[a as usize].distance(self.points[b as usize]) + 1e-2 * self.unit;
        let total: f64 = (0..around.len()).map(|i| length(around[i], around[(i + 1) % around.len()])).sum();
        let mut at = 0.0;
        let mut placed = Vec::with_capacity(around.len());
        for i in 0..around.len() {
            placed.push(DVec2::from_angle(at * std::f64::consts::TAU / total) * (total / std::f64::consts::TAU));
            at += length(around[i], around[(i + 1) % around.len()]);
        }
        around.iter().zip(placed).for_each(|(&v, p)| self.uv[v as usize] = p);
        let inner: Vec<u32> = level.vertices.iter().copied().filter(|&v| !disc.on_border[v as usize]).collect();
        for _ in 0..TUTTE_ROUNDS {
            for &v in &inner {
                let ring = &neighbours[v as usize];
                let sum: DVec2 = ring.iter().map(|&w| self.uv[w as usize]).sum();
                self.uv[v as usize] = sum / ring.len() as f64;
            }
        }
        Ok(())
    }

    /// Puts a removed vertex back among its neighbours.
    fn insert(&mut self, removal: &Removal, ring: &[u32]) -> Result<(), Failure> {
        let v = removal.vertex;
        let count = if removal.closed { ring.len() } else { ring.len() - 1 };
        self.seen.clear();
        let mut mean = (DVec2::ZERO, 0.0);
        for i in 0..count {
            let (a, b) = (ring[i], ring[(i + 1) % ring.len()]);
            let rest = self.rest(&[v, a, b]);
            self.seen.push(Seen { a: self.uv[a as usize], b: self.uv[b as usize], rest });
        }
        for (i, &r) in ring.iter().enumerate() {
            if removal.closed || i == 0 || i + 1 == ring.len() {
                let weight = 1.0 / (self.points[v as usize].distance(self.points[r as usize]) + 1e-3 * self.unit);
                mean = (mean.0 + weight * self.uv[r as usize], mean.1 + weight);
            }
        }
        let mut p = mean.0 / mean.1;
        if !energy_at(&self.seen, p).is_finite() {
            p = self.near_target(removal, ring).ok_or(Failure::Turned)?;
        }
        for _ in 0..2 {
            p = step(&self.seen, p);
        }
        self.uv[v as usize] = p;
        Ok(())
    }

    /// A place close to the vertex that the removed one went to, from where all neighbours are seen.
    fn near_target(&self, removal: &Removal, ring: &[u32]) -> Option<DVec2> {
        let u = self.uv[removal.into as usize];
        let spoke = |i: usize| self.uv[ring[i] as usize] - u;
        let last = ring.len() - 1;
        // The neighbours that stay around u, from the first to the last.
        let (first, end) = match removal.closed {
            true => (1, last),
            false if ring[0] == removal.into => (1, last),
            false => (0, last - 1),
        };
        let angle: f64 = (first..end).map(|i| spoke(i).angle_to(spoke(i + 1))).sum();
        let turn = if removal.closed { 0.5 * angle } else { angle.min(std::f64::consts::FRAC_PI_2) };
        let way = match removal.closed || ring[0] == removal.into {
            true => DVec2::from_angle(turn).rotate(spoke(first)),
            false => DVec2::from_angle(-turn).rotate(spoke(end)),
        };
        let shortest = (first..=end).map(|i| spoke(i).length()).fold(f64::INFINITY, f64::min);
        let way = way.normalize_or_zero() * shortest;
        (1..40).map(|k| u + way * 0.5f64.powi(k)).find(|&p| energy_at(&self.seen, p).is_finite())
    }

    /// Sweeps over all vertices of a version; its stretch after that.
    fn relax(&mut self, level: &Level, sweeps: usize) -> Stretch {
        let mut rests: Vec<Rest> = level.triangles.iter().map(|t| self.rest(t)).collect();
        rests[level.real..].iter_mut().for_each(|r| r.cot = r.cot.map(|c| c * AIR));
        let mut start = vec![0u32; self.points.len() + 1];
        level.triangles.iter().flatten().for_each(|&v| start[v as usize + 1] += 1);
        (0..self.points.len()).for_each(|v| start[v + 1] += start[v]);
        let mut corners = vec![0u32; level.triangles.len() * 3];
        let mut fill = start.clone();
        for (c, &v) in level.triangles.iter().flatten().enumerate() {
            corners[fill[v as usize] as usize] = c as u32;
            fill[v as usize] += 1;
        }
        let mut stretch = self.scale(level, &rests);
        for _ in 0..sweeps {
            for &v in &level.vertices {
                self.seen.clear();
                for &c in &corners[start[v as usize] as usize..start[v as usize + 1] as usize] {
                    let (t, k) = (c as usize / 3, c as usize % 3);
                    let triangle = level.triangles[t];
                    let uv = |j: usize| self.uv[triangle[(k + j) % 3] as usize];
                    let seen = Seen { a: uv(1), b: uv(2), rest: rests[t].seen_from(k) };
                    self.seen.push(seen);
                }
                self.uv[v as usize] = step(&self.seen, self.uv[v as usize]);
            }
            let before = stretch.energy;
            stretch = self.scale(level, &rests);
            if stretch.energy > before * (1.0 - CONVERGED) {
                break;
            }
        }
        stretch
    }

    /// Of some triangles as they lie.
    fn stretch(&self, triangles: &[[u32; 3]]) -> Stretch {
        let mut stretch = Stretch::default();
        for t in triangles {
            let rest = self.rest(t);
            let (d, a) = measure(&rest, t.map(|v| self.uv[v as usize]));
            stretch.add(d, a, rest.area2);
        }
        stretch
    }

    /// Scales all coordinates to where the energy is least.
    fn scale(&mut self, level: &Level, rests: &[Rest]) -> Stretch {
        let mut stretch = Stretch::default();
        for (t, rest) in level.triangles.iter().zip(rests) {
            let (d, a) = measure(rest, t.map(|v| self.uv[v as usize]));
            stretch.add(d, a, rest.area2);
        }
        let factor = stretch.best_scale();
        if factor.is_finite() && factor > 0.0 {
            level.vertices.iter().for_each(|&v| self.uv[v as usize] *= factor);
            stretch.scaled(factor);
        }
        stretch
    }
}
