//! Definitions of messages, as bags have them: the fields of each type in order.

use std::collections::BTreeMap;

use crate::scalar::Scalar;

/// A type of value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Type {
    Number(Scalar),
    Text,
    WideText,
    /// Another definition, by its name.
    Named(String),
}

/// How many values a field has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Count {
    One,
    Fixed(usize),
    Any,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Field {
    pub(crate) name: String,
    pub(crate) ty: Type,
    pub(crate) count: Count,
}

/// The definitions that a message needs; the first one is its own.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Schema {
    pub(crate) root: String,
    types: BTreeMap<String, Vec<Field>>,
}

/// A definition with more types, or a type with more fields, is refused.
const MAX_PARTS: usize = 1000;

impl Schema {
    /// Parses the definition of `kind` with those it needs behind it, each after a line of `=` and a line `MSG: name`.
    ///
    /// # Errors
    /// Says which line cannot be understood.
    pub(crate) fn parse(kind: &str, text: &str) -> Result<Self, String> {
        let mut types: BTreeMap<String, Vec<Field>> = BTreeMap::new();
        let mut current = kind.to_owned();
        types.insert(current.clone(), Vec::new());
        for line in text.lines() {
            let line = line.split('#').next().unwrap_or_default().trim();
            if line.is_empty() || line.starts_with("===") {
                continue;
            }
            if let Some(name) = line.strip_prefix("MSG:") {
                current = plain(name.trim());
                types.insert(current.clone(), Vec::new());
            } else if let Some(field) = field(line, &current).map_err(|why| format!("{current}: {why}"))?
                && let Some(fields) = types.get_mut(&current)
            {
                fields.push(field);
                if fields.len() > MAX_PARTS {
                    return Err(format!("{current} has more than {MAX_PARTS} fields"));
                }
            }
            if types.len() > MAX_PARTS {
                return Err(format!("has more than {MAX_PARTS} types"));
            }
        }
        for (name, fields) in built_in() {
            types.entry(name).or_insert(fields);
        }
        Ok(Self {
            root: kind.to_owned(),
            types,
        })
    }

    /// The fields of a type. A name without a package is looked for in any.
    pub(crate) fn fields(&self, name: &str) -> Option<&[Field]> {
        let exact = self.types.get(name);
        let by_end = || {
            let (_, short) = name.rsplit_once('/')?;
            let mut found = self
                .types
                .iter()
                .filter(|(other, _)| other.rsplit('/').next() == Some(short));
            found.next().map(|(_, fields)| fields)
        };
        exact.or_else(by_end).map(Vec::as_slice)
    }
}

/// Types that definitions need not spell out.
fn built_in() -> [(String, Vec<Field>); 2] {
    let int = |name: &str, scalar| Field {
        name: name.to_owned(),
        ty: Type::Number(scalar),
        count: Count::One,
    };
    ["Time", "Duration"].map(|name| {
        let fields = vec![int("sec", Scalar::I32), int("nanosec", Scalar::U32)];
        (format!("builtin_interfaces/{name}"), fields)
    })
}

fn plain(name: &str) -> String {
    name.replace("/msg/", "/")
}

/// The field that a line declares; `None` for a constant.
fn field(line: &str, current: &str) -> Result<Option<Field>, String> {
    let (ty, rest) = line
        .split_once(char::is_whitespace)
        .ok_or_else(|| format!("{line:?} is no field"))?;
    let rest = rest.trim();
    let name: String = rest
        .chars()
        .take_while(|c| c.is_ascii_alphanumeric() || *c == '_')
        .collect();
    let behind = rest.get(name.len()..).unwrap_or_default().trim_start();
    if name.is_empty() {
        return Err(format!("{line:?} is no field"));
    }
    if behind.starts_with('=') {
        return Ok(None);
    }
    let (element, count) = match ty.split_once('[') {
        None => (ty, Count::One),
        Some((element, count)) => {
            let count = count.strip_suffix(']').ok_or_else(|| format!("{line:?} is no field"))?;
            let count = match count {
                "" => Count::Any,
                bounded if bounded.starts_with("<=") => Count::Any,
                fixed => Count::Fixed(fixed.parse().map_err(|_| format!("{line:?} is no field"))?),
            };
            (element, count)
        }
    };
    let ty = match element.split("<=").next().unwrap_or_default() {
        "string" => Type::Text,
        "wstring" => Type::WideText,
        "bool" | "uint8" | "byte" | "char" | "octet" => Type::Number(Scalar::U8),
        "int8" => Type::Number(Scalar::I8),
        "uint16" => Type::Number(Scalar::U16),
        "int16" => Type::Number(Scalar::I16),
        "uint32" => Type::Number(Scalar::U32),
        "int32" => Type::Number(Scalar::I32),
        "uint64" => Type::Number(Scalar::U64),
        "int64" => Type::Number(Scalar::I64),
        "float32" => Type::Number(Scalar::F32),
        "float64" => Type::Number(Scalar::F64),
        "time" => Type::Named("builtin_interfaces/Time".to_owned()),
        "duration" => Type::Named("builtin_interfaces/Duration".to_owned()),
        "Header" => Type::Named("std_msgs/Header".to_owned()),
        name if name.contains('/') => Type::Named(plain(name)),
        name => {
            let package = current.rsplit_once('/').map_or("", |(package, _)| package);
            Type::Named(format!("{package}/{name}"))
        }
    };
    Ok(Some(Field { name, ty, count }))
}

