//! One frame's decisions, in the order in which they make room for one another.
//!
//! Must never: look at every chunk of the archive. A frame costs what it wants, and what is in RAM and VRAM.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use super::state::{LEAVING, Ram, UPLOADING, Vram, resident_in};
use super::{Cache, Command, POOLS};
use crate::{ChunkId, Class, Want};

/// What the wants of a frame come to. Which chunks are in it stands in the cache's marks.
#[derive(Clone, Debug, Default)]
pub(super) struct Goals {
    /// The wants in order of priority, pinned chunks first.
    wants: Vec<Want>,
    /// Of the chunks that shall be in VRAM, those that are not or are on their way: coarser before finer, most urgent
    /// first. All that shall be there fit together.
    lacking: Vec<ChunkId>,
    /// Chunks that shall be read into RAM or wait there, most urgent first; they fit together.
    ram: Vec<ChunkId>,
    /// All bytes that shall be in VRAM, by pool.
    vram_bytes: [u64; POOLS],
    /// The part of them that is there.
    standing_bytes: [u64; POOLS],
}

/// What stands in VRAM and is no goal; the least goes first: unwanted, then least urgent, longest unused, longest chain,
/// number.
type Leftover = (bool, Reverse<u32>, u32, Reverse<u8>, ChunkId);

/// Half octaves of the error: within one, what is resident comes first, so that chunks of nearly equal errors do not
/// push one another out of VRAM frame by frame.
fn error_step(error_px: f32) -> i32 {
    (error_px.max(f32::MIN_POSITIVE).log2() * 2.0).floor() as i32
}

/// The smallest error in a half octave.
fn least_error(step: i32) -> f32 {
    let mut error = (step as f32 * 0.5).exp2().max(f32::MIN_POSITIVE);
    while error_step(error) < step {
        error = error.next_up();
    }
    while error > f32::MIN_POSITIVE && error_step(error.next_down()) >= step {
        error = error.next_down();
    }
    error
}

/// Class, then error, then number: the order in which a view gives its wants.
fn compare(a: &Want, b: &Want) -> Ordering {
    b.class.cmp(&a.class).then(b.error_px.total_cmp(&a.error_px)).then(a.chunk.cmp(&b.chunk))
}

impl Cache {
    /// Greedy in order of priority; what does not fit is left out, and smaller things after it may still fit.
    pub(super) fn set_goals(&mut self, wants: &[Want], goals: &mut Goals) {
        (goals.vram_bytes, goals.standing_bytes) = ([0; POOLS], [0; POOLS]);
        goals.lacking.clear();
        goals.ram.clear();
        self.order(wants, &mut goals.wants);
        for at in 0..goals.wants.len() {
            let want = goals.wants[at];
            let mark = &mut self.marks[want.chunk.0 as usize];
            if mark.wanted != self.frame {
                (mark.wanted, mark.rank) = (self.frame, at as u32 + 1);
            }
            if want.class >= Class::Soon && mark.vram != self.frame {
                self.add_chain(want.chunk, goals);
            }
        }
        self.add_ram(goals);
    }

    /// Pinned chunks first, then by class, half octave of the error, residency, error.
    fn order(&self, wants: &[Want], out: &mut Vec<Want>) {
        out.clear();
        out.extend(self.pinned.iter().map(|&chunk| Want { chunk, class: Class::Now, error_px: f32::INFINITY }));
        let sorted: Vec<Want>;
        let mut rest = wants;
        if !wants.is_sorted_by(|a, b| compare(a, b).is_le()) {
            sorted = {
                let mut all = wants.to_vec();
                all.sort_unstable_by(compare);
                all
            };
            rest = &sorted;
        }
        let resident = |w: &&Want| self.resident[w.chunk.0 as usize];
        while let Some(first) = rest.first() {
            let least = least_error(error_step(first.error_px));
            let same = |w: &&Want| w.class == first.class && w.error_px.max(f32::MIN_POSITIVE) >= least;
            let (step, others) = rest.split_at(rest.iter().take_while(same).count().max(1));
            out.extend(step.iter().filter(resident));
            out.extend(step.iter().filter(|w| !resident(w)));
            rest = others;
        }
    }

