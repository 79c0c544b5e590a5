//! What voxels of four bytes would err: `cargo run --release -p tsdfuse-cli --example four_byte_voxels -- LOG`.
//!
//! Fuses with raycasting, and after each scan adds what it changed to smaller voxels of several forms, too, once a voxel. In the end the
//! smaller ones are compared with those of the map. What is found is written up in docs/voxels.md.

#![allow(clippy::print_stdout)]

use std::collections::HashMap;

use anyhow::{Context, Result};
use rayon::prelude::*;
use tsdfuse::index::BlockIndex;
use tsdfuse::map::{Block, Voxel, WEIGHT_SCALE};
use tsdfuse::mesh::MeshConfig;
use tsdfuse::{Integrator, MapConfig, Raycast, VoxelMap};

/// A form of four bytes.
#[derive(Clone, Copy)]
struct Form {
    name: &'static str,
    /// Steps of a weight of 1.
    scale: f64,
    /// Whether distances are kept as a sum, or as their mean in steps of 1/32 767 of the truncation.
    sums: bool,
}

const FORMS: [Form; 5] = [
    form("mean, weights of 1/64", 64.0, false),
    form("mean, weights of 1/256", 256.0, false),
    form("mean, weights of 1/1024", 1024.0, false),
    form("sums, steps of 1/256", 256.0, true),
    form("sums, steps of 1/1024", 1024.0, true),
];

const fn form(name: &'static str, scale: f64, sums: bool) -> Form {
    Form { name, scale, sums }
}

#[derive(Clone, Copy, Default)]
struct Small {
    weight: u16,
    distance: i16,
}

impl Form {
    /// Adds a weight and a weighted distance; at its largest weight a voxel keeps a running mean.
    fn add(self, voxel: &mut Small, weight: f64, weighted: f64) {
        let one = f64::from(i16::MAX);
        let (old, added) = (f64::from(voxel.weight), weight * self.scale);
        if self.sums {
            let (sum, distance) = (
                old + added.round(),
                f64::from(voxel.distance) + (weighted * self.scale).round(),
            );
            let shrink = (one / sum).min(1.0);
            voxel.weight = (sum * shrink).round() as u16;
            voxel.distance = (distance * shrink).round() as i16;
        } else {
            let sum = old + added;
            let mean = (f64::from(voxel.distance) * old + weighted * self.scale * one) / sum;
            voxel.distance = mean.round().clamp(-one, one) as i16;
            // An update may be less than a step, but was seen.
            voxel.weight = sum.round().clamp(1.0, f64::from(u16::MAX)) as u16;
        }
    }

    /// F; nothing where no weight is left.
    fn distance(self, voxel: Small) -> Option<f64> {
        let over = if self.sums {
            f64::from(voxel.weight)
        } else {
            f64::from(i16::MAX)
        };
        (voxel.weight > 0).then(|| f64::from(voxel.distance) / over)
    }
}

/// The small voxels of a block.
type Smalls = Vec<Small>;

fn main() -> Result<()> {
    let path = std::env::args().nth(1).context("a log is wanted")?;
    let log = tsdfuse_io::open(&path)?;
    let mut map = VoxelMap::new(MapConfig::default())?;
    let mut fuser = Raycast::default();
    let mut small: HashMap<BlockIndex, Smalls> = HashMap::new();
    for scan in &log {
        let scan = scan?;
        let before = map.clone();
        for index in fuser.integrate(&mut map, &scan)?.updated_blocks {
            small
                .entry(index)
                .or_insert_with(|| vec![Small::default(); 512 * FORMS.len()]);
        }
        small.par_iter_mut().for_each(|(&index, voxels)| {
            if let Some(block) = map.block(index) {
                add_changes(before.block(index), block, voxels);
            }
        });
    }

    let truncation_mm = 1e3 * map.config().truncation_m;
    println!("{path}: {} scans, {} blocks\n", log.scans().len(), map.block_count());
    println!("| | RMS mm | 99.9 % mm | largest mm | other side | lost |");
    println!("|---|---|---|---|---|---|");
    for (number, form) in FORMS.iter().enumerate() {
        let errors: Vec<Option<(f64, bool)>> = small
            .par_iter()
            .flat_map_iter(|(&index, voxels)| errors(map.block(index), &voxels[512 * number..], *form))
            .collect();
        let mut found: Vec<f64> = errors
            .iter()
            .flatten()
            .map(|(error, _)| error * truncation_mm)
            .collect();
        found.sort_unstable_by(f64::total_cmp);
        let of_all = |n: usize| n as f64 / errors.len() as f64;
        println!(
            "| {} | {:.4} | {:.3} | {:.2} | {:.1e} | {:.1e} |",
            form.name,
            (found.iter().map(|e| e * e).sum::<f64>() / found.len() as f64).sqrt(),
            found[found.len() * 999 / 1000],
            found.last().copied().unwrap_or_default(),
            of_all(errors.iter().flatten().filter(|(_, flipped)| *flipped).count()),
            of_all(errors.iter().filter(|error| error.is_none()).count()),
        );
    }
    Ok(())
}

/// Adds what a scan changed in a block.
fn add_changes(old: Option<&Block>, new: &Block, voxels: &mut [Small]) {
    for (i, voxel) in new.voxels.iter().enumerate() {
        let old = old.map_or(Voxel::default(), |block| block.voxels[i]);
        if *voxel == old {
            continue;
        }
        let scaled = |sum: i64| sum as f64 / f64::from(WEIGHT_SCALE);
        let weight = scaled(i64::from(voxel.weight_sum) - i64::from(old.weight_sum));
        let weighted = scaled(i64::from(voxel.distance_sum) - i64::from(old.distance_sum));
        for (number, form) in FORMS.iter().enumerate() {
            form.add(&mut voxels[512 * number + i], weight, weighted);
        }
    }
}

/// |ΔF| of each voxel that becomes surface, and whether it lies on the other side of it; `None` where nothing is left.
fn errors<'a>(
    block: Option<&'a Block>,
    voxels: &'a [Small],
    form: Form,
) -> impl Iterator<Item = Option<(f64, bool)>> + 'a {
    let exact = block.map_or(&[][..], |block| &block.voxels[..]).iter().zip(voxels);
    let exact = exact.filter(|(exact, _)| exact.weight() >= MeshConfig::default().min_weight);
    exact.filter_map(move |(exact, small)| {
        let wanted = f64::from(exact.distance()?);
        let got = form.distance(*small);
        Some(got.map(|got| ((got - wanted).abs(), (got < 0.0) != (wanted < 0.0))))
    })
}
