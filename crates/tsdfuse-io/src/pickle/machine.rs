//! The stack machine: runs a pickle (protocols 2 to 5) into a [`Graph`] and calls nothing.

use std::collections::HashMap;

use super::graph::{Class, Graph, Node, Value};

/// A DataFrame of numbers takes some 300 operations, however long it is; one with a text in each row some 10⁵.
const MAX_OPERATIONS: usize = 1 << 20;

/// Runs the pickle up to its STOP.
///
/// # Errors
/// Names the byte and the reason, or the class that is foreign to DataFrames.
pub(super) fn run(input: &[u8]) -> Result<Graph<'_>, String> {
    if input.first() != Some(&0x80) {
        return Err("is no pickle of protocol 2 or later".into());
    }
    let mut machine = Machine {
        input,
        at: 0,
        stack: Vec::new(),
        marks: Vec::new(),
        memo: HashMap::new(),
        nodes: Vec::new(),
        encoded: 0,
    };
    for _ in 0..MAX_OPERATIONS {
        let start = machine.at;
        match machine.step() {
            Ok(None) => {}
            Ok(Some(root)) => {
                let nodes = machine.nodes;
                return Ok(Graph { nodes, root });
            }
            Err(Fault::Foreign(class)) => {
                return Err(format!("foreign class {class}: only DataFrames of numbers are read"));
            }
            Err(Fault::At(reason)) => return Err(format!("byte {start} of the pickle: {reason}")),
        }
    }
    Err(format!(
        "needs more than {MAX_OPERATIONS} operations: no DataFrame of numbers does"
    ))
}

enum Fault {
    At(&'static str),
    Foreign(String),
}

type Step<T> = Result<T, Fault>;

const TRUNCATED: Fault = Fault::At("the file ends here");
const UNDERFLOW: Fault = Fault::At("takes more from the stack than there is");

struct Machine<'a> {
    input: &'a [u8],
    at: usize,
    stack: Vec<Value<'a>>,
    /// Heights of the stack at each open MARK.
    marks: Vec<usize>,
    memo: HashMap<u32, Value<'a>>,
    nodes: Vec<Node<'a>>,
    /// Bytes made from text so far.
    encoded: usize,
}

