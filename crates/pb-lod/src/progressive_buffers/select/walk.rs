//! The walk over the coarse buffer hierarchy: frustum culling, and subtrees that are all coarsest taken as one
//! range of the coarse buffer without a visit to their leaves (paper section 3.3).
//!
//! Where there are instances, each object's subtree is walked once for each of its instances that is near or in sight, with
//! the eyes moved to where they are for the object.

use std::ops::Range;

use glam::{DVec3, Vec4Swizzles};

use super::super::instances::Placement;
use super::super::switch::Switch;
use super::crowd::{Block, Crowd, Object};
use super::tables::{Node, Sphere, Tables};
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

/// What a walk looks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Scope {
    /// All that is not coarsest at this fraction of its distance, wherever it is.
    Around(f32),
    /// What touches a frustum, and the neighbours of it: their floors move triangles that are seen. Neighbours stand
    /// [`Place::Elsewhere`].
    Drawn,
}

/// A cluster that is drawn on its own, or that may be wanted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub cluster: u32,
    /// Of its object; 0 where there are none.
    pub instance: u32,
    pub place: Place,
    /// Touches a frustum, or a cluster that does: its floor moves triangles that are seen.
    pub shows: bool,
    /// Comparable with switch distances; see [`Eyes::reach`].
    pub reach: f32,
    /// Its radius as a reach.
    pub girth: f32,
    /// World size of a pixel at its nearest point, over all views.
    pub pixel: f32,
}

/// What a walk found.
#[derive(Default)]
pub(super) struct Walk {
    /// Clusters that are not certainly coarsest: in tree order, neighbours last.
    pub seen: Vec<Seen>,
    /// Runs of visible clusters that are certainly coarsest, by instance.
    pub coarse: Vec<(u32, Range<u32>)>,
    /// Per cluster: the last walk over a tree in which it touches a frustum; 0 where none does.
    visible: Vec<u32>,
    /// Number of the walk over a tree that is under way, from 1.
    turn: u32,
    /// Instances that touch a frustum, ascending.
    in_sight: Vec<u32>,
    /// Bound of the projected error of the coarse runs, pixels.
    pub coarse_error_px: f32,
    /// Per cluster: found as a neighbour; all false between walks.
    beside: Vec<bool>,
    stack: Vec<Visit>,
    /// The eyes as an instance's object has them.
    local: Eyes,
}

/// A node that is still to be visited.
#[derive(Clone, Copy)]
struct Visit {
    node: u32,
    /// It lies inside one frustum as a whole.
    whole: bool,
    /// Eyes that may see it, a bit each; eyes past the 64th share bits.
    eyes: u64,
}

#[derive(Clone)]
struct Eye {
    position: DVec3,
    /// Unit normals and offsets, relative to the eye.
    planes: Vec<(DVec3, f64)>,
    pixel_angle: f64,
    /// World distance times this is a reach.
    unit: f64,
}

