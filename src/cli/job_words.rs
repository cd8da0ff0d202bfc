//! A job as text: its progress, its warnings, and what `palpate job show` prints.
//! Uses: the service's answers, `job_losses`, the score of `model`, `times`. Never: a request.

use std::fmt::Write;

use serde::Deserialize;
use serde_json::Value;

use super::client::text_of;
use super::job_losses::recipe_name;
use super::model::score;
use super::output::{duration, grouped};
use super::progress::to_go;
use super::times::second;
use crate::api::JobOut;
use crate::evaluate::request::EvaluationReport;
use crate::jobs::{Progress, warnings_of};

/// The warnings of a job, oldest first: those of its progress while it runs, then those of its result.
pub fn warnings(job: &JobOut) -> Vec<String> {
    match (&job.task.result, &job.progress) {
        (Some(result), _) => warnings_of(result),
        (None, Some(progress)) => progress.warnings.clone(),
        (None, None) => Vec::new(),
    }
}

/// The progress of a job, with its counts if they are known.
pub fn progress_words(progress: &Progress) -> String {
    match progress.total {
        0 => phase_words(progress),
        total => {
            let (done, total) = (grouped(progress.done), grouped(total));
            format!("{done} of {total}, {}", phase_words(progress))
        }
    }
}

/// The phase of a job, with its losses and its time to go.
pub fn phase_words(progress: &Progress) -> String {
    let mut words = progress.phase.clone();
    if let Some(epoch) = progress.epoch {
        words += &format!(", epoch {epoch}");
    }
    if let Some(loss) = progress.train_loss {
        words += &format!(", loss {loss:.3e}");
    }
    if let Some(loss) = progress.validation_loss {
        words += &format!(", validation {loss:.3e}");
    }
    if let Some(rate) = progress.per_second {
        words += &format!(", {rate:.0}/s");
    }
    if let Some(left_s) = progress.left_s {
        words += &format!(", {}", to_go(left_s));
    }
    words
}

/// A job as text: a line for each fact, then the text of its recipe, or the values of its request.
pub fn details(job: &JobOut) -> String {
    let task = &job.task;
    let mut text = format!("{} {}: {}", task.kind, task.id, task.state);
    let mut line = |name: &str, value: &str| {
        let _ = write!(text, "\n  {name:<11} {value}");
    };
    if let Some(name) = recipe_name(job) {
        line("recipe", &name);
    }
    line("requested", &format!("{} by {}", second(task.created_at), task.asked_by));
    for (name, at) in [("started", task.started_at), ("ended", task.finished_at)] {
        if let Some(at) = at {
            line(name, &second(at));
        }
    }
    if let Some((begin, end)) = task.started_at.zip(task.finished_at) {
        line("duration", &duration(end.duration_since(begin).as_secs_f64()));
    }
    if let Some(dataset) = &task.dataset {
        line("dataset", dataset.as_str());
    }
    if let Some(progress) = &job.progress {
        line("progress", &progress_words(progress));
    }
    for warning in warnings(job) {
        line("warning", &warning);
    }
    if let Some(error) = &task.error {
        line("error", error);
    }
    if let Some(result) = &task.result {
        if let Some(model) = result["model"].as_str() {
            line("model", &format!("{model} {}", text_of(&result["name"])));
        }
        if let Ok(report) = EvaluationReport::deserialize(result) {
            line("score", &score(&report));
            report.notes.iter().for_each(|note| line("note", note));
        }
    }
    match task.request["recipe"].as_str() {
        Some(recipe) => text += &format!("\n\nrecipe:\n{}", recipe.trim_end()),
        None => {
            text += "\n\nrequest:";
            for (key, value) in task.request.as_object().into_iter().flatten() {
                let _ = write!(text, "\n  {key:<11} {}", value_words(value));
            }
        }
    }
    text
}

/// A value of a request as text.
fn value_words(value: &Value) -> String {
    match value {
        Value::Array(items) => items.iter().map(value_words).collect::<Vec<_>>().join(", "),
        Value::String(text) => text.clone(),
        value => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_phase_that_ends_has_no_time_of_zero_to_go() {
        let shown = |left_s| {
            phase_words(&Progress { left_s, phase: "training".into(), ..Progress::default() })
        };
        assert_eq!(shown(Some(0.0)), "training, nearly done");
        assert_eq!(shown(Some(75.0)), "training, 1 min 15 s to go");
        assert_eq!(shown(None), "training");
    }

    #[test]
    fn a_job_is_shown_with_its_warnings_its_result_and_its_request() {
        let job = |kind: &str, request: Value, more: Value| {
            let mut job = json!({ "id": "job-0192ab34-7c1b-7000-8000-000000000001", "kind": kind,
                "state": "done", "request": request, "asked_by": "ada",
                "created_at": "2026-11-24T22:00:00Z", "started_at": "2026-11-24T22:00:00Z",
                "finished_at": "2026-11-24T22:01:15Z" });
            job.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
            details(&serde_json::from_value(job).unwrap())
        };
        let recipe = "name = \"net\"\nmap = \"4x20\"\n";
        let warning = "3 of 9 channels are constant";
        let result = json!({ "model": "mdl-1", "name": "net", "warnings": [warning] });
        let shown = job("training", json!({ "recipe": recipe }), json!({ "result": result }));
        let lines: Vec<&str> = shown.lines().collect();
        assert_eq!(lines[0], "training job-0192ab34-7c1b-7000-8000-000000000001: done");
        for line in [
            "  recipe      net",
            "  duration    1 min 15 s",
            "  warning     3 of 9 channels are constant",
            "  model       mdl-1 net",
        ] {
            assert!(lines.contains(&line), "{line}: {shown}");
        }
        assert!(shown.ends_with("\n\nrecipe:\nname = \"net\"\nmap = \"4x20\""), "{shown}");

        let request = json!({ "scored": "exact", "limit": 9, "where": ["a__gt=1", "b=2"] });
        let failed = json!({ "state": "failed", "error": "no model serves" });
        let shown = job("evaluation", request, failed);
        for line in
            ["  error       no model serves", "  where       a__gt=1, b=2", "  limit       9"]
        {
            assert!(shown.lines().any(|shown| shown == line), "{line}: {shown}");
        }

        let progress = json!({ "phase": "training", "done": 1000, "total": 4000, "epoch": 3,
            "warnings": [warning] });
        let running = json!({ "state": "running", "finished_at": null, "progress": progress });
        let shown = job("training", json!({ "recipe": recipe }), running);
        for line in [
            "  progress    1,000 of 4,000, training, epoch 3",
            "  warning     3 of 9 channels are constant",
        ] {
            assert!(shown.lines().any(|shown| shown == line), "{line}: {shown}");
        }
    }
}
