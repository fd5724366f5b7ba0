//! The triangles around one vertex, laid out for the many questions that a collapse asks of them: four side by side.

use super::corner_lists::NONE;
use super::patch::Patch;
use crate::closest::closest_on_triangle;
use glam::{Vec3, Vec4};

/// A triangle may turn by at most about 75 degrees in one collapse.
const MIN_TURN_COSINE: f32 = 0.25;

/// Triangles that are worked on at a time.
pub(super) const LANES: usize = 4;

/// Most vertices of a patch: their numbers are exact in f32, where those of four triangles are compared at once.
pub(super) const MAX_VERTICES: usize = 1 << 24;

/// A triangle of the fan: its two other vertices in its order.
#[derive(Clone, Copy)]
pub(super) struct Spoke {
    pub a: u32,
    pub b: u32,
}

/// Four vectors, one per lane.
pub(super) type Wide = [Vec4; 3];

/// Four triangles of the fan, in the order of the spokes; the rest of the last ones is empty.
#[derive(Clone, Copy, Default)]
pub(super) struct Lanes {
    /// Numbers of the vertices.
    a: Vec4,
    b: Vec4,
    /// Where they are from the centre.
    pub at_a: Wide,
    at_b: Wide,
    /// Normals as long as the doubled area, and one over their squared length; zero for triangles without area.
    normal: Wide,
    inverse: Vec4,
}

/// The living triangles around a vertex.
#[derive(Clone, Default)]
pub(super) struct Fan {
    pub center: u32,
    pub spokes: Vec<Spoke>,
    pub lanes: Vec<Lanes>,
}

impl Fan {
    /// The neighbours that the fan starts with and ends with, if it is one open run.
    pub fn ends(&self) -> Option<[u32; 2]> {
        let mut ends = [NONE; 2];
        for s in &self.spokes {
            if !self.spokes.iter().any(|o| o.b == s.a) && std::mem::replace(&mut ends[0], s.a) != NONE {
                return None;
            }
            if !self.spokes.iter().any(|o| o.a == s.b) && std::mem::replace(&mut ends[1], s.b) != NONE {
                return None;
            }
        }
        (ends[0] != NONE && ends[1] != NONE).then_some(ends)
    }
}

impl Patch {
    /// Lays out the fan of `v`.
    pub(super) fn spread(&mut self, v: u32) {
        let Fan { center, spokes, lanes } = &mut self.fan;
        *center = v;
        spokes.clear();
        lanes.clear();
        let positions = &self.input.positions;
        let origin = positions[v as usize];
        for c in self.corners.around(v) {
            let lane = spokes.len() % LANES;
            if lane == 0 {
                lanes.push(Lanes::default());
            }
            let last = lanes.last_mut().expect("one was pushed");
            (last.a[lane], last.b[lane]) = (c.a as f32, c.b as f32);
            let (at_a, at_b) = (positions[c.a as usize] - origin, positions[c.b as usize] - origin);
            for k in 0..3 {
                (last.at_a[k][lane], last.at_b[k][lane]) = (at_a[k], at_b[k]);
            }
            spokes.push(Spoke { a: c.a, b: c.b });
        }
        for l in lanes {
            l.normal = cross(l.at_a, l.at_b);
            let square = dot(l.normal, l.normal);
            l.inverse = Vec4::select(square.cmpgt(Vec4::ZERO), square.recip(), Vec4::ZERO);
        }
        if let Some(charts) = &mut self.input.charts {
            charts.spread(&self.corners, v);
        }
    }

    /// Largest squared distance of `u` from the planes of the fan; infinite when a triangle would turn over as the centre
    /// moves to `u`, on the surface or in its chart, or a chart would be torn.
    pub(super) fn turn(&self, u: u32) -> f32 {
        if self.input.charts.as_ref().is_some_and(|c| !c.allow(&self.fan.spokes, u)) {
            return f32::INFINITY;
        }
        let d = splat(self.input.positions[u as usize] - self.input.positions[self.fan.center as usize]);
        let gone = Vec4::splat(u as f32);
        let mut most = Vec4::ZERO;
        for l in &self.fan.lanes {
            let kept = l.a.cmpne(gone) & l.b.cmpne(gone) & l.inverse.cmpgt(Vec4::ZERO);
            let turned = cross(minus(l.at_a, d), minus(l.at_b, d));
            let along = dot(turned, l.normal);
            let least = dot(turned, turned) * (MIN_TURN_COSINE * MIN_TURN_COSINE);
            let over = along.cmple(Vec4::ZERO) | (along * l.inverse * along).cmple(least);
            if (kept & over).any() {
                return f32::INFINITY;
            }
            let height = dot(l.normal, d);
            most = most.max(Vec4::select(kept, height * height * l.inverse, Vec4::ZERO));
        }
        most.max_element()
    }

    /// Cost of the largest distance of the witnesses of the fan's centre and of `u` from the triangles around `u` after the
    /// collapse; that witness is kept in `farthest`. The planes of a thin spike do not resist when its tip moves down; its
    /// tip does.
    pub(super) fn reach(&mut self, u: u32) -> f32 {
        if !self.watchful {
            return 0.0;
        }
        let positions = &self.input.positions;
        let (v, to) = (self.fan.center, positions[u as usize]);
        let (from, behind, beyond) = (positions[v as usize], self.witness[v as usize], self.witness[u as usize]);
        let mut far = (0.0, to);
        for w in
            [Some(from), (behind != from).then_some(behind), (beyond != to).then_some(beyond)].into_iter().flatten()
        {
            let kept = self.fan.spokes.iter().filter(|s| s.a != u && s.b != u).map(|s| (s.a, s.b));
            let own = self.corners.around(u).iter().filter(|c| c.a != v && c.b != v).map(|c| (c.a, c.b));
            let mut least = f32::INFINITY;
            for (a, b) in kept.chain(own) {
                let q = closest_on_triangle(w, [to, positions[a as usize], positions[b as usize]]);
                least = least.min(q.distance_squared(w));
                if least <= far.0 {
                    break;
                }
            }
            if least.is_finite() && least > far.0 {
                far = (least, w);
            }
        }
        self.farthest = far.1;
        far.0 * self.weights.witness
    }
}

fn splat(v: Vec3) -> Wide {
    [Vec4::splat(v.x), Vec4::splat(v.y), Vec4::splat(v.z)]
}

fn minus(a: Wide, b: Wide) -> Wide {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Four scalar products.
pub(super) fn dot(a: Wide, b: Wide) -> Vec4 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Wide, b: Wide) -> Wide {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
