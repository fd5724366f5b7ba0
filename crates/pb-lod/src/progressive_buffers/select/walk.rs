//! The walk over the coarse buffer hierarchy: frustum culling, and subtrees that are all coarsest taken as one
//! range of the coarse buffer without a visit to their leaves (paper section 3.3).

use std::ops::Range;

use glam::{DVec3, Vec4Swizzles};

use super::super::switch::Switch;
use super::tables::{Sphere, Tables};
use crate::plan::{Detail, View};

/// Frusta widen by this fraction of the distance for what may come into view next: about 17 degrees.
const RING: f64 = 0.3;
/// Distances are shortened by this before they choose a level: the shader measures them in f32.
const ROUNDING: f64 = 1e-5;

/// Where a cluster stands for the views of a frame; the best place over all views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Place {
    /// Outside even the widened frusta.
    Elsewhere,
    /// Inside a widened frustum.
    Ring,
    /// Touches a frustum.
    Visible,
}

/// A cluster that is drawn on its own, or that may be wanted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub cluster: u32,
    pub place: Place,
    /// It is visible, or its floor moves a border with one that is, and so triangles that are seen.
    pub shows: bool,
    /// Comparable with switch distances; see [`Eyes::reach`].
    pub reach: f32,
    /// Its radius as a reach.
    pub girth: f32,
    /// World size of a pixel at its nearest point, over all views.
    pub pixel: f32,
}

/// What a walk found.
pub(super) struct Walk {
    /// Clusters that are not certainly coarsest, in tree order.
    pub seen: Vec<Seen>,
    /// Runs of visible clusters that are certainly coarsest.
    pub coarse: Vec<Range<u32>>,
    /// Per cluster: touches a frustum.
    pub visible: Vec<bool>,
    /// Bound of the projected error of the coarse runs, pixels.
    pub coarse_error_px: f32,
}

struct Eye {
    position: DVec3,
    /// Unit normals and offsets, relative to the eye.
    planes: Vec<(DVec3, f64)>,
    pixel_angle: f64,
    /// World distance times this is a reach.
    unit: f64,
}

/// The views of a frame, prepared.
pub(super) struct Eyes {
    eyes: Vec<Eye>,
    quantum: f64,
}

impl Eyes {
    pub fn new(views: &[View], detail: Detail, t: &Tables) -> Eyes {
        let eye = |view: &View| Eye {
            position: view.eye - t.origin,
            planes: view
                .planes
                .iter()
                .map(|p| (p.xyz().as_dvec3(), p.w as f64))
                .filter(|(n, _)| n.length() > 0.0)
                .map(|(n, w)| (n / n.length(), w / n.length()))
                .collect(),
            pixel_angle: view.pixel_angle as f64,
            unit: match detail {
                Detail::ErrorPx(_) => view.pixel_angle as f64,
                Detail::Bands { .. } => 1.0,
            },
        };
        Eyes { eyes: views.iter().map(eye).collect(), quantum: t.quantum }
    }

    /// Reach and pixel size of a sphere's nearest point: the smallest over the views. A reach is the distance
    /// (bands) or the distance times the pixel angle (errors), so that one table serves all views; it is
    /// rounded down so that no vertex in the sphere is nearer in the shader's f32 (design section 3).
    fn reach_of(&self, sphere: &Sphere) -> (f32, f32) {
        let (mut reach, mut pixel) = (f64::INFINITY, f64::INFINITY);
        for eye in &self.eyes {
            let (offset, radius) = self.place_sphere(eye, sphere);
            let near = (offset.length() - radius).max(0.0);
            reach = reach.min((near * (1.0 - ROUNDING) - self.quantum).max(0.0) * eye.unit);
            pixel = pixel.min(near.max(self.quantum) * eye.pixel_angle);
        }
        (reach as f32, pixel as f32)
    }

