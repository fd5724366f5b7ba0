//! How long a bake goes on: what each stage usually takes for so much work, corrected by what this machine took so far.
//!
//! No clock here: times are given, in seconds since the start.

use pb_lod::progressive_buffers::bake::{TexelOptions, TexelWork};
use pb_mesh::texture::Quality;

/// All stages, in their order.
const STAGES: [&str; 10] =
    ["read", "textures", "repair", "segment", "charts", "simplify", "measure", "pack", "texels", "write"];

/// What is known of the work; what is not yet, counts as in [`Forecast::usual`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Work {
    /// Of all inputs.
    pub input_bytes: u64,
    /// Of the scene.
    pub triangles: Option<u64>,
    /// Of all images; `None` without.
    pub image_texels: Option<u64>,
    /// How they are made.
    pub texel_options: TexelOptions,
    /// Known when the charts are made.
    pub texels: Option<TexelWork>,
}

/// Seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Remaining {
    /// Of the running stage.
    pub stage: f64,
    /// Of all.
    pub total: f64,
}

/// Share of a stage from which on its own speed is all that counts.
const SURE_SHARE: f64 = 0.25;
/// Stages this much faster than the slowest, measured by what is usual, were not made but found.
const FOUND: f64 = 0.3;

/// Follows a bake.
#[derive(Clone, Debug)]
pub struct Forecast {
    pub work: Work,
    threads: usize,
    /// Stages that ended, and how long they took.
    done: Vec<(&'static str, f64)>,
    now: Option<Now>,
}

#[derive(Clone, Copy, Debug)]
struct Now {
    stage: &'static str,
    start: f64,
    /// The last share that was told, and when.
    share: f64,
    told: f64,
}

impl Forecast {
    /// Nothing runs yet.
    pub fn new(work: Work, threads: usize) -> Self {
        Forecast { work, threads, done: Vec::new(), now: None }
    }

    /// A stage begins; the one before ends.
    pub fn begin(&mut self, stage: &'static str, at: f64) {
        if let Some(now) = self.now.replace(Now { stage, start: at, share: 0.0, told: at }) {
            self.done.push((now.stage, at - now.start));
        }
    }

    /// How much of the running stage is done, 0 to 1.
    pub fn tell(&mut self, share: f64, at: f64) {
        if let Some(now) = self.now.as_mut().filter(|now| share > now.share) {
            (now.share, now.told) = (share.min(1.0), at);
        }
    }

    /// Of the running stage.
    pub fn share(&self) -> f64 {
        self.now.map_or(0.0, |now| now.share)
    }

    /// Units per second of the running stage, and their name; `None` before anything is known.
    pub fn rate(&self) -> Option<(f64, &'static str)> {
        let now = self.now.filter(|now| now.told > now.start)?;
        let done = |count: u64| count as f64 * now.share / (now.told - now.start);
        match now.stage {
            "textures" => Some((done(self.work.image_texels?), "texels")),
            "texels" => Some((done(self.work.texels?.tile_texels), "texels")),
            _ => Some((done(self.work.triangles?), "triangles")),
        }
    }

    /// What is left at a time.
    pub fn remaining(&self, at: f64) -> Remaining {
        let Some(now) = self.now else { return Remaining::default() };
        let elapsed = at - now.start;
        let usual = self.usual(now.stage);
        let mut list: Vec<(f64, f64)> = self.done.iter().filter_map(|d| Some((d.1, self.paced(d.0)?))).collect();
        let before = pace(&list).unwrap_or(2.0 / self.threads as f64);
        let sure = (now.share / SURE_SHARE).min(1.0);
        let measured = if now.share > 0.0 { (now.told - now.start) / now.share } else { 0.0 };
        let whole = (sure * measured + (1.0 - sure) * usual * before).max(elapsed * 1.02);
        if sure == 1.0
            && let Some(usual) = self.paced(now.stage)
        {
            list.push((whole, usual));
        }
        let pace = pace(&list).unwrap_or(before);
        let later = STAGES.iter().skip_while(|s| **s != now.stage).skip(1).map(|s| self.usual(s)).sum::<f64>();
        let stage = whole - elapsed;
        Remaining { stage, total: stage + later * pace }
    }

