//! The small server behind a live view: the page, and a WebSocket for each viewer.

use std::fmt;
use std::io::{self, Cursor, Read, Write};
use std::net::SocketAddr;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tiny_http::{Header, Request, Response, StatusCode};
use tungstenite::handshake::derive_accept_key;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Bytes, Message, WebSocket};

use super::ADDRESS;
use super::state::{Seen, Shared};
use crate::page;

/// Viewers at a time.
const MOST_VIEWERS: usize = 16;

/// A viewer is told something at least so often, so that one that is gone is noticed.
const SIGN_OF_LIFE: Duration = Duration::from_secs(20);

/// From one message to the next while something grows: so often a viewer is told what changed, and what changed twice is told once.
const PAUSE: Duration = Duration::from_millis(70);

/// A server that answers until it is dropped.
pub(super) struct Server {
    inner: Arc<Inner>,
    thread: Option<JoinHandle<()>>,
}

struct Inner {
    http: tiny_http::Server,
    address: SocketAddr,
    /// First part of all paths: who does not know it, is told nothing.
    token: String,
    page: Vec<u8>,
    shared: Arc<Shared>,
    viewers: AtomicUsize,
    tileset: Option<PathBuf>,
}

impl fmt::Debug for Server {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Server")
            .field("address", &self.inner.address)
            .finish_non_exhaustive()
    }
}

impl Server {
    pub(super) fn start(
        address: SocketAddr,
        title: &str,
        shared: Arc<Shared>,
        tileset: Option<PathBuf>,
    ) -> io::Result<Self> {
        let listen =
            |address| tiny_http::Server::http(address).map_err(|error| io::Error::other(format!("{address}: {error}")));
        let http = match listen(address) {
            Err(_) if address == ADDRESS => listen(SocketAddr::new(address.ip(), 0))?,
            other => other?,
        };
        let address = http.server_addr().to_ip().unwrap_or(address);
        let tiles = tileset
            .as_deref()
            .and_then(Path::file_name)
            .map(|name| format!("tiles/{}", name.to_string_lossy()));
        let inner = Arc::new(Inner {
            http,
            address,
            token: token()?,
            page: page::live(title, tiles.as_deref())?,
            shared,
            viewers: AtomicUsize::new(0),
            tileset,
        });
        let answering = inner.clone();
        let thread = thread::Builder::new().name("live view".to_owned()).spawn(move || {
            answering
                .http
                .incoming_requests()
                .for_each(|request| answer(&answering, request));
        })?;
        Ok(Self {
            inner,
            thread: Some(thread),
        })
    }

    pub(super) fn url(&self) -> String {
        format!("http://{}/{}/", self.inner.address, self.inner.token)
    }

    pub(super) fn address(&self) -> SocketAddr {
        self.inner.address
    }

    pub(super) fn viewers(&self) -> usize {
        self.inner.viewers.load(Ordering::Relaxed)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.inner.shared.close();
        self.inner.http.unblock();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// 128 bits that nobody guesses, as text.
fn token() -> io::Result<String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(|error| io::Error::other(error.to_string()))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Answers one request; if the other side is gone, nobody is there to be told.
fn answer(inner: &Arc<Inner>, request: Request) {
    let path = request.url().split(['?', '#']).next().unwrap_or_default();
    let inside = path.strip_prefix('/').and_then(|path| path.strip_prefix(&*inner.token));
    let _ = match inside {
        Some("/") => request.respond(of_type(inner.page.clone(), "text/html; charset=utf-8")),
        Some("/live") => {
            join(inner, request);
            Ok(())
        }
        Some(inside) => match inside.strip_prefix("/tiles/").and_then(|name| tile(inner, name)) {
            Some((bytes, kind)) => request.respond(of_type(bytes, kind)),
            None => request.respond(Response::from_string("no such page").with_status_code(404)),
        },
        None => request.respond(Response::from_string("open the whole URL that tsdfuse printed").with_status_code(403)),
    };
}

fn of_type(bytes: Vec<u8>, kind: &str) -> Response<Cursor<Vec<u8>>> {
    let headers = [
        ("Content-Type", kind),
        ("Cache-Control", "no-store"),
        ("Referrer-Policy", "no-referrer"),
        ("X-Content-Type-Options", "nosniff"),
    ];
    let headers = headers
        .iter()
        .filter_map(|(name, value)| Header::from_bytes(*name, *value).ok());
    headers.fold(Response::from_data(bytes), Response::with_header)
}

/// A file beside the tileset.
fn tile(inner: &Inner, name: &str) -> Option<(Vec<u8>, &'static str)> {
    let name = Path::new(name);
    let is_beside = name.components().all(|part| matches!(part, Component::Normal(_)));
    let kind = match name.extension()?.to_str()? {
        "json" => "application/json",
        "glb" => "model/gltf-binary",
        _ => return None,
    };
    let folder = inner.tileset.as_deref()?.parent()?;
    let bytes = is_beside.then(|| std::fs::read(folder.join(name)).ok())??;
    Some((bytes, kind))
}

/// Makes a viewer of a request for a WebSocket.
fn join(inner: &Arc<Inner>, request: Request) {
    let header = |name: &'static str| {
        let found = request.headers().iter().find(|header| header.field.equiv(name));
        found.map(|header| header.value.as_str().to_owned())
    };
    let Some(key) = header("Sec-WebSocket-Key") else {
        let _ = request.respond(Response::from_string("a WebSocket is wanted").with_status_code(400));
        return;
    };
    if inner.viewers.fetch_add(1, Ordering::Relaxed) >= MOST_VIEWERS {
        inner.viewers.fetch_sub(1, Ordering::Relaxed);
        let _ = request.respond(Response::from_string("too many viewers").with_status_code(503));
        return;
    }
    let accept = derive_accept_key(key.as_bytes());
    let headers = [
        ("Upgrade", "websocket"),
        ("Connection", "Upgrade"),
        ("Sec-WebSocket-Accept", &accept),
    ];
    let headers = headers
        .iter()
        .filter_map(|(name, value)| Header::from_bytes(*name, *value).ok())
        .collect();
    let response = Response::new(StatusCode(101), headers, io::empty(), Some(0), None);
    let inner = inner.clone();
    let viewing = thread::Builder::new().name("viewer".to_owned()).spawn({
        let inner = inner.clone();
        move || {
            let stream = request.upgrade("websocket", response);
            // It ends when the viewer goes.
            let _ = view(stream, &inner.shared);
            inner.viewers.fetch_sub(1, Ordering::Relaxed);
        }
    });
    if viewing.is_err() {
        inner.viewers.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Tells a viewer what it does not know yet, whenever it has shown what it was told before.
fn view(stream: impl Read + Write, shared: &Shared) -> tungstenite::Result<()> {
    let config = WebSocketConfig::default().max_message_size(Some(1 << 10));
    let mut socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
    let mut seen = Seen::default();
    let mut message = Vec::new();
    while !shared.is_closing() {
        let told = Instant::now();
        if shared.next(&mut seen, SIGN_OF_LIFE, &mut message) {
            let news = Bytes::from(message);
            socket.send(Message::Binary(news.clone()))?;
            // Its memory, which nobody else has any more.
            message = news.into();
            message.clear();
        } else {
            socket.send(Message::text("{}"))?;
        }
        loop {
            if let Message::Text(answer) = socket.read()? {
                seen.answered(&answer);
                break;
            }
        }
        if shared.grows() {
            thread::sleep(PAUSE.saturating_sub(told.elapsed()));
        }
    }
    socket.close(None)
}
