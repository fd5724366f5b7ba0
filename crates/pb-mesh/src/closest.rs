//! Nearest points of triangles and segments.

use glam::{Vec2, Vec3, Vec4};

/// Point of triangle `t` nearest to `p`.
pub(crate) fn closest_on_triangle(p: Vec3, t: [Vec3; 3]) -> Vec3 {
    t[0] + Facet::new(t[1] - t[0], t[2] - t[0]).closest(p - t[0]).0
}

/// A triangle by its edges from its first corner, ready to be asked for nearest points (Ericson, Real-Time Collision
/// Detection, 5.1.5).
#[derive(Clone, Copy)]
pub(crate) struct Facet {
    ab: Vec3,
    ac: Vec3,
    /// Dot products: ab ab, ab ac, ac ac.
    dots: [f32; 3],
}

impl Facet {
    pub fn new(ab: Vec3, ac: Vec3) -> Self {
        Facet { ab, ac, dots: [ab.dot(ab), ab.dot(ac), ac.dot(ac)] }
    }

    /// The nearest point to `ap`, both from the first corner, and the corners that it is a mix of as bits.
    pub fn closest(&self, ap: Vec3) -> (Vec3, u8) {
        let (ab, ac, [bb, bc, cc]) = (self.ab, self.ac, self.dots);
        let (d1, d2) = (ab.dot(ap), ac.dot(ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            return (Vec3::ZERO, 1);
        }
        let (d3, d4) = (d1 - bb, d2 - bc);
        if d3 >= 0.0 && d4 <= d3 {
            return (ab, 2);
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            return (ab * (d1 / (d1 - d3).max(f32::MIN_POSITIVE)), 3);
        }
        let (d5, d6) = (d1 - bc, d2 - cc);
        if d6 >= 0.0 && d5 <= d6 {
            return (ac, 4);
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            return (ac * (d2 / (d2 - d6).max(f32::MIN_POSITIVE)), 5);
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
            return (ab + (ac - ab) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)).max(f32::MIN_POSITIVE)), 6);
        }
        let denominator = 1.0 / (va + vb + vc);
        (ab * (vb * denominator) + ac * (vc * denominator), 7)
    }
}

/// Answers of [`closest_of_four`], one lane each.
pub(crate) struct FourNearest {
    offset: [Vec4; 3],
    corners: Vec4,
    /// Squared distances.
    pub squares: Vec4,
}

impl FourNearest {
    /// What [`Facet::closest`] says of one of them.
    pub fn lane(&self, lane: usize) -> (Vec3, u8) {
        (Vec3::from_array(self.offset.map(|x| x[lane])), self.corners[lane] as u8)
    }
}