    /// Reach and pixel size of a cluster.
    pub fn reach(&self, t: &Tables, cluster: u32) -> (f32, f32) {
        self.reach_of(&t.sphere(cluster))
    }

    /// Offset from the eye and radius of a sphere, world units.
    fn place_sphere(&self, eye: &Eye, sphere: &Sphere) -> (DVec3, f64) {
        let center = DVec3::from_array(sphere.center.map(|v| v as f64)) * self.quantum;
        (center - eye.position, sphere.radius as f64 * self.quantum)
    }

    /// Best place over all views; the flag says that the whole sphere is inside one frustum.
    fn place(&self, sphere: &Sphere) -> (Place, bool) {
        let (mut best, mut whole) = (Place::Elsewhere, false);
        for eye in &self.eyes {
            let (offset, radius) = self.place_sphere(eye, sphere);
            let depth = eye.planes.iter().map(|(n, w)| n.dot(offset) + w).fold(f64::INFINITY, f64::min);
            let place = match depth {
                d if d >= -radius => Place::Visible,
                d if d >= -radius - RING * offset.length() => Place::Ring,
                _ => Place::Elsewhere,
            };
            best = best.max(place);
            whole |= depth >= radius;
        }
        (best, whole)
    }

    /// Projected size of an error whose nearest point has this pixel size; at most one radian.
    pub fn error_px(&self, error: f32, pixel: f32) -> f32 {
        let radian = self.eyes.iter().map(|e| 1.0 / e.pixel_angle).fold(0.0, f64::max) as f32;
        if error == 0.0 { 0.0 } else { (error / pixel).min(radian) }
    }
}

/// Walks the tree. Subtrees that stay coarsest even at `margin` times their distance are not entered, except
/// to cull their invisible parts.
pub(super) fn walk(t: &Tables, eyes: &Eyes, switch: &Switch, margin: f32) -> Walk {
    let mut out =
        Walk { seen: Vec::new(), coarse: Vec::new(), visible: vec![false; t.clusters()], coarse_error_px: 0.0 };
    let mut stack = if t.nodes.is_empty() { vec![] } else { vec![0u32] };
    let coarsest = t.levels as usize - 1;
    while let Some(index) = stack.pop() {
        let node = &t.nodes[index as usize];
        let (place, whole) = eyes.place(&node.sphere);
        let (reach, pixel) = eyes.reach_of(&node.sphere);
        let farthest_switch = match &switch.bands {
            Some(bands) => bands[coarsest],
            None => node.error * switch.scale,
        };
        let coarse = reach * margin >= farthest_switch && t.textures_coarse(switch, node, reach * margin);
        let clusters = node.first..node.first + node.count;
        match node.children {
            _ if coarse && place < Place::Visible => {}
            Some(children) if !(coarse && whole) => stack.extend(children.iter().rev()),
            _ if coarse => {
                out.visible[clusters.start as usize..clusters.end as usize].fill(true);
                out.coarse_error_px = out.coarse_error_px.max(eyes.error_px(node.error, pixel));
                out.coarse.push(clusters);
            }
            _ => clusters.for_each(|c| out.see(t, eyes, c)),
        }
    }
    let visible = &out.visible;
    for seen in out.seen.iter_mut().filter(|s| !s.shows) {
        seen.shows = t.neighbours(seen.cluster).iter().any(|&c| visible[c as usize]);
    }
    out
}

impl Walk {
    fn see(&mut self, t: &Tables, eyes: &Eyes, cluster: u32) {
        let (reach, pixel) = eyes.reach(t, cluster);
        let place = eyes.place(&t.sphere(cluster)).0;
        self.visible[cluster as usize] = place == Place::Visible;
        let unit = eyes.eyes.iter().map(|e| e.unit).fold(f64::INFINITY, f64::min);
        let girth = (t.sphere(cluster).radius as f64 * eyes.quantum * unit) as f32;
        self.seen.push(Seen { cluster, place, shows: place == Place::Visible, reach, girth, pixel });
    }
}
