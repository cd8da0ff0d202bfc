//! Effects of a fault script on the wires.

use std::time::{Duration, Instant};

use serde_json::json;
use tokio::time::timeout;
use tokio_modbus::Request;
use tokio_modbus::client::Context;
use tokio_modbus::prelude::{Reader, Slave, Writer};
use tokio_modbus::slave::SlaveContext;

use crate::common::{
    Control, IAI_TCP, Iai, bench, call, cells_client, on_one_bus, over_the_skin, reader,
    rtu_client, switch_on, tcp_client,
};

const SHORT: Duration = Duration::from_millis(80);

async fn x_position(context: &mut Context) -> Result<Vec<u16>, &'static str> {
    context.set_slave(Slave(1));
    match timeout(SHORT, context.read_holding_registers(0x9000, 2)).await {
        Err(_) => Err("silence"),
        Ok(Err(_)) => Err("broken"),
        Ok(Ok(Err(_))) => Err("exception"),
        Ok(Ok(Ok(words))) => Ok(words),
    }
}

#[tokio::test]
async fn wire_faults_strike_over_tcp() {
    let rig = switch_on(IAI_TCP, 1.0, "").await;
    let mut control = Control::open(&rig).await;
    let cases = [
        (json!({ "kind": "no_reply" }), "silence"),
        (json!({ "kind": "exception", "code": 6 }), "exception"),
        (json!({ "kind": "disconnect" }), "broken"),
        (json!({ "kind": "garbled_reply" }), "broken"),
        (json!({ "kind": "garbled_reply", "part": "cut" }), "silence"),
        (json!({ "kind": "late_reply", "delay_ms": 200 }), "silence"),
    ];
    for (mut fault, expected) in cases {
        fault["cmd"] = "fault".into();
        fault["device"] = "x".into();
        fault["count"] = 1.into();
        assert_eq!(control.say(fault.clone()).await["ok"], true);
        let mut client = tcp_client(&rig, "stage").await;
        client.set_slave(Slave(2));
        assert!(client.read_holding_registers(0x9000, 2).await.unwrap().is_ok(), "y unaffected");
        assert_eq!(x_position(&mut client).await, Err(expected), "{fault}");
        let mut client = tcp_client(&rig, "stage").await;
        assert!(x_position(&mut client).await.is_ok(), "once only: {fault}");
    }
    let wrong = json!({ "cmd": "fault", "kind": "no_reply", "device": "w" });
    let refused = control.say(wrong).await;
    assert!(refused["error"].as_str().unwrap().contains("device = w"), "{refused}");
}

#[tokio::test]
async fn wire_faults_strike_over_rtu() {
    let script = "[[fault]]\nkind = \"no_reply\"\ndevice = \"x\"\ncount = 1\n\
        [[fault]]\nkind = \"garbled_reply\"\npart = \"payload\"\ndevice = \"stage\"\ncount = 1\n\
        [[fault]]\nkind = \"exception\"\ncode = 4\ndevice = \"x\"\ncount = 1";
    let rig = switch_on(&on_one_bus("iai", 100.0, 100.0), 1.0, script).await;
    for expected in ["silence", "broken", "exception"] {
        let mut bus = rtu_client(&rig);
        let outcome = x_position(&mut bus).await;
        // A client that cannot decode a frame may report it or continue to wait.
        let silent_or = [Err(expected), Err("silence")];
        assert!(silent_or.contains(&outcome), "{expected}: {outcome:?}");
        drop(bus);
        tokio::time::sleep(Duration::from_millis(40)).await;
    }
    assert!(x_position(&mut rtu_client(&rig)).await.is_ok());
}

#[tokio::test]
async fn a_lost_answer_may_leave_a_motion_behind() {
    let (rig, mut control, mut iai) = bench(100.0).await;
    iai.home(1..=1).await;
    for (executed, end) in [(true, 50.0), (false, 50.0)] {
        let fault = json!({ "cmd": "fault", "kind": "no_reply", "device": "x", "count": 1,
            "executed": executed });
        control.say(fault).await;
        let target = if executed { 50.0 } else { 90.0 };
        assert!(timeout(SHORT, iai.start(1, target, 250.0)).await.is_err());
        iai = Iai(tcp_client(&rig, "stage").await);
        iai.wait(1, |dss1| dss1 & 1 << 3 != 0).await;
        assert_eq!(control.status().await["axes"][0]["position"], end);
    }
}

