//! The content of a message, read by its definition: ROS 1 serialisation and CDR of either byte order.
//!
//! Arrays of numbers and of records of numbers stay bytes, so that a cloud is not copied before its columns are picked.

use super::container::Encoding;
use super::schema::{Count, Field, Schema, Type};
use crate::scalar::Scalar;

/// How deep definitions may be nested.
const MAX_DEPTH: usize = 16;

/// A value in a message.
#[derive(Clone, Debug)]
pub(crate) enum Value<'a> {
    Int(i64),
    Float(f64),
    Text(&'a [u8]),
    /// An array of numbers; of `u8` these are the bytes of anything.
    Numbers(Numbers<'a>),
    /// An array of records of the same size.
    Records(Records<'a>),
    List(Vec<Value<'a>>),
    Struct(Vec<(&'a str, Value<'a>)>),
}

/// An array of numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbers<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) scalar: Scalar,
    pub(crate) is_big_endian: bool,
}

/// Records with named numbers at fixed places: the points of a cloud.
#[derive(Clone, Debug)]
pub(crate) struct Records<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) count: usize,
    /// Bytes from one record to the next. The last one may be cut off after its last field.
    pub(crate) stride: usize,
    pub(crate) is_big_endian: bool,
    /// Name, offset and type of each number.
    pub(crate) fields: Vec<(String, usize, Scalar)>,
}

impl Scalar {
    /// As [`Scalar::read`], for either order of bytes.
    pub(crate) fn read_as(self, bytes: &[u8], is_big_endian: bool) -> Option<f64> {
        if !is_big_endian {
            return self.read(bytes);
        }
        let (mut turned, size) = ([0; 8], self.size());
        turned.get_mut(..size)?.copy_from_slice(bytes.get(..size)?);
        turned.get_mut(..size)?.reverse();
        self.read(&turned)
    }
}

impl Numbers<'_> {
    pub(crate) fn iter(&self) -> impl Iterator<Item = f64> + '_ {
        let chunks = self.bytes.chunks_exact(self.scalar.size());
        chunks.filter_map(|bytes| self.scalar.read_as(bytes, self.is_big_endian))
    }
}

impl<'a> Value<'a> {
    /// A part of a struct, by the names of the way to it with points between them.
    pub(crate) fn get(&self, path: &str) -> Result<&Value<'a>, String> {
        let mut value = self;
        for name in path.split('.') {
            let Value::Struct(fields) = value else {
                return Err(format!("{path} is no part of it"));
            };
            // ROS 1 has D, K, R and P where ROS 2 has small letters.
            let found = fields.iter().find(|(other, _)| other.eq_ignore_ascii_case(name));
            value = &found.ok_or_else(|| format!("has no field {path}"))?.1;
        }
        Ok(value)
    }

    pub(crate) fn int(&self, path: &str) -> Result<i64, String> {
        match self.get(path)? {
            Value::Int(value) => Ok(*value),
            _ => Err(format!("{path} is no integer")),
        }
    }

    pub(crate) fn float(&self, path: &str) -> Result<f64, String> {
        match self.get(path)? {
            Value::Float(value) => Ok(*value),
            Value::Int(value) => Ok(*value as f64),
            _ => Err(format!("{path} is no number")),
        }
    }

    pub(crate) fn text(&self, path: &str) -> Result<String, String> {
        match self.get(path)? {
            Value::Text(bytes) => Ok(String::from_utf8_lossy(bytes).into_owned()),
            _ => Err(format!("{path} is no text")),
        }
    }

    pub(crate) fn bytes(&self, path: &str) -> Result<&'a [u8], String> {
        match self.get(path)? {
            Value::Numbers(numbers) if numbers.scalar.size() == 1 => Ok(numbers.bytes),
            _ => Err(format!("{path} holds no bytes")),
        }
    }

    pub(crate) fn numbers(&self, path: &str) -> Result<Numbers<'a>, String> {
        match self.get(path)? {
            Value::Numbers(numbers) => Ok(*numbers),
            _ => Err(format!("{path} holds no numbers")),
        }
    }

    /// The elements of an array of structs.
    pub(crate) fn list(&self, path: &str) -> Result<&[Value<'a>], String> {
        match self.get(path)? {
            Value::List(values) => Ok(values),
            Value::Records(records) if records.count == 0 => Ok(&[]),
            _ => Err(format!("{path} is no list")),
        }
    }
}

