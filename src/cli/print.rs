//! A page of HTML as PDF or PNG, by a browser of this machine without a window.
//! Uses: Chromium or a relative, as a process. Never: the network, a page from elsewhere.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use tokio::process::Command;

/// Programs that print, the most likely one first.
const BROWSERS: [&str; 8] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "brave-browser",
    "microsoft-edge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
];
/// Longest time that printing may take.
const PRINT_WITHIN: Duration = Duration::from_secs(120);

/// Pixels of a PNG per pixel of its page.
const PNG_SCALE: u32 = 2;

/// Why there is no PDF or PNG.
#[derive(Debug, thiserror::Error)]
pub enum PrintError {
    /// No browser was found.
    #[error("it needs Chromium or Chrome, and none of them is in PATH; install `chromium`")]
    NoBrowser,
    /// The browser failed.
    #[error("{browser}: {why}", browser = browser.display())]
    Failed { browser: PathBuf, why: String },
}

/// Returns the browser that prints: the first one in the folders of `path`.
pub fn browser(path: Option<&OsStr>) -> Option<PathBuf> {
    let folders: Vec<PathBuf> = path.map(std::env::split_paths).into_iter().flatten().collect();
    BROWSERS.into_iter().find_map(|name| {
        let is_absolute = Path::new(name).is_absolute();
        let places = folders.iter().filter(|_| !is_absolute).map(|folder| folder.join(name));
        places.chain(is_absolute.then(|| PathBuf::from(name))).find(|place| place.is_file())
    })
}

/// Prints a page to a PDF.
///
/// # Errors
/// `PrintError` if there is no browser, or it fails.
pub async fn print(html: &Path, pdf: &Path) -> Result<(), PrintError> {
    let options =
        ["--no-pdf-header-footer".to_owned(), format!("--print-to-pdf={}", pdf.display())];
    driven(html, pdf, &options).await
}

/// Draws a page of this width and height, px, to a PNG.
///
/// # Errors
/// `PrintError` if there is no browser, or it fails.
pub async fn photograph(
    html: &Path,
    png: &Path,
    [width_px, height_px]: [u32; 2],
) -> Result<(), PrintError> {
    let options = [
        "--hide-scrollbars".to_owned(),
        format!("--force-device-scale-factor={PNG_SCALE}"),
        format!("--window-size={width_px},{height_px}"),
        format!("--screenshot={}", png.display()),
    ];
    driven(html, png, &options).await
}

/// Lets the browser write a page to a file.
async fn driven(html: &Path, out: &Path, options: &[String]) -> Result<(), PrintError> {
    let path = std::env::var_os("PATH");
    let browser = browser(path.as_deref()).ok_or(PrintError::NoBrowser)?;
    let failed = |why: String| PrintError::Failed { browser: browser.clone(), why };
    let html = std::path::absolute(html).map_err(|error| failed(error.to_string()))?;
    let address = reqwest::Url::from_file_path(&html)
        .map_err(|()| failed(format!("{}: this path has no address", html.display())))?;
    // A profile that is not that of the person: a browser that is open would take the request over.
    let profile = std::env::temp_dir().join(format!("palpate-print-{}", std::process::id()));
    let mut command = Command::new(&browser);
    command
        .args(["--headless", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"])
        .arg("--run-all-compositor-stages-before-draw")
        .arg(format!("--user-data-dir={}", profile.display()))
        .args(options)
        .arg(address.as_str())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .kill_on_drop(true);
    if rustix::process::geteuid().is_root() {
        // Its sandbox refuses root. The page is our own, without scripts.
        command.arg("--no-sandbox");
    }
    let ended = tokio::time::timeout(PRINT_WITHIN, command.status()).await;
    let _ = std::fs::remove_dir_all(&profile);
    let status = match ended {
        Ok(Ok(status)) => status,
        Ok(Err(error)) => return Err(failed(error.to_string())),
        Err(_) => return Err(failed(format!("not done after {} s", PRINT_WITHIN.as_secs()))),
    };
    let written = std::fs::metadata(out).is_ok_and(|file| file.len() > 0);
    if status.success() && written { Ok(()) } else { Err(failed(status.to_string())) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_browser_in_the_path_prints_and_without_one_the_sentence_says_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let path = std::env::join_paths([Path::new("/nonexistent"), folder.path()]).unwrap();
        let found = |path: &OsStr| browser(Some(path)).filter(|found| found.starts_with(&folder));
        assert_eq!(found(&path), None);
        std::fs::write(folder.path().join("google-chrome"), "").unwrap();
        assert_eq!(found(&path), Some(folder.path().join("google-chrome")));
        assert!(PrintError::NoBrowser.to_string().contains("install `chromium`"));
    }
}
