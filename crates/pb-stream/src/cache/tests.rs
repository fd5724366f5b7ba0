//! The two properties, on simulated views with tight bounds; and the dialogues one by one.

use super::*;
use crate::Class;
use proptest::prelude::*;

/// `clusters` chains of `levels` chunks like an archive's: chunk `c * levels + i`, finer ones larger.
fn chains(clusters: u32, levels: u32) -> Vec<ChunkInfo> {
    (0..clusters * levels)
        .map(|id| {
            let level = id % levels;
            let coarser = (level + 1 < levels).then_some(ChunkId(id + 1));
            let bytes = 100u32 << (levels - 1 - level);
            ChunkInfo { ram_bytes: bytes, vram_bytes: bytes as u64, pool: 0, coarser, pinned: coarser.is_none() }
        })
        .collect()
}

/// The same, every second cluster in the second pool.
fn chains_in_two_pools(clusters: u32, levels: u32) -> Vec<ChunkInfo> {
    let mut info = chains(clusters, levels);
    info.iter_mut().enumerate().for_each(|(c, i)| i.pool = c / levels as usize % 2);
    info
}

fn want(chunk: u32, class: Class, error_px: f32) -> Want {
    Want { chunk: ChunkId(chunk), class, error_px }
}

fn limits(ram_bytes: u64, vram_bytes: u64) -> Limits {
    Limits { loads_in_flight: 3, upload_bytes_per_frame: 500, ..Limits::new(ram_bytes, [vram_bytes; POOLS]) }
}

/// A disk, a GPU and a view that answer commands, each at its own pace, and check every promise.
struct World {
    cache: Cache,
    loading: Vec<ChunkId>,
    uploading: Vec<ChunkId>,
    asked_back: Vec<ChunkId>,
    in_vram: Vec<bool>,
    in_ram: Vec<bool>,
    broken: Vec<bool>,
}

impl World {
    fn new(info: Vec<ChunkInfo>, limits: Limits) -> Self {
        let n = info.len();
        Self {
            cache: Cache::new(info, limits).unwrap(),
            loading: Vec::new(),
            uploading: Vec::new(),
            asked_back: Vec::new(),
            in_vram: vec![false; n],
            in_ram: vec![false; n],
            broken: vec![false; n],
        }
    }

    /// In RAM they have as many.
    fn vram_bytes(&self, chunks: impl Iterator<Item = usize>) -> u64 {
        chunks.map(|c| self.cache.info[c].vram_bytes).sum()
    }

    /// One frame; `released` is what the view gives back of what was asked back.
    fn frame(&mut self, wants: &[Want], released: &[ChunkId]) -> Vec<Command> {
        let commands = self.cache.frame(wants, released);
        for &command in &commands {
            self.obey(command, released);
            self.check();
        }
        commands
    }

    fn obey(&mut self, command: Command, released: &[ChunkId]) {
        let finer_in_vram = |w: &World, c: ChunkId| {
            (0..w.in_vram.len()).any(|f| {
                w.cache.info[f].coarser == Some(c) && (w.in_vram[f] || w.uploading.contains(&ChunkId(f as u32)))
            })
        };
        match command {
            Command::Load(c) => {
                assert!(!self.in_ram[c.0 as usize] && !self.loading.contains(&c));
                assert!(!self.cache.has_failed(c), "{c:?} is asked for again");
                self.loading.push(c);
            }
            Command::Withdraw(c) => {
                assert!(self.loading.contains(&c));
                // Those of odd numbers are being read.
                if c.0.is_multiple_of(2) {
                    self.loading.retain(|&k| k != c);
                    self.cache.load_withdrawn(c);
                }
            }
            Command::Upload(c) => {
                assert!(self.in_ram[c.0 as usize] && !self.in_vram[c.0 as usize]);
                let coarser = self.cache.info[c.0 as usize].coarser;
                assert!(coarser.is_none_or(|k| self.in_vram[k.0 as usize]), "{c:?} before its coarser one");
                self.uploading.push(c);
            }
            Command::DropRam(c) => {
                assert!(self.in_ram[c.0 as usize] && !self.uploading.contains(&c));
                self.in_ram[c.0 as usize] = false;
            }
            Command::Retire(c) => {
                assert!(self.in_vram[c.0 as usize] && !self.cache.info[c.0 as usize].pinned);
                self.asked_back.push(c);
            }
            Command::Keep(c) => self.asked_back.retain(|&k| k != c),
            Command::Free(c) => {
                assert!(self.asked_back.contains(&c), "{c:?} was not asked back");
                assert!(!finer_in_vram(self, c), "{c:?} before its finer one");
                let _ = released;
                self.asked_back.retain(|&k| k != c);
                self.in_vram[c.0 as usize] = false;
            }
        }
    }

