//! The triangles around one vertex, laid out for the many questions that a collapse asks of them.

use super::corner_lists::NONE;
use super::patch::Patch;
use crate::closest::closest_on_triangle;
use glam::Vec3;

/// A triangle may turn by at most about 75 degrees in one collapse.
const MIN_TURN_COSINE: f32 = 0.25;

/// Squared distance of a witness, in terms of the cost of planes, which is near a mean.
const WITNESS_WEIGHT: f32 = 4.0;

/// A triangle of the fan: its two other vertices in its order, where they are from the centre, and its unit normal.
#[derive(Clone, Copy)]
pub(super) struct Spoke {
    pub a: u32,
    pub b: u32,
    at_a: Vec3,
    at_b: Vec3,
    /// Zero for triangles without area.
    normal: Vec3,
}

/// The living triangles around a vertex.
#[derive(Default)]
pub(super) struct Fan {
    pub center: u32,
    pub spokes: Vec<Spoke>,
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
        self.fan.center = v;
        self.fan.spokes.clear();
        let positions = &self.input.positions;
        let center = positions[v as usize];
        for c in self.corners.around(v) {
            let (at_a, at_b) = (positions[c.a as usize] - center, positions[c.b as usize] - center);
            let normal = at_a.cross(at_b);
            let length = normal.length();
            let normal = if length > 0.0 { normal / length } else { Vec3::ZERO };
            self.fan.spokes.push(Spoke { a: c.a, b: c.b, at_a, at_b, normal });
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
        let d = self.input.positions[u as usize] - self.input.positions[self.fan.center as usize];
        let mut most = 0f32;
        for s in &self.fan.spokes {
            if s.a == u || s.b == u || s.normal == Vec3::ZERO {
                continue;
            }
            let turned = (s.at_a - d).cross(s.at_b - d);
            let along = turned.dot(s.normal);
            if along <= 0.0 || along * along <= MIN_TURN_COSINE * MIN_TURN_COSINE * turned.length_squared() {
                return f32::INFINITY;
            }
            let height = s.normal.dot(d);
            most = most.max(height * height);
        }
        most
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
            let own = self.corners.around(u).filter(|c| c.a != v && c.b != v).map(|c| (c.a, c.b));
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
        far.0 * WITNESS_WEIGHT
    }
}
