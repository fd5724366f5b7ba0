//! What selection and cache tell one another in a frame: residency one way, wants and released chunks the other.
//!
//! Must never: decide anything; look at every chunk in every frame.

use pb_lod::plan::{ChunkId, Class, Plan, Want};
use pb_stream::cache::Cache;

/// The cache's chunks are those of the model, but for those that are always there.
pub struct Exchange {
    /// Per chunk: it is always there.
    always: Vec<bool>,
    /// Per chunk: it may be drawn.
    resident: Vec<bool>,
    changed: Vec<ChunkId>,
    wants: Vec<pb_stream::Want>,
    released: Vec<pb_stream::ChunkId>,
}

impl Exchange {
    /// Only what is always there is there yet.
    pub fn new(always: Vec<bool>) -> Self {
        Self { resident: always.clone(), always, changed: Vec::new(), wants: Vec::new(), released: Vec::new() }
    }

    /// Takes over what changed since the last frame began. To be called once before each frame of the cache.
    pub fn update(&mut self, cache: &Cache) {
        self.changed.clear();
        self.changed.extend(cache.changes().iter().map(|c| ChunkId(c.0)));
        for chunk in &self.changed {
            let at = chunk.0 as usize;
            self.resident[at] = self.always[at] || cache.resident()[at];
        }
    }

    /// Per chunk: it may be drawn.
    pub fn resident(&self) -> &[bool] {
        &self.resident
    }

    /// Chunks whose residency the last update may have changed.
    pub fn changed(&self) -> &[ChunkId] {
        &self.changed
    }

    /// A plan's wants and released chunks, for the cache.
    pub fn hand_over(&mut self, plan: &Plan) -> (&[pb_stream::Want], &[pb_stream::ChunkId]) {
        self.wants.clear();
        self.wants.extend(plan.wants.iter().filter(|w| !self.always[w.chunk.0 as usize]).map(stream_want));
        self.released.clear();
        self.released.extend(plan.released.iter().map(|c| pb_stream::ChunkId(c.0)));
        (&self.wants, &self.released)
    }
}

/// A want as the cache sees it.
pub fn stream_want(want: &Want) -> pb_stream::Want {
    let class = match want.class {
        Class::Maybe => pb_stream::Class::Maybe,
        Class::Soon => pb_stream::Class::Soon,
        Class::Now => pb_stream::Class::Now,
    };
    pb_stream::Want { chunk: pb_stream::ChunkId(want.chunk.0), class, error_px: want.error_px }
}
