//! What a large pose graph takes: `cargo bench -p tsdfuse-loops`. Ten thousand poses along forty laps, with five hundred closures from lap to lap.
#![allow(clippy::print_stdout)] // its only output

use std::f64::consts::TAU;
use std::time::Instant;

use glam::{DQuat, DVec3};
use nalgebra::Matrix6;
use tsdfuse::Pose;
use tsdfuse_loops::{Edge, PoseGraph};

const POSES: usize = 10_000;
const LAP: usize = 250;
const CLOSURES: usize = 500;
const RUNS: usize = 5;

/// Between -1 and 1.
fn random(state: &mut u64) -> f64 {
    *state = state
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

fn truth(at: usize) -> Pose {
    let angle = TAU * at as f64 / LAP as f64;
    Pose {
        rotation: DQuat::from_rotation_z(angle),
        translation: DVec3::new(80.0 * angle.cos(), 50.0 * angle.sin(), angle.sin()),
    }
}

fn graph() -> PoseGraph {
    let mut state = 1;
    let mut edge = |from: usize, to: usize, sigma: (f64, f64), is_closure| {
        let mut three = |size: f64| DVec3::new(random(&mut state), random(&mut state), random(&mut state)) * size;
        let noise = Pose {
            rotation: DQuat::from_scaled_axis(three(sigma.1)),
            translation: three(sigma.0),
        };
        let (shift, turn) = (sigma.0.powi(-2), sigma.1.powi(-2));
        Edge {
            from,
            to,
            measured: truth(from).inverse() * truth(to) * noise,
            information: Matrix6::from_diagonal(&[shift, shift, shift, turn, turn, turn].into()),
            is_closure,
        }
    };
    let mut edges: Vec<Edge> = (1..POSES).map(|to| edge(to - 1, to, (0.02, 0.002), false)).collect();
    let step = (POSES - LAP) / CLOSURES;
    edges.extend((0..CLOSURES).map(|n| edge(n * step, n * step + LAP, (0.01, 0.001), true)));
    let mut nodes = vec![truth(0)];
    for edge in &edges[..POSES - 1] {
        nodes.push(nodes[edge.from] * edge.measured);
    }
    PoseGraph {
        nodes,
        edges,
        ..PoseGraph::default()
    }
}

fn main() {
    let graph = graph();
    let mut seconds = Vec::new();
    for run in 0..RUNS {
        let mut solved = graph.clone();
        let begun = Instant::now();
        let done = solved.optimize();
        seconds.push(begun.elapsed().as_secs_f64());
        if run == 0 {
            println!("{POSES} poses, {} edges: {done:?}", solved.edges.len());
        }
    }
    seconds.sort_by(f64::total_cmp);
    println!(
        "{:.3} s (median of {RUNS}; {:.3} to {:.3})",
        seconds[RUNS / 2],
        seconds[0],
        seconds[RUNS - 1]
    );
}
