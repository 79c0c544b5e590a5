//! The host's part of each method: what it finds out about a scan and its sensor before the scan is submitted, by the code of
//! the CPU's method.

use tsdfuse::{
    Scan, SensorModel,
    fuse::{Beams, Distance, FuseConfig, FuseError, Method, PatchConfig, Rows, rings_of, twin},
    normals::{Estimator, NormalsConfig},
    sensor::Pinhole,
};

use crate::error::GpuError;
use crate::kernels::Kernels;
use crate::prepared::{Cylinder, Image, Prepared, Surface, range_weights, weights};
use crate::shader::{EUCLIDEAN, PROJECTIVE, RAYCAST};
use crate::sweep::segments;

/// The methods that run on the device.
pub const METHODS: [Method; 5] = [
    Method::Raycast,
    Method::Normals,
    Method::Cylindrical,
    Method::Depth,
    Method::Patch,
];

/// What each method keeps about the sensor.
#[derive(Debug)]
pub(crate) enum Prepare {
    /// Nothing: returns are used as they are.
    Raycast,
    /// The beams, for the neighbours of each return.
    Normals { config: NormalsConfig, beams: Beams },
    /// The beams, and the cylindrical image.
    Cylindrical { beams: Beams, image: Option<Cylinder> },
    /// Nothing: each scan has its camera.
    Depth,
    /// The beams, for the neighbours of each return, and their angles.
    Patch {
        config: PatchConfig,
        beams: Beams,
        angles: Box<Angles>,
    },
}

impl Prepare {
    /// Prepares a method, and returns its kernels.
    ///
    /// # Errors
    /// [`GpuError::Unsupported`] lists the methods that run on the device.
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
            Method::Raycast => Ok((Self::Raycast, Kernels::one_line(&[form, RAYCAST]))),
            Method::Cylindrical => {
                let image = Self::Cylindrical {
                    beams: Beams::new(sensor),
                    image: None,
                };
                Ok((image, Kernels::cylindrical()))
            }
            Method::Normals if config.normals.estimator == Estimator::Adjacent => {
                let neighbours = Self::Normals {
                    config: config.normals,
                    beams: Beams::new(sensor),
                };
                Ok((neighbours, Kernels::normals()))
            }
            Method::Normals => {
                let what = "normals.estimator = holz does not run on the GPU; adjacent does";
                Err(GpuError::Unsupported(what.into()))
            }
            Method::Depth => Ok((Self::Depth, Kernels::depth())),
            Method::Patch => {
                let PatchConfig {
                    noise_m,
                    carve,
                    agreement,
                    ..
                } = config.patch;
                let neighbours = Self::Patch {
                    config: config.patch,
                    beams: Beams::new(sensor),
                    angles: Box::default(),
                };
                Ok((neighbours, Kernels::patch(noise_m == 0.0, carve, agreement)))
            }
            _ => {
                let there = METHODS.map(Method::name).join(", ");
                let what = format!("{} does not run on the GPU; there are {there}", method.name());
                Err(GpuError::Unsupported(what))
            }
        }
    }

    /// Prepares a scan for its kernels.
    pub(crate) fn prepare<'a>(&'a mut self, scan: &'a Scan) -> Result<Prepared<'a>, GpuError> {
        let as_it_is = |weights| Prepared {
            scan,
            weights,
            items: scan.points.len(),
            segments: segments(scan),
            image: None,
            surface: None,
            cylinder: None,
            camera: None,
        };
        if let Self::Depth = self {
            let camera = camera_of(scan)?;
            return Ok(Prepared {
                items: camera.pixels(),
                camera: Some(camera),
                ..as_it_is(vec![1.0])
            });
        }
        if scan.points.is_empty() {
            return Ok(as_it_is(Vec::new()));
        }
        match self {
            Self::Raycast | Self::Depth => Ok(as_it_is(range_weights(&scan.points))),
            Self::Cylindrical { beams, image } => {
                let sensor = beams.of(scan)?;
                let cylinder = image.get_or_insert_with(|| Cylinder::of(sensor));
                Ok(Prepared {
                    cylinder: Some(cylinder),
                    ..as_it_is(cylinder.weights(&scan.points))
                })
            }
            Self::Normals { config, beams } => {
                let sensor = beams.of(scan)?;
                Ok(Prepared {
                    image: Some(Image {
                        min_dot: config.min_dot,
                        ..Image::of(sensor, rings_of(scan, sensor))
                    }),
                    // (5.20)
                    ..as_it_is(weights(&scan.points, |_| 1.0))
                })
            }
            Self::Patch { config, beams, angles } => {
                let Rows {
                    sensor,
                    rings,
                    neighbour_cells,
                } = beams.or_grid(scan)?;
                angles.update(&sensor);
                let surface = Surface {
                    config: *config,
                    gaps: &angles.gaps,
                    nearest: &angles.nearest,
                    neighbour_cells: neighbour_cells as u32,
                    crowd: if config.carve && config.agreement {
                        twin::crowd(&sensor, 1.0)
                    } else {
                        0.0
                    },
                };
                let weights = surface.weights(scan);
                Ok(Prepared {
                    image: Some(Image::of(&sensor, rings)),
                    surface: Some(surface),
                    ..as_it_is(weights)
                })
            }
        }
    }
}

/// The angles of a sensor's beams.
#[derive(Debug, Default)]
pub(crate) struct Angles {
    elevations_deg: Vec<f32>,
    /// The tangents of the angles between each ring and the next; the uppermost ring has that of the ring below it.
    gaps: Vec<f32>,
    /// The nearest ring for each bin of elevation.
    nearest: Vec<u32>,
}

impl Angles {
    fn update(&mut self, sensor: &SensorModel) {
        if self.elevations_deg != sensor.elevations_deg {
            self.elevations_deg.clone_from(&sensor.elevations_deg);
            self.nearest = twin::nearest_rings(sensor).into_iter().map(u32::from).collect();
            self.gaps = twin::ring_gap_tangents(sensor);
            self.gaps.push(self.gaps.last().copied().unwrap_or(0.0));
        }
    }
}

/// The camera that took a scan.
fn camera_of(scan: &Scan) -> Result<Pinhole, GpuError> {
    let wrong = |reason: String| FuseError::Image {
        scan: scan.name.clone(),
        reason,
    };
    let camera = scan
        .camera
        .ok_or_else(|| wrong("is not the image of a depth camera, which this method needs".into()))?;
    camera.check().map_err(|e| wrong(e.to_string()))?;
    Ok(camera)
}
