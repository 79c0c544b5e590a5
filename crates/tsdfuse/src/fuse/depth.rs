//! Depth images (InfiniTAM, KinectFusion; thesis 5.1): the integrator for RGB-D cameras.
//!
//! Which voxels: those of all blocks that the line of sight of a pixel passes between the depths d − μ and d + μ, and of all
//! blocks that are there already and that the camera sees. What distance: with the voxel at X in the camera's frame and the
//! depth D of the pixel in which it is seen, η = D − X_depth (5.2), F = min(1, η/μ) where η ≥ −μ (5.3). What weight: 1.
//!
//! So whatever was in front of the surface before is averaged with free space, and disappears in time.
//!
//! Strong with dense images: no gaps, each voxel is written once a frame. Weak at grazing incidence, since η is measured along
//! the optical axis, and at depth edges, where a camera's pixels mix two surfaces. LiDAR has no such image: see [`super::Caminal`].

use std::time::Instant;

use fearless_simd::{Simd, dispatch, f32x8, prelude::*};
use glam::{Mat3, Vec3};

use super::{
    FuseError, Integration, Integrator,
    centers::{BLOCK_RADIUS, Centers, depths_at},
    engine::Skip,
    gather::{Gather, Near, ROW, Updates},
    pierced::Segment,
};
use crate::{
    index::{Anchor, BlockIndex},
    map::{MapConfig, OutOfMemory, VoxelMap},
    reach::Reach,
    scan::Scan,
    sensor::{DepthImage, Pinhole},
};

/// The integrator of depth images.
#[derive(Debug, Default)]
pub struct Depth {
    image: DepthImage,
    gather: Gather,
}

impl Integrator for Depth {
    /// Fuses a scan that has a [`Scan::camera`].
    fn integrate(&mut self, map: &mut VoxelMap, scan: &Scan) -> Result<Integration, FuseError> {
        let start = Instant::now();
        scan.check()?;
        let wrong = |reason: String| FuseError::Image {
            scan: scan.name.clone(),
            reason,
        };
        let camera = scan.camera.ok_or_else(|| {
            wrong(
                "is not the image of a depth camera, which this method needs; caminal makes one of LiDAR scans".into(),
            )
        })?;
        camera.check().map_err(|e| wrong(e.to_string()))?;
        let anchor = anchor(map, scan)?;
        self.image.render(&camera, &scan.points, |p| p);
        let (hidden, outside_image) = (self.image.hidden, self.image.outside);
        let views = [View::new(camera, world_axes(scan)?, std::mem::take(&mut self.image))];
        let prepare_secs = start.elapsed().as_secs_f64();
        let mut done = integrate(map, anchor, &views, &mut self.gather)?;
        (done.skipped.hidden, done.skipped.outside_image) = (hidden, outside_image);
        done.prepare_secs = prepare_secs;
        let [view] = views;
        self.image = view.image;
        Ok(done)
    }

    fn reach(&self, map: &MapConfig, scan: &Scan) -> Result<Reach, FuseError> {
        Ok(Reach::of(map, scan)?)
    }

    fn needs_sensor(&self) -> bool {
        false
    }
}

/// The scan's anchor in the map's grid.
pub(super) fn anchor(map: &VoxelMap, scan: &Scan) -> Result<Anchor, FuseError> {
    let position = scan.world_from_sensor()?.translation;
    map.grid().anchor(position).ok_or_else(|| FuseError::OutsideGrid {
        scan: scan.name.clone(),
        position,
    })
}

/// Turns the axes of the sensor at the scan's pose into those of the world.
pub(super) fn world_axes(scan: &Scan) -> Result<Mat3, FuseError> {
    Ok(glam::DMat3::from_quat(scan.world_from_sensor()?.rotation).as_mat3())
}

/// What a camera at the scan's anchor sees.
#[derive(Debug)]
pub(super) struct View {
    camera: Pinhole,
    world_from_camera: Mat3,
    pub(super) image: DepthImage,
    /// The farthest depth in the image.
    reach_m: f32,
    /// Normals of the planes through the borders of the image, towards the inside.
    borders: [Vec3; 4],
}

impl View {
    pub(super) fn new(camera: Pinhole, world_from_camera: Mat3, image: DepthImage) -> Self {
        let (u, v) = (camera.width as f32 - 0.5, camera.height as f32 - 0.5);
        let corners = [(-0.5, -0.5), (-0.5, v), (u, v), (u, -0.5)].map(|(u, v)| camera.ray(u, v));
        Self {
            camera,
            world_from_camera,
            reach_m: image.depths_m.iter().copied().fold(0.0, f32::max),
            image,
            borders: std::array::from_fn(|k| corners[(k + 1) % 4].cross(corners[k]).normalize()),
        }
    }

    /// The pixels that measured something.
    fn measured(&self) -> impl Iterator<Item = usize> {
        let depths = self.image.depths_m.iter().enumerate();
        depths.filter(|(_, depth)| **depth > 0.0).map(|(pixel, _)| pixel)
    }

