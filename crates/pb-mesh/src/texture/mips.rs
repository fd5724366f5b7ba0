//! From the finest mip of a tile to the coarser ones.
//!
//! A texel of mip m is the average of those texels of mip 0 that lie under it and in the chart that owns it; texels
//! without any take those of their chart around them. So no neighbour and no background comes into an average.

use super::color::{Coding, Texels, to_unorm};
use super::coverage::{Coverage, Level, MIN_SIZE, NONE, neighbours};
use glam::Vec4;

/// Weight of a texel of mip 0 whose centre is outside its chart: decides only where nothing else does.
const BORDER: f32 = 1.0 / 4096.0;
/// Weight of colour under zero alpha, likewise.
const FAINT: f32 = 1e-6;
/// The least and the most that alpha is multiplied with to keep the area of holes.
const ALPHA_GAIN: std::ops::RangeInclusive<f32> = 0.5..=4.0;
/// Alpha from which on a texel is seen.
const SEEN: f32 = 127.5 / 255.0;

/// The mip chain of one map of a tile.
#[derive(Clone, Debug, PartialEq)]
pub struct Mips {
    /// Texels per side of the finest mip, a power of two.
    pub size: u32,
    /// What the numbers mean.
    pub coding: Coding,
    /// Finest first, down to 4 texels per side; rows from the top.
    pub levels: Vec<Texels>,
}

impl Mips {
    /// One mip of one value.
    pub(super) fn constant(coding: Coding, value: Vec4) -> Mips {
        let mut texels = Texels::zeros(coding, (MIN_SIZE * MIN_SIZE) as usize);
        (0..texels.len()).for_each(|i| texels.set(coding, i, value));
        Mips { size: MIN_SIZE, coding, levels: vec![texels] }
    }

    /// Texels per side of a mip.
    pub fn side(&self, mip: usize) -> u32 {
        self.size >> mip
    }
}

/// What one chart has under one texel.
#[derive(Clone, Copy)]
struct Part {
    chart: u32,
    weight: f32,
    /// Colour times alpha and weight; alpha times weight. Of normals alpha is 1.
    sum: Vec4,
}

impl Part {
    fn value(&self) -> Vec4 {
        (self.sum / (self.sum.w + FAINT * self.weight)).truncate().extend(self.sum.w / self.weight)
    }
}

/// The parts of all texels of a mip.
struct Parts {
    size: u32,
    /// Of texel i: from `first[i]` to `first[i + 1]`.
    first: Vec<u32>,
    parts: Vec<Part>,
}

impl Parts {
    fn of(&self, texel: u32) -> &[Part] {
        &self.parts[self.first[texel as usize] as usize..self.first[texel as usize + 1] as usize]
    }

    /// The parts of a mip of half the size, from what each texel of this one adds.
    fn halved(size: u32, mut add: impl FnMut(u32, &mut Vec<Part>)) -> Parts {
        let half = size / 2;
        let mut all = Parts { size: half, first: vec![0], parts: Vec::new() };
        let mut here = Vec::new();
        for y in 0..half {
            for x in 0..half {
                let corner = 2 * y * size + 2 * x;
                [corner, corner + 1, corner + size, corner + size + 1].into_iter().for_each(|t| add(t, &mut here));
                all.parts.append(&mut here);
                all.first.push(all.parts.len() as u32);
            }
        }
        all
    }
}

fn add_part(parts: &mut Vec<Part>, part: Part) {
    match parts.iter_mut().find(|p| p.chart == part.chart) {
        Some(p) => {
            p.weight += part.weight;
            p.sum += part.sum;
        }
        None => parts.push(part),
    }
}

/// Fills what no chart owns in the finest mip and adds the coarser ones.
pub(super) fn coarser(coverage: &Coverage, coding: Coding, mut finest: Texels, cut_out: bool) -> Mips {
    let size = coverage.size();
    finest.copy(&coverage.levels[0].copies);
    let seen = if cut_out { seen_part(coverage, coding, &finest) } else { None };
    let mut parts: Option<Parts> = None;
    let mut levels = vec![finest];
    for level in &coverage.levels[1..] {
        let next = match &parts {
            None => Parts::halved(size, |t, out| {
                first_part(coverage, coding, &levels[0], t).into_iter().for_each(|p| add_part(out, p))
            }),
            Some(p) => Parts::halved(p.size, |t, out| p.of(t).iter().for_each(|q| add_part(out, *q))),
        };
        levels.push(resolved(level, coding, &next, seen));
        parts = Some(next);
    }
    if cut_out {
        color_holes(coding, &mut levels);
    }
    Mips { size, coding, levels }
}