    fn check(&self) {
        let limits = self.cache.limits();
        let indices = |list: &[ChunkId]| list.iter().map(|c| c.0 as usize).collect::<Vec<_>>();
        let set = |flags: &[bool]| (0..flags.len()).filter(|&c| flags[c]).collect::<Vec<_>>();
        let ram = self.vram_bytes(set(&self.in_ram).into_iter().chain(indices(&self.loading)));
        assert!(ram <= limits.ram_bytes, "ram {ram} of {limits:?}");
        for pool in 0..POOLS {
            let there = set(&self.in_vram).into_iter().chain(indices(&self.uploading));
            let vram = self.vram_bytes(there.filter(|&c| self.cache.info[c].pool == pool));
            assert!(vram <= limits.vram_bytes[pool], "pool {pool} {vram} of {limits:?}");
        }
        assert!(self.loading.len() <= limits.loads_in_flight as usize);
    }

    fn check_view(&self) {
        assert_eq!(self.cache.resident(), self.in_vram);
        let stats = self.cache.stats();
        assert_eq!(stats.loads_in_flight as usize, self.loading.len());
        assert_eq!(stats.retiring as usize, self.asked_back.len());
        for (c, _) in self.in_vram.iter().enumerate().filter(|(_, r)| **r) {
            assert!(self.cache.info[c].coarser.is_none_or(|k| self.in_vram[k.0 as usize]));
        }
    }

    fn finish_load(&mut self, i: usize) {
        let chunk = self.loading.remove(i);
        if self.broken[chunk.0 as usize] {
            self.cache.load_failed(chunk);
        } else {
            self.in_ram[chunk.0 as usize] = true;
            self.cache.loaded(chunk);
        }
    }

    fn finish_upload(&mut self, i: usize, works: bool) {
        let chunk = self.uploading.remove(i);
        if works {
            self.in_vram[chunk.0 as usize] = true;
            self.cache.uploaded(chunk);
        } else {
            self.cache.upload_failed(chunk);
        }
    }

    /// Frames with a prompt disk, GPU and view, until nothing changes any more. Fails if that never happens.
    fn settle(&mut self, wants: &[Want]) {
        for _ in 0..2000 {
            let released = self.asked_back.clone();
            self.frame(wants, &released);
            while !self.loading.is_empty() {
                self.finish_load(0);
            }
            while !self.uploading.is_empty() {
                self.finish_upload(0, true);
            }
            self.check_view();
            if self.cache.is_idle() {
                return;
            }
        }
        panic!("does not settle");
    }
}

#[derive(Clone, Debug)]
enum Step {
    Frame(Vec<Want>, u8),
    Load(u8),
    Upload(u8, bool),
}

fn any_want(chunks: u32) -> impl Strategy<Value = Want> {
    let class = prop_oneof![Just(Class::Maybe), Just(Class::Soon), Just(Class::Now)];
    (0..chunks, class, 0u8..20).prop_map(|(c, class, e)| want(c, class, e as f32))
}

fn any_step(chunks: u32) -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => (prop::collection::vec(any_want(chunks), 0..12), any::<u8>()).prop_map(|(w, r)| Step::Frame(w, r)),
        3 => any::<u8>().prop_map(Step::Load),
        3 => (any::<u8>(), prop::bool::weighted(0.9)).prop_map(|(i, works)| Step::Upload(i, works)),
    ]
}

