//! The columns of a pickled DataFrame.

use super::array::{Array, objects};
use super::graph::{Class, Graph, Value};
use super::machine;

/// The most rows of a scan. A sweep has some 170 000 returns.
const MAX_ROWS: usize = 1 << 22;

/// The most columns of a scan.
const MAX_COLUMNS: usize = 1 << 12;

/// A DataFrame: named columns of numbers, all of one length.
///
/// pandas keeps columns of one type together as the rows of a *block*; a *placement* says which columns these are.
#[derive(Debug)]
pub(crate) struct DataFrame<'a> {
    names: Vec<Option<&'a str>>,
    blocks: Vec<Result<Array<'a>, String>>,
    /// Block and row of each column.
    places: Vec<Option<(usize, usize)>>,
}

impl<'a> DataFrame<'a> {
    /// Reads the structure of a pickle; the numbers stay in place.
    ///
    /// # Errors
    /// One line that says why this is no DataFrame of numbers.
    pub(crate) fn new(pickle: &'a [u8]) -> Result<Self, String> {
        let graph = machine::run(pickle)?;
        let (columns, blocks) = layout(&graph).ok_or("holds no pandas DataFrame of a known layout")?;
        let names = names(&graph, columns).ok_or("the names of the columns have an unknown layout")?;
        if names.len() > MAX_COLUMNS {
            return Err(format!("{} columns: no scan has more than {MAX_COLUMNS}", names.len()));
        }
        let mut frame = Self {
            places: vec![None; names.len()],
            names,
            blocks: Vec::new(),
        };
        for (values, placement) in blocks {
            frame.add_block(Array::new(&graph, values), &Placement::new(&graph, placement)?)?;
        }
        Ok(frame)
    }

    /// Adds a block. If it holds no numbers, that is an error only when one of its columns is asked for.
    fn add_block(&mut self, block: Result<Array<'a>, String>, placement: &Placement) -> Result<(), String> {
        let columns = placement.columns().unwrap_or(0);
        if let Ok(block) = &block
            && block.rows != columns
        {
            return Err(format!("a block of {} rows for {columns} columns", block.rows));
        }
        if let Ok(block) = &block
            && block.len > MAX_ROWS
        {
            return Err(format!("{} rows: no scan has more than {MAX_ROWS}", block.len));
        }
        if let (Ok(new), Some(Ok(known))) = (&block, self.blocks.iter().find(|b| b.is_ok()))
            && new.len != known.len
        {
            return Err(format!("columns of {} and of {} rows", known.len, new.len));
        }
        for row in 0..columns {
            let place = placement.column(row).and_then(|column| self.places.get_mut(column));
            let place = place.ok_or_else(|| format!("a block of {columns} columns that are not all in the table"))?;
            if place.replace((self.blocks.len(), row)).is_some() {
                return Err("a column with two blocks of values".into());
            }
        }
        self.blocks.push(block);
        Ok(())
    }

    /// The numbers of a column.
    ///
    /// # Errors
    /// There is no such column, or it holds no numbers.
    pub(crate) fn column(&self, name: &str) -> Result<Vec<f64>, String> {
        let column = self.names.iter().position(|n| *n == Some(name));
        let column = column.ok_or_else(|| format!("no column '{name}'"))?;
        let place = self.places.get(column).copied().flatten();
        let (block, row) = place.ok_or_else(|| format!("column '{name}' has no values"))?;
        match self.blocks.get(block) {
            Some(Ok(block)) => Ok(block.row(row)),
            Some(Err(reason)) => Err(format!("column '{name}': {reason}")),
            None => Err(format!("column '{name}' has no values")),
        }
    }
}

/// A block's values and placement, not yet read.
type RawBlock<'a> = (Value<'a>, Value<'a>);

