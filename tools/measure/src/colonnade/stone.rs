//! What weather does to stone: relief that grows finer with the mesh, and stains, as functions of the place.

use glam::DVec3;

use super::field::{noise, octaves};
use crate::random::{Random, mixed};

/// Waves per metre of the coarsest relief.
const COARSE_WAVES: f64 = 1.1;
/// Most octaves of relief: waves of under a millimetre.
const MAX_OCTAVES: u32 = 11;

/// One block of stone, unlike all others.
#[derive(Clone, Debug)]
pub struct Stone {
    pub seed: u64,
    /// sRGB, 0 to 1.
    tint: [f64; 3],
    /// Height of the coarsest relief, m.
    rough: f64,
    /// How far chips go into edges, m.
    chips: f64,
    /// How high moss grows from the ground, m.
    moss: f64,
    /// How dark rain has left it, 0 to 1.
    stains: f64,
}

/// What colours depend on, beside the place.
#[derive(Clone, Copy, Debug)]
pub struct Exposure {
    /// Upward part of the outward direction.
    pub up: f64,
    /// 0 to 1.
    pub dirt: f64,
    /// 0 to 1: how much rain runs down here.
    pub rain: f64,
}

/// 0 below `from`, 1 above `to`, smooth between; also for `from` above `to`.
pub fn ramp(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Between two colours.
pub fn blend(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    std::array::from_fn(|k| a[k] + (b[k] - a[k]) * t)
}

/// Noise at so many waves per metre.
pub fn waves(p: DVec3, per_metre: f64, seed: u64) -> f64 {
    noise((p * per_metre).to_array(), seed)
}

/// Octaves of `coarsest` waves per metre that a mesh with such edges can show.
pub fn octave_count(coarsest: f64, edge: f64) -> u32 {
    ((0.5 / (edge * coarsest)).log2().floor() + 1.0).clamp(1.0, f64::from(MAX_OCTAVES)) as u32
}

impl Stone {
    pub fn new(seed: u64) -> Stone {
        let mut random = Random::new(mixed(seed));
        let mut between = |low: f64, high: f64| low + (high - low) * random.unit();
        let (warm, light) = (between(0.0, 1.0), between(0.88, 1.06));
        let tint = blend([0.80, 0.76, 0.70], [0.80, 0.70, 0.55], warm).map(|c| c * light);
        Stone {
            seed,
            tint,
            rough: between(0.008, 0.02),
            chips: between(0.03, 0.09),
            moss: between(0.2, 1.1),
            stains: between(0.3, 1.0),
        }
    }

    /// How far the surface lies out at a place, for a mesh with such edges, m. `edge`: 0 on faces, 1 on sharp edges.
    pub fn relief(&self, p: DVec3, edges: f64, edge: f64) -> f64 {
        let weather = octaves((p * COARSE_WAVES).to_array(), self.seed, octave_count(COARSE_WAVES, edges), 0.5);
        let chip = ramp(0.0, 0.6, waves(p, 2.9, self.seed ^ 1)) * edge;
        let (wounds, _) = self.wounds(p);
        self.rough * weather - self.chips * chip - 0.012 * wounds
    }

    /// Cracks and pits, 0 to 1, and the dirt in them.
    pub fn wounds(&self, p: DVec3) -> (f64, f64) {
        let crack = ramp(0.035, 0.0, waves(p, 0.9, self.seed ^ 2).abs()) * ramp(0.1, 0.3, waves(p, 0.6, self.seed ^ 3));
        let pit = ramp(0.34, 0.6, waves(p, 27.0, self.seed ^ 4)) * ramp(-0.3, 0.4, waves(p, 1.9, self.seed ^ 5));
        (crack + 0.4 * pit, (0.7 * crack + 0.55 * pit).min(1.0))
    }

    /// sRGB at a place.
    pub fn color(&self, p: DVec3, exposure: Exposure) -> [f64; 3] {
        let Exposure { up, dirt, rain } = exposure;
        let seed = self.seed;
        let mottle = octaves((p * 1.7).to_array(), seed ^ 21, 3, 0.6);
        let vein = 1.0 - (waves(p, 1.3, seed ^ 22) + 0.35 * mottle).abs();
        let fine = waves(p, 34.0, seed ^ 23) + 0.7 * waves(p, 90.0, seed ^ 24);
        let shade = 1.0 + 0.13 * mottle - 0.16 * vein.powi(14) + 0.05 * fine;
        let mut color = self.tint.map(|c| c * shade);
        color = blend(color, [0.62, 0.47, 0.30], 0.30 * ramp(0.1, 0.7, waves(p, 0.7, seed ^ 25)));
        if rain > 0.0 {
            let streak = noise([p.x * 7.0, p.y * 0.35, p.z * 7.0], seed ^ 26) + 0.3 * mottle;
            color = blend(color, [0.19, 0.17, 0.15], 0.75 * self.stains * rain * ramp(-0.05, 0.6, streak));
        }
        let lichen = ramp(0.30, 0.42, waves(p, 4.1, seed ^ 27) * 0.7 + fine * 0.14);
        let patch = if waves(p, 1.0, seed ^ 28) > 0.0 { [0.74, 0.56, 0.24] } else { [0.66, 0.67, 0.58] };
        color = blend(color, patch, 0.65 * lichen * ramp(-0.6, 0.5, up + mottle));
        color = blend(color, [0.16, 0.14, 0.11], 0.6 * dirt);
        let damp = self.moss * (1.0 + 0.9 * mottle) + 0.35 * up.max(0.0) - p.y;
        let moss = ramp(0.0, 0.5, damp + 0.25 * fine) * ramp(-0.5, 0.1, up + 0.5 * dirt + 0.4 * mottle);
        blend(color, [0.25, 0.29, 0.11].map(|c| c * (1.0 + 0.3 * fine)), 0.85 * moss)
    }
}