#[test]
fn loads_that_nobody_waits_for_make_way() {
    let info = chains(6, 1).into_iter().map(|i| ChunkInfo { pinned: false, ..i }).collect();
    let mut world = World::new(info, limits(10_000, 10_000));
    let early: Vec<Want> = (0..3).map(|c| want(c, Class::Soon, 1.0)).collect();
    let load = |chunks: [u32; 3]| chunks.map(|c| Command::Load(ChunkId(c)));
    assert_eq!(world.frame(&early, &[]), load([0, 1, 2]));
    let late: Vec<Want> = (3..6).map(|c| want(c, Class::Now, 1.0)).collect();
    let all = [early, late].concat();
    // Chunk 1 is being read already.
    let told = world.frame(&all, &[]);
    assert_eq!(told, [0, 1, 2].map(|c| Command::Withdraw(ChunkId(c))));
    assert_eq!(world.frame(&all, &[])[1..], [3, 4].map(|c| Command::Load(ChunkId(c))));
    world.finish_load(0);
    assert_eq!(world.cache.stats().loads_in_flight, 2);
    assert!(world.frame(&all, &[]).contains(&Command::Load(ChunkId(5))));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Safety at every step of random views, with answers in random order and time; and liveness after it.
    #[test]
    fn bounds_hold_nothing_drawn_is_freed_and_a_lone_want_becomes_resident(
        steps in prop::collection::vec(any_step(24), 1..150),
        ram in 800u64..3000,
        vram in 2100u64..5000,
        broken in prop::collection::vec(prop::bool::weighted(0.05), 24),
        lone in 0u32..24,
        two_pools in any::<bool>(),
    ) {
        let info = if two_pools { chains_in_two_pools(6, 4) } else { chains(6, 4) };
        let mut world = World::new(info.clone(), limits(ram, vram));
        world.broken = broken;
        for step in steps {
            match step {
                Step::Frame(wants, mask) => {
                    let asked = world.asked_back.iter().enumerate();
                    let released: Vec<ChunkId> =
                        asked.filter(|(i, _)| mask >> (i % 8) & 1 == 1).map(|(_, &c)| c).collect();
                    world.frame(&wants, &released);
                }
                Step::Load(i) if !world.loading.is_empty() => world.finish_load(i as usize % world.loading.len()),
                Step::Upload(i, works) if !world.uploading.is_empty() => {
                    world.finish_upload(i as usize % world.uploading.len(), works);
                }
                _ => {}
            }
            world.check();
            world.check_view();
        }
        // The chain of one cluster is 1500 bytes and the roots are 600: that fits into the smallest bound.
        world.settle(&[want(lone, Class::Now, 5.0)]);
        let mut chain = std::iter::successors(Some(ChunkId(lone)), |c| info[c.0 as usize].coarser);
        let readable = chain.clone().all(|c| !world.broken[c.0 as usize]);
        prop_assert!(!readable || chain.all(|c| world.in_vram[c.0 as usize]));
    }

    /// The same events give the same commands.
    #[test]
    fn replaying_gives_the_same_commands(frames in prop::collection::vec(prop::collection::vec(any_want(24), 0..12), 1..20)) {
        let run = || {
            let mut world = World::new(chains(6, 4), limits(1000, 2500));
            let mut log = Vec::new();
            for wants in &frames {
                let released = world.asked_back.clone();
                log.push(world.frame(wants, &released));
                while !world.loading.is_empty() { world.finish_load(0); }
                while !world.uploading.is_empty() { world.finish_upload(0, true); }
            }
            log
        };
        prop_assert_eq!(run(), run());
    }
}

#[test]
fn roots_come_first_and_are_never_asked_back() {
    let mut world = World::new(chains(6, 4), limits(1000, 2100));
    world.settle(&[]);
    assert!((0..6).all(|c| world.in_vram[c * 4 + 3]));
    (0..24).for_each(|c| world.settle(&[want(c, Class::Now, 1.0)]));
    assert!((0..6).all(|c| world.in_vram[c * 4 + 3]));
}

#[test]
fn a_chunk_is_freed_only_after_the_view_released_it() {
    let mut world = World::new(chains(2, 4), limits(2000, 1700));
    world.settle(&[want(0, Class::Now, 1.0)]);
    assert!(world.in_vram[0]);
    let wants = [want(4, Class::Now, 1.0)];
    // The other cluster does not fit beside it: the first is asked back, finest first, but stays while it is shown.
    let mut asked = world.frame(&wants, &[]);
    asked.retain(|c| matches!(c, Command::Retire(_)));
    assert_eq!(asked, [0, 1, 2].map(|c| Command::Retire(ChunkId(c))));
    (0..10).for_each(|_| assert!(world.frame(&wants, &[]).iter().all(|c| !matches!(c, Command::Free(_)))));
    assert!(world.in_vram[0] && world.cache.retiring()[0]);
    let freed = world.frame(&wants, &[ChunkId(1), ChunkId(0)]);
    assert!(freed.starts_with(&[Command::Free(ChunkId(0)), Command::Free(ChunkId(1))]), "{freed:?}");
    world.settle(&wants);
    assert!(world.in_vram[4]);
}

#[test]
fn a_coarser_chunk_that_is_released_first_waits_for_the_finer_one() {
    let mut world = World::new(chains(2, 4), limits(2000, 1700));
    world.settle(&[want(0, Class::Now, 1.0)]);
    let wants = [want(4, Class::Now, 1.0)];
    world.frame(&wants, &[]);
    assert!(world.frame(&wants, &[ChunkId(2)]).iter().all(|c| !matches!(c, Command::Free(_))));
    assert_eq!(world.frame(&wants, &[ChunkId(1)]).iter().filter(|c| matches!(c, Command::Free(_))).count(), 0);
    let freed = world.frame(&wants, &[ChunkId(0)]);
    assert!(freed.starts_with(&[0, 1, 2].map(|c| Command::Free(ChunkId(c)))), "{freed:?}");
}

