//! Pictures of a map.

use std::path::{Path, PathBuf};
use std::time::Instant;

use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse::render::{Camera, Hit, Image, ImageKind, RenderConfig, Renderer, View, overview, viridis};
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Pose, VoxelMap};

use crate::error::{Result, RunError};
use crate::intensity::{self, Intensity};
use crate::layers::Colors;
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

/// What a picture shows.
#[derive(Clone, Copy, Debug)]
pub enum Picture<'a> {
    /// What is seen as such.
    Plain(ImageKind),
    /// Heights in the colours of "viridis": of what is seen, all but the lowest and the highest fiftieth.
    Height,
    /// Intensities as greys.
    Intensity(&'a Intensity),
    /// What cameras saw.
    Color(&'a Colors),
}

/// The colour of surface of which nothing is known.
const UNKNOWN: Vec3 = Vec3::new(0.36, 0.42, 0.52);

impl Picture<'_> {
    /// The picture of a view.
    pub fn of(&self, view: &View, camera: &Camera, pose: Pose) -> Image {
        let rays = camera.rays();
        let place = |pixel: usize, hit: &Hit| {
            let (direction, _) = rays.of(pixel % view.width, pixel / view.width);
            pose.translation + pose.rotation * direction * f64::from(hit.range_m)
        };
        let shown = |color: [u8; 3]| Vec3::from_array(color.map(f32::from)) / 255.0;
        match self {
            Self::Plain(ImageKind::Shaded) => view.shaded(camera, pose),
            Self::Plain(kind) => view.image(*kind),
            Self::Height => {
                let hits = view.hits.iter().enumerate();
                let mut heights: Vec<f64> = hits.filter_map(|(i, hit)| Some(place(i, hit.as_ref()?).z)).collect();
                heights.sort_unstable_by(f64::total_cmp);
                let at = |share: f64| {
                    heights
                        .get((share * heights.len() as f64) as usize)
                        .copied()
                        .unwrap_or_default()
                };
                let (low, high) = (at(0.02), at(0.98));
                let share = |z: f64| ((z - low) / (high - low).max(1e-3)).clamp(0.0, 1.0) as f32;
                view.lit(camera, pose, |i, hit| shown(viridis(share(place(i, hit).z))) * 1.15)
            }
            Self::Intensity(layer) => {
                let white = layer.white();
                let values = between_rings(view, |pixel, hit| layer.at(place(pixel, hit)));
                view.lit(camera, pose, |i, _| {
                    values[i].map_or(UNKNOWN, |value| shown(intensity::grey(value, white)) * 1.15)
                })
            }
            Self::Color(colors) => view.lit(camera, pose, |i, hit| {
                colors.at(place(i, hit)).map_or(UNKNOWN, |color| shown(color) * 1.15)
            }),
        }
    }
}

/// Pixels to which a known one gives its value, at most.
const FILL_PIXELS: usize = 24;
/// Neighbours whose ranges differ by more than this share are of other surface.
const SAME_SURFACE: f32 = 0.03;

/// The value of each pixel that sees surface; where none was measured there, the mean of those around it.
fn between_rings(view: &View, value: impl Fn(usize, &Hit) -> Option<f32>) -> Vec<Option<f32>> {
    let known = |(i, hit): (usize, &Option<Hit>)| value(i, hit.as_ref()?);
    let mut values: Vec<Option<f32>> = view.hits.iter().enumerate().map(known).collect();
    let width = view.width;
    for _ in 0..FILL_PIXELS {
        let before = values.clone();
        for (i, value) in values.iter_mut().enumerate().filter(|(_, value)| value.is_none()) {
            let Some(here) = &view.hits[i] else { continue };
            let column = i % width;
            let around = [
                (column > 0).then(|| i - 1),
                (column + 1 < width).then_some(i + 1),
                i.checked_sub(width),
                Some(i + width).filter(|below| *below < view.hits.len()),
            ];
            let near = around.into_iter().flatten().filter_map(|j| {
                let there = view.hits[j].as_ref()?;
                let is_same = (there.range_m - here.range_m).abs() < SAME_SURFACE * here.range_m;
                before[j].filter(|_| is_same)
            });
            let (sum, count) = near.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
            *value = (count > 0.0).then(|| sum / count);
        }
    }
    values
}

/// Looks once, and writes pictures of what is seen.
///
/// # Errors
/// If a file cannot be written.
pub fn write(look: &mut Look<'_>, camera: &Camera, pose: Pose, files: &[(Picture<'_>, PathBuf)]) -> Result<ViewReport> {
    let start = Instant::now();
    let view = look(camera, pose)?;
    let seconds = start.elapsed().as_secs_f64();
    for (picture, path) in files {
        tsdfuse_io::png::write(path, &picture.of(&view, camera, pose))?;
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
    let file = (Picture::Plain(ImageKind::Shaded), path.to_owned());
    write(&mut look, &Camera::Pinhole(camera), pose, &[file])
}
