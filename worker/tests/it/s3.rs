//! The same work with results in a bucket of an S3 service: moto, a server for tests, from the packages of
//! PALPATE_PYTHON. It checks signatures and policies when it is told to.

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};

use crate::bench::{Bench, text, until};
use crate::server::{NEW_KEY, left_out, openssl, run};

const SOON: Duration = Duration::from_secs(60);
const SECRET_KEY: &str = "store-hush-3";
/// The page whose policy is used.
const PAGE: &str = "../docs/how-to/cluster-postgresql.md";
/// Makes the bucket of the page, and a user with a key for each policy; prints the keys. From then on each request must
/// be signed, and permitted. Arguments: address, certificate of the authority, policies by user.
const USERS: &str = r#"
import json, ssl, sys, urllib.request, boto3
address, authority, policies = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
def client(service):
    return boto3.client(service, endpoint_url=address, verify=authority, region_name="us-east-1",
                        aws_access_key_id="root", aws_secret_access_key="root")
client("s3").create_bucket(Bucket="lab-results")
iam, keys = client("iam"), {}
for user, policy in policies.items():
    iam.create_user(UserName=user)
    iam.put_user_policy(UserName=user, PolicyName="palpate", PolicyDocument=json.dumps(policy))
    key = iam.create_access_key(UserName=user)["AccessKey"]
    keys[user] = [key["AccessKeyId"], key["SecretAccessKey"]]
request = urllib.request.Request(address + "/moto-api/reset-auth", b"0", {"content-type": "text/plain"})
urllib.request.urlopen(request, context=ssl.create_default_context(cafile=authority))
print(json.dumps(keys))
"#;

/// A running S3 service; killed when dropped.
struct Service {
    process: Child,
    port: u16,
}

impl Drop for Service {
    fn drop(&mut self) {
        drop(self.process.kill());
        drop(self.process.wait());
    }
}

/// A Python that has the packages; `None` without one.
fn python() -> Option<String> {
    let python = std::env::var("PALPATE_PYTHON").unwrap_or_else(|_| "python3".into());
    let has_moto = Command::new(&python).args(["-c", "import moto.server"]).output();
    if !has_moto.is_ok_and(|output| output.status.success()) {
        return left_out(&format!("{python}: no moto[s3], flask and flask-cors"));
    }
    Some(python)
}

/// Starts the service with some of its options.
fn service(python: &str, options: &[&str]) -> Service {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let start = "import sys, moto.server; moto.server.main(sys.argv[1:])";
    let mut command = Command::new(python);
    command.args(["-c", start, "-H", "127.0.0.1", "-p", &port.to_string()]).args(options);
    let process = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let service = Service { process, port };
    until("the service answers", SOON, || {
        std::net::TcpStream::connect(("127.0.0.1", port)).is_ok()
    });
    service
}

/// A certificate for localhost with its key, and that of the authority which has signed it.
fn certificates(folder: &Path) -> [PathBuf; 3] {
    for arguments in [
        format!("req -x509 -days 2 -subj /CN=lab -keyout lab.key -out lab.crt {NEW_KEY}"),
        format!(
            "req -subj /CN=store -keyout store.key -out store.csr \
             -addext subjectAltName=DNS:localhost {NEW_KEY}"
        ),
        "x509 -req -in store.csr -CA lab.crt -CAkey lab.key -CAcreateserial -days 2 \
         -copy_extensions copy -out store.crt"
            .into(),
    ] {
        openssl(folder, &arguments);
    }
    ["store.crt", "store.key", "lab.crt"].map(|name| folder.join(name))
}

#[test]
fn results_in_a_bucket_equal_those_of_one_process() {
    let Some(python) = python() else { return };
    let Some(bench) = Bench::start() else { return };
    let service = service(&python, &[]);
    let bucket = format!("http://127.0.0.1:{}/lab", service.port);
    run(Command::new("curl").args(["-sf", "-X", "PUT", &bucket]));
    let made = bench.order(6, json!({ "seed": 3, "fails": [4] }));
    let at = |arguments: &[&str]| {
        let mut command = bench.command(arguments);
        command.env("PALPATE_STORE", "s3://lab/some/prefix");
        command.env("AWS_ENDPOINT", format!("http://127.0.0.1:{}", service.port));
        command.env("AWS_ACCESS_KEY_ID", "id").env("AWS_SECRET_ACCESS_KEY", SECRET_KEY);
        command
    };
    let ok = |arguments: &[&str]| text(&run(&mut at(arguments)).stdout);
    assert!(ok(&["submit", made.path(), "--attempts", "1"]).contains("6 submitted"));
    let worked = at(&["work", "--until-idle"]).env("PALPATE_LOG", "trace").output().unwrap();
    assert!(worked.status.success());
    let log = text(&worked.stderr);
    assert!(log.contains("made=5 existed=0 failed=1") && !log.contains(SECRET_KEY), "{log}");
    let status: serde_json::Value =
        serde_json::from_str(&ok(&["status", made.path(), "--json"])).unwrap();
    let order = &status["orders"][0];
    assert_eq!((&order["done"], &order["failed"]), (&json!(5), &json!(1)));
    assert!(order["errors"][0]["error"].as_str().unwrap().contains("index 4 fails"), "{order}");
    let fetched = bench.folder.path().join("fetched");
    assert!(ok(&["fetch", &made.order.id[..8], fetched.to_str().unwrap()]).contains("5 of 6"));
    let results = made.results(&fetched.join("results"));
    assert!(results[4].is_none());
    assert!(results == made.undisturbed());
    assert!(
        ok(&["submit", made.path()]).contains("1 submitted (1 had failed), 0 in the queue, 5 done")
    );
    // A service on another machine must be encrypted, by whichever name its client takes it.
    for name in ["AWS_ENDPOINT", "AWS_ENDPOINT_URL_S3"] {
        let mut status = at(&["status"]);
        status.env("AWS_ALLOW_HTTP", "true").env(name, "http://store.lab:9000");
        let refused = status.output().unwrap();
        let error = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{error}");
        let is_named = error.contains(&format!("{name}: must be https"));
        assert!(is_named && !error.contains(SECRET_KEY), "{error}");
    }
}

