//! All devices on one RS-485 line, a pseudo-terminal.

use std::time::Instant;

use tokio_modbus::Request;
use tokio_modbus::client::Context;
use tokio_modbus::prelude::{Reader, Slave, Writer};
use tokio_modbus::slave::SlaveContext;
use virtual_rig::VirtualRig;

use crate::common::{Control, Iai, PATIENCE, call, on_one_bus, rtu_client, switch_on};

async fn long(context: &mut Context, address: u16) -> i32 {
    let words = context.read_holding_registers(address, 2).await.unwrap().unwrap();
    (u32::from(words[0]) << 16 | u32::from(words[1])) as i32
}

async fn until(context: &mut Context, address: u16, bit: u16, set: bool) {
    let since = Instant::now();
    loop {
        let word = context.read_holding_registers(address, 1).await.unwrap().unwrap()[0];
        if (word & 1 << bit != 0) == set {
            return;
        }
        assert!(since.elapsed() < PATIENCE, "register {address:04x} stays {word:04x}");
    }
}

async fn cells_answer_too(rig: &VirtualRig, context: &mut Context) {
    context.set_slave(Slave(9));
    let millivolts = context.read_input_registers(0, 8).await.unwrap().unwrap();
    assert!(millivolts[..6].iter().all(|v| (400..650).contains(v)), "{millivolts:?}");
    assert_eq!(millivolts[6..], [0, 0]);
    let mut control = Control::open(rig).await;
    control.say(serde_json::json!({ "cmd": "mount", "tips": 1 })).await;
    let millivolts = context.read_input_registers(0, 6).await.unwrap().unwrap();
    assert_eq!(millivolts[1..], [0; 5]);
}

#[tokio::test]
async fn oriental_motor_axes_share_the_line_with_the_cells() {
    let rig = switch_on(&on_one_bus("oriental_az", 200.0, 100.0), 100.0, "").await;
    let mut bus = rtu_client(&rig);
    for unit in 1..=4 {
        bus.set_slave(Slave(unit));
        for word in [0, 1 << 4, 0] {
            bus.write_multiple_registers(0x007C, &[0, word]).await.unwrap().unwrap();
        }
    }
    for unit in 1..=4 {
        bus.set_slave(Slave(unit));
        until(&mut bus, 0x007F, 4, true).await;
    }
    bus.set_slave(Slave(2));
    // 123 mm at 200 steps/mm, 250 mm/s, 1500 mm/s^2.
    let values: [i32; 8] = [0, 1, 24_600, 50_000, 300_000, 300_000, 1000, 1];
    let words: Vec<u16> =
        values.iter().flat_map(|&v| [(v as u32 >> 16) as u16, v as u16]).collect();
    bus.write_multiple_registers(0x0058, &words).await.unwrap().unwrap();
    until(&mut bus, 0x007F, 13, false).await;
    assert_eq!(long(&mut bus, 0x00CC).await, 24_600);
    let truth = Control::open(&rig).await.status().await;
    assert_eq!(truth["axes"][1]["position"], 123.0);
    cells_answer_too(&rig, &mut bus).await;
}

#[tokio::test]
async fn leadshine_axes_run_paths() {
    let rig = switch_on(&on_one_bus("leadshine_em2rs", 2000.0, 100.0), 100.0, "").await;
    let mut bus = rtu_client(&rig);
    bus.set_slave(Slave(1));
    bus.write_single_register(0x6002, 0x20).await.unwrap().unwrap();
    until(&mut bus, 0x1003, 6, true).await;
    let pulses: u32 = 246_000;
    let path = [1, (pulses >> 16) as u16, pulses as u16, 1200, 80, 80, 0, 0];
    bus.write_multiple_registers(0x6200, &path).await.unwrap().unwrap();
    bus.write_single_register(0x6002, 0x10).await.unwrap().unwrap();
    until(&mut bus, 0x1003, 2, false).await;
    assert_eq!(long(&mut bus, 0x1014).await, 246_000);
    assert_eq!(call(&mut bus, Request::WriteSingleRegister(0x6002, 0x99)).await, Err(3));
    let truth = Control::open(&rig).await.status().await;
    assert_eq!(truth["axes"][0]["position"], 123.0);
}

#[tokio::test]
async fn the_line_survives_noise_silence_and_a_new_client() {
    let rig = switch_on(&on_one_bus("iai", 100.0, 100.0), 100.0, "").await;
    {
        let mut iai = Iai(rtu_client(&rig));
        iai.home(1..=1).await;
        // No device has address 42: no reply, which must not disturb the next request.
        let nobody = iai.unit(42).read_holding_registers(0x9000, 1);
        assert!(tokio::time::timeout(std::time::Duration::from_millis(60), nobody).await.is_err());
    }
    {
        use tokio::io::AsyncWriteExt;
        let path = &rig.ready.lines["stage"];
        let mut noise =
            tokio_serial::SerialStream::open(&tokio_serial::new(path, 115_200)).unwrap();
        noise.write_all(&[0x01, 0x03, 0x90]).await.unwrap();
        tokio::time::sleep(std::time::Duration::from_millis(60)).await;
        noise.write_all(&[0x01, 0x03, 0x90, 0, 0, 1, 0xBA, 0xD0, 0x55]).await.unwrap();
        tokio::time::sleep(std::time::Duration::from_millis(60)).await;
    }
    let mut iai = Iai(rtu_client(&rig));
    iai.go(1, 42.5, 250.0).await;
    // In position means within a band of 0.01 mm.
    assert!((iai.status(1).await.0 - 42.5).abs() < 0.011);
}