/// Reads a message.
///
/// # Errors
/// Says at which byte and in which field the message ends or is impossible.
pub(crate) fn read<'a>(schema: &'a Schema, encoding: Encoding, bytes: &'a [u8]) -> Result<Value<'a>, String> {
    read_until(schema, encoding, bytes, usize::MAX)
}

/// Reads the first `fields` fields of a message.
///
/// # Errors
/// As [`read`].
pub(crate) fn read_until<'a>(
    schema: &'a Schema,
    encoding: Encoding,
    bytes: &'a [u8],
    fields: usize,
) -> Result<Value<'a>, String> {
    let (bytes, alignment, is_big_endian) = match encoding {
        Encoding::Ros1 => (bytes, 1, false),
        Encoding::Other => return Err("is serialised in a way that is not known".to_owned()),
        Encoding::Cdr => {
            let &[_, kind, _, _] = bytes.first_chunk().ok_or("has no CDR header")?;
            // Plain CDR and CDR 2, each in either order; the others have lengths of members.
            let alignment = match kind {
                0 | 1 => 8,
                6 | 7 => 4,
                _ => return Err(format!("is CDR of kind {kind}, which is not read")),
            };
            (bytes.get(4..).unwrap_or_default(), alignment, kind % 2 == 0)
        }
    };
    let mut reader = Reader {
        schema,
        bytes,
        at: 0,
        alignment,
        is_big_endian,
    };
    let root = schema.fields(&schema.root).ok_or("has no definition")?;
    reader.fields(root.get(..fields.min(root.len())).unwrap_or_default(), 0)
}

struct Reader<'a> {
    schema: &'a Schema,
    bytes: &'a [u8],
    at: usize,
    /// Numbers lie at multiples of their size, up to this; 1: anywhere.
    alignment: usize,
    is_big_endian: bool,
}

