//! From the finest mip of a tile to the coarser ones.
//!
//! A texel of mip m is the average of those texels of mip 0 that lie under it and in the chart that owns it; texels
//! without any take those of their chart around them. So no neighbour and no background comes into an average.

use super::color::{Coding, Texels, to_unorm};
use super::coverage::{Coverage, Level, MIN_SIZE, NOBODY, NONE, neighbours};
use super::veil::is_partial;
use glam::Vec4;
use std::ops::Deref;

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

    fn add(&mut self, other: &Part) {
        self.weight += other.weight;
        self.sum += other.sum;
    }
}

/// What the charts have under the texels of a mip.
enum Parts<'a> {
    /// Of the mip below the finest: added up whenever they are asked for, as they would be the longest list of all.
    Second { coverage: &'a Coverage, coding: Coding, finest: &'a Texels },
    /// Of texel i: from `first[i]` to `first[i + 1]`.
    Listed { size: u32, first: Vec<u32>, parts: Vec<Part> },
}

/// The parts under one texel.
enum Under<'a> {
    Added([Part; 4], usize),
    Listed(&'a [Part]),
}

impl Deref for Under<'_> {
    type Target = [Part];

    fn deref(&self) -> &[Part] {
        match self {
            Under::Added(parts, count) => &parts[..*count],
            Under::Listed(parts) => parts,
        }
    }
}

impl Parts<'_> {
    /// Texels per side.
    fn size(&self) -> u32 {
        match self {
            Parts::Second { coverage, .. } => coverage.size() / 2,
            Parts::Listed { size, .. } => *size,
        }
    }

    fn of(&self, texel: u32) -> Under<'_> {
        match self {
            Parts::Second { coverage, coding, finest } => {
                let (mut parts, mut count) = ([Part { chart: NONE, weight: 0.0, sum: Vec4::ZERO }; 4], 0);
                let under = under(coverage.size(), texel);
                for part in under.into_iter().filter_map(|t| first_part(coverage, *coding, finest, t)) {
                    match parts[..count].iter_mut().find(|p| p.chart == part.chart) {
                        Some(known) => known.add(&part),
                        None => {
                            parts[count] = part;
                            count += 1;
                        }
                    }
                }
                Under::Added(parts, count)
            }
            Parts::Listed { first, parts, .. } => {
                Under::Listed(&parts[first[texel as usize] as usize..first[texel as usize + 1] as usize])
            }
        }
    }

    /// The parts of the next coarser mip.
    fn halved(&self) -> Parts<'static> {
        let size = self.size() / 2;
        let (mut first, mut parts) = (vec![0], Vec::<Part>::new());
        for texel in 0..size * size {
            let begin = parts.len();
            for below in under(self.size(), texel).map(|t| self.of(t)) {
                for part in below.iter() {
                    match parts[begin..].iter_mut().find(|p| p.chart == part.chart) {
                        Some(known) => known.add(part),
                        None => parts.push(*part),
                    }
                }
            }
            first.push(parts.len() as u32);
        }
        Parts::Listed { size, first, parts }
    }
}

/// The four texels of a mip of `size` texels per side that lie under one of the next coarser.
fn under(size: u32, texel: u32) -> [u32; 4] {
    let (x, y) = (texel % (size / 2), texel / (size / 2));
    let corner = 2 * y * size + 2 * x;
    [corner, corner + 1, corner + size, corner + size + 1]
}

/// Fills what no chart owns in the finest mip and adds the coarser ones.
pub(super) fn coarser(coverage: &Coverage, coding: Coding, mut finest: Texels, cut_out: bool) -> Mips {
    finest.copy(coverage.levels[0].copies());
    let seen = if cut_out { seen_part(coverage, coding, &finest) } else { None };
    let mut levels = Vec::new();
    let mut parts = Parts::Second { coverage, coding, finest: &finest };
    for (mip, level) in coverage.levels.iter().enumerate().skip(1) {
        if mip > 1 {
            parts = parts.halved();
        }
        levels.push(resolved(level, coding, &parts, seen));
    }
    levels.insert(0, finest);
    if cut_out {
        color_holes(coding, &mut levels);
    }
    Mips { size: coverage.size(), coding, levels }
}

fn first_part(coverage: &Coverage, coding: Coding, finest: &Texels, texel: u32) -> Option<Part> {
    let chart = coverage.levels[0].owner[texel as usize];
    let weight = if coverage.triangles[texel as usize] == NOBODY { BORDER } else { 1.0 };
    let value = finest.get(coding, texel as usize);
    let sum = (value.truncate() * (value.w + FAINT)).extend(value.w) * weight;
    (chart != NOBODY).then_some(Part { chart: chart.into(), weight, sum })
}

/// The texels of a mip.
fn resolved(level: &Level, coding: Coding, parts: &Parts, seen: Option<f32>) -> Texels {
    // Asked for twice where there are holes: a list of all would take more than the texels themselves.
    let owned = || {
        let texels = (0..).zip(&level.owner).filter(|(_, chart)| **chart != NOBODY);
        texels.map(|(texel, &chart)| {
            let part = part_for(parts, texel, chart.into());
            (texel, part.map_or(0.0, |p| p.weight), part.map_or(Vec4::W, |p| p.value()))
        })
    };
    let gain = seen.map(|seen| alpha_gain(owned(), seen));
    let mut texels = Texels::zeros(coding, level.owner.len());
    for (texel, _, value) in owned() {
        let gain = gain.filter(|_| !is_partial(value.w));
        let alpha = gain.map_or(value.w, |gain| (value.w * gain).min(1.0));
        texels.set(coding, texel as usize, value.with_w(alpha));
    }
    texels.copy(level.copies());
    texels
}

/// What a chart has under a texel, else under those around it, else what any chart has there.
fn part_for(parts: &Parts, texel: u32, chart: u32) -> Option<Part> {
    let own = |t: u32| parts.of(t).iter().find(|p| p.chart == chart).copied();
    own(texel).or_else(|| {
        let around = || neighbours(parts.size(), texel);
        let sum = |a: Part, b: Part| Part { chart, weight: a.weight + b.weight, sum: a.sum + b.sum };
        let others = || std::iter::once(texel).chain(around()).flat_map(|t| parts.of(t).to_vec());
        around().filter_map(own).reduce(sum).or_else(|| others().max_by(|a, b| a.weight.total_cmp(&b.weight)))
    })
}

/// The part of the charts' area that is no hole; `None` without holes.
fn seen_part(coverage: &Coverage, coding: Coding, finest: &Texels) -> Option<f32> {
    let inside = || (0..finest.len()).filter(|&i| coverage.triangles[i] != NOBODY);
    let seen = inside().filter(|&i| finest.get(coding, i).w >= SEEN).count();
    let all = inside().count();
    (seen > 0 && seen < all).then(|| seen as f32 / all as f32)
}

/// What alpha is multiplied with so that the wanted part of the area is seen (Castaño 2010, "Computing alpha mipmaps").
fn alpha_gain(owned: impl Iterator<Item = (u32, f32, Vec4)>, seen: f32) -> f32 {
    let mut area = [0.0f32; 256];
    let alpha = |value: &Vec4| if is_partial(value.w) { 1.0 } else { value.w };
    owned.for_each(|(_, weight, value)| area[usize::from(to_unorm(alpha(&value)))] += weight);
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
