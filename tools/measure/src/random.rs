//! Seeded numbers and noise: the same on every machine.

/// splitmix64.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed)
    }

    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mixed(self.0)
    }

    /// Uniform in `0.0..1.0`.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// One number from another, as good as at random.
pub fn mixed(x: u64) -> u64 {
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Value noise on a unit lattice, smooth, in `-1.0..1.0`.
pub fn noise(p: [f64; 3], seed: u64) -> f64 {
    let cell = p.map(|x| x.floor() as i64);
    let smooth = |k: usize| {
        let t = p[k] - p[k].floor();
        t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
    };
    let w: [f64; 3] = std::array::from_fn(smooth);
    let corner = |i: u32| {
        let at: [i64; 3] = std::array::from_fn(|k| cell[k] + (i >> k & 1) as i64);
        let key = at.iter().fold(seed, |h, &c| mixed(h ^ c as u64).wrapping_add(0x9e37_79b9_7f4a_7c15));
        let weight: f64 = (0..3).map(|k| if i >> k & 1 == 1 { w[k] } else { 1.0 - w[k] }).product();
        weight * ((mixed(key) >> 11) as f64 / (1u64 << 52) as f64 - 1.0)
    };
    (0..8).map(corner).sum()
}

/// Sum of octaves of noise, each of twice the frequency and `gain` times the amplitude of the last.
pub fn octaves(p: [f64; 3], seed: u64, count: u32, gain: f64) -> f64 {
    (0..count).map(|o| noise(p.map(|x| x * f64::from(1 << o)), seed ^ u64::from(o) << 32) * gain.powi(o as i32)).sum()
}
