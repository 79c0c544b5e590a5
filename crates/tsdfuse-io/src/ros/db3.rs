//! ROS 2 bags in SQLite files (`.db3`).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use rusqlite::{Connection, OpenFlags};

use super::container::{Channel, Container, Data, Encoding, Entry, MAX_MESSAGE, NO_CHUNK};
use crate::error::{Error, Result};

/// The index of a SQLite bag.
pub(crate) struct Db3 {
    path: PathBuf,
    connection: Mutex<Connection>,
    channels: Vec<Channel>,
    entries: Vec<Vec<Entry>>,
}

impl Db3 {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let wrong = |e: rusqlite::Error| wrong(path, &e);
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags).map_err(wrong)?;
        let (numbers, channels) = channels(&connection).map_err(wrong)?;
        let mut entries = vec![Vec::new(); channels.len()];
        let index = |entries: &mut Vec<Vec<Entry>>| {
            let mut statement =
                connection.prepare("SELECT id, topic_id, timestamp FROM messages ORDER BY timestamp, id")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                let (id, topic, time_ns): (i64, i64, i64) = (row.get(0)?, row.get(1)?, row.get(2)?);
                let list = numbers.get(&topic).and_then(|&number: &usize| entries.get_mut(number));
                if let Some(list) = list {
                    list.push(Entry {
                        time_ns,
                        part: 0,
                        chunk: NO_CHUNK,
                        offset: id.cast_unsigned(),
                    });
                }
            }
            Ok(())
        };
        index(&mut entries).map_err(wrong)?;
        Ok(Self {
            path: path.to_owned(),
            connection: Mutex::new(connection),
            channels,
            entries,
        })
    }

    fn connection(&self) -> MutexGuard<'_, Connection> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn wrong(path: &Path, error: &rusqlite::Error) -> Error {
    let text = error.to_string().replace('\n', " ");
    Error::format(path, format!("is no SQLite bag of ROS 2, or damaged: {text}"))
}

/// The channels, and where each topic's is.
fn channels(connection: &Connection) -> rusqlite::Result<(BTreeMap<i64, usize>, Vec<Channel>)> {
    let mut definitions: BTreeMap<String, String> = BTreeMap::new();
    // Older bags have no such table.
    let sql = "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'";
    if let Ok(mut statement) = connection.prepare(sql) {
        let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
        definitions.extend(rows.filter_map(Result::ok));
    }
    let mut statement = connection.prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id")?;
    let (mut numbers, mut channels) = (BTreeMap::new(), Vec::new());
    let mut rows = statement.query([])?;
    while let Some(row) = rows.next()? {
        let (id, topic, kind, format): (i64, String, String, String) =
            (row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?);
        let encoding = if format == "cdr" {
            Encoding::Cdr
        } else {
            Encoding::Other
        };
        let schema = definitions.get(&kind).map_or("", String::as_str);
        numbers.insert(id, channels.len());
        channels.push(Channel::new(&topic, &kind, encoding, schema));
    }
    Ok((numbers, channels))
}

impl Container for Db3 {
    fn format(&self) -> &str {
        "ROS 2 bag (SQLite)"
    }

    fn channels(&self) -> &[Channel] {
        &self.channels
    }

    fn entries(&self, channel: usize) -> &[Entry] {
        self.entries.get(channel).map_or(&[], Vec::as_slice)
    }

    fn read(&self, entry: &Entry, limit: usize) -> Result<Data> {
        let connection = self.connection();
        let read = || {
            let row = entry.offset.cast_signed();
            let blob = connection.blob_open("main", "messages", "data", row, true)?;
            let len = blob.len().min(limit);
            if len as u64 > MAX_MESSAGE {
                return Ok(None);
            }
            let mut bytes = vec![0; len];
            blob.read_at_exact(&mut bytes, 0)?;
            Ok(Some(Data::Own(bytes)))
        };
        read().map_err(|e| wrong(&self.path, &e))?.ok_or_else(|| {
            let reason = format!("message {} has more than {MAX_MESSAGE} bytes", entry.offset);
            Error::format(&self.path, reason)
        })
    }

    fn notes(&self) -> &[String] {
        &[]
    }
}
