//! The device of a training: what this build has, and the threads that compute.
//! Uses: burn, rayon. Never: nets.

use burn::tensor::Device;
use nets::compute::Compute;
use nets::error::TrainError;

/// The device that this build is for: a GPU if it was built for one.
pub fn own() -> Compute {
    if cfg!(feature = "cuda") {
        Compute::Cuda(0)
    } else if cfg!(feature = "wgpu") {
        Compute::Wgpu
    } else {
        Compute::Cpu { threads: 0 }
    }
}

/// burn's device.
///
/// # Errors
/// `TrainError::Device` if this build does not have it.
pub(crate) fn of(compute: Compute) -> Result<Device, TrainError> {
    match compute {
        Compute::Cpu { .. } => Ok(Device::flex()),
        #[cfg(feature = "cuda")]
        Compute::Cuda(number) => Ok(Device::cuda(number)),
        #[cfg(not(feature = "cuda"))]
        Compute::Cuda(_) => Err(TrainError::Device("cuda")),
        #[cfg(feature = "wgpu")]
        Compute::Wgpu => Ok(Device::wgpu(burn::tensor::DeviceKind::DefaultDevice)),
        #[cfg(not(feature = "wgpu"))]
        Compute::Wgpu => Err(TrainError::Device("wgpu")),
    }
}

/// Runs work on a dedicated pool of threads.
///
/// # Errors
/// `TrainError::Threads` if they could not be started.
pub(crate) fn run<T: Send>(
    compute: Compute,
    work: impl FnOnce() -> T + Send,
) -> Result<T, TrainError> {
    let threads = match compute {
        Compute::Cpu { threads } => threads,
        Compute::Cuda(_) | Compute::Wgpu => 1,
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|e| TrainError::Threads(e.to_string()))?;
    Ok(pool.install(work))
}
