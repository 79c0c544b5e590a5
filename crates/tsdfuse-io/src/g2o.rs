//! Pose graphs as g2o text (Kümmerle et al., ICRA 2011): the 3-D poses in it, and what was measured between them.
//!
//! `VERTEX_SE3:QUAT id x y z qx qy qz qw` is a pose, `EDGE_SE3:QUAT id id x y z qx qy qz qw` with the 21 numbers of the upper triangle of an
//! information matrix a measurement. `FIX` is skipped; other tags are an error, for a graph without them would be another one. Where only
//! poses are wanted ([`poses::read`](crate::poses::read)), measurements are passed over, and `VERTEX_SE2 id x y yaw` is a pose, too.

use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};

use crate::atomic;
use crate::error::{Error, Result};
use crate::files;
use crate::text::{self, Line};

/// A pose graph.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Graph {
    /// Number and `world_from_node`.
    pub nodes: Vec<(u64, Pose)>,
    /// What was measured.
    pub edges: Vec<Edge>,
}

impl Graph {
    /// The ends (`world_from_node`) of measurements between nodes of which none follows the other: the loops that were closed.
    pub fn closures(&self) -> impl Iterator<Item = [Pose; 2]> {
        let place: HashMap<u64, usize> = self.nodes.iter().enumerate().map(|(n, (id, _))| (*id, n)).collect();
        self.edges.iter().filter_map(move |edge| {
            let (from, to) = (*place.get(&edge.from)?, *place.get(&edge.to)?);
            (from.abs_diff(to) > 1).then(|| [self.nodes[from].1, self.nodes[to].1])
        })
    }
}

/// A measurement between two nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// Number of the node from which it was measured.
    pub from: u64,
    /// Number of the node that was measured.
    pub to: u64,
    /// `from_from_to`.
    pub measured: Pose,
    /// The upper triangle, row by row, of the information of shift (metres) and turn, along and about the axes of `to`. What unit a turn
    /// has is not agreed upon: radians here and in GTSAM, half of that (the imaginary part of the quaternion) in g2o itself.
    pub information: [f64; 21],
}

/// Reads a file.
///
/// # Errors
/// Names the file, the line and the reason.
pub fn read(path: impl AsRef<Path>) -> Result<Graph> {
    let path = path.as_ref();
    parse(path, &files::read(path)?)
}

/// Parses the content of a file; `path` is for messages.
///
/// # Errors
/// Names the file, the line and the reason.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Graph> {
    let mut graph = Graph::default();
    for line in text::lines(path, bytes)? {
        let words: Vec<&str> = line.words().collect();
        match words.as_slice() {
            ["VERTEX_SE3:QUAT", id, rest @ ..] => graph.nodes.push((number(&line, id)?, in_space(&line, rest)?)),
            ["EDGE_SE3:QUAT", from, to, rest @ ..] if rest.len() == 28 => {
                let values: Vec<f64> = numbers(&line, rest)?;
                let information = values[7..].try_into().unwrap_or([0.0; 21]);
                if !information.iter().all(|v| v.is_finite()) {
                    return Err(line.error("the information holds a number that is not finite"));
                }
                graph.edges.push(Edge {
                    from: number(&line, from)?,
                    to: number(&line, to)?,
                    measured: pose(&line, &values[..7])?,
                    information,
                });
            }
            [tag @ "EDGE_SE3:QUAT", rest @ ..] => {
                return Err(line.error(format!("{} numbers where {tag} has 30", rest.len())));
            }
            ["FIX", ..] => {}
            [tag, ..] => return Err(line.error(format!("{tag:?} is no pose in space and no measurement between two"))),
            [] => {}
        }
    }
    if graph.nodes.is_empty() {
        return Err(Error::format(path, "holds no poses"));
    }
    Ok(graph)
}

