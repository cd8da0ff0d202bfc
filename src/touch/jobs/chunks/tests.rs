//! Tests of work orders of trainings: what they state, and what is refused before a trainer starts.
//! Uses: temporary folders. Never: a trainer.

use serde_json::json;

use super::*;

const RECIPE: &str = "name = \"small\"\ndataset = \"r2s-transfer\"\n[training]\nseed = 1\nepochs = 2\nbatch = 32\n\
                      [training.net]\nkind = \"transfer-net\"\nform = \"residual\"\nhidden = 1\nwidth = 8\n";
const BYTES: &str = "not Parquet";

fn dataset() -> DatasetFile {
    DatasetFile {
        id: DatasetId::unchecked("ds-0123456789abcdef"),
        rows: 3,
        bytes: BYTES.len() as u64,
        sha256: crate::digest::sha256_hex(BYTES),
    }
}

fn evaluation(dataset: &str) -> EvaluationRequest {
    let request = json!({ "scored": "voltages", "dataset": dataset, "part": "test" });
    serde_json::from_value(request).unwrap()
}

fn net(recipe: &str) -> NetOrder {
    let lineage = json!({ "runs": [{ "label": "virtual" }],
        "models": [{ "calibration": "cal-1", "model": "sim-0" }] });
    NetOrder::new(recipe, dataset(), &lineage, vec![evaluation("r2s-transfer")]).unwrap()
}

fn order(nets: Vec<NetOrder>) -> WorkOrder {
    let order = work_order(nets, ONE_THREAD);
    WorkOrder::from_json(&order.to_json().unwrap()).unwrap()
}

fn read(nets: Vec<NetOrder>) -> Result<TrainingsOrder, Problem> {
    TrainingsOrder::read(&order(nets))
}

#[test]
fn an_order_states_what_determines_a_net() {
    let other = net(&RECIPE.replace("small", "other"));
    let order = order(vec![net(RECIPE), other]);
    assert_eq!((order.kind.as_str(), order.chunks), (TRAININGS, 2));
    assert_eq!(order.files, BTreeSet::from([dataset().sha256]), "both have the same dataset");
    let definition = &order.definition;
    assert_eq!(definition["compute"], json!({ "cpu": { "threads": 1 } }));
    assert_eq!(definition["nets"][0]["label"], "virtual");
    assert_eq!(definition["nets"][1]["dataset"]["sha256"], dataset().sha256);
    let read = TrainingsOrder::read(&order).unwrap();
    let names: Vec<&str> = read.recipes.iter().map(|recipe| recipe.name.as_str()).collect();
    assert_eq!(names, ["small", "other"]);
    let seed = net(&RECIPE.replace("seed = 1", "seed = 2"));
    assert_ne!(work_order(vec![seed], Compute::Wgpu).id, order.id);
}

#[test]
fn a_net_that_chunks_cannot_make_is_refused_by_key() {
    let key = |nets: Vec<NetOrder>| read(nets).unwrap_err().key;
    assert_eq!(key(vec![net(RECIPE), net(RECIPE)]), "definition.nets.1.recipe.name");
    let hidden = net(&RECIPE.replace("small", ".."));
    assert_eq!(key(vec![hidden]), "definition.nets.0.recipe.name");
    let mut broken = net(RECIPE);
    broken.recipe = "name = 1".into();
    assert_eq!(key(vec![broken]), "definition.nets.0.recipe");
    let noisy = RECIPE.replacen("dataset", "noise_of = \"mdl-1\"\ndataset", 1);
    assert_eq!(key(vec![net(&noisy)]), "definition.nets.0.recipe.noise_of");
    let mut apart = net(RECIPE);
    apart.evaluations.push(evaluation("real-unseen"));
    assert_eq!(key(vec![apart]), "definition.nets.0.evaluations.dataset");
    let mut first = net(RECIPE);
    first.evaluations[0].frames = FramesRead::First;
    assert_eq!(key(vec![first]), "definition.nets.0.evaluations.frames");
    let threads = work_order(vec![net(RECIPE)], Compute::Cpu { threads: 2 });
    let refused = TrainingsOrder::read(&threads).unwrap_err();
    let stated = r#"{"cpu":{"threads":2}}"#;
    assert_eq!((&*refused.key, &*refused.value), ("definition.compute", stated));
    let more = WorkOrder { chunks: 2, ..order(vec![net(RECIPE)]) };
    assert_eq!(TrainingsOrder::read(&more).unwrap_err().key, "chunks");
}

#[test]
fn another_program_another_processor_and_another_dataset_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    let new = |order| TrainingChunks::new(order, data, data.join("cache"));
    let order = read(vec![net(RECIPE)]).unwrap();
    let missing = new(order.clone()).err().unwrap();
    assert_eq!(missing.key, "definition.nets.0.dataset.id");
    let name = dataset().sha256;
    new_file::write(&data.join("inputs"), &name, BYTES).unwrap();
    assert!(new(order.clone()).is_ok());
    new_file::write(&data.join("inputs"), &name, "NOT Parquet").unwrap();
    let other = new(order.clone()).err().unwrap();
    assert!(other.limit.contains("has other bytes") && other.limit.contains(&name), "{other}");
    let mut old = order.clone();
    old.definition.code = "palpate 0.0.0 a".into();
    assert_eq!(new(old).err().unwrap().key, "definition.code");
    let mut elsewhere = order;
    elsewhere.definition.kernel = "none".into();
    assert_eq!(new(elsewhere).err().unwrap().key, "definition.kernel");
}

#[test]
fn one_process_trains_a_net() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.lock");
    let first = lock(&path).unwrap();
    assert!(first.is_some());
    let second = lock(&path).unwrap_err().to_string();
    assert_eq!(second, "another process trains this net");
    drop(first);
    assert!(lock(&path).unwrap().is_some());
}
