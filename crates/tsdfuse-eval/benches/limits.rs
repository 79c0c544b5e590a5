//! What large inputs cost: `cargo bench -p tsdfuse-eval -- poisson` (a million of five million candidates) and
//! `cargo bench -p tsdfuse-eval -- nearest` (ten million points against ten million). Prints seconds, and the peak of memory
//! where the system tells.

#![allow(clippy::print_stdout)]

use std::f64::consts::TAU;
use std::time::Instant;

use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;
use tsdfuse_eval::{Reference, sample};

fn main() {
    let asked = |name: &str| std::env::args().any(|argument| argument == name);
    let mesh = torus(1000, 500);
    if asked("poisson") {
        timed("sampling", || sample::uniform(&mesh, 5_000_000));
        timed("poisson_disk", || sample::poisson_disk(&mesh, 1_000_000));
    }
    if asked("nearest") {
        let near = |p: DVec3| p + 0.01 * DVec3::new((p.y * 1e4).sin(), (p.z * 1e4).sin(), (p.x * 1e4).sin());
        let cloud = sample::uniform(&mesh, 10_000_000).into_iter().map(near).collect();
        let samples = sample::uniform(&mesh, 10_000_000);
        timed("nearest points", || {
            Reference::cloud(cloud).map(|reference| reference.distances(&samples).len())
        });
        timed("nearest triangles", || {
            Reference::mesh(mesh.clone()).map(|reference| reference.distances(&samples).len())
        });
    }
}

fn timed<T>(what: &str, work: impl FnOnce() -> T) {
    let start = Instant::now();
    drop(work());
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status
        .lines()
        .find(|line| line.starts_with("VmHWM"))
        .unwrap_or_default();
    println!("{what}: {:.2} s {peak}", start.elapsed().as_secs_f64());
}

/// 40 m and 10 m in radius, with a million triangles.
fn torus(around: u32, across: u32) -> Mesh {
    let at = |i: u32, j: u32| {
        let (u, v) = (
            TAU * f64::from(i) / f64::from(around),
            TAU * f64::from(j) / f64::from(across),
        );
        let radius = 40.0 + 10.0 * v.cos();
        DVec3::new(radius * u.cos(), radius * u.sin(), 10.0 * v.sin())
    };
    let number = |i: u32, j: u32| (i % around) * across + j % across;
    let quad = |i: u32, j: u32| {
        let [a, b, c, d] = [number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    Mesh {
        vertices: (0..around).flat_map(|i| (0..across).map(move |j| at(i, j))).collect(),
        triangles: (0..around)
            .flat_map(|i| (0..across).flat_map(move |j| quad(i, j)))
            .collect(),
        ..Default::default()
    }
}
