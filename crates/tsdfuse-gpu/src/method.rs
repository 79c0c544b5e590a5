//! What a method sends to the device, and which kernels it uses there.

use std::borrow::Cow;

use rayon::prelude::*;
use tsdfuse::{
    Scan, SensorModel,
    fuse::{Beams, Cylindrical, Distance, FuseConfig, FuseError, Method, Skipped},
    glam::Vec3,
    normals::{Estimator, NormalsConfig},
    sensor::{DepthImage, NONE, Pinhole, ScanImage, rings_of},
};

use crate::device::GpuError;
use crate::frame::Frame;
use crate::shader::{DEPTH, EUCLIDEAN, FRAME, LINES, NORMALS, PROJECTIVE, RAYCAST};

/// The methods that run on the device.
pub const METHODS: [Method; 4] = [Method::Raycast, Method::Normals, Method::Cylindrical, Method::Depth];

/// What the CPU does for a method: what the very code of the CPU's method does, up to the returns' geometry.
#[derive(Debug)]
pub(crate) enum Prepare {
    /// The returns as they are.
    Raycast,
    /// Who is whose neighbour.
    Normals {
        config: NormalsConfig,
        beams: Beams,
        image: Box<ScanImage>,
    },
    /// The returns, rounded to pixels.
    Cylindrical(Box<Cylindrical>),
    /// The depth image.
    Depth(Box<DepthImage>),
}

/// The kernels of a method.
pub(crate) struct Kernels {
    /// Their source.
    pub(crate) parts: Vec<&'static str>,
    /// The one that makes blocks, a thread for each item.
    pub(crate) allocate: &'static str,
    /// The one that updates them.
    pub(crate) fuse: &'static str,
    /// Whether that has a workgroup for each block, not a thread for each item.
    pub(crate) by_block: bool,
}

impl Kernels {
    /// Those that walk along lines.
    fn lines(parts: &[&'static str]) -> Self {
        Self {
            // One kernel does both, so that both see the very same voxels.
            allocate: "fuse",
            fuse: "fuse",
            parts: [FRAME, LINES].iter().chain(parts).copied().collect(),
            by_block: false,
        }
    }
}

/// A scan as it is sent.
pub(crate) struct Prepared<'a> {
    pub(crate) scan: Cow<'a, Scan>,
    /// What was left out on the way.
    pub(crate) skipped: Skipped,
    /// The most that the scan can add to the weight of one voxel.
    pub(crate) weight: f32,
    /// Returns, or pixels.
    pub(crate) items: usize,
    image: Option<Image>,
    depth: Option<(Pinhole, &'a [f32])>,
}

/// An organized image as it is sent.
struct Image {
    /// The cell of each return, row by row, or [`NONE`].
    cell_of: Vec<u32>,
    /// The return in each cell, or [`NONE`].
    cells: Vec<u32>,
    rings: u32,
    columns: u32,
    max_range_m: f32,
    min_dot: f32,
}

impl Prepare {
    /// A method, and the sources of its kernels.
    ///
    /// # Errors
    /// [`GpuError::Unsupported`] names the methods that there are.
    pub(crate) fn new(
        method: Method,
        config: &FuseConfig,
        sensor: Option<&SensorModel>,
    ) -> Result<(Self, Kernels), GpuError> {
        let form = match config.raycast.distance {
            Distance::Euclidean => EUCLIDEAN,
            Distance::Projective => PROJECTIVE,
        };
        let sensor = sensor.cloned();
        match method {
            Method::Raycast => Ok((Self::Raycast, Kernels::lines(&[form, RAYCAST]))),
            Method::Cylindrical => {
                let round = Self::Cylindrical(Box::new(Cylindrical::new(sensor)));
                Ok((round, Kernels::lines(&[EUCLIDEAN, RAYCAST])))
            }
            Method::Normals if config.normals.estimator == Estimator::Adjacent => {
                let neighbours = Self::Normals {
                    config: config.normals,
                    beams: Beams::new(sensor),
                    image: Box::default(),
                };
                Ok((neighbours, Kernels::lines(&[NORMALS])))
            }
            Method::Normals => {
                let what = "normals.estimator = holz does not run on the GPU; adjacent does";
                Err(GpuError::Unsupported(what.into()))
            }
            Method::Depth => {
                let kernels = Kernels {
                    parts: vec![FRAME, DEPTH],
                    allocate: "allocate_depth",
                    fuse: "fuse_depth",
                    by_block: true,
                };
                Ok((Self::Depth(Box::default()), kernels))
            }
            _ => {
                let there = METHODS.map(Method::name).join(", ");
                let what = format!("{} does not run on the GPU; there are {there}", method.name());
                Err(GpuError::Unsupported(what))
            }
        }
    }

