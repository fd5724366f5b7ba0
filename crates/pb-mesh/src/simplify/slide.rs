//! How far a collapse lets the texture slide over the surface (Cohen, Olano and Manocha 1998, "Appearance-preserving
//! simplification": the texture deviation).
//!
//! The point of a texel is where its (u, v) lies; after the collapse that is another point of the surface, or none
//! where a seam has moved inwards. Asked of the vertex that goes and of one point that each wedge remembers, as for the
//! distance of surfaces ([`Patch::reach`]).

use super::charts::Charts;
use super::patch::Patch;
use crate::closest::{closest_in_uv, closest_on_segment};
use glam::{Vec2, Vec3};

/// Squared slide of texture, in terms of the cost of planes. Larger ones spend the vertices on zigzags of seams.
const SLIDE_WEIGHT: f32 = 0.25;

/// A point of the input's surface and its texture coordinates, UV units: of those that the triangles around a wedge
/// stand for the one that slid furthest when it was last looked at; the wedge itself at first.
#[derive(Clone, Copy, Default, PartialEq)]
pub(super) struct UvWitness {
    pub uv: Vec2,
    pub at: Vec3,
}

impl Patch {
    /// Cost of the largest slide of texture when the fan's centre collapses onto `u`, squared quanta; its witnesses are
    /// kept. Zero without textures, and towards the first level as the distance of witnesses.
    pub(super) fn slide(&mut self, u: u32) -> f32 {
        if !self.watchful {
            return 0.0;
        }
        let Some(charts) = &self.input.charts else { return 0.0 };
        let Some(joined) = charts.joined(&self.fan.spokes, u) else { return f32::INFINITY };
        let mut found = joined.map(|_| (0.0, UvWitness::default()));
        for (k, pair) in joined.iter().enumerate() {
            found[k] = if k > 0 && *pair == joined[0] { found[0] } else { self.wedge_slide(charts, *pair, u) };
        }
        if joined[0][1] == joined[1][1] && found[0].0 > found[1].0 {
            found[1] = found[0];
        }
        let worst = found[0].0.max(found[1].0);
        let farthest = found.map(|f| f.1);
        self.input.charts.iter_mut().for_each(|c| c.farthest = farthest);
        worst * worst * SLIDE_WEIGHT
    }

    /// The largest slide where wedge `pair[0]` becomes `pair[1]`, at `u`, and its witness.
    fn wedge_slide(&self, charts: &Charts, pair: [u32; 2], u: u32) -> (f32, UvWitness) {
        let positions = &self.input.positions;
        let itself = |w: u32, v: u32| UvWitness { uv: charts.uv(w), at: positions[v as usize] };
        let (own, to) = (itself(pair[0], self.fan.center), itself(pair[1], u));
        let [behind, beyond] = pair.map(|w| charts.witness[w as usize]);
        let mut far = (0.0, to);
        let others = [(behind, behind != own), (beyond, beyond != to)];
        for (witness, _) in [(own, true)].into_iter().chain(others).filter(|w| w.1) {
            let slid = self.witness_slide(charts, pair, u, &witness);
            if slid > far.0 {
                far = (slid, witness);
            }
        }
        far.0 = far.0.max(Self::seam_shift(charts, pair));
        far
    }

    /// How far the texture at a witness slides.
    fn witness_slide(&self, charts: &Charts, pair: [u32; 2], u: u32, witness: &UvWitness) -> f32 {
        let v = self.fan.center;
        let spokes = self.fan.spokes.iter().zip(&charts.fan).filter(|(_, w)| w[0] == pair[0]);
        let kept = spokes.filter(|(s, _)| s.a != u && s.b != u).map(|(s, w)| ([pair[1], w[1], w[2]], s.a, s.b));
        let others = self.corners.numbered_around(u).filter(|(_, c)| c.a != v && c.b != v);
        let others = others.map(|(i, c)| (charts.of_triangle(i), c.a, c.b)).filter(|(w, ..)| w[0] == pair[1]);
        let mut best = (f32::INFINITY, f32::INFINITY);
        for (wedges, a, b) in kept.chain(others) {
            if charts.area(wedges) <= 0 {
                continue;
            }
            let (weights, square) = closest_in_uv(witness.uv, wedges.map(|w| charts.uv(w)));
            if square < best.0 {
                let corners = [u, a, b].map(|x| self.input.positions[x as usize]);
                let at = corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2];
                best = (square, at.distance(witness.at));
            }
            if square == 0.0 {
                break;
            }
        }
        if best.0 < f32::INFINITY {
            best.1 + best.0.sqrt() * charts.unit
        } else {
            self.vanishing_size(charts, pair[0], u)
        }
    }

    /// The distance of the fan's centre from where its triangles in the chart of wedge `own` shrink to, when all go.
    fn vanishing_size(&self, charts: &Charts, own: u32, u: u32) -> f32 {
        let positions = &self.input.positions;
        let (from, to) = (positions[self.fan.center as usize], positions[u as usize]);
        let gone = self.fan.spokes.iter().zip(&charts.fan).filter(|(_, w)| w[0] == own && charts.area(**w) > 0);
        let height = |x: u32| closest_on_segment(from, to, positions[x as usize]).distance(from);
        gone.map(|(s, _)| height(if s.a == u { s.b } else { s.a })).fold(0.0, f32::max)
    }

    /// How far the seam of the chart at wedge `pair[0]` moves in its tile, quanta; zero inside the chart.
    fn seam_shift(charts: &Charts, pair: [u32; 2]) -> f32 {
        let spokes = || charts.fan.iter().filter(|w| w[0] == pair[0]);
        // Where all triangles of the wedge go, so does its seam.
        if spokes().all(|w| w[1] == pair[1] || w[2] == pair[1]) {
            return 0.0;
        }
        let starts = spokes().map(|w| w[1]).filter(|&x| spokes().all(|o| o[2] != x));
        let ends = spokes().map(|w| w[2]).filter(|&x| spokes().all(|o| o[1] != x));
        let (mut count, mut next) = (0, None);
        for x in starts.chain(ends) {
            count += 1;
            next = if x == pair[1] { next } else { next.xor(Some(x)) };
        }
        let uv = |w: u32| charts.uv(w).extend(0.0);
        let distance = match (count, next) {
            (0, _) => return 0.0,
            (2, Some(end)) => closest_on_segment(uv(pair[0]), uv(pair[1]), uv(end)).distance(uv(pair[0])),
            _ => uv(pair[0]).distance(uv(pair[1])),
        };
        distance * charts.unit
    }
}
