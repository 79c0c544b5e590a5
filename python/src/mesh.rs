//! Triangle meshes.

use std::path::PathBuf;

use glam::{DVec3, Vec3};
use numpy::{PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use tsdfuse::mesh::Mesh as EngineMesh;

use crate::arrays::{IntoRows, Rows};
use crate::data::to_python;
use crate::error::{OrRaise, wrong};

/// A triangle mesh, as arrays.
#[pyclass(frozen, module = "tsdfuse")]
pub(crate) struct Mesh {
    vertices: Py<PyArray2<f64>>,
    normals: Py<PyArray2<f32>>,
    triangles: Py<PyArray2<i32>>,
}

impl Mesh {
    /// Hands a mesh over to Python, without copies.
    pub(crate) fn of(py: Python<'_>, mesh: EngineMesh) -> PyResult<Self> {
        Ok(Self {
            vertices: mesh.vertices.into_rows(py)?.unbind(),
            normals: mesh.normals.into_rows(py)?.unbind(),
            triangles: mesh.triangles.into_rows(py)?.unbind(),
        })
    }

    /// The mesh for the engine: a copy, checked, since Python may have changed its arrays.
    pub(crate) fn to_engine(&self, py: Python<'_>) -> PyResult<EngineMesh> {
        let vertices: Vec<DVec3> = Rows::<f64>::of("vertices", self.vertices.bind(py))?.vectors()?.to_vec();
        let normals: Vec<Vec3> = Rows::<f32>::of("normals", self.normals.bind(py))?.vectors()?.to_vec();
        if !normals.is_empty() && normals.len() != vertices.len() {
            return Err(wrong(format_args!(
                "{} normals for {} vertices",
                normals.len(),
                vertices.len()
            )));
        }
        let triangles = Rows::<i32>::of("triangles", self.triangles.bind(py))?;
        let corner = |&number: &i32| {
            let corner = u32::try_from(number)
                .ok()
                .filter(|&corner| (corner as usize) < vertices.len());
            corner.ok_or_else(|| {
                wrong(format_args!(
                    "triangles: there is no vertex {number} of {}",
                    vertices.len()
                ))
            })
        };
        let triangle = |[a, b, c]: &[i32; 3]| Ok([corner(a)?, corner(b)?, corner(c)?]);
        let triangles = triangles.vectors()?.iter().map(triangle).collect::<PyResult<_>>()?;
        Ok(EngineMesh {
            vertices,
            normals,
            triangles,
        })
    }
}

#[pymethods]
impl Mesh {
    #[new]
    #[pyo3(signature = (vertices, triangles, normals=None))]
    fn new(
        py: Python<'_>,
        vertices: &Bound<'_, PyAny>,
        triangles: &Bound<'_, PyAny>,
        normals: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let rows = |values: &Bound<'_, PyAny>| Rows::<f32>::of("normals", values)?.vectors().map(<[Vec3]>::to_vec);
        let mesh = Self {
            vertices: Rows::<f64>::of("vertices", vertices)?
                .vectors()?
                .to_vec()
                .into_rows(py)?
                .unbind(),
            normals: normals
                .map(rows)
                .transpose()?
                .unwrap_or_default()
                .into_rows(py)?
                .unbind(),
            triangles: {
                let triangles = Rows::<i32>::of("triangles", triangles)?;
                let triangles = triangles.vectors()?.iter().map(|&corners| glam::IVec3::from(corners));
                triangles.collect::<Vec<_>>().into_rows(py)?.unbind()
            },
        };
        mesh.to_engine(py)?;
        Ok(mesh)
    }

    /// Reads a mesh file.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let mesh = py.detach(|| tsdfuse_io::mesh::read(&path)).or_raise()?;
        Self::of(py, mesh)
    }

    /// Writes a mesh file.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        tsdfuse_io::mesh::check(&path).map_err(wrong)?;
        let mesh = self.to_engine(py)?;
        py.detach(|| tsdfuse_io::mesh::write(&path, &mesh)).or_raise()
    }

    #[getter]
    fn vertices(&self, py: Python<'_>) -> Py<PyArray2<f64>> {
        self.vertices.clone_ref(py)
    }

    #[getter]
    fn normals(&self, py: Python<'_>) -> Py<PyArray2<f32>> {
        self.normals.clone_ref(py)
    }

    #[getter]
    fn triangles(&self, py: Python<'_>) -> Py<PyArray2<i32>> {
        self.triangles.clone_ref(py)
    }

    /// Counts of edges and boundaries.
    fn topology<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let mesh = self.to_engine(py)?;
        let topology = py.detach(|| mesh.topology());
        let told = pyo3::types::PyDict::new(py);
        told.set_item("is_manifold", topology.is_manifold())?;
        told.set_item("is_closed", topology.is_closed())?;
        told.set_item("vertices", mesh.vertices.len())?;
        told.set_item("triangles", mesh.triangles.len())?;
        Ok(told.into_any())
    }

    /// An `open3d.geometry.TriangleMesh`.
    fn to_open3d(slf: &Bound<'_, Self>) -> PyResult<Py<PyAny>> {
        let convert = slf.py().import("tsdfuse._convert")?;
        Ok(convert.call_method1("open3d_mesh", (slf,))?.unbind())
    }

    /// A `trimesh.Trimesh`.
    fn to_trimesh(slf: &Bound<'_, Self>) -> PyResult<Py<PyAny>> {
        let convert = slf.py().import("tsdfuse._convert")?;
        Ok(convert.call_method1("trimesh_mesh", (slf,))?.unbind())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let rows = |shape: &[usize]| shape.first().copied().unwrap_or_default();
        use numpy::PyUntypedArrayMethods;
        let (vertices, triangles) = (
            rows(self.vertices.bind(py).shape()),
            rows(self.triangles.bind(py).shape()),
        );
        format!("<Mesh: {vertices} vertices, {triangles} triangles>")
    }

    fn __getnewargs__(&self, py: Python<'_>) -> (Py<PyArray2<f64>>, Py<PyArray2<i32>>, Option<Py<PyArray2<f32>>>) {
        let normals = self.normals.clone_ref(py);
        let has_normals = normals.bind(py).readonly().as_array().nrows() > 0;
        (self.vertices(py), self.triangles(py), has_normals.then_some(normals))
    }

    /// How it compares, as plain data: see `tsdfuse.compare`.
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let rows = Rows::<f64>::of("vertices", self.vertices.bind(py))?;
        let corners = rows
            .vectors()?
            .iter()
            .map(|&v| (v, v))
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        corners
            .map(|(low, high)| to_python(py, &[low.to_array(), high.to_array()]))
            .transpose()
    }
}
