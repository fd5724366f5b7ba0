//! The model's tiles on the adapter: pools of pages, and the table that tells the shader where each mip lies.
//!
//! All memory is made once, inside the bytes that [`TexturePlan`] was given. Must never: read the archive; decide
//! what is resident (the caller does).

use pb_lod::progressive_buffers::textures::{
    MIN_SIZE_LOG2, MapFormat, MapKind, MapRecord, MipPlace, Textures, TileRecord,
};

use crate::draw_table::texture_floors;
use crate::gpu::Gpu;
use crate::share::Party;
use crate::squares::PagesFull;
use crate::texture_pool::{NewSquare, PageLimits, PoolSize, PoolWish, Storage, TexturePool};

/// Table entry of a mip that is not resident.
const ABSENT: u32 = u32::MAX;
/// Table words per cluster before the places: floor, sizes, first place.
const CLUSTER_WORDS: usize = 3;

/// Units of 4 x 4 texels of the model in one pool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Needs {
    /// Of all tails.
    tails: u64,
    /// Of the largest other chunk.
    largest: u64,
    /// Of everything.
    all: u64,
    /// log2 of the side of the largest mip, and of the largest in a tail, texels.
    largest_log2: u32,
    tail_log2: u32,
}

/// How much memory the textures of a model take.
#[derive(Clone, Debug)]
pub struct TexturePlan {
    pools: Vec<PoolSize>,
    needs: Vec<Needs>,
    /// By map: its pool.
    pool_of: Vec<usize>,
    table_words: usize,
}

impl TexturePlan {
    /// Pools without pages yet, for at most `bound` bytes. `None` where a tile is larger than the adapter's textures.
    pub fn new(t: &Textures, bound: u64, limits: &PageLimits, blocks: bool) -> Option<Self> {
        let storage: Vec<Storage> = t.maps.iter().map(|m| Storage::of(format(m), blocks)).collect();
        let mut storages = storage.clone();
        storages.sort_unstable();
        storages.dedup();
        let pool_of: Vec<usize> =
            storage.iter().map(|s| storages.binary_search(s).expect("it is among them")).collect();
        let pool = |(s, n): (&Storage, &Needs)| {
            let (tail_log2, largest_log2, bytes) = (n.tail_log2, n.largest_log2, n.all * s.unit_bytes());
            PoolSize::empty(*s, &PoolWish { tail_log2, largest_log2, bytes, bound }, limits)
        };
        let all = needs(t, &pool_of, &vec![u32::MAX; storages.len()]);
        let pools: Option<Vec<PoolSize>> = storages.iter().zip(&all).map(pool).collect();
        let pools = pools?;
        let pages: Vec<u32> = pools.iter().map(|p| p.page_log2).collect();
        let needs = needs(t, &pool_of, &pages);
        let places: usize = t.tiles.iter().map(|tile| t.maps.len() * (tile.last() as usize + 1)).sum();
        Some(Self { pools, needs, pool_of, table_words: t.tiles.len() * CLUSTER_WORDS + places })
    }

    /// Bytes of the table and of the squares through which others move.
    pub fn fixed_bytes(&self) -> u64 {
        self.table_bytes() + self.pools.iter().map(PoolSize::scratch_bytes).sum::<u64>()
    }

    fn table_bytes(&self) -> u64 {
        self.table_words as u64 * 4
    }

    /// What each pool needs. Pages are the steps.
    pub fn parties(&self, limits: &PageLimits) -> Vec<Party> {
        let party = |(pool, n): (&PoolSize, &Needs)| {
            let page_units = pool.page_bytes() / pool.storage.unit_bytes();
            let bytes = |units: u64| units.div_ceil(page_units) * pool.page_bytes();
            let (least, most) = (bytes(n.tails), pool.most_pages(limits) as u64 * pool.page_bytes());
            let clip = |units| bytes(units).min(most).max(least);
            Party { least, enough: clip(n.tails + n.largest), all: clip(n.all), step: pool.page_bytes() }
        };
        self.pools.iter().zip(&self.needs).map(party).collect()
    }

    /// Gives each pool its bytes, in the order of [`Self::parties`].
    pub fn give(&mut self, bytes: &[u64]) {
        for (pool, bytes) in self.pools.iter_mut().zip(bytes) {
            pool.pages = (bytes / pool.page_bytes()) as u32;
        }
    }

