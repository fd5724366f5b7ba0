//! Small components that shrink to a point: below a level's error nobody misses them.

use super::patch::Patch;
use crate::topology::Kind;

impl Patch {
    /// Small components whose size is within `limit` (squared quanta) shrink to a point; at most `quota`
    /// vertices go. Returns how many went.
    pub fn vanish(&mut self, limit: f32, quota: usize) -> usize {
        let mut count = 0;
        while let Some(&(size, _)) = self.input.components.last() {
            if size > limit || count >= quota {
                break;
            }
            let (_, members) = self.input.components.pop().expect("just seen");
            let mut living = members.into_iter().filter(|&v| self.is_alive(v));
            let Some(point) = living.next() else { continue };
            let others: Vec<u32> = living.collect();
            self.corners.drop_around(point);
            others.iter().for_each(|&v| self.corners.drop_around(v));
            count += others.len();
            for v in others {
                self.bury_whole(v, point);
            }
            self.input.kinds[point as usize] = Kind::Locked;
            self.points.push(point);
        }
        count
    }

    fn bury_whole(&mut self, v: u32, parent: u32) {
        self.bury(v, parent);
        if let Some(charts) = &mut self.input.charts {
            charts.bury(v, parent);
        }
    }

    /// Points left by components that vanished at an earlier level die: nothing draws them any more.
    pub fn bury_points(&mut self) -> usize {
        let mut points = std::mem::take(&mut self.points);
        points.sort_unstable();
        let mut heirs: Vec<u32> = (0..self.living.len() as u32).filter(|&h| self.is_alive(h)).collect();
        if !points.is_empty() {
            heirs.retain(|h| points.binary_search(h).is_err());
        }
        let mut count = 0;
        for &v in &points {
            let p = self.input.positions[v as usize];
            let distance = |h: u32| self.input.positions[h as usize].distance_squared(p);
            match heirs.iter().copied().min_by(|&a, &b| distance(a).total_cmp(&distance(b))) {
                Some(heir) => {
                    self.bury_whole(v, heir);
                    count += 1;
                }
                None => self.points.push(v),
            }
        }
        count
    }
}
