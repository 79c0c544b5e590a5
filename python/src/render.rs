//! Views of a map, and single rays through it.

use numpy::{PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use tsdfuse::Pose;
use tsdfuse::render::{Camera, Hit, ImageKind, Ray, RenderConfig, Renderer, overview, turntable};
use tsdfuse::sensor::Pinhole;
use tsdfuse_run::{Device, view};

use crate::arrays::{IntoRows, Rows, check_pinhole, pose_array, pose_arrays};
use crate::data::from_python;
use crate::error::{OrRaise, wrong};
use crate::map::{Map, no_surface};
use crate::sensor;

/// What a camera sees of a map.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct View {
    view: tsdfuse::render::View,
    pose: Pose,
}

/// A camera: intrinsics, or a size with an angle of view, or a LiDAR.
fn camera_of(
    camera: Option<&Bound<'_, PyAny>>,
    sensor: Option<&Bound<'_, PyAny>>,
    size: (u32, u32),
    fov_deg: f32,
) -> PyResult<Camera> {
    if let Some(sensor) = sensor {
        return Ok(Camera::Lidar(sensor::model(sensor)?));
    }
    let camera: Pinhole = match camera {
        Some(camera) => from_python(camera, "camera")?,
        None => Pinhole::with_fov(size.0, size.1, fov_deg.to_radians()),
    };
    check_pinhole(&camera)?;
    Ok(Camera::Pinhole(camera))
}

#[pymethods]
impl Map {
    /// A picture of the map.
    #[pyo3(signature = (pose=None, *, width=1280, height=720, fov_deg=60.0, camera=None, sensor=None, min_weight=0.0, max_range=10_000.0, device="cpu"))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn render(
        &self,
        py: Python<'_>,
        pose: Option<&Bound<'_, PyAny>>,
        width: u32,
        height: u32,
        fov_deg: f32,
        camera: Option<&Bound<'_, PyAny>>,
        sensor: Option<&Bound<'_, PyAny>>,
        min_weight: f32,
        max_range: f32,
        device: &str,
    ) -> PyResult<View> {
        let camera = camera_of(camera, sensor, (width, height), fov_deg)?;
        let device = device.parse::<Device>().map_err(wrong)?;
        let asked = pose.map(|at| crate::arrays::pose("pose", at)).transpose()?;
        let config = RenderConfig {
            min_weight,
            max_range_m: max_range,
        };
        py.detach(|| {
            let content = self.read();
            let renderer = view::renderer(&content.map, &config).or_raise()?;
            let pose = match (asked, &camera) {
                (Some(pose), _) => pose,
                (None, Camera::Pinhole(pinhole)) => {
                    overview(&renderer, pinhole, &content.path()).ok_or_else(no_surface)?
                }
                (None, Camera::Lidar(_)) => return Err(wrong("a LiDAR's view needs a pose")),
            };
            let view = device.look(&renderer, &config).or_raise()?(&camera, pose).or_raise()?;
            Ok(View { view, pose })
        })
    }

    /// Poses around the map, from which all of it is seen.
    #[pyo3(signature = (count=1, *, width=1280, height=720, fov_deg=60.0))]
    fn turntable<'py>(
        &self,
        py: Python<'py>,
        count: usize,
        width: u32,
        height: u32,
        fov_deg: f32,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let camera = Pinhole::with_fov(width, height, fov_deg.to_radians());
        check_pinhole(&camera)?;
        let poses = py.detach(|| {
            let content = self.read();
            let renderer = view::renderer(&content.map, &RenderConfig::default()).or_raise()?;
            Ok::<_, PyErr>(turntable(&renderer, &camera, &content.path(), count))
        })?;
        pose_arrays(py, poses.into_iter().map(Some))
    }

    /// What rays meet.
    #[pyo3(signature = (origins, directions, *, max_range=10_000.0, min_weight=0.0))]
    fn raycast<'py>(
        &self,
        py: Python<'py>,
        origins: &Bound<'py, PyAny>,
        directions: &Bound<'py, PyAny>,
        max_range: f64,
        min_weight: f32,
    ) -> PyResult<(
        Bound<'py, PyArray1<f32>>,
        Bound<'py, PyArray2<f32>>,
        Bound<'py, PyArray1<bool>>,
    )> {
        let (origins, directions) = (
            Rows::<f64>::of("origins", origins)?,
            Rows::<f64>::of("directions", directions)?,
        );
        let (origins, directions) = (origins.vectors()?, directions.vectors()?);
        let one = origins.len() == 1;
        if !one && origins.len() != directions.len() {
            let (origins, directions) = (origins.len(), directions.len());
            return Err(wrong(format_args!(
                "{origins} origins for {directions} directions: one for each, or one for all"
            )));
        }
        let config = RenderConfig {
            min_weight,
            ..RenderConfig::default()
        };
        let hits = py.detach(|| {
            let content = self.read();
            let renderer = Renderer::new(&content.map, &config).or_raise()?;
            let ray = |(number, &direction)| Ray {
                origin: origins[if one { 0 } else { number }],
                direction,
                length_m: max_range,
            };
            let rays: Vec<_> = directions.iter().enumerate().map(ray).collect();
            Ok::<_, PyErr>(renderer.cast(&rays))
        })?;
        let each = |of: fn(&Hit) -> f32| hits.iter().map(|hit| hit.as_ref().map_or(f32::NAN, of)).collect();
        let normals: Vec<_> = hits
            .iter()
            .map(|hit| hit.map_or(glam::Vec3::ZERO, |hit| hit.normal))
            .collect();
        let met = hits.iter().map(Option::is_some).collect();
        Ok((
            PyArray1::from_vec(py, each(|hit| hit.range_m)),
            normals.into_rows(py)?,
            PyArray1::from_vec(py, met),
        ))
    }
}