/// Whether the first line that holds something is one of a pose graph.
pub(crate) fn recognises(bytes: &[u8]) -> bool {
    let mut lines = bytes.split(|b| *b == b'\n').map(<[u8]>::trim_ascii);
    let first = lines.find(|line| !line.is_empty() && !line.starts_with(b"#"));
    first.is_some_and(|line| [&b"VERTEX_"[..], b"EDGE_"].iter().any(|word| line.starts_with(word)))
}

/// The poses of a graph, in space or in a plane, in the order of their numbers.
///
/// # Errors
/// Names the file, the line and the reason.
pub(crate) fn poses(path: &Path, bytes: &[u8]) -> Result<Vec<Pose>> {
    let mut nodes: Vec<(u64, Pose)> = Vec::new();
    for line in text::lines(path, bytes)? {
        let words: Vec<&str> = line.words().collect();
        match words.as_slice() {
            ["VERTEX_SE3:QUAT", id, rest @ ..] => nodes.push((number(&line, id)?, in_space(&line, rest)?)),
            ["VERTEX_SE2", id, rest @ ..] => nodes.push((number(&line, id)?, in_plane(&line, rest)?)),
            _ => {}
        }
    }
    nodes.sort_by_key(|(id, _)| *id);
    if let Some([(id, _), _]) = nodes.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        return Err(Error::format(path, format!("has pose {id} twice")));
    }
    if nodes.is_empty() {
        let reason = "holds no poses: it has no VERTEX_SE3:QUAT and no VERTEX_SE2";
        return Err(Error::format(path, reason));
    }
    Ok(nodes.into_iter().map(|(_, pose)| pose).collect())
}

fn in_space(line: &Line, words: &[&str]) -> Result<Pose> {
    if words.len() != 7 {
        return Err(line.error(format!("{} numbers where VERTEX_SE3:QUAT has 8", words.len() + 1)));
    }
    pose(line, &numbers(line, words)?)
}

fn in_plane(line: &Line, words: &[&str]) -> Result<Pose> {
    let &[x, y, yaw] = numbers(line, words)?.as_slice() else {
        return Err(line.error(format!("{} numbers where VERTEX_SE2 has 4", words.len() + 1)));
    };
    Pose::new(DQuat::from_rotation_z(yaw), DVec3::new(x, y, 0.0)).map_err(|e| line.error(e))
}

fn number(line: &Line, word: &str) -> Result<u64> {
    word.parse()
        .map_err(|_| line.error(format!("{word:?} is not the number of a pose")))
}

fn numbers(line: &Line, words: &[&str]) -> Result<Vec<f64>> {
    let parse = |word: &&str| {
        word.parse()
            .map_err(|_| line.error(format!("{word:?} is not a number")))
    };
    words.iter().map(parse).collect()
}

fn pose(line: &Line, numbers: &[f64]) -> Result<Pose> {
    let &[x, y, z, qx, qy, qz, qw] = numbers else {
        return Err(line.error("a pose has 7 numbers"));
    };
    let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
    // Some programs print few digits.
    let rotation = if (rotation.length() - 1.0).abs() < 1e-2 {
        rotation.normalize()
    } else {
        rotation
    };
    Pose::new(rotation, DVec3::new(x, y, z)).map_err(|e| line.error(e))
}

