//! Dividing a layout that lies on itself into parts that do not, each where it was: so a part is laid out once, however
//! many charts come of it. It is halved until nothing overlaps; then neighbours whose union does not overlap are joined
//! again, those with the longest seam first.

use super::flatten::stretches;
use super::halve::halve;
use super::outline::overlaps;
use super::piece::{NONE, Piece, components, next};
use super::stretch::Stretch;
use glam::DVec2;
use std::collections::{BTreeMap, BTreeSet};

/// Weight of place against normals where a layout is divided.
const PLACE: f64 = 3.0;
/// Rounds of halving: what is cut too much is joined again.
const ROUNDS: usize = 1;
/// Parts are not joined where the box around both has more than this many times the area of their boxes: they would pack
/// badly.
const MAX_SPRAWL: f64 = 1.3;

/// A part of a layout that does not lie on itself.
pub(super) struct Division {
    /// Its triangles, with the indices of the surface, and connected as in the layout.
    pub piece: Piece,
    /// Per vertex of the piece.
    pub uv: Vec<DVec2>,
    pub stretch: Stretch,
}

/// Divides `disc`, which lies on itself at `uv`. Returns discs that do not, of at most `max_stretch`, and the triangles
/// (indices of the surface, ascending) of parts that need another layout. There are two or more in all.
pub(super) fn divide(disc: &Piece, uv: &[DVec2], max_stretch: f64) -> (Vec<Division>, Vec<Vec<u32>>) {
    let mut divider =
        Divider { disc, uv, max_stretch, stretches: stretches(disc, uv), scratch: vec![NONE; disc.faces.len()] };
    let parts = divider.halved();
    let (mut done, mut rest) = (Vec::new(), Vec::new());
    for faces in divider.joined(parts) {
        let (good, mut division) = divider.division(&faces);
        division.piece.faces = faces.iter().map(|&f| disc.faces[f as usize]).collect();
        match good && faces.len() > 1 {
            true => done.push(division),
            false => rest.push(division.piece.faces),
        }
    }
    (done, rest)
}

struct Divider<'a> {
    disc: &'a Piece,
    uv: &'a [DVec2],
    max_stretch: f64,
    /// Per triangle of the disc.
    stretches: Vec<Stretch>,
    scratch: Vec<u32>,
}

impl Divider<'_> {
    /// The piece of some triangles of the disc, and whether it is a disc that lies flat enough; it may lie on itself.
    fn division(&mut self, faces: &[u32]) -> (bool, Division) {
        let (disc, whole) = (self.disc, self.uv);
        let corner = |f: u32, k: usize| disc.triangles[f as usize][k] as usize;
        let piece = Piece::new(faces, &disc.partner, |f, k| disc.points[corner(f, k)], &mut self.scratch);
        let mut uv = vec![DVec2::ZERO; piece.points.len()];
        for (&f, t) in faces.iter().zip(&piece.triangles) {
            (0..3).for_each(|k| uv[t[k] as usize] = whole[corner(f, k)]);
        }
        let mut stretch = Stretch::default();
        faces.iter().for_each(|&f| stretch.merge(&self.stretches[f as usize]));
        let good = piece.euler_characteristic() == 1 && stretch.l2() <= self.max_stretch;
        (good, Division { piece, uv, stretch })
    }

    /// Parts that do not lie on themselves, or are no discs; triangles ascending.
    fn halved(&mut self) -> Vec<Vec<u32>> {
        let mut parts = Vec::new();
        let all: Vec<u32> = (0..self.disc.faces.len() as u32).collect();
        let mut open = vec![self.division(&all).1.piece];
        while let Some(piece) = open.pop() {
            let half = halve(&piece, PLACE, ROUNDS);
            for local in components(&piece.partner, |t| u32::from(half[t as usize])) {
                let faces: Vec<u32> = local.into_iter().map(|t| piece.faces[t as usize]).collect();
                let (good, division) = self.division(&faces);
                match good && overlaps(&division.piece, &division.uv) {
                    true => open.push(division.piece),
                    false => parts.push(faces),
                }
            }
        }
        parts
    }

    /// Joins parts.
    fn joined(&mut self, parts: Vec<Vec<u32>>) -> Vec<Vec<u32>> {
        let mut part_of = vec![0; self.disc.faces.len()];
        let mut parts: Vec<Option<Vec<u32>>> = parts.into_iter().map(Some).collect();
        let mut hopeless: BTreeSet<(u32, u32)> = BTreeSet::new();
        loop {
            for (i, part) in parts.iter().enumerate() {
                part.iter().flatten().for_each(|&f| part_of[f as usize] = i as u32);
            }
            let before = parts.len();
            for (a, b) in self.seams(&part_of) {
                let (Some(first), Some(second)) = (&parts[a as usize], &parts[b as usize]) else { continue };
                let mut faces = [&first[..], &second[..]].concat();
                let sprawls = || self.box_area(&faces) > MAX_SPRAWL * (self.box_area(first) + self.box_area(second));
                if !hopeless.insert((a, b)) || sprawls() {
                    continue;
                }
                faces.sort_unstable();
                let (good, division) = self.division(&faces);
                if good && !overlaps(&division.piece, &division.uv) {
                    (parts[a as usize], parts[b as usize]) = (None, None);
                    parts.push(Some(faces));
                }
            }
            if parts.len() == before {
                return parts.into_iter().flatten().collect();
            }
        }
    }

    /// Of the box around some triangles in the plane.
    fn box_area(&self, faces: &[u32]) -> f64 {
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for v in faces.iter().flat_map(|&f| self.disc.triangles[f as usize]) {
            (low, high) = (low.min(self.uv[v as usize]), high.max(self.uv[v as usize]));
        }
        (high - low).element_product()
    }

    /// Neighbouring parts, those with the longest seam first.
    fn seams(&self, part_of: &[u32]) -> Vec<(u32, u32)> {
        let mut lengths: BTreeMap<(u32, u32), f64> = BTreeMap::new();
        for (h, &across) in self.disc.partner.iter().enumerate() {
            if across == NONE || part_of[h / 3] >= part_of[across as usize / 3] {
                continue;
            }
            let [a, b] = [h as u32, next(h as u32)].map(|h| self.disc.points[self.disc.start(h) as usize]);
            *lengths.entry((part_of[h / 3], part_of[across as usize / 3])).or_insert(0.0) += a.distance(b);
        }
        let mut pairs: Vec<((u32, u32), f64)> = lengths.into_iter().collect();
        pairs.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        pairs.into_iter().map(|(pair, _)| pair).collect()
    }
}
