//! The heaviest of many samples whose weights only fall.

use std::collections::BinaryHeap;

/// Samples by weight, in buckets of neighbouring weights. A sample may lie too high; it is put right when it is met. Only
/// the highest bucket is ordered: it is small, where a heap of all samples would be far larger than a cache.
pub(super) struct Queue {
    /// The lowest first.
    buckets: Vec<Vec<u32>>,
    /// Weights of a bucket, but for the highest of all, which has no end.
    width: u64,
    /// What was the bucket above: weight and number for the order, and the sample.
    top: BinaryHeap<(u64, u32, u32)>,
}

const BUCKETS: usize = 1 << 16;

impl Queue {
    pub(super) fn new(weights: &[u64]) -> Self {
        // The few samples of more than four times the mean share the highest bucket.
        let mean = weights.iter().sum::<u64>() / weights.len().max(1) as u64;
        let width = 4 * mean / BUCKETS as u64 + 1;
        let mut buckets = vec![Vec::new(); BUCKETS];
        for (&weight, i) in weights.iter().zip(0..) {
            buckets[((weight / width) as usize).min(BUCKETS - 1)].push(i);
        }
        Self {
            buckets,
            width,
            top: BinaryHeap::new(),
        }
    }

    /// Takes out the sample of the greatest weight, and of equals the one of the greatest number.
    pub(super) fn pop(&mut self, weights: &[u64], numbers: &[u32]) -> Option<usize> {
        loop {
            let Some((was, _, i)) = self.top.pop() else {
                let highest = self.buckets.pop()?;
                highest.into_iter().for_each(|i| self.put(i, weights, numbers));
                continue;
            };
            if was == weights[i as usize] {
                return Some(i as usize);
            }
            self.put(i, weights, numbers);
        }
    }

    /// Puts a sample where it belongs now.
    fn put(&mut self, i: u32, weights: &[u64], numbers: &[u32]) {
        let weight = weights[i as usize];
        match self.buckets.get_mut((weight / self.width) as usize) {
            Some(bucket) => bucket.push(i),
            None => self.top.push((weight, numbers[i as usize], i)),
        }
    }
}
