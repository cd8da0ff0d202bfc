//! `openapi.yaml` as generators of clients see it: valid, and good for clients in Python and
//! TypeScript that make real calls.

use std::path::Path;
use std::process::Command;

use super::datasets::filled::Filled;
use super::support::{self, Folder};

const DESCRIPTION: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.yaml");

/// Runs a command to its end; its output is shown if it fails.
async fn succeeds(mut command: Command) -> String {
    let output = tokio::task::spawn_blocking(move || command.output()).await.unwrap().unwrap();
    let text =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(output.status.success(), "{}", text.join("\n"));
    text.join("\n")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_generated_python_client_makes_real_calls() {
    let Some(python) = support::python("openapi_spec_validator, openapi_python_client") else {
        return;
    };
    let lab = Filled::open("contract-python").await;
    let folder = Folder::new("contract-python-client");
    let mut command = Command::new(python);
    command.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/contract/client.py")).args([
        DESCRIPTION,
        &lab.url(""),
        &lab.key("contract", "admin").await.1,
        &folder.path(""),
    ]);
    let said = succeeds(command).await;
    assert!(said.contains("operations imported, 16 called"), "{said}");
    lab.close().await;
}

/// The packages are those of `.ci/run`: `PALPATE_NODE` is the folder with their `node_modules`.
#[tokio::test(flavor = "multi_thread")]
async fn a_typed_typescript_client_makes_real_calls() {
    let Some(packages) = std::env::var_os("PALPATE_NODE") else {
        eprintln!("SKIPPED: PALPATE_NODE names no folder with openapi-typescript");
        return;
    };
    let lab = Filled::open("contract-typescript").await;
    let folder = Folder::new("contract-typescript-client");
    let modules = Path::new(&packages).join("node_modules");
    std::os::unix::fs::symlink(&modules, folder.path("node_modules")).unwrap();
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/contract/client.ts");
    std::fs::copy(source, folder.path("client.ts")).unwrap();
    std::fs::write(folder.path("package.json"), r#"{ "type": "module" }"#).unwrap();
    let tool = |name: &str| {
        let mut command = Command::new(modules.join(".bin").join(name));
        command.current_dir(folder.path(""));
        command
    };
    let mut generate = tool("openapi-typescript");
    generate.args([DESCRIPTION, "--output", "api.d.ts"]);
    succeeds(generate).await;
    let mut compile = tool("tsc");
    compile.args("--strict --target es2022 --module nodenext --skipLibCheck client.ts".split(' '));
    succeeds(compile).await;
    let mut run = Command::new("node");
    run.current_dir(folder.path("")).args([
        "client.js",
        &lab.url(""),
        &lab.key("contract", "admin").await.1,
    ]);
    assert!(succeeds(run).await.contains("6 calls"));
    lab.close().await;
}

/// Nothing that an example names has to exist (404), and the rig and the queue may refuse it (409).
#[tokio::test(flavor = "multi_thread")]
async fn every_example_of_a_body_is_one_that_the_service_understands() {
    let lab = Filled::open("contract-examples").await;
    let described = lab.get("/openapi.json").await;
    let mut sent = 0;
    for (path, item) in described["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let body = &operation["requestBody"]["content"]["application/json"];
            let name = operation["operationId"].as_str().unwrap_or_default();
            // A frame is long.
            if body.is_null() || ["infer", "model_quantities"].contains(&name) {
                continue;
            }
            let address = path.replace("{run}", "1");
            let method = method.to_uppercase().parse().unwrap();
            let request = lab.http.request(method, lab.url(&address)).json(&body["example"]);
            let answer = request.send().await.unwrap();
            let (status, text) = (answer.status().as_u16(), answer.text().await.unwrap());
            let understood = [200, 201, 202, 404, 409].contains(&status);
            assert!(understood, "{name}: {status} {text}");
            sent += 1;
        }
    }
    assert!(sent >= 15, "{sent}");
    lab.close().await;
}

/// schemathesis sends what the description allows and forbids, with keys of every role and without one:
/// no 5xx, and no answer that the description does not state. `PALPATE_CONTRACT_EXAMPLES` sets the number of
/// examples for each operation; 300 take a quarter of an hour.
///
/// All checks are on, with the statuses of `schemathesis.toml`. The phase `fuzzing` sends at least one request, and at
/// most that number, to every operation as each role and without a key. The phase `coverage` sends every case that the
/// schemas define, which does not depend on the role: only an admin, who may request all, sends them. Left out: the
/// WebSockets, and the revocation of keys, which would end the test's own.
#[tokio::test(flavor = "multi_thread")]
async fn every_answer_is_one_that_the_description_states() {
    let Some(python) = support::python("schemathesis") else { return };
    let lab = Filled::open("contract-fuzz").await;
    let examples = std::env::var("PALPATE_CONTRACT_EXAMPLES").unwrap_or_else(|_| "5".into());
    for role in ["viewer", "operator", "admin", "keyless"] {
        let header = match role {
            "keyless" => "X-No-Key: 1".to_owned(),
            _ => format!("Authorization: Bearer {}", lab.key(role, role).await.1),
        };
        let phases = match role {
            "admin" => "examples,coverage,fuzzing,stateful",
            _ => "examples,fuzzing,stateful",
        };
        let folder = Folder::new(&format!("contract-fuzz-{role}"));
        let mut command = Command::new(Path::new(&python).with_file_name("schemathesis"));
        command
            .current_dir(folder.path(""))
            .args([
                "--config-file",
                concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/contract/schemathesis.toml"),
            ])
            .args(["run", DESCRIPTION, "--url", &lab.url(""), "-H", &header])
            .args(["--phases", phases, "--max-examples", &examples, "--seed", "1", "--no-color"])
            // Other tests share the processor.
            .args(["--checks", "all", "--max-response-time", "180"])
            .args(["--exclude-path", "/api/v1/live", "--exclude-path", "/api/v1/frames/live"])
            .args(["--exclude-path", "/api/v1/live/quantities"])
            .args(["--exclude-operation-id", "revoke_key", "--request-timeout", "180"]);
        let said = succeeds(command).await;
        let cases = said.lines().find(|line| line.contains(" generated, ")).unwrap_or_default();
        eprintln!("{role}: {}", cases.trim());
    }
    lab.close().await;
}