/// The views of a frame, prepared.
#[derive(Default)]
pub(super) struct Eyes {
    eyes: Vec<Eye>,
    quantum: f64,
    /// All eyes have the same pixels, so the nearest one has the smallest reach.
    alike: bool,
    /// Smallest of the eyes' units.
    unit: f64,
    /// Reaches are distances.
    bands: bool,
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
        let eyes: Vec<Eye> = views.iter().map(eye).collect();
        let alike = eyes.windows(2).all(|w| w[0].pixel_angle == w[1].pixel_angle);
        let unit = eyes.iter().map(|e| e.unit).fold(f64::INFINITY, f64::min);
        Eyes { eyes, quantum: t.quantum, alike, unit, bands: matches!(detail, Detail::Bands { .. }) }
    }

    /// What multiplies a reach in the space of an object to make one that switch distances can be compared with: a
    /// projected error is the same in both, a distance is not.
    fn stretch(&self, placement: &Placement) -> f64 {
        if self.bands { placement.scale } else { 1.0 }
    }

    /// The same eyes seen from an object that stands somewhere: all in its units and axes.
    fn enter(&mut self, placement: &Placement, world: &Eyes) {
        let stretch = world.stretch(placement);
        self.eyes.truncate(world.eyes.len());
        let known = self.eyes.len();
        self.eyes.extend_from_slice(&world.eyes[known..]);
        let turn = placement.rotation.conjugate();
        for (local, eye) in self.eyes.iter_mut().zip(&world.eyes) {
            local.position = placement.point_of(eye.position);
            local.planes.clear();
            local.planes.extend(eye.planes.iter().map(|&(n, w)| (turn * n, w / placement.scale)));
            (local.pixel_angle, local.unit) = (eye.pixel_angle, eye.unit * stretch);
        }
        (self.quantum, self.alike) = (world.quantum, world.alike);
        (self.unit, self.bands) = (world.unit * stretch, world.bands);
    }

    /// Reach and pixel size of a sphere of an object that stands somewhere, as [`Eyes::enter`] would have them.
    pub fn reach_at(&self, placement: &Placement, sphere: &Sphere) -> (f32, f32) {
        let stretch = self.stretch(placement) as f32;
        let each = self.eyes.iter().map(|eye| {
            let squared = (sphere.center - placement.point_of(eye.position)).length_squared();
            self.seen_at(eye, sphere, squared)
        });
        let (reach, pixel) = each.fold((f32::INFINITY, f32::INFINITY), |a, b| (a.0.min(b.0), a.1.min(b.1)));
        (reach * stretch, pixel)
    }

    /// Reach and pixel size of a sphere's nearest point: the smallest over the views. A reach is the distance
    /// (bands) or the distance times the pixel angle (errors), so that one table serves all views; it is
    /// rounded down so that no vertex in the sphere is nearer in the shader's f32 (design section 3).
    fn reach_of(&self, sphere: &Sphere) -> (f32, f32) {
        let squared = |eye: &Eye| (sphere.center - eye.position).length_squared();
        let (reach, pixel) = match &self.eyes[..] {
            [first, rest @ ..] if self.alike => {
                self.seen_at(first, sphere, rest.iter().map(squared).fold(squared(first), f64::min))
            }
            eyes => {
                let each = eyes.iter().map(|eye| self.seen_at(eye, sphere, squared(eye)));
                each.fold((f32::INFINITY, f32::INFINITY), |a, b| (a.0.min(b.0), a.1.min(b.1)))
            }
        };
        (reach, pixel)
    }

    /// Reach and pixel size of a sphere for one eye, from the square of the distance to its centre.
    fn seen_at(&self, eye: &Eye, sphere: &Sphere, squared: f64) -> (f32, f32) {
        let near = (squared.sqrt() - sphere.radius).max(0.0);
        let reach = (near * (1.0 - ROUNDING) - self.quantum).max(0.0) * eye.unit;
        (reach as f32, (near.max(self.quantum) * eye.pixel_angle) as f32)
    }

    /// Reach and pixel size of a cluster.
    pub fn reach(&self, t: &Tables, cluster: u32) -> (f32, f32) {
        self.reach_of(t.sphere(cluster))
    }

    /// Best place over all views; the flag says that the whole sphere is inside one frustum.
    fn place(&self, sphere: &Sphere) -> (Place, bool) {
        let (mut best, mut whole) = (Place::Elsewhere, false);
        for eye in &self.eyes {
            let offset = sphere.center - eye.position;
            let depth = eye.planes.iter().map(|(n, w)| n.dot(offset) + w).fold(f64::INFINITY, f64::min);
            let place = match depth {
                d if d >= -sphere.radius => Place::Visible,
                d if d >= -sphere.radius - RING * offset.length() => Place::Ring,
                _ => Place::Elsewhere,
            };
            best = best.max(place);
            whole |= depth >= sphere.radius;
        }
        (best, whole)
    }

    /// Those of `among` that see a sphere; the flag says that one of them has the whole of it. Of those that see a leaf the
    /// first is enough: nobody asks its children.
    fn seen_by(&self, sphere: &Sphere, among: u64, is_leaf: bool) -> (u64, bool) {
        let mut by = 0;
        for (i, eye) in self.eyes.iter().enumerate().filter(|(i, _)| among >> (i % 64) & 1 != 0) {
            let offset = sphere.center - eye.position;
            let mut depth = f64::INFINITY;
            for (n, w) in &eye.planes {
                depth = depth.min(n.dot(offset) + w);
                if depth < -sphere.radius {
                    break;
                }
            }
            if depth >= sphere.radius {
                return (among, true);
            }
            by |= u64::from(depth >= -sphere.radius) << (i % 64);
            if is_leaf && by != 0 {
                break;
            }
        }
        (by, false)
    }

    /// Projected size of an error whose nearest point has this pixel size; at most one radian.
    pub fn error_px(&self, error: f32, pixel: f32) -> f32 {
        let radian = self.eyes.iter().map(|e| 1.0 / e.pixel_angle).fold(0.0, f64::max) as f32;
        if error == 0.0 { 0.0 } else { (error / pixel).min(radian) }
    }
}