impl<'a> Reader<'a> {
    fn fields(&mut self, fields: &'a [Field], depth: usize) -> Result<Value<'a>, String> {
        if depth > MAX_DEPTH {
            return Err("has a definition that is nested too deep".to_owned());
        }
        let mut values = Vec::with_capacity(fields.len());
        for field in fields {
            let value = self.field(field, depth).map_err(|why| match depth {
                0 => format!("{}: {why}", field.name),
                _ => why,
            })?;
            values.push((field.name.as_str(), value));
        }
        // An empty struct is one byte in ROS 2.
        if fields.is_empty() && self.alignment > 1 && depth > 0 {
            self.take(1)?;
        }
        Ok(Value::Struct(values))
    }

    fn field(&mut self, field: &'a Field, depth: usize) -> Result<Value<'a>, String> {
        let count = match field.count {
            Count::One => return self.one(&field.ty, depth),
            Count::Fixed(count) => count,
            Count::Any => self.count()?,
        };
        match &field.ty {
            Type::Number(scalar) => {
                if count > 0 {
                    self.align(scalar.size());
                }
                let bytes = count.checked_mul(scalar.size()).ok_or_else(|| self.cut(count))?;
                let bytes = self.take(bytes)?;
                Ok(Value::Numbers(Numbers {
                    bytes,
                    scalar: *scalar,
                    is_big_endian: self.is_big_endian,
                }))
            }
            Type::Named(name) if let Some(layout) = self.layout(name) => self.records(count, layout),
            ty => {
                // Each takes at least one byte.
                if count > self.bytes.len().saturating_sub(self.at) {
                    return Err(self.cut(count));
                }
                let mut values = Vec::new();
                for _ in 0..count {
                    values.push(self.one(ty, depth)?);
                }
                Ok(Value::List(values))
            }
        }
    }

    fn one(&mut self, ty: &'a Type, depth: usize) -> Result<Value<'a>, String> {
        match ty {
            Type::Number(scalar) => {
                self.align(scalar.size());
                let bytes = self.take(scalar.size())?;
                Ok(self.number(*scalar, bytes))
            }
            Type::Text => {
                let len = self.count()?;
                let bytes = self.take(len)?;
                // CDR counts the zero behind it.
                Ok(Value::Text(bytes.strip_suffix(&[0]).unwrap_or(bytes)))
            }
            Type::WideText => {
                let len = self.count()?;
                let len = len.checked_mul(2).ok_or_else(|| self.cut(len))?;
                Ok(Value::Text(self.take(len)?))
            }
            Type::Named(name) => {
                let fields = self
                    .schema
                    .fields(name)
                    .ok_or_else(|| format!("has no definition of {name}"))?;
                self.fields(fields, depth + 1)
            }
        }
    }

    fn number(&self, scalar: Scalar, bytes: &[u8]) -> Value<'a> {
        let mut wide = [0; 8];
        match scalar {
            Scalar::F32 | Scalar::F64 => Value::Float(scalar.read_as(bytes, self.is_big_endian).unwrap_or(f64::NAN)),
            Scalar::I64 | Scalar::U64 => {
                wide.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
                Value::Int(if self.is_big_endian {
                    i64::from_be_bytes(wide)
                } else {
                    i64::from_le_bytes(wide)
                })
            }
            _ => Value::Int(scalar.read_as(bytes, self.is_big_endian).unwrap_or_default() as i64),
        }
    }

    /// How many elements or bytes follow.
    fn count(&mut self) -> Result<usize, String> {
        self.align(4);
        let bytes = self.take(4)?;
        Ok(Scalar::U32.read_as(bytes, self.is_big_endian).unwrap_or_default() as usize)
    }

    fn align(&mut self, size: usize) {
        self.at = self.at.next_multiple_of(size.min(self.alignment).max(1));
    }

    fn take(&mut self, len: usize) -> Result<&'a [u8], String> {
        let bytes = self.at.checked_add(len).and_then(|end| self.bytes.get(self.at..end));
        let bytes = bytes.ok_or_else(|| self.cut(len))?;
        self.at += len;
        Ok(bytes)
    }

    fn cut(&self, wanted: usize) -> String {
        format!(
            "{wanted} at byte {} are beyond the {} bytes of the message",
            self.at,
            self.bytes.len()
        )
    }

    fn records(&mut self, count: usize, layout: Layout) -> Result<Value<'a>, String> {
        let Layout { fields, size, first } = layout;
        if count > 0 {
            self.align(first);
        }
        let stride = size.next_multiple_of(first.min(self.alignment).max(1));
        let len = count
            .checked_sub(1)
            .map_or(Some(0), |n| n.checked_mul(stride)?.checked_add(size));
        let bytes = self.take(len.ok_or_else(|| self.cut(count))?)?;
        Ok(Value::Records(Records {
            bytes,
            count,
            stride,
            is_big_endian: self.is_big_endian,
            fields,
        }))
    }

    /// How records of a type lie, if they are made of numbers alone and all lie alike.
    fn layout(&self, name: &str) -> Option<Layout> {
        let mut layout = Layout {
            fields: Vec::new(),
            size: 0,
            first: 0,
        };
        self.lay(name, "", &mut layout, 0)?;
        let widest = layout.fields.iter().map(|(_, _, scalar)| scalar.size()).max()?;
        (self.alignment == 1 || widest.min(self.alignment) <= layout.first.min(self.alignment)).then_some(layout)
    }

    fn lay(&self, name: &str, prefix: &str, layout: &mut Layout, depth: usize) -> Option<()> {
        let fields = self
            .schema
            .fields(name)
            .filter(|fields| depth < MAX_DEPTH && !fields.is_empty())?;
        for field in fields {
            let path = format!("{prefix}{}", field.name);
            match (&field.ty, field.count) {
                (Type::Number(scalar), Count::One) => {
                    let offset = layout.size.next_multiple_of(scalar.size().min(self.alignment).max(1));
                    if layout.fields.is_empty() {
                        layout.first = scalar.size();
                    }
                    layout.fields.push((path, offset, *scalar));
                    layout.size = offset + scalar.size();
                }
                (Type::Named(name), Count::One) => self.lay(name, &format!("{path}."), layout, depth + 1)?,
                _ => return None,
            }
            if layout.fields.len() > 256 {
                return None;
            }
        }
        Some(())
    }
}

