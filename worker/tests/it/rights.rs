//! What a worker may do, which secrets are shown, and encryption.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::time::Duration;

use serde_json::json;

use crate::bench::{Bench, DESK_PASSWORD, text};
use crate::server::{NEW_KEY, PASSWORD, openssl};

const SOON: Duration = Duration::from_secs(30);

#[test]
fn a_worker_takes_and_returns_chunks_and_nothing_else() {
    let Some(bench) = Bench::start() else { return };
    bench.asked("CREATE TABLE other (x int)");
    let made = bench.order(5, json!({ "seed": 1, "fails": [2] }));
    bench.ok(&["submit", made.path(), "--attempts", "2"]);
    let address = bench.desk(bench.server.port);
    let mut worker = bench.worker(&address, &[]);
    bench.try_run(&["status", &made.order.id, "--wait"]);
    worker.terminate();
    assert!(worker.ended(SOON), "{}", worker.log());
    assert_eq!(
        (&bench.status(&made)["done"], &bench.status(&made)["failed"]),
        (&json!(4), &json!(1))
    );

    let submit = bench.command_at(&address, &["submit", made.path()]).output().unwrap();
    assert_eq!(submit.status.code(), Some(1));
    assert!(text(&submit.stderr).contains("permission denied"), "{}", text(&submit.stderr));
    let setup = bench.command_at(&address, &["setup"]).output().unwrap();
    assert_eq!(setup.status.code(), Some(1));
    for refused in [
        "INSERT INTO palpate_queue._private_jobs (task_id) VALUES (1)",
        "SELECT palpate_queue.add_job('order', '{}')",
        "UPDATE palpate_queue._private_jobs SET priority = -1000",
        "UPDATE palpate_queue._private_jobs SET max_attempts = 1000",
        "UPDATE palpate_queue._private_jobs SET key = NULL",
        "UPDATE palpate_queue._private_tasks SET identifier = 'x'",
        "TRUNCATE palpate_queue._private_jobs",
        "DROP TABLE palpate_queue._private_jobs",
        "CREATE TABLE palpate_queue.x (x int)",
        "CREATE TABLE x (x int)",
        "CREATE SCHEMA x",
        "SELECT * FROM other",
        "SELECT * FROM pg_authid",
        "CREATE ROLE x",
        "COPY (SELECT 1) TO PROGRAM 'true'",
    ] {
        let output = bench.server.psql("desk_1", "queue", DESK_PASSWORD, refused);
        assert!(!output.status.success(), "{refused}");
        let error = text(&output.stderr);
        assert!(
            ["denied", "must be", "permission"].iter().any(|word| error.contains(word)),
            "{refused}: {error}"
        );
    }
    // The rights of a role are the same after a second setup.
    bench.ok(&["setup"]);
    bench.ok(&["submit", made.path(), "--attempts", "1"]);
    assert!(bench.worker(&address, &["--until-idle"]).ended(SOON));
}

#[test]
fn no_password_is_shown() {
    let Some(bench) = Bench::start() else { return };
    let port = bench.server.port;
    let wrong = bench.server.address("owner", DESK_PASSWORD, port);
    let nowhere = wrong.replace(&port.to_string(), "1");
    for address in [
        wrong.as_str(),
        &nowhere,
        &wrong.replace("queue", "none"),
        &wrong.replace("postgres:", "mysql:"),
    ] {
        for command in [&["status"][..], &["setup"], &["--json", "status"]] {
            let output =
                bench.command_at(address, command).env("PALPATE_LOG", "trace").output().unwrap();
            assert!(!output.status.success());
            let shown = text(&output.stdout) + &text(&output.stderr);
            assert!(shown.contains("error: ") && !shown.contains(DESK_PASSWORD), "{shown}");
        }
    }
    // Nor is it among the arguments, or in the environment of the program that makes chunks: `stand-in` checks that.
    let file = bench.folder.path().join("queue-address");
    fs::write(&file, format!("{}\n", bench.address)).unwrap();
    let of_file = |mode: u32| {
        fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
        let mut command = bench.command(&["status"]);
        command.env_remove("PALPATE_QUEUE").env("PALPATE_QUEUE_FILE", &file).output().unwrap()
    };
    assert!(of_file(0o600).status.success());
    let refused = of_file(0o640);
    let error = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        error.contains("mode 640") && error.contains("chmod 600") && !error.contains(PASSWORD),
        "{error}"
    );
    let both = bench.command(&["status"]).env("PALPATE_QUEUE_FILE", &file).output().unwrap();
    assert!(text(&both.stderr).contains("set one of them"));
}

#[test]
fn a_queue_that_is_not_set_up_is_named_and_not_waited_for() {
    let Some(bench) = Bench::start() else { return };
    bench.server.sql("CREATE DATABASE empty");
    let address = bench.address.replace("/queue", "/empty");
    let mut worker = bench.worker(&address, &[]);
    assert!(!worker.ended(SOON));
    assert!(
        bench
            .command_at(&address, &["work"])
            .output()
            .is_ok_and(|output| { text(&output.stderr).contains("palpate-worker setup") })
    );
}

#[test]
fn the_connection_is_encrypted_and_a_false_server_refused() {
    let Some(mut bench) = Bench::start() else { return };
    let folder = bench.server.folder().to_owned();
    for name in ["server", "false"] {
        let arguments = format!(
            "req -x509 -days 2 -subj /CN=lab -addext subjectAltName=DNS:localhost \
             -addext basicConstraints=CA:FALSE -keyout {name}.key -out {name}.crt {NEW_KEY}"
        );
        openssl(&folder, &arguments);
    }
    for (setting, name) in [("ssl_key_file", "server.key"), ("ssl_cert_file", "server.crt")] {
        let file = folder.join(name);
        bench.server.own(&file);
        bench.server.sql(&format!("ALTER SYSTEM SET {setting} = '{}'", file.display()));
    }
    bench.server.sql("ALTER SYSTEM SET ssl = on");
    bench.server.kill();
    bench.server.begin();
    let host = bench.address.replace("127.0.0.1", "localhost");
    let with = |authority: &str| {
        let authority = folder.join(authority);
        let address = format!("{host}?sslmode=verify-full&sslrootcert={}", authority.display());
        bench.command_at(&address, &["status"]).output().unwrap()
    };
    let good = with("server.crt");
    assert!(good.status.success(), "{}", text(&good.stderr));
    let bad = with("false.crt");
    let error = text(&bad.stderr);
    assert!(
        !bad.status.success() && error.contains("certificate") && !error.contains(PASSWORD),
        "{error}"
    );
    // The name of the certificate counts, too.
    let address = format!(
        "{}?sslmode=verify-full&sslrootcert={}",
        bench.address,
        folder.join("server.crt").display()
    );
    assert!(!bench.command_at(&address, &["status"]).output().unwrap().status.success());
}
