//! The tsdfuse command.
fn main() {}
