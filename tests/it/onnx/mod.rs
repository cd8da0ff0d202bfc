//! Nets as ONNX files: the same answers in tract, in onnxruntime and in the trainer, files of another
//! program, and files that are damaged.

mod kinds;
mod random_nets;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use nets::compute::Compute;
use nets::network::{Form, Layer, Network};
use palpate::ids::ModelId;
use palpate::infer::plan::{Plan, PlanError};
use palpate::learn::onnx::write::{Description, to_onnx};
use palpate::learn::onnx::{OnnxFile, sealed};
use palpate_trainer::answer::answer;

use kinds::{KINDS, conv, kind_index, kinds};
use random_nets::{CHANNELS, Draw, architectures, net};

use crate::support::{self, Folder, succeeded};

/// Frames for each net: batches of 64 and of eight, and three alone.
const COMPARED_FRAMES: usize = 75;

fn file_of(network: &Network) -> Vec<u8> {
    let says = Description {
        name: "net",
        doc: "random weights",
        input: ["voltages_v", "V"],
        output: ["answer_n", "N"],
        version: "1",
        properties: &[("palpate.task".into(), "test".into())],
    };
    sealed(to_onnx(network, &says).unwrap(), &ModelId::unchecked("mdl-0123456789abcdef"))
}

fn to_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn from_bytes(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// Largest difference, over the largest number that was expected.
fn apart(found: &[f32], wanted: &[f32]) -> f32 {
    assert_eq!(found.len(), wanted.len());
    let largest = wanted.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
    let pairs = found.iter().zip(wanted);
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) / largest
}

#[derive(serde::Deserialize)]
struct Compared {
    difference: f64,
    largest: f64,
    shape: Vec<usize>,
    input: String,
    output: String,
    metadata: BTreeMap<String, String>,
}

#[test]
fn tract_and_the_trainer_give_the_same_answers_for_every_layer_and_every_net() {
    let mut draw = Draw::new(1);
    for (name, network) in [kinds(&mut draw), architectures(&mut draw)].concat() {
        let frames = draw.frames(COMPARED_FRAMES, network.inputs);
        let mut answers = Vec::new();
        let plan = Plan::load(&file_of(&network), network.inputs, &network.output).unwrap();
        plan.answer(&frames, &mut answers).unwrap();
        let trainers = answer(&network, &frames, Compute::Cpu { threads: 1 }).unwrap();
        assert!(apart(&answers, &trainers) <= 1e-5, "{name}: {}", apart(&answers, &trainers));
    }
}

#[test]
fn tract_and_onnxruntime_give_the_same_answers_for_every_layer_and_every_net() {
    let Some(python) = support::python("onnx, onnxruntime") else { return };
    let folder = Folder::new("onnx-compare");
    let mut draw = Draw::new(1);
    let nets = [kinds(&mut draw), architectures(&mut draw)].concat();
    let mut covered = [false; KINDS];
    for (name, network) in &nets {
        network.layers.iter().for_each(|layer| covered[kind_index(layer)] = true);
        let file = file_of(network);
        let frames = draw.frames(COMPARED_FRAMES, network.inputs);
        let mut answers = Vec::new();
        let plan = Plan::load(&file, network.inputs, &network.output).unwrap();
        plan.answer(&frames, &mut answers).unwrap();
        let path = folder.join(name);
        fs::write(path.with_extension("onnx"), file).unwrap();
        fs::write(path.with_extension("frames"), to_bytes(&frames)).unwrap();
        fs::write(path.with_extension("answers"), to_bytes(&answers)).unwrap();
    }
    assert_eq!(covered, [true; KINDS], "a kind of layer has no net");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/onnx/compare.py");
    let output = Command::new(&python).arg(script).arg(&*folder).output().unwrap();
    let compared: BTreeMap<String, Compared> = serde_json::from_str(&succeeded(&output)).unwrap();
    assert_eq!(compared.len(), nets.len());
    for (name, network) in &nets {
        let found = &compared[*name];
        let relative = found.difference / found.largest;
        println!(
            "{name}: {:.1e} of {:.3}, relative {relative:.1e}",
            found.difference, found.largest
        );
        assert!(relative <= 1e-5, "{name}: {relative:e}");
        assert_eq!(found.shape, [&[COMPARED_FRAMES], &network.output[..]].concat(), "{name}");
        assert_eq!([&found.input, &found.output], ["voltages_v", "answer_n"]);
        assert_eq!(found.metadata["palpate.model"], "mdl-0123456789abcdef");
        assert_eq!(found.metadata["palpate.task"], "test");
    }
}

#[test]
fn files_of_pytorch_are_served_as_they_are() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/onnx/pytorch"));
    let frames = from_bytes(&fs::read(folder.join("frames.f32")).unwrap());
    for name in ["dynamo", "torchscript"] {
        let file = fs::read(folder.join(name).with_extension("onnx")).unwrap();
        let wanted = from_bytes(&fs::read(folder.join("answers.f32")).unwrap());
        let onnx = OnnxFile::read(&file).unwrap();
        assert!(onnx.model().producer_name.starts_with("pytorch"));
        let plan = Plan::load(&file, 20, &[8, 8]).unwrap();
        let mut answers = Vec::new();
        plan.answer(&frames, &mut answers).unwrap();
        assert!(apart(&answers, &wanted) <= 1e-5, "{name}: {}", apart(&answers, &wanted));
    }
}

