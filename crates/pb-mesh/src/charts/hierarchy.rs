//! Coarser and coarser versions of a disc by half-edge collapses, each of which can be undone in the plane without
//! turning a triangle (Sander, Snyder, Gortler, Hoppe 2001, section 4; Hormann, Greiner, Campagna 1999).

use super::notch::Disc;
use glam::DVec3;

/// A disc of at most this many vertices is not made coarser.
const COARSEST: usize = 24;
/// Vertices with more triangles than this are not removed.
const MAX_VALENCE: usize = 12;
/// Triangles of a collapse may turn by an angle of at most this cosine.
const MIN_TURN_COSINE: f64 = 0.2;
/// A round that removes fewer than one in this many vertices is the last.
const MIN_PROGRESS: usize = 20;
/// How strongly removals avoid long edges: the weight of length against the height over the plane.
const LENGTH_WEIGHT: f64 = 0.02;

/// A vertex that was removed, and the neighbours it had, counter-clockwise; the first is the one it went to, but on the
/// border, where it may also be the last.
pub(super) struct Removal {
    pub vertex: u32,
    pub into: u32,
    pub ring: std::ops::Range<usize>,
    pub closed: bool,
}

/// Triangles of one version, and around which vertices they lie.
pub(super) struct Level {
    /// Vertex indices are those of the disc in all versions. Those of the surface come first.
    pub triangles: Vec<[u32; 3]>,
    /// How many triangles are of the surface.
    pub real: usize,
    /// Vertices that are used, ascending.
    pub vertices: Vec<u32>,
    /// Removals that led from this version to the next, in order.
    pub removals: Vec<Removal>,
}

/// All versions of a disc, finest first.
pub(super) struct Hierarchy {
    pub levels: Vec<Level>,
    /// Neighbours of removed vertices.
    pub rings: Vec<u32>,
}

/// The changing mesh.
struct Work<'a> {
    points: &'a [DVec3],
    on_border: &'a [bool],
    triangles: Vec<[u32; 3]>,
    /// Triangles around each vertex; dead ones are still listed.
    around: Vec<Vec<u32>>,
    dead: Vec<bool>,
    ring: Vec<u32>,
}

/// What a collapse would cost, and where to.
type Choice = (f64, u32);

impl Hierarchy {
    /// Of a disc.
    pub fn new(disc: &Disc) -> Hierarchy {
        let n = disc.points.len();
        let mut around = vec![Vec::with_capacity(8); n];
        for (t, v) in disc.triangles.iter().enumerate() {
            v.iter().for_each(|&v| around[v as usize].push(t as u32));
        }
        let mut work = Work {
            points: &disc.points,
            on_border: &disc.on_border,
            triangles: disc.triangles.clone(),
            around,
            dead: vec![false; disc.triangles.len()],
            ring: Vec::new(),
        };
        let mut hierarchy = Hierarchy { levels: Vec::new(), rings: Vec::new() };
        let mut vertices: Vec<u32> = (0..n as u32).collect();
        let mut touched = vec![u32::MAX; n];
        loop {
            let triangles = work.living();
            let real = work.living_before(disc.real);
            let mut level = Level { triangles, real, vertices, removals: Vec::new() };
            if level.vertices.len() > COARSEST {
                work.round(&mut level, &mut hierarchy, &mut touched);
            }
            let removed = level.removals.len();
            let gone: std::collections::BTreeSet<u32> = level.removals.iter().map(|r| r.vertex).collect();
            vertices = level.vertices.iter().copied().filter(|v| !gone.contains(v)).collect();
            let enough = removed > 0 && removed * MIN_PROGRESS >= level.vertices.len();
            if !enough && removed > 0 {
                // The few removals still count: one more version, which is the last.
                hierarchy.levels.push(level);
                let real = work.living_before(disc.real);
                let last = Level { triangles: work.living(), real, vertices, removals: Vec::new() };
                hierarchy.levels.push(last);
                return hierarchy;
            }
            hierarchy.levels.push(level);
            if !enough {
                return hierarchy;
            }
        }
    }
}

