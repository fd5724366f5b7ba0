//! Sets of cells, a bit each, and the places where one fits among others.

/// Cells of a rectangle, row by row; bit x of a row is in word `x / 64`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Mask {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    words: usize,
    bits: Vec<u64>,
}

impl Mask {
    /// Without any cell set.
    pub fn new(width: usize, height: usize) -> Mask {
        let words = width.div_ceil(64);
        Mask { width, height, words, bits: vec![0; words * height] }
    }

    /// Whether a cell is set.
    #[cfg(test)]
    pub fn get(&self, x: usize, y: usize) -> bool {
        self.bits[y * self.words + x / 64] >> (x % 64) & 1 == 1
    }

    /// Sets the cells `from..=to` of a row.
    pub fn set_run(&mut self, y: usize, from: usize, to: usize) {
        let row = &mut self.bits[y * self.words..(y + 1) * self.words];
        for (i, word) in row.iter_mut().enumerate().take(to / 64 + 1).skip(from / 64) {
            let low = if i == from / 64 { u64::MAX << (from % 64) } else { u64::MAX };
            let high = if i == to / 64 { u64::MAX >> (63 - to % 64) } else { u64::MAX };
            *word |= low & high;
        }
    }

    /// Sets every cell that the triangle touches; corners in cells, inside the mask.
    pub fn set_triangle(&mut self, p: [[f64; 2]; 3]) {
        let top = p.iter().fold(f64::INFINITY, |m, q| m.min(q[1])).max(0.0) as usize;
        let bottom = p.iter().fold(0.0f64, |m, q| m.max(q[1])) as usize;
        for y in top..=bottom.min(self.height - 1) {
            let (low, high) = (y as f64, y as f64 + 1.0);
            let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
            for k in 0..3 {
                let (a, b) = (p[k], p[(k + 1) % 3]);
                if a[1].max(b[1]) < low || a[1].min(b[1]) > high {
                    continue;
                }
                for y in [low, high] {
                    let t = ((y - a[1]) / (b[1] - a[1])).clamp(0.0, 1.0);
                    let t = if t.is_nan() { 0.0 } else { t };
                    let x = a[0] + t * (b[0] - a[0]);
                    (from, to) = (from.min(x), to.max(x));
                }
                if a[1] == b[1] {
                    (from, to) = (from.min(b[0]), to.max(b[0]));
                }
            }
            if from <= to {
                self.set_run(y, from.max(0.0) as usize, (to.max(0.0) as usize).min(self.width - 1));
            }
        }
    }

