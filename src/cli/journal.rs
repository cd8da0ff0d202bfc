//! Lines of standard error in the journal of systemd: whether it is connected to it, and the priority of each line.
//! Uses: rustix, the environment. Never: the journal itself (it reads standard error).

use std::borrow::Cow;
use std::os::fd::AsFd;

use tracing::Level;

/// Whether standard error is connected to the journal.
pub fn is_behind_stderr() -> bool {
    let stream = std::env::var("JOURNAL_STREAM");
    stream.is_ok_and(|stream| is_stream(&stream, std::io::stderr()))
}

/// Whether a file is the one that `JOURNAL_STREAM` names, by the numbers of its device and inode: standard error may
/// have been redirected since.
///
/// Source: systemd.exec(5).
fn is_stream(stream: &str, file: impl AsFd) -> bool {
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

/// A text for standard error. In the journal each of its lines is an entry, and begins with the priority of its level.
pub fn with_priority(text: &str, level: Level, is_journal: bool) -> Cow<'_, str> {
    if !is_journal {
        return text.into();
    }
    let lines = text.split('\n').map(|line| match line {
        "" => String::new(),
        line => format!("{}{line}", priority(level)),
    });
    lines.collect::<Vec<_>>().join("\n").into()
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

    #[test]
    fn every_line_of_a_text_in_the_journal_begins_with_the_priority() {
        let text = "next:\n\n  palpate runs   lists the runs";
        let prioritised = "<6>next:\n\n<6>  palpate runs   lists the runs";
        assert_eq!(with_priority(text, Level::INFO, true), prioritised);
        assert_eq!(with_priority("error: no rig", Level::ERROR, true), "<3>error: no rig");
        assert_eq!(with_priority(text, Level::ERROR, false), text);
    }
}