    /// Bytes of everything together.
    pub fn bytes(&self) -> u64 {
        self.fixed_bytes() + self.pools.iter().map(PoolSize::bytes).sum::<u64>()
    }

    /// Bytes that `chunk` fills in each pool.
    fn chunk_bytes(&self, t: &Textures, chunk: usize) -> Vec<u64> {
        let mut bytes = vec![0; self.pools.len()];
        for mip in mips(t, chunk) {
            let pool = self.pool_of[mip.map as usize];
            bytes[pool] += units(&mip) * self.pools[pool].storage.unit_bytes();
        }
        bytes
    }

    /// True when some mip of a chunk is wider than the pages: it never is resident.
    fn too_wide(&self, t: &Textures, chunk: usize) -> bool {
        mips(t, chunk).any(|m| m.side > 1 << self.pools[self.pool_of[m.map as usize]].page_log2)
    }

    /// Bytes of each pool for chunks that are no tails.
    fn room(&self) -> Vec<u64> {
        let room = |(p, n): (&PoolSize, &Needs)| p.bytes() - n.tails * p.storage.unit_bytes();
        self.pools.iter().zip(&self.needs).map(room).collect()
    }

    /// One budget for all pools, and what each chunk costs of it. Chunks that keep to the budget together fit, each
    /// pool on its own: where pools are short, a chunk costs its largest share of any of them. Tails come as
    /// their bytes and count for nothing in the budget; what never fits comes as `u64::MAX`.
    pub fn costs(&self, t: &Textures) -> (u64, Vec<u64>) {
        let (room, short) =
            (self.room(), self.pools.iter().zip(&self.needs).any(|(p, n)| p.bytes() < n.all * p.storage.unit_bytes()));
        let budget: u64 = room.iter().sum();
        let share = |(&bytes, &room): (&u64, &u64)| match (bytes, room) {
            (0, _) => 0,
            (_, 0) => u64::MAX,
            _ => u64::try_from((bytes as u128 * budget as u128).div_ceil(room as u128)).unwrap_or(u64::MAX),
        };
        let cost = |chunk: usize| {
            let bytes = self.chunk_bytes(t, chunk);
            if is_tail(t, chunk) {
                return bytes.iter().sum();
            }
            let cost = match short {
                true => bytes.iter().zip(&room).map(share).max().unwrap_or(0),
                false => bytes.iter().sum(),
            };
            if self.too_wide(t, chunk) || cost > budget { u64::MAX } else { cost }
        };
        (budget, (0..chunks(t)).map(cost).collect())
    }
}

fn format(map: &MapRecord) -> MapFormat {
    map.format().expect("checked when the archive was opened")
}

/// Number of texture chunks.
fn chunks(t: &Textures) -> usize {
    t.tiles.len() * t.levels as usize
}

/// The mips in texture chunk `cluster * L + level`.
fn mips<'a>(t: &'a Textures, chunk: usize) -> impl Iterator<Item = MipPlace> + 'a {
    let levels = t.levels as usize;
    t.mips((chunk / levels) as u32, (chunk % levels) as u32)
}

/// True for the chunk of the last level, which is always resident.
fn is_tail(t: &Textures, chunk: usize) -> bool {
    (chunk + 1).is_multiple_of(t.levels as usize)
}

fn units(mip: &MipPlace) -> u64 {
    (mip.side as u64 / 4).pow(2)
}

/// By pool, of all chunks without a mip that is wider than its pool's page.
fn needs(t: &Textures, pool_of: &[usize], page_log2: &[u32]) -> Vec<Needs> {
    let (pools, least) = (page_log2.len(), MIN_SIZE_LOG2 as u32);
    let mut out = vec![Needs { largest_log2: least, tail_log2: least, ..Needs::default() }; pools];
    let fits = |chunk: &usize| mips(t, *chunk).all(|m| m.side.ilog2() <= page_log2[pool_of[m.map as usize]]);
    for chunk in (0..chunks(t)).filter(fits) {
        let mut here = vec![0; pools];
        for mip in mips(t, chunk) {
            here[pool_of[mip.map as usize]] += units(&mip);
            let need = &mut out[pool_of[mip.map as usize]];
            need.largest_log2 = need.largest_log2.max(mip.side.ilog2());
            if is_tail(t, chunk) {
                need.tail_log2 = need.tail_log2.max(mip.side.ilog2());
            }
        }
        for (need, here) in out.iter_mut().zip(here) {
            need.all += here;
            match is_tail(t, chunk) {
                true => need.tails += here,
                false => need.largest = need.largest.max(here),
            }
        }
    }
    out
}

