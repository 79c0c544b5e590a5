//! NumPy arrays in and out. What the engine makes is handed over without a copy; what it is given is copied once, where it keeps it.

use bytemuck::allocation::try_cast_vec;
use bytemuck::cast_slice;
use glam::{DVec3, IVec3, Vec3};
use numpy::{
    AllowTypeChange, Element, PyArray1, PyArray2, PyArray3, PyArrayLike1, PyArrayLike2, PyArrayMethods,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use tsdfuse::Pose;

use crate::error::{OrRaise, wrong};

/// Refuses an array that has not three columns.
fn check_columns(name: &str, shape: &[usize], columns: usize) -> PyResult<()> {
    if shape.len() == 2 && shape[1] == columns {
        return Ok(());
    }
    Err(wrong(format_args!(
        "{name} must have the shape (N, {columns}), not {shape:?}"
    )))
}

/// Numbers in rows of three, of any shape (N, 3).
pub(crate) struct Rows<'py, T: Element>(PyArrayLike2<'py, T, AllowTypeChange>);

impl<'py, T: Element + bytemuck::Pod> Rows<'py, T>
where
    for<'a> T: FromPyObject<'a, 'py>,
{
    /// Takes what NumPy makes an array of; without a copy if it is one of this type.
    pub(crate) fn of(name: &str, value: &Bound<'py, PyAny>) -> PyResult<Self> {
        let array = contiguous(value)?;
        let rows: PyArrayLike2<'py, T, AllowTypeChange> = array
            .extract()
            .map_err(|error: PyErr| wrong(format_args!("{name} must have the shape (N, 3): {error}")))?;
        check_columns(name, rows.shape(), 3)?;
        Ok(Self(rows))
    }

    fn numbers(&self) -> PyResult<&[T]> {
        Ok(self.0.as_slice()?)
    }
}

/// The array in C order, which NumPy does not copy if it is so already.
fn contiguous<'py>(value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    value.py().import("numpy")?.call_method1("ascontiguousarray", (value,))
}

impl Rows<'_, f32> {
    pub(crate) fn vectors(&self) -> PyResult<&[Vec3]> {
        Ok(cast_slice(self.numbers()?))
    }
}

impl Rows<'_, f64> {
    pub(crate) fn vectors(&self) -> PyResult<&[DVec3]> {
        Ok(cast_slice(self.numbers()?))
    }
}

impl Rows<'_, i32> {
    pub(crate) fn vectors(&self) -> PyResult<&[[i32; 3]]> {
        Ok(cast_slice(self.numbers()?))
    }
}

/// One number per point.
pub(crate) fn column<'py, T>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<Vec<T>>
where
    for<'a> T: Element + Copy + FromPyObject<'a, 'py> + 'py,
{
    let array = contiguous(value)?;
    let column: PyArrayLike1<'py, T, AllowTypeChange> = array
        .extract()
        .map_err(|error: PyErr| wrong(format_args!("{name} must have the shape (N,): {error}")))?;
    Ok(column.as_slice()?.to_vec())
}

/// Three numbers.
pub(crate) fn triple(name: &str, value: &Bound<'_, PyAny>) -> PyResult<DVec3> {
    match column::<f64>(name, value)?.as_slice() {
        &[x, y, z] => Ok(DVec3::new(x, y, z)),
        other => Err(wrong(format_args!("{name} must be three numbers, not {}", other.len()))),
    }
}

/// A pose: a rigid matrix of 3 or 4 rows and 4 columns.
pub(crate) fn pose(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Pose> {
    let array = contiguous(value)?;
    let matrix: PyArrayLike2<'_, f64, AllowTypeChange> = array
        .extract()
        .map_err(|error: PyErr| wrong(format_args!("{name} must have the shape (4, 4): {error}")))?;
    let shape = [matrix.shape()[0], matrix.shape()[1]];
    let numbers = matrix.as_slice()?;
    if !matches!(shape, [3 | 4, 4]) || (shape[0] == 4 && numbers[12..] != [0.0, 0.0, 0.0, 1.0]) {
        return Err(wrong(format_args!(
            "{name} must be a rigid matrix of the shape (4, 4) whose last row is 0, 0, 0, 1"
        )));
    }
    let mut rows = [0.0; 12];
    rows.copy_from_slice(&numbers[..12]);
    Pose::from_row_major_3x4(&rows).map_err(|error| wrong(format_args!("{name}: {error}")))
}

/// Poses: an array of the shape (N, 4, 4).
pub(crate) fn poses(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<Pose>> {
    value.try_iter()?.map(|matrix| pose(name, &matrix?)).collect()
}

/// The 16 numbers of a pose's matrix, row by row.
fn matrix(pose: &Pose) -> [f64; 16] {
    let mut numbers = [0.0; 16];
    numbers[..12].copy_from_slice(&pose.to_row_major_3x4());
    numbers[15] = 1.0;
    numbers
}

/// A matrix (4, 4).
pub(crate) fn pose_array<'py>(py: Python<'py>, pose: &Pose) -> PyResult<Bound<'py, PyArray2<f64>>> {
    PyArray1::from_vec(py, matrix(pose).to_vec()).reshape([4, 4])
}

/// Matrices (N, 4, 4); NaN where a pose is not known.
pub(crate) fn pose_arrays<'py>(
    py: Python<'py>,
    poses: impl ExactSizeIterator<Item = Option<Pose>>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let count = poses.len();
    let numbers: Vec<f64> = poses
        .flat_map(|pose| pose.as_ref().map_or([f64::NAN; 16], matrix))
        .collect();
    PyArray1::from_vec(py, numbers).reshape([count, 4, 4])
}

/// An array (N, 3) that takes over the memory of vectors.
pub(crate) trait IntoRows {
    type Number: Element;

    fn into_rows(self, py: Python<'_>) -> PyResult<Bound<'_, PyArray2<Self::Number>>>;
}

macro_rules! into_rows {
    ($($vector:ty: $number:ty;)*) => {
        $(
            impl IntoRows for Vec<$vector> {
                type Number = $number;

                fn into_rows(self, py: Python<'_>) -> PyResult<Bound<'_, PyArray2<$number>>> {
                    let rows = self.len();
                    let copied = |vectors: Self| cast_slice::<$vector, $number>(&vectors).to_vec();
                    let numbers = try_cast_vec(self).unwrap_or_else(|(_, vectors)| copied(vectors));
                    PyArray1::from_vec(py, numbers).reshape([rows, 3])
                }
            }
        )*
    };
}

into_rows! {
    DVec3: f64;
    Vec3: f32;
    IVec3: i32;
    [u32; 3]: i32;
}

/// A camera's intrinsics for a message-free world: positive sizes.
pub(crate) fn check_pinhole(camera: &tsdfuse::sensor::Pinhole) -> PyResult<()> {
    camera.check().or_raise()
}
