//! IAI axes and an ADAM-6017 over Modbus TCP.

use std::time::Instant;

use sim_core::stats::{sorted, upper_quantile};
use tokio_modbus::Request;
use tokio_modbus::prelude::{Reader, Slave, Writer};
use tokio_modbus::slave::SlaveContext;

use crate::common::{IAI_TCP, bench, call, cells_client, over_the_skin, switch_on, tcp_client};

#[tokio::test]
async fn axes_home_move_and_press_and_the_cells_show_it() {
    let (rig, mut control, mut iai) = bench(100.0).await;
    let mut cells = cells_client(&rig).await;
    let surface = over_the_skin(&mut iai, &mut control).await;
    let zero = cells.read_input_registers(0, 6).await.unwrap().unwrap();
    iai.go(3, surface + 5.0, 60.0).await;
    // The module converts ten times per process second.
    tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    let loaded = cells.read_input_registers(0, 6).await.unwrap().unwrap();
    let status = control.status().await;
    for arm in 0..6 {
        let counts = f64::from(loaded[arm]) - f64::from(zero[arm]);
        let measured = counts / 65535.0 * 5.0 * 111.2 / 4.0;
        let truth = status["forces_n"][arm].as_f64().unwrap();
        assert!((measured - truth).abs() < 0.5, "arm {arm}: {measured} for {truth}");
    }
    assert!(status["forces_n"][0].as_f64().unwrap() > 5.0);
    assert_eq!(
        (status["presses"].as_u64(), status["lateral_in_contact"].as_u64()),
        (Some(1), Some(0))
    );
    // A motion that the service must never make is detected.
    iai.go(1, 290.0, 250.0).await;
    assert_eq!(control.status().await["lateral_in_contact"], 1);
}

#[tokio::test]
async fn a_stop_is_counted_with_its_time_and_ends_the_motion() {
    let (_rig, mut control, mut iai) = bench(1.0).await;
    let context = iai.unit(4);
    for (coil, on) in [(0x0427, true), (0x0403, true), (0x040B, true), (0x040A, true)] {
        context.write_single_coil(coil, on).await.unwrap().unwrap();
    }
    let sent = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    let status = control.status().await;
    assert_eq!(status["stops"], 1);
    assert_eq!(status["stop_receipts"][0]["axis"], "radial");
    let received = status["stop_receipts"][0]["unix_s"].as_f64().unwrap();
    assert!((sent.as_secs_f64() - received).abs() < 0.5);
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    assert_eq!(control.status().await["axes"][3]["moving"], false);
}

#[tokio::test]
async fn exceptions_are_those_of_the_devices() {
    let rig = switch_on(IAI_TCP, 1.0, "").await;
    let mut stage = tcp_client(&rig, "stage").await;
    stage.set_slave(Slave(1));
    assert_eq!(call(&mut stage, Request::ReadInputRegisters(0x9000, 2)).await, Err(1));
    assert_eq!(call(&mut stage, Request::ReadHoldingRegisters(0x1234, 1)).await, Err(2));
    assert_eq!(call(&mut stage, Request::WriteSingleCoil(0x0999, true)).await, Err(2));
    let mut cells = tcp_client(&rig, "cells").await;
    assert_eq!(call(&mut cells, Request::WriteSingleRegister(200, 7)).await, Err(11));
    cells.set_slave(Slave(1));
    assert_eq!(call(&mut cells, Request::WriteSingleRegister(200, 7)).await, Err(3));
    // No device at unit 77: the gateway reports it.
    stage.set_slave(Slave(77));
    assert_eq!(call(&mut stage, Request::ReadHoldingRegisters(0x9000, 1)).await, Err(11));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_round_trip_is_short() {
    let rig = switch_on(IAI_TCP, 1.0, "").await;
    let mut stage = tcp_client(&rig, "stage").await;
    stage.set_slave(Slave(1));
    let mut times: Vec<f64> = Vec::new();
    for _ in 0..300 {
        let since = Instant::now();
        stage.read_holding_registers(0x9000, 10).await.unwrap().unwrap();
        times.push(since.elapsed().as_secs_f64());
    }
    let times = sorted(times);
    let [median, p90] = [0.5, 0.9].map(|share| upper_quantile(&times, share).unwrap());
    println!("median {:.0} us, p90 {:.0} us", median * 1e6, p90 * 1e6);
    assert!(median < 5e-3, "median {median} s: the wire is delayed");
}