#[tokio::test]
async fn stuck_stale_and_alarmed_axes() {
    let (_rig, mut control, mut iai) = bench(100.0).await;
    iai.home(1..=2).await;
    control.say(json!({ "cmd": "fault", "kind": "stuck_axis", "device": "x" })).await;
    iai.start(1, 100.0, 250.0).await;
    tokio::time::sleep(Duration::from_millis(30)).await;
    let (position, dss1) = iai.status(1).await;
    assert_eq!((position, dss1 & 1 << 3), (0.0, 0), "never in position, never moving");
    control.say(json!({ "cmd": "fault", "kind": "stale_registers", "device": "y" })).await;
    iai.start(2, 100.0, 250.0).await;
    tokio::time::sleep(Duration::from_millis(30)).await;
    assert_eq!(iai.status(2).await.0, 0.0);
    let truth = control.status().await;
    assert_eq!(
        (&truth["axes"][0]["position"], &truth["axes"][1]["position"]),
        (&json!(0.0), &json!(100.0))
    );
    control.say(json!({ "cmd": "mend" })).await;
    iai.wait(1, |dss1| dss1 & 1 << 3 != 0).await;
    // In position means within a band of 0.01 mm.
    assert!((iai.status(1).await.0 - 100.0).abs() < 0.011);
    assert!((iai.status(2).await.0 - 100.0).abs() < 0.011);
    control.say(json!({ "cmd": "fault", "kind": "alarm", "code": 0xCC, "device": "x" })).await;
    assert_eq!(iai.status(1).await.1 & 1 << 10, 1 << 10);
    let code = iai.unit(1).read_holding_registers(0x9002, 1).await.unwrap().unwrap();
    assert_eq!(code, [0xCC]);
    control.say(json!({ "cmd": "fault", "kind": "power_loss", "device": "y" })).await;
    assert_eq!(iai.status(2).await.1 & (1 << 4 | 1 << 12), 0, "neither homed nor powered");
}

#[tokio::test]
async fn a_motor_that_is_off_raises_no_alarm_and_stays_off_until_it_is_switched_on() {
    let (_rig, mut control, mut iai) = bench(100.0).await;
    iai.home(1..=1).await;
    let off = json!({ "cmd": "fault", "kind": "motor_off", "device": "x", "count": 1 });
    assert_eq!(control.say(off).await["ok"], true);
    let bits: u16 = 1 << 12 | 1 << 10 | 1 << 4;
    assert_eq!(iai.status(1).await.1 & bits, 1 << 4, "homed, no alarm, motor off");
    assert_eq!(control.status().await["axes"][0]["servo"], false);
    iai.unit(1).write_single_coil(0x0403, true).await.unwrap().unwrap();
    assert_eq!(iai.status(1).await.1 & bits, 1 << 12 | 1 << 4);
}

