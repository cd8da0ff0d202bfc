//! Answers of a network through burn.
//! Uses: burn, `model`. Never: training.

use burn::tensor::{Tensor, TensorData};
use nets::compute::Compute;
use nets::error::TrainError;
use nets::network::Network;

use crate::device;
use crate::model::Model;

/// Computes the answers of a network through burn, one after the other, for frames one after the
/// other: the reference for other runtimes.
///
/// # Errors
/// `TrainError::Threads` if the threads could not be started; `Device` if this build lacks the device.
pub fn answer(network: &Network, frames: &[f32], compute: Compute) -> Result<Vec<f32>, TrainError> {
    device::run(compute, || {
        let device = device::of(compute)?;
        let mut model = Model::new(network.clone(), network.layers.len(), &device);
        let batch = frames.len() / network.inputs;
        let data = TensorData::new(frames.to_vec(), [batch, network.inputs]);
        let answers = model.answer(Tensor::from_data(data, &device)).into_data();
        Ok(answers.try_to_vec::<f32>().expect("answers are f32"))
    })?
}