#[test]
fn callers_share_a_plan_and_pieces_do_not_change_an_answer() {
    let mut draw = Draw::new(2);
    let network = random_nets::recon(&mut draw, 32);
    let plan = Plan::load(&file_of(&network), CHANNELS, &[32, 32]).unwrap();
    let frames = draw.frames(19, CHANNELS);
    let mut whole = Vec::new();
    plan.answer(&frames, &mut whole).unwrap();
    assert_eq!(whole.len(), 19 * 32 * 32);
    let mut single = Vec::new();
    for frame in frames.chunks_exact(CHANNELS) {
        plan.answer(frame, &mut single).unwrap();
    }
    assert!(apart(&single, &whole) <= 1e-5);
    std::thread::scope(|scope| {
        let (plan, frames, whole) = (&plan, &frames, &whole);
        for _ in 0..4 {
            scope.spawn(move || {
                for _ in 0..5 {
                    let mut answers = Vec::new();
                    plan.answer(frames, &mut answers).unwrap();
                    assert_eq!(&answers, whole);
                }
            });
        }
    });
}

/// A step that does nothing keeps a batch norm from becoming part of the layer before it.
#[test]
fn a_batch_norm_in_the_layer_before_it_gives_the_same_answers() {
    let mut draw = Draw::new(5);
    let image = Layer::Image { channels: 3, height: 2, width: 2 };
    let befores = [
        (vec![draw.dense(12, 6)], 6, vec![6]),
        (vec![draw.dense(12, 12), image.clone()], 3, vec![3, 2, 2]),
        (vec![image.clone(), conv(&mut draw, 3, 5, 3, true)], 5, vec![5, 2, 2]),
        (vec![image.clone(), conv(&mut draw, 3, 5, 3, false)], 5, vec![5, 2, 2]),
        (vec![image, draw.up(3, 4)], 4, vec![4, 4, 4]),
    ];
    let nothing = Layer::Scale { scale: 1.0, shift: 0.0 };
    for (before, channels, output) in befores {
        let norm = draw.batch_norm(channels);
        let frames = draw.frames(3, 12);
        let [inside, outside] = [vec![], vec![nothing.clone()]].map(|between| {
            let layers = [before.clone(), between, vec![norm.clone()]].concat();
            let file = file_of(&net(12, &output, layers, Form::Plain));
            let norms = OnnxFile::read(&file).unwrap().operators().contains(&"BatchNormalization");
            let mut answers = Vec::new();
            let plan = Plan::load(&file, 12, &output).unwrap();
            plan.answer(&frames, &mut answers).unwrap();
            (norms, answers)
        });
        assert!(!inside.0 && outside.0);
        assert!(apart(&inside.1, &outside.1) < 1e-6, "{}", apart(&inside.1, &outside.1));
    }
}

/// Cuts and changes must be refused by name, or (a changed weight) answered; never a panic, and what
/// is refused for a wrong number is never a crash.
#[test]
fn a_damaged_file_is_refused_or_served_but_never_ends_the_process() {
    let mut draw = Draw::new(3);
    let nets = kinds(&mut draw);
    let (mut refused, mut served) = (0, 0);
    let mut tried =
        |file: &[u8], network: &Network| match Plan::load(file, network.inputs, &network.output) {
            Ok(plan) => {
                let mut out = Vec::new();
                let answered = plan.answer(&vec![0.01; network.inputs * 3], &mut out);
                assert!(answered.is_ok() || out.is_empty());
                served += 1;
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                refused += 1;
            }
        };
    for (_, network) in &nets {
        let file = file_of(network);
        for part in 0..40 {
            tried(&file[..file.len() * part / 40], network);
        }
        for _ in 0..60 {
            let mut damaged = file.clone();
            for place in draw.numbers(3, 0.0, 1.0) {
                let place = (place * file.len() as f32) as usize % file.len();
                damaged[place] ^= 1 << (place % 8);
            }
            tried(&damaged, network);
        }
    }
    println!("{refused} refused, {served} served");
    assert!(refused > 40 * nets.len() / 2 && served > 0, "{refused} refused, {served} served");
}

#[test]
fn frames_that_cannot_be_answered_are_named_and_nothing_is_appended() {
    let mut draw = Draw::new(4);
    let (_, network) = kinds(&mut draw).swap_remove(0);
    let file = file_of(&network);
    let plan = Plan::load(&file, 12, &[7]).unwrap();
    let mut out = vec![1.0];
    let frames = PlanError::Frames { numbers: 13, channels: 12 };
    assert_eq!(plan.answer(&[0.0; 13], &mut out), Err(frames));
    let mut frames = vec![0.0; 10 * 12];
    frames[9 * 12 + 5] = f32::NAN;
    let hole = PlanError::NotFinite { frame: 9, channel: 5 };
    assert_eq!(plan.answer(&frames, &mut out), Err(hole));
    frames[9 * 12 + 5] = f32::MAX;
    frames[9 * 12 + 6] = f32::MAX;
    assert!(matches!(plan.answer(&frames, &mut out), Err(PlanError::NoAnswer { frame: 9 })));
    assert_eq!(out, [1.0]);
    plan.answer(&[], &mut out).unwrap();
    assert_eq!(out, [1.0]);
}
