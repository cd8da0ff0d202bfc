//! Manifests: facts survive a round trip, invalid values are named, ids cover facts and weights.

use nets::network::{Form, Layer, Network};

use super::*;

fn sensor() -> SensorFacts {
    SensorFacts { name: "ert-28".into(), channels: 4, points: 3 }
}

fn facts() -> ModelFacts {
    ModelFacts {
        task: NetTask::Recon,
        label: Label::Virtual,
        sensor: "ert-28".into(),
        channels: 4,
        output_shape: vec![8, 8],
        places_mm: Vec::new(),
        force_map: Some("80x160".parse().unwrap()),
        datasets: vec![DatasetId::unchecked("ds-0123456789abcdef")],
        calibration: Some(CalibrationId::unchecked("cal-1")),
        simulation: None,
        code: "palpate 0.1.0".into(),
        recipe: Some("net = \"recon\"\nepochs = 3\n".into()),
        trained_on: TrainedRange {
            contact_counts: vec![1, 2],
            max_force_n: Some(40.0),
            forces_unknown: false,
            max_norm_v: Some(1.5),
        },
    }
}

fn network() -> Network {
    let weight = (0..256).map(|i| (i % 7) as f32 - 3.0).collect();
    let layers = vec![Layer::Dense { inputs: 4, outputs: 64, weight, bias: vec![0.0; 64] }];
    Network { inputs: 4, output: vec![8, 8], layers, form: Form::Plain }
}

fn keys(problems: Vec<Problem>) -> Vec<String> {
    problems.into_iter().map(|problem| problem.key).collect()
}

#[test]
fn a_manifest_survives_its_file() {
    let (mut manifest, file) = model_of(&network(), facts(), &sensor()).unwrap();
    manifest.scores = toml::from_str("[real-unseen]\nlocation_mm = 12.5\n").unwrap();
    let text = manifest.to_toml();
    assert_eq!(Manifest::from_toml("manifest.toml", &text, &sensor()).unwrap(), manifest);
    manifest.check_file(&file).unwrap();
    let onnx = OnnxFile::read(&file).unwrap();
    let said: Vec<_> =
        onnx.model().metadata_props.iter().map(|p| (p.key.as_str(), p.value.as_str())).collect();
    assert!(said.contains(&("palpate.model", manifest.id.as_str())), "{said:?}");
    assert!(said.contains(&("palpate.force_map", "80x160")), "{said:?}");
}

#[test]
fn a_net_of_another_machine_keeps_its_id() {
    let (manifest, file) = model_of(&network(), facts(), &sensor()).unwrap();
    let stated: ModelFacts = toml::from_str(&facts().to_toml()).unwrap();
    assert_eq!(stated, facts());
    let of = |facts, id: &str| manifest_with_id(&file, facts, &sensor(), ModelId::unchecked(id));
    assert_eq!(of(stated, manifest.id.as_str()).unwrap(), manifest);
    let other = of(facts(), "mdl-0123456789abcdef");
    assert!(matches!(other, Err(ModelError::Changed { .. })), "{other:?}");
    let changed = of(ModelFacts { label: Label::Measured, ..facts() }, manifest.id.as_str());
    assert!(matches!(changed, Err(ModelError::Changed { .. })), "{changed:?}");
}

#[test]
fn an_id_covers_facts_and_weights_and_not_scores() {
    let (manifest, file) = model_of(&network(), facts(), &sensor()).unwrap();
    assert_eq!(manifest.id.as_str().len(), "mdl-".len() + ID_DIGITS);
    assert_eq!(model_of(&network(), facts(), &sensor()).unwrap().1, file);
    let other = ModelFacts { code: "palpate 0.1.1".into(), ..facts() };
    assert_ne!(model_of(&network(), other, &sensor()).unwrap().0.id, manifest.id);
    let mut scored = manifest.clone();
    scored.scores.insert("fvu".into(), 0.05.into());
    scored.check_file(&file).unwrap();

    let mut damaged = file.clone();
    let place = damaged.len() / 2;
    damaged[place] ^= 1;
    assert!(matches!(manifest.check_file(&damaged), Err(ModelError::Changed { .. })));
    let mut claimed = manifest;
    claimed.model.trained_on.max_force_n = Some(400.0);
    assert!(matches!(claimed.check_file(&file), Err(ModelError::Changed { .. })));
}

