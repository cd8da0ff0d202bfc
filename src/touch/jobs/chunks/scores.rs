//! The scores of a net that a chunk has trained, on parts of its dataset.
//! Uses: `scoring`, `gathered`. Never: the store, another model, a time.

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::NetOrder;
use crate::chunk::Tell;
use crate::clock::Clock;
use crate::evaluate::request::{EvaluationReport, EvaluationRequest, Scored};
use crate::infer::methods::Models;
use crate::infer::registry::{Model, NewModel};
use crate::infer::untouched::UntouchedSkins;
use crate::jobs::gathered::Gathered;
use crate::jobs::scoring::{Reader, Scoring};
use crate::jobs::{JobError, JobResult, Watch};
use crate::learn::task::MEASURED;
use crate::program::STOP_POLL;

/// An evaluation of a net.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetScore {
    /// Its request, which names the net.
    pub request: EvaluationRequest,
    /// Its report, without latencies.
    pub report: EvaluationReport,
}

/// Scores a net as its order states; none if `tell` broke off, which receives the number of scored rows.
///
/// # Errors
/// `JobError` if a request does not fit the net, or its dataset cannot be read.
pub(super) fn net_scores(
    net: &NetOrder,
    model: &NewModel,
    [file, scratch]: [&Path; 2],
    tell: &mut Tell<'_>,
) -> JobResult<Option<Vec<NetScore>>> {
    if net.evaluations.is_empty() {
        return Ok(Some(Vec::new()));
    }
    let watch = Arc::new(Watch::default());
    let model = Arc::new(model.load()?);
    std::thread::scope(|scope| {
        let work = scope.spawn(|| -> JobResult<Option<Vec<NetScore>>> {
            let mut scores = Vec::new();
            for request in &net.evaluations {
                match net_score(net, &model, request, [file, scratch], &watch)? {
                    Some(score) => scores.push(score),
                    None => return Ok(None),
                }
            }
            Ok(Some(scores))
        });
        while !work.is_finished() {
            std::thread::sleep(STOP_POLL);
            if tell(watch.progress().done).is_break() {
                watch.stop();
            }
        }
        work.join().unwrap_or(Err(JobError::Worker))
    })
}

/// Scores a net on one part; none if it was stopped.
fn net_score(
    net: &NetOrder,
    model: &Arc<Model>,
    request: &EvaluationRequest,
    [file, scratch]: [&Path; 2],
    watch: &Arc<Watch>,
) -> JobResult<Option<NetScore>> {
    let request = request.of_net(&model.manifest.id);
    request.check()?;
    let reader = match request.scored {
        Scored::Voltages => Reader::Voltages(Some(model.clone())),
        Scored::Quantity => Reader::Quantity(model.clone(), model.quantity()?),
        Scored::Method(method) => {
            let (map, threshold_n) = (Some(model.clone()), request.threshold_n);
            Reader::Contacts(method.ready(&Models { map, threshold_n, ..Models::default() })?)
        }
    };
    let columns = reader.columns();
    let scoring = Scoring {
        dataset: net.dataset.id.clone(),
        lineage: json!({ "runs": [{ "label": net.label }] }),
        // It has learned from the same runs: only the part test is held out.
        held_out: request.part.as_deref() == Some("test"),
        gathered: Gathered::new(file, &request, columns, scratch)?,
        raw: None,
        untouched: UntouchedSkins::default(),
        reader,
        measured: columns.contains(&MEASURED),
        // No skin is read.
        rig_sensor: (String::new(), 0),
        watch: watch.clone(),
        clock: Clock::new(1.0),
        request: request.clone(),
    };
    let report = scoring.run()?;
    Ok(report.map(|report| {
        let report = EvaluationReport { latency_ms: None, ..report };
        NetScore { request, report }
    }))
}
