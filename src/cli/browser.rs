//! Opens the page in the browser of the desktop.
//! Uses: the opener of the system, as a process. Never: a failure of the command that asks for it.

use std::io;
use std::process::{Command, ExitStatus, Stdio};

use super::output::note;
use crate::program::withhold;

/// Program that opens an address with the browser of the desktop.
const OPENER: &str = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };

/// Opens an address in the browser, and reports if that fails. It does not wait: an opener may last as
/// long as its browser.
pub fn open(url: &str) {
    let url = url.to_owned();
    let opening = move || {
        let mut opener = Command::new(OPENER);
        withhold(&mut opener);
        opener.arg(&url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        if let Some(words) = failure(&url, opener.status()) {
            note(words);
        }
    };
    if let Err(error) = std::thread::Builder::new().name("browser".into()).spawn(opening) {
        tracing::warn!(%error, "no browser was opened");
    }
}

/// Text for a person whose browser did not open.
fn failure(url: &str, ended: io::Result<ExitStatus>) -> Option<String> {
    let cause = match ended {
        Ok(status) if status.success() => return None,
        Ok(status) => status.to_string(),
        Err(error) => error.to_string(),
    };
    Some(format!("no browser could be opened ({OPENER}: {cause}): open {url} yourself"))
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    #[test]
    fn a_browser_that_did_not_open_is_reported_with_the_address() {
        let url = "http://127.0.0.1:8080";
        assert_eq!(failure(url, Ok(ExitStatus::from_raw(0))), None);
        let missing = failure(url, Err(io::ErrorKind::NotFound.into())).unwrap();
        assert!(
            missing.contains(OPENER) && missing.ends_with("open http://127.0.0.1:8080 yourself")
        );
        let refused = failure(url, Ok(ExitStatus::from_raw(3 << 8))).unwrap();
        assert!(refused.contains("exit status: 3"), "{refused}");
    }
}
