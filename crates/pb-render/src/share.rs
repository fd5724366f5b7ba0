//! Divides a byte bound among those who need memory. Must never: hand out more than there is.

/// Somebody who needs memory. All numbers are bytes and multiples of `step`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Party {
    /// Nothing works below this.
    pub least: u64,
    /// Enough to show everything once, one thing after the other.
    pub enough: u64,
    /// More is of no use.
    pub all: u64,
    /// Memory comes in pieces of this size.
    pub step: u64,
}

/// Each party's bytes: the least, then as far as they go enough, the rest in proportion to what is missing.
/// `None` where `bytes` are fewer than the least of all.
pub fn share(bytes: u64, parties: &[Party]) -> Option<Vec<u64>> {
    let mut out: Vec<u64> = parties.iter().map(|p| p.least).collect();
    let mut left = bytes.checked_sub(out.iter().sum())?;
    for (o, p) in out.iter_mut().zip(parties) {
        let more = p.enough.max(p.least) - *o;
        if more <= left {
            (*o, left) = (*o + more, left - more);
        }
    }
    let missing: Vec<u64> = out.iter().zip(parties).map(|(o, p)| p.all.max(*o) - o).collect();
    let (total, rest) = (missing.iter().sum::<u64>().max(1), left);
    for ((o, p), missing) in out.iter_mut().zip(parties).zip(&missing) {
        let part = (*missing as u128 * rest.min(total) as u128 / total as u128) as u64 / p.step * p.step;
        (*o, left) = (*o + part, left - part);
    }
    // What rounding left over goes to whoever can use it.
    for (o, p) in out.iter_mut().zip(parties) {
        let more = left.min(p.all.max(*o) - *o) / p.step * p.step;
        (*o, left) = (*o + more, left - more);
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn party(least: u64, enough: u64, all: u64, step: u64) -> Party {
        Party { least, enough, all, step }
    }

    #[test]
    fn the_bound_is_kept_and_nothing_usable_is_left_over() {
        let parties = [party(10, 20, 1000, 1), party(64, 128, 640, 64), party(0, 0, 0, 64)];
        assert_eq!(share(73, &parties), None);
        assert_eq!(share(74, &parties).unwrap(), [10, 64, 0]);
        for bytes in (74..2000).step_by(7) {
            let shares = share(bytes, &parties).unwrap();
            let sum: u64 = shares.iter().sum();
            assert!(sum <= bytes);
            assert!(sum == bytes || shares[0] == 1000, "{bytes}: {shares:?}");
            for (s, p) in shares.iter().zip(&parties) {
                assert!((p.least..=p.all).contains(s) && (s - p.least).is_multiple_of(p.step));
            }
        }
        assert_eq!(share(5000, &parties).unwrap(), [1000, 640, 0]);
    }

    #[test]
    fn who_misses_more_gets_more() {
        let parties = [party(0, 0, 1000, 1), party(0, 0, 3000, 1)];
        assert_eq!(share(2000, &parties).unwrap(), [500, 1500]);
    }
}
