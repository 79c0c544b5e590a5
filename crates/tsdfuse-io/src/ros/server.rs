//! Messages to whoever listens: a server that speaks Foxglove's WebSocket protocol.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{Context, FoxgloveError, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};

use super::schema::known;
use super::sink::Sink;
use crate::error::{Error, Result};

/// Messages that wait for a slow client; beyond this, the oldest are lost to it.
const BACKLOG: usize = 64;

/// A server to which Foxglove and other clients of its protocol connect (`ws://`, `foxglove.sdk.v1`), until it is dropped. What a run
/// says is said to it by a [`Writer`](super::Writer::to).
///
/// Who subscribes late gets the last message of each topic at once. Slow clients lose messages and slow nobody.
pub struct Server {
    handle: Option<WebSocketServerHandle>,
    address: SocketAddr,
    context: Arc<Context>,
    said: Arc<Said>,
}

/// What was said, channel by channel, for those who come late.
#[derive(Default)]
struct Said(Mutex<Vec<Spoken>>);

/// A channel with its last message.
struct Spoken {
    channel: Arc<RawChannel>,
    last: Option<(u64, Vec<u8>)>,
    has_newcomers: bool,
}

impl Said {
    fn channels(&self) -> MutexGuard<'_, Vec<Spoken>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ServerListener for Said {
    fn on_subscribe(&self, client: Client, subscribed: ChannelView<'_>) {
        let mut channels = self.channels();
        let Some(spoken) = channels
            .iter_mut()
            .find(|spoken| spoken.channel.id() == subscribed.id())
        else {
            return;
        };
        spoken.has_newcomers = true;
        if let Some((time_ns, message)) = &spoken.last {
            let at = PartialMetadata::with_log_time(*time_ns);
            spoken.channel.log_with_meta_to_sink(message, at, client.sink_id());
        }
    }
}

