//! Cuts polygons into triangles. A polygon with n corners always gives n - 2 triangles, whatever its shape, so that
//! the surface stays as closed as it was.

/// Polygons with more corners are cut as fans: ear clipping takes up to cubic time, and files are outside data.
const MAX_EAR_CLIPPING: usize = 256;

/// Appends the triangles of one polygon, as indices into `corners` (the corners' positions in order).
///
/// Convex polygons become fans from the first corner. Concave ones are clipped ear by ear in the plane of their mean
/// normal (Meisters, "Polygons have ears", 1975). Self-intersecting and vanishing polygons become fans too.
pub fn triangulate(corners: &[[f64; 3]], out: &mut Vec<[u32; 3]>) {
    let count = corners.len();
    if count < 3 {
        return;
    }
    let flat = project(corners);
    if count == 3 || count > MAX_EAR_CLIPPING || is_convex(&flat) {
        fan(&(0..count as u32).collect::<Vec<_>>(), out);
    } else {
        clip_ears(&flat, out);
    }
}

fn fan(ring: &[u32], out: &mut Vec<[u32; 3]>) {
    out.extend(ring.windows(2).skip(1).map(|pair| [ring[0], pair[0], pair[1]]));
}

/// Drops the axis along which the polygon's mean normal (Newell) is longest; counter-clockwise afterwards.
fn project(corners: &[[f64; 3]]) -> Vec<[f64; 2]> {
    let origin = corners[0];
    let local: Vec<[f64; 3]> = corners.iter().map(|c| std::array::from_fn(|k| c[k] - origin[k])).collect();
    let mut normal = [0.0; 3];
    for (i, a) in local.iter().enumerate() {
        let b = local[(i + 1) % local.len()];
        (0..3).for_each(|k| normal[k] += a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
    }
    let axis = (0..3).max_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs())).expect("there are three axes");
    let (u, v) = if normal[axis] >= 0.0 { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
    local.iter().map(|p| [p[u], p[v]]).collect()
}

/// Twice the signed area; positive when counter-clockwise.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn is_convex(flat: &[[f64; 2]]) -> bool {
    let n = flat.len();
    // Exactly straight corners are fine, a fan from corner 0 only makes flat triangles of them.
    (0..n).all(|i| turn(flat[i], flat[(i + 1) % n], flat[(i + 2) % n]) >= 0.0) && winds_once(flat)
}

/// A star pentagon turns left everywhere, but goes round more than once: seen from corner 0 its fan turns back.
fn winds_once(flat: &[[f64; 2]]) -> bool {
    (1..flat.len() - 1).all(|i| turn(flat[0], flat[i], flat[i + 1]) >= 0.0)
}

fn clip_ears(flat: &[[f64; 2]], out: &mut Vec<[u32; 3]>) {
    let mut ring: Vec<u32> = (0..flat.len() as u32).collect();
    while ring.len() > 3 {
        let n = ring.len();
        let Some(ear) = (0..n).find(|&i| is_ear(flat, &ring, i)) else { break };
        out.push([ring[(ear + n - 1) % n], ring[ear], ring[(ear + 1) % n]]);
        ring.remove(ear);
    }
    fan(&ring, out);
}

fn is_ear(flat: &[[f64; 2]], ring: &[u32], i: usize) -> bool {
    let n = ring.len();
    let at = |i: usize| flat[ring[i % n] as usize];
    let (a, b, c) = (at(i + n - 1), at(i), at(i + 1));
    if turn(a, b, c) <= 0.0 {
        return false;
    }
    (2..n - 1).map(|k| at(i + k)).all(|p| {
        let at_corner = p == a || p == b || p == c;
        at_corner || turn(a, b, p) < 0.0 || turn(b, c, p) < 0.0 || turn(c, a, p) < 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(corners: &[[f64; 3]]) -> Vec<[u32; 3]> {
        let mut out = Vec::new();
        triangulate(corners, &mut out);
        out
    }

    fn area(corners: &[[f64; 3]], triangles: &[[u32; 3]]) -> f64 {
        let flat = |i: u32| [corners[i as usize][0], corners[i as usize][1]];
        triangles.iter().map(|t| turn(flat(t[0]), flat(t[1]), flat(t[2])).abs() / 2.0).sum()
    }

    #[test]
    fn convex_polygons_become_fans() {
        let square = [[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [1.0, 1.0, 5.0], [0.0, 1.0, 5.0]];
        assert_eq!(cut(&square), [[0, 1, 2], [0, 2, 3]]);
        assert!(cut(&square[..2]).is_empty());
    }

    #[test]
    fn concave_polygons_are_covered_once_in_both_orientations() {
        let mut arrow = vec![[0.0, 0.0, 0.0], [2.0, -2.0, 0.0], [1.0, 0.0, 0.0], [2.0, 2.0, 0.0]];
        assert!((area(&arrow, &cut(&arrow)) - 2.0).abs() < 1e-12);
        arrow.rotate_left(1);
        assert!((area(&arrow, &cut(&arrow)) - 2.0).abs() < 1e-12);
        arrow.reverse();
        assert!((area(&arrow, &cut(&arrow)) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn any_polygon_gives_two_triangles_less_than_corners() {
        let comb: Vec<[f64; 3]> = (0..60)
            .map(|i| [f64::from(i), f64::from(i % 2 * 5), 0.0])
            .chain([[60.0, 9.0, 0.0], [0.0, 9.0, 0.0]])
            .collect();
        assert_eq!(cut(&comb).len(), comb.len() - 2);
        assert_eq!(cut(&[[1.0; 3]; 17]).len(), 15);
        let star: Vec<[f64; 3]> =
            (0..5).map(|i| [f64::from(i * 2 % 5).cos(), f64::from(i * 2 % 5).sin(), 0.0]).collect();
        assert_eq!(cut(&star).len(), 3);
        assert_eq!(cut(&vec![[0.0, 1.0, 2.0]; 5000]).len(), 4998);
    }
}