    /// Cells that are set.
    pub fn count(&self) -> usize {
        self.bits.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// Turned by a quarter: `(x, y) -> (height - 1 - y, x)`.
    pub fn turned(&self) -> Mask {
        let mut turned = Mask::new(self.height, self.width);
        for y in 0..self.height {
            for (i, &word) in self.bits[y * self.words..(y + 1) * self.words].iter().enumerate() {
                let mut word = word;
                while word != 0 {
                    let x = i * 64 + word.trailing_zeros() as usize;
                    word &= word - 1;
                    turned.set_run(x, self.height - 1 - y, self.height - 1 - y);
                }
            }
        }
        turned
    }

    /// Wider by `gap` cells on all sides, with all cells set that are at most `gap` away (maximum norm) from a set one.
    pub fn widened(&self, gap: usize) -> Mask {
        let mut wide = Mask::new(self.width + 2 * gap, self.height + 2 * gap);
        for y in 0..self.height {
            for (from, to) in self.runs(y) {
                (y..=y + 2 * gap).for_each(|row| wide.set_run(row, from, to + 2 * gap));
            }
        }
        wide
    }

    /// Runs of set cells of a row, both ends included.
    fn runs(&self, y: usize) -> Vec<(usize, usize)> {
        let mut runs: Vec<(usize, usize)> = Vec::new();
        for (i, &word) in self.bits[y * self.words..(y + 1) * self.words].iter().enumerate() {
            let (mut word, mut base) = (word, i * 64);
            while word != 0 {
                let skip = word.trailing_zeros() as usize;
                word >>= skip;
                base += skip;
                let length = word.trailing_ones() as usize;
                match runs.last_mut() {
                    Some(last) if last.1 + 1 == base => last.1 += length,
                    _ => runs.push((base, base + length - 1)),
                }
                word = if length == 64 { 0 } else { word >> length };
                base += length;
            }
        }
        runs
    }

    /// Sets the cells of `other`, moved by `(x, y)`; what lies outside is left out.
    pub fn unite(&mut self, other: &Mask, x: isize, y: isize) {
        for row in 0..other.height {
            let at = row as isize + y;
            if at < 0 || at >= self.height as isize {
                continue;
            }
            for (from, to) in other.runs(row) {
                let (from, to) = ((from as isize + x).max(0), (to as isize + x).min(self.width as isize - 1));
                if from <= to {
                    self.set_run(at as usize, from as usize, to as usize);
                }
            }
        }
    }

    /// The 64 cells from column `x` of a row on.
    fn window(&self, x: usize, y: usize) -> u64 {
        let row = &self.bits[y * self.words..(y + 1) * self.words];
        let (word, shift) = (x / 64, x % 64);
        let low = row.get(word).copied().unwrap_or(0) >> shift;
        let high = row.get(word + 1).copied().unwrap_or(0);
        if shift == 0 { low } else { low | high << (64 - shift) }
    }

    /// A column further right up to which `other` cannot lie at `(x, y)` without touching a set cell; `None`: it fits.
    fn blocked_until(&self, other: &Mask, x: usize, y: usize) -> Option<usize> {
        for row in 0..other.height {
            for word in 0..other.words {
                let hit = other.bits[row * other.words + word] & self.window(x + word * 64, y + row);
                if hit != 0 {
                    let at = x + word * 64 + hit.trailing_zeros() as usize;
                    // The same cell of `other` hits every cell of this run.
                    let run = (self.window(at, y + row)).trailing_ones() as usize;
                    return Some(x + run);
                }
            }
        }
        None
    }

    /// The first place for `other`, row by row from row `from` on.
    pub fn first_fit(&self, other: &Mask, from: usize) -> Option<[usize; 2]> {
        if other.width > self.width || other.height > self.height {
            return None;
        }
        for y in from..=self.height - other.height {
            let mut x = 0;
            while x <= self.width - other.width {
                match self.blocked_until(other, x, y) {
                    None => return Some([x, y]),
                    Some(next) => x = next,
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::Mask;

    fn cells(mask: &Mask) -> Vec<(usize, usize)> {
        let all = (0..mask.height).flat_map(|y| (0..mask.width).map(move |x| (x, y)));
        all.filter(|&(x, y)| mask.get(x, y)).collect()
    }

    #[test]
    fn a_triangle_sets_all_cells_that_it_touches_and_no_others() {
        let mut mask = Mask::new(4, 4);
        mask.set_triangle([[0.5, 0.5], [2.4, 0.5], [0.5, 2.4]]);
        assert_eq!(cells(&mask), [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2)]);
    }

    #[test]
    fn turning_four_times_changes_nothing() {
        let mut mask = Mask::new(70, 3);
        mask.set_run(0, 1, 68);
        mask.set_run(2, 65, 69);
        let once = mask.turned();
        assert!(once.get(2, 1) && once.get(0, 69) && !once.get(2, 0));
        assert_eq!(once.turned().turned().turned(), mask);
    }

    #[test]
    fn widening_reaches_diagonally() {
        let mut mask = Mask::new(1, 1);
        mask.set_run(0, 0, 0);
        assert_eq!(mask.widened(2).count(), 25);
    }

    #[test]
    fn the_first_place_is_found_across_words() {
        let mut taken = Mask::new(128, 2);
        taken.set_run(0, 0, 100);
        taken.set_run(1, 0, 60);
        let mut other = Mask::new(30, 1);
        other.set_run(0, 0, 29);
        assert_eq!(taken.first_fit(&other, 0), Some([61, 1]));
        let mut small = Mask::new(27, 1);
        small.set_run(0, 0, 26);
        assert_eq!(taken.first_fit(&small, 0), Some([101, 0]));
        assert_eq!(taken.first_fit(&Mask::new(129, 1), 0), None);
    }
}
