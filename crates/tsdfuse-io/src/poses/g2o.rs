//! Pose graphs as g2o and most programs for simultaneous localisation and mapping write them: of each vertex its number and its pose.

use std::path::Path;

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};

use super::Poses;
use crate::error::{Error, Result};
use crate::text::{self, Line};

/// What a line of a pose graph may begin with.
const WORDS: [&str; 2] = ["VERTEX_", "EDGE_"];

/// Whether the first line that holds something is one of a pose graph.
pub(super) fn recognises(bytes: &[u8]) -> bool {
    let mut lines = bytes.split(|b| *b == b'\n').map(<[u8]>::trim_ascii);
    let first = lines.find(|line| !line.is_empty() && !line.starts_with(b"#"));
    first.is_some_and(|line| WORDS.iter().any(|word| line.starts_with(word.as_bytes())))
}

/// The poses of the vertices, in the order of their numbers.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Poses> {
    let mut vertices: Vec<(u64, Pose)> = Vec::new();
    for line in text::lines(path, bytes)? {
        let pose: fn(&[f64]) -> Option<Pose> = match line.words().next() {
            Some("VERTEX_SE3:QUAT") => space,
            Some("VERTEX_SE2") => plane,
            _ => continue,
        };
        vertices.push(vertex(&line, pose)?);
    }
    vertices.sort_by_key(|(number, _)| *number);
    if let Some([(number, _), _]) = vertices.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        return Err(Error::format(path, format!("has vertex {number} twice")));
    }
    if vertices.is_empty() {
        return Err(Error::format(
            path,
            "holds no poses: it has no VERTEX_SE3:QUAT and no VERTEX_SE2",
        ));
    }
    Ok(Poses::Listed(vertices.into_iter().map(|(_, pose)| pose).collect()))
}

fn vertex(line: &Line, pose: fn(&[f64]) -> Option<Pose>) -> Result<(u64, Pose)> {
    let number = line.words().nth(1).and_then(|word| word.parse().ok());
    let number = number.ok_or_else(|| line.error("a vertex has a number"))?;
    let numbers: Option<Vec<f64>> = line.words().skip(2).map(|word| word.parse().ok()).collect();
    let pose = numbers.and_then(|numbers| pose(&numbers));
    Ok((number, pose.ok_or_else(|| line.error("these numbers are no pose"))?))
}

fn space(numbers: &[f64]) -> Option<Pose> {
    let &[x, y, z, qx, qy, qz, qw] = numbers else {
        return None;
    };
    Pose::new(DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(x, y, z)).ok()
}

fn plane(numbers: &[f64]) -> Option<Pose> {
    let &[x, y, yaw] = numbers else { return None };
    Pose::new(DQuat::from_rotation_z(yaw), DVec3::new(x, y, 0.0)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Pose>, String> {
        match super::super::parse(Path::new("a.g2o"), text.as_bytes()).map_err(|e| e.to_string())? {
            Poses::Listed(poses) => Ok(poses),
            Poses::Timed(_) => panic!("a pose graph has no times"),
        }
    }

    #[test]
    fn vertices_are_poses_in_the_order_of_their_numbers() {
        let poses = read(
            "# a graph\nVERTEX_SE3:QUAT 7 1 2 3 0 0 0.6 0.8\nFIX 7\nVERTEX_SE3:QUAT 2 0 0 1 0 0 0 1\n\
             EDGE_SE3:QUAT 2 7 1 2 2 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\nVERTEX_SE2 9 4 5 1.5\n",
        )
        .unwrap();
        let at: Vec<_> = poses.iter().map(|pose| pose.translation.to_array()).collect();
        assert_eq!(at, [[0.0, 0.0, 1.0], [1.0, 2.0, 3.0], [4.0, 5.0, 0.0]]);
        assert!((poses[2].rotation.to_scaled_axis().z - 1.5).abs() < 1e-12);
    }

    #[test]
    fn damage_is_named() {
        for (text, wanted) in [
            ("VERTEX_SE3:QUAT x 1 2 3 0 0 0 1", "line 1: a vertex has a number"),
            ("VERTEX_SE3:QUAT 1 1 2 3 0 0 0", "line 1: these numbers are no pose"),
            ("VERTEX_SE3:QUAT 1 1 2 3 0 0 0 0", "line 1: these numbers are no pose"),
            ("VERTEX_SE2 1 1 2 x", "line 1: these numbers are no pose"),
            ("VERTEX_SE2 1 1 2 3\nVERTEX_SE2 1 1 2 3", "has vertex 1 twice"),
            ("EDGE_SE2 1 2 3", "holds no poses"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.contains(wanted), "{message}");
        }
    }
}
