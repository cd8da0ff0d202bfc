//! Lines of the log in the journal of systemd: whether standard error is connected to it, and their priority.
//! Uses: rustix. Never: the journal itself (it reads standard error).

use std::os::fd::AsFd;

use tracing::Level;

/// Whether a file is the one that `JOURNAL_STREAM` names, by the numbers of its device and inode: standard error may
/// have been redirected since.
///
/// Source: systemd.exec(5).
pub fn is_stream(stream: &str, file: impl AsFd) -> bool {
    rustix::fs::fstat(file).is_ok_and(|stat| stream == format!("{}:{}", stat.st_dev, stat.st_ino))
}

/// What a line of a level begins with; the journal removes it, and `journalctl -p` selects by it.
///
/// Source: sd-daemon(3).
pub fn priority(level: Level) -> &'static str {
    match level {
        Level::ERROR => "<3>",
        Level::WARN => "<4>",
        Level::INFO => "<6>",
        Level::DEBUG | Level::TRACE => "<7>",
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::MetadataExt;

    use super::*;

    #[test]
    fn the_stream_of_the_journal_is_recognised_by_device_and_inode() {
        let (file, other) = (tempfile::tempfile().unwrap(), tempfile::tempfile().unwrap());
        let of = file.metadata().unwrap();
        let stream = format!("{}:{}", of.dev(), of.ino());
        assert!(is_stream(&stream, &file));
        assert!(!is_stream(&stream, &other) && !is_stream("8:x", &file));
    }
}
