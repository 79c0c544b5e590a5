//! What is known of a surface beside its place, as it lies beside a saved map.

use std::path::Path;

use rayon::prelude::*;
use tsdfuse::glam::DVec3;
use tsdfuse::{MapConfig, Mesh};
use tsdfuse_view::Paint;

use crate::error::Result;
use crate::intensity::{self, Intensity};
use crate::layer::{Layer, path_beside};
use crate::paint::{Painted, UNSEEN, linear, srgb};

/// What is known of the vertices of a mesh.
#[derive(Clone, Debug, Default)]
pub struct Painting {
    /// Their colours.
    pub colors: Option<Painted>,
    /// Their intensities.
    pub intensities: Option<Vec<f32>>,
}

impl Painting {
    /// The mesh with all of that, for pages and views.
    pub fn with<T>(&self, mesh: &Mesh, show: impl FnOnce(&tsdfuse_view::Surface<'_>) -> T) -> T {
        let channels = self.intensities.iter();
        let channels: Vec<_> = channels
            .map(|values| (intensity::channel(values), values.as_slice()))
            .collect();
        let colors = self.colors.as_ref().map(|painted| painted.colors.as_slice());
        let paint = Paint {
            colors: colors.unwrap_or_default(),
            channels: &channels,
        };
        show(&tsdfuse_view::Surface { mesh, paint })
    }
}

/// The layers of red, green and blue light, linear: f = 2v − 1 of a share v of white.
#[derive(Debug)]
pub struct Colors([Layer; 3]);

/// Their names.
const COLORS: [&str; 3] = ["red", "green", "blue"];

impl Colors {
    /// Layers without observations beside a map.
    ///
    /// # Errors
    /// As [`VoxelMap::new`](tsdfuse::VoxelMap::new).
    pub fn beside(map: &MapConfig) -> Result<Self> {
        Ok(Self([Layer::beside(map)?, Layer::beside(map)?, Layer::beside(map)?]))
    }

    /// Reads the layers beside a saved map, if they are there.
    ///
    /// # Errors
    /// As [`Intensity::read`].
    pub fn read_beside(map: &Path) -> Result<Option<Self>> {
        let paths = COLORS.map(|name| path_beside(map, name));
        if !paths.iter().all(|path| path.is_file()) {
            return Ok(None);
        }
        let [red, green, blue] = &paths;
        Ok(Some(Self([Layer::read(red)?, Layer::read(green)?, Layer::read(blue)?])))
    }

    /// Saves the layers beside a saved map.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn save_beside(&self, map: &Path) -> Result<()> {
        let mut layers = COLORS.iter().zip(&self.0);
        layers.try_for_each(|(name, layer)| layer.save(&path_beside(map, name)))
    }

    /// Adds the colours of a mesh where images saw it.
    ///
    /// # Errors
    /// [`RunError::Full`](crate::RunError::Full) if there is no memory for them.
    pub fn add(&mut self, mesh: &Mesh, painted: &Painted) -> Result<()> {
        for (channel, layer) in self.0.iter_mut().enumerate() {
            let seen = mesh
                .vertices
                .iter()
                .zip(&painted.colors)
                .filter(|(_, color)| **color != UNSEEN);
            layer.add(seen.map(|(vertex, color)| (*vertex, 2.0 * linear(f32::from(color[channel])) - 1.0, 1.0)))?;
        }
        Ok(())
    }

    /// The colour around a point (world), sRGB; `None` where no image saw it.
    pub fn at(&self, point: DVec3) -> Option<[u8; 3]> {
        let [red, green, blue] = self.0.each_ref().map(|layer| layer.at(point));
        Some([red?, green?, blue?].map(|f| srgb(0.5 + 0.5 * f)))
    }

    /// The colour of each vertex.
    pub fn of_vertices(&self, mesh: &Mesh) -> Painted {
        let found: Vec<Option<[u8; 3]>> = mesh.vertices.par_iter().map(|vertex| self.at(*vertex)).collect();
        Painted {
            seen: found.iter().flatten().count(),
            colors: found.into_iter().map(|color| color.unwrap_or(UNSEEN)).collect(),
            ..Painted::default()
        }
    }
}