impl<'a> Machine<'a> {
    /// One operation; the result at STOP.
    fn step(&mut self) -> Step<Option<Value<'a>>> {
        let value = match self.byte()? {
            0x80 => return self.take(1).map(|_| None), // PROTO
            0x95 => return self.take(8).map(|_| None), // FRAME: how much to read ahead
            b'.' => return self.pop().map(Some),       // STOP
            b'(' => return self.mark(),
            b'0' => return self.pop().map(|_| None),      // POP
            b'1' => return self.pop_mark().map(|_| None), // POP_MARK
            b'2' => self.top()?,                          // DUP
            b'N' => Value::None,
            b'\x88' => Value::Bool(true),
            b'\x89' => Value::Bool(false),
            b'J' => Value::Int(i32::from_le_bytes(self.array()?).into()), // BININT
            b'K' => Value::Int(self.byte()?.into()),                      // BININT1
            b'M' => Value::Int(u16::from_le_bytes(self.array()?).into()), // BININT2
            b'\x8a' => self.long1()?,
            b'G' => self.take(8).map(|_| Value::Float)?, // BINFLOAT: none that matter here
            b'\x8c' => self.text1().and_then(|n| self.text(n))?, // SHORT_BINUNICODE
            b'X' => self.length4().and_then(|n| self.text(n))?, // BINUNICODE
            b'\x8d' => self.length8().and_then(|n| self.text(n))?, // BINUNICODE8
            b'C' => self.text1().and_then(|n| self.take(n)).map(Value::Bytes)?, // SHORT_BINBYTES
            b'B' => self.length4().and_then(|n| self.take(n)).map(Value::Bytes)?, // BINBYTES
            b'\x8e' | b'\x96' => self.length8().and_then(|n| self.take(n)).map(Value::Bytes)?, // BINBYTES8, BYTEARRAY8
            b')' => self.node(Node::Tuple(Vec::new())),  // EMPTY_TUPLE
            b']' => self.node(Node::List(Vec::new())),   // EMPTY_LIST
            b'}' => self.node(Node::Dict(Vec::new())),   // EMPTY_DICT
            b'\x85' => self.tuple(1)?,
            b'\x86' => self.tuple(2)?,
            b'\x87' => self.tuple(3)?,
            b't' => self.pop_mark().map(|entries| self.node(Node::Tuple(entries)))?, // TUPLE
            b'l' => self.pop_mark().map(|entries| self.node(Node::List(entries)))?,  // LIST
            b'd' => {
                // DICT
                let entries = pairs(&self.pop_mark()?)?;
                self.node(Node::Dict(entries))
            }
            b'a' => return self.pop().and_then(|value| self.append(vec![value])), // APPEND
            b'e' => return self.pop_mark().and_then(|values| self.append(values)), // APPENDS
            b's' => return self.pop_n(2).and_then(|pair| self.set(&pair)),        // SETITEM
            b'u' => return self.pop_mark().and_then(|values| self.set(&values)),  // SETITEMS
            b'c' => {
                // GLOBAL
                let (module, name) = (self.line()?, self.line()?);
                class(module, name)?
            }
            b'\x93' => {
                // STACK_GLOBAL
                match (self.pop_n(2)?).as_slice() {
                    [Value::Str(module), Value::Str(name)] => class(module, name)?,
                    _ => return Err(Fault::At("names a class by something that is not text")),
                }
            }
            b'R' | b'\x81' => self.object()?, // REDUCE, NEWOBJ
            b'b' => return self.build(),
            b'h' => self.byte().and_then(|key| self.recall(key.into()))?, // BINGET
            b'j' => {
                // LONG_BINGET
                let key = u32::from_le_bytes(self.array()?);
                self.recall(key)?
            }
            b'q' => return self.byte().and_then(|key| self.memoize(key.into())), // BINPUT
            b'r' => {
                // LONG_BINPUT
                let key = u32::from_le_bytes(self.array()?);
                return self.memoize(key);
            }
            b'\x94' => return self.memoize(u32::try_from(self.memo.len()).unwrap_or(u32::MAX)), // MEMOIZE
            _ => return Err(Fault::At("an operation that DataFrames do not need")),
        };
        self.stack.push(value);
        Ok(None)
    }

    fn take(&mut self, n: usize) -> Step<&'a [u8]> {
        let end = self.at.checked_add(n).ok_or(TRUNCATED)?;
        let taken = self.input.get(self.at..end).ok_or(TRUNCATED)?;
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Step<[u8; N]> {
        self.take(N)?.try_into().map_err(|_| TRUNCATED)
    }

    fn byte(&mut self) -> Step<u8> {
        self.array().map(|[byte]| byte)
    }

    fn text1(&mut self) -> Step<usize> {
        self.byte().map(usize::from)
    }

    fn length4(&mut self) -> Step<usize> {
        usize::try_from(u32::from_le_bytes(self.array()?)).map_err(|_| TRUNCATED)
    }

    fn length8(&mut self) -> Step<usize> {
        usize::try_from(u64::from_le_bytes(self.array()?)).map_err(|_| TRUNCATED)
    }

    fn text(&mut self, n: usize) -> Step<Value<'a>> {
        let text = std::str::from_utf8(self.take(n)?);
        text.map(Value::Str).map_err(|_| Fault::At("text that is not UTF-8"))
    }

    fn line(&mut self) -> Step<&'a str> {
        let rest = self.input.get(self.at..).ok_or(TRUNCATED)?;
        let n = rest.iter().position(|&b| b == b'\n').ok_or(TRUNCATED)?;
        let line = self.take(n + 1)?.get(..n).ok_or(TRUNCATED)?;
        std::str::from_utf8(line).map_err(|_| Fault::At("text that is not UTF-8"))
    }

    fn long1(&mut self) -> Step<Value<'a>> {
        let bytes = self.text1().and_then(|n| self.take(n))?;
        let negative = bytes.last().is_some_and(|b| b & 0x80 != 0);
        let mut wide = [if negative { 0xff } else { 0 }; 8];
        let low = wide
            .get_mut(..bytes.len())
            .ok_or(Fault::At("an integer of more than 64 bits"))?;
        low.copy_from_slice(bytes);
        Ok(Value::Int(i64::from_le_bytes(wide)))
    }

    fn node(&mut self, node: Node<'a>) -> Value<'a> {
        self.nodes.push(node);
        Value::Node(self.nodes.len() - 1)
    }

    fn mark(&mut self) -> Step<Option<Value<'a>>> {
        self.marks.push(self.stack.len());
        Ok(None)
    }

    /// How much of the stack lies under the last MARK, out of reach.
    fn floor(&self) -> usize {
        self.marks.last().copied().unwrap_or(0)
    }

    fn top(&self) -> Step<Value<'a>> {
        let reachable = self.stack.get(self.floor()..).and_then(<[_]>::last);
        reachable.copied().ok_or(UNDERFLOW)
    }

    fn pop(&mut self) -> Step<Value<'a>> {
        let top = self.top()?;
        self.stack.pop();
        Ok(top)
    }

    fn pop_n(&mut self, n: usize) -> Step<Vec<Value<'a>>> {
        let from = self.stack.len().checked_sub(n).filter(|&from| from >= self.floor());
        Ok(self.stack.split_off(from.ok_or(UNDERFLOW)?))
    }

    fn pop_mark(&mut self) -> Step<Vec<Value<'a>>> {
        let mark = self.marks.pop().ok_or(Fault::At("no MARK is open"))?;
        Ok(self.stack.split_off(mark.min(self.stack.len())))
    }

    fn tuple(&mut self, n: usize) -> Step<Value<'a>> {
        let entries = self.pop_n(n)?;
        Ok(self.node(Node::Tuple(entries)))
    }

    fn top_node(&mut self) -> Step<&mut Node<'a>> {
        let Value::Node(n) = self.top()? else {
            return Err(Fault::At("changes what cannot be changed"));
        };
        self.nodes.get_mut(n).ok_or(UNDERFLOW)
    }

    fn append(&mut self, values: Vec<Value<'a>>) -> Step<Option<Value<'a>>> {
        match self.top_node()? {
            Node::List(list) => list.extend(values),
            _ => return Err(Fault::At("appends to what is no list")),
        }
        Ok(None)
    }

    fn set(&mut self, values: &[Value<'a>]) -> Step<Option<Value<'a>>> {
        let new = pairs(values)?;
        match self.top_node()? {
            Node::Dict(dict) => dict.extend(new),
            _ => return Err(Fault::At("sets a key of what is no dict")),
        }
        Ok(None)
    }

    /// Notes down what Python would call.
    fn object(&mut self) -> Step<Value<'a>> {
        let (args, callable) = (self.pop()?, self.pop()?);
        let class = match callable {
            Value::Class(class) => Some(class),
            Value::Node(n) => self.partial(n),
            _ => None,
        };
        let class = class.ok_or(Fault::At("calls what is no class"))?;
        if class == Class::Encode {
            return self.encode(args);
        }
        let state = Value::None;
        Ok(self.node(Node::Object { class, args, state }))
    }

    /// Bytes from Latin-1 text; not more in all than there is text, so that none is copied again and again.
    fn encode(&mut self, args: Value<'a>) -> Step<Value<'a>> {
        let text = match args {
            Value::Node(n) => match self.nodes.get(n) {
                Some(Node::Tuple(args)) => match *args.as_slice() {
                    [Value::Str(text), Value::Str("latin1")] => Some(text),
                    _ => None,
                },
                _ => None,
            },
            _ => None,
        };
        let text = text.ok_or(Fault::At("encodes what is no Latin-1 text"))?;
        self.encoded += text.len();
        if self.encoded > self.input.len() {
            return Err(Fault::At("encodes the same text again and again"));
        }
        let bytes: Option<_> = text.chars().map(|c| u8::try_from(c).ok()).collect();
        let bytes = bytes.ok_or(Fault::At("encodes what is no Latin-1 text"))?;
        Ok(self.node(Node::Encoded(bytes)))
    }

    /// The function that `functools.partial` holds.
    fn partial(&self, n: usize) -> Option<Class> {
        let Some(&Node::Object {
            class: Class::Partial,
            args: Value::Node(args),
            ..
        }) = self.nodes.get(n)
        else {
            return None;
        };
        match self.nodes.get(args)? {
            Node::Tuple(args) => args.first().and_then(|f| match f {
                Value::Class(class) => Some(*class),
                _ => None,
            }),
            _ => None,
        }
    }

    fn build(&mut self) -> Step<Option<Value<'a>>> {
        let new = self.pop()?;
        match self.top_node()? {
            Node::Object { state, .. } => *state = new,
            _ => return Err(Fault::At("sets the state of what is no object")),
        }
        Ok(None)
    }

    fn recall(&self, key: u32) -> Step<Value<'a>> {
        self.memo
            .get(&key)
            .copied()
            .ok_or(Fault::At("recalls what was never memoized"))
    }

    fn memoize(&mut self, key: u32) -> Step<Option<Value<'a>>> {
        let top = self.top()?;
        self.memo.insert(key, top);
        Ok(None)
    }
}

fn class<'a>(module: &str, name: &str) -> Step<Value<'a>> {
    let class = Class::named(module, name).map(Value::Class);
    class.ok_or_else(|| Fault::Foreign(format!("{module}.{name}").escape_default().take(120).collect()))
}

fn pairs<'a>(values: &[Value<'a>]) -> Step<Vec<(Value<'a>, Value<'a>)>> {
    let (pairs, rest) = values.as_chunks();
    match rest {
        [] => Ok(pairs.iter().map(|&[k, v]| (k, v)).collect()),
        _ => Err(Fault::At("a key without a value")),
    }
}