/// The definition of a type of ROS 2, for bags that have none.
pub(crate) fn known(kind: &str) -> Option<String> {
    let package = kind.split('/').next().unwrap_or_default();
    let short = kind.rsplit('/').next().unwrap_or_default();
    let own = format!("{package}/{short}");
    let mut text = fields_of(&own, package)?.to_owned();
    let (mut told, mut done) = (vec![own], 0);
    while let Some(current) = told.get(done).cloned() {
        done += 1;
        for line in fields_of(&current, package)?.lines() {
            let Some(Field {
                ty: Type::Named(name), ..
            }) = field(line, &current).ok().flatten()
            else {
                continue;
            };
            if !told.contains(&name) {
                let fields = fields_of(&name, package)?;
                text += &format!("\n{:=<80}\nMSG: {name}\n{fields}", "");
                told.push(name);
            }
        }
    }
    Some(text)
}

/// The fields of a known type, line by line; some belong to any package.
fn fields_of(name: &str, package: &str) -> Option<&'static str> {
    let mut texts = KNOWN.split("\n===\n").filter_map(|text| text.split_once('\n'));
    let is_it = |known: &str| match known.strip_prefix("*/") {
        Some(short) => name.strip_prefix(package).and_then(|name| name.strip_prefix('/')) == Some(short),
        None => known == name,
    };
    texts.find(|(known, _)| is_it(known)).map(|(_, fields)| fields)
}

const KNOWN: &str = include_str!("known.msg");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definitions_are_understood() {
        let text = "# remark\nHeader header\nuint8 A=1\nstring<=5 name \"none\"\nPoint[] points\nfloat64[9] k\n\
            int16[<=4] few\n=====\nMSG: std_msgs/msg/Header\nuint32 seq\ntime stamp\nstring frame_id\n===\nMSG: p/Point\nfloat32 x 1.0\n";
        let schema = Schema::parse("p/Cloud", text).unwrap();
        let fields = schema.fields("p/Cloud").unwrap();
        let names: Vec<_> = fields.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, ["header", "name", "points", "k", "few"]);
        assert_eq!(fields[2].ty, Type::Named("p/Point".into()));
        assert_eq!((fields[3].count, fields[4].count), (Count::Fixed(9), Count::Any));
        assert_eq!(schema.fields("std_msgs/Header").unwrap().len(), 3);
        assert!(schema.fields("p/Missing").is_none());
    }

    #[test]
    fn what_is_no_definition_is_told() {
        for bad in [
            "uint8",
            "uint8[x] a",
            "uint8[3 a",
            "uint8 [",
            "uint8[99999999999999999999] a",
        ] {
            let told = Schema::parse("p/A", bad).unwrap_err();
            assert_eq!(told, format!("p/A: {bad:?} is no field"));
        }
    }

    #[test]
    fn all_known_definitions_parse() {
        for text in KNOWN.split("\n===\n") {
            let kind = text.lines().next().unwrap().replace('*', "any");
            let text = known(&kind).unwrap();
            let schema = Schema::parse(&kind, &text).unwrap();
            assert!(!schema.fields(&kind).unwrap().is_empty(), "{kind}");
            // As ROS writes them: what a definition needs, once, behind lines of 80 signs.
            for part in text.split(&format!("\n{}\nMSG: ", "=".repeat(80))).skip(1) {
                let name = part.lines().next().unwrap();
                assert_eq!(text.matches(&format!("MSG: {name}\n")).count(), 1, "{kind}: {name}");
            }
            assert!(!text.contains("MSG: ") || text.matches("MSG: ").count() == text.matches(&"=".repeat(80)).count());
        }
        assert!(!known("sensor_msgs/Imu").unwrap().contains("nav_msgs"));
    }
}
