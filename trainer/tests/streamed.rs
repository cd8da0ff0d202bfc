//! Point-Net learns from the stream of simulated samples.

use std::sync::{Arc, OnceLock};

use nets::compute::Compute;
use nets::points::draws::Draws;
use nets::points::streamed::Streamed;
use nets::progress::{Flow, Observer, Plan, Progress};
use nets::recipe::Recipe;
use palpate_trainer::train::train;
use sim_core::batch::{BatchModel, Kernel};
use sim_core::forward::ForwardModel;
use sim_core::responses::UnitResponses;
use sim_core::sensor::Sensor;

/// Model of the paper's skin, solved once.
fn model() -> &'static ForwardModel {
    static MODEL: OnceLock<ForwardModel> = OnceLock::new();
    MODEL.get_or_init(|| {
        let text = include_str!("../../experiments/sensors/ert-28.toml");
        let sensor = Sensor::from_toml(text).unwrap();
        let responses = Arc::new(UnitResponses::solve(&sensor).unwrap());
        ForwardModel::new(&sensor, responses).unwrap()
    })
}

fn batch() -> Arc<BatchModel> {
    static BATCH: OnceLock<Arc<BatchModel>> = OnceLock::new();
    BATCH.get_or_init(|| Arc::new(BatchModel::new(model(), Kernel::detect()))).clone()
}

fn stream(seed: u64, len: u64) -> Streamed {
    Streamed::new(batch(), model().sensor().points(), Draws::default(), seed, len)
}

/// Stores validation losses.
struct Losses(Vec<f64>);

impl Observer for Losses {
    fn see(&mut self, progress: &Progress) -> Flow {
        self.0.extend(progress.validation_loss);
        Flow::Continue
    }
    fn keep(&mut self, _: Vec<u8>) {}
}

#[test]
fn point_net_learns_from_a_stream_that_never_repeats() {
    let toml = "seed = 4\nepochs = 4\nbatch = 64\n[net]\nkind = 'point-net'\nhidden = 2\n\
                width = 128\n[noise]\nwhite_v = 0.0012\n[optimiser]\nbeta1 = 0.9\n";
    let recipe = Recipe::from_toml(toml).unwrap();
    let compute = Compute::Cpu { threads: 1 };
    let plan = Plan { recipe, data: "model".into(), noise_sd_v: None, start: None, compute };
    let mut losses = Losses(Vec::new());
    train(&plan, &stream(5, 4000), &stream(6, 500), None, &mut losses).unwrap();
    let [first, .., last] = losses.0[..] else { panic!("{:?}", losses.0) };
    // Answer of a net that knows only the mean number of pressed points and their mean force:
    // 3.4 (1 + ln(804 / 3.4)) = 22.0 of entropy, and 3.4 x 0.47 of spread of ln force.
    assert!(first < 24.0 && last < 21.5 && last < first, "{:?}", losses.0);
}
