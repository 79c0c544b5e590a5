//! What was seen, pixel by pixel.

use glam::Vec3;

/// The surface that a pixel sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance from the camera along the ray, metres.
    pub range_m: f32,
    /// Distance along the optical axis of a pinhole camera, metres; the range for a LiDAR.
    pub depth_m: f32,
    /// The surface's unit normal, world axes; it points to free space.
    pub normal: Vec3,
    /// Cosine of the angle between the normal and the way back to the camera.
    pub incidence_cos: f32,
    /// The weight W there, trilinear between the voxels.
    pub weight: f32,
}

/// What a camera sees of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// What each pixel sees, row by row from the top left; `None` where the ray meets no surface.
    pub hits: Vec<Option<Hit>>,
}

impl View {
    pub(super) fn empty(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            hits: vec![None; width * height],
        }
    }

    /// What a pixel sees; `None` also outside of the image.
    pub fn hit(&self, column: usize, row: usize) -> Option<&Hit> {
        let column = (column < self.width).then_some(column)?;
        self.hits.get(row * self.width + column)?.as_ref()
    }

    /// How many pixels see surface.
    pub fn hit_count(&self) -> usize {
        self.hits.iter().flatten().count()
    }
}
