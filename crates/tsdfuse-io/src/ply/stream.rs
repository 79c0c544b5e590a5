//! Writes a mesh that comes in parts and is never in memory as a whole.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, Write};
use std::path::{Path, PathBuf};

use tsdfuse::glam::{DVec3, Vec3};

use super::write::{Layout, in_chunks, is_far, triangle};
use crate::atomic::{self, Temporary};
use crate::error::{Error, Result};

/// Bytes of a waiting vertex: three doubles, three floats.
const VERTEX: usize = 36;

/// A mesh that is being written. Its parts wait in hidden files beside the final one, which [`Stream::finish`] puts together.
#[derive(Debug)]
pub struct Stream {
    path: PathBuf,
    vertices: Waiting,
    triangles: Waiting,
    double: bool,
}

/// The vertices or the triangles that wait.
#[derive(Debug)]
struct Waiting {
    count: u64,
    file: BufWriter<File>,
    _name: Temporary,
}

impl Waiting {
    fn beside(path: &Path) -> io::Result<Self> {
        let (name, file) = Temporary::create(path)?;
        Ok(Self {
            count: 0,
            file: BufWriter::with_capacity(1 << 18, file),
            _name: name,
        })
    }

    /// All of it, from the start.
    fn read(&mut self) -> io::Result<BufReader<&File>> {
        self.file.flush()?;
        self.file.get_mut().rewind()?;
        Ok(BufReader::with_capacity(1 << 18, self.file.get_ref()))
    }
}

impl Stream {
    /// Begins a mesh with normals; the file appears with [`Self::finish`].
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn new(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let waiting = || Waiting::beside(path).map_err(Error::io(path));
        Ok(Self {
            path: path.to_owned(),
            vertices: waiting()?,
            triangles: waiting()?,
            double: false,
        })
    }

    /// Adds vertices, each with its normal.
    ///
    /// # Errors
    /// What the system says.
    pub fn vertices(&mut self, positions: &[DVec3], normals: &[Vec3]) -> io::Result<()> {
        self.double |= positions.iter().any(|v| is_far(*v));
        let layout = Layout {
            double: true,
            normals: true,
            colors: false,
        };
        let count = positions.len().min(normals.len());
        self.vertices.count += count as u64;
        in_chunks(&mut self.vertices.file, count, |i, bytes| {
            layout.vertex(positions[i], normals.get(i), bytes);
        })
    }

    /// Adds triangles. Vertices are numbered in the order in which they were added, through all parts.
    ///
    /// # Errors
    /// What the system says.
    pub fn triangles(&mut self, triangles: &[[u32; 3]]) -> io::Result<()> {
        self.triangles.count += triangles.len() as u64;
        in_chunks(&mut self.triangles.file, triangles.len(), |i, bytes| {
            triangle(triangles[i], bytes);
        })
    }

    /// How many vertices and triangles there are so far.
    pub fn counts(&self) -> (u64, u64) {
        (self.vertices.count, self.triangles.count)
    }

    /// Writes the file, which appears when it is complete.
    ///
    /// # Errors
    /// Names the file and what the system says.
    pub fn finish(mut self) -> Result<()> {
        let layout = Layout {
            double: self.double,
            normals: true,
            colors: false,
        };
        let (vertices, triangles) = self.counts();
        let path = self.path.clone();
        atomic::write(path, |out| {
            layout.header(out, vertices, Some(triangles))?;
            let mut waiting = self.vertices.read()?;
            if self.double {
                io::copy(&mut waiting, out)?;
            } else {
                let mut bytes = Vec::with_capacity(VERTEX);
                for _ in 0..vertices {
                    bytes.clear();
                    let (position, normal) = vertex(&mut waiting)?;
                    layout.vertex(position, Some(&normal), &mut bytes);
                    out.write_all(&bytes)?;
                }
            }
            io::copy(&mut self.triangles.read()?, out).map(drop)
        })
    }
}

fn vertex(bytes: &mut impl Read) -> io::Result<(DVec3, Vec3)> {
    let mut vertex = [0; VERTEX];
    bytes.read_exact(&mut vertex)?;
    let (doubles, _) = vertex[..24].as_chunks::<8>();
    let (floats, _) = vertex[24..].as_chunks::<4>();
    let position = DVec3::from_array(std::array::from_fn(|k| f64::from_le_bytes(doubles[k])));
    Ok((
        position,
        Vec3::from_array(std::array::from_fn(|k| f32::from_le_bytes(floats[k]))),
    ))
}

#[cfg(test)]
mod tests {
    use tsdfuse::Mesh;

    use super::*;

    #[test]
    fn a_mesh_in_parts_is_the_file_of_the_whole() {
        let dir = tempfile::tempdir().unwrap();
        for (name, far) in [("near.ply", 0.0), ("far.ply", 5e6)] {
            let path = dir.path().join(name);
            let place = |i: u32| DVec3::new(far, 0.1, 0.25) * f64::from(i);
            let mesh = Mesh {
                vertices: (0..1000).map(place).collect(),
                normals: (0..1000).map(|i| Vec3::Y * i as f32).collect(),
                triangles: (0..998).map(|i| [i, i + 1, i + 2]).collect(),
            };
            let mut stream = Stream::new(&path).unwrap();
            for part in [0..1, 1..400, 400..400, 400..1000] {
                stream
                    .vertices(&mesh.vertices[part.clone()], &mesh.normals[part.clone()])
                    .unwrap();
                let triangles = mesh
                    .triangles
                    .iter()
                    .filter(|t| part.contains(&(t[2] as usize)))
                    .copied();
                stream.triangles(&triangles.collect::<Vec<_>>()).unwrap();
            }
            assert!(!path.exists());
            assert_eq!(stream.counts(), (1000, 998));
            stream.finish().unwrap();
            let mut whole = Vec::new();
            super::super::write_to(&mut whole, &mesh).unwrap();
            assert!(std::fs::read(&path).unwrap() == whole, "{name}");
        }
        // One that is not finished leaves nothing behind.
        drop(Stream::new(dir.path().join("none.ply")).unwrap());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2);
    }
}
