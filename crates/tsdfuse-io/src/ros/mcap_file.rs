//! Messages into an MCAP file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions};

use super::schema::known;
use super::sink::Sink;
use crate::atomic::AtomicFile;
use crate::error::{Error, Result};

/// Chunks that hold a sweep or two.
const CHUNK: u64 = 4 << 20;

/// A file that appears when it is finished.
pub(super) struct McapFile {
    path: PathBuf,
    mcap: mcap::Writer<AtomicFile>,
}

impl McapFile {
    pub(super) fn create(path: &Path) -> Result<Self> {
        let file = AtomicFile::create(path)?;
        let options = WriteOptions::new()
            .profile("ros2")
            .library("tsdfuse")
            .compression(None)
            .chunk_size(Some(CHUNK));
        Ok(Self {
            path: path.to_owned(),
            mcap: options.create(file).map_err(wrong(path))?,
        })
    }
}

fn wrong(path: &Path) -> impl FnOnce(McapError) -> Error {
    move |error| Error::format(path, error.to_string())
}

impl Sink for McapFile {
    fn path(&self) -> &Path {
        &self.path
    }

    fn channel(&mut self, topic: &str, kind: &str) -> Result<u16> {
        let text = known(kind).unwrap_or_default();
        let schema = self
            .mcap
            .add_schema(&kind.replace('/', "/msg/"), "ros2msg", text.as_bytes())
            .map_err(wrong(&self.path))?;
        let channel = self.mcap.add_channel(schema, topic, "cdr", &BTreeMap::new());
        channel.map_err(wrong(&self.path))
    }

    fn send(&mut self, channel_id: u16, time_ns: u64, message: Vec<u8>) -> Result<()> {
        let header = MessageHeader {
            channel_id,
            sequence: 0,
            log_time: time_ns,
            publish_time: time_ns,
        };
        let written = self.mcap.write_to_known_channel(&header, &message);
        written.map_err(wrong(&self.path))
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.mcap.finish().map_err(wrong(&self.path))?;
        self.mcap.into_inner().commit()
    }
}