#[test]
fn a_retired_chunk_that_is_wanted_again_is_kept() {
    let mut world = World::new(chains(2, 4), limits(2000, 1700));
    world.settle(&[want(0, Class::Now, 1.0)]);
    world.frame(&[want(4, Class::Now, 1.0)], &[]);
    let back = world.frame(&[want(0, Class::Now, 1.0)], &[ChunkId(0)]);
    assert!(back.contains(&Command::Keep(ChunkId(0))) && !back.contains(&Command::Free(ChunkId(0))));
    assert!(world.in_vram[0] && !world.cache.retiring()[0]);
}

#[test]
fn unwanted_chunks_stay_while_there_is_room_and_the_longest_unused_goes_first() {
    let mut world = World::new(chains(3, 2), limits(1000, 300 + 400));
    world.settle(&[want(0, Class::Now, 1.0)]);
    world.settle(&[want(2, Class::Now, 1.0)]);
    assert!(world.in_vram[0], "there is room for both");
    world.settle(&[want(4, Class::Now, 1.0)]);
    assert!(!world.in_vram[0] && world.in_vram[2]);
}

#[test]
fn the_more_urgent_want_gets_the_room() {
    let wants = [want(0, Class::Soon, 90.0), want(2, Class::Now, 1.0), want(4, Class::Now, 8.0)];
    let mut world = World::new(chains(3, 2), limits(1000, 300 + 400));
    world.settle(&wants);
    assert_eq!([0, 2, 4].map(|c| world.in_vram[c]), [false, true, true]);
    let mut world = World::new(chains(3, 2), limits(1000, 300 + 200));
    world.settle(&wants);
    assert_eq!([0, 2, 4].map(|c| world.in_vram[c]), [false, false, true]);
}

#[test]
fn pools_of_vram_lend_nothing_to_one_another_and_do_not_wait_for_one_another() {
    let limits = Limits { vram_bytes: [300, 800], ..limits(1000, 0) };
    let mut world = World::new(chains_in_two_pools(4, 2), limits);
    world.settle(&[
        want(0, Class::Now, 90.0),
        want(4, Class::Now, 80.0),
        want(2, Class::Now, 2.0),
        want(6, Class::Now, 1.0),
    ]);
    assert_eq!([0, 2, 4, 6].map(|c| world.in_vram[c]), [false, true, false, true]);
    let limits = Limits { vram_bytes: [400, 800], ..limits };
    let mut world = World::new(chains_in_two_pools(4, 2), limits);
    world.settle(&[want(0, Class::Now, 90.0)]);
    // The first pool is full of what is still shown; the second takes what is less urgent.
    (0..9).for_each(|_| {
        world.frame(&[want(4, Class::Now, 90.0), want(6, Class::Now, 1.0)], &[]);
        (0..world.loading.len()).for_each(|_| world.finish_load(0));
        (0..world.uploading.len()).for_each(|_| world.finish_upload(0, true));
    });
    assert_eq!([0, 4, 6].map(|c| world.in_vram[c]), [true, false, true]);
}

#[test]
fn maybe_wants_go_to_ram_only() {
    let mut world = World::new(chains(1, 2), limits(1000, 1000));
    world.settle(&[want(0, Class::Maybe, 1.0)]);
    assert!(world.in_ram[0] && !world.in_vram[0]);
}

#[test]
fn a_damaged_chunk_is_counted_not_asked_for_again_and_hides_its_finer_ones() {
    let mut world = World::new(chains(2, 4), limits(3000, 4000));
    world.broken[1] = true;
    world.settle(&[want(0, Class::Now, 1.0), want(4, Class::Now, 1.0)]);
    assert_eq!(world.cache.stats().failed, 1);
    assert_eq!(world.in_vram[..4], [false, false, false, true]);
    assert!(world.in_vram[4..].iter().all(|&r| r));
    world.settle(&[want(2, Class::Now, 1.0)]);
    assert!(world.in_vram[2], "what is coarser than the damage is still used");
}

#[test]
fn a_fragmented_heap_gets_room_and_another_try() {
    let mut world = World::new(chains(2, 2), limits(1000, 600));
    world.settle(&[want(0, Class::Now, 1.0)]);
    let wants = [want(2, Class::Now, 1.0)];
    // Uploads of chunk 2 fail while chunk 0 is there.
    for _ in 0..50 {
        let released = world.asked_back.clone();
        world.frame(&wants, &released);
        while !world.loading.is_empty() {
            world.finish_load(0);
        }
        let works = !world.in_vram[0];
        while !world.uploading.is_empty() {
            world.finish_upload(0, works);
        }
    }
    assert!(world.in_vram[2] && !world.in_vram[0]);
}

#[test]
fn bounds_that_cannot_work_are_refused_with_what_is_needed() {
    let refuse = |ram, vram| Cache::new(chains(6, 4), limits(ram, vram)).err().unwrap().to_string();
    assert!(refuse(1000, 599).contains("coarsest level alone needs 600"));
    assert!(refuse(799, 1000).contains("largest chunk needs 800"));
}
