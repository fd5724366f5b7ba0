//! Moving one vertex of a plane triangulation at a time to where the symmetric Dirichlet energy is least; no step turns
//! a triangle (Smith and Schaefer 2015, section 3).
//!
//! Energy of a triangle with rest area A, plane area a and Dirichlet energy D of the map: `D (1 + A^2 / a^2)`; it grows
//! without bound as a triangle collapses, and is least where the map is an isometry.

use glam::{DVec2, DVec3};

/// Rest shapes are at least this high, in their longest edges: needles weigh little, and do not lie down.
const MIN_HEIGHT: f64 = 2e-3;
/// Rest shapes have a longest edge of at least this part of the typical one.
const TINY: f64 = 1e-4;
/// No vertex goes farther than this share of the way to where a triangle would vanish.
const MAX_COLLAPSE: f64 = 0.8;
/// Halvings of a step that does not lower the energy.
const MAX_HALVINGS: usize = 3;

/// The shape that a triangle has on the surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rest {
    /// Half the cotangents of the angles.
    pub cot: [f64; 3],
    /// Square of the area.
    pub area2: f64,
}

impl Rest {
    /// `unit`: a typical edge length; shorter triangles are treated as if of a tiny part of it.
    pub fn new(corners: [DVec3; 3], unit: f64) -> Rest {
        let edge2 = |k: usize| corners[(k + 1) % 3].distance_squared(corners[(k + 2) % 3]);
        let apex = (1..3).fold(0, |best, k| if edge2(k) > edge2(best) { k } else { best });
        let (a, b) = ((apex + 1) % 3, (apex + 2) % 3);
        let base = edge2(apex).sqrt().max(TINY * unit);
        let (side, along) = (corners[apex] - corners[a], corners[b] - corners[a]);
        let x = (side.dot(along) / base).clamp(0.0, base);
        let height = (side.cross(along).length() / base).max(MIN_HEIGHT * base);
        let mut cot = [0.0; 3];
        cot[a] = 0.5 * x / height;
        cot[b] = 0.5 * (base - x) / height;
        cot[apex] = 0.5 * (height * height - x * (base - x)) / (base * height);
        Rest { cot, area2: 0.25 * base * base * height * height }
    }

    /// The same shape with corner `k` first.
    pub fn seen_from(&self, k: usize) -> Rest {
        Rest { cot: [self.cot[k], self.cot[(k + 1) % 3], self.cot[(k + 2) % 3]], area2: self.area2 }
    }
}

/// Dirichlet energy of the map from rest shape `rest` to `p`, and the signed area of `p`.
pub(super) fn measure(rest: &Rest, p: [DVec2; 3]) -> (f64, f64) {
    let d = rest.cot[0] * (p[1] - p[2]).length_squared()
        + rest.cot[1] * (p[2] - p[0]).length_squared()
        + rest.cot[2] * (p[0] - p[1]).length_squared();
    (d, 0.5 * (p[1] - p[0]).perp_dot(p[2] - p[0]))
}

/// Energy of a triangle; infinite where it is turned or has no area.
pub(super) fn energy(rest: &Rest, p: [DVec2; 3]) -> f64 {
    let (d, a) = measure(rest, p);
    if a > 0.0 { d * (1.0 + rest.area2 / (a * a)) } else { f64::INFINITY }
}

/// A triangle seen from the vertex that moves: its two other corners, counter-clockwise, and the rest shape with the
/// moving corner first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub a: DVec2,
    pub b: DVec2,
    pub rest: Rest,
}

/// Energy around a vertex at `p`.
pub(super) fn energy_at(seen: &[Seen], p: DVec2) -> f64 {
    seen.iter().map(|s| energy(&s.rest, [p, s.a, s.b])).sum()
}

/// One guarded Newton step from `p`, where all triangles have positive area; returns where to.
pub(super) fn step(seen: &[Seen], p: DVec2) -> DVec2 {
    let (mut before, mut g, mut hxx, mut hxy, mut hyy) = (0.0, DVec2::ZERO, 0.0, 0.0, 0.0);
    for s in seen {
        let (d, a) = measure(&s.rest, [p, s.a, s.b]);
        let dd = 2.0 * (s.rest.cot[1] * (p - s.b) + s.rest.cot[2] * (p - s.a));
        let d2 = 2.0 * (s.rest.cot[1] + s.rest.cot[2]);
        let da = 0.5 * DVec2::new(s.a.y - s.b.y, s.b.x - s.a.x);
        let inverse = 1.0 / a;
        let ratio = s.rest.area2 * inverse * inverse;
        before += d * (1.0 + ratio);
        g += dd * (1.0 + ratio) - da * (2.0 * d * ratio * inverse);
        let (mixed, curved) = (-2.0 * ratio * inverse, 6.0 * d * ratio * inverse * inverse);
        let diagonal = d2 * (1.0 + ratio);
        hxx += diagonal + 2.0 * mixed * dd.x * da.x + curved * da.x * da.x;
        hyy += diagonal + 2.0 * mixed * dd.y * da.y + curved * da.y * da.y;
        hxy += mixed * (dd.x * da.y + dd.y * da.x) + curved * da.x * da.y;
    }
    // Make the Hessian positive definite by its smaller eigenvalue.
    let (mean, half) = (0.5 * (hxx + hyy), 0.5 * (hxx - hyy));
    let lowest = mean - (half * half + hxy * hxy).sqrt();
    let lift = (1e-3 * mean.abs() - lowest).max(0.0) + f64::MIN_POSITIVE;
    let (hxx, hyy) = (hxx + lift, hyy + lift);
    let det = hxx * hyy - hxy * hxy;
    let way = DVec2::new(hxy * g.y - hyy * g.x, hxy * g.x - hxx * g.y) / det;
    if !way.is_finite() {
        return p;
    }
    let mut t = 1.0f64;
    for s in seen {
        let a = 0.5 * (s.a - p).perp_dot(s.b - p);
        let slope = 0.5 * ((s.a.y - s.b.y) * way.x + (s.b.x - s.a.x) * way.y);
        if slope * t < -MAX_COLLAPSE * a {
            t = -MAX_COLLAPSE * a / slope;
        }
    }
    for _ in 0..=MAX_HALVINGS {
        let to = p + t * way;
        if energy_at(seen, to) < before {
            return to;
        }
        t *= 0.5;
    }
    p
}
