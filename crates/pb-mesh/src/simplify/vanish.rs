//! Small components that shrink to a point: below a level's error nobody misses them.

use super::patch::Patch;
use crate::topology::Kind;
use glam::Vec3;

impl Patch {
    /// Small components whose size is within `limit` (squared quanta) shrink to a point; at most `quota`
    /// vertices go. Returns how many went, with the point, which is drawn no more.
    pub fn vanish(&mut self, limit: f32, quota: usize) -> usize {
        let mut count = 0;
        while let Some(&(size, _)) = self.input.components.last() {
            if size * self.weights.vanish > limit || count >= quota {
                break;
            }
            let (_, members) = self.input.components.pop().expect("just seen");
            let mut living = members.into_iter().filter(|&v| self.is_alive(v));
            let Some(point) = living.next() else { continue };
            let others: Vec<u32> = living.collect();
            self.corners.drop_around(point);
            others.iter().for_each(|&v| self.corners.drop_around(v));
            count += others.len() + 1;
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

    /// Points that nothing draws: those of components that have vanished.
    pub fn point_count(&self) -> usize {
        self.points.len()
    }

    /// Points left by components that vanished at an earlier level die: nothing draws them any more.
    pub fn bury_points(&mut self) {
        if self.points.is_empty() {
            return;
        }
        let mut points = std::mem::take(&mut self.points);
        points.sort_unstable();
        let is_heir = |h: &u32| self.is_alive(*h) && points.binary_search(h).is_err();
        let heirs = Heirs::new((0..self.living.len() as u32).filter(is_heir), &self.input.positions);
        for &v in &points {
            match heirs.nearest(self.input.positions[v as usize]) {
                Some(heir) => self.bury_whole(v, heir),
                None => self.points.push(v),
            }
        }
    }
}

/// Vertices that points may end in, by x.
struct Heirs {
    list: Vec<(Vec3, u32)>,
}

impl Heirs {
    fn new(vertices: impl Iterator<Item = u32>, positions: &[Vec3]) -> Heirs {
        let mut list: Vec<(Vec3, u32)> = vertices.map(|v| (positions[v as usize], v)).collect();
        list.sort_unstable_by(|a, b| a.0.x.total_cmp(&b.0.x).then(a.1.cmp(&b.1)));
        Heirs { list }
    }

    /// The nearest one; of several, the one with the lowest index.
    fn nearest(&self, p: Vec3) -> Option<u32> {
        let middle = self.list.partition_point(|h| h.0.x < p.x);
        let (before, behind) = self.list.split_at(middle);
        let mut best = (f32::INFINITY, u32::MAX);
        let mut look = |&(at, v): &(Vec3, u32)| {
            let distance = at.distance_squared(p);
            if distance < best.0 || distance == best.0 && v < best.1 {
                best = (distance, v);
            }
            (at.x - p.x).powi(2) <= best.0
        };
        // Both ways, until x alone is further than the best.
        let _ = behind.iter().all(&mut look);
        let _ = before.iter().rev().all(&mut look);
        (best.1 != u32::MAX).then_some(best.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_ends_in_the_nearest_vertex() {
        let at = |i: u32| Vec3::new((i * 37 % 101) as f32, (i * 53 % 89) as f32, (i * 71 % 97) as f32);
        let positions: Vec<Vec3> = (0..400).map(|i| at(i / 2)).collect();
        let heirs = Heirs::new((0..400).filter(|v| v % 7 != 0), &positions);
        for p in (0..300).map(|i| at(i * 3 + 11) + Vec3::splat(0.25)) {
            let distance = |v: u32| positions[v as usize].distance_squared(p);
            let nearest = (0..400).filter(|v| v % 7 != 0).min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
            assert_eq!(heirs.nearest(p), nearest);
        }
        assert_eq!(Heirs::new(std::iter::empty(), &positions).nearest(Vec3::ZERO), None);
    }
}
