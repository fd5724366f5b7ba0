//! Solids with a top that is a height field: the paving between the pillars, and steps down to hills around it.

use glam::DVec3;
use rayon::prelude::*;

use super::Rect;
use super::field::{noise, octaves};
use super::lathe::cap_positions;
use super::stone::{Exposure, Stone, blend, octave_count, ramp, waves};
use super::topology::{Counts, End, Topology, Wedge, cap_counts};
use crate::random::mixed;

/// Share of the chart that the sides of the solid take on each of its sides.
const SKIRT: f64 = 0.04;
/// How far the outermost line lies beyond its place, and below it, m: so that neighbours have no gap between them.
const TUCK: [f64; 2] = [0.015, 0.03];
/// Fewest quads each way.
const MIN_QUADS: f64 = 4.0;
/// Waves per metre of the coarsest relief of stone and of earth.
const COARSE_WAVES: f64 = 0.4;
/// Sides of a flagstone, m, and width of the joints between them.
const FLAG: [f64; 2] = [1.5, 1.0];
const JOINT: f64 = 0.012;
/// Steps around the paving: how many, how deep, how high, m.
const STEPS: u32 = 4;
const TREAD: f64 = 0.38;
const RISER: f64 = 0.17;
/// A riser is this much deeper at its foot, m.
const SLANT: f64 = 0.03;
/// Where the ground ends, m from the paving.
pub const REACH: f64 = 15.0;
/// Height of the sides, and of the middle of the bottom, m.
const SIDES: f64 = 0.5;
const BOTTOM: f64 = -3.2;

/// How the lines of one axis lie.
#[derive(Clone, Copy, Debug)]
pub enum Axis {
    /// Evenly from one coordinate to another.
    Even(f64, f64),
    /// From the edge of the paving outwards, up or down the axis: dense over the steps, then ever wider.
    Outward(f64, f64),
}

impl Axis {
    /// Coordinate at a share of the lines; ascending.
    fn at(self, share: f64) -> f64 {
        match self {
            Axis::Even(from, to) => from + (to - from) * share,
            Axis::Outward(edge, sign) => edge + sign * outward(if sign > 0.0 { share } else { 1.0 - share }),
        }
    }

    /// About how long the surface is along it, m: what quads are spread over.
    fn length(self) -> f64 {
        match self {
            Axis::Even(from, to) => to - from,
            Axis::Outward(..) => 9.0,
        }
    }
}

/// Distance from the paving at a share of the lines: two fifths of them go down the steps by arc length.
fn outward(share: f64) -> f64 {
    const STAIRS: f64 = 0.4;
    let depth = f64::from(STEPS) * TREAD;
    if share < STAIRS {
        let (step, rest) = ((share / STAIRS * f64::from(STEPS)).floor(), (share / STAIRS * f64::from(STEPS)).fract());
        let tread = (TREAD - SLANT) / (TREAD + RISER);
        let within = if rest < tread {
            rest / tread * (TREAD - SLANT)
        } else {
            TREAD - SLANT + (rest - tread) / (1.0 - tread) * SLANT
        };
        return step * TREAD + within;
    }
    let t = (share - STAIRS) / (1.0 - STAIRS);
    depth + (REACH - depth) * (0.35 * t + 0.65 * t * t)
}

/// What a part of the ground is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Flagstones.
    Paving,
    /// Steps, then earth and grass.
    Land,
}

/// One part of the ground.
#[derive(Clone, Debug)]
pub struct Ground {
    pub kind: Kind,
    pub x: Axis,
    pub z: Axis,
    /// Far corner of the paving; the near one is at 0, 0.
    pub paved: [f64; 2],
    pub stone: Stone,
    /// Of the whole scene: so that neighbours agree.
    pub seed: u64,
}

/// Flagstone at a place: its number, and the distance from its edge, m.
fn flag(x: f64, z: f64, seed: u64) -> (u64, f64) {
    let row = (z / FLAG[1]).floor();
    let shift = noise([0.5, row * 1.7 + 0.3, 0.5], seed) * FLAG[0];
    let column = ((x + shift) / FLAG[0]).floor();
    let (u, v) = ((x + shift) / FLAG[0] - column, z / FLAG[1] - row);
    let edge = (u.min(1.0 - u) * FLAG[0]).min(v.min(1.0 - v) * FLAG[1]);
    (mixed(mixed(seed ^ column as i64 as u64).wrapping_add(row as i64 as u64)), edge)
}

/// A number of a flagstone, 0 to 1.
fn share_of(number: u64, which: u64) -> f64 {
    (mixed(number ^ which) >> 11) as f64 / (1u64 << 53) as f64
}

