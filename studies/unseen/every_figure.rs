//! Every figure of every study, up to this last one, states its title, label and n, and has no missing
//! number; the studies share a Transfer-Net.

use serde_json::{Value, json};

use crate::budget::{R2S, small};
use crate::evaluate::frame_pairs::FramePair;
use crate::evaluate::simulation::report;
use crate::factorial::fig_11;
use crate::ids::TrialId;
use crate::lab::fake::{FakeLab, result};
use crate::maps::table_iv;
use crate::noise::fig_10;
use crate::sheet::OutputFile;
use crate::simulation;
use crate::store::{Fit, RunRow};
use crate::transfer::table_iii;
use crate::unseen::{Unseen, fig_12};

fn lab() -> FakeLab {
    FakeLab { scores: true, ..FakeLab::default() }
}

fn unseen() -> Unseen {
    Unseen { dataset: "real-unseen".into(), points: None, skin: None, ours: false }
}

fn run() -> RunRow {
    let sensor = include_str!("../../experiments/sensors/ert-28.toml");
    let run: Value = json!({
        "uid": "01a208ed-3612-760c-9dff-1d5fb515cdf8", "scan_id": 3, "experiment": "night",
        "kind": "real-hex", "definition": "", "definition_sha256": "ab", "seed": 1, "rig": "",
        "rig_sha256": "cd", "sensor": sensor, "sensor_sha256": "ef", "calibration_id": null,
        "label": "virtual", "version": "0.1.0", "git_commit": null, "deadband_n": 5.0,
        "tip_diameter_mm": 20.0, "trials_planned": 40, "auto_resume": true, "not_before": null,
        "plan_sha256": null, "state": "ended", "requested_state": null, "paused_why": null,
        "exit_status": "success", "reason": null, "queue_position": null, "waiting_since": null,
        "is_resumable": false,
        "created_at": "2026-11-23T10:00:00Z", "started_at": null, "ended_at": null,
        "submitted_by": "Ada",
    });
    serde_json::from_value(run).unwrap()
}

/// Files of the fit of a run of 40 trials.
fn fit() -> Vec<OutputFile> {
    let fit = |n: u32| Fit {
        trial: TrialId(i64::from(n)),
        tips: 1,
        contact_count: (n % 3) as u8,
        max_force_n: Some(f64::from(n)),
        single_tip_mm: Some([100.0 + 20.0 * f64::from(n % 7), 200.0]),
        flagged: false,
        rmse_v: 0.01,
        fvu: Some(0.2),
    };
    let pair = FramePair {
        name: "median fit: trial t7".into(),
        measured_v: vec![0.001; 784],
        simulated_v: vec![0.002; 784],
    };
    let fits: Vec<Fit> = (0..40).map(fit).collect();
    simulation::files(&run(), &report(&fits), &[pair]).unwrap()
}

/// Names and texts of the figures of all studies.
fn figures() -> Vec<(String, String)> {
    let budget = small();
    let sheets = [
        result(table_iii(&lab(), &budget, R2S)).unwrap(),
        result(table_iv(&lab(), &budget)).unwrap(),
        result(fig_10(&lab(), &budget)).unwrap(),
        result(fig_11(&lab(), &budget)).unwrap(),
        result(fig_12(&lab(), &budget, &unseen())).unwrap(),
    ];
    let files = sheets.into_iter().flat_map(|sheet| sheet.files).chain(fit());
    let figures = files.filter(|file| file.name.ends_with(".svg"));
    figures.map(|file| (file.name, file.text)).collect()
}

fn texts(svg: &str) -> Vec<&str> {
    let all = svg.split("<text").skip(1);
    all.filter_map(|text| Some(text.split_once('>')?.1.split_once('<')?.0.trim())).collect()
}

#[test]
fn every_figure_states_title_label_and_n() {
    let all = figures();
    let names: Vec<&str> = all.iter().map(|(name, _)| name.as_str()).collect();
    for name in ["table-iii", "fig-9", "fig-10a", "fig-10b", "fig-11-force_percent", "fig-12"] {
        assert!(names.contains(&format!("{name}.svg").as_str()), "{name}: {names:?}");
    }
    for name in ["fig-12a", "fig-12-location", "fvu_by_force", "fvu_map", "frames"] {
        assert!(names.contains(&format!("{name}.svg").as_str()), "{name}: {names:?}");
    }
    for (name, svg) in &all {
        let texts = texts(svg);
        assert!(texts[0].len() > 20, "{name} has no title: {texts:?}");
        let below = texts.iter().find(|text| text.contains(", n = "));
        let below = below.unwrap_or_else(|| panic!("{name} has no n: {texts:?}"));
        let labels = ["virtual", "measured", "simulated"];
        assert!(labels.iter().any(|label| below.starts_with(label)), "{name}: {below}");
        assert!(!below.contains("n = 0 "), "{name}: {below}");
        assert!(!svg.contains("NaN") && !svg.contains("no data"), "{name}");
    }
}

#[test]
fn every_axis_has_its_unit_or_is_a_count() {
    let counts = [
        "FVU",
        "mean FVU",
        "trials",
        "contacts of a trial",
        "contacts of a test trial",
        "reading",
        "injection",
        "mean FVU (1 or more at the top)",
    ];
    for (name, svg) in figures() {
        // Names of axes are turned, or below the numbers: each figure has at least one unit or count.
        let named = texts(&svg).into_iter().filter(|text| {
            let unit = ["(mm)", "(N)", "(mV)", "(%)"].iter().any(|unit| text.ends_with(unit));
            unit || counts.contains(text)
        });
        assert!(named.count() >= 1, "{name}");
    }
}

#[test]
fn the_published_line_of_table_iii_is_drawn_and_a_missing_count_is_a_gap() {
    let sheet = result(table_iii(&lab(), &small(), R2S)).unwrap();
    let svg = &sheet.files.iter().find(|file| file.name == "table-iii.svg").unwrap().text;
    assert!(svg.contains("paper (measured)") && svg.contains("no net"));
    assert_eq!(texts(svg).iter().filter(|text| text.starts_with("trained on 1")).count(), 6);
}

#[test]
fn the_figures_use_the_last_net_of_table_iii() {
    let lab_to_4 = || FakeLab { contacts: Some(vec![1, 2, 4]), ..lab() };
    let trained = |lab: &FakeLab, at: usize| lab.trained.lock().unwrap()[at].clone();
    let of_table = lab_to_4();
    result(table_iii(&of_table, &small(), R2S)).unwrap();
    let last = trained(&of_table, 2);
    assert_eq!(last.stem, "transfer-to-4-small");
    let labs = [lab_to_4(), lab_to_4(), lab_to_4()];
    result(fig_10(&labs[0], &small())).unwrap();
    result(fig_11(&labs[1], &small())).unwrap();
    result(fig_12(&labs[2], &small(), &unseen())).unwrap();
    for lab in &labs {
        assert_eq!(trained(lab, 0), last);
        let transfers = lab.trained.lock().unwrap();
        let mut of_recipe = transfers.iter().filter(|t| t.recipe.starts_with("transfer-net"));
        assert!(of_recipe.all(|t| t.conditions == ["contact_count__lte=4"]), "{transfers:?}");
    }
}
