//! The bytes of a chunk, a line of JSON and then an ONNX file; and the folders of gathered nets.
//! Uses: `chunk`, `learn::model_file`, `infer::registry`. Never: a net whose files are not those of its manifest;
//! losses, which state times.

use std::io::{self, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{NetScore, TrainingsOrder};
use crate::chunk::MakeFailure;
use crate::chunk::error::ChunkError;
use crate::chunk::folder::OrderFolder;
use crate::chunk::order::ChunkRow;
use crate::infer::registry::{self, NewModel};
use crate::jobs::JobError;
use crate::learn::model_file::Manifest;
use crate::learn::order::MANIFEST;
use crate::learn::residuals::Residuals;
use crate::new_file;

/// Name of the file with the scores of a gathered net: a list of [`NetScore`], JSON.
pub const SCORES_FILE: &str = "scores.json";

#[derive(Debug, Clone)]
pub(super) struct ScoredNet {
    pub(super) model: NewModel,
    pub(super) scores: Vec<NetScore>,
}

/// The first line of a chunk.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NetHead {
    name: String,
    manifest: String,
    /// Text of its sensor file.
    sensor: String,
    /// Residuals; only of a Transfer-Net.
    residuals: Option<Residuals>,
    scores: Vec<NetScore>,
}

/// Writes the bytes of a chunk.
pub(super) fn write_net(net: &ScoredNet, out: &mut impl Write) -> io::Result<()> {
    let ScoredNet { model, scores } = net;
    let head = NetHead {
        name: model.name.clone(),
        manifest: model.manifest.to_toml(),
        sensor: model.sensor.clone(),
        residuals: model.residuals.clone(),
        scores: scores.clone(),
    };
    out.write_all(&serde_json::to_vec(&head)?)?;
    out.write_all(b"\n")?;
    out.write_all(&model.onnx)
}

fn read_net(bytes: &[u8]) -> Result<ScoredNet, MakeFailure> {
    let end = bytes.iter().position(|byte| *byte == b'\n').ok_or("its bytes have no first line")?;
    let head: NetHead = serde_json::from_slice(&bytes[..end])?;
    let NetHead { name, manifest, sensor, residuals, scores } = head;
    let onnx = bytes[end + 1..].to_vec();
    let text = |error: JobError| error.to_string();
    let (_, facts) = registry::facts("sensor", &sensor).map_err(|p| text(p.into()))?;
    let manifest = Manifest::from_toml(MANIFEST, &manifest, &facts).map_err(|p| text(p.into()))?;
    manifest.check_file(&onnx).map_err(|error| error.to_string())?;
    let model = NewModel { name, manifest, onnx, sensor, losses: None, residuals };
    Ok(ScoredNet { model, scores })
}

/// Nets that were written from the chunks of a work order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GatheredNets {
    /// Number of nets.
    pub nets: u64,
    /// Number of bytes of their chunks.
    pub bytes: u64,
}

/// Writes each net of a work order to a folder of its name in `out`: scores, ONNX file, manifest, sensor file,
/// residuals. `rows` are all rows of the order; `tell` receives a call for each net.
///
/// # Errors
/// `ChunkError::File` if a chunk cannot be read; `Make` if it is not the net of its order, or cannot be written;
/// `Incomplete` if chunks are damaged: the others were written.
pub fn gather(
    order: &TrainingsOrder,
    chunks: &OrderFolder,
    rows: &[ChunkRow],
    out: &Path,
    tell: &mut dyn FnMut(),
) -> Result<GatheredNets, ChunkError> {
    let (mut gathered, mut damaged) = (GatheredNets::default(), Vec::new());
    for (row, recipe) in rows.iter().zip(&order.recipes) {
        let failed = |source: MakeFailure| ChunkError::Make { index: row.index, source };
        let Some(bytes) = chunks.bytes(row)? else {
            damaged.push(row.index);
            continue;
        };
        let ScoredNet { model, scores } = read_net(&bytes).map_err(failed)?;
        if model.name != recipe.name {
            let found = &model.name;
            return Err(failed(format!("is {found}, the order has {}", recipe.name).into()));
        }
        let folder = out.join(&model.name);
        let scores = serde_json::to_vec(&scores).map_err(|error| failed(error.into()))?;
        new_file::write(&folder, SCORES_FILE, scores)
            .map_err(ChunkError::file("writing", folder.join(SCORES_FILE)))?;
        // The manifest last.
        model.save(&folder).map_err(|error| failed(error.to_string().into()))?;
        gathered.nets += 1;
        gathered.bytes += row.bytes;
        tell();
    }
    chunks.all_whole(damaged)?;
    Ok(gathered)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_that_are_no_net_are_refused() {
        for (text, words) in [
            ("{}", "no first line"),
            ("{\"name\":\"a\"}\nonnx", "missing field"),
            (
                "{\"name\":\"a\",\"manifest\":\"\",\"sensor\":\"\",\"residuals\":null,\"scores\":[]}\nonnx",
                "sensor",
            ),
        ] {
            let error = read_net(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
