//! Solids turned about an axis, with round or square sections: pillars, beams, fallen pieces. Closed at both ends.

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::f64::consts::{SQRT_2, TAU};

use super::field::octaves;
use super::profile::{Place, Profile};
use super::stone::{Exposure, Stone, ramp};
use super::topology::{Counts, End, Topology, Wedge, cap_counts, cap_vertices};
use super::{Rect, random_between};
use crate::random::Random;

/// Fewest columns, and fewest rows of quads from end to end.
const MIN_COLUMNS: f64 = 8.0;
const MIN_ROWS: f64 = 12.0;
/// Flutes need so many columns each to be seen.
const COLUMNS_PER_FLUTE: f64 = 4.0;
/// Width of the joint between two drums, m.
const JOINT: f64 = 0.006;

/// Grooves along a shaft, and the joints of its drums.
#[derive(Clone, Debug)]
pub struct Flutes {
    pub count: f64,
    /// m.
    pub depth: f64,
    /// Heights between which they run, m.
    pub heights: [f64; 2],
    /// Heights of joints, m.
    pub joints: Vec<f64>,
}

/// How a pillar has broken off.
#[derive(Clone, Copy, Debug)]
pub struct Break {
    /// Where the broken part begins, m along the outline.
    pub from: f64,
    /// Slope of the break along both horizontal axes.
    pub slope: [f64; 2],
}

/// A solid about the second of its own axes.
#[derive(Clone, Debug)]
pub struct Lathe {
    pub origin: DVec3,
    /// Its own axes in the world; a rotation.
    pub axes: DMat3,
    pub profile: Profile,
    /// Width of the section along its first and third axis, over the outline's.
    pub section: [f64; 2],
    /// Where one chart ends and the next begins, m along the outline, ascending.
    pub cuts: Vec<f64>,
    pub stone: Stone,
    pub flutes: Option<Flutes>,
    pub broken: Option<Break>,
    /// How much rain runs down it, 0 to 1.
    pub rain: f64,
}

/// A place of the surface before weather.
struct Spot {
    world: DVec3,
    /// Which way relief lifts it; about of length 1.
    outward: DVec3,
    place: Place,
    /// 0 on the sides of a square section, 1 at its corners.
    corner: f64,
}

/// Direction of a share of the way around a section, from its middle to its outline.
fn section(around: f64, square: f64) -> [f64; 2] {
    let (sin, cos) = (around * TAU).sin_cos();
    let reach = 1.0 + (1.0 / sin.abs().max(cos.abs()) - 1.0) * square;
    [cos * reach, sin * reach]
}

impl Lathe {
    /// Columns and rows for about so many triangles, with quads about as high as wide.
    pub fn size(&self, triangles: f64) -> [usize; 2] {
        let around = TAU * self.profile.mean_radius() * self.section[0].midpoint(self.section[1]);
        let columns = (triangles * around / (2.0 * self.profile.length())).sqrt();
        let columns = ((columns / 8.0).round() * 8.0).max(MIN_COLUMNS);
        let caps = 2.0 * cap_counts(columns as usize).triangles as f64;
        [columns as usize, ((triangles - caps) / (2.0 * columns)).round().max(MIN_ROWS) as usize]
    }

    /// First and last row of each chart of the sides.
    fn spans(&self, rows: usize) -> Vec<[usize; 2]> {
        let row = |cut: &f64| (cut / self.profile.length() * rows as f64).round() as usize;
        let mut ends: Vec<usize> = std::iter::once(0).chain(self.cuts.iter().map(row)).collect();
        ends.push(rows);
        for i in 1..ends.len() {
            ends[i] = ends[i].clamp(ends[i - 1] + 1, rows + 1 + i - ends.len());
        }
        ends.windows(2).map(|w| [w[0], w[1]]).collect()
    }

    pub fn counts(&self, [columns, rows]: [usize; 2]) -> Counts {
        let (n, caps) = (columns as u64, cap_counts(columns));
        let lines = rows as u64 + 1 + self.cuts.len() as u64;
        Counts {
            positions: n * (rows as u64 + 1) + 2 * caps.positions,
            wedges: (n + 1) * lines + 2 * caps.wedges,
            triangles: 2 * n * rows as u64 + 2 * caps.triangles,
        }
    }