impl Ground {
    /// Quads along x and z for about so many triangles.
    pub fn size(&self, triangles: f64) -> [usize; 2] {
        let columns = (triangles * self.x.length() / (2.0 * self.z.length())).sqrt().round().max(MIN_QUADS);
        // 2 per quad, and about 8 per line that ends at the border.
        let lines = ((triangles - 8.0 * columns) / (2.0 * columns + 8.0)).round().max(MIN_QUADS);
        [columns as usize, lines as usize]
    }

    pub fn counts(&self, [columns, lines]: [usize; 2]) -> Counts {
        let border = 2 * (columns + lines);
        let (n, m, border_count, cap) = (columns as u64, lines as u64, border as u64, cap_counts(border));
        Counts {
            positions: (n + 1) * (m + 1) + border_count + cap.positions,
            wedges: (n + 1) * (m + 1) + 2 * (border_count + 1) + cap.wedges,
            triangles: 2 * n * m + 2 * border_count + cap.triangles,
        }
    }

    /// `cells`: where the charts of the top with its sides, and of the bottom, lie.
    pub fn topology(&self, [columns, lines]: [usize; 2], cells: &[Rect]) -> Topology {
        let mut topology = Topology::with_room_for(self.counts([columns, lines]));
        let share = |[i, j]: [usize; 2]| [i as f64 / columns as f64, j as f64 / lines as f64];
        let top = |at: [usize; 2]| (at[1] * (columns + 1) + at[0]) as u32;
        let inside = |at| share(at).map(|s| SKIRT + (1.0 - 2.0 * SKIRT) * s);
        topology.grid(columns, lines, |i, j| Wedge { position: top([i, j]), uv: cells[0].at(inside([i, j])) });
        let border = border([columns, lines]);
        let (count, first) = (border.len(), ((columns + 1) * (lines + 1)) as u32);
        topology.grid(count, 1, |k, upper| {
            let at = border[k % count];
            match upper {
                0 => Wedge { position: first + (k % count) as u32, uv: cells[0].at(share(at)) },
                _ => Wedge { position: top(at), uv: cells[0].at(inside(at)) },
            }
        });
        let uv = |k: usize, scale: f64| cells[1].at(share(border[k]).map(|s| 0.5 + (s - 0.5) * scale));
        topology.cap(count, End::First, (|k| first + k as u32, first + count as u32), uv);
        topology
    }

    pub fn positions(&self, [columns, lines]: [usize; 2]) -> Vec<[f32; 3]> {
        let edges = (self.x.length() / columns as f64).max(self.z.length() / lines as f64);
        let at = |[i, j]: [usize; 2]| {
            let outside = |k: usize, n: usize| if k == 0 { -1.0 } else { f64::from(u8::from(k == n)) };
            let out = [outside(i, columns), outside(j, lines)];
            let x = self.x.at(i as f64 / columns as f64) + out[0] * TUCK[0];
            let z = self.z.at(j as f64 / lines as f64) + out[1] * TUCK[0];
            let y = self.height(x, z, edges) - if out == [0.0; 2] { 0.0 } else { TUCK[1] };
            DVec3::new(x, y, z)
        };
        let single = |p: DVec3| p.to_array().map(|x| x as f32);
        let line = |j: usize| (0..=columns).map(move |i| single(at([i, j])));
        let mut all: Vec<[f32; 3]> = Vec::with_capacity(self.counts([columns, lines]).positions as usize);
        all.par_extend((0..=lines).into_par_iter().flat_map_iter(line));
        let below = |&b: &[usize; 2]| single(at(b) - DVec3::Y * SIDES);
        let foot: Vec<[f32; 3]> = border([columns, lines]).iter().map(below).collect();
        let cap: Vec<[f32; 3]> =
            cap_positions(&foot, Some(if self.kind == Kind::Paving { -SIDES } else { BOTTOM })).collect();
        all.extend(foot);
        all.extend(cap);
        all
    }

    /// How far a place is from the paving, m, and how high the steps are there.
    fn steps(&self, x: f64, z: f64) -> (f64, f64) {
        let beyond = |c: f64, end: f64| (-c).max(c - end).max(0.0);
        let away = beyond(x, self.paved[0]).max(beyond(z, self.paved[1]));
        let down = |step: u32| {
            let foot = f64::from(step + 1) * TREAD;
            ramp(foot - SLANT, foot, away)
        };
        (away, -RISER * (0..STEPS).map(down).sum::<f64>())
    }

