//! Connected parts: which of many things hang together.

/// Things by number, joined pair by pair.
pub struct Parts(Vec<u32>);

impl Parts {
    /// So many things, each by itself.
    pub fn new(count: usize) -> Self {
        Parts((0..count as u32).collect())
    }

    /// These two are of one part.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.lowest(a), self.lowest(b));
        self.0[a.max(b) as usize] = a.min(b);
    }

    /// The part of each thing, by the lowest number in it.
    pub fn list(mut self) -> Vec<u32> {
        (0..self.0.len() as u32).map(|i| self.lowest(i)).collect()
    }

    fn lowest(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }
}