    /// `cells`: where the charts of the sides, of the first cap and of the last lie.
    pub fn topology(&self, [columns, rows]: [usize; 2], cells: &[Rect]) -> Topology {
        let mut topology = Topology::with_room_for(self.counts([columns, rows]));
        let spans = self.spans(rows);
        for (&[from, to], cell) in spans.iter().zip(cells) {
            topology.grid(columns, to - from, |i, j| Wedge {
                position: ((from + j) * columns + i % columns) as u32,
                uv: cell.at([i as f64 / columns as f64, j as f64 / (to - from) as f64]),
            });
        }
        let inner = columns * (rows + 1);
        let ends = [(End::First, 0, inner), (End::Last, rows, inner + cap_counts(columns).positions as usize)];
        for ((end, row, inner), cell) in ends.into_iter().zip(&cells[spans.len()..]) {
            let square = self.profile.at(self.profile.length() * row as f64 / rows as f64).point.square;
            let uv = |k: usize, share: f64| {
                cell.at(section(k as f64 / columns as f64, square).map(|x| 0.5 + 0.5 / SQRT_2 * share * x))
            };
            topology.cap(columns, end, (|k| (row * columns + k) as u32, inner as u32), uv);
        }
        topology
    }

    pub fn positions(&self, [columns, rows]: [usize; 2]) -> Vec<[f32; 3]> {
        let edges = self.profile.length() / rows as f64;
        let flutes = self.flutes.as_ref().map_or(1.0, |f| f.count);
        let shown = ramp(COLUMNS_PER_FLUTE / 2.0, COLUMNS_PER_FLUTE, columns as f64 / flutes);
        let line = |j: usize| {
            (0..columns).map(move |i| self.point([i as f64 / columns as f64, j as f64 / rows as f64], edges, shown))
        };
        let mut all: Vec<[f32; 3]> = Vec::with_capacity(self.counts([columns, rows]).positions as usize);
        all.par_extend((0..=rows).into_par_iter().flat_map_iter(line));
        for row in [0, rows] {
            let outer = all[row * columns..(row + 1) * columns].to_vec();
            all.extend(cap_positions(&outer, None));
        }
        all
    }

    fn spot(&self, [around, along]: [f64; 2]) -> Spot {
        let place = self.profile.at(along * self.profile.length());
        let (point, direction) = (place.point, section(around, place.point.square));
        let out = section(around, 0.0);
        let local = DVec3::new(
            direction[0] * point.radius * self.section[0],
            point.height,
            direction[1] * point.radius * self.section[1],
        );
        let outward = DVec3::new(out[0] * place.normal[0], place.normal[1], out[1] * place.normal[0]);
        let corner = point.square * ((direction[0].hypot(direction[1]) - 1.0) / (SQRT_2 - 1.0)).clamp(0.0, 1.0);
        Spot { world: self.origin + self.axes * local, outward: self.axes * outward, place, corner }
    }

    /// Weather, flutes and joints. `shown`: how much of the flutes the mesh can show.
    fn relief(&self, spot: &Spot, around: f64, edges: f64, shown: f64) -> f64 {
        let (groove, arris, joint) = self.fluting(spot, around, edges);
        let edge = spot.place.edge.max(0.9 * spot.corner.powi(4)).max(0.45 * arris);
        let relief = self.stone.relief(spot.world, edges, edge);
        let depth = self.flutes.as_ref().map_or(0.0, |f| f.depth);
        relief - shown * depth * groove - 0.012 * joint
    }

    /// Depth within a flute, nearness to the ridge between two, and to a joint: each 0 to 1.
    fn fluting(&self, spot: &Spot, around: f64, edges: f64) -> (f64, f64, f64) {
        let Some(flutes) = &self.flutes else { return (0.0, 0.0, 0.0) };
        let height = spot.place.point.height;
        let [low, high] = flutes.heights;
        let runs = ramp(low, low + 0.12, height) * ramp(high, high - 0.1, height);
        let across = 2.0 * (around * flutes.count).fract() - 1.0;
        let width = JOINT.max(edges);
        let joint = flutes.joints.iter().map(|j| ramp(width, 0.0, (height - j).abs())).fold(0.0, f64::max);
        (runs * (1.0 - across * across), runs * ramp(0.7, 1.0, across.abs()), joint)
    }