/// Writes a file, which appears when it is complete.
///
/// # Errors
/// Names the file and what the system says.
pub fn write(path: impl AsRef<Path>, graph: &Graph) -> Result<()> {
    let joined = |pose: &Pose| {
        let (t, q) = (pose.translation, pose.rotation);
        format!("{} {} {} {} {} {} {}", t.x, t.y, t.z, q.x, q.y, q.z, q.w)
    };
    atomic::write(path.as_ref(), |out| {
        for (id, pose) in &graph.nodes {
            writeln!(out, "VERTEX_SE3:QUAT {id} {}", joined(pose))?;
        }
        for edge in &graph.edges {
            write!(
                out,
                "EDGE_SE3:QUAT {} {} {}",
                edge.from,
                edge.to,
                joined(&edge.measured)
            )?;
            edge.information.iter().try_for_each(|v| write!(out, " {v}"))?;
            writeln!(out)?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph() -> Graph {
        let pose = |x: f64| Pose {
            rotation: DQuat::from_rotation_z(0.1 * x),
            translation: DVec3::new(x, -2.0, 0.5),
        };
        Graph {
            nodes: vec![(3, pose(0.0)), (7, pose(1.0))],
            edges: vec![Edge {
                from: 3,
                to: 7,
                measured: pose(1.0),
                information: std::array::from_fn(|i| i as f64),
            }],
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("graph.g2o");
        write(&path, &graph()).unwrap();
        let back = read(&path).unwrap();
        assert_eq!(back.edges[0].information, graph().edges[0].information);
        for ((a, own), (b, want)) in back.nodes.iter().zip(&graph().nodes) {
            assert_eq!((a, own.translation), (b, want.translation));
            assert!(own.rotation.angle_between(want.rotation) < 1e-7);
        }
    }

    #[test]
    fn vertices_are_poses_in_the_order_of_their_numbers() {
        let text = "# a graph\nVERTEX_SE3:QUAT 7 1 2 3 0 0 0.6 0.8\nFIX 7\nVERTEX_SE3:QUAT 2 0 0 1 0 0 0 1\n\
             EDGE_SE3:QUAT 2 7 1 2 2 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\nVERTEX_SE2 9 4 5 1.5\n";
        assert!(recognises(text.as_bytes()) && !recognises(b"# a graph\n1 2 3"));
        let poses = poses(Path::new("a.g2o"), text.as_bytes()).unwrap();
        let at: Vec<_> = poses.iter().map(|pose| pose.translation.to_array()).collect();
        assert_eq!(at, [[0.0, 0.0, 1.0], [1.0, 2.0, 3.0], [4.0, 5.0, 0.0]]);
        assert!((poses[2].rotation.to_scaled_axis().z - 1.5).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_pose_is_named() {
        for (text, wanted) in [
            (
                "VERTEX_SE3:QUAT x 1 2 3 0 0 0 1",
                "line 1: \"x\" is not the number of a pose",
            ),
            (
                "VERTEX_SE3:QUAT 1 1 2 3 0 0 0",
                "line 1: 7 numbers where VERTEX_SE3:QUAT has 8",
            ),
            ("VERTEX_SE3:QUAT 1 1 2 3 0 0 0 0", "line 1: "),
            ("VERTEX_SE2 1 1 2 x", "line 1: \"x\" is not a number"),
            ("VERTEX_SE2 1 1 2", "line 1: 3 numbers where VERTEX_SE2 has 4"),
            ("VERTEX_SE2 1 1 2 3\nVERTEX_SE2 1 1 2 3", "has pose 1 twice"),
            ("EDGE_SE2 1 2 3", "holds no poses"),
        ] {
            let message = poses(Path::new("a.g2o"), text.as_bytes()).unwrap_err().to_string();
            assert!(message.contains(wanted), "{message}");
        }
    }

    #[test]
    fn what_is_no_graph_is_refused_with_its_line() {
        let of = |text: &str| parse(Path::new("x.g2o"), text.as_bytes()).unwrap_err().to_string();
        let vertex = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n";
        assert_eq!(of(""), "x.g2o: holds no poses");
        assert!(of(&format!("{vertex}VERTEX_SE3:QUAT 1 0 0")).contains("line 2: 3 numbers"));
        assert!(of(&format!("{vertex}VERTEX_SE2 1 0 0 0")).contains("line 2: \"VERTEX_SE2\""));
        assert!(of("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 3").contains("line 1"));
        assert!(of("VERTEX_SE3:QUAT x 0 0 0 0 0 0 1").contains("\"x\" is not the number of a pose"));
        let nan = format!("{vertex}EDGE_SE3:QUAT 0 0 0 0 0 0 0 0 1{}", " nan".repeat(21));
        assert!(of(&nan).contains("not finite"));
        assert!(parse(Path::new("x"), format!("{vertex}FIX 0\n").as_bytes()).is_ok());
    }
}
