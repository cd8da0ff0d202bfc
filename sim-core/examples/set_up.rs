//! Time of the unit responses without and with the cache, and the peak of memory.
//! `cargo run -p sim-core --example set_up`

use std::time::Instant;

use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sensor = Sensor::from_toml(include_str!("../../experiments/sensors/ert-28.toml"))?;
    let began = Instant::now();
    let solved = UnitResponses::solve(&sensor)?;
    println!("{} rows from nothing: {:.2?}", solved.nodes(), began.elapsed());
    print_peak();
    let path = std::env::temp_dir().join(format!("unit-responses-{}.bin", std::process::id()));
    std::fs::write(&path, solved.to_bytes())?;
    for _ in 0..5 {
        let began = Instant::now();
        let bytes = std::fs::read(&path)?;
        let read = began.elapsed();
        let cached = UnitResponses::from_bytes(&bytes, &sensor)?;
        println!(
            "{:.1} MB from the cache: {:.0?}, {read:.0?} of it the file",
            1e-6 * bytes.len() as f64,
            began.elapsed()
        );
        assert!(cached == solved, "the cache holds what was solved");
    }
    std::fs::remove_file(&path)?;
    print_peak();
    Ok(())
}

/// Prints the peak of memory; Linux only, elsewhere it prints nothing.
fn print_peak() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    if let Some(line) = status.lines().find(|line| line.starts_with("VmHWM")) {
        println!("peak of memory: {}", line.trim_start_matches("VmHWM:").trim());
    }
}
