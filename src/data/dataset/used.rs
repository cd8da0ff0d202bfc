//! When a file was last read, as its time of access: noted here, since the file system may not note reads.
//! Uses: std's files, jiff. Never: the content of a file.

use std::fs::{File, FileTimes};
use std::path::Path;
use std::time::SystemTime;

use jiff::Timestamp;

/// Notes that a file is read now. A failure only leaves the earlier time.
pub fn note(path: &Path) {
    if let Ok(file) = File::open(path) {
        let _ = file.set_times(FileTimes::new().set_accessed(SystemTime::now()));
    }
}

/// Wall time at which a file was last read; `None` if it is unknown.
pub fn last_used_at(path: &Path) -> Option<Timestamp> {
    let used = path.metadata().ok()?.accessed().ok()?;
    Timestamp::try_from(used).ok()
}