    fn point(&self, at: [f64; 2], edges: f64, shown: f64) -> [f32; 3] {
        let spot = self.spot(at);
        let relief = self.relief(&spot, at[0], edges, shown);
        let p = spot.world + spot.outward * relief + self.axes.y_axis * self.fracture(&spot, at[1]);
        p.to_array().map(|x| x as f32)
    }

    /// How far the break lies along the axis, m.
    fn fracture(&self, spot: &Spot, along: f64) -> f64 {
        let Some(Break { from, slope }) = self.broken else { return 0.0 };
        let p = spot.world - self.origin;
        let rough = 0.22 * octaves((spot.world * 2.2).to_array(), self.stone.seed ^ 9, 6, 0.5);
        ramp(from - 0.5, from, along * self.profile.length()) * (slope[0] * p.x + slope[1] * p.z + rough)
    }

    /// sRGB at a place of a chart of a mesh with so many rows.
    pub fn color(&self, rows: usize, piece: usize, [a, b]: [f64; 2]) -> [f64; 3] {
        let spans = self.spans(rows);
        if let Some([from, to]) = spans.get(piece) {
            let at = [a, (*from as f64 + b * (to - from) as f64) / rows as f64];
            let spot = self.spot(at);
            let (groove, _, joint) = self.fluting(&spot, at[0], 0.0);
            let (_, wear) = self.stone.wounds(spot.world);
            let dirt = (wear + 0.35 * groove * groove + 0.8 * joint).min(1.0);
            return self.stone.color(spot.world, Exposure { up: spot.outward.y, dirt, rain: self.rain });
        }
        let (along, side) = if piece == spans.len() { (0.0, -1.0) } else { (self.profile.length(), 1.0) };
        let point = self.profile.at(along).point;
        let [x, z] = [a, b].map(|c| (2.0 * c - 1.0) * SQRT_2 * point.radius);
        let world = self.origin + self.axes * DVec3::new(x * self.section[0], point.height, z * self.section[1]);
        let exposure = Exposure { up: side * self.axes.y_axis.y, dirt: self.stone.wounds(world).1, rain: 0.0 };
        self.stone.color(world, exposure)
    }
}

/// The positions of a cap within a ring; its middle at a height, else as high as the ring.
pub fn cap_positions(outer: &[[f32; 3]], height: Option<f64>) -> impl Iterator<Item = [f32; 3]> {
    let at = |k: usize| DVec3::from_array(outer[k].map(f64::from));
    let middle = (0..outer.len()).map(at).sum::<DVec3>() / outer.len() as f64;
    let middle = middle.with_y(height.unwrap_or(middle.y));
    cap_vertices(outer.len()).map(move |(k, share)| middle.lerp(at(k), share).to_array().map(|x| x as f32))
}

/// A pillar that stands at a place: base, fluted shaft and capital, or what is left of it.
pub fn pillar(foot: DVec3, seed: u64, broken: bool) -> Lathe {
    let mut random = Random::new(seed);
    let mut between = |low: f64, high: f64| random_between(&mut random, low, high);
    let scale = between(0.97, 1.03);
    let top = between(2.2, 5.0);
    let mut corners: Vec<[f64; 3]> = PILLAR.iter().map(|&[r, h, q]| [r * scale, h, q]).collect();
    if broken {
        corners.retain(|c| c[1] < top - 0.2);
        let radius = corners[corners.len() - 1][0] * 0.985;
        corners.extend([[radius, top, 0.0], [0.1 * radius, top + 0.02, 0.0]]);
    }
    let profile = Profile::new(&corners, 0.03);
    let ends = if broken { top } else { SHAFT[1] };
    let mut joints = vec![SHAFT[0] + between(0.5, 1.0)];
    while joints[joints.len() - 1] < ends - 0.9 {
        joints.push(joints[joints.len() - 1] + between(0.8, 1.6));
    }
    joints.retain(|j| *j < ends - 0.3);
    let heights: &[f64] = if broken { &[SHAFT[0]] } else { &[SHAFT[0], SHAFT[0].midpoint(SHAFT[1]), SHAFT[1]] };
    let turn = DMat3::from_rotation_y(between(-0.03, 0.03));
    let lean = DMat3::from_rotation_x(between(-0.008, 0.008)) * DMat3::from_rotation_z(between(-0.008, 0.008));
    let slope = [between(-0.5, 0.5), between(-0.5, 0.5)];
    Lathe {
        origin: foot,
        axes: lean * turn,
        cuts: heights.iter().map(|h| profile.length_at_height(*h)).collect(),
        broken: broken.then(|| Break { from: profile.length_at_height(top - 0.03), slope }),
        section: [1.0; 2],
        stone: Stone::new(seed ^ 0x5eed),
        flutes: Some(Flutes { count: 20.0, depth: 0.035 * scale, heights: [0.86, SHAFT[1] - 0.03], joints }),
        rain: 1.0,
        profile,
    }
}

