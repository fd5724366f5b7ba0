//! Objects: the parts of a mesh that stand in several places of the world, and those places.
//!
//! Object 0 stands once, where its positions are. Every other object has its positions where the first of its placements
//! has them, and stands at all of them. A placement turns, scales alike in all directions and moves, nothing else: then
//! distances from an eye that is moved the other way tell all that a level of detail depends on.

use glam::{DMat3, DMat4, DQuat, DVec3};

/// Largest part of its size by which a placement may move a point otherwise than the matrix that it was made from: far
/// below the grid step of a cluster, and above the rounding of matrices in single precision.
const TOLERANCE: f64 = 2e-6;

/// Where an object stands: `p -> translation + scale * (rotation * p)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Of length 1.
    pub rotation: DQuat,
    /// Above 0.
    pub scale: f64,
    /// In the units of the input.
    pub translation: DVec3,
}

impl Placement {
    /// Where the object's positions are.
    pub const IDENTITY: Placement = Placement { rotation: DQuat::IDENTITY, scale: 1.0, translation: DVec3::ZERO };

    /// Of a matrix that turns, scales alike in all directions and moves; none of one that mirrors, stretches, shears,
    /// flattens, or is not finite.
    pub fn of_matrix(matrix: DMat4) -> Option<Placement> {
        let linear = DMat3::from_mat4(matrix);
        let translation = matrix.w_axis.truncate();
        let scale = linear.determinant().cbrt();
        if !(scale > 0.0 && scale.is_finite() && translation.is_finite()) {
            return None;
        }
        let turned = linear * scale.recip();
        let rotation = DQuat::from_mat3(&turned).normalize();
        let off = DMat3::from_quat(rotation) - turned;
        let most = off.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
        (most <= TOLERANCE && rotation.is_finite()).then_some(Placement { rotation, scale, translation })
    }

    /// Where a point of the object is.
    pub fn point(&self, p: DVec3) -> DVec3 {
        self.translation + self.scale * (self.rotation * p)
    }

    /// Which point of the object is there.
    pub fn point_of(&self, world: DVec3) -> DVec3 {
        self.rotation.conjugate() * (world - self.translation) / self.scale
    }

    /// The same placement for positions that are counted from `origin` on both sides.
    pub fn around(&self, origin: DVec3) -> Placement {
        Placement { translation: self.point(origin) - origin, ..*self }
    }
}

/// Which records (of a soup) or positions (of a mesh) belong to which object, and where objects stand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Objects {
    /// Object of each record or position; empty where all are of object 0.
    pub of: Vec<u32>,
    /// Of the objects 1, 2, ...: where they stand, the identity first.
    pub placements: Vec<Vec<Placement>>,
}

impl Objects {
    /// The object of a record or position.
    pub fn object_of(&self, index: usize) -> u32 {
        self.of.get(index).copied().unwrap_or(0)
    }

    /// Appends those of another input with `theirs` records behind `mine`; object 0 is one.
    pub(crate) fn append(&mut self, other: Objects, mine: usize, theirs: usize) {
        if self.of.is_empty() && other.of.is_empty() {
            return;
        }
        let base = self.placements.len() as u32;
        self.of.resize(mine, 0);
        self.of.extend(other.of.iter().map(|&o| if o == 0 { 0 } else { o + base }));
        self.of.resize(mine + theirs, 0);
        self.placements.extend(other.placements);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_placement_moves_points_as_its_matrix_does_and_back() {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -2.0, 1.1);
        let matrix = DMat4::from_scale_rotation_translation(DVec3::splat(0.25), rotation, DVec3::new(5e6, -3.0, 40.0));
        let placement = Placement::of_matrix(matrix).unwrap();
        let p = DVec3::new(1.0, 20.0, -7.0);
        assert!(placement.point(p).distance(matrix.transform_point3(p)) < 1e-8);
        assert!(placement.point_of(placement.point(p)).distance(p) < 1e-8);
        let origin = DVec3::new(100.0, -4.0, 9.0);
        let moved = placement.around(origin).point(p - origin) + origin;
        assert!(moved.distance(placement.point(p)) < 1e-8);
    }

    #[test]
    fn what_mirrors_stretches_shears_or_flattens_is_no_placement() {
        let scaled = |x, y, z| DMat4::from_scale(DVec3::new(x, y, z));
        for matrix in
            [scaled(-1.0, 1.0, 1.0), scaled(1.0, 1.0, 1.001), scaled(1.0, 0.0, 1.0), scaled(f64::NAN, 1.0, 1.0)]
        {
            assert_eq!(Placement::of_matrix(matrix), None, "{matrix}");
        }
        let mut sheared = DMat4::IDENTITY;
        sheared.y_axis.x = 0.01;
        assert_eq!(Placement::of_matrix(sheared), None);
        let mut far = DMat4::IDENTITY;
        far.w_axis.x = f64::INFINITY;
        assert_eq!(Placement::of_matrix(far), None);
        assert!(Placement::of_matrix(scaled(-2.0, -2.0, 2.0)).is_some(), "a half turn");
    }
}