/// Tiles, pools and table of one model.
pub struct GpuTiles {
    levels: u32,
    maps: Vec<MapRecord>,
    tiles: Vec<TileRecord>,
    pub(crate) cutouts: bool,
    plan: TexturePlan,
    pools: Vec<TexturePool>,
    /// As on the adapter: floors by cluster, then sizes and first place by cluster, then places.
    table: Vec<u32>,
    pub(crate) table_buffer: wgpu::Buffer,
    /// By chunk.
    resident: Vec<bool>,
    /// By cluster: the finest level that may be sampled.
    finest: Vec<u32>,
}

impl GpuTiles {
    /// Makes pools and table, and uploads the tails: the last texture chunk of each cluster.
    pub fn new(gpu: &Gpu, t: &Textures, plan: TexturePlan, tails: &[&[u8]], cutouts: bool) -> Self {
        assert_eq!(tails.len(), t.tiles.len(), "one tail per cluster");
        let table_buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("tiles"),
            size: plan.table_bytes().max(4),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut out = Self {
            levels: t.levels,
            maps: t.maps.to_vec(),
            tiles: t.tiles.to_vec(),
            cutouts,
            pools: plan.pools.iter().map(|&size| TexturePool::new(gpu, size)).collect(),
            table: empty_table(t, plan.table_words),
            table_buffer,
            resident: (0..chunks(t)).map(|c| mips(t, c).next().is_none()).collect(),
            finest: (0..t.tiles.len()).map(|c| t.tiles[c].tail(t.levels)).collect(),
            plan,
        };
        for (c, tail) in tails.iter().enumerate() {
            let chunk = c * t.levels as usize + t.levels as usize - 1;
            out.fill(gpu, chunk, tail).expect("every pool has room for its tails");
        }
        gpu.queue.write_buffer(&out.table_buffer, 0, bytemuck::cast_slice(&out.table));
        out
    }

