//! Moves the poses of a g2o file to where they agree best with what was measured between them:
//! `cargo run --release -p tsdfuse-loops --example optimize_graph -- IN.g2o OUT.g2o [--robust]`. The cost is the whole sum of `eᵀ Ω e`.
//! With `--robust`, measurements between poses that do not follow each other may be wrong, as closures may.
#![allow(clippy::print_stdout)] // its output

use std::collections::HashMap;
use std::error::Error;
use std::time::Instant;

use tsdfuse_io::g2o;
use tsdfuse_loops::{Edge, PoseGraph};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (input, output, is_robust) = match arguments.as_slice() {
        [input, output] => (input, output, false),
        [input, output, robust] if robust == "--robust" => (input, output, true),
        _ => return Err("usage: optimize_graph IN.g2o OUT.g2o [--robust]".into()),
    };
    let mut file = g2o::read(input)?;
    let place: HashMap<u64, usize> = file.nodes.iter().enumerate().map(|(n, (id, _))| (*id, n)).collect();
    let of = |id: u64| place.get(&id).copied().ok_or(format!("there is no pose {id}"));
    let mut graph = PoseGraph {
        nodes: file.nodes.iter().map(|(_, pose)| *pose).collect(),
        ..PoseGraph::default()
    };
    for edge in &file.edges {
        let (from, to) = (of(edge.from)?, of(edge.to)?);
        graph.edges.push(Edge {
            from,
            to,
            measured: edge.measured,
            information: Edge::information_of(&edge.information),
            is_closure: is_robust && from.abs_diff(to) > 1,
        });
    }
    let begun = Instant::now();
    let done = graph.optimize();
    let seconds = begun.elapsed().as_secs_f64();
    println!(
        "{} poses, {} measurements: cost {:.6} before, {:.6} after {} iterations, {seconds:.2} s",
        graph.nodes.len(),
        graph.edges.len(),
        done.cost_before,
        done.cost,
        done.iterations
    );
    for ((_, pose), found) in file.nodes.iter_mut().zip(graph.nodes) {
        *pose = found;
    }
    g2o::write(output, &file)?;
    Ok(())
}
