//! Cutting a part open until it is a disc: along the shortest arcs that join its borders and open its handles.
//!
//! Tree and cotree with greedy choice (Eppstein 2003; Erickson and Whittlesey 2005): T is the forest of shortest paths
//! to the border, C a spanning tree of the triangles over edges outside of T that prefers to cross edges far from the
//! border; each edge in neither closes one arc, its two shortest paths to the border the rest of it.

use super::piece::{NONE, Piece, next};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Opens `piece`, which has a border or a handle, into a disc.
pub(super) fn open_to_disc(piece: &mut Piece) {
    let (distance, towards) = shortest_paths(piece);
    let mut in_forest = vec![false; piece.partner.len()];
    for &h in towards.iter().filter(|&&h| h != NONE) {
        in_forest[h as usize] = true;
        in_forest[piece.partner[h as usize] as usize] = true;
    }
    let inner = (0..piece.partner.len() as u32).filter(|&h| {
        let p = piece.partner[h as usize];
        p != NONE && h < p && !in_forest[h as usize]
    });
    let mut candidates: Vec<(f64, u32)> = inner
        .map(|h| {
            let (a, b) = (piece.start(h) as usize, piece.start(next(h)) as usize);
            (distance[a] + distance[b] + piece.points[a].distance(piece.points[b]), h)
        })
        .collect();
    candidates.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut root: Vec<u32> = (0..piece.triangles.len() as u32).collect();
    let mut marked = vec![false; piece.partner.len()];
    for (_, h) in candidates {
        let across = piece.partner[h as usize];
        let (a, b) = (find(&mut root, h / 3), find(&mut root, across / 3));
        if a != b {
            root[a.max(b) as usize] = a.min(b);
            continue;
        }
        mark(piece, &mut marked, h);
        for mut v in [piece.start(h), piece.start(across)] {
            while towards[v as usize] != NONE && !marked[towards[v as usize] as usize] {
                let step = towards[v as usize];
                mark(piece, &mut marked, step);
                v = piece.start(next(step));
            }
        }
    }
    piece.cut(&marked);
}

fn mark(piece: &Piece, marked: &mut [bool], h: u32) {
    marked[h as usize] = true;
    marked[piece.partner[h as usize] as usize] = true;
}

fn find(root: &mut [u32], mut t: u32) -> u32 {
    while root[t as usize] != t {
        root[t as usize] = root[root[t as usize] as usize];
        t = root[t as usize];
    }
    t
}

/// Distance of every vertex from the border (from vertex 0 where there is none) along edges, and the half-edge that
/// leads there.
fn shortest_paths(piece: &Piece) -> (Vec<f64>, Vec<u32>) {
    let mut distance = vec![f64::INFINITY; piece.points.len()];
    let mut towards = vec![NONE; piece.points.len()];
    let mut queue: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
    let closed = !piece.on_border.contains(&true);
    for (v, at) in distance.iter_mut().enumerate() {
        if piece.on_border[v] || (closed && v == 0) {
            *at = 0.0;
            queue.push(Reverse((0, v as u32)));
        }
    }
    let mut out = vec![NONE; piece.points.len()];
    (0..piece.partner.len() as u32).for_each(|h| out[piece.start(h) as usize] = h);
    while let Some(Reverse((bits, v))) = queue.pop() {
        let from = f64::from_bits(bits);
        if from > distance[v as usize] {
            continue;
        }
        for h in ring(piece, out[v as usize]) {
            let w = piece.start(next(h)) as usize;
            let to = from + piece.points[v as usize].distance(piece.points[w]);
            if to < distance[w] {
                distance[w] = to;
                towards[w] = piece.partner[h as usize];
                queue.push(Reverse((to.to_bits(), w as u32)));
            }
        }
    }
    (distance, towards)
}

/// Inner half-edges that start where `first` does.
fn ring(piece: &Piece, first: u32) -> impl Iterator<Item = u32> + '_ {
    let mut start = first;
    loop {
        let back = piece.partner[super::piece::prev(start) as usize];
        if back == NONE || back == first {
            break;
        }
        start = back;
    }
    let begin = start;
    let mut at = Some(start);
    std::iter::from_fn(move || {
        let h = at?;
        let across = piece.partner[h as usize];
        at = if across == NONE { None } else { Some(next(across)).filter(|&n| n != begin) };
        Some(h)
    })
    .filter(|&h| piece.partner[h as usize] != NONE)
}