#[test]
fn over_https_the_policy_of_the_page_is_enough_and_permits_no_more() {
    let Some(python) = python() else { return };
    let Some(bench) = Bench::start() else { return };
    let [certificate, key, authority] = certificates(bench.folder.path());
    let path = |path: &Path| path.to_str().unwrap().to_owned();
    let service = service(&python, &["-c", &path(&certificate), "-k", &path(&key)]);
    let endpoint = |host: &str| format!("https://{host}:{}", service.port);
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(PAGE)).unwrap();
    let policy = page.split_once("```json\n").unwrap().1.split_once("```").unwrap().0;
    let desk: Value = serde_json::from_str(policy).unwrap();
    // Who submits and fetches, as the page says.
    let mut owner = desk.clone();
    owner["Statement"].as_array_mut().unwrap().extend(
        [
            ("s3:PutObject", "*/order.json"),
            ("s3:PutObject", "inputs/*"),
            ("s3:GetObject", "*/failed/*"),
        ]
        .map(|(action, file)| {
            let resource = format!("arn:aws:s3:::lab-results/palpate/{file}");
            json!({ "Effect": "Allow", "Action": action, "Resource": resource })
        }),
    );
    let policies = json!({ "desk": desk, "owner": owner }).to_string();
    let mut users = Command::new(&python);
    users.args(["-c", USERS, &endpoint("localhost"), &path(&authority), &policies]);
    let keys = run(users.env("NO_PROXY", "*")).stdout;
    let keys: BTreeMap<String, [String; 2]> = serde_json::from_slice(&keys).unwrap();
    let at = |user: &str, arguments: &[&str]| {
        let [id, secret] = &keys[user];
        let mut command = bench.command(arguments);
        command
            .env("PALPATE_STORE", "s3://lab-results/palpate")
            .env("PALPATE_STORE_CA", &authority);
        command.env("AWS_ENDPOINT", endpoint("localhost")).env("AWS_REGION", "us-east-1");
        command.env("AWS_ACCESS_KEY_ID", id).env("AWS_SECRET_ACCESS_KEY", secret);
        command.env("NO_PROXY", "*");
        command
    };
    let ok = |user: &str, arguments: &[&str]| text(&run(&mut at(user, arguments)).stdout);
    let large = vec![7_u8; 6 << 20];
    let made = bench.order_on(4, json!({ "seed": 5, "fails": [2] }), &[&large[..]]);
    assert!(ok("owner", &["submit", made.path(), "--attempts", "1"]).contains("4 submitted"));
    let worked = at("desk", &["work", "--until-idle"]).output().unwrap();
    let log = text(&worked.stderr);
    assert!(worked.status.success() && log.contains("made=3 existed=0 failed=1"), "{log}");
    let status: Value = serde_json::from_str(&ok("owner", &["status", "--json"])).unwrap();
    let order = &status["orders"][0];
    assert_eq!((&order["done"], &order["failed"]), (&json!(3), &json!(1)));
    assert!(order["errors"][0]["error"].as_str().unwrap().contains("index 2 fails"), "{order}");
    let fetched = bench.folder.path().join("fetched");
    ok("owner", &["fetch", &made.order.id, &path(&fetched)]);
    assert!(made.results(&fetched.join("results")) == made.undisturbed());
    // A machine cannot submit, and a wrong key can do nothing.
    let other = bench.order(1, json!({ "seed": 6 }));
    let mut wrong = at("owner", &["status"]);
    wrong.env("AWS_SECRET_ACCESS_KEY", SECRET_KEY);
    for mut refused in [at("desk", &["submit", other.path()]), wrong] {
        let output = refused.output().unwrap();
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{error}");
        assert!(error.contains("error: store: ") && !error.contains(SECRET_KEY), "{error}");
    }
    let mut damaged = at("owner", &["status"]);
    let output = damaged.env("PALPATE_STORE_CA", made.folder.join("order.json")).output().unwrap();
    let error = text(&output.stderr);
    assert!(output.status.code() == Some(2) && error.contains("PALPATE_STORE_CA: "), "{error}");
    // Without the authority, or at a name that is not the certificate's, the store is asked again and again in vain.
    let unnamed = endpoint("127.0.0.1");
    for (name, value) in [("PALPATE_STORE_CA", ""), ("AWS_ENDPOINT", unnamed.as_str())] {
        let mut status = at("owner", &["status"]);
        let status = status.env(name, value).stdout(Stdio::null()).stderr(Stdio::null());
        let mut process = status.spawn().unwrap();
        std::thread::sleep(Duration::from_secs(3));
        let ended = process.try_wait().unwrap();
        drop(process.kill());
        process.wait().unwrap();
        assert!(ended.is_none_or(|status| !status.success()), "{name}={value}");
    }
}
