//! One frame's decisions, in the order in which they make room for one another.

use super::state::{Ram, Vram};
use super::{Cache, Command, POOLS};
use crate::{ChunkId, Class, Want};

/// What the wants of a frame come to.
pub(super) struct Goals {
    /// Chunks that shall be in VRAM, coarser before finer, most urgent first; they fit together.
    vram: Vec<ChunkId>,
    /// Per chunk: is it in `vram`?
    in_vram: Vec<bool>,
    /// Chunks that shall be read into RAM or wait there, most urgent first; they fit together.
    ram: Vec<ChunkId>,
    /// Per chunk: is it in `ram`?
    in_ram: Vec<bool>,
    /// All bytes of `vram`, by pool.
    vram_bytes: [u64; POOLS],
    /// Per chunk that is wanted: its place in order of priority, from 1; 0 for the others.
    rank: Vec<u32>,
}

/// Half octaves of the error: within one, what is resident comes first, so that chunks of nearly equal errors do not
/// push one another out of VRAM frame by frame.
fn error_step(error_px: f32) -> i32 {
    (error_px.max(f32::MIN_POSITIVE).log2() * 2.0).floor() as i32
}

impl Cache {
    /// Greedy in order of priority; what does not fit is left out, and smaller things after it may still fit.
    pub(super) fn goals(&mut self, wants: &[Want]) -> Goals {
        let mut wants = wants.to_vec();
        let key = |w: &Want| (w.class, error_step(w.error_px), self.resident[w.chunk.0 as usize]);
        wants.sort_by(|a, b| key(b).cmp(&key(a)).then(b.error_px.total_cmp(&a.error_px)).then(a.chunk.cmp(&b.chunk)));
        let n = self.info.len();
        let mut goals = Goals {
            vram: Vec::new(),
            in_vram: vec![false; n],
            ram: Vec::new(),
            in_ram: vec![false; n],
            vram_bytes: [0; POOLS],
            rank: vec![0; n],
        };
        let pinned = self.pinned.iter().map(|&chunk| Want { chunk, class: Class::Now, error_px: f32::INFINITY });
        let wants: Vec<Want> = pinned.chain(wants).collect();
        for (rank, want) in wants.iter().enumerate() {
            let place = want.chunk.0 as usize;
            self.last_wanted[place] = self.frame;
            if goals.rank[place] == 0 {
                goals.rank[place] = rank as u32 + 1;
            }
            if want.class >= Class::Soon {
                self.add_chain(want.chunk, &mut goals);
            }
        }
        self.add_ram(&wants, &mut goals);
        goals
    }

    /// Adds a chunk and its coarser ones to the VRAM goal, all or none. Pinned chunks fit by construction.
    fn add_chain(&self, chunk: ChunkId, goals: &mut Goals) {
        let chain: Vec<ChunkId> = self.chain(chunk).take_while(|c| !goals.in_vram[c.0 as usize]).collect();
        let bytes: u64 = chain.iter().map(|&c| self.vram_size(c)).sum();
        let (pinned, pool) = (self.info[chunk.0 as usize].pinned, self.info[chunk.0 as usize].pool);
        let fits = goals.vram_bytes[pool] + bytes <= self.vram_bound(pool);
        if chain.iter().any(|c| self.failed[c.0 as usize]) || !(fits || pinned) {
            return;
        }
        goals.vram_bytes[pool] += bytes;
        for &c in chain.iter().rev() {
            goals.in_vram[c.0 as usize] = true;
            goals.vram.push(c);
        }
    }

    /// What has to pass through RAM: first what VRAM lacks, then all else that is wanted and not in VRAM; of what is not
    /// there yet no more than may be in flight.
    fn add_ram(&self, wants: &[Want], goals: &mut Goals) {
        let (mut room, mut loads) = (self.limits.ram_bytes, self.limits.loads_in_flight);
        let candidates: Vec<ChunkId> = goals.vram.iter().copied().chain(wants.iter().map(|w| w.chunk)).collect();
        for chunk in candidates {
            let place = chunk.0 as usize;
            let needed = matches!(self.vram[place], Vram::Absent | Vram::Uploading) && !self.failed[place];
            let load = (self.ram[place] != Ram::Loaded) as u32;
            if needed && !goals.in_ram[place] && self.ram_size(chunk) <= room && load <= loads {
                (room, loads) = (room - self.ram_size(chunk), loads - load);
                goals.in_ram[place] = true;
                goals.ram.push(chunk);
            }
        }
    }