impl View {
    fn each<'py>(&self, py: Python<'py>, of: fn(&Hit) -> f32) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let pixels = self
            .view
            .hits
            .iter()
            .map(|hit| hit.as_ref().map_or(f32::NAN, of))
            .collect();
        PyArray1::from_vec(py, pixels).reshape([self.view.height, self.view.width])
    }
}

#[pymethods]
impl View {
    /// Metres along the optical axis; ranges for a LiDAR; NaN where nothing is seen.
    #[getter]
    fn depth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.each(py, |hit| hit.depth_m)
    }

    /// Metres along the ray.
    #[getter]
    fn range<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.each(py, |hit| hit.range_m)
    }

    /// The map's weight.
    #[getter]
    fn weight<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.each(py, |hit| hit.weight)
    }

    /// Unit normals in the world.
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let normal = |hit: &Option<Hit>| hit.map_or([f32::NAN; 3], |hit| hit.normal.to_array());
        let numbers = self.view.hits.iter().flat_map(normal).collect();
        PyArray1::from_vec(py, numbers).reshape([self.view.height, self.view.width, 3])
    }

    /// `world_from_camera`.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pose_array(py, &self.pose)
    }

    /// A picture.
    #[pyo3(signature = (kind="shaded"))]
    fn image<'py>(&self, py: Python<'py>, kind: &str) -> PyResult<Bound<'py, PyAny>> {
        use tsdfuse::render::Pixels;
        let image = self.view.image(image_kind(kind)?);
        let size = [image.height, image.width];
        Ok(match image.pixels {
            Pixels::Grey(pixels) => PyArray1::from_vec(py, pixels).reshape(size)?.into_any(),
            Pixels::Grey16(pixels) => PyArray1::from_vec(py, pixels).reshape(size)?.into_any(),
            Pixels::Rgb(pixels) => {
                let flat: Bound<'py, PyArrayDyn<u8>> =
                    PyArray1::from_vec(py, pixels.into_flattened()).reshape(vec![image.height, image.width, 3])?;
                flat.into_any()
            }
        })
    }

    /// Writes a picture.
    #[pyo3(signature = (path, kind="shaded"))]
    fn write(&self, py: Python<'_>, path: std::path::PathBuf, kind: &str) -> PyResult<()> {
        tsdfuse_io::png::check(&path).map_err(wrong)?;
        let kind = image_kind(kind)?;
        py.detach(|| tsdfuse_io::png::write(&path, &self.view.image(kind)))
            .or_raise()
    }

    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, pyo3::types::PyBytes>> {
        let bytes = py
            .detach(|| tsdfuse_io::png::encode(&self.view.image(ImageKind::Shaded)))
            .or_raise()?;
        Ok(pyo3::types::PyBytes::new(py, &bytes))
    }

    fn __repr__(&self) -> String {
        let (width, height) = (self.view.width, self.view.height);
        let seen = 100 * self.view.hit_count() / (width * height).max(1);
        format!("<View: {width} x {height} pixels, {seen} % see surface>")
    }
}

fn image_kind(name: &str) -> PyResult<ImageKind> {
    let found = ImageKind::ALL.into_iter().find(|kind| kind.name() == name);
    found.ok_or_else(|| {
        wrong(format_args!(
            "no picture {name}; there are {}",
            ImageKind::ALL.map(ImageKind::name).join(", ")
        ))
    })
}
