//! Error quadrics (Garland and Heckbert 1997), centred on the vertex that owns them.
//!
//! Centring keeps f32 exact enough: a quadric is only ever evaluated at a neighbour of its vertex.

use super::fan::Wide;
use glam::{Vec3, Vec4};

/// Sum of weighted squared distances to planes, as a function of the offset from the owner's position.
#[derive(Clone, Copy, Debug, Default)]
pub struct Quadric {
    /// xx, yy, zz, xy, xz, yz of the 3x3 form.
    a: [f32; 6],
    b: Vec3,
    c: f32,
    /// Sum of weights, an area.
    pub weight: f32,
}

impl Quadric {
    /// A plane through the owner with unit normal `n`, weighted by an area.
    pub fn plane(n: Vec3, weight: f32) -> Self {
        let m = n * weight;
        Quadric { a: [m.x * n.x, m.y * n.y, m.z * n.z, m.x * n.y, m.x * n.z, m.y * n.z], b: Vec3::ZERO, c: 0.0, weight }
    }

    fn times(&self, d: Vec3) -> Vec3 {
        let [xx, yy, zz, xy, xz, yz] = self.a;
        Vec3::new(xx * d.x + xy * d.y + xz * d.z, xy * d.x + yy * d.y + yz * d.z, xz * d.x + yz * d.y + zz * d.z)
    }

    /// Weighted squared distance at offset `d` from the owner; never negative.
    #[inline]
    pub fn at(&self, d: Vec3) -> f32 {
        (d.dot(self.times(d)) + 2.0 * self.b.dot(d) + self.c).max(0.0)
    }

    /// The same at four offsets.
    pub fn at_four(&self, [x, y, z]: Wide) -> Vec4 {
        let [xx, yy, zz, xy, xz, yz] = self.a;
        let cross = x * y * xy + x * z * xz + y * z * yz + x * self.b.x + y * self.b.y + z * self.b.z;
        (x * x * xx + y * y * yy + z * z * zz + cross * 2.0 + self.c).max(Vec4::ZERO)
    }

    /// The same function for an owner that lies `d` away.
    pub fn moved(&self, d: Vec3) -> Self {
        Quadric { a: self.a, b: self.b + self.times(d), c: self.at(d), weight: self.weight }
    }

    /// Adds a quadric with the same owner.
    pub fn add(&mut self, other: &Quadric) {
        for (x, y) in self.a.iter_mut().zip(other.a) {
            *x += y;
        }
        self.b += other.b;
        self.c += other.c;
        self.weight += other.weight;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moving_the_owner_keeps_the_function() {
        let mut q = Quadric::plane(Vec3::new(0.6, 0.8, 0.0), 2.0);
        q.add(&Quadric::plane(Vec3::Z, 0.5));
        let moved = q.moved(Vec3::new(1.0, 2.0, -1.0));
        for d in [Vec3::ZERO, Vec3::X, Vec3::new(3.0, -1.0, 2.0)] {
            assert!((q.at(Vec3::new(1.0, 2.0, -1.0) + d) - moved.at(d)).abs() < 1e-4);
        }
        assert!((moved.at(Vec3::ZERO) - (2.0 * 2.2f32 * 2.2 + 0.5)).abs() < 1e-4);
    }
}