/// What a walk is for: the switches of geometry and textures, and what is looked for.
struct Search<'a> {
    t: &'a Tables,
    switches: &'a [Switch; 2],
    scope: Scope,
    /// Part of a distance at which all that is coarsest is left alone.
    margin: f32,
}

impl Search<'_> {
    /// Whether all clusters below a node are coarsest from this reach on.
    fn coarse(&self, node: &Node, reach: f32) -> bool {
        let [switch, textures] = self.switches;
        let farthest = switch.bands.as_ref().map(|bands| bands[self.t.levels as usize - 1]);
        let reach = reach * self.margin;
        reach >= farthest.unwrap_or(node.error * switch.scale) && self.t.textures_coarse(textures, node, reach)
    }
}

impl Walk {
    /// Walks the tree. Subtrees that stay coarsest are not entered, except to cull their invisible parts; what lies
    /// inside a frustum as a whole is not culled again.
    /// The switches are those of geometry and textures.
    pub fn go(&mut self, t: &Tables, eyes: &Eyes, switches: &[Switch; 2], scope: Scope) {
        self.seen.clear();
        self.coarse.clear();
        self.visible.clear();
        self.visible.resize(t.clusters(), 0);
        self.turn = 0;
        self.in_sight.clear();
        self.coarse_error_px = 0.0;
        let margin = if let Scope::Around(margin) = scope { margin } else { 1.0 };
        let search = Search { t, switches, scope, margin };
        match &t.crowd {
            Some(crowd) => {
                crowd.objects.iter().for_each(|object| self.walk_object(&search, eyes, crowd, object));
            }
            None if t.nodes.is_empty() => {}
            None => self.walk_tree(&search, eyes, 0, 0),
        }
    }

    /// Looks at all instances of an object.
    fn walk_object(&mut self, search: &Search, eyes: &Eyes, crowd: &Crowd, object: &Object) {
        let node = &search.t.nodes[object.node as usize];
        for Block { sphere, scale, instances } in crowd.blocks(object) {
            let (place, _) = place_of(eyes, sphere, search.scope);
            if place < Place::Visible {
                // As the largest instance would have it, with its nearest point where the block's is.
                let reach = eyes.reach_of(sphere).0 / if eyes.bands { 1.0 } else { *scale as f32 };
                if search.scope == Scope::Drawn || search.coarse(node, reach) {
                    continue;
                }
            }
            instances.clone().for_each(|instance| self.walk_instance(search, eyes, crowd, (object.node, instance)));
        }
    }

    /// One instance: as a whole, where that says enough, else its tree.
    fn walk_instance(&mut self, search: &Search, eyes: &Eyes, crowd: &Crowd, (root, instance): (u32, u32)) {
        let node = &search.t.nodes[root as usize];
        let placement = crowd.placement(instance);
        let (place, whole) = place_of(eyes, &crowd.sphere(&node.sphere, instance), search.scope);
        if place < Place::Visible && search.scope == Scope::Drawn {
            return;
        }
        let (reach, pixel) = eyes.reach_at(placement, &node.sphere);
        let coarse = search.coarse(node, reach);
        if place == Place::Visible {
            self.in_sight.push(instance);
        }
        match coarse {
            true if place < Place::Visible => {}
            true if whole => {
                self.turn += 1;
                self.take_coarse(eyes, node, pixel, instance);
            }
            _ => {
                let mut local = std::mem::take(&mut self.local);
                local.enter(placement, eyes);
                self.walk_tree(search, &local, root, instance);
                self.local = local;
            }
        }
    }

    /// Walks one tree, with the eyes in its space.
    fn walk_tree(&mut self, search: &Search, eyes: &Eyes, root: u32, instance: u32) {
        let &Search { t, scope, .. } = search;
        self.turn += 1;
        let first = self.seen.len();
        self.stack.push(Visit { node: root, whole: false, eyes: u64::MAX });
        while let Some(visit) = self.stack.pop() {
            let node = &t.nodes[visit.node as usize];
            let (place, visit) = look(eyes, node, visit, scope);
            if place < Place::Visible && scope == Scope::Drawn {
                continue;
            }
            let (reach, pixel) = eyes.reach_of(&node.sphere);
            let coarse = search.coarse(node, reach);
            match node.children {
                _ if coarse && place < Place::Visible => {}
                Some(children) if !(coarse && visit.whole) => {
                    self.stack.extend(children.iter().rev().map(|&node| Visit { node, ..visit }));
                }
                _ if coarse => self.take_coarse(eyes, node, pixel, instance),
                _ => {
                    let clusters = node.first..node.first + node.count;
                    clusters.for_each(|c| self.see(t, eyes, (c, instance), place, (reach, pixel)));
                }
            }
        }
        match scope {
            Scope::Drawn => self.see_neighbours(t, eyes, first, instance),
            Scope::Around(_) => {
                let Walk { seen, visible, turn, .. } = self;
                for s in seen[first..].iter_mut().filter(|s| !s.shows) {
                    s.shows = t.neighbours(s.cluster).iter().any(|&c| visible[c as usize] == *turn);
                }
            }
        }
    }