impl Server {
    /// Listens at an address; port 0 is any that is free.
    ///
    /// # Errors
    /// If nobody can listen there.
    pub fn start(address: SocketAddr, name: &str) -> io::Result<Self> {
        let context = Context::new();
        let said = Arc::new(Said::default());
        let host = match address {
            SocketAddr::V4(v4) => v4.ip().to_string(),
            SocketAddr::V6(v6) => format!("[{}]", v6.ip()),
        };
        let server = context
            .websocket_server()
            .name(name)
            .bind(host, address.port())
            .message_backlog_size(BACKLOG)
            .listener(said.clone());
        let handle = server.start_blocking().map_err(|error| match error {
            FoxgloveError::Bind(error) | FoxgloveError::IoError(error) => {
                io::Error::new(error.kind(), format!("{address}: {error}"))
            }
            other => io::Error::other(format!("{address}: {other}")),
        })?;
        Ok(Self {
            address: SocketAddr::new(address.ip(), handle.port()),
            handle: Some(handle),
            context,
            said,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What clients connect to.
    pub fn url(&self) -> String {
        format!("ws://{}", self.address)
    }

    /// How many clients are connected.
    pub fn clients(&self) -> usize {
        self.handle.as_ref().map_or(0, WebSocketServerHandle::client_count)
    }

    /// Where messages to all clients go.
    pub(super) fn sink(&self) -> impl Sink + use<> {
        Speaker {
            path: self.url().into(),
            context: self.context.clone(),
            said: self.said.clone(),
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(handle) = self.handle.take() {
            handle.stop().wait_blocking();
        }
    }
}

impl fmt::Debug for Server {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Server")
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

struct Speaker {
    path: PathBuf,
    context: Arc<Context>,
    said: Arc<Said>,
}

impl Sink for Speaker {
    fn path(&self) -> &Path {
        &self.path
    }

    fn channel(&mut self, topic: &str, kind: &str) -> Result<u16> {
        let text = known(kind).unwrap_or_default();
        let schema = Schema::new(kind.replace('/', "/msg/"), "ros2msg", text.into_bytes());
        let channel = self
            .context
            .channel_builder(topic)
            .message_encoding("cdr")
            .schema(schema)
            .build_raw()
            .map_err(|error| Error::format(&self.path, format!("{topic}: {error}")))?;
        let mut channels = self.said.channels();
        channels.push(Spoken {
            channel,
            last: None,
            has_newcomers: false,
        });
        u16::try_from(channels.len() - 1).map_err(|_| Error::format(&self.path, "too many topics"))
    }

    fn send(&mut self, channel: u16, time_ns: u64, message: Vec<u8>) -> Result<()> {
        if let Some(spoken) = self.said.channels().get_mut(usize::from(channel)) {
            let at = PartialMetadata::with_log_time(time_ns);
            spoken.channel.log_with_meta(&message, at);
            spoken.last = Some((time_ns, message));
        }
        Ok(())
    }

    fn is_heard(&self, channel: u16) -> bool {
        let channels = self.said.channels();
        channels
            .get(usize::from(channel))
            .is_some_and(|spoken| spoken.channel.has_sinks())
    }

    fn has_newcomers(&mut self, channel: u16) -> bool {
        let mut channels = self.said.channels();
        let spoken = channels.get_mut(usize::from(channel));
        spoken.is_some_and(|spoken| std::mem::take(&mut spoken.has_newcomers))
    }

    fn finish(self: Box<Self>) -> Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpStream;

    use serde_json::{Value, json};
    use tsdfuse::glam::{DVec3, Vec3};
    use tsdfuse::{Pose, Scan};
    use tungstenite::client::IntoClientRequest;
    use tungstenite::stream::MaybeTlsStream;
    use tungstenite::{Message, WebSocket};

    use super::super::container::Encoding;
    use super::super::schema::Schema;
    use super::super::value::read;
    use super::super::{SurfacePart, Writer};
    use super::*;
    use crate::source::Sensor;

    struct Listener {
        socket: WebSocket<MaybeTlsStream<TcpStream>>,
        /// Number, topic and definition of each channel.
        channels: Vec<(u64, String, Schema)>,
    }

    impl Listener {
        fn connect(server: &Server) -> Self {
            let mut request = server.url().into_client_request().unwrap();
            let protocol = "foxglove.sdk.v1".parse().unwrap();
            request.headers_mut().insert("Sec-WebSocket-Protocol", protocol);
            let (socket, _) = tungstenite::connect(request).unwrap();
            let channels = Vec::new();
            Self { socket, channels }
        }

        /// Subscribes to all channels, as soon as so many are known.
        fn subscribe(&mut self, count: usize) {
            while self.channels.len() < count {
                let Message::Text(text) = self.socket.read().unwrap() else {
                    continue;
                };
                let told: Value = serde_json::from_str(&text).unwrap();
                for channel in told["channels"].as_array().into_iter().flatten() {
                    let text = |key: &str| channel[key].as_str().unwrap().to_owned();
                    let schema = Schema::parse(&text("schemaName"), &text("schema")).unwrap();
                    let id = channel["id"].as_u64().unwrap();
                    self.channels.push((id, text("topic"), schema));
                }
            }
            let all = self.channels.iter().map(|(id, ..)| json!({"id": id, "channelId": id}));
            let asked = json!({"op": "subscribe", "subscriptions": all.collect::<Vec<_>>()});
            self.socket.send(Message::text(asked.to_string())).unwrap();
        }

        /// The next message: its topic, when it was said, and a number in it.
        fn hear(&mut self, path: &str) -> (String, u64, i64) {
            loop {
                let Message::Binary(bytes) = self.socket.read().unwrap() else {
                    continue;
                };
                assert_eq!(bytes[0], 1);
                let id = u64::from(u32::from_le_bytes(bytes[1..5].try_into().unwrap()));
                let time_ns = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                let (_, topic, schema) = self.channels.iter().find(|(of, ..)| *of == id).unwrap();
                let number = read(schema, Encoding::Cdr, &bytes[13..])
                    .unwrap()
                    .int(path)
                    .unwrap_or(-1);
                return (topic.clone(), time_ns, number);
            }
        }
    }

    fn scan(points: usize, time_ns: i64) -> Scan {
        Scan {
            points: vec![Vec3::X; points],
            time_ns: Some(time_ns),
            pose: Some(Pose::IDENTITY),
            ..Scan::default()
        }
    }

    #[test]
    fn listeners_hear_what_is_said_and_late_ones_the_last_word() {
        let server = Server::start("127.0.0.1:0".parse().unwrap(), "test").unwrap();
        let mut writer = Writer::to(&server, &[Sensor::new("lidar")]).unwrap();
        writer.announce().unwrap();
        assert!(!writer.is_surface_seen() && !writer.is_surface_new_to_some());
        writer.write_scan(0, &scan(3, 5)).unwrap();
        // Both poses, clouds, surface, grid.
        let mut first = Listener::connect(&server);
        first.subscribe(4);
        let heard = [first.hear("width"), first.hear("width")];
        assert!(heard.contains(&("/lidar".to_owned(), 5, 3)), "{heard:?}");
        assert!(heard.contains(&("/tf".to_owned(), 5, -1)), "{heard:?}");
        while !writer.is_surface_seen() {}
        assert!(writer.is_surface_new_to_some() && !writer.is_surface_new_to_some());
        writer.write_scan(0, &scan(4, 6)).unwrap();
        assert_eq!(first.hear("width"), ("/tf".to_owned(), 6, -1));
        assert_eq!(first.hear("width"), ("/lidar".to_owned(), 6, 4));
        let part = SurfacePart {
            place: tsdfuse::glam::IVec3::ZERO,
            corners: vec![DVec3::ZERO; 3],
            colors: Vec::new(),
        };
        writer.write_surface(7, std::slice::from_ref(&part)).unwrap();
        assert_eq!(first.hear("markers").0, "/surface");
        assert_eq!(server.clients(), 1);
        let mut second = Listener::connect(&server);
        second.subscribe(4);
        let mut heard: Vec<String> = (0..3).map(|_| second.hear("width").0).collect();
        heard.sort();
        assert_eq!(heard, ["/lidar", "/surface", "/tf"]);
        while !writer.is_surface_new_to_some() {}
        writer.finish().unwrap();
    }

    #[test]
    fn an_address_that_is_taken_is_named() {
        let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = taken.local_addr().unwrap();
        let told = Server::start(address, "test").unwrap_err().to_string();
        assert!(told.contains(&address.to_string()), "{told}");
    }
}
