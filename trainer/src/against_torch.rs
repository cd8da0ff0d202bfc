//! Tests: answers, losses, gradients and first steps of Adam equal PyTorch's, for the same weights
//! and samples. `tests/make_torch.py` wrote those to `tests/torch.json`.

use burn::tensor::{Device, Tensor, TensorData};
use nets::input::Input;
use nets::loss::Loss;
use nets::recipe::Recipe;
use nets::statistics::Statistics;
use serde::Deserialize;

use crate::adam::{Adam, Update};
use crate::loss::value;
use crate::model::Model;

/// PyTorch's results for one net.
#[derive(Deserialize)]
struct Case {
    recipe: String,
    channels: usize,
    target: usize,
    /// All numbers of the network, in the order of `Network::each_number`.
    numbers: Vec<f32>,
    inputs: Vec<f32>,
    targets: Vec<f32>,
    /// Answers of the untrained network.
    answers: Vec<f32>,
    /// Minimised loss before each step.
    losses: Vec<f64>,
    /// Gradients of the first loss, in the order of the numbers; none where nothing is trained.
    gradients: Vec<Option<f32>>,
    /// All numbers after the last step.
    after: Vec<f32>,
}

fn cases() -> Vec<Case> {
    serde_json::from_str(include_str!("../tests/torch.json")).unwrap()
}

/// Largest difference, relative to the largest number.
fn apart(found: &[f32], wanted: &[f32]) -> f32 {
    assert_eq!(found.len(), wanted.len());
    let size = wanted.iter().fold(0.0f32, |m, x| m.max(x.abs()));
    found.iter().zip(wanted).fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / size
}

/// A case's net on a device, ready for its first step.
struct Begun {
    recipe: Recipe,
    model: Model,
    loss: Loss,
    samples: [Tensor<2>; 2],
}

fn begin(case: &Case) -> Begun {
    let recipe = Recipe::from_toml(&case.recipe).unwrap();
    let statistics = Statistics::unknown(recipe.net.input().measured(), case.channels, case.target);
    let mut network = recipe.first(&statistics, case.target);
    assert_eq!(network.numbers().len(), case.numbers.len(), "{}", case.recipe);
    network.set_numbers(&case.numbers);
    let device = Device::flex();
    let loss = recipe.net.architecture().loss(network.target_size());
    let model = Model::new(network, Input::LAYERS, &device);
    let samples = [(&case.inputs, case.channels), (&case.targets, case.target)].map(|(x, len)| {
        Tensor::from_data(TensorData::new(x.clone(), [x.len() / len, len]), &device)
    });
    Begun { recipe, model, loss, samples }
}

fn gradients(begun: &mut Begun) -> (f64, Vec<Tensor<2>>) {
    let [inputs, targets] = begun.samples.clone();
    let loss = value(begun.loss, begun.model.learn(inputs), targets.autodiff());
    let minimised: f32 = loss.clone().into_scalar();
    (minimised.into(), begun.model.gradients(&mut loss.backward()))
}

#[test]
fn answers_are_those_of_pytorch() {
    for case in cases() {
        let mut begun = begin(&case);
        let answers = begun.model.answer(begun.samples[0].clone()).into_data();
        let apart = apart(answers.as_slice().unwrap(), &case.answers);
        assert!(apart < 2e-6, "{}: {apart}", case.recipe);
    }
}

#[test]
fn gradients_are_those_of_pytorch() {
    for case in cases() {
        let mut begun = begin(&case);
        let (loss, gradients) = gradients(&mut begun);
        assert!((loss / case.losses[0] - 1.0).abs() < 2e-6, "{}: {loss}", case.recipe);
        let mut gradients = gradients.into_iter();
        begun.model.move_parameters(|_| gradients.next().unwrap());
        let found = begun.model.network().numbers().into_iter();
        let (found, wanted): (Vec<f32>, Vec<f32>) =
            found.zip(&case.gradients).filter_map(|(x, g)| Some((x, (*g)?))).unzip();
        let apart = apart(&found, &wanted);
        assert!(apart < 5e-6, "{}: {apart}", case.recipe);
    }
}

/// Numbers after all steps of the case.
fn after(case: &Case, update: Update) -> Vec<f32> {
    let mut begun = begin(case);
    let device = Device::flex();
    let optimiser = begun.recipe.optimiser;
    let mut adam = Adam::new(optimiser, begun.model.shapes(), &device, update);
    for wanted in &case.losses {
        let (loss, gradients) = gradients(&mut begun);
        assert!((loss / wanted - 1.0).abs() < 1e-5, "{}: {loss}, {wanted}", case.recipe);
        adam.step(&mut begun.model, gradients, optimiser.learning_rate);
    }
    begun.model.network().numbers()
}

#[test]
fn steps_are_those_of_pytorch_in_place_and_as_tensors() {
    for case in cases() {
        for update in [Update::InPlace, Update::AsTensors] {
            let found = after(&case, update);
            let moved = apart(&case.numbers, &case.after);
            let apart = apart(&found, &case.after);
            assert!(apart < 2e-6 && apart < moved / 1e3, "{} {update:?}: {apart}", case.recipe);
        }
    }
}
