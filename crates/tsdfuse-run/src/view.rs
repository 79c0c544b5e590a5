//! Pictures of a map.

use std::path::{Path, PathBuf};
use std::time::Instant;

use tsdfuse::glam::DVec3;
use tsdfuse::render::{Camera, ImageKind, RenderConfig, Renderer, View, overview};
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Pose, VoxelMap};

use crate::error::{Result, RunError};
use crate::report::ViewReport;

/// Looks through a camera from a pose (`world_from_camera`).
pub type Look<'a> = Box<dyn FnMut(&Camera, Pose) -> Result<View> + 'a>;

/// A map that is looked at: its surface, and the eye.
pub(crate) struct See<'a> {
    pub(crate) renderer: &'a Renderer<'a>,
    pub(crate) look: Look<'a>,
}

/// Finds the surface of a map, which must have some.
///
/// # Errors
/// [`RunError::Nothing`] for a map without surface.
pub fn renderer<'a>(map: &'a VoxelMap, config: &RenderConfig) -> Result<Renderer<'a>> {
    let renderer = Renderer::new(map, config)?;
    if renderer.surface_blocks().len() == 0 {
        return Err(RunError::Nothing(format!(
            "the map has no surface: {} blocks of voxels, but none that it passes at a weight of {} or more",
            map.block_count(),
            config.min_weight
        )));
    }
    Ok(renderer)
}

/// Lets the CPU look at a map.
pub(crate) fn on_cpu(map: &VoxelMap, min_weight: f32, look: &mut dyn FnMut(See<'_>) -> Result<()>) -> Result<()> {
    let config = RenderConfig {
        min_weight,
        ..Default::default()
    };
    let renderer = renderer(map, &config)?;
    look(See {
        renderer: &renderer,
        look: Box::new(|camera, pose| Ok(renderer.view(camera, pose)?)),
    })
}

/// Looks once, and writes pictures of what is seen.
///
/// # Errors
/// If a file cannot be written.
pub fn write(look: &mut Look<'_>, camera: &Camera, pose: Pose, files: &[(ImageKind, PathBuf)]) -> Result<ViewReport> {
    let start = Instant::now();
    let view = look(camera, pose)?;
    let seconds = start.elapsed().as_secs_f64();
    for (kind, path) in files {
        let image = match kind {
            ImageKind::Shaded => view.shaded(camera, pose),
            kind => view.image(*kind),
        };
        tsdfuse_io::png::write(path, &image)?;
    }
    Ok(ViewReport {
        pose: pose.to_row_major_3x4(),
        width: view.width,
        height: view.height,
        surface_pixels: view.hit_count(),
        files: files.iter().map(|(_, path)| path.clone()).collect(),
        seconds,
        write_seconds: start.elapsed().as_secs_f64() - seconds,
    })
}

/// The camera of previews.
pub fn preview_camera() -> Pinhole {
    Pinhole::with_fov(1280, 720, 60f32.to_radians())
}

/// Writes an overview of a map, of what lies around where the sensor was driven.
pub(crate) fn preview(see: See<'_>, driven: &[DVec3], path: &Path) -> Result<ViewReport> {
    let See { renderer, mut look } = see;
    let camera = preview_camera();
    let pose = overview(renderer, &camera, driven);
    let pose = pose.ok_or_else(|| RunError::Nothing("the map has no surface".to_owned()))?;
    let file = (ImageKind::Shaded, path.to_owned());
    write(&mut look, &Camera::Pinhole(camera), pose, &[file])
}
