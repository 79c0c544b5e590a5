//! Where messages of ROS 2 go: into a file, or to whoever listens.

use std::path::Path;

use crate::error::Result;

/// Takes messages, each of a channel that was made before.
pub(super) trait Sink: Send {
    /// What errors call it.
    fn path(&self) -> &Path;

    /// Makes the channel of a topic with messages of one kind, such as `nav_msgs/Odometry`.
    fn channel(&mut self, topic: &str, kind: &str) -> Result<u16>;

    /// Takes a message of a channel in CDR; nanoseconds since 1970.
    fn send(&mut self, channel: u16, time_ns: u64, message: Vec<u8>) -> Result<()>;

    /// Whether anybody would read a message of this channel.
    fn is_heard(&self, _channel: u16) -> bool {
        true
    }

    /// Whether somebody listens to this channel who did not when this was asked last.
    fn has_newcomers(&mut self, _channel: u16) -> bool {
        false
    }

    /// No message follows.
    fn finish(self: Box<Self>) -> Result<()>;
}
