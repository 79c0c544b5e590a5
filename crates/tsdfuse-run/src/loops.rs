//! Loops of a log's trajectory: placed scans go in, and corrections come out.

use std::collections::HashMap;
use std::time::Instant;

use serde::{Deserialize, Serialize};
use tsdfuse::glam::DVec3;
use tsdfuse::{ImuSample, Pose, Scan};
use tsdfuse_io::{GnssFix, Log, g2o};
use tsdfuse_loops::{Anchoring, Closer, Closure, Fix, LoopConfig};
use tsdfuse_odometry::Quality;

use crate::error::Result;

/// What a GNSS receiver is off that does not tell it, metres (standard deviation): along both horizontal axes, and vertically.
const USUAL_SIGMA_M: (f64, f64) = (3.0, 6.0);

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
    /// What GNSS and gravity told, if the log has either.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchoring: Option<Anchoring>,
    /// Latitude, longitude (degrees, WGS 84) and height (metres; 0 if it is not known) of the first fix, the origin of the fixes' world (east, north, up).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixes_origin: Option<[f64; 3]>,
}

/// Scans of a log on their way to corrections.
pub(crate) struct Loops {
    closer: Closer,
    /// Their numbers in the log.
    indices: Vec<usize>,
    /// The first GNSS fix.
    origin: Option<GnssFix>,
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
    /// Of a log, whose GNSS and IMU tell about its trajectory, too.
    ///
    /// # Errors
    /// If these cannot be read.
    pub(crate) fn of(log: &Log, config: LoopConfig) -> Result<Self> {
        let mut closer = Closer::new(config);
        let sensor_from_body = log
            .sensors()
            .first()
            .map_or(Pose::IDENTITY, |sensor| sensor.body_from_sensor.inverse());
        let fixes = if config.gnss { log.gnss()? } else { Vec::new() };
        let origin = fixes.first().copied();
        if let Some(origin) = &origin {
            let (flat, up) = USUAL_SIGMA_M;
            closer.push_fixes(fixes.iter().map(|fix| {
                let sigma_m = fix.sigma_m.map_or(DVec3::new(flat, flat, up), DVec3::from_array);
                let is_height_known = fix.altitude_m.is_some() && origin.altitude_m.is_some();
                Fix {
                    time_ns: fix.time_ns,
                    place: fix.seen_from(origin),
                    sigma_m: if is_height_known {
                        sigma_m
                    } else {
                        sigma_m.with_z(f64::INFINITY)
                    },
                    antenna: sensor_from_body.transform_point(DVec3::from_array(fix.antenna_m)),
                }
            }));
        }
        if config.gravity {
            closer.push_imu(log.imu()?.into_iter().map(|sample| ImuSample {
                acceleration: sensor_from_body.rotation * sample.acceleration,
                ..sample
            }));
        }
        Ok(Self {
            closer,
            indices: Vec::new(),
            origin,
            seconds: 0.0,
        })
    }

    /// Takes the next scan, which is placed; whether that closed a loop.
    pub(crate) fn push(&mut self, index: usize, scan: &Scan, quality: &Quality) -> bool {
        let start = Instant::now();
        let closed = self.closer.push(scan, quality);
        self.indices.push(index);
        self.seconds += start.elapsed().as_secs_f64();
        closed > 0
    }

    /// Where the sensor was when it came by first and when it came back, for each closure so far, by the poses that scans were placed with.
    pub(crate) fn ends(&self) -> Vec<[DVec3; 2]> {
        let closer = &self.closer;
        let place = |scan| (closer.correction(scan).inverse() * closer.pose(scan)).translation;
        let closures = closer.closures().iter();
        closures.map(|c| [place(c.earlier), place(c.later)]).collect()
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
                anchoring: closer.anchoring().copied(),
                fixes_origin: self
                    .origin
                    .map(|fix| [fix.latitude_deg, fix.longitude_deg, fix.altitude_m.unwrap_or(0.0)]),
            },
            graph: graph(closer, indices),
        }
    }
}

impl Corrections {
    /// Whether neither loops nor fixes nor gravity move the trajectory.
    pub(crate) fn move_nothing(&self) -> bool {
        let anchoring = self.report.anchoring.as_ref();
        self.report.closures.is_empty() && anchoring.is_none_or(|anchoring| anchoring.drift_share.is_none())
    }

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