struct Layout {
    fields: Vec<(String, usize, Scalar)>,
    size: usize,
    /// Size of the first number.
    first: usize,
}

/// The records of a `sensor_msgs/PointCloud2`.
///
/// # Errors
/// Says which field is impossible, or that the data is too short.
pub(crate) fn cloud<'a>(message: &Value<'a>) -> Result<Rows<'a>, String> {
    let size = |name: &str| usize::try_from(message.int(name)?).map_err(|_| format!("{name} is negative"));
    let (width, height) = (size("width")?, size("height")?);
    let (stride, row_step) = (size("point_step")?, size("row_step")?);
    let bytes = message.bytes("data")?;
    let mut fields = Vec::new();
    for field in message.list("fields")? {
        let (name, offset) = (field.text("name")?, field.int("offset")?);
        let scalar = match field.int("datatype")? {
            1 => Scalar::I8,
            2 => Scalar::U8,
            3 => Scalar::I16,
            4 => Scalar::U16,
            5 => Scalar::I32,
            6 => Scalar::U32,
            7 => Scalar::F32,
            8 => Scalar::F64,
            // Not in the definition of the message, but in use.
            9 => Scalar::I64,
            10 => Scalar::U64,
            other => return Err(format!("field {name} has datatype {other}, which is not known")),
        };
        let offset = usize::try_from(offset).ok().filter(|offset| {
            let end = offset.checked_add(scalar.size());
            end.is_some_and(|end| end <= stride)
        });
        let offset = offset.ok_or_else(|| format!("field {name} lies beyond the {stride} bytes of a point"))?;
        fields.push((name, offset, scalar));
    }
    if width == 0 || height == 0 {
        return Ok(Rows {
            rows: 0,
            row_step: 0,
            row: Records {
                bytes: &[],
                count: 0,
                stride: stride.max(1),
                is_big_endian: false,
                fields,
            },
        });
    }
    if stride == 0 {
        return Err("has points of 0 bytes".to_owned());
    }
    // Some publishers leave row_step at zero.
    let row_step = if row_step == 0 || height == 1 {
        width.saturating_mul(stride)
    } else {
        row_step
    };
    let row_len = width.checked_mul(stride);
    let wanted = row_len.and_then(|row| row_step.checked_mul(height - 1)?.checked_add(row));
    if row_len.is_none_or(|row| row > row_step) || wanted.is_none_or(|wanted| wanted > bytes.len()) {
        return Err(format!(
            "{height} x {width} points of {stride} bytes in rows of {row_step} are more than its {} bytes of data",
            bytes.len()
        ));
    }
    let is_big_endian = message.int("is_bigendian")? != 0;
    Ok(Rows {
        rows: height,
        row_step,
        row: Records {
            bytes,
            count: width,
            stride,
            is_big_endian,
            fields,
        },
    })
}

/// Records in rows: those of an organized cloud, which may have padding between rows.
#[derive(Clone, Debug)]
pub(crate) struct Rows<'a> {
    pub(crate) rows: usize,
    /// Bytes from one row to the next.
    pub(crate) row_step: usize,
    /// The bytes of all rows, and how many records one has.
    pub(crate) row: Records<'a>,
}

impl<'a> Rows<'a> {
    /// Records that are not organized.
    pub(crate) fn one(records: Records<'a>) -> Self {
        Self {
            rows: 1,
            row_step: records.bytes.len(),
            row: records,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.rows * self.row.count
    }

    /// The bytes of each record, in order; those of the last one may end early.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &'a [u8]> + '_ {
        let (row_len, stride) = (self.row.count.saturating_mul(self.row.stride), self.row.stride);
        let bytes = self.row.bytes;
        let rows = (0..self.rows).filter_map(move |row| bytes.get(row.checked_mul(self.row_step)?..));
        rows.flat_map(move |row| {
            row.get(..row_len.min(row.len()))
                .unwrap_or_default()
                .chunks(stride.max(1))
        })
    }

    /// The number of a field by one of its names, the preferred ones first.
    pub(crate) fn find(&self, names: &[&str]) -> Option<usize> {
        let position = |name: &&str| {
            self.row
                .fields
                .iter()
                .position(|(other, ..)| other.eq_ignore_ascii_case(name))
        };
        names.iter().find_map(position)
    }
}