    /// A node that is visible and certainly coarsest.
    fn take_coarse(&mut self, eyes: &Eyes, node: &Node, pixel: f32, instance: u32) {
        let clusters = node.first..node.first + node.count;
        self.visible[clusters.start as usize..clusters.end as usize].fill(self.turn);
        self.coarse_error_px = self.coarse_error_px.max(eyes.error_px(node.error, pixel));
        self.coarse.push((instance, clusters));
    }

    /// Runs need no look at their neighbours: what lies inside a frustum as a whole has its borders there, and so touches
    /// no cluster that is out of sight.
    fn see_neighbours(&mut self, t: &Tables, eyes: &Eyes, first: usize, instance: u32) {
        let visible = self.seen.len();
        self.beside.resize(t.clusters(), false);
        for i in first..visible {
            for &c in t.neighbours(self.seen[i].cluster) {
                if self.visible[c as usize] != self.turn && !std::mem::replace(&mut self.beside[c as usize], true) {
                    self.see(t, eyes, (c, instance), Place::Elsewhere, eyes.reach(t, c));
                    self.seen.last_mut().expect("it was just pushed").shows = true;
                }
            }
        }
        self.seen[visible..].iter().for_each(|s| self.beside[s.cluster as usize] = false);
    }

    fn see(
        &mut self,
        t: &Tables,
        eyes: &Eyes,
        (cluster, instance): (u32, u32),
        place: Place,
        (reach, pixel): (f32, f32),
    ) {
        let shows = place == Place::Visible;
        if shows {
            self.visible[cluster as usize] = self.turn;
        }
        let girth = (t.sphere(cluster).radius * eyes.unit) as f32;
        self.seen.push(Seen { cluster, instance, place, shows, reach, girth, pixel });
    }

    /// Whether a cluster touches a frustum, in any instance.
    pub fn is_visible(&self, cluster: u32) -> bool {
        self.visible[cluster as usize] != 0
    }

    /// Reach of a cluster: the smallest over the views and over the instances in sight. Infinite where none is.
    pub fn reach(&self, t: &Tables, eyes: &Eyes, cluster: u32) -> f32 {
        let Some(crowd) = &t.crowd else { return eyes.reach(t, cluster).0 };
        let instances = crowd.instances_of(cluster);
        let first = self.in_sight.partition_point(|&i| i < instances.start);
        let own = self.in_sight[first..].iter().take_while(|i| instances.contains(i));
        own.map(|&i| eyes.reach_at(crowd.placement(i), t.sphere(cluster)).0).fold(f32::INFINITY, f32::min)
    }
}

/// Where a sphere is for some eyes, as far as the scope asks; the flag says that it is in one frustum as a whole.
fn place_of(eyes: &Eyes, sphere: &Sphere, scope: Scope) -> (Place, bool) {
    match scope {
        Scope::Around(_) => eyes.place(sphere),
        Scope::Drawn => {
            let (by, whole) = eyes.seen_by(sphere, u64::MAX, false);
            (if by == 0 { Place::Elsewhere } else { Place::Visible }, whole)
        }
    }
}

/// Where a node is, from where its parent was; and what its children inherit.
fn look(eyes: &Eyes, node: &Node, parent: Visit, scope: Scope) -> (Place, Visit) {
    if parent.whole {
        return (Place::Visible, parent);
    }
    match scope {
        Scope::Around(_) => {
            let (place, whole) = eyes.place(&node.sphere);
            (place, Visit { whole, ..parent })
        }
        Scope::Drawn => {
            let (by, whole) = eyes.seen_by(&node.sphere, parent.eyes, node.children.is_none());
            (if by == 0 { Place::Elsewhere } else { Place::Visible }, Visit { whole, eyes: by, ..parent })
        }
    }
}