    /// Height of the surface, for a mesh with such edges, m.
    fn height(&self, x: f64, z: f64, edges: f64) -> f64 {
        let (away, step) = self.steps(x, z);
        let count = octave_count(COARSE_WAVES, edges);
        if self.kind == Kind::Paving {
            let (number, edge) = flag(x, z, self.seed);
            let lean = 0.016 * (share_of(number, 1) - 0.5) + 0.012 * (share_of(number, 2) - 0.5) * edge;
            let worn = 0.010 * octaves([x * 0.9, 0.2, z * 0.9], self.seed ^ 31, count, 0.55);
            let width = JOINT.max(0.8 * edges);
            return lean + worn - 0.018 * ramp(width, 0.25 * width, edge) - 0.006 * ramp(width * 3.0, 0.0, edge);
        }
        let stairs = f64::from(STEPS) * TREAD;
        let worn = 0.012 * octaves([x * 1.3, away, z * 1.3], self.seed ^ 32, count, 0.55);
        let far = (away - stairs).max(0.0);
        let hills = octaves([x * 0.07, 0.7, z * 0.07], self.seed ^ 33, count + 2, 0.5);
        let rise = ramp(3.0, REACH - stairs, far) * (2.6 + 2.5 * hills) + ramp(0.0, 6.0, far) * 0.35 * hills;
        step + worn + rise.max(-1.4)
    }

    /// sRGB at a place of a chart.
    pub fn color(&self, piece: usize, at: [f64; 2]) -> [f64; 3] {
        let [a, b] = if piece == 0 { at.map(|s| ((s - SKIRT) / (1.0 - 2.0 * SKIRT)).clamp(0.0, 1.0)) } else { at };
        let (x, z) = (self.x.at(a), self.z.at(b));
        let (away, step) = self.steps(x, z);
        let p = DVec3::new(x, step, z);
        let fine = waves(p, 40.0, self.seed ^ 41);
        let broad = octaves([x * 0.35, 0.0, z * 0.35], self.seed ^ 42, 4, 0.55);
        let stairs = f64::from(STEPS) * TREAD;
        let flags = || self.flags(p, fine, broad);
        if self.kind == Kind::Paving {
            return flags();
        }
        let riser = ramp(0.5 * TREAD, 0.0, (away / TREAD).fract().min(1.0 - (away / TREAD).fract()) * TREAD * 4.0);
        let stone = blend(flags(), [0.20, 0.18, 0.14], 0.35 * riser);
        let earth = blend([0.50, 0.41, 0.28], [0.62, 0.53, 0.38], 0.5 + 0.5 * fine + 0.4 * broad);
        let blades =
            noise([x * 28.0, 0.0, z * 28.0], self.seed ^ 43) + noise([x * 75.0, 0.0, z * 75.0], self.seed ^ 44);
        let grass = blend([0.27, 0.30, 0.12], [0.45, 0.44, 0.20], 0.5 + 0.35 * blades);
        let land = blend(earth, grass, ramp(-0.25, 0.2, broad + 0.12 * fine + 0.02 * (away - stairs)));
        blend(stone, land, ramp(-0.25, 0.25, away - stairs + 0.2 * broad))
    }

    fn flags(&self, p: DVec3, fine: f64, broad: f64) -> [f64; 3] {
        let (number, edge) = flag(p.x, p.z, self.seed);
        let (_, wear) = self.stone.wounds(p + DVec3::Y * (share_of(number, 3) * 9.0));
        let exposure = Exposure { up: 0.3, dirt: wear, rain: 0.0 };
        let lift = DVec3::Y * (2.0 + 3.0 * share_of(number, 4));
        let shade = 0.74 + 0.2 * share_of(number, 5) + 0.1 * broad;
        let mut color = self.stone.color(p + lift, exposure).map(|c| c * shade);
        color = blend(color, [0.52, 0.44, 0.31], 0.55 * ramp(0.0, 0.6, broad + 0.25 * fine));
        let joint = ramp(JOINT * 1.6, JOINT * 0.5, edge + 0.006 * fine);
        let filled = blend([0.17, 0.15, 0.11], [0.24, 0.28, 0.10], ramp(-0.1, 0.3, broad + 0.3 * fine));
        color = blend(color, filled, joint);
        blend(color, [0.26, 0.30, 0.11], 0.7 * ramp(0.12, 0.0, edge) * ramp(0.1, 0.45, broad + 0.35 * fine))
    }
}

/// Corners of a grid along its border, as a tube's last ring runs when its grid faces up.
fn border([columns, lines]: [usize; 2]) -> Vec<[usize; 2]> {
    let sides = (0..lines).map(|j| [columns, j]).chain((0..columns).map(|i| [columns - i, lines]));
    sides.chain((0..lines).map(|j| [0, lines - j])).chain((0..columns).map(|i| [i, 0])).collect()
}
