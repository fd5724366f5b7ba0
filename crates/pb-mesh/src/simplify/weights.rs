//! What the cost of a collapse is made of.

/// The collapses to the level after this one and to coarser ones have [`Weights::COARSE`].
pub(super) const COARSE_LEVEL: usize = 2;

/// Weights of the parts of a cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Weights {
    /// Squared distance of a witness, in terms of the cost of planes, which is near a mean.
    pub witness: f32,
    /// Exponent of [`Weights::scale`], in sixteenths: 0 to 15.
    pub sixteenths: u8,
    /// Squared size of a component that vanishes, in terms of the usual one.
    pub vanish: f32,
}

impl Weights {
    /// For the first levels, where single features count.
    pub const FINE: Weights = Weights { witness: 6.0, sixteenths: 7, vanish: 1.0 };
    /// For those from [`COARSE_LEVEL`] on, whose triangles stand for much of the surface each.
    pub const COARSE: Weights = Weights { witness: 9.0, sixteenths: 4, vanish: 1.0 };

    /// What makes the value of a quadric of this weight a cost. Between the mean over its planes, which keeps the largest
    /// distance down, and their sum, which keeps the mean over the whole surface down: the mean times a power of the
    /// number of triangles behind it.
    pub fn scale(&self, weight: f32, mean_area: f32) -> f32 {
        let mut root = weight / mean_area;
        let mut power = 1.0;
        // Square roots alone are the same on every machine.
        for bit in (0..4).rev() {
            root = root.sqrt();
            if self.sixteenths >> bit & 1 != 0 {
                power *= root;
            }
        }
        if weight > 0.0 { (1.0 + power) / weight } else { 0.0 }
    }
}