/// The index of the columns, and the blocks.
fn layout<'a>(graph: &Graph<'a>) -> Option<(Value<'a>, Vec<RawBlock<'a>>)> {
    let (_, state) = graph.object_of(graph.root, Class::DataFrame)?;
    let manager = graph.get(state, "_mgr").or_else(|| graph.get(state, "_data"))?;
    let (args, state) = graph.object_of(manager, Class::BlockManager)?;
    let (axes, blocks) = match graph.entries(args)? {
        // Since pandas 1.3: BlockManager(blocks, axes), a block being made by a call.
        &[blocks, axes] => {
            let blocks = graph.entries(blocks)?.iter().map(|&block| {
                let (args, _) = graph.object_of(block, Class::Block)?;
                Some((graph.entry(args, 0)?, graph.entry(args, 1)?))
            });
            (axes, blocks.collect::<Option<_>>()?)
        }
        // Before that, and in PandaSet's own files: a state whose last entry describes the blocks in the layout of pandas 0.14.1.
        _ => {
            let described = graph.get(*graph.entries(state)?.last()?, "0.14.1")?;
            let blocks = graph.entries(graph.get(described, "blocks")?)?;
            let blocks = blocks
                .iter()
                .map(|&b| Some((graph.get(b, "values")?, graph.get(b, "mgr_locs")?)));
            (graph.get(described, "axes")?, blocks.collect::<Option<_>>()?)
        }
    };
    Some((graph.entry(axes, 0)?, blocks))
}

/// The names in an index; `None` for a label that is not text.
fn names<'a>(graph: &Graph<'a>, index: Value<'a>) -> Option<Vec<Option<&'a str>>> {
    let (args, _) = graph.object_of(index, Class::NewIndex)?;
    let data = graph.get(graph.entry(args, 1)?, "data")?;
    let labels = match graph.object(data)? {
        (Class::BackedArray, _, state) => objects(graph, graph.entry(state, 1)?)?,
        (Class::ArrowStringArray, _, state) => return arrow_names(graph, graph.get(state, "_pa_array")?),
        _ => objects(graph, data)?,
    };
    Some(labels.iter().map(|label| label.text()).collect())
}

/// The strings of a pickled Arrow array of type `large_string`: 64-bit offsets into one piece of UTF-8.
fn arrow_names<'a>(graph: &Graph<'a>, array: Value<'a>) -> Option<Vec<Option<&'a str>>> {
    let (args, _) = graph.object_of(array, Class::ArrowArray)?;
    let &[_, len, _, Value::Int(0), buffers, ..] = graph.entries(graph.entry(args, 0)?)? else {
        return None;
    };
    let len = len.count().filter(|&len| len <= MAX_COLUMNS)?;
    let buffer = |i: usize| {
        let (args, _) = graph.object_of(graph.entry(buffers, i)?, Class::ArrowBuffer)?;
        match graph.entry(args, 0)? {
            Value::Bytes(bytes) => Some(bytes),
            _ => None,
        }
    };
    let (offsets, text) = (buffer(1)?, buffer(2)?);
    let ends = offsets.as_chunks().0.get(..=len)?.iter();
    let ends: Vec<usize> = ends
        .map(|&b| u64::from_le_bytes(b).try_into().ok())
        .collect::<Option<_>>()?;
    let names = ends.windows(2).map(|w| match *w {
        [from, to] => Some(std::str::from_utf8(text.get(from..to)?).ok()),
        _ => None,
    });
    names.collect()
}

/// Which columns the rows of a block are.
enum Placement {
    Slice { start: i64, stop: i64, step: i64 },
    List(Vec<f64>),
}

impl Placement {
    fn new<'a>(graph: &Graph<'a>, value: Value<'a>) -> Result<Self, String> {
        if let Some((args, _)) = graph.object_of(value, Class::Slice)
            && let Some(&[Value::Int(start), stop, Value::Int(step)]) = graph.entries(args)
        {
            // A slice that runs down to column 0 has no stop.
            let stop = if let Value::Int(stop) = stop { stop } else { -1 };
            return Ok(Self::Slice { start, stop, step });
        }
        let list = Array::new(graph, value).map_err(|reason| format!("the place of a block: {reason}"))?;
        Ok(Self::List(list.row(0)))
    }

    /// How many columns there are.
    fn columns(&self) -> Option<usize> {
        match self {
            Self::Slice { start, stop, step } => {
                let span = stop.checked_sub(*start)?;
                usize::try_from(span.checked_add(step.checked_sub(step.signum())?)?.checked_div(*step)?).ok()
            }
            Self::List(list) => Some(list.len()),
        }
    }

    /// The column of a block's row.
    fn column(&self, row: usize) -> Option<usize> {
        match self {
            Self::Slice { start, step, .. } => {
                let shift = step.checked_mul(row.try_into().ok()?)?;
                start.checked_add(shift)?.try_into().ok()
            }
            Self::List(list) => {
                let column = *list.get(row)?;
                (column >= 0.0 && column < f64::from(u32::MAX)).then_some(column as usize)
            }
        }
    }
}
