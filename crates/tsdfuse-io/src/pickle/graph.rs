//! What a pickle describes: plain values, containers, and objects that were never made.

use super::array::latin1;
use std::borrow::Cow;

/// The classes and functions of a pickled DataFrame. Two that are read alike share an entry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Class {
    DataFrame,
    BlockManager,
    Block,
    Partial,
    Slice,
    NewIndex,
    Index,
    BackedArray,
    ArrowStringArray,
    ArrowArray,
    ArrowBuffer,
    ArrowType,
    StringDtype,
    Reconstruct,
    FromBuffer,
    NdArray,
    Dtype,
    Encode,
}

impl Class {
    /// The class of that name, if DataFrames need it.
    pub(super) fn named(module: &str, name: &str) -> Option<Self> {
        Some(match (module, name) {
            ("pandas.core.frame" | "pandas", "DataFrame") => Self::DataFrame,
            ("pandas.core.internals.managers" | "pandas.core.internals", "BlockManager") => Self::BlockManager,
            ("pandas._libs.internals", "_unpickle_block") | ("pandas.core.internals.blocks", "new_block") => {
                Self::Block
            }
            ("functools", "partial") => Self::Partial,
            ("builtins" | "__builtin__", "slice") => Self::Slice,
            ("pandas.core.indexes.base", "_new_Index") => Self::NewIndex,
            ("pandas.core.indexes.base" | "pandas", "Index")
            | ("pandas.core.indexes.range" | "pandas", "RangeIndex")
            | ("pandas.core.indexes.numeric", "Int64Index" | "UInt64Index" | "Float64Index") => Self::Index,
            ("pandas._libs.arrays", "__pyx_unpickle_NDArrayBacked") | ("pandas.arrays", "StringArray") => {
                Self::BackedArray
            }
            ("pandas.arrays", "ArrowStringArray") => Self::ArrowStringArray,
            ("pyarrow.lib", "_restore_array") => Self::ArrowArray,
            ("pyarrow.lib", "py_buffer") => Self::ArrowBuffer,
            ("pyarrow.lib", "type_for_alias") => Self::ArrowType,
            ("pandas", "StringDtype") => Self::StringDtype,
            ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => Self::Reconstruct,
            ("numpy.core.numeric" | "numpy._core.numeric", "_frombuffer") => Self::FromBuffer,
            ("numpy", "ndarray") => Self::NdArray,
            ("numpy", "dtype") => Self::Dtype,
            ("_codecs", "encode") => Self::Encode,
            _ => return None,
        })
    }
}

/// A value: text and bytes lie in the input, everything compound in the graph's nodes.
#[derive(Clone, Copy, Debug)]
pub(super) enum Value<'a> {
    None,
    Bool(bool),
    Int(i64),
    Float,
    Str(&'a str),
    Bytes(&'a [u8]),
    Class(Class),
    Node(usize),
}

/// A container or an object.
#[derive(Debug)]
pub(super) enum Node<'a> {
    Tuple(Vec<Value<'a>>),
    List(Vec<Value<'a>>),
    Dict(Vec<(Value<'a>, Value<'a>)>),
    /// What Python would have made by calling `class(*args)` and then setting `state`.
    Object {
        class: Class,
        args: Value<'a>,
        state: Value<'a>,
    },
}

/// Everything a pickle describes.
#[derive(Debug)]
pub(super) struct Graph<'a> {
    pub(super) nodes: Vec<Node<'a>>,
    pub(super) root: Value<'a>,
}

impl<'a> Graph<'a> {
    fn node(&self, value: Value<'a>) -> Option<&Node<'a>> {
        match value {
            Value::Node(n) => self.nodes.get(n),
            _ => None,
        }
    }

    /// The entries of a tuple or list.
    pub(super) fn entries(&self, value: Value<'a>) -> Option<&[Value<'a>]> {
        match self.node(value)? {
            Node::Tuple(entries) | Node::List(entries) => Some(entries),
            _ => None,
        }
    }

    /// Entry `i` of a tuple or list.
    pub(super) fn entry(&self, value: Value<'a>, i: usize) -> Option<Value<'a>> {
        self.entries(value)?.get(i).copied()
    }

    /// The value of a dict's text key.
    pub(super) fn get(&self, value: Value<'a>, key: &str) -> Option<Value<'a>> {
        match self.node(value)? {
            Node::Dict(entries) => entries
                .iter()
                .find_map(|&(k, v)| matches!(k, Value::Str(k) if k == key).then_some(v)),
            _ => None,
        }
    }

    /// The class, arguments and state of an object.
    pub(super) fn object(&self, value: Value<'a>) -> Option<(Class, Value<'a>, Value<'a>)> {
        match *self.node(value)? {
            Node::Object { class, args, state } => Some((class, args, state)),
            _ => None,
        }
    }

    /// Arguments and state of an object of that class.
    pub(super) fn object_of(&self, value: Value<'a>, wanted: Class) -> Option<(Value<'a>, Value<'a>)> {
        let (class, args, state) = self.object(value)?;
        (class == wanted).then_some((args, state))
    }

    /// Bytes, also in the form that protocol 2 gives them: text to be encoded as Latin-1.
    pub(super) fn bytes(&self, value: Value<'a>) -> Option<Cow<'a, [u8]>> {
        if let Value::Bytes(bytes) = value {
            return Some(Cow::Borrowed(bytes));
        }
        let (args, _) = self.object_of(value, Class::Encode)?;
        match self.entries(args)? {
            [Value::Str(text), Value::Str("latin1")] => latin1(text).map(Cow::Owned),
            _ => None,
        }
    }
}

impl<'a> Value<'a> {
    /// An integer that counts something.
    pub(super) fn count(self) -> Option<usize> {
        match self {
            Value::Int(n) => n.try_into().ok(),
            _ => None,
        }
    }

    /// Text.
    pub(super) fn text(self) -> Option<&'a str> {
        match self {
            Value::Str(text) => Some(text),
            _ => None,
        }
    }
}