impl Work<'_> {
    fn living(&self) -> Vec<[u32; 3]> {
        self.triangles.iter().zip(&self.dead).filter(|(_, dead)| !**dead).map(|(t, _)| *t).collect()
    }

    fn living_before(&self, end: usize) -> usize {
        self.dead[..end].iter().filter(|dead| !**dead).count()
    }

    /// Removes vertices that are not neighbours of each other, the cheapest first.
    fn round(&mut self, level: &mut Level, hierarchy: &mut Hierarchy, touched: &mut [u32]) {
        let round = hierarchy.levels.len() as u32;
        let mut choices: Vec<(f64, u32)> = Vec::with_capacity(level.vertices.len());
        for &v in &level.vertices {
            self.around[v as usize].retain(|&t| !self.dead[t as usize]);
            if let Some((cost, _)) = self.choose(v, false) {
                choices.push((cost, v));
            }
        }
        choices.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let most = (level.vertices.len() - COARSEST).min(level.vertices.len() / 2);
        for &(_, v) in &choices {
            if level.removals.len() >= most {
                break;
            }
            if touched[v as usize] == round {
                continue;
            }
            let Some((_, u)) = self.choose(v, true) else { continue };
            let closed = !self.on_border[v as usize];
            self.find_ring(v);
            if closed {
                let at = self.ring.iter().position(|&r| r == u).unwrap_or(0);
                self.ring.rotate_left(at);
            }
            self.ring.iter().for_each(|&r| touched[r as usize] = round);
            let start = hierarchy.rings.len();
            hierarchy.rings.extend_from_slice(&self.ring);
            level.removals.push(Removal { vertex: v, into: u, ring: start..hierarchy.rings.len(), closed });
            self.collapse(v, u);
        }
    }

    fn collapse(&mut self, v: u32, u: u32) {
        let moved = std::mem::take(&mut self.around[v as usize]);
        for t in moved {
            if self.dead[t as usize] {
                continue;
            }
            if self.triangles[t as usize].contains(&u) {
                self.dead[t as usize] = true;
                continue;
            }
            self.triangles[t as usize].iter_mut().filter(|c| **c == v).for_each(|c| *c = u);
            self.around[u as usize].push(t);
        }
    }

    /// Neighbours of `v` counter-clockwise into `self.ring`. False where they are too many.
    fn find_ring(&mut self, v: u32) -> bool {
        let mut steps = [[0u32; 2]; MAX_VALENCE];
        let mut count = 0;
        for &t in self.around[v as usize].iter().filter(|&&t| !self.dead[t as usize]) {
            if count == MAX_VALENCE {
                return false;
            }
            let c = self.triangles[t as usize];
            steps[count] = match c.iter().position(|&c| c == v) {
                Some(0) => [c[1], c[2]],
                Some(1) => [c[2], c[0]],
                _ => [c[0], c[1]],
            };
            count += 1;
        }
        let steps = &mut steps[..count];
        let first = steps.iter().map(|s| s[0]).find(|a| steps.iter().all(|s| s[1] != *a));
        self.ring.clear();
        let Some(mut at) = first.or(steps.first().map(|s| s[0])) else { return false };
        self.ring.push(at);
        for _ in 0..count {
            let Some(step) = steps.iter().find(|s| s[0] == at) else { return false };
            at = step[1];
            self.ring.push(at);
        }
        if first.is_none() {
            self.ring.pop();
        }
        true
    }

    /// The cheapest legal collapse of `v`; the link condition, which is dear, only where `check` asks for it.
    fn choose(&mut self, v: u32, check: bool) -> Option<Choice> {
        if !self.find_ring(v) {
            return None;
        }
        let closed = !self.on_border[v as usize];
        let k = self.ring.len();
        if closed && k < 3 {
            return None;
        }
        let p = self.points[v as usize];
        let ring: [DVec3; MAX_VALENCE + 1] =
            std::array::from_fn(|i| if i < k { self.points[self.ring[i] as usize] } else { DVec3::ZERO });
        let fans = if closed { k } else { k - 1 };
        let mut normals = [(DVec3::ZERO, 0.0); MAX_VALENCE];
        for (i, normal) in normals[..fans].iter_mut().enumerate() {
            let cross = (ring[i] - p).cross(ring[if i + 1 == k { 0 } else { i + 1 }] - p);
            *normal = (cross, cross.length());
        }
        let mut best: Option<Choice> = None;
        for j in 0..k {
            if !closed && j != 0 && j != k - 1 {
                continue;
            }
            let least = best.map_or(f64::INFINITY, |b| b.0);
            let Some(cost) = cost_of(&ring[..k], &normals[..fans], p, j, least) else { continue };
            if check && !self.is_legal(v, self.ring[j], closed) {
                continue;
            }
            best = Some((cost, self.ring[j]));
        }
        best
    }

    /// Link condition: `u` and `v` have no neighbours in common but across their edge, and the disc does not fall apart.
    fn is_legal(&self, v: u32, u: u32, closed: bool) -> bool {
        let mut common: Vec<u32> = Vec::new();
        for &t in self.around[u as usize].iter().filter(|&&t| !self.dead[t as usize]) {
            for &w in &self.triangles[t as usize] {
                if w != u && w != v && self.ring.contains(&w) && !common.contains(&w) {
                    common.push(w);
                }
            }
        }
        if closed {
            return common.len() == 2;
        }
        // On the border the neighbour across must not be cut off, and one triangle must stay.
        common.len() == 1 && self.ring.len() > 2
    }
}

/// Height over the planes around `p`, and a little of the length, where `p` goes to corner `j` of the ring; `None` where a
/// triangle would turn too far, or where that is no less than `least`. `normals`: of the fans, and their lengths.
fn cost_of(ring: &[DVec3], normals: &[(DVec3, f64)], p: DVec3, j: usize, least: f64) -> Option<f64> {
    let (k, u) = (ring.len(), ring[j]);
    let step = u - p;
    let length2 = step.length_squared();
    let mut cost = 0.0;
    for &(normal, size) in normals {
        let height = normal.dot(step);
        let planes = if size > 0.0 { height * height / size } else { 0.0 };
        cost += planes + LENGTH_WEIGHT * size * length2;
    }
    if cost.is_nan() || cost >= least {
        return None;
    }
    for (i, &(normal, size)) in normals.iter().enumerate() {
        let next = if i + 1 == k { 0 } else { i + 1 };
        if i == j || next == j || size == 0.0 {
            continue;
        }
        let after = (ring[i] - u).cross(ring[next] - u);
        let along = after.dot(normal);
        if along <= 0.0 || along * along <= MIN_TURN_COSINE * MIN_TURN_COSINE * after.length_squared() * size * size {
            return None;
        }
    }
    Some(cost)
}
