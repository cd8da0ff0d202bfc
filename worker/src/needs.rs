//! What a chunk needs of a machine, and what a machine has, as flags of the queue.
//! PURE. A worker takes a chunk only if it has every flag of the chunk.

use serde::{Deserialize, Serialize};

/// What a chunk needs, or a machine has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Needs {
    /// Whether a GPU is needed, or present.
    #[serde(default)]
    pub gpu: bool,
    /// Memory, MiB.
    #[serde(default)]
    pub memory_mib: u64,
}

/// Flag of a chunk that needs a GPU.
const GPU: &str = "gpu";
/// Memory is counted in steps of 1 GiB: a flag is a name, not a number.
const STEP_MIB: u64 = 1024;
/// Largest memory that has a flag, steps.
const STEPS_MAX: u64 = 4096;

impl Needs {
    /// Flags of a chunk; its memory is rounded up.
    pub fn flags(&self) -> Vec<String> {
        let gpu = self.gpu.then(|| GPU.to_owned());
        let steps = self.memory_mib.div_ceil(STEP_MIB);
        gpu.into_iter().chain((steps > 0).then(|| memory(steps))).collect()
    }

    /// Flags that chunks for a machine may have; its memory is rounded down.
    pub fn allowed(&self) -> Vec<String> {
        let gpu = self.gpu.then(|| GPU.to_owned());
        let steps = (self.memory_mib / STEP_MIB).min(STEPS_MAX);
        gpu.into_iter().chain((1..=steps).map(memory)).collect()
    }
}

fn memory(steps: u64) -> String {
    format!("memory_gib_{steps}")
}

/// Memory of this machine as `/proc/meminfo` states it, MiB; 0 if it does not.
pub fn memory_mib(meminfo: &str) -> u64 {
    let kib = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"));
    kib.and_then(|kib| kib.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()).unwrap_or(0)
        / 1024
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_may_take_what_fits_it() {
        let fits = |chunk: Needs, machine: Needs| {
            let allowed = machine.allowed();
            chunk.flags().iter().all(|flag| allowed.contains(flag))
        };
        let needs = |gpu, memory_mib| Needs { gpu, memory_mib };
        assert!(fits(needs(false, 0), needs(false, 0)));
        assert!(fits(needs(false, 1500), needs(false, 2048)));
        assert!(!fits(needs(false, 1500), needs(false, 2047)));
        assert!(fits(needs(true, 1), needs(true, 1024)));
        assert!(!fits(needs(true, 0), needs(false, 1 << 20)));
    }

    #[test]
    fn the_memory_of_a_machine_is_read() {
        assert_eq!(memory_mib("MemTotal:       24682980 kB\nMemFree: 1 kB\n"), 24_104);
        assert_eq!(memory_mib("nothing"), 0);
    }
}
