//! Downloads a file of a service; a connection that breaks is resumed. An answer that is made as it is read becomes a
//! file, too.
//! Uses: `client`, `new_file`, `progress`. Never: a wait without a deadline, a name for a file that its caller has not
//! checked.

use std::io::Write;
use std::path::Path;
use std::time::Duration;

use futures::StreamExt;
use reqwest::Response;
use tokio::time::timeout;

use super::client::Client;
use super::error::{CliError, CliResult};
use super::progress::{Counted, Working};
use crate::new_file::{Finished, NewFile};

/// Longest wait until a dataset is made.
pub const DATASET_WAIT: Duration = Duration::from_secs(3600);
/// Number of attempts of a download whose connection breaks.
const TRIES: u32 = 5;
/// Longest wait for the next part of a file.
const STALLED: Duration = Duration::from_secs(30);

/// Downloads a file of `wanted` bytes. The result is unfinished, in the folder of `out`: the caller compares its
/// sha256 and finishes it. It is no longer than `wanted` and a part; shorter if the file is.
///
/// # Errors
/// As [`Client::send`]; `CliError::Late` if no part arrives within 30 s, `Http` if the connection breaks too often,
/// `File` if the file cannot be written.
pub async fn download(client: &Client, url: &str, wanted: u64, out: &Path) -> CliResult<NewFile> {
    let failed = |source| CliError::File { path: out.into(), source };
    let mut file = NewFile::create_for(out).map_err(failed)?;
    let (mut have, mut tries) = (0_u64, 0);
    let mut shown = Counted::of("bytes downloaded", wanted);
    let client = client.patient(DATASET_WAIT).quiet();
    'file: while have < wanted {
        let range = format!("bytes={have}-");
        let answer = in_time(client.part(url, &range)).await??;
        let mut pieces = answer.bytes_stream();
        while have < wanted {
            match in_time(pieces.next()).await? {
                Some(Ok(piece)) => {
                    file.write_all(&piece).map_err(failed)?;
                    have += piece.len() as u64;
                    shown.show(have, wanted);
                }
                None => break 'file,
                Some(Err(_)) if tries < TRIES => {
                    tries += 1;
                    break;
                }
                Some(Err(error)) => return Err(error.into()),
            }
        }
    }
    Ok(file)
}

/// Downloads a file whose length and sha256 are known to `out`.
///
/// # Errors
/// As [`download`]; `Refused` if the service sends other bytes.
pub async fn download_whole(
    client: &Client,
    url: &str,
    whole: &Finished,
    out: &Path,
) -> CliResult<()> {
    let file = download(client, url, whole.bytes, out).await?;
    let found = file.sha256();
    if found != whole.sha256 {
        let detail = format!("the downloaded file has the sha256 {found}");
        return Err(CliError::Refused { status: 500, detail, again: false });
    }
    finish(file, out).map(drop)
}

/// Finishes a downloaded file under its name.
///
/// # Errors
/// `CliError::File` if it cannot be written.
pub fn finish(file: NewFile, out: &Path) -> CliResult<Finished> {
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    file.finish(&name).map_err(CliError::file(out))
}

/// Writes an answer to a file, which appears when it is complete, and names this `work` while it lasts. Returns the
/// number of bytes. `broken`: the error of a connection that breaks.
///
/// # Errors
/// `CliError::File` if the file cannot be written, or that of `broken`.
pub async fn keep(
    answer: Response,
    out: &Path,
    work: &str,
    broken: impl Fn(reqwest::Error) -> CliError,
) -> CliResult<u64> {
    let failed = |source| CliError::File { path: out.into(), source };
    let _shown = Working::on(work);
    let mut file = NewFile::create_for(out).map_err(failed)?;
    let mut pieces = answer.bytes_stream();
    while let Some(piece) = pieces.next().await {
        file.write_all(&piece.map_err(&broken)?).map_err(failed)?;
    }
    Ok(finish(file, out)?.bytes)
}

async fn in_time<T>(work: impl Future<Output = T>) -> CliResult<T> {
    timeout(STALLED, work).await.map_err(|_| CliError::Late {
        what: "the arrival of the next part of the file".into(),
        after_s: STALLED.as_secs(),
    })
}