/// [`Facet::closest`] for four triangles and as many points, each from its triangle's first corner. The same numbers, bit
/// by bit, without a branch: each case of the scalar rule is a mask, and the first that holds is laid over the others.
pub(crate) fn closest_of_four(facets: [&Facet; 4], points: [Vec3; 4]) -> FourNearest {
    let (ab, ac) = (lanes(facets.map(|f| f.ab)), lanes(facets.map(|f| f.ac)));
    let [bb, bc, cc] = lanes(facets.map(|f| Vec3::from_array(f.dots)));
    let p = lanes(points);
    let dot = |u: [Vec4; 3], v: [Vec4; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    let (zero, one, tiny) = (Vec4::ZERO, Vec4::ONE, Vec4::splat(f32::MIN_POSITIVE));
    let (d1, d2) = (dot(ab, p), dot(ac, p));
    let (d3, d4) = (d1 - bb, d2 - bc);
    let (d5, d6) = (d1 - bc, d2 - cc);
    let (vc, vb, va) = (d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4);
    let at_a = d1.cmple(zero) & d2.cmple(zero);
    let at_b = d3.cmpge(zero) & d4.cmple(d3);
    let on_ab = vc.cmple(zero) & d1.cmpge(zero) & d3.cmple(zero);
    let at_c = d6.cmpge(zero) & d5.cmple(d6);
    let on_ac = vb.cmple(zero) & d2.cmpge(zero) & d6.cmple(zero);
    let on_bc = va.cmple(zero) & (d4 - d3).cmpge(zero) & (d5 - d6).cmpge(zero);
    let denominator = one / (va + vb + vc);
    let along_bc = (d4 - d3) / ((d4 - d3) + (d5 - d6)).max(tiny);
    // Shares of the two edges, and the corners' bits; the case that counts most is laid on last.
    let (mut s, mut t, mut corners) = (vb * denominator, vc * denominator, Vec4::splat(7.0));
    let cases = [
        (on_bc, zero, zero, 6.0),
        (on_ac, zero, d2 / (d2 - d6).max(tiny), 5.0),
        (at_c, zero, one, 4.0),
        (on_ab, d1 / (d1 - d3).max(tiny), zero, 3.0),
        (at_b, one, zero, 2.0),
        (at_a, zero, zero, 1.0),
    ];
    for (case, s_there, t_there, bits) in cases {
        s = Vec4::select(case, s_there, s);
        t = Vec4::select(case, t_there, t);
        corners = Vec4::select(case, Vec4::splat(bits), corners);
    }
    let only_bc = corners.cmpeq(Vec4::splat(6.0));
    let offset = [0, 1, 2].map(|k| Vec4::select(only_bc, ab[k] + (ac[k] - ab[k]) * along_bc, ab[k] * s + ac[k] * t));
    let away = [0, 1, 2].map(|k| offset[k] - p[k]);
    FourNearest { offset, corners, squares: dot(away, away) }
}

/// Four vectors as their coordinates.
fn lanes(v: [Vec3; 4]) -> [Vec4; 3] {
    let [a, b, c, d] = v;
    [Vec4::new(a.x, b.x, c.x, d.x), Vec4::new(a.y, b.y, c.y, d.y), Vec4::new(a.z, b.z, c.z, d.z)]
}

pub(crate) fn closest_on_segment(p: Vec3, a: Vec3, b: Vec3) -> Vec3 {
    let d = b - a;
    let l = d.length_squared();
    if l > 0.0 { a + d * ((p - a).dot(d) / l).clamp(0.0, 1.0) } else { a }
}

/// Distance between two segments, by alternating projection from the crossing of their lines.
pub(crate) fn segment_distance(p: Vec3, q: Vec3, a: Vec3, b: Vec3) -> f32 {
    let (d1, d2, r) = (q - p, b - a, p - a);
    let (l1, l2, f, c, m) = (d1.length_squared(), d2.length_squared(), d2.dot(r), d1.dot(r), d1.dot(d2));
    let denominator = l1 * l2 - m * m;
    let s = if denominator > 0.0 { ((m * f - c * l2) / denominator).clamp(0.0, 1.0) } else { 0.0 };
    let on_b = closest_on_segment(p + d1 * s, a, b);
    let on_a = closest_on_segment(on_b, p, q);
    closest_on_segment(on_a, a, b).distance(on_a)
}

/// Height of `p` over a triangle if its foot lies inside.
pub(crate) fn height_over(p: Vec3, t: [Vec3; 3]) -> Option<f32> {
    let n = (t[1] - t[0]).cross(t[2] - t[0]).try_normalize()?;
    let inside = (0..3).all(|k| (t[(k + 1) % 3] - t[k]).cross(p - t[k]).dot(n) >= 0.0);
    inside.then(|| (p - t[0]).dot(n).abs())
}

/// The point of triangle `t` in the plane that is nearest to `p`: its barycentric weights and the squared distance, zero
/// inside. A triangle without area is its edges.
pub(crate) fn closest_in_uv(p: Vec2, t: [Vec2; 3]) -> ([f32; 3], f32) {
    let area = (t[1] - t[0]).perp_dot(t[2] - t[0]);
    let opposite = |k: usize| (t[(k + 1) % 3] - p).perp_dot(t[(k + 2) % 3] - p);
    let parts = [opposite(0), opposite(1), opposite(2)];
    if area != 0.0 && parts.iter().all(|x| x * area >= 0.0) {
        return (parts.map(|x| x / area), 0.0);
    }
    let mut best = ([0.0; 3], f32::INFINITY);
    for k in 0..3 {
        let (from, along) = (t[k], t[(k + 1) % 3] - t[k]);
        let length = along.length_squared();
        let x = if length > 0.0 { ((p - from).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
        let square = (from + along * x).distance_squared(p);
        if square < best.1 {
            best = ([0.0; 3], square);
            (best.0[k], best.0[(k + 1) % 3]) = (1.0 - x, x);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Whole numbers, so that points lie on corners, on edges and in triangles without area often.
    fn point() -> impl Strategy<Value = Vec3> {
        [-4i32..=4, -4i32..=4, -2i32..=2].prop_map(|p| Vec3::from_array(p.map(|x| x as f32)))
    }

    proptest! {
        #[test]
        fn four_triangles_at_once_give_what_each_gives_alone(
            corners in prop::array::uniform8(point()), points in prop::array::uniform4(point()),
        ) {
            let facets: [Facet; 4] = std::array::from_fn(|k| Facet::new(corners[2 * k], corners[2 * k + 1]));
            let four = closest_of_four(facets.each_ref(), points);
            for k in 0..4 {
                let (offset, bits) = facets[k].closest(points[k]);
                let (found, found_bits) = four.lane(k);
                prop_assert_eq!((offset, bits), (found, found_bits));
                prop_assert_eq!(offset.distance_squared(points[k]), four.squares[k]);
            }
        }
    }
}
