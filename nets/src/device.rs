//! Device of a training: threads of this machine, or a GPU.
//! Uses: burn, rayon. Never: nets.

use burn::tensor::Device;

use crate::error::TrainError;

/// Location of the tensors and device that computes on them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compute {
    /// This machine's processor.
    Cpu {
        /// Number of threads; 0: the number of cores.
        threads: usize,
    },
    /// The NVIDIA GPU with this index.
    #[cfg(feature = "cuda")]
    Cuda(usize),
    /// The first GPU that wgpu finds.
    #[cfg(feature = "wgpu")]
    Wgpu,
}

impl Compute {
    /// Whether tensors are in host memory.
    pub(crate) fn is_host(self) -> bool {
        matches!(self, Self::Cpu { .. })
    }

    pub(crate) fn device(self) -> Device {
        match self {
            Self::Cpu { .. } => Device::flex(),
            #[cfg(feature = "cuda")]
            Self::Cuda(number) => Device::cuda(number),
            #[cfg(feature = "wgpu")]
            Self::Wgpu => Device::wgpu(burn::tensor::DeviceKind::DefaultDevice),
        }
    }

    /// Runs work on a dedicated pool of threads.
    pub(crate) fn run<T: Send>(self, work: impl FnOnce() -> T + Send) -> Result<T, TrainError> {
        let threads = match self {
            Self::Cpu { threads } => threads,
            #[cfg(any(feature = "cuda", feature = "wgpu"))]
            _ => 1,
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let pool = pool.map_err(|e| TrainError::Threads(e.to_string()))?;
        Ok(pool.install(work))
    }
}