fn first_part(coverage: &Coverage, coding: Coding, finest: &Texels, texel: u32) -> Option<Part> {
    let chart = coverage.levels[0].owner[texel as usize];
    let weight = if coverage.triangles[texel as usize] == NONE { BORDER } else { 1.0 };
    let value = finest.get(coding, texel as usize);
    let sum = (value.truncate() * (value.w + FAINT)).extend(value.w) * weight;
    (chart != NONE).then_some(Part { chart, weight, sum })
}

/// The texels of a mip.
fn resolved(level: &Level, coding: Coding, parts: &Parts, seen: Option<f32>) -> Texels {
    let mut owned: Vec<(u32, f32, Vec4)> = Vec::new();
    for (texel, &chart) in level.owner.iter().enumerate().filter(|(_, c)| **c != NONE) {
        let part = part_for(parts, texel as u32, chart);
        owned.push((texel as u32, part.map_or(0.0, |p| p.weight), part.map_or(Vec4::W, |p| p.value())));
    }
    if let Some(seen) = seen {
        let gain = alpha_gain(&owned, seen);
        owned.iter_mut().for_each(|(_, _, value)| value.w = (value.w * gain).min(1.0));
    }
    let mut texels = Texels::zeros(coding, level.owner.len());
    owned.iter().for_each(|(texel, _, value)| texels.set(coding, *texel as usize, *value));
    texels.copy(&level.copies);
    texels
}

/// What a chart has under a texel, else under those around it, else what any chart has there.
fn part_for(parts: &Parts, texel: u32, chart: u32) -> Option<Part> {
    let own = |t: u32| parts.of(t).iter().find(|p| p.chart == chart).copied();
    own(texel).or_else(|| {
        let around = || neighbours(parts.size, texel);
        let sum = |a: Part, b: Part| Part { chart, weight: a.weight + b.weight, sum: a.sum + b.sum };
        let others = || parts.of(texel).iter().chain(around().flat_map(|t| parts.of(t)));
        around().filter_map(own).reduce(sum).or_else(|| others().max_by(|a, b| a.weight.total_cmp(&b.weight)).copied())
    })
}

/// The part of the charts' area that is no hole; `None` without holes.
fn seen_part(coverage: &Coverage, coding: Coding, finest: &Texels) -> Option<f32> {
    let inside = || (0..finest.len()).filter(|&i| coverage.triangles[i] != NONE);
    let seen = inside().filter(|&i| finest.get(coding, i).w >= SEEN).count();
    let all = inside().count();
    (seen > 0 && seen < all).then(|| seen as f32 / all as f32)
}

/// What alpha is multiplied with so that the wanted part of the area is seen (Castaño 2010, "Computing alpha mipmaps").
fn alpha_gain(owned: &[(u32, f32, Vec4)], seen: f32) -> f32 {
    let mut area = [0.0f32; 256];
    owned.iter().for_each(|(_, weight, value)| area[usize::from(to_unorm(value.w))] += weight);
    let wanted = area.iter().sum::<f32>() * seen;
    let mut above = 0.0;
    for alpha in (1..=255).rev() {
        let with = above + area[alpha];
        if with >= wanted {
            // seen from this alpha on, or from the next that occurs, whichever comes nearer
            let next = (alpha + 1..=255).find(|&a| area[a] > 0.0).filter(|_| wanted - above < with - wanted);
            let gain = SEEN * 255.0 * 1.004 / next.unwrap_or(alpha) as f32;
            return gain.clamp(*ALPHA_GAIN.start(), *ALPHA_GAIN.end());
        }
        above = with;
    }
    1.0
}

/// Gives holes the colour of what is around them, from coarse to fine: interpolation must not bring in what the image
/// has under zero alpha.
fn color_holes(coding: Coding, levels: &mut [Texels]) {
    let last = levels.len() - 1;
    let seen = (0..levels[last].len()).map(|i| levels[last].get(coding, i));
    let sum: Vec4 = seen.map(|t| (t * t.w).with_w(t.w)).sum();
    for mip in (0..=last).rev() {
        let (fine, coarser) = levels.split_at_mut(mip + 1);
        let fine = &mut fine[mip];
        let side = fine.len().isqrt();
        for i in 0..fine.len() {
            if fine.get(coding, i).w == 0.0 {
                let parent = (i / side / 2) * (side / 2) + i % side / 2;
                let above = coarser.first().map_or(sum / sum.w.max(1e-6), |c| c.get(coding, parent));
                fine.set(coding, i, above.with_w(0.0));
            }
        }
    }
}
