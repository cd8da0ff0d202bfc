//! Adam (Kingma and Ba 2015, algorithm 1), in the order of operations of PyTorch.
//! Uses: burn, rayon. Never: schedules, nets.
//!
//! burn's own Adam makes about fifteen passes over each matrix and allocates a new one each time.
//! In host memory one pass updates weight and moments in place, which halves the time of a step of
//! Transfer-Net; on other devices the same formula is tensor operations, which burn fuses.

use burn::tensor::{Device, Tensor, TensorData};
use nets::optimiser::Optimiser;
use rayon::prelude::*;

use crate::model::Model;

/// Number of values that one thread updates at a time.
const VALUES_AT_ONCE: usize = 1 << 14;

/// How weights and moments are updated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Update {
    /// In one pass over buffers in host memory.
    InPlace,
    /// By operations on tensors, on any device.
    AsTensors,
}

/// State of the optimiser.
pub(crate) struct Adam {
    settings: Optimiser,
    update: Update,
    /// Number of steps taken.
    steps: u64,
    /// For each parameter the means of gradient and squared gradient.
    moments: Vec<[Tensor<2>; 2]>,
}

/// Factors of one step.
#[derive(Clone, Copy)]
struct Step {
    beta1: f32,
    beta2: f32,
    rate: f32,
    /// `1 / sqrt(1 - beta2^t)`.
    unbias: f32,
    epsilon: f32,
}

impl Adam {
    /// Starts with zero moments, for parameters of these shapes.
    pub fn new(
        settings: Optimiser,
        shapes: impl Iterator<Item = [usize; 2]>,
        device: &Device,
        update: Update,
    ) -> Self {
        let zeros = |shape| [Tensor::zeros(shape, device), Tensor::zeros(shape, device)];
        Self { settings, update, steps: 0, moments: shapes.map(zeros).collect() }
    }

    /// Returns the number of steps, and the moments in the order of the parameters.
    pub fn state(&self) -> (u64, Vec<Vec<f32>>) {
        let read = |t: &Tensor<2>| t.to_data().try_to_vec::<f32>().expect("moments are f32");
        (self.steps, self.moments.iter().flatten().map(read).collect())
    }

    /// Restores a state; the lengths of the moments must match.
    pub fn set_state(&mut self, steps: u64, moments: Vec<Vec<f32>>) {
        self.steps = steps;
        for (moment, numbers) in self.moments.iter_mut().flatten().zip(moments) {
            let data = TensorData::new(numbers, moment.dims());
            *moment = Tensor::from_data(data, &moment.device());
        }
    }

    /// One step of a model at a learning rate, along gradients in the order of its parameters.
    pub fn step(&mut self, model: &mut Model, gradients: Vec<Tensor<2>>, learning_rate: f64) {
        self.steps += 1;
        let Optimiser { beta1, beta2, epsilon, .. } = self.settings;
        let taken = self.steps as f64;
        let step = Step {
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            rate: (learning_rate / (1.0 - beta1.powf(taken))) as f32,
            unbias: (1.0 / (1.0 - beta2.powf(taken)).sqrt()) as f32,
            epsilon: epsilon as f32,
        };
        let mut old = std::mem::take(&mut self.moments).into_iter().zip(gradients);
        model.move_parameters(|weight| {
            let (moments, gradient) = old.next().expect("every parameter has moments");
            let [first, second] = moments;
            let moved = [weight, first, second];
            let (weight, moments) = match self.update {
                Update::InPlace => step.in_place(moved, gradient),
                Update::AsTensors => step.as_tensors(moved, gradient),
            };
            self.moments.push(moments);
            weight
        });
    }
}

impl Step {
    /// In host memory, in one pass over buffers with no other owner.
    fn in_place(self, moved: [Tensor<2>; 3], gradient: Tensor<2>) -> (Tensor<2>, [Tensor<2>; 2]) {
        let device = gradient.device();
        let [mut weight, mut first, mut second] = moved.map(Tensor::into_data);
        let gradient = gradient.into_data();
        let parts = numbers_mut(&mut weight)
            .par_chunks_mut(VALUES_AT_ONCE)
            .zip(numbers_mut(&mut first).par_chunks_mut(VALUES_AT_ONCE))
            .zip(numbers_mut(&mut second).par_chunks_mut(VALUES_AT_ONCE))
            .zip(gradient.as_slice::<f32>().expect("gradients are f32").par_chunks(VALUES_AT_ONCE));
        parts.for_each(|(((weight, first), second), gradient)| {
            for (((w, m), v), &g) in weight.iter_mut().zip(first).zip(second).zip(gradient) {
                *m += (1.0 - self.beta1) * (g - *m);
                *v = self.beta2 * *v + (1.0 - self.beta2) * g * g;
                *w -= self.rate * *m / (v.sqrt() * self.unbias + self.epsilon);
            }
        });
        let put = |data| Tensor::from_data(data, &device);
        (put(weight), [put(first), put(second)])
    }

    /// On any device.
    fn as_tensors(self, moved: [Tensor<2>; 3], gradient: Tensor<2>) -> (Tensor<2>, [Tensor<2>; 2]) {
        let [weight, first, second] = moved;
        let square = gradient.clone() * gradient.clone();
        let first = first.clone() + (gradient - first).mul_scalar(1.0 - self.beta1);
        let second = second.mul_scalar(self.beta2) + square.mul_scalar(1.0 - self.beta2);
        let spread = second.clone().sqrt().mul_scalar(self.unbias).add_scalar(self.epsilon);
        let weight = weight - first.clone().mul_scalar(self.rate) / spread;
        (weight, [first, second])
    }
}

fn numbers_mut(data: &mut TensorData) -> &mut [f32] {
    data.as_mut_slice().expect("parameters and moments are f32")
}