/// Heights at which the shaft begins and ends, m.
const SHAFT: [f64; 2] = [0.9, 6.35];
/// Height of a pillar's top, m.
pub const PILLAR_TOP: f64 = 7.1;
/// An Attic base, a shaft that swells, and a Doric capital: radius, height, square.
const PILLAR: [[f64; 3]; 34] = [
    [0.74, -0.06, 1.0],
    [0.74, 0.27, 1.0],
    [0.705, 0.285, 0.8],
    [0.67, 0.29, 0.0],
    [0.715, 0.31, 0.0],
    [0.735, 0.36, 0.0],
    [0.715, 0.41, 0.0],
    [0.65, 0.435, 0.0],
    [0.605, 0.46, 0.0],
    [0.59, 0.50, 0.0],
    [0.61, 0.54, 0.0],
    [0.645, 0.555, 0.0],
    [0.66, 0.59, 0.0],
    [0.645, 0.625, 0.0],
    [0.595, 0.645, 0.0],
    [0.555, 0.67, 0.0],
    [0.525, 0.76, 0.0],
    [0.52, 0.9, 0.0],
    [0.518, 2.2, 0.0],
    [0.505, 3.6, 0.0],
    [0.475, 5.0, 0.0],
    [0.445, 6.2, 0.0],
    [0.44, 6.35, 0.0],
    [0.46, 6.38, 0.0],
    [0.46, 6.42, 0.0],
    [0.44, 6.45, 0.0],
    [0.45, 6.52, 0.0],
    [0.51, 6.61, 0.0],
    [0.60, 6.70, 0.0],
    [0.645, 6.77, 0.0],
    [0.64, 6.83, 0.0],
    [0.68, 6.845, 0.9],
    [0.70, 6.86, 1.0],
    [0.70, PILLAR_TOP, 1.0],
];

/// A beam along x from one pillar's middle to the next.
pub fn beam(from: DVec3, length: f64, seed: u64) -> Lathe {
    let sink = -0.06 - 0.03 * Random::new(seed).unit();
    let profile = Profile::new(
        &[[0.96, 0.004, 1.0], [1.0, 0.03, 1.0], [1.0, length - 0.03, 1.0], [0.96, length - 0.004, 1.0]],
        0.03,
    );
    Lathe {
        origin: from + DVec3::new(0.0, 0.4 + sink, 0.0),
        axes: DMat3::from_cols(DVec3::Y, DVec3::X, DVec3::NEG_Z),
        profile,
        section: [0.4, 0.52],
        cuts: Vec::new(),
        stone: Stone::new(seed ^ 0xbea),
        flutes: None,
        broken: None,
        rain: 0.8,
    }
}

/// A piece that has fallen: half of a drum or a block, lying on the ground.
pub fn debris(foot: DVec3, seed: u64) -> Lathe {
    let mut random = Random::new(seed);
    let mut between = |low: f64, high: f64| random_between(&mut random, low, high);
    let (radius, length, square) = (between(0.26, 0.46), between(0.4, 0.95), between(-0.5, 1.0).max(0.0));
    let (sin, cos) = between(0.0, TAU).sin_cos();
    let along = DVec3::new(cos, between(-0.12, 0.12), sin).normalize();
    let up = (DVec3::Y - along * along.y).normalize();
    let end = 0.12 * radius;
    let corners =
        [[end, 0.0, square], [0.93 * radius, 0.03, square], [radius, length, square], [end, length + 0.04, square]];
    let profile = Profile::new(&corners, 0.07);
    Lathe {
        origin: foot + DVec3::Y * (0.82 * radius) - along * (length / 2.0),
        axes: DMat3::from_cols(up, along, up.cross(along)),
        profile,
        section: [1.0, between(0.8, 1.1)],
        cuts: Vec::new(),
        stone: Stone::new(seed ^ 0xdeb),
        flutes: None,
        broken: None,
        rain: 0.4,
    }
}
