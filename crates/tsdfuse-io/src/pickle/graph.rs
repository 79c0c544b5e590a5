//! What a pickle describes: plain values, containers, and objects that are only described, never constructed.

use std::ops::Deref;
use std::rc::Rc;

/// The classes and functions of a pickled DataFrame. Those that are read in the same way share an entry.
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

/// A value. Text and bytes stay in the input; everything compound is a node of the graph.
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
    /// Bytes that protocol 2 writes as text, to be encoded as Latin-1.
    Encoded(Rc<[u8]>),
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

    /// Bytes, in whichever way they were written.
    pub(super) fn bytes(&self, value: Value<'a>) -> Option<Bytes<'a>> {
        match (value, self.node(value)) {
            (Value::Bytes(bytes), _) => Some(Bytes::InPickle(bytes)),
            (_, Some(Node::Encoded(bytes))) => Some(Bytes::Encoded(Rc::clone(bytes))),
            _ => None,
        }
    }
}

/// Bytes in the pickle, or decoded from its text.
#[derive(Debug)]
pub(super) enum Bytes<'a> {
    InPickle(&'a [u8]),
    Encoded(Rc<[u8]>),
}

impl Deref for Bytes<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::InPickle(bytes) => bytes,
            Self::Encoded(bytes) => bytes,
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
