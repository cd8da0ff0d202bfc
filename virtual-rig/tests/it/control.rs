//! The control socket, and the files at the start of a rig.

use serde_json::json;
use tokio_modbus::prelude::Reader;

use crate::common::{
    Control, IAI_TCP, Iai, bench, cells_client, on_one_bus, over_the_skin, reader, rtu_client,
    serve, switch_on,
};

#[tokio::test]
async fn tips_are_mounted_in_the_air_only() {
    let (_rig, mut control, mut iai) = bench(100.0).await;
    assert_eq!(control.say(json!({ "cmd": "mount", "tips": 7 })).await["ok"], false);
    assert_eq!(control.say(json!({ "cmd": "mount", "tips": 4 })).await["ok"], true);
    let surface = over_the_skin(&mut iai, &mut control).await;
    iai.go(3, surface + 4.0, 60.0).await;
    let refused = control.say(json!({ "cmd": "mount", "tips": 1 })).await;
    assert_eq!(refused["error"], "tips are pressing: raise z first");
    let status = control.status().await;
    assert_eq!((&status["tips"], &status["forces_n"][4]), (&json!(4), &json!(0.0)));
    assert_eq!(status["pressing"], true);
    iai.go(3, surface - 20.0, 60.0).await;
    let (peak_n, deepest_mm) = peaks(&control.status().await);
    assert!(peak_n > 5.0 && (deepest_mm - 4.0).abs() < 0.02, "{peak_n} N, {deepest_mm} mm");
    assert_eq!(control.say(json!({ "cmd": "clear_peaks" })).await["ok"], true);
    let (peak_n, deepest_mm) = peaks(&control.status().await);
    assert!(peak_n == 0.0 && (deepest_mm + 20.0).abs() < 0.02, "{peak_n} N, {deepest_mm} mm");
    assert_eq!(control.say(json!({ "cmd": "dance" })).await["ok"], false);
    assert_eq!(control.say(json!("hello")).await["ok"], false);
}

/// Largest force on a tip, N, and deepest z below the surface, mm.
fn peaks(status: &serde_json::Value) -> (f64, f64) {
    let number = |key: &str| status[key].as_f64().unwrap();
    (number("peak_force_n"), number("deepest_below_surface_mm"))
}

#[tokio::test]
async fn cells_may_stay_on_their_cables_without_tips() {
    let rig = switch_on(IAI_TCP, 100.0, "").await;
    let mut control = Control::open(&rig).await;
    let mut cells = cells_client(&rig).await;
    for (command, live) in [
        (json!({ "cmd": "mount", "tips": 1, "powered": 6 }), 6),
        (json!({ "cmd": "mount", "tips": 4 }), 4),
    ] {
        assert_eq!(control.say(command).await["powered"], live);
        let counts = cells.read_input_registers(0, 6).await.unwrap().unwrap();
        assert_eq!(counts.iter().filter(|&&c| c > 5000).count(), live, "{counts:?}");
        assert_eq!(control.status().await["powered"], live);
    }
    let refused = control.say(json!({ "cmd": "mount", "tips": 3, "powered": 2 })).await;
    assert_eq!(refused["error"], "powered must be from tips to 6");
    assert_eq!(control.status().await["tips"], 4);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn weights_press_on_the_skin_and_not_on_the_cells() {
    let rig = switch_on(IAI_TCP, 10.0, "").await;
    let mut control = Control::open(&rig).await;
    let mut reader = reader(&rig).await;
    let before = reader.frame().await.largest_v();
    let off = json!([{ "x_mm": -5.0, "y_mm": 80.0, "force_n": 9.81 }]);
    let refused = control.say(json!({ "cmd": "place", "weights": off })).await;
    assert_eq!(refused["error"], "a weight must be on the skin");
    let heavy = json!([{ "x_mm": 205.0, "y_mm": 250.0, "force_n": 40.0 }]);
    assert_eq!(control.say(json!({ "cmd": "place", "weights": heavy })).await["ok"], true);
    let placed = control.status().await;
    let mut frame = reader.frame().await;
    while (frame.device_time_us as f64) < (placed["process_s"].as_f64().unwrap() + 1.0) * 1e6 {
        frame = reader.frame().await;
    }
    assert!(frame.largest_v() > 3.0 * before, "{} after {before}", frame.largest_v());
    assert_eq!(placed["forces_n"], json!([0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    assert_eq!(control.say(json!({ "cmd": "clear" })).await["ok"], true);
    assert_eq!(control.status().await["weights"], json!([]));
}

#[tokio::test]
async fn the_served_rig_file_names_the_wires_as_they_are() {
    let rig = switch_on(IAI_TCP, 25.0, "").await;
    let served: toml::Table = toml::from_str(&rig.rig_text).unwrap();
    assert_eq!(served["clock_rate"].as_float(), Some(25.0));
    assert_eq!(served["label"].as_str(), Some("virtual"), "whatever the file says");
    assert_eq!(served["lines"]["stage"]["address"].as_str(), Some(&*rig.ready.lines["stage"]));
    assert_eq!(served["ert"]["address"].as_str(), Some(&*rig.ready.ert));
    assert_ne!(rig.ready.lines["stage"], "127.0.0.1:5020");
    let original: toml::Table = toml::from_str(IAI_TCP).unwrap();
    assert_eq!(served["axes"], original["axes"]);
    let on_disk = std::fs::read_to_string(rig.ready.rig.as_ref().unwrap()).unwrap();
    assert_eq!(on_disk, rig.rig_text);
}

#[tokio::test]
async fn a_configured_serial_path_is_a_link_to_the_pseudo_terminal() {
    let dir = std::path::Path::new(env!("CARGO_TARGET_TMPDIR"));
    let path = dir.join(format!("bus-{}", std::process::id()));
    let text = on_one_bus("iai", 100.0, 100.0).replacen("unused", path.to_str().unwrap(), 1);
    let text = text.replacen("unused", &format!("{}-ert", path.display()), 1);
    let rig = serve(&text, 100.0, "", false).await.unwrap();
    assert_eq!(rig.ready.lines["stage"], path.to_str().unwrap());
    Iai(rtu_client(&rig)).home(1..=1).await;
    drop(rig);
    assert!(path.symlink_metadata().is_err(), "the link is removed with the rig");
    std::fs::write(&path, "a file of another program").unwrap();
    let error = serve(&text, 100.0, "", false).await.err().unwrap().to_string();
    assert!(error.contains("use --ephemeral"), "{error}");
    std::fs::remove_file(&path).unwrap();
}
