//! Statistics of distances.

use rayon::prelude::*;
use serde::Serialize;

/// Statistics of a set of distances, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Stats {
    /// The number of distances.
    pub count: usize,
    /// The average distance (thesis 7.4).
    pub mean_m: f64,
    /// The standard deviation of the whole set (divided by the count, not by one less).
    pub std_m: f64,
    /// The root mean square.
    pub rmse_m: f64,
    /// The median. This and the percentiles are interpolated linearly between neighbours.
    pub median_m: f64,
    /// The 90th percentile.
    pub p90_m: f64,
    /// The 95th percentile.
    pub p95_m: f64,
    /// The 99th percentile.
    pub p99_m: f64,
    /// The largest distance: the one-sided Hausdorff distance (thesis 7.3).
    pub max_m: f64,
}

impl Stats {
    /// The statistics of these distances; `None` if there are none.
    pub fn of(distances_m: &[f64]) -> Option<Self> {
        let mut sorted = distances_m.to_vec();
        sorted.par_sort_unstable_by(f64::total_cmp);
        let max_m = *sorted.last()?;
        let n = sorted.len() as f64;
        let mean_m = sum(&sorted, |d| d) / n;
        Some(Self {
            count: sorted.len(),
            mean_m,
            std_m: (sum(&sorted, |d| (d - mean_m).powi(2)) / n).sqrt(),
            rmse_m: (sum(&sorted, |d| d * d) / n).sqrt(),
            median_m: percentile(&sorted, 0.50),
            p90_m: percentile(&sorted, 0.90),
            p95_m: percentile(&sorted, 0.95),
            p99_m: percentile(&sorted, 0.99),
            max_m,
        })
    }
}

/// The value at rank `share · (n − 1)`, interpolated linearly between its neighbours, as in NumPy.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let rank = share * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[rank.floor() as usize], sorted[rank.ceil() as usize]);
    low + (high - low) * rank.fract()
}

/// The middle value, the lower of the two middle ones if their number is even; NaN if there is none. Unlike
/// [`Stats::median_m`] it is always one of the values.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let middle = sorted.len().saturating_sub(1) / 2;
    sorted.get(middle).copied().unwrap_or(f64::NAN)
}

/// A sum whose order of additions does not depend on the number of threads.
fn sum(values: &[f64], term: impl Fn(f64) -> f64 + Sync) -> f64 {
    let parts: Vec<f64> = values
        .par_chunks(1 << 14)
        .map(|part| part.iter().map(|&v| term(v)).sum())
        .collect();
    parts.iter().sum()
}

/// The share of the distances that are at most `threshold_m`; 0 if there are none.
pub fn share_within(distances_m: &[f64], threshold_m: f64) -> f64 {
    let within = distances_m.par_iter().filter(|&&d| d <= threshold_m).count();
    within as f64 / distances_m.len().max(1) as f64
}

/// The numbers of distances in equal bins from 0 upwards.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Histogram {
    /// The width of a bin, metres; bin `i` covers `[i, i + 1) · bin_m`.
    pub bin_m: f64,
    /// The number of distances in each bin.
    pub counts: Vec<u64>,
    /// The number of distances beyond the last bin.
    pub beyond: u64,
}

impl Histogram {
    /// Counts distances in `bins` bins.
    pub fn of(distances_m: &[f64], bin_m: f64, bins: usize) -> Self {
        let mut histogram = Self {
            bin_m,
            counts: vec![0; bins],
            beyond: 0,
        };
        for d in distances_m {
            // The cast saturates.
            match histogram.counts.get_mut((d / bin_m) as usize) {
                Some(count) => *count += 1,
                None => histogram.beyond += 1,
            }
        }
        histogram
    }

    /// The share of all distances below the end of each bin.
    pub fn cumulative(&self) -> Vec<f64> {
        let total = (self.counts.iter().sum::<u64>() + self.beyond).max(1) as f64;
        let sums = self.counts.iter().scan(0, |sum, count| {
            *sum += count;
            Some(*sum)
        });
        sums.map(|sum: u64| sum as f64 / total).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_few_distances() {
        let stats = Stats::of(&[4.0, 1.0, 3.0, 2.0, 0.0]).unwrap();
        assert_eq!(
            (stats.count, stats.mean_m, stats.median_m, stats.max_m),
            (5, 2.0, 2.0, 4.0)
        );
        assert!((stats.std_m - 2_f64.sqrt()).abs() < 1e-15 && (stats.rmse_m - 6_f64.sqrt()).abs() < 1e-15);
        assert!((stats.p90_m - 3.6).abs() < 1e-12 && (stats.p99_m - 3.96).abs() < 1e-12);
        assert_eq!(Stats::of(&[]), None);
        assert_eq!(Stats::of(&[7.0]).unwrap().p95_m, 7.0);
    }

    #[test]
    fn the_median_is_one_of_the_values() {
        assert_eq!(median([3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median([4.0, 1.0, 3.0, 2.0]), 2.0);
        assert_eq!(median([-0.0, 0.0]).to_bits(), (-0.0_f64).to_bits());
        assert!(median([]).is_nan());
    }

    #[test]
    fn a_bound_belongs_to_the_share() {
        assert_eq!(share_within(&[0.05, 0.051, 0.0], 0.05), 2.0 / 3.0);
        assert_eq!(share_within(&[], 0.05), 0.0);
    }

    #[test]
    fn bins_count_every_distance() {
        let histogram = Histogram::of(&[0.0, 0.9, 1.0, 2.5, 3.0, 1e300], 1.0, 3);
        assert_eq!((histogram.counts.as_slice(), histogram.beyond), (&[2, 1, 1][..], 2));
        assert_eq!(histogram.cumulative(), [2.0 / 6.0, 3.0 / 6.0, 4.0 / 6.0]);
    }

    #[test]
    fn threads_do_not_change_sums() {
        let distances: Vec<f64> = (0..100_000).map(|i| (f64::from(i) * 0.618).fract() * 1e-3).collect();
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Stats::of(&distances))
        };
        assert_eq!(with(1), with(4));
    }
}