    /// A chunk, its coarser one, and so on.
    fn chain(&self, chunk: ChunkId) -> impl Iterator<Item = ChunkId> + '_ {
        std::iter::successors(Some(chunk), |c| self.info[c.0 as usize].coarser)
    }

    fn ram_size(&self, chunk: ChunkId) -> u64 {
        self.info[chunk.0 as usize].ram_bytes as u64
    }

    fn vram_size(&self, chunk: ChunkId) -> u64 {
        self.info[chunk.0 as usize].vram_bytes
    }

    /// What may be planned with in a pool.
    fn vram_bound(&self, pool: usize) -> u64 {
        self.limits.vram_bytes[pool] - self.lost_bytes[pool]
    }

    /// Retiring chunks that are wanted again stay; released ones go, finer before coarser.
    pub(super) fn keep_and_free(&mut self, goals: &Goals, released: &[ChunkId], commands: &mut Vec<Command>) {
        for &chunk in released {
            if self.vram[chunk.0 as usize] == Vram::Retiring {
                self.set_vram(chunk, Vram::Retiring, Vram::Released);
            }
        }
        if self.stats.retiring == 0 {
            return;
        }
        let mut released = Vec::new();
        for chunk in (0..self.info.len() as u32).map(ChunkId) {
            let state = self.vram[chunk.0 as usize];
            match state {
                Vram::Retiring | Vram::Released if goals.in_vram[chunk.0 as usize] => {
                    self.set_vram(chunk, state, Vram::Resident);
                    commands.push(Command::Keep(chunk));
                }
                Vram::Released => released.push(chunk),
                _ => {}
            }
        }
        // Longer chains first: a finer chunk is one step further from the end of its chain.
        released.sort_by_key(|&c| (std::cmp::Reverse(self.chain(c).count()), c));
        for chunk in released {
            if self.finer_in_vram[chunk.0 as usize] == 0 {
                self.set_vram(chunk, Vram::Released, Vram::Absent);
                commands.push(Command::Free(chunk));
            }
        }
    }

    /// Asks back as much of VRAM as the goal lacks: unwanted chunks first, longest unused first, finer before
    /// coarser; then the least urgent of those that are wanted but did not fit.
    pub(super) fn retire(&mut self, goals: &Goals, commands: &mut Vec<Command>) {
        (0..POOLS).for_each(|pool| self.retire_in(pool, goals, commands));
    }

    fn retire_in(&mut self, pool: usize, goals: &Goals, commands: &mut Vec<Command>) {
        let bound = self.vram_bound(pool);
        if self.vram_bytes[pool] + goals.vram_bytes[pool] <= bound {
            return; // room for everything, whatever is there already
        }
        let leftover = |c: &ChunkId| {
            let place = c.0 as usize;
            self.info[place].pool == pool && self.vram[place] == Vram::Resident && !goals.in_vram[place]
        };
        let goal = goals.vram_bytes[pool] + self.uploading_outside(pool, goals);
        let mut victims: Vec<ChunkId> = (0..self.info.len() as u32).map(ChunkId).filter(leftover).collect();
        let mut kept: u64 = victims.iter().map(|&c| self.vram_size(c)).sum();
        victims.sort_by_key(|&c| {
            let place = c.0 as usize;
            let rank = goals.rank[place];
            (rank != 0, std::cmp::Reverse(rank), self.last_wanted[place], std::cmp::Reverse(self.chain(c).count()), c)
        });
        let mut progress = true;
        while progress && goal + kept > bound {
            progress = false;
            for &chunk in &victims {
                let place = chunk.0 as usize;
                let stands = self.vram[place] == Vram::Resident && self.finer_staying[place] == 0;
                if stands && goal + kept > bound {
                    kept -= self.vram_size(chunk);
                    self.set_vram(chunk, Vram::Resident, Vram::Retiring);
                    commands.push(Command::Retire(chunk));
                    progress = true;
                }
            }
        }
    }

    /// Bytes of uploads under way that are no longer wanted: they will be residents soon.
    fn uploading_outside(&self, pool: usize, goals: &Goals) -> u64 {
        if self.stats.uploads_in_flight == 0 {
            return 0;
        }
        let outside = |c: &ChunkId| {
            let place = c.0 as usize;
            self.info[place].pool == pool && self.vram[place] == Vram::Uploading && !goals.in_vram[place]
        };
        (0..self.info.len() as u32).map(ChunkId).filter(outside).map(|c| self.vram_size(c)).sum()
    }

    /// Begins uploads in order of priority. Room is kept for what is more urgent and still on its way.
    pub(super) fn upload(&mut self, goals: &Goals, commands: &mut Vec<Command>) {
        // None: the pool is full until something was released.
        let mut room: [Option<u64>; POOLS] =
            std::array::from_fn(|pool| Some(self.limits.vram_bytes[pool] - self.vram_bytes[pool]));
        let mut begun = 0;
        for &chunk in &goals.vram {
            let place = chunk.0 as usize;
            if self.vram[place] != Vram::Absent {
                continue;
            }
            let (bytes, pool) = (self.vram_size(chunk), self.info[place].pool);
            room[pool] = room[pool].and_then(|r| r.checked_sub(bytes));
            if room[pool].is_none() {
                continue;
            }
            let bytes = self.ram_size(chunk);
            let coarser = self.info[place].coarser;
            let ready =
                self.ram[place] == Ram::Loaded && coarser.is_none_or(|c| self.vram[c.0 as usize] == Vram::Resident);
            if ready && (begun == 0 || begun + bytes <= self.limits.upload_bytes_per_frame) {
                begun += bytes;
                self.set_vram(chunk, Vram::Absent, Vram::Uploading);
                commands.push(Command::Upload(chunk));
            }
        }
    }

    /// Loads that are under way and have no place in RAM any more.
    pub(super) fn withdraw(&mut self, goals: &Goals, commands: &mut Vec<Command>) {
        self.loading.retain(|c| self.ram[c.0 as usize] == Ram::Loading);
        let unwanted = self.loading.iter().filter(|c| !goals.in_ram[c.0 as usize]);
        commands.extend(unwanted.map(|&c| Command::Withdraw(c)));
    }

    /// Begins loads in order of priority, dropping from RAM what is not wanted there, longest unused first.
    pub(super) fn load(&mut self, goals: &Goals, commands: &mut Vec<Command>) {
        let absent = |c: &&ChunkId| self.ram[c.0 as usize] == Ram::Absent;
        let missing: Vec<ChunkId> = goals.ram.iter().filter(absent).copied().collect();
        let mut victims: Option<std::vec::IntoIter<ChunkId>> = None;
        for chunk in missing {
            if self.stats.loads_in_flight >= self.limits.loads_in_flight {
                return;
            }
            while self.stats.ram_bytes + self.ram_size(chunk) > self.limits.ram_bytes {
                let victims = victims.get_or_insert_with(|| self.ram_victims(goals).into_iter());
                let Some(victim) = victims.next() else { return };
                self.set_ram(victim, Ram::Loaded, Ram::Absent);
                commands.push(Command::DropRam(victim));
            }
            self.set_ram(chunk, Ram::Absent, Ram::Loading);
            self.loading.push(chunk);
            commands.push(Command::Load(chunk));
        }
    }

    /// What may leave RAM, first to go first. Copies that are being uploaded stay.
    fn ram_victims(&self, goals: &Goals) -> Vec<ChunkId> {
        let free = |c: &ChunkId| {
            let place = c.0 as usize;
            self.ram[place] == Ram::Loaded && self.vram[place] != Vram::Uploading && !goals.in_ram[place]
        };
        let mut victims: Vec<ChunkId> = (0..self.info.len() as u32).map(ChunkId).filter(free).collect();
        victims.sort_by_key(|&c| (self.last_wanted[c.0 as usize], c));
        victims
    }
}