    /// What the CPU does to a scan before it is sent.
    pub(crate) fn prepare<'a>(&'a mut self, scan: &'a Scan) -> Result<Prepared<'a>, GpuError> {
        let as_it_is = Prepared {
            scan: Cow::Borrowed(scan),
            skipped: Skipped::default(),
            weight: weight_of(&scan.points),
            items: scan.points.len(),
            image: None,
            depth: None,
        };
        if let Self::Depth(image) = self {
            return depth(scan, image);
        }
        if scan.points.is_empty() {
            return Ok(as_it_is);
        }
        match self {
            Self::Raycast | Self::Depth(_) => Ok(as_it_is),
            Self::Cylindrical(method) => {
                let (rounded, skipped) = method.round(scan)?;
                Ok(Prepared {
                    items: rounded.points.len(),
                    scan: Cow::Owned(rounded),
                    skipped,
                    ..as_it_is
                })
            }
            Self::Normals { config, beams, image } => {
                let sensor = beams.of(scan)?;
                image.update(&scan.points, &rings_of(scan, sensor), sensor);
                let cell = |(ring, column)| (ring * image.columns() + column) as u32;
                let cell_of = (0..scan.points.len()).map(|i| image.place_of(i).map_or(NONE, cell));
                Ok(Prepared {
                    // (5.20)
                    weight: scan.points.len() as f32,
                    image: Some(Image {
                        cell_of: cell_of.collect(),
                        cells: (0..image.rings()).flat_map(|ring| image.row(ring)).copied().collect(),
                        rings: image.rings() as u32,
                        columns: image.columns() as u32,
                        max_range_m: sensor.max_range_m,
                        min_dot: config.min_dot,
                    }),
                    ..as_it_is
                })
            }
        }
    }
}

/// The sum of the weights (5.8) of some returns: no voxel can get more. In parts, added in one order on any number of threads.
fn weight_of(points: &[Vec3]) -> f32 {
    let parts = points
        .par_chunks(8192)
        .map(|part| part.iter().map(|p| p.length_recip().min(1.0)).sum());
    parts.collect::<Vec<f32>>().into_iter().sum()
}

/// The depth image of a scan.
fn depth<'a>(scan: &'a Scan, image: &'a mut DepthImage) -> Result<Prepared<'a>, GpuError> {
    let wrong = |reason: String| FuseError::Image {
        scan: scan.name.clone(),
        reason,
    };
    let camera = scan
        .camera
        .ok_or_else(|| wrong("is not the image of a depth camera, which this method needs".into()))?;
    camera.check().map_err(|e| wrong(e.to_string()))?;
    image.render(&camera, &scan.points, |p| p);
    Ok(Prepared {
        scan: Cow::Borrowed(scan),
        skipped: Skipped {
            hidden: image.hidden,
            outside_image: image.outside,
            ..Skipped::default()
        },
        weight: 1.0,
        items: camera.pixels(),
        image: None,
        depth: Some((camera, &image.depths_m)),
    })
}

impl Prepared<'_> {
    /// What is sent: points, times if returns are placed by them, then the image; of a depth image its depths alone.
    pub(crate) fn columns(&self) -> Vec<&[u8]> {
        if let Some((_, depths)) = &self.depth {
            return vec![bytemuck::cast_slice(depths)];
        }
        let mut columns = vec![
            bytemuck::cast_slice(&self.scan.points),
            bytemuck::cast_slice(self.times()),
        ];
        if let Some(image) = &self.image {
            columns.extend([bytemuck::cast_slice(&image.cell_of), bytemuck::cast_slice(&image.cells)]);
        }
        columns
    }

    /// Tells kernels where these columns begin.
    pub(crate) fn place_columns(&self, frame: &mut Frame) {
        if let Some((camera, depths)) = &self.depth {
            frame.camera = [camera.fx, camera.fy, camera.cx, camera.cy];
            (frame.columns, frame.rings) = (camera.width, camera.height);
            frame.max_range_m = depths.iter().copied().fold(0.0, f32::max);
            return;
        }
        let mut next = 3 * self.scan.points.len();
        let mut place = |column: usize| {
            next += column;
            (next - column) as u32
        };
        if !self.times().is_empty() {
            frame.times_at = place(self.times().len());
        }
        if let Some(image) = &self.image {
            frame.cells_at = place(image.cell_of.len());
            frame.image_at = place(image.cells.len());
            (frame.rings, frame.columns) = (image.rings, image.columns);
            (frame.max_range_m, frame.min_dot) = (image.max_range_m, image.min_dot);
        }
    }

    fn times(&self) -> &[f32] {
        self.scan.trajectory().and(self.scan.times.as_deref()).unwrap_or(&[])
    }
}