    /// Adds a chunk and its coarser ones to the VRAM goal, all or none. Pinned chunks fit by construction.
    fn add_chain(&mut self, chunk: ChunkId, goals: &mut Goals) {
        let (mut length, mut bytes, mut failed) = (0, 0, false);
        for c in self.chain(chunk).take_while(|c| self.marks[c.0 as usize].vram != self.frame) {
            length += 1;
            bytes += self.vram_size(c);
            failed |= self.failed[c.0 as usize];
        }
        let (pinned, pool) = (self.info[chunk.0 as usize].pinned, self.info[chunk.0 as usize].pool);
        let fits = goals.vram_bytes[pool] + bytes <= self.vram_bound(pool);
        if failed || !(fits || pinned) {
            return;
        }
        goals.vram_bytes[pool] += bytes;
        let (first, mut next) = (goals.lacking.len(), Some(chunk));
        for _ in 0..length {
            let c = next.expect("the chain was that long");
            next = self.info[c.0 as usize].coarser;
            self.marks[c.0 as usize].vram = self.frame;
            match self.vram[c.0 as usize] {
                Vram::Absent | Vram::Uploading => goals.lacking.push(c),
                _ => goals.standing_bytes[pool] += self.vram_size(c),
            }
        }
        goals.lacking[first..].reverse();
    }

