//! Loops of a log's trajectory: placed scans go in, and corrections come out.

use std::collections::HashMap;
use std::time::Instant;

use serde::{Deserialize, Serialize};
use tsdfuse::{Pose, Scan};
use tsdfuse_io::g2o;
use tsdfuse_loops::{Closer, Closure, LoopConfig};
use tsdfuse_odometry::Quality;

/// The loops of a trajectory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopsReport {
    /// Seconds that it took.
    pub seconds: f64,
    /// Stretches of the way that were compared with each other.
    pub local_maps: usize,
    /// Places that look like an earlier one, which odometry says they cannot be.
    pub distrusted: usize,
    /// Places that were recognised, with the scans' numbers in the log.
    pub closures: Vec<Closure>,
}

/// Scans of a log on their way to corrections.
pub(crate) struct Loops {
    closer: Closer,
    /// Their numbers in the log.
    indices: Vec<usize>,
    seconds: f64,
}

/// How scans are to be moved, and why.
#[derive(Default)]
pub(crate) struct Corrections {
    /// Motions of the world, by the scans' numbers in the log.
    by_scan: HashMap<usize, Pose>,
    pub(crate) report: LoopsReport,
    /// The graph of the local maps, whose nodes have the numbers of scans.
    pub(crate) graph: g2o::Graph,
}

impl Loops {
    pub(crate) fn new(config: LoopConfig) -> Self {
        Self {
            closer: Closer::new(config),
            indices: Vec::new(),
            seconds: 0.0,
        }
    }

    /// Takes the next scan, which is placed.
    pub(crate) fn push(&mut self, index: usize, scan: &Scan, quality: &Quality) {
        let start = Instant::now();
        self.closer.push(scan, quality);
        self.indices.push(index);
        self.seconds += start.elapsed().as_secs_f64();
    }

    /// No more scans will come.
    pub(crate) fn finish(mut self) -> Corrections {
        let start = Instant::now();
        self.closer.finish();
        let Self { closer, indices, .. } = &self;
        let by_scan = indices.iter().enumerate();
        let by_scan = by_scan.map(|(n, &index)| (index, closer.correction(n))).collect();
        let closures = closer.closures().iter().map(|closure| Closure {
            earlier: indices[closure.earlier],
            later: indices[closure.later],
            ..*closure
        });
        Corrections {
            by_scan,
            report: LoopsReport {
                seconds: self.seconds + start.elapsed().as_secs_f64(),
                local_maps: closer.graph().nodes.len(),
                distrusted: closer.distrusted(),
                closures: closures.collect(),
            },
            graph: graph(closer, indices),
        }
    }
}

impl Corrections {
    /// The motion of the world that corrects a scan's pose.
    pub(crate) fn of(&self, index: usize) -> Pose {
        self.by_scan.get(&index).copied().unwrap_or(Pose::IDENTITY)
    }
}

fn graph(closer: &Closer, indices: &[usize]) -> g2o::Graph {
    let ids: Vec<u64> = closer.graph_scans().map(|scan| indices[scan] as u64).collect();
    let graph = closer.graph();
    g2o::Graph {
        nodes: ids.iter().copied().zip(graph.nodes.iter().copied()).collect(),
        edges: graph
            .edges
            .iter()
            .map(|edge| g2o::Edge {
                from: ids[edge.from],
                to: ids[edge.to],
                measured: edge.measured,
                information: edge.upper_triangle(),
            })
            .collect(),
    }
}
