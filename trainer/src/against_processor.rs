//! Tests of a build for a GPU: losses and gradients of the paper's nets, at the size of its sensor,
//! equal those of the processor.

use burn::tensor::{Device, Tensor, TensorData};
use nets::input::Input;
use nets::noise::{Noise, NoiseSource};
use nets::recipe::Recipe;
use nets::samples::Samples;
use nets::statistics::Statistics;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;

use crate::device;
use crate::loss::value;
use crate::model::Model;
use crate::rows::Fixed;

const CHANNELS: usize = 784;
const POINTS: usize = 804;
const ROWS: usize = 512;
const BATCH: usize = 64;
/// Largest norm of a difference, relative to the norm of the processor's result. CUDA's matrix products
/// round their factors to the 10 bits of TF32; PyTorch's gradients differ by 4 % between TF32 and f32.
const APART_MAX: f64 = if cfg!(feature = "cuda") { 0.1 } else { 1e-4 };

/// Random frames of about 30 mV, and targets of which one in a hundred is 9 N.
fn random(target_len: usize) -> Fixed {
    let mut chance = ChaCha12Rng::seed_from_u64(3);
    let inputs = (0..ROWS * CHANNELS).map(|_| chance.random_range(-0.05..0.05f32)).collect();
    let mut target = || if chance.random_range(0..100) == 0 { 9.0 } else { 0.0 };
    let targets = (0..ROWS * target_len).map(|_| target()).collect();
    Fixed { lens: [CHANNELS, target_len], inputs, targets }
}

/// Minimised loss and all gradients of the first batch on a device.
fn learned(recipe: &Recipe, samples: &Fixed, device: &Device) -> (f64, Vec<Vec<f32>>) {
    let noise = NoiseSource::new(1, Noise::default(), None, CHANNELS);
    let measured = recipe.net.input().measured();
    let statistics = Statistics::measure(samples, measured, &noise, 1).unwrap();
    let network = recipe.first(&statistics, samples.target_len());
    let loss = recipe.net.architecture().loss(network.target_size());
    let mut model = Model::new(network, Input::LAYERS, device);
    let put = |numbers: &[f32], len: usize| {
        let data = TensorData::new(numbers[..BATCH * len].to_vec(), [BATCH, len]);
        Tensor::<2>::from_data(data, device)
    };
    let targets = put(&samples.targets, samples.target_len()).autodiff();
    let loss = value(loss, model.learn(put(&samples.inputs, CHANNELS)), targets);
    let minimised: f32 = loss.clone().into_scalar();
    let gradients = model.gradients(&mut loss.backward()).into_iter();
    let numbers = |gradient: Tensor<2>| gradient.into_data().try_to_vec::<f32>().unwrap();
    (minimised.into(), gradients.map(numbers).collect())
}

/// Norm of the difference, relative to that of the second.
fn apart(found: &[f32], wanted: &[f32]) -> f64 {
    let norm = |numbers: &mut dyn Iterator<Item = f64>| numbers.map(|x| x * x).sum::<f64>().sqrt();
    let difference = found.iter().zip(wanted).map(|(a, b)| f64::from(*a) - f64::from(*b));
    norm(&mut difference.into_iter()) / norm(&mut wanted.iter().map(|x| f64::from(*x)))
}

#[test]
fn gradients_on_a_gpu_are_those_of_the_processor() {
    for net in [
        r#"{kind="transfer-net"}"#,
        r#"{kind="transfer-net",form="residual"}"#,
        r#"{kind="recon-net",side=160,upsampling="apart"}"#,
        r#"{kind="recon-net",side=160}"#,
        r#"{kind="recon-net",side=160,upsampling="shuffled"}"#,
        r#"{kind="point-net"}"#,
    ] {
        let recipe = Recipe::from_toml(&format!("seed = 1\nepochs = 1\nnet = {net}\n")).unwrap();
        let samples = random(recipe.net.answer().target_len(CHANNELS, POINTS));
        let (loss, wanted) = learned(&recipe, &samples, &Device::flex());
        let gpu = device::of(device::own()).unwrap();
        let (found_loss, found) = learned(&recipe, &samples, &gpu);
        let each = found.iter().zip(&wanted).map(|(found, wanted)| apart(found, wanted));
        let most = each.fold((found_loss / loss - 1.0).abs(), f64::max);
        println!("{net}: {most:.1e}");
        assert!(most < APART_MAX, "{net}: {most:.1e}, loss {found_loss} instead of {loss}");
    }
}