    /// Seconds that a stage takes with two cores of a machine of 2026.
    fn usual(&self, stage: &str) -> f64 {
        let bytes = self.work.input_bytes as f64 * 1e-6;
        let triangles = self.work.triangles.map_or(bytes / 30.0, |t| t as f64 * 1e-6);
        let image_texels = self.work.image_texels.unwrap_or(0) as f64 * 1e-6;
        let textured = self.work.image_texels.is_some() || self.work.texels.is_some();
        // Of what is shown, tiles have about as many as images.
        let texels = |of: fn(TexelWork) -> u64| self.work.texels.map_or(image_texels, |t| of(t) as f64 * 1e-6);
        match stage {
            "read" => bytes * 0.003,
            "textures" => image_texels * 0.01,
            "repair" => triangles * 0.11,
            "segment" => triangles * 0.15,
            "charts" if textured => triangles * 0.45,
            "simplify" => triangles * if textured { 1.2 } else { 0.6 },
            "measure" => triangles * if textured { 1.45 } else { 0.25 },
            "pack" => triangles * 0.15,
            "texels" if textured => texels(|t| t.packed_texels) * self.seconds_per_million_texels(),
            "write" => triangles * 0.03 + texels(|t| t.tile_texels) * 0.001,
            _ => 0.0,
        }
    }

    /// Of packing them, all else included.
    fn seconds_per_million_texels(&self) -> f64 {
        let TexelOptions { quality, compress, .. } = self.work.texel_options;
        match quality {
            _ if !compress => 0.115,
            Quality::Fast => 0.18,
            Quality::Normal => 0.29,
            Quality::Best => 1.55,
        }
    }

    /// The same for stages that tell how fast the machine is; charts take several times as long where the source has no good ones.
    fn paced(&self, stage: &str) -> Option<f64> {
        let usual = self.usual(stage);
        (!matches!(stage, "read" | "textures" | "charts" | "write") && usual > 0.0).then_some(usual)
    }
}

/// How many times longer than usual it took, by what took how long instead of how long. Long stages count more, but no single
/// one decides.
fn pace(list: &[(f64, f64)]) -> Option<f64> {
    let slowest = list.iter().map(|(took, usual)| took / usual).fold(0.0, f64::max);
    let made = list.iter().filter(|(took, usual)| took / usual >= slowest * FOUND);
    let (sum, weight) = made.fold((0.0, 0.0), |sum, (took, usual)| (sum.0 + took / usual.sqrt(), sum.1 + usual.sqrt()));
    (weight > 0.0).then_some(sum / weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The worst error in the second half, as a share of what is left or of a twentieth of all, of a bake whose stages take so many times as long as usual.
    fn worst(work: Work, factor: impl Fn(&str) -> f64, tells: bool) -> f64 {
        let whole = Forecast::new(work, 2);
        let times: Vec<f64> = STAGES.iter().map(|s| whole.usual(s) * factor(s)).collect();
        let total: f64 = times.iter().sum();
        let mut forecast = Forecast::new(work, 2);
        let (mut at, mut worst) = (0.0, 0.0f64);
        for (stage, time) in STAGES.iter().zip(times).filter(|s| s.1 > 0.0) {
            forecast.begin(stage, at);
            for step in 0..100 {
                let now = at + time * f64::from(step) / 100.0;
                if tells {
                    forecast.tell(f64::from(step) / 100.0, now);
                }
                if now > total / 2.0 {
                    let error = (forecast.remaining(now).total - (total - now)).abs();
                    worst = worst.max(error / (total - now).max(total * 0.05));
                }
            }
            at += time;
        }
        worst
    }

    fn plain() -> Work {
        Work { input_bytes: 100 << 20, triangles: Some(4_000_000), ..Work::default() }
    }

    #[test]
    fn what_is_left_is_right_on_a_machine_of_any_speed() {
        let texels = TexelWork { tile_texels: 200_000_000, packed_texels: 90_000_000 };
        let textured = Work { image_texels: Some(60_000_000), texels: Some(texels), ..plain() };
        for work in [plain(), textured] {
            for speed in [0.1, 1.0, 7.0] {
                assert!(worst(work, |_| speed, true) < 0.15, "{}", worst(work, |_| speed, true));
            }
        }
    }

    #[test]
    fn stages_that_take_longer_than_usual_are_noticed() {
        for slow in STAGES {
            let error = worst(plain(), |s| if s == slow { 1.5 } else { 1.0 }, true);
            assert!(error < 0.3, "{slow}: {error}");
        }
        assert!(worst(plain(), |_| 3.0, false) < 0.1, "also without shares");
    }

    #[test]
    fn stages_that_were_found_do_not_count() {
        let mut forecast = Forecast::new(plain(), 2);
        for (stage, at) in [("read", 0.0), ("segment", 0.1), ("simplify", 4.1), ("measure", 4.12)] {
            forecast.begin(stage, at);
        }
        // The segmentation took several times as long as usual; the simplification was found.
        let slower = 4.0 / forecast.usual("segment");
        let expected = (forecast.usual("measure") + forecast.usual("pack") + forecast.usual("write")) * slower;
        let left = forecast.remaining(4.12).total;
        assert!((left / expected - 1.0).abs() < 0.1, "{left} {expected}");
    }
}
