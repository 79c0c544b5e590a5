//! What commands share that stay open for others to look.

use std::net::SocketAddr;
use std::thread;
use std::time::Duration;

use tsdfuse_run::Stop;

use crate::progress::say;

/// Tells where something is served, and how to come there over ssh.
pub(crate) fn tell(what: &str, url: &str, address: SocketAddr) {
    say(format_args!("  {what:<8} {url}"));
    if address.ip().is_loopback() {
        let port = address.port();
        let host = std::fs::read_to_string("/etc/hostname").ok();
        let host = host
            .as_deref()
            .map(str::trim)
            .filter(|name| !name.is_empty())
            .unwrap_or("THIS-MACHINE");
        say(format_args!(
            "  over ssh first, on your machine: ssh -L {port}:127.0.0.1:{port} {host}"
        ));
    }
}

/// Stays until Ctrl-C, and looks after who comes ten times a second.
pub(crate) fn stay(what: &str, url: &str, stop: &Stop, mut attend: impl FnMut()) {
    if !stop.is_stopped() {
        say(format_args!("  {what} stays open at {url}; Ctrl-C ends it"));
    }
    while !stop.is_stopped() {
        attend();
        thread::sleep(Duration::from_millis(100));
    }
}
