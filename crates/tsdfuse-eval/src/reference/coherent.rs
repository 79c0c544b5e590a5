//! Queries in an order in which neighbouring points follow each other, so that the cache already holds what the next one needs.

use rayon::prelude::*;
use tsdfuse::glam::DVec3;

use crate::bounds::Bounds;

/// `answer` for each point, in the order of the points.
pub(super) fn answers<T: Copy + Default + Send>(points: &[DVec3], answer: impl Fn(DVec3) -> T + Sync) -> Vec<T> {
    let Some(bounds) = Bounds::of(points) else {
        return Vec::new();
    };
    let mut order: Vec<(u32, u32)> = points
        .par_iter()
        .zip(0..points.len() as u32)
        .map(|(&p, i)| (morton(p, &bounds), i))
        .collect();
    order.par_sort_unstable();
    let ordered: Vec<T> = order.par_iter().map(|&(_, i)| answer(points[i as usize])).collect();
    let mut answers = vec![T::default(); points.len()];
    order
        .iter()
        .zip(ordered)
        .for_each(|(&(_, i), answer)| answers[i as usize] = answer);
    answers
}

/// The interleaved bits of the coordinates, 10 of each.
fn morton(p: DVec3, bounds: &Bounds) -> u32 {
    // A box without depth gives NaN, which becomes 0.
    let cell = ((p - bounds.min) / (bounds.max - bounds.min) * 1023.0)
        .as_uvec3()
        .to_array();
    (0..10)
        .rev()
        .flat_map(|bit| cell.map(|c| c >> bit & 1))
        .fold(0, |code, bit| code << 1 | bit)
}