    /// What has to pass through RAM: first what VRAM lacks, then all else that is wanted and not in VRAM; of what is not
    /// there yet no more than may be in flight, but room for all of it: what is less urgent must not take its place.
    fn add_ram(&mut self, goals: &mut Goals) {
        let (mut room, mut loads) = (self.limits.ram_bytes, self.limits.loads_in_flight);
        for chunk in goals.lacking.iter().copied().chain(goals.wants.iter().map(|w| w.chunk)) {
            let place = chunk.0 as usize;
            let needed = matches!(self.vram[place], Vram::Absent | Vram::Uploading) && !self.failed[place];
            let load = (self.ram[place] != Ram::Loaded) as u32;
            let bytes = self.ram_size(chunk);
            let marks = &mut self.marks[place];
            if !needed || marks.reserved == self.frame || bytes > room {
                continue;
            }
            marks.reserved = self.frame;
            room -= bytes;
            if load <= loads {
                loads -= load;
                marks.ram = self.frame;
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

    /// Whether a chunk shall be in VRAM.
    fn is_goal(&self, chunk: ChunkId) -> bool {
        self.marks[chunk.0 as usize].vram == self.frame
    }

    /// Retiring chunks that are wanted again stay; released ones go, finer before coarser.
    pub(super) fn keep_and_free(&mut self, released: &[ChunkId], commands: &mut Vec<Command>) {
        for &chunk in released {
            if self.vram[chunk.0 as usize] == Vram::Retiring {
                self.set_vram(chunk, Vram::Retiring, Vram::Released);
            }
        }
        let mut leaving = self.in_vram.list(LEAVING).to_vec();
        leaving.sort_unstable();
        for &chunk in &leaving {
            if self.is_goal(chunk) {
                self.set_vram(chunk, self.vram[chunk.0 as usize], Vram::Resident);
                commands.push(Command::Keep(chunk));
            }
        }
        leaving.retain(|c| self.vram[c.0 as usize] == Vram::Released);
        // Longer chains first: a finer chunk is one step further from the end of its chain.
        leaving.sort_by_key(|&c| Reverse(self.depth[c.0 as usize]));
        for chunk in leaving {
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
        let goal = goals.vram_bytes[pool] + self.uploading_outside(pool);
        // Leftovers: what stands there and is no goal.
        let mut kept = self.standing_bytes[pool] - goals.standing_bytes[pool];
        if goal + kept <= bound {
            return;
        }
        let mut next = self.vram_victims(pool);
        let mut victims = Vec::with_capacity(next.len());
        while let Some(Reverse((.., chunk))) = next.pop() {
            if goal + kept <= bound {
                return;
            }
            kept -= self.retire_chunk(chunk, commands);
            victims.push(chunk);
        }
        // What finer chunks stood on goes in later rounds.
        let mut progress = true;
        while progress && goal + kept > bound {
            progress = false;
            for &chunk in &victims {
                if goal + kept > bound {
                    let bytes = self.retire_chunk(chunk, commands);
                    progress |= bytes > 0;
                    kept -= bytes;
                }
            }
        }
    }

    /// Asks a chunk back if nothing finer stays on it; the bytes that this makes.
    fn retire_chunk(&mut self, chunk: ChunkId, commands: &mut Vec<Command>) -> u64 {
        let place = chunk.0 as usize;
        if self.vram[place] != Vram::Resident || self.finer_staying[place] > 0 {
            return 0;
        }
        self.set_vram(chunk, Vram::Resident, Vram::Retiring);
        commands.push(Command::Retire(chunk));
        self.vram_size(chunk)
    }

    /// Leftovers of a pool, first to go on top.
    fn vram_victims(&self, pool: usize) -> BinaryHeap<Reverse<Leftover>> {
        let leftover = self.in_vram.list(resident_in(pool)).iter().filter(|c| !self.is_goal(**c));
        let key = |&c: &ChunkId| {
            let mark = &self.marks[c.0 as usize];
            let rank = if mark.wanted == self.frame { mark.rank } else { 0 };
            Reverse((rank != 0, Reverse(rank), mark.wanted, Reverse(self.depth[c.0 as usize]), c))
        };
        leftover.map(key).collect()
    }

    /// Bytes of uploads under way that are no longer wanted: they will be residents soon.
    fn uploading_outside(&self, pool: usize) -> u64 {
        let outside = |c: &&ChunkId| self.info[c.0 as usize].pool == pool && !self.is_goal(**c);
        self.in_vram.list(UPLOADING).iter().filter(outside).map(|&c| self.vram_size(c)).sum()
    }

    /// Begins uploads in order of priority. Room is kept for what is more urgent and still on its way.
    pub(super) fn upload(&mut self, goals: &Goals, commands: &mut Vec<Command>) {
        // None: the pool is full until something was released.
        let mut room: [Option<u64>; POOLS] =
            std::array::from_fn(|pool| Some(self.limits.vram_bytes[pool] - self.vram_bytes[pool]));
        let mut begun = 0;
        for &chunk in &goals.lacking {
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
    pub(super) fn withdraw(&mut self, commands: &mut Vec<Command>) {
        self.loading.retain(|c| self.ram[c.0 as usize] == Ram::Loading);
        let unwanted = self.loading.iter().filter(|c| self.marks[c.0 as usize].ram != self.frame);
        commands.extend(unwanted.map(|&c| Command::Withdraw(c)));
    }

    /// Begins loads in order of priority, dropping from RAM what is not wanted there, longest unused first.
    pub(super) fn load(&mut self, goals: &Goals, commands: &mut Vec<Command>) {
        let mut victims = None;
        for &chunk in &goals.ram {
            if self.ram[chunk.0 as usize] != Ram::Absent {
                continue;
            }
            if self.stats.loads_in_flight >= self.limits.loads_in_flight {
                return;
            }
            while self.stats.ram_bytes + self.ram_size(chunk) > self.limits.ram_bytes {
                let victims = victims.get_or_insert_with(|| self.ram_victims());
                let Some(Reverse((_, victim))) = victims.pop() else { return };
                self.set_ram(victim, Ram::Loaded, Ram::Absent);
                commands.push(Command::DropRam(victim));
            }
            self.set_ram(chunk, Ram::Absent, Ram::Loading);
            self.loading.push(chunk);
            commands.push(Command::Load(chunk));
        }
    }

    /// What may leave RAM, first to go on top: longest unused, number. Copies that are being uploaded stay.
    fn ram_victims(&self) -> BinaryHeap<Reverse<(u32, ChunkId)>> {
        let free = |c: &&ChunkId| {
            let place = c.0 as usize;
            self.vram[place] != Vram::Uploading && self.marks[place].ram != self.frame
        };
        let free = self.loaded.list(0).iter().filter(free);
        free.map(|&c| Reverse((self.marks[c.0 as usize].wanted, c))).collect()
    }
}
