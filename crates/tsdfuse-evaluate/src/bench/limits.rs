//! What memory allows on as many threads as fuse: in order, as STREAM measures it (McCalpin, <https://www.cs.virginia.edu/stream/>),
//! and lines of 64 bytes at random, as a map is updated.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;

/// Bytes of a cache line, of which a row of eight voxels fills one.
pub(crate) const LINE_BYTES: usize = 64;

/// Words of each array: 256 MiB, many times what caches hold.
const WORDS: usize = 1 << 25;

/// Each measure is the best of so many.
const TRIES: usize = 8;

/// Random lines that each thread reads and writes.
const RANDOM: usize = 1 << 22;

/// Words that a thread takes at a time.
const PART: usize = 1 << 16;

/// Bytes count once when they are read and once when they are written.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// a = b.
    pub copy_bytes_per_sec: f64,
    /// a = b + s·c.
    pub triad_bytes_per_sec: f64,
    /// a = s·a + 1: what an update of the whole map in order would do.
    pub in_place_bytes_per_sec: f64,
    /// Lines at random in one array, each read, changed and written, none waiting for another.
    pub random_lines_per_sec: f64,
}

impl Limits {
    /// Measures on the threads of the current pool.
    pub(crate) fn measure() -> Self {
        let mut arrays = Arrays::new(WORDS);
        let bytes = |arrays: usize, seconds: f64| (arrays * WORDS * size_of::<f64>()) as f64 / seconds;
        let copy = best(|| arrays.copy());
        let triad = best(|| arrays.triad(3.0));
        let in_place = best(|| arrays.in_place(0.5));
        drop(arrays);
        let lines = Lines::new(WORDS);
        let random = best(|| lines.update(RANDOM));
        Self {
            copy_bytes_per_sec: bytes(2, copy),
            triad_bytes_per_sec: bytes(3, triad),
            in_place_bytes_per_sec: bytes(2, in_place),
            random_lines_per_sec: (RANDOM * rayon::current_num_threads()) as f64 / random,
        }
    }
}

/// Seconds of the fastest try.
fn best(mut work: impl FnMut()) -> f64 {
    let seconds = (0..TRIES).map(|_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    });
    seconds.fold(f64::INFINITY, f64::min)
}

/// Three arrays, in parts that threads take.
struct Arrays {
    a: Vec<f64>,
    b: Vec<f64>,
    c: Vec<f64>,
}

impl Arrays {
    fn new(words: usize) -> Self {
        // Each number is written: memory that is only asked for is not there yet.
        let array = |value: f64| (0..words).into_par_iter().map(|_| value).collect();
        Self {
            a: array(1.0),
            b: array(2.0),
            c: array(3.0),
        }
    }

    fn copy(&mut self) {
        let parts = self.a.par_chunks_mut(PART).zip(self.b.par_chunks(PART));
        parts.for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| *a = *b));
    }

    fn triad(&mut self, s: f64) {
        let parts = self.a.par_chunks_mut(PART).zip(self.b.par_chunks(PART));
        let parts = parts.zip(self.c.par_chunks(PART));
        parts.for_each(|((a, b), c)| {
            let words = a.iter_mut().zip(b).zip(c);
            words.for_each(|((a, b), c)| *a = *b + s * *c);
        });
    }

    fn in_place(&mut self, s: f64) {
        let parts = self.a.par_chunks_mut(PART);
        parts.for_each(|a| a.iter_mut().for_each(|a| *a = s * *a + 1.0));
    }
}

/// An array that all threads write to. Two may meet in a line and one of them be lost, which costs the same.
struct Lines(Vec<AtomicU64>);

impl Lines {
    fn new(words: usize) -> Self {
        Self((0..words).into_par_iter().map(|_| AtomicU64::new(0)).collect())
    }

    /// Adds 1 in `count` random lines on each thread.
    fn update(&self, count: usize) {
        const WORDS_A_LINE: usize = LINE_BYTES / size_of::<u64>();
        let lines = self.0.len() / WORDS_A_LINE;
        rayon::broadcast(|thread| {
            let mut random = thread.index() as u64;
            for _ in 0..count {
                // Knuth's MMIX generator; its upper bits are the random ones.
                random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                let line = ((random >> 32) as usize * lines) >> 32;
                let word = &self.0[line * WORDS_A_LINE];
                word.store(word.load(Relaxed) + 1, Relaxed);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is timed is done, to the last word.
    #[test]
    fn the_arrays_hold_what_was_asked_for() {
        let words = 2 * PART + 3;
        let mut arrays = Arrays::new(words);
        arrays.copy();
        assert_eq!(arrays.a, vec![2.0; words]);
        arrays.triad(3.0);
        assert_eq!(arrays.a, vec![11.0; words]);
        arrays.in_place(0.5);
        assert_eq!(arrays.a, vec![6.5; words]);
    }

    #[test]
    fn random_lines_are_all_there_and_all_of_the_array() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let lines = Lines::new(8 * 1000);
        pool.install(|| lines.update(100_000));
        let hits: Vec<u64> = lines.0.iter().map(|word| word.load(Relaxed)).collect();
        assert_eq!(hits.iter().sum::<u64>(), 100_000);
        // 100 a line, give or take six standard deviations.
        assert!(hits.iter().step_by(8).all(|hits| (40..160).contains(hits)), "{hits:?}");
        assert!(hits.iter().enumerate().all(|(i, hits)| i % 8 == 0 || *hits == 0));
    }
}
