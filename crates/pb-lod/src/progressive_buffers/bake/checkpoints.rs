//! Results of finished steps that outlive the process, so that a bake that was cut short goes on where it was.
//!
//! A step has a name and one or many parts: a mesh's collapses are one, the chunks of each cluster are one each. Whoever
//! bakes says where they lie ([`Checkpoints`]); what lies in them is written and read here ([`Kept`]), in the byte order of
//! the machine. A result that was kept is the one that the step would make again, so the archive has the same bytes.

use super::charting::{ClusterTile, Origin};
use super::levels::LevelErrors;
use crate::progressive_buffers::layout::LevelRecord;
use crate::progressive_buffers::textures::TileRecord;
use crate::progressive_buffers::write::EncodedChunk;
use bytemuck::Pod;
use pb_archive::{Spill, SpillPlace};
use pb_mesh::segment::Segmentation;
use pb_mesh::simplify::Collapses;
use std::io::{Error, Read, Result, Write};

/// Where results are kept. Parts are written from any thread.
pub trait Checkpoints: Sync {
    /// What was kept of a part of a step, whole and as it was written.
    fn load(&self, step: &'static str, part: u32) -> Option<Box<dyn Read + '_>>;

    /// Keeps what `write` writes. A failure is not the bake's: it goes on, and cannot be resumed there.
    fn save(&self, step: &'static str, part: u32, write: &dyn Fn(&mut dyn Write) -> Result<()>);
}

/// Nothing is kept.
pub struct NoCheckpoints;

impl Checkpoints for NoCheckpoints {
    fn load(&self, _: &'static str, _: u32) -> Option<Box<dyn Read + '_>> {
        None
    }

    fn save(&self, _: &'static str, _: u32, _: &dyn Fn(&mut dyn Write) -> Result<()>) {}
}

/// What can be kept.
pub(super) trait Kept: Sized {
    /// Chunks lie in `spill` and stay there.
    fn read(input: &mut dyn Read, spill: &Spill) -> Result<Self>;
    fn write(&self, out: &mut dyn Write) -> Result<()>;
}

/// Writes a list: its length, its items as they lie in memory.
pub fn put_list<T: Pod>(out: &mut dyn Write, list: &[T]) -> Result<()> {
    out.write_all(&(list.len() as u64).to_ne_bytes())?;
    out.write_all(bytemuck::cast_slice(list))
}

/// Reads what [`put_list`] has written.
///
/// # Errors
/// The input ends early.
pub fn take_list<T: Pod>(input: &mut dyn Read) -> Result<Vec<T>> {
    let mut length = [0; 8];
    input.read_exact(&mut length)?;
    let mut list = vec![T::zeroed(); u64::from_ne_bytes(length) as usize];
    input.read_exact(bytemuck::cast_slice_mut(&mut list))?;
    Ok(list)
}

fn put<T: Pod>(out: &mut dyn Write, item: T) -> Result<()> {
    out.write_all(bytemuck::bytes_of(&item))
}

fn take<T: Pod>(input: &mut dyn Read) -> Result<T> {
    let mut item = T::zeroed();
    input.read_exact(bytemuck::bytes_of_mut(&mut item))?;
    Ok(item)
}

impl Kept for Segmentation {
    fn read(input: &mut dyn Read, _: &Spill) -> Result<Self> {
        Ok(Segmentation { order: take_list(input)?, starts: take_list(input)?, components: take_list(input)? })
    }

    fn write(&self, out: &mut dyn Write) -> Result<()> {
        [&self.order, &self.starts, &self.components].into_iter().try_for_each(|list| put_list(out, list))
    }
}

impl Kept for Collapses {
    fn read(input: &mut dyn Read, _: &Spill) -> Result<Self> {
        Ok(Collapses {
            parent: take_list(input)?,
            last_level: take_list(input)?,
            counts: take_list::<u64>(input)?.into_iter().map(|n| n as usize).collect(),
            wedge_parent: take_list(input)?,
            wedge_last_level: take_list(input)?,
        })
    }

    fn write(&self, out: &mut dyn Write) -> Result<()> {
        put_list(out, &self.parent)?;
        put_list(out, &self.last_level)?;
        put_list(out, &self.counts.iter().map(|n| *n as u64).collect::<Vec<_>>())?;
        put_list(out, &self.wedge_parent)?;
        put_list(out, &self.wedge_last_level)
    }
}

impl Kept for LevelErrors {
    fn read(input: &mut dyn Read, _: &Spill) -> Result<Self> {
        Ok(LevelErrors { max: take_list(input)?, rms: take(input)?, vertices: take(input)? })
    }

    fn write(&self, out: &mut dyn Write) -> Result<()> {
        put_list(out, &self.max)?;
        put(out, self.rms)?;
        put(out, self.vertices)
    }
}

impl Kept for ClusterTile {
    fn read(input: &mut dyn Read, _: &Spill) -> Result<Self> {
        Ok(ClusterTile {
            size: take(input)?,
            corners: take_list(input)?,
            chart_of: take_list(input)?,
            texel: take(input)?,
            side: take(input)?,
            charts: take(input)?,
            fill: take(input)?,
            reduced: take::<u8>(input)? != 0,
            origin: Origin::read(input)?,
        })
    }

    fn write(&self, out: &mut dyn Write) -> Result<()> {
        put(out, self.size)?;
        put_list(out, &self.corners)?;
        put_list(out, &self.chart_of)?;
        put(out, self.texel)?;
        put(out, self.side)?;
        put(out, self.charts)?;
        put(out, self.fill)?;
        put(out, u8::from(self.reduced))?;
        self.origin.write(out)
    }
}

impl Origin {
    fn read(input: &mut dyn Read) -> Result<Self> {
        let (code, why) = (take::<u8>(input)?, take_list(input)?);
        let why = String::from_utf8(why).map_err(Error::other)?;
        match code {
            0 => Ok(Origin::Source),
            1 => Ok(Origin::Given),
            2 => Ok(Origin::Auto(None)),
            3 => Ok(Origin::Auto(Some(why))),
            _ => Err(Error::other("no such origin of charts")),
        }
    }

    fn write(&self, out: &mut dyn Write) -> Result<()> {
        let (code, why) = match self {
            Origin::Source => (0u8, ""),
            Origin::Given => (1, ""),
            Origin::Auto(None) => (2, ""),
            Origin::Auto(Some(why)) => (3, why.as_str()),
        };
        put(out, code)?;
        put_list(out, why.as_bytes())
    }
}

impl Kept for (Vec<LevelRecord>, Vec<EncodedChunk>) {
    fn read(input: &mut dyn Read, spill: &Spill) -> Result<Self> {
        Ok((take_list(input)?, take_chunks(input, spill)?))
    }

    fn write(&self, out: &mut dyn Write) -> Result<()> {
        put_list(out, &self.0)?;
        put_chunks(out, &self.1)
    }
}

impl Kept for (TileRecord, Vec<EncodedChunk>) {
    fn read(input: &mut dyn Read, spill: &Spill) -> Result<Self> {
        Ok((take(input)?, take_chunks(input, spill)?))
    }

    fn write(&self, out: &mut dyn Write) -> Result<()> {
        put(out, self.0)?;
        put_chunks(out, &self.1)
    }
}

fn put_chunks(out: &mut dyn Write, chunks: &[EncodedChunk]) -> Result<()> {
    let places: Option<Vec<SpillPlace>> = chunks.iter().map(|c| c.bytes.place()).collect();
    put_list(out, &places.ok_or_else(|| Error::other("chunks in memory end with the process"))?)?;
    put_list(out, &chunks.iter().map(|c| c.decoded_bytes).collect::<Vec<u32>>())
}

fn take_chunks(input: &mut dyn Read, spill: &Spill) -> Result<Vec<EncodedChunk>> {
    let (places, decoded) = (take_list::<SpillPlace>(input)?, take_list::<u32>(input)?);
    let chunk = |(place, decoded_bytes): (SpillPlace, u32)| {
        let bytes = spill.find(place).ok_or_else(|| Error::other("the chunk is not there any more"))?;
        Ok(EncodedChunk { bytes, decoded_bytes })
    };
    places.into_iter().zip(decoded).map(chunk).collect()
}
