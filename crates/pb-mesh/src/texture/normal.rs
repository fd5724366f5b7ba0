//! Tangent frames: of a source's texture coordinates, and of the tile.
//!
//! The tile's frame is one that a shader can make of the shading normal N and of the derivatives of position P and tile
//! coordinates (u, v), so that no tangents are stored:
//!
//! ```text
//! T = normalize(dP/du - N (N . dP/du))       B = +-cross(N, T), on the side away from dP/dv   (v runs downwards)
//! n = x T + y B + z N,   z = sqrt(1 - x^2 - y^2)
//! ```
//!
//! T, B and N are orthonormal, so every normal has its x, y, z, however much the chart is stretched. The source's frame
//! is the same with its own texture coordinates, as glTF 2.0 (3.9.3) wants it for meshes without tangents, but for the
//! smoothing of tangents over vertices.

use glam::{DVec2, DVec3, Vec3, Vec4};

/// Derivatives of the position with respect to two coordinates; not normalised.
#[derive(Clone, Copy, Debug)]
pub(super) struct Derivatives {
    along_u: Vec3,
    along_v: Vec3,
}

impl Derivatives {
    /// Of a triangle; `None` where the coordinates have no area.
    pub fn of(positions: [DVec3; 3], coordinates: [DVec2; 3]) -> Option<Derivatives> {
        let (e1, e2) = (positions[1] - positions[0], positions[2] - positions[0]);
        let (d1, d2) = (coordinates[1] - coordinates[0], coordinates[2] - coordinates[0]);
        let area = d1.perp_dot(d2);
        let scale = d1.length_squared().max(d2.length_squared());
        if area.abs() <= scale * 1e-9 || !area.is_finite() {
            return None;
        }
        let sign = area.signum();
        let unit = |v: DVec3| v.normalize_or_zero().as_vec3();
        let along_u = unit((e1 * d2.y - e2 * d1.y) * sign);
        let along_v = unit((e2 * d1.x - e1 * d2.x) * sign);
        Some(Derivatives { along_u, along_v })
    }

    /// (T, B) at a shading normal of unit length; `None` where the normal lies along dP/du.
    pub fn frame(&self, normal: Vec3) -> Option<(Vec3, Vec3)> {
        let tangent = (self.along_u - normal * normal.dot(self.along_u)).try_normalize()?;
        let side = normal.cross(tangent);
        Some((tangent, if side.dot(self.along_v) > 0.0 { -side } else { side }))
    }
}

/// The normal that a source's map shows, world space.
pub(super) fn perturbed(texel: Vec4, scale: f32, source: Option<&Derivatives>, normal: Vec3) -> Vec3 {
    let Some((tangent, bitangent)) = source.and_then(|d| d.frame(normal)) else { return normal };
    let n = texel.truncate() * 2.0 - 1.0;
    (tangent * (n.x * scale) + bitangent * (n.y * scale) + normal * n.z).try_normalize().unwrap_or(normal)
}

/// A world normal in the tile's frame; below the surface it is put onto its horizon.
pub(super) fn in_tile(world: Vec3, tile: Option<&Derivatives>, normal: Vec3) -> Vec3 {
    let Some((tangent, bitangent)) = tile.and_then(|d| d.frame(normal)) else { return Vec3::Z };
    Vec3::new(world.dot(tangent), world.dot(bitangent), world.dot(normal).max(0.0)).try_normalize().unwrap_or(Vec3::Z)
}
