//! An evaluation as a job: prepares the reader, gathers the rows, and has the answers scored.
//! Uses: `scoring`, `gathered`, `evaluate`, `infer`, `dataset`. Never: HTTP, a number without its rows.

use std::sync::Arc;

use serde_json::Value;

use super::error::{JobError, JobResult};
use super::gathered::{Gathered, first_frames};
use super::scoring::{Reader, Scoring};
use super::{Jobs, Watch};
use crate::dataset::background::background;
use crate::evaluate::held_out::{Made, is_held_out};
use crate::evaluate::request::{EvaluationRequest, FramesRead, OffsetsRead, Scored};
use crate::ids::{CalibrationId, DatasetId};
use crate::infer::methods::Models;
use crate::infer::methods::fast::PointPipeline;
use crate::infer::slot::Slot;
use crate::infer::untouched::UntouchedSkins;
use crate::learn::error::LearnError;
use crate::learn::task::MEASURED;
use crate::store::{DatasetRow, TaskRow};

/// Runs an evaluation; `None` if it was stopped.
pub(super) async fn run(
    jobs: &Jobs,
    job: &TaskRow,
    watch: &Arc<Watch>,
) -> JobResult<Option<Value>> {
    let request: EvaluationRequest =
        serde_json::from_value(job.request.clone()).map_err(JobError::Json)?;
    request.check()?;
    watch.phase("preparing the method", 0);
    let reader = reader(jobs, &request).await?;
    watch.phase("making the dataset", 0);
    let name = job.dataset.as_ref().map_or(request.dataset.as_str(), DatasetId::as_str);
    let dataset = jobs.inner.datasets.resolve(name).await?;
    jobs.inner.store.begin_task(job.id, Some(&dataset.id)).await?;
    let scoring = scoring(jobs, request, reader, dataset, watch).await?;
    let report = background(move || scoring.run()).await??;
    report.map(|report| serde_json::to_value(report).map_err(JobError::Json)).transpose()
}

/// Gathers the rows of a request from its dataset, for a reader.
///
/// # Errors
/// `JobError` if no row meets the conditions, or the dataset or the store cannot be read.
pub(super) async fn scoring(
    jobs: &Jobs,
    request: EvaluationRequest,
    reader: Reader,
    dataset: DatasetRow,
    watch: &Arc<Watch>,
) -> JobResult<Scoring> {
    let file = jobs.inner.datasets.used(&dataset.id);
    watch.phase("gathering frames", dataset.rows);
    let scratch = jobs.inner.data.join("cache");
    let columns = reader.columns();
    let measured = columns.contains(&MEASURED);
    if request.frames == FramesRead::First && !measured {
        let limit = "no measured frames are read: use mean, or name a Transfer-Net";
        return Err(LearnError::value("evaluation", "frames", "first", limit).into());
    }
    let requested = request.clone();
    let at = file.clone();
    let gathered = background(move || Gathered::new(&at, &requested, columns, &scratch)).await??;
    let raw = match request.frames {
        FramesRead::Mean => None,
        FramesRead::First => Some(first_frames(&jobs.inner.store, &gathered).await?),
    };
    let takes = reader.method().is_some_and(|method| method.takes_untouched());
    let untouched = match (request.offsets, takes) {
        (OffsetsRead::Untouched, true) => {
            UntouchedSkins::before(&jobs.inner.store, &gathered.trials()).await?
        }
        (OffsetsRead::Untouched, false) | (OffsetsRead::Calibration, _) => {
            UntouchedSkins::default()
        }
    };
    let held_out = held_out(jobs, &reader, &dataset, request.part.as_deref()).await?;
    let (watch, clock) = (watch.clone(), jobs.inner.clock.clone());
    let sensor = jobs.inner.serving.sensor();
    let rig_sensor = (sensor.file.name.clone(), sensor.channels());
    Ok(Scoring {
        request,
        dataset: dataset.id,
        lineage: dataset.lineage,
        held_out,
        gathered,
        raw,
        untouched,
        reader,
        measured,
        rig_sensor,
        watch,
        clock,
    })
}

async fn reader(jobs: &Jobs, request: &EvaluationRequest) -> JobResult<Reader> {
    let models = &jobs.inner.models;
    let load = async |name: &Option<String>| match name {
        Some(name) => models.load(name).await.map(Some),
        None => Ok(None),
    };
    let mut ready = Models {
        transfer: load(&request.transfer).await?,
        map: load(&request.map).await?,
        points: load(&request.points).await?.map(PointPipeline::new).transpose()?,
        threshold_n: request.threshold_n,
        ..Models::default()
    };
    let method = match request.scored {
        Scored::Voltages => return Ok(Reader::Voltages(ready.transfer)),
        Scored::Quantity => {
            let net = models.load(request.net.as_deref().unwrap_or_default()).await?;
            let quantity = net.quantity()?;
            return Ok(Reader::Quantity(net, quantity));
        }
        Scored::Method(method) => method,
    };
    if method.slots().contains(&Slot::Skin) {
        let (serving, calibration) = (&jobs.inner.serving, skin(jobs, request).await?);
        if method.is_fit() {
            // The preparation of a skin takes most of a minute: it is reused.
            serving.once_restored(None).await;
            ready.skin = Some(serving.skin(calibration.as_ref()).await?);
        } else {
            ready.forward = Some(Arc::new(serving.skins().model(calibration.as_ref()).await?));
        }
    }
    Ok(Reader::Contacts(background(move || method.ready(&ready)).await??))
}

/// Whether none of the scored rows can have been used to train a net of the reader.
async fn held_out(
    jobs: &Jobs,
    reader: &Reader,
    dataset: &DatasetRow,
    part: Option<&str>,
) -> JobResult<bool> {
    let scored = Made { definition: &dataset.definition, lineage: &dataset.lineage };
    for id in reader.nets().iter().flat_map(|net| &net.manifest.model.datasets) {
        // The lineage of an unknown dataset is unknown.
        let Some(row) = jobs.inner.store.dataset(id).await? else { continue };
        let learned = Made { definition: &row.definition, lineage: &row.lineage };
        if !is_held_out(part, &scored, &learned) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Id of the calibration of the exact model: the named one, or else the serving one.
pub(super) async fn skin(
    jobs: &Jobs,
    request: &EvaluationRequest,
) -> JobResult<Option<CalibrationId>> {
    match &request.skin {
        Some(skin) => Ok(Some(skin.clone())),
        None => Ok(jobs.inner.serving.promoted_skin().await?),
    }
}