    /// Names the blocks on the line of sight of a pixel. `last` are the two blocks of a line that was named before.
    #[inline(always)]
    fn allocate(
        &self,
        pixel: usize,
        anchor: &Anchor,
        truncation: [f32; 2],
        last: &mut Option<(BlockIndex, BlockIndex)>,
        near: &mut Near<()>,
    ) -> Result<(), Skip> {
        let depth = self.image.depths_m[pixel];
        let (row, column) = (pixel / self.camera.width as usize, pixel % self.camera.width as usize);
        let ray = self.world_from_camera * self.camera.ray(column as f32, row as f32);
        let length = ray.length();
        let [truncation_m, truncation_vox] = truncation;
        // All of it must lie within the grid.
        let low = anchor.locate(ray * (depth - truncation_m)).ok_or(Skip::OutsideGrid)?;
        let high = anchor.locate(ray * (depth + truncation_m)).ok_or(Skip::OutsideGrid)?;
        // Between two blocks that are one or that share a face lies no other one.
        let ends = (BlockIndex::of(low.voxel), BlockIndex::of(high.voxel));
        if (ends.1.0 - ends.0.0).abs().element_sum() <= 1 {
            if last.replace(ends) != Some(ends) {
                near.block(ends.0, 0, ());
                near.block(ends.1, 0, ());
            }
            return Ok(());
        }
        Segment {
            center: anchor.locate(ray * depth).ok_or(Skip::OutsideGrid)?,
            axis: ray / length,
            half_length: truncation_vox * length,
        }
        .for_each_block(|block| near.block(block, 0, ()));
        Ok(())
    }

    /// Whether part of a ball around a point of the camera's frame can be seen.
    fn sees(&self, center: Vec3, radius_m: f32, truncation_m: f32) -> bool {
        center.x <= self.reach_m + truncation_m + radius_m && self.borders.iter().all(|n| n.dot(center) >= -radius_m)
    }
}

/// Fuses what cameras at one place see; what comes back counts pixels.
pub(super) fn integrate(
    map: &mut VoxelMap,
    anchor: Anchor,
    views: &[View],
    gather: &mut Gather,
) -> Result<Integration, OutOfMemory> {
    let config = *map.config();
    let (voxel_size_m, truncation_m) = (config.voxel_size_m as f32, config.truncation_m as f32);
    let centers: Vec<Centers> = views
        .iter()
        .map(|view| Centers {
            anchor,
            origin: Vec3::ZERO,
            rotation: view.world_from_camera.transpose(),
            voxel_size_m,
        })
        .collect();
    let radius_m = BLOCK_RADIUS * voxel_size_m;
    let looking_at = |block: BlockIndex| {
        let seen =
            move |(view, centers): &(&View, &Centers)| view.sees(centers.of_block(block), radius_m, truncation_m);
        views.iter().zip(&centers).filter(seen)
    };
    let pixels: Vec<(&View, usize)> = views.iter().flat_map(|v| v.measured().map(move |p| (v, p))).collect();
    let level = gather.level();
    gather.run(
        map,
        pixels.len(),
        |range, near| {
            let mut last = None;
            dispatch!(level, _ => for (view, pixel) in &pixels[range] {
                let done = view.allocate(*pixel, &anchor, [truncation_m, config.truncation_vox()], &mut last, near);
                near.count(done);
            });
        },
        |block| looking_at(block).next().is_some(),
        |block, _, updates| {
            for (view, centers) in looking_at(block) {
                dispatch!(level, simd => view.update(simd, block, centers, truncation_m, updates));
            }
        },
    )
}

impl View {
    /// Updates the voxels of a block.
    #[inline(always)]
    fn update<S: Simd>(&self, simd: S, block: BlockIndex, centers: &Centers, truncation_m: f32, updates: &mut Updates) {
        centers.for_each_row(
            block,
            #[inline(always)]
            |first, [x, y, z]| {
                let mut seen = [[0.0; ROW]; 2];
                let [at_column, at_row] = &mut seen;
                for i in 0..ROW {
                    (at_column[i], at_row[i]) = self.camera.project(Vec3::new(x[i], y[i], z[i]));
                }
                let vector = |row: [f32; ROW]| f32x8::simd_from(simd, row);
                let (inside, pixels) = self.camera.pixels_at(vector(*at_column), vector(*at_row));
                if !inside.any_true() {
                    return;
                }
                let depth = depths_at(simd, &self.image.depths_m, pixels);
                let eta = depth - vector(*x); // (5.2)
                let inside = inside & depth.simd_gt(0.0) & eta.simd_ge(-truncation_m);
                let weight = f32x8::splat(simd, 1.0);
                updates.add_row(first / ROW, inside, eta / truncation_m, weight); // (5.3); the engine limits F to 1
            },
        );
    }
}
