//! Device of a training, by name: threads of a machine, or a GPU.
//! PURE. Never: the device itself (the trainer has it).

use serde::{Deserialize, Serialize};

/// Location of the tensors and device that computes on them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compute {
    /// The processor.
    Cpu {
        /// Number of threads; 0: the number of cores.
        threads: usize,
    },
    /// The NVIDIA GPU with this index.
    Cuda(usize),
    /// The first GPU that wgpu finds.
    Wgpu,
}

impl Compute {
    /// Whether tensors are in host memory.
    pub fn is_host(self) -> bool {
        matches!(self, Self::Cpu { .. })
    }
}
