//! Where the charts and clusters of an archive meet in a picture, so that errors there can be told from those elsewhere.
//!
//! The archive's finest level is exported with the texture coordinates of its tiles: a part of the file is a cluster,
//! triangles that share corners (place and coordinates) are a chart. The picture may show coarser levels; their borders are
//! the same lines to within the error that the view allows.

use anyhow::{Context, Result};
use image::GrayImage;
use std::collections::HashMap;
use std::path::Path;

use crate::parts::Parts;
use crate::reference::camera::Flypath;
use crate::reference::scene::Scene;
use crate::reference::{NONE, visible};

/// Where frames say what is a border: a folder beside them.
pub const PLACES: &str = "places";
/// How far the reciprocal depth may bend from pixel to pixel, of itself: more is an edge of the surface.
const BEND: f64 = 0.02;

/// What a pixel sees, as the grey of the pictures in [`PLACES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Place {
    /// Background, contours, edges behind which something else begins.
    Edge = 0,
    /// One chart, also in the pixels around it.
    Inside = 1,
    /// Several charts of one cluster.
    Charts = 2,
    /// Several clusters.
    Clusters = 3,
}

/// Cluster and chart of every triangle.
pub struct Borders {
    scene: Scene,
    chart_of: Vec<u32>,
}

impl Borders {
    /// Of an exported level.
    pub fn read(exported: &Path) -> Result<Borders> {
        let scene = Scene::read_shape(exported)?;
        let chart_of = charts(&scene);
        Ok(Borders { scene, chart_of })
    }

    /// Writes what the pixels of all frames of a flight see.
    pub fn write(&self, flight: &Flypath, size: [usize; 2], out: &Path) -> Result<()> {
        std::fs::create_dir_all(out).with_context(|| format!("{}: cannot be made", out.display()))?;
        for frame in 0..flight.frames() {
            let seen = visible(&self.scene, &flight.camera(frame, size), size);
            let places = self.places(&seen, size).into_iter().map(|p| p as u8).collect();
            let path = out.join(format!("frame_{frame:05}.png"));
            let picture = GrayImage::from_raw(size[0] as u32, size[1] as u32, places).context("a place per pixel")?;
            picture.save(&path).with_context(|| path.display().to_string())?;
        }
        Ok(())
    }

    fn places(&self, seen: &[[(f64, u32); 4]], [width, height]: [usize; 2]) -> Vec<Place> {
        let inverse = |i: usize| seen[i].iter().map(|s| 1.0 / s.0).sum::<f64>();
        let is_bent = |i: usize, step: usize| {
            let bend = inverse(i - step) - 2.0 * inverse(i) + inverse(i + step);
            bend.abs() > BEND * inverse(i)
        };
        let place = |i: usize| {
            let (x, y) = (i % width, i / width);
            if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
                return Place::Edge;
            }
            let around = [0, 1, 2].into_iter().flat_map(|dy| (0..3).map(move |dx| i + dy * width + dx - width - 1));
            let samples = || around.clone().flat_map(|j| seen[j].iter().map(|s| s.1));
            if samples().any(|t| t == NONE) || [1, width, width + 1, width - 1].iter().any(|step| is_bent(i, *step)) {
                return Place::Edge;
            }
            let cluster = |t: u32| self.scene.triangles[t as usize].material;
            let own = seen[i][0].1;
            match () {
                _ if samples().any(|t| cluster(t) != cluster(own)) => Place::Clusters,
                _ if samples().any(|t| self.chart_of[t as usize] != self.chart_of[own as usize]) => Place::Charts,
                _ => Place::Inside,
            }
        };
        (0..seen.len()).map(place).collect()
    }
}

/// Charts by triangle: those that share a corner in cluster, place and coordinates are one.
fn charts(scene: &Scene) -> Vec<u32> {
    let mut parts = Parts::new(scene.triangles.len());
    let mut first = HashMap::new();
    for (i, t) in scene.triangles.iter().enumerate() {
        for k in 0..3 {
            let place = scene.positions[t.corners[k] as usize].to_array().map(f64::to_bits);
            let other = *first.entry((t.material, place, t.uv[k].map(f32::to_bits))).or_insert(i as u32);
            parts.join(i as u32, other);
        }
    }
    parts.list()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::camera::Camera;
    use crate::reference::scene::{Material, Triangle};
    use glam::DVec3;

    /// Six squares in a row: two charts of one cluster, three squares of another, and one far behind.
    fn row() -> Scene {
        let mut scene = Scene { materials: vec![Material::plain(None, [1.0; 4]); 2], ..Scene::default() };
        for (i, (z, shift, material)) in
            [(0.0, 0.0, 0), (0.0, 9.0, 0), (0.0, 0.0, 1), (0.0, 0.0, 1), (0.0, 0.0, 1), (-9.0, 0.0, 1)]
                .into_iter()
                .enumerate()
        {
            let first = scene.positions.len() as u32;
            let corner = |k: u32| [i as f64 + f64::from(k == 1 || k == 2), f64::from(k >= 2)];
            scene.positions.extend((0..4).map(|k| DVec3::new(corner(k)[0], corner(k)[1], z)));
            for t in [[0, 1, 2], [0, 2, 3]] {
                let uv = t.map(|k| [corner(k)[0] as f32 + shift, corner(k)[1] as f32]);
                scene.triangles.push(Triangle { corners: t.map(|k| first + k), uv, material });
            }
        }
        scene
    }

    #[test]
    fn borders_are_where_charts_and_clusters_meet_and_not_where_the_surface_ends() {
        let scene = row();
        let borders = Borders { chart_of: charts(&scene), scene };
        let center = DVec3::new(3.0, 0.5, 0.0);
        let camera = Camera::new(center + DVec3::Z * 4.0, center, DVec3::Y, 90.0, [80, 80]);
        let places = borders.places(&visible(&borders.scene, &camera, [80, 80]), [80, 80]);
        // A square is ten pixels wide.
        let row: Vec<Place> = (0..80).map(|x| places[40 * 80 + x]).collect();
        use Place::{Charts, Clusters, Edge, Inside};
        assert_eq!(row[9..13], [Edge, Edge, Inside, Inside], "the contour");
        assert_eq!(row[18..23], [Inside, Charts, Charts, Inside, Inside]);
        assert_eq!(row[28..33], [Inside, Clusters, Clusters, Inside, Inside]);
        assert_eq!(row[38..43], [Inside; 5], "squares of one chart");
        assert!(row[58..61].contains(&Edge) && !row[58..61].contains(&Charts), "what is behind has another depth");
    }
}
