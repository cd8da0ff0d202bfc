//! Campaigns from the queue to their end.

use std::collections::BTreeSet;

use serde_json::json;

use super::bench::{Lab, rig_args};

/// Two settings of three configurations and four depths: 24 trials.
pub const SMALL: &str = "name = 'small'\nseed = 5\nsensor = 's'\n[real_hex]\ntips = [1, 4]\n\
     configurations = 3\ndepths = 4\ndepth_step_mm = 1.25\nblock = 3\nreference_every = 2\n\
     [measure]\nsettle_ms = 400.0\n";

#[tokio::test(flavor = "multi_thread")]
async fn a_small_campaign_stores_every_planned_trial_once() {
    let lab = Lab::open("small", rig_args("virtual", 40.0)).await;
    lab.home().await;
    let run = lab.queue(SMALL).await;
    lab.start(&run).await;
    let summary = lab.ended(&run).await;
    assert_eq!(summary["run"]["exit_status"], "success", "{summary:#}\n{:#}", lab.events().await);
    assert_eq!(summary["trials_stored"], 24);
    let keys = lab.keys(&run).await;
    assert_eq!(keys.len(), 24);
    assert_eq!(keys.iter().collect::<BTreeSet<_>>().len(), 24);
    let page = lab.get(&format!("/api/v1/runs/{run}/trials?limit=100")).await;
    for trial in page["trials"].as_array().unwrap() {
        assert_eq!(trial["flags"], json!([]), "{trial:#}");
    }
    lab.close().await;
}