    fn tables(&self) -> Textures<'_> {
        Textures { maps: &self.maps, tiles: &self.tiles, levels: self.levels }
    }

    /// See [`TexturePlan::costs`].
    pub fn costs(&self) -> (u64, Vec<u64>) {
        self.plan.costs(&self.tables())
    }

    /// Bytes in use: table, room for moves, squares.
    pub fn used_bytes(&self) -> u64 {
        self.plan.fixed_bytes() + self.pools.iter().map(TexturePool::used_bytes).sum::<u64>()
    }

    /// Makes a chunk resident; `bytes` are its mips as the archive has them.
    /// Fails only when the resident chunks cost more than the budget.
    pub fn upload(&mut self, gpu: &Gpu, chunk: usize, bytes: &[u8]) -> Result<(), PagesFull> {
        if self.resident[chunk] {
            return Ok(());
        }
        for (entry, _) in self.fill(gpu, chunk, bytes)? {
            let word = bytemuck::bytes_of(&self.table[entry as usize]);
            gpu.queue.write_buffer(&self.table_buffer, entry as u64 * 4, word);
        }
        Ok(())
    }

    /// Places a chunk's mips, all or none. The answer says which words of the table changed.
    fn fill(&mut self, gpu: &Gpu, chunk: usize, bytes: &[u8]) -> Result<Vec<(u32, u32)>, PagesFull> {
        let mips: Vec<MipPlace> = mips(&self.tables(), chunk).collect();
        assert_eq!(bytes.len(), mips.iter().map(|m| m.bytes as usize).sum::<usize>(), "as the table says");
        let mut wanted = vec![0; self.pools.len()];
        mips.iter().for_each(|m| wanted[self.plan.pool_of[m.map as usize]] += units(m));
        let too_wide = self.plan.too_wide(&self.tables(), chunk);
        for (pool, wanted) in self.pools.iter().zip(wanted) {
            if too_wide || wanted > pool.free_units() {
                return Err(PagesFull { wanted, free: pool.free_units() });
            }
        }
        let mut changed = Vec::new();
        for mip in &mips {
            let new = NewSquare {
                owner: self.entry(chunk / self.levels as usize, mip.map, mip.mip) as u32,
                side: mip.side,
                format: format(&self.maps[mip.map as usize]),
                bytes: &bytes[mip.offset as usize..][..mip.bytes as usize],
            };
            let pool = &mut self.pools[self.plan.pool_of[mip.map as usize]];
            changed.extend(pool.put(gpu, &new).expect("the free units were counted"));
        }
        changed.iter().for_each(|&(entry, place)| self.table[entry as usize] = place);
        self.resident[chunk] = true;
        self.update_finest(chunk / self.levels as usize);
        Ok(changed)
    }

    /// Takes a chunk out; nothing drawn from now on may need it. Tails stay.
    pub fn free(&mut self, chunk: usize) {
        let t = self.tables();
        let (mips, tail) = (mips(&t, chunk).collect::<Vec<_>>(), is_tail(&t, chunk));
        if mips.is_empty() || tail || !std::mem::replace(&mut self.resident[chunk], false) {
            return;
        }
        for mip in mips {
            let entry = self.entry(chunk / self.levels as usize, mip.map, mip.mip);
            let place = std::mem::replace(&mut self.table[entry], ABSENT);
            self.pools[self.plan.pool_of[mip.map as usize]].take_out(place);
        }
        self.update_finest(chunk / self.levels as usize);
    }

    /// True when the chunk may be sampled, as far as it alone goes.
    pub fn is_resident(&self, chunk: usize) -> bool {
        self.resident[chunk]
    }

    /// Word of the table that says where a mip lies.
    fn entry(&self, cluster: usize, map: u32, level: u32) -> usize {
        let mips = self.tiles[cluster].last() + 1;
        self.table[self.tiles.len() + cluster * 2 + 1] as usize + (map * mips + level) as usize
    }

    fn update_finest(&mut self, cluster: usize) {
        let mut finest = self.tiles[cluster].tail(self.levels);
        while finest > 0 && self.resident[cluster * self.levels as usize + finest as usize - 1] {
            finest -= 1;
        }
        self.finest[cluster] = finest;
    }

    /// Sends floors (levels, by cluster) to the adapter, never finer than what is resident.
    pub fn write_floors(&self, gpu: &Gpu, floors: &[f32]) {
        assert_eq!(floors.len(), self.tiles.len(), "one floor per cluster");
        let floors = texture_floors(floors, &self.finest);
        gpu.queue.write_buffer(&self.table_buffer, 0, bytemuck::cast_slice(&floors));
    }

    /// True where the normal map holds normals of the model, not of the tile's frame.
    pub fn object_normals(&self) -> bool {
        let map = self.maps.iter().find(|m| m.kind() == Some(MapKind::Normal));
        map.is_some_and(|m| matches!(format(m), MapFormat::Bc7Linear | MapFormat::Rgba8Linear))
    }

    /// The map of a kind: its place in the model's order, and all pages of its pool.
    pub fn map(&self, kind: MapKind) -> Option<(usize, wgpu::TextureView)> {
        let map = self.maps.iter().position(|m| m.kind() == Some(kind))?;
        Some((map, self.pools[self.plan.pool_of[map]].view(format(&self.maps[map]))))
    }
}

/// The table before anything is resident.
fn empty_table(t: &Textures, words: usize) -> Vec<u32> {
    let mut table = Vec::with_capacity(words);
    table.extend(t.tiles.iter().enumerate().map(|(c, _)| (t.tiles[c].tail(t.levels) as f32).to_bits()));
    let mut place = (t.tiles.len() * CLUSTER_WORDS) as u32;
    for tile in t.tiles {
        let first = (0..t.maps.len()).map(|m| (tile.first[m] as u32) << (4 + 4 * m));
        table.extend([first.fold(tile.size_log2 as u32, |a, b| a | b), place]);
        place += t.maps.len() as u32 * (tile.last() + 1);
    }
    table.resize(words, ABSENT);
    table
}
