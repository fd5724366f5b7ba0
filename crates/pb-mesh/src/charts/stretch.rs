//! How far a layout is from an isometry: L2 stretch of Sander, Snyder, Gortler, Hoppe 2001, section 3.

/// Sums over triangles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stretch {
    /// Symmetric Dirichlet energy; 4 areas where the map is an isometry.
    pub energy: f64,
    /// Dirichlet energy of the maps from surface to plane.
    forward: f64,
    /// Dirichlet energy of the maps back.
    back: f64,
    /// Area on the surface.
    pub area: f64,
    /// Area in the plane.
    pub plane: f64,
}

impl Stretch {
    /// A triangle with Dirichlet energy `d`, plane area `a` and the square `area2` of its area on the surface.
    pub fn add(&mut self, d: f64, a: f64, area2: f64) {
        let back = d * area2 / (a * a);
        self.forward += d;
        self.back += back;
        self.energy += d + back;
        self.area += area2.sqrt();
        self.plane += a;
    }

    /// Adds the sums of another chart.
    pub fn merge(&mut self, other: &Stretch) {
        self.energy += other.energy;
        self.forward += other.forward;
        self.back += other.back;
        self.area += other.area;
        self.plane += other.plane;
    }

    /// Root mean square of the singular values of the map from plane to surface, with equal areas of both: 1 for an
    /// isometry, more for anything else.
    pub fn l2(&self) -> f64 {
        if self.area > 0.0 { (0.5 * self.back * self.plane).sqrt() / self.area } else { 1.0 }
    }

    /// The factor on all coordinates that makes the energy least.
    pub fn best_scale(&self) -> f64 {
        (self.back / self.forward).powf(0.25)
    }

    /// After all coordinates were multiplied with `factor`.
    pub fn scaled(&mut self, factor: f64) {
        let square = factor * factor;
        self.forward *= square;
        self.back /= square;
        self.plane *= square;
        self.energy = self.forward + self.back;
    }
}