/// All layers that are known.
#[derive(Debug, Default)]
pub struct Layers {
    /// Colours.
    pub colors: Option<Colors>,
    /// Intensities.
    pub intensity: Option<Intensity>,
}

impl Layers {
    /// Reads those that lie beside a saved map.
    ///
    /// # Errors
    /// As [`Intensity::read`].
    pub fn read_beside(map: &Path) -> Result<Self> {
        let path = Intensity::path_beside(map);
        Ok(Self {
            colors: Colors::read_beside(map)?,
            intensity: path.is_file().then(|| Intensity::read(&path)).transpose()?,
        })
    }

    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.colors.is_none() && self.intensity.is_none()
    }

    /// What they tell of the vertices of a mesh.
    pub fn painting(&self, mesh: &Mesh) -> Painting {
        Painting {
            colors: self.colors.as_ref().map(|colors| colors.of_vertices(mesh)),
            intensities: self.intensity.as_ref().map(|layer| layer.of_vertices(mesh)),
        }
    }

    /// What gives each vertex of a mesh a colour, for formats that have nothing else: what cameras saw, or else intensities as greys, the
    /// same greys for all parts of a surface.
    pub fn vertex_coloring(&self) -> impl Fn(&Mesh) -> Vec<[u8; 3]> + Sync {
        let white = self.intensity.as_ref().map_or(1.0, Intensity::white);
        move |mesh| match (&self.colors, &self.intensity) {
            (Some(colors), _) => colors.of_vertices(mesh).colors,
            (None, Some(layer)) => {
                let grey = |value: f32| intensity::grey(value, white);
                layer.of_vertices(mesh).into_iter().map(grey).collect()
            }
            (None, None) => vec![UNSEEN; mesh.vertices.len()],
        }
    }
}

/// Gaps of intensities are filled, those of colours are not: what no camera saw is grey.
impl Intensity {
    /// The intensity of each vertex, in the sensor's unit. Where nothing was measured, that of the vertices around; 0 if there is none.
    pub fn of_vertices(&self, mesh: &Mesh) -> Vec<f32> {
        let decode = |f: f32| if f.is_nan() { 0.0 } else { intensity::decode(f) };
        self.layer().of_vertices(mesh).into_iter().map(decode).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::glam::Vec3;

    #[test]
    fn colours_are_saved_beside_a_map_and_found_again() {
        let vertices: Vec<DVec3> = (0..400)
            .map(|i| DVec3::new(0.05 * f64::from(i % 20), 0.05 * f64::from(i / 20), 1.0))
            .collect();
        let mesh = Mesh {
            normals: vec![Vec3::Z; vertices.len()],
            vertices,
            triangles: Vec::new(),
        };
        let color = |vertex: &DVec3| if vertex.x < 0.48 { [200, 30, 40] } else { [10, 90, 250] };
        let mut painted = Painted {
            colors: mesh.vertices.iter().map(color).collect(),
            ..Painted::default()
        };
        painted.colors[0] = UNSEEN;
        let mut colors = Colors::beside(&MapConfig::default()).unwrap();
        colors.add(&mesh, &painted).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let map = dir.path().join("street.tsdf");
        assert!(Layers::read_beside(&map).unwrap().is_empty());
        colors.save_beside(&map).unwrap();
        let read = Layers::read_beside(&map).unwrap();
        let found = read.painting(&mesh).colors.unwrap();
        assert!(found.seen >= 399, "{}", found.seen);
        for (vertex, found) in mesh.vertices.iter().zip(&found.colors).skip(1) {
            if (vertex.x - 0.48).abs() > 0.1 {
                let off = color(vertex).iter().zip(found).map(|(a, b)| a.abs_diff(*b)).max();
                assert!(off <= Some(2), "{vertex} {found:?}");
            }
        }
        assert_eq!(read.vertex_coloring()(&mesh), found.colors);
        assert_eq!(read.colors.unwrap().at(DVec3::splat(9.0)), None);
    }
}
