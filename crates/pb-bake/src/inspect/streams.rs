//! What each stream of an archive costs, level by level.

use crate::failure::{Failure, blame_input};
use pb_lod::progressive_buffers::codec::StreamBytes;
use pb_lod::progressive_buffers::model::{Model, ModelError};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write as _;

/// Bytes by what they say. Streams of packed chunks are told apart by packing each alone.
#[derive(Serialize)]
pub struct StreamTable {
    /// Streams of geometry and textures.
    streams: Vec<Stream>,
    /// Header, tables, directory, and the space between chunks.
    tables: u64,
    triangles_in: u64,
}

#[derive(Serialize)]
struct Stream {
    name: &'static str,
    /// Finest level first.
    levels: Vec<u64>,
    bytes: u64,
    bytes_per_input_triangle: f64,
}

impl StreamTable {
    /// Reads and packs all chunks.
    pub fn new(model: &Model) -> Result<StreamTable, Failure> {
        let (levels, clusters) = (model.levels(), model.record().clusters);
        let triangles_in = model.record().triangles_in;
        let level = |level: u32| -> Result<StreamBytes, ModelError> {
            let of = |cluster| Ok(StreamBytes::of(&model.read_chunk(model.chunk_id(cluster, level))?));
            let all: Result<Vec<StreamBytes>, ModelError> = (0..clusters).into_par_iter().map(of).collect();
            Ok(all?.into_iter().fold(StreamBytes::default(), |mut sum, one| {
                sum += one;
                sum
            }))
        };
        let geometry: Vec<StreamBytes> = (0..levels).map(level).collect::<Result<_, _>>().map_err(blame_input)?;
        let stream = |name, levels: Vec<u64>| {
            let bytes = levels.iter().sum();
            Stream { name, levels, bytes, bytes_per_input_triangle: bytes as f64 / triangles_in.max(1) as f64 }
        };
        let names = StreamBytes::default().named().map(|n| n.0);
        let mut streams: Vec<Stream> = (0..names.len())
            .map(|k| stream(names[k], geometry.iter().map(|l| l.named()[k].1).collect()))
            .filter(|s| s.bytes > 0)
            .collect();
        if model.textures().is_some() {
            let of = |level| (0..clusters).map(|c| u64::from(model.extent(model.texture_chunk_id(c, level)).1)).sum();
            streams.push(stream("texels", (0..levels).map(of).collect()));
        }
        let chunks: u64 = model.archive().chunks().iter().map(|c| u64::from(c.stored_bytes)).sum();
        Ok(StreamTable { streams, tables: model.archive().file_bytes() - chunks, triangles_in })
    }

    /// For people.
    pub fn text(&self) -> String {
        let mut text = String::from("stream    ");
        let levels = self.streams.first().map_or(0, |s| s.levels.len());
        (0..levels).for_each(|l| text += &format!(" {:>13}", format!("level {l}")));
        text += &format!(" {:>13} {:>15}\n", "bytes", "per triangle in");
        for s in &self.streams {
            let _ = write!(text, "{:<10}", s.name);
            s.levels.iter().for_each(|bytes| text += &format!(" {bytes:>13}"));
            let _ = writeln!(text, " {:>13} {:>15.3}", s.bytes, s.bytes_per_input_triangle);
        }
        let tables = self.tables as f64 / self.triangles_in.max(1) as f64;
        let _ = writeln!(text, "{:<10}{} {:>13} {tables:>15.3}", "tables", " ".repeat(14 * levels), self.tables);
        text
    }
}
