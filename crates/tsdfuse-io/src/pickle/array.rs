//! NumPy arrays of numbers: one or two dimensions, C or Fortran order, either byte order, read in place.

use super::graph::{Bytes, Class, Graph, Value};

/// An array of numbers, `rows × len` (a vector is one row).
#[derive(Debug)]
pub(super) struct Array<'a> {
    /// Letter and size of the type, as NumPy writes them: `f8`.
    dtype: &'a str,
    big_endian: bool,
    fortran_order: bool,
    pub(super) rows: usize,
    pub(super) len: usize,
    bytes: Bytes<'a>,
}

impl<'a> Array<'a> {
    pub(super) fn new(graph: &Graph<'a>, value: Value<'a>) -> Result<Self, String> {
        let parts = Parts::of(graph, value).ok_or("an array of unknown layout")?;
        let (rows, len) = match *parts.shape {
            [len] => (1, len.count()),
            [rows, len] => (rows.count().ok_or("an array of negative size")?, len.count()),
            _ => return Err(format!("an array of {} dimensions", parts.shape.len())),
        };
        let len = len.ok_or("an array of negative size")?;
        let (dtype, big_endian) = dtype(graph, parts.dtype).ok_or("an array of unknown type")?;
        let size = item_size(dtype).ok_or_else(|| format!("an array of type '{dtype}' instead of numbers"))?;
        let bytes = graph.bytes(parts.data).ok_or("an array without data")?;
        if rows.checked_mul(len).and_then(|n| n.checked_mul(size)) != Some(bytes.len()) {
            return Err(format!("an array of {rows} x {len} {dtype} in {} bytes", bytes.len()));
        }
        Ok(Self {
            dtype,
            big_endian,
            fortran_order: parts.fortran_order,
            rows,
            len,
            bytes,
        })
    }

    /// One row, as `f64`: exact for all types except 64-bit integers above 2⁵³.
    pub(super) fn row(&self, row: usize) -> Vec<f64> {
        match self.dtype {
            "f8" => self.convert(row, f64::from_le_bytes),
            "f4" => self.convert(row, |b| f32::from_le_bytes(b).into()),
            "i8" => self.convert(row, |b| i64::from_le_bytes(b) as f64),
            "i4" => self.convert(row, |b| i32::from_le_bytes(b).into()),
            "i2" => self.convert(row, |b| i16::from_le_bytes(b).into()),
            "i1" => self.convert(row, |b| i8::from_le_bytes(b).into()),
            "u8" => self.convert(row, |b| u64::from_le_bytes(b) as f64),
            "u4" => self.convert(row, |b| u32::from_le_bytes(b).into()),
            "u2" => self.convert(row, |b| u16::from_le_bytes(b).into()),
            _ => self.convert(row, |[b]| b.into()),
        }
    }

    fn convert<const N: usize>(&self, row: usize, number: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        let (from, step, skip) = if self.fortran_order {
            (0, self.rows, row * N)
        } else {
            (row * self.len * N, 1, 0)
        };
        let items = self.bytes.get(from..).unwrap_or_default().chunks_exact(step.max(1) * N);
        let item = |chunk: &[u8]| {
            let mut bytes = *chunk.get(skip..).and_then(<[u8]>::first_chunk).unwrap_or(&[0; N]);
            if self.big_endian {
                bytes.reverse();
            }
            number(bytes)
        };
        items.take(self.len).map(item).collect()
    }
}

/// The parts of an array, from either of NumPy's two ways of pickling.
struct Parts<'g, 'a> {
    shape: &'g [Value<'a>],
    dtype: Value<'a>,
    fortran_order: bool,
    data: Value<'a>,
}

impl<'g, 'a> Parts<'g, 'a> {
    fn of(graph: &'g Graph<'a>, array: Value<'a>) -> Option<Self> {
        let (shape, dtype, fortran_order, data) = match graph.object(array)? {
            (Class::Reconstruct, _, state) => match *graph.entries(state)? {
                [_, shape, dtype, Value::Bool(fortran_order), data] => (shape, dtype, fortran_order, data),
                _ => return None,
            },
            (Class::FromBuffer, args, _) => match *graph.entries(args)? {
                [data, dtype, shape, order] => (shape, dtype, order.text()? == "F", data),
                _ => return None,
            },
            _ => return None,
        };
        Some(Self {
            shape: graph.entries(shape)?,
            dtype,
            fortran_order,
            data,
        })
    }
}

/// The Python objects in an array of objects.
pub(super) fn objects<'g, 'a>(graph: &'g Graph<'a>, array: Value<'a>) -> Option<&'g [Value<'a>]> {
    graph.entries(Parts::of(graph, array)?.data)
}

/// The name of a dtype, and whether its bytes are in big-endian order.
fn dtype<'a>(graph: &Graph<'a>, value: Value<'a>) -> Option<(&'a str, bool)> {
    let (args, state) = graph.object_of(value, Class::Dtype)?;
    let name = graph.entry(args, 0)?.text()?;
    let order = graph.entry(state, 1).and_then(Value::text);
    Some((name, order == Some(">")))
}

fn item_size(dtype: &str) -> Option<usize> {
    match dtype {
        "f8" | "i8" | "u8" => Some(8),
        "f4" | "i4" | "u4" => Some(4),
        "i2" | "u2" => Some(2),
        "i1" | "u1" | "b1" => Some(1),
        _ => None,
    }
}
