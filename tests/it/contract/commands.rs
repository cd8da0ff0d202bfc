//! What the HTTP API can tell has a command in the terminal, or a reason why not.

use std::collections::BTreeSet;

use clap::Subcommand;
use palpate::cli;

use super::DESCRIPTION;

/// GET operations with the command that shows their answer, or what it states.
const COMMANDS: &[(&str, &str)] = &[
    ("actions", "actions"),
    ("bench_records", "report 3"),
    ("caller", "key whoami"),
    ("dataset", "dataset show real"),
    ("dataset_card", "dataset card real"),
    ("dataset_file", "dataset export real"),
    ("dataset_groups", "query SELECT"),
    ("dataset_lineage", "dataset show real --lineage"),
    ("dataset_package", "dataset card real --datapackage"),
    ("dataset_rows", "dataset export real --format csv"),
    ("evaluate_simulation", "evaluate simulation --run 3"),
    ("events", "events"),
    ("export", "dataset exports"),
    ("export_file", "dataset export real"),
    ("job", "job show job-0192"),
    ("job_losses", "job losses job-0192"),
    ("keys", "key list"),
    ("list_datasets", "dataset list"),
    ("list_experiments", "init"),
    ("list_exports", "dataset exports"),
    ("list_jobs", "job list"),
    ("list_models", "model list"),
    ("list_recipes", "init"),
    ("list_runs", "runs"),
    ("list_trials", "trials"),
    ("live_contacts", "live"),
    ("live_quantities", "live --quantities"),
    ("live_status", "status --watch"),
    ("liveness", "status"),
    ("lock", "lock"),
    ("metrics", "metrics"),
    ("model", "model show transfer-net"),
    ("model_losses", "job losses job-0192"),
    ("model_onnx", "model onnx transfer-net --out transfer.onnx"),
    ("model_residuals", "evaluate transfer"),
    ("placement", "placement"),
    ("queue", "queue list"),
    ("published", "evaluate published"),
    ("queue_times", "queue list"),
    ("query_by_address", "query SELECT"),
    ("query_tables", "query"),
    ("readiness", "status"),
    ("record_frames", "live --record frames.parquet --frames 300"),
    ("rig_limits", "rig limits"),
    ("rig_rates", "rig rates"),
    ("rig_samples", "rig samples"),
    ("run", "show 3"),
    ("run_history", "show 3 --history"),
    ("run_preflight", "plan experiments/quickstart.toml"),
    ("run_progress", "show 3"),
    ("run_summary", "show 3"),
    ("run_tour", "show 3"),
    ("run_trials", "trials 3"),
    ("run_twins", "show 3"),
    ("sensor", "show 3"),
    ("sensor_overlay", "sensor overlay --out overlay.pdf"),
    ("serving", "model serving"),
    ("status", "status"),
    ("trial", "show t812"),
    ("trial_groups", "query SELECT"),
    ("twin_inputs", "cluster sbatch twins 3 --folder twins"),
    ("twins", "status --twins"),
    ("untouched_frame", "rig untouched"),
    ("vocabulary", "vocabulary"),
    ("wear", "rig wear"),
    ("workers", "status --workers"),
];

/// GET operations without a command.
const EXCEPTIONS: &[(&str, &str)] = &[
    ("experiment_schema", "a schema, for editors of experiment files"),
    ("live_frames", "a stream, for programs that draw"),
    ("run_plan", "every step of a plan, for programs; `plan` shows it in numbers"),
    ("trial_frames", "raw frames, for programs; `show` draws their mean"),
];

/// The `operationId` of each GET operation of `openapi.yaml`.
fn gets() -> BTreeSet<String> {
    let text = std::fs::read_to_string(DESCRIPTION).unwrap();
    let (mut found, mut is_get) = (BTreeSet::new(), false);
    for line in text.lines().filter(|line| !line.is_empty()) {
        let indent = line.len() - line.trim_start().len();
        if indent <= 4 {
            is_get = line == "    get:";
        } else if let Some(id) = line.strip_prefix("      operationId: ").filter(|_| is_get) {
            found.insert(id.to_owned());
        }
    }
    found
}

#[test]
fn what_the_api_can_tell_has_a_command_or_a_reason() {
    let gets = gets();
    assert!(gets.len() > 50, "{} GET operations", gets.len());
    let all = COMMANDS.iter().chain(EXCEPTIONS);
    let listed: BTreeSet<String> = all.map(|(id, _)| (*id).to_owned()).collect();
    assert_eq!(listed.len(), COMMANDS.len() + EXCEPTIONS.len(), "an operation is listed twice");
    let missing: Vec<&String> = gets.difference(&listed).collect();
    assert!(missing.is_empty(), "no command in tests/it/contract/commands.rs: {missing:?}");
    let gone: Vec<&String> = listed.difference(&gets).collect();
    assert!(gone.is_empty(), "not in openapi.yaml: {gone:?}");
    for (id, command) in COMMANDS {
        let line = cli::Command::augment_subcommands(clap::Command::new("palpate"));
        let words = ["palpate"].into_iter().chain(command.split(' '));
        let error = line.try_get_matches_from(words).err().map(|error| error.to_string());
        assert_eq!(error, None, "{id}: palpate {command}");
    }
}
