//! A map, prepared for views.

use rayon::prelude::*;

use super::field::Field;
use super::tree::Beam;
use super::walk::Ray;
use super::{Camera, RenderConfig, RenderError, View};
use crate::index::BlockIndex;
use crate::{Pose, VoxelMap};

/// Rows and columns of the tiles of pixels that cross empty space together.
const TILE: [usize; 2] = [4, 8];

/// A map, prepared for any number of views.
#[derive(Debug)]
pub struct Renderer<'a> {
    pub(super) map: &'a VoxelMap,
    pub(super) config: RenderConfig,
    pub(super) field: Field<'a>,
}

impl<'a> Renderer<'a> {
    /// Finds the surface; this takes as long as one or two views.
    ///
    /// # Errors
    /// [`RenderError`] for an invalid configuration, and for a map as wide as the Earth.
    pub fn new(map: &'a VoxelMap, config: &RenderConfig) -> Result<Self, RenderError> {
        config.validate()?;
        Ok(Self {
            map,
            config: *config,
            field: Field::new(map, config.min_weight)?,
        })
    }

    /// What a camera sees from a pose (`world_from_camera`; sensor frame: x forward, y left, z up).
    ///
    /// # Errors
    /// [`RenderError`] for an invalid camera or pose, and for a camera outside the grid.
    pub fn view(&self, camera: &Camera, world_from_camera: Pose) -> Result<View, RenderError> {
        camera.check()?;
        let Pose { rotation, translation } = Pose::new(world_from_camera.rotation, world_from_camera.translation)?;
        let (width, height) = camera.size();
        let mut view = View::empty(width, height);
        let anchor = self.map.grid().anchor(translation).map(|anchor| anchor.split());
        let Some((base, fraction)) = anchor.filter(|(base, _)| self.field.reaches(*base)) else {
            return Err(RenderError::Outside(translation.to_array()));
        };
        let max_range_m = f64::from(self.config.max_range_m.min(camera.max_range_m()));
        let rays = camera.rays();
        let ray = |column: usize, row: usize| {
            let (direction, depth_per_range) = rays.of(column, row);
            Ray {
                base,
                // Cells begin at the centres of voxels.
                origin: fraction - 0.5,
                direction: rotation * direction,
                start: 0.0,
                length: max_range_m / self.map.config().voxel_size_m,
                depth_per_range,
            }
        };
        let bands = view.hits.par_chunks_mut(TILE[0] * width).enumerate();
        bands.for_each(|(band, hits)| {
            let mut tile: Vec<Ray> = Vec::with_capacity(TILE[0] * TILE[1]);
            for first in (0..width).step_by(TILE[1]) {
                let columns = first..width.min(first + TILE[1]);
                let rows = 0..hits.len() / width;
                let pixels = rows.flat_map(|row| columns.clone().map(move |column| row * width + column));
                tile.clear();
                tile.extend(pixels.clone().map(|p| ray(p % width, TILE[0] * band + p / width)));
                let beam = Beam::about(base, fraction - 0.5, tile.iter().map(|ray| ray.direction));
                let start = beam.map_or(0.0, |beam| self.field.clear_length(&beam));
                for (pixel, ray) in pixels.zip(&tile).filter(|(_, ray)| start < ray.length) {
                    hits[pixel] = self.field.meet(&Ray { start, ..*ray });
                }
            }
        });
        Ok(view)
    }

    /// What several cameras see, each from its pose.
    ///
    /// # Errors
    /// See [`Renderer::view`].
    pub fn views(&self, cameras: &[(Camera, Pose)]) -> Result<Vec<View>, RenderError> {
        cameras.iter().map(|(camera, pose)| self.view(camera, *pose)).collect()
    }

    /// The blocks that the surface passes, sorted.
    pub fn surface_blocks(&self) -> impl ExactSizeIterator<Item = BlockIndex> {
        self.field.blocks()
    }

    /// The same blocks, each with how much surface is in it: voxels that it passes.
    pub(super) fn surface(&self) -> impl Iterator<Item = (BlockIndex, u32)> {
        self.field.cells()
    }

    /// The map.
    pub fn map(&self) -> &'a VoxelMap {
        self.map
    }
}

/// What a camera sees of a map from a pose (`world_from_camera`); for several views, see [`Renderer`].
///
/// # Errors
/// See [`Renderer::new`] and [`Renderer::view`].
pub fn render(
    map: &VoxelMap,
    camera: &Camera,
    world_from_camera: Pose,
    config: &RenderConfig,
) -> Result<View, RenderError> {
    Renderer::new(map, config)?.view(camera, world_from_camera)
}