#[tokio::test]
async fn a_cut_line_refuses_until_it_is_whole() {
    let script = "[[fault]]\nkind = \"disconnect\"\ndevice = \"stage\"\nfor_s = 0.4";
    let rig = switch_on(IAI_TCP, 1.0, script).await;
    let mut outcomes = Vec::new();
    let since = Instant::now();
    while since.elapsed() < Duration::from_millis(700) {
        let mut client = tcp_client(&rig, "stage").await;
        outcomes.push(x_position(&mut client).await.is_ok());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(!outcomes[0] && outcomes[outcomes.len() - 1], "{outcomes:?}");
    let mended = outcomes.iter().position(|&ok| ok).unwrap();
    assert!(outcomes[mended..].iter().all(|&ok| ok), "{outcomes:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_mangled_stream_loses_packets_and_no_more() {
    let script = "[[fault]]\nkind = \"flip_bytes\"\ndevice = \"ert\"\nrate = 0.2\n\
        [[fault]]\nkind = \"drop_bytes\"\ndevice = \"ert\"\nrate = 0.1";
    let rig = switch_on(IAI_TCP, 20.0, script).await;
    let mut reader = reader(&rig).await;
    let (mut good, mut last) = (0, 0);
    while good < 200 {
        let frame = reader.frame().await;
        assert!(good == 0 || frame.sequence > last);
        (good, last) = (good + 1, frame.sequence);
    }
    assert!((20..200).contains(&reader.garbled), "{}", reader.garbled);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stalled_stream_goes_on_with_a_gap() {
    let script =
        "[[fault]]\nkind = \"stall_stream\"\ndevice = \"ert\"\nat_frame = 100\nfor_s = 5.0";
    let rig = switch_on(IAI_TCP, 20.0, script).await;
    let mut reader = reader(&rig).await;
    let mut gaps = Vec::new();
    let mut last = reader.frame().await;
    while last.sequence < 400 {
        let frame = reader.frame().await;
        if frame.sequence != last.sequence + 1 {
            gaps.push(frame.sequence - last.sequence);
        }
        last = frame;
    }
    assert_eq!(gaps.len(), 1, "{gaps:?}");
    assert!((140..200).contains(&gaps[0]), "{gaps:?}");
}

#[tokio::test]
async fn a_dead_cell_reads_nothing() {
    let rig = switch_on(IAI_TCP, 100.0, "").await;
    let mut control = Control::open(&rig).await;
    let fault = json!({ "cmd": "fault", "kind": "dead_cell", "device": "cells", "arm": 2 });
    assert_eq!(control.say(fault).await["ok"], true);
    tokio::time::sleep(Duration::from_millis(10)).await;
    let mut cells = cells_client(&rig).await;
    let counts = cells.read_input_registers(0, 6).await.unwrap().unwrap();
    assert_eq!(counts[1], 0);
    assert!(counts[0] > 5000);
    assert!(call(&mut cells, Request::ReadInputRegisters(0, 9)).await == Err(2));
}

#[tokio::test]
async fn a_module_that_hangs_in_the_air_says_so_under_load_too() {
    let (rig, mut control, mut iai) = bench(100.0).await;
    let surface_z_mm = over_the_skin(&mut iai, &mut control).await;
    control.say(json!({ "cmd": "fault", "kind": "hung_module", "device": "cells" })).await;
    let mut cells = cells_client(&rig).await;
    let in_the_air = cells.read_input_registers(0, 6).await.unwrap().unwrap();
    iai.go(3, surface_z_mm + 4.0, 60.0).await;
    assert!(control.status().await["forces_n"][0].as_f64().unwrap() > 2.0);
    assert_eq!(cells.read_input_registers(0, 6).await.unwrap().unwrap(), in_the_air);
    assert_eq!(cells.read_holding_registers(210, 1).await.unwrap().unwrap(), [0x6017]);
    control.say(json!({ "cmd": "mend" })).await;
    tokio::time::sleep(Duration::from_millis(10)).await;
    let loaded = cells.read_input_registers(0, 6).await.unwrap().unwrap();
    assert!(loaded[0] > in_the_air[0] + 500, "{loaded:?} after {in_the_air:?}");
}

#[tokio::test]
async fn a_tip_that_came_off_never_presses_and_its_cell_stays_alive() {
    let (rig, mut control, mut iai) = bench(100.0).await;
    let surface_z_mm = over_the_skin(&mut iai, &mut control).await;
    let off = json!({ "cmd": "fault", "kind": "missing_tip", "device": "cells", "arm": 2 });
    assert_eq!(control.say(off).await["ok"], true);
    iai.go(3, surface_z_mm + 4.0, 60.0).await;
    let forces = control.status().await["forces_n"].clone();
    assert!(forces[0].as_f64().unwrap() > 2.0 && forces[1] == 0.0, "{forces}");
    let mut cells = cells_client(&rig).await;
    assert!(cells.read_input_registers(1, 1).await.unwrap().unwrap()[0] > 5000);
    control.say(json!({ "cmd": "mend" })).await;
    assert!(control.status().await["forces_n"][1].as_f64().unwrap() > 2.0);
}

#[tokio::test]
async fn a_cut_line_drops_a_connection_without_carrying_out_what_it_asked() {
    let rig = switch_on(IAI_TCP, 1.0, "").await;
    let mut control = Control::open(&rig).await;
    let mut stage = tcp_client(&rig, "stage").await;
    stage.set_slave(Slave(1));
    stage.write_single_coil(0x0427, true).await.unwrap().unwrap();
    let cut = json!({ "cmd": "fault", "kind": "disconnect", "device": "stage", "for_s": 0.5 });
    assert_eq!(control.say(cut).await["ok"], true);
    let sent = timeout(SHORT, stage.write_single_coil(0x0403, true)).await.unwrap();
    assert!(sent.is_err(), "dropped: {sent:?}");
    assert_eq!(control.status().await["axes"][0]["servo"], false);
    tokio::time::sleep(Duration::from_millis(600)).await;
    let mut stage = tcp_client(&rig, "stage").await;
    stage.set_slave(Slave(1));
    stage.write_single_coil(0x0403, true).await.unwrap().unwrap();
    assert_eq!(control.status().await["axes"][0]["servo"], true);
}
