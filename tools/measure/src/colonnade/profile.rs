//! Outlines that are turned into solids: lines with rounded corners, by arc length.

/// Lines of a rounded corner.
const CORNER_LINES: u32 = 6;
/// Over this much of the outline its direction is averaged, m: so that relief does not fold over corners.
const SMOOTHING: f64 = 0.025;

/// A point of an outline.
#[derive(Clone, Copy, Debug, Default)]
pub struct Point {
    /// Distance from the axis, m.
    pub radius: f64,
    /// Along the axis, m.
    pub height: f64,
    /// 0: the section is round, 1: square, with the radius to the middle of its sides.
    pub square: f64,
}

/// What the surface is like at a place of the outline.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    pub point: Point,
    /// Outwards: away from the axis, and along it; of length 1.
    pub normal: [f64; 2],
    /// 0 where the outline is straight or hollow, towards 1 at its edges.
    pub edge: f64,
}

/// An outline from the first end of a solid to its last.
#[derive(Clone, Debug)]
pub struct Profile {
    points: Vec<Point>,
    /// Arc length up to each point, m.
    lengths: Vec<f64>,
}

fn mixed(a: Point, b: Point, t: f64) -> Point {
    let mix = |x: f64, y: f64| x + (y - x) * t;
    Point { radius: mix(a.radius, b.radius), height: mix(a.height, b.height), square: mix(a.square, b.square) }
}

fn distance(a: Point, b: Point) -> f64 {
    (a.radius - b.radius).hypot(a.height - b.height).max((a.square - b.square).abs() * 0.3)
}

impl Profile {
    /// Through (radius, height, square), corners rounded over `fillet` m of either side at most.
    pub fn new(corners: &[[f64; 3]], fillet: f64) -> Profile {
        let corners: Vec<Point> =
            corners.iter().map(|&[radius, height, square]| Point { radius, height, square }).collect();
        let mut points = vec![corners[0]];
        for w in corners.windows(3) {
            let (before, after) = (distance(w[0], w[1]), distance(w[1], w[2]));
            let from = mixed(w[1], w[0], fillet.min(before * 0.45) / before);
            let to = mixed(w[1], w[2], fillet.min(after * 0.45) / after);
            points.extend((0..=CORNER_LINES).map(|i| {
                let t = f64::from(i) / f64::from(CORNER_LINES);
                mixed(mixed(from, w[1], t), mixed(w[1], to, t), t)
            }));
        }
        points.push(corners[corners.len() - 1]);
        let mut length = 0.0;
        let steps = points.windows(2).map(|w| {
            length += distance(w[0], w[1]);
            length
        });
        let lengths = std::iter::once(0.0).chain(steps.collect::<Vec<_>>()).collect();
        Profile { points, lengths }
    }

    /// Of the whole outline, m.
    pub fn length(&self) -> f64 {
        self.lengths[self.lengths.len() - 1]
    }

    /// Average distance from the axis, m.
    pub fn mean_radius(&self) -> f64 {
        let parts = self.points.windows(2).zip(self.lengths.windows(2));
        parts.map(|(p, l)| p[0].radius.midpoint(p[1].radius) * (l[1] - l[0])).sum::<f64>() / self.length()
    }

    /// Arc length at which the outline first reaches a height, m.
    pub fn length_at_height(&self, height: f64) -> f64 {
        let found = self.points.windows(2).position(|w| w[1].height >= height);
        let Some(i) = found else { return self.length() };
        let (a, b) = (self.points[i].height, self.points[i + 1].height);
        let t = if b > a { ((height - a) / (b - a)).clamp(0.0, 1.0) } else { 0.0 };
        self.lengths[i] + (self.lengths[i + 1] - self.lengths[i]) * t
    }

    fn point(&self, length: f64) -> Point {
        let i = self.lengths.partition_point(|l| *l <= length).clamp(1, self.points.len() - 1);
        let (from, to) = (self.lengths[i - 1], self.lengths[i]);
        mixed(self.points[i - 1], self.points[i], ((length - from) / (to - from).max(1e-12)).clamp(0.0, 1.0))
    }

    fn normal(&self, from: f64, to: f64) -> [f64; 2] {
        let (a, b) = (self.point(from.max(0.0)), self.point(to.min(self.length())));
        let (along, out) = (b.height - a.height, b.radius - a.radius);
        let length = along.hypot(out).max(1e-9);
        [along / length, -out / length]
    }

    /// The outline at an arc length, m.
    pub fn at(&self, length: f64) -> Place {
        let [below, above] =
            [self.normal(length - 2.0 * SMOOTHING, length), self.normal(length, length + 2.0 * SMOOTHING)];
        // Convex where the outline turns towards the axis on its way up.
        let turn = below[0] * above[1] - below[1] * above[0];
        Place {
            point: self.point(length),
            normal: self.normal(length - SMOOTHING, length + SMOOTHING),
            edge: turn.clamp(0.0, 1.0),
        }
    }
}