#[test]
fn wrong_values_and_unknown_keys_are_named() {
    let wrong = ModelFacts {
        sensor: "other".into(),
        channels: 5,
        output_shape: vec![9, 8],
        code: String::new(),
        datasets: vec![DatasetId::unchecked("mine")],
        trained_on: TrainedRange { max_force_n: Some(-1.0), ..TrainedRange::default() },
        ..facts()
    };
    assert_eq!(
        keys(wrong.check("m", &sensor()).unwrap_err()),
        [
            "model.sensor",
            "model.channels",
            "model.output_shape",
            "model.code",
            "model.datasets",
            "model.trained_on.max_force_n",
        ]
    );
    let no_map = ModelFacts { force_map: None, ..facts() };
    assert_eq!(keys(no_map.check("m", &sensor()).unwrap_err()), ["model.force_map"]);
    let points = ModelFacts { task: NetTask::Points, force_map: None, ..facts() };
    let said = points.check("m", &sensor()).unwrap_err()[0].to_string();
    assert_eq!(said, "m: model.output_shape = [8, 8]: must be [2, 3] for points on this sensor");

    let text = model_of(&network(), facts(), &sensor()).unwrap().0.to_toml();
    let more = text.replace("code = ", "colour = \"red\"\ncode = ");
    let said = Manifest::from_toml("m", &more, &sensor()).unwrap_err()[0].to_string();
    assert!(said.starts_with("m: model.colour = \"red\": unknown key"), "{said}");
    let said = Manifest::from_toml("m", "id = 3", &sensor()).unwrap_err()[0].to_string();
    assert!(said.starts_with("m: id = 3: must be text in quotes"), "{said}");
}

#[test]
fn a_file_of_another_program_needs_only_facts_and_fits_or_is_refused() {
    let says = Description {
        name: "theirs",
        doc: "",
        input: ["x", ""],
        output: ["y", ""],
        version: "",
        properties: &[],
    };
    let file = to_onnx(&network(), &says).unwrap();
    let manifest = manifest_for_foreign(&file, facts(), &sensor()).unwrap();
    manifest.check_file(&file).unwrap();
    let narrow = SensorFacts { channels: 3, ..sensor() };
    let said = manifest_for_foreign(&file, ModelFacts { channels: 3, ..facts() }, &narrow);
    let words = "input `x` has shape [None, Some(4)], recon on this sensor has [None, Some(3)]";
    assert_eq!(said.unwrap_err().to_string(), format!("ONNX file: {words}"));
    let cut = manifest_for_foreign(&file[..file.len() / 2], facts(), &sensor());
    assert!(matches!(cut, Err(ModelError::Onnx(_))));
}

#[test]
fn what_lies_outside_of_training_is_said() {
    let range = facts().trained_on;
    assert_eq!(range.frame(&[0.3, 0.4, 1.2]), None);
    let strong = range.frame(&[3.0, 4.0]).unwrap();
    assert_eq!(strong.to_string(), "a frame of norm 5.0000 V: trained up to 1.5000 V");
    assert_eq!(range.answer(&[10.0, 39.0]), None);
    assert_eq!(range.answer(&[10.0; 3]), Some(OutOfRange::Contacts { contacts: 3 }));
    assert_eq!(range.answer(&[41.0]), Some(OutOfRange::Force { force_n: 41.0, max_force_n: 40.0 }));
    assert_eq!(TrainedRange::default().answer(&[1e6; 9]), None);
}
