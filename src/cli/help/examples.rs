//! Examples of every command, by its words after `palpate`; a test parses each.
//! Uses: nothing. Never: an option that is not typed often.

/// Words of a command, and its examples.
pub const EXAMPLES: &[(&str, &[&str])] = &[
    (
        "",
        &[
            "palpate run quickstart",
            "palpate plan real-hex",
            "palpate serve --open",
            "palpate dataset export real --format csv",
        ],
    ),
    (
        "serve",
        &[
            "palpate serve --open",
            "palpate serve --rig rig.toml --data /srv/palpate",
            "palpate serve --bind 0.0.0.0:8443 --tls-cert cert.pem --tls-key key.pem",
        ],
    ),
    (
        "run",
        &[
            "palpate run quickstart",
            "palpate run real-hex-1 --rig rig.toml --data /srv/palpate",
            "palpate run quickstart --virtual --speed 50 --json",
        ],
    ),
    (
        "plan",
        &[
            "palpate plan real-hex",
            "palpate plan real-hex --rig rig.toml",
            "palpate plan quickstart --plot plan.svg",
        ],
    ),
    ("calibrate", &["palpate calibrate piezo examples/calibration/compression.csv"]),
    (
        "calibrate piezo",
        &[
            "palpate calibrate piezo examples/calibration/compression.csv",
            "palpate calibrate piezo compression.csv --out skin.toml --plot compression.svg",
        ],
    ),
    (
        "calibrate foam",
        &["palpate calibrate foam examples/calibration/indentation.csv --out skin.toml"],
    ),
    ("calibrate skin", &["palpate calibrate skin --run 3 --out skin.toml --plot fields.svg"]),
    (
        "simulate",
        &[
            "palpate simulate --contacts contacts.jsonl",
            "echo '{\"contacts\":[]}' | palpate simulate --picture untouched.svg",
        ],
    ),
    ("simulate random", &["palpate simulate random --trials 200000 --out sim-random"]),
    (
        "cluster",
        &[
            "palpate cluster sbatch random --trials 2000000 --folder sim",
            "palpate cluster gather sim --out palpate-data/sim-random/2m",
        ],
    ),
    ("cluster sbatch", &["palpate cluster sbatch random --trials 2000000 --folder sim"]),
    (
        "cluster sbatch random",
        &[
            "palpate cluster sbatch random --trials 2000000 --folder sim",
            "palpate cluster sbatch random --folder sim --tasks 16 --partition long --time 60",
        ],
    ),
    (
        "cluster sbatch table",
        &[
            "palpate cluster sbatch table maps --scale small --folder nets",
            "palpate cluster sbatch table transfer --scale medium --folder nets --time 2:00:00",
        ],
    ),
    (
        "cluster sbatch twins",
        &[
            "palpate cluster sbatch twins 3 --folder twins",
            "palpate cluster sbatch twins 3 --chunk-trials 5000 --folder twins --tasks 8",
        ],
    ),
    (
        "cluster sbatch evaluation",
        &["palpate cluster sbatch evaluation exact --dataset real-unseen --folder readings"],
    ),
    (
        "cluster make",
        &[
            "palpate cluster make sim 3 17",
            "palpate cluster make sim --task 0 --tasks 1",
            "echo '{\"folder\":\"sim\",\"index\":3}' | palpate cluster make --lines",
        ],
    ),
    ("cluster status", &["palpate cluster status sim", "palpate cluster status sim --json"]),
    (
        "cluster gather",
        &[
            "palpate cluster gather sim --out palpate-data/sim-random/2m",
            "palpate cluster gather twins --url http://127.0.0.1:8080",
        ],
    ),
    (
        "worker",
        &[
            "palpate worker --help",
            "palpate worker submit sim",
            "palpate worker work --at-once 2",
            "palpate worker status --json",
        ],
    ),
    (
        "status",
        &[
            "palpate status",
            "palpate status --watch",
            "palpate status --twins --json",
            "palpate status --workers",
            "palpate status --ready",
        ],
    ),
    ("metrics", &["palpate metrics"]),
    ("vocabulary", &["palpate vocabulary", "palpate vocabulary trips"]),
    ("queue", &["palpate queue", "palpate queue add real-hex-1 --at 22:00"]),
    ("queue list", &["palpate queue list", "palpate queue list --json"]),
    ("queue add", &["palpate queue add real-hex-1 --at 22:00"]),
    ("queue edit", &["palpate queue edit 4 real-hex-2 --at 2026-11-24T22:00"]),
    ("queue move", &["palpate queue move 4 1"]),
    ("queue remove", &["palpate queue remove 4"]),
    ("pause", &["palpate pause", "palpate pause --now --why inspection"]),
    ("resume", &["palpate resume"]),
    ("stop", &["palpate stop --why enough"]),
    ("abort", &["palpate abort", "palpate abort 3 --why wrong-skin"]),
    ("confirm", &["palpate confirm", "palpate confirm --trial 12 --anyway"]),
    ("repeat", &["palpate repeat", "palpate repeat --trial 12 --why slipped"]),
    ("placement", &["palpate placement", "palpate placement --json"]),
    ("sensor", &["palpate sensor overlay --out overlay.pdf"]),
    ("sensor overlay", &["palpate sensor overlay --paper sheet --out overlay.pdf"]),
    (
        "query",
        &[
            "palpate query",
            "palpate query 'SELECT tips, count(*) AS n FROM trials GROUP BY tips ORDER BY tips'",
            "palpate query 'SELECT * FROM contacts WHERE force_n > 10' --out contacts.csv",
        ],
    ),
    (
        "plot",
        &[
            "palpate plot counts last",
            "palpate plot force-depth 3 tips=1 --out force-depth.png",
            "palpate plot fvu contact_count__gte=1 --out fvu.svg",
            "palpate plot 'SELECT tips, avg(fvu) AS fvu FROM trials GROUP BY tips ORDER BY tips'",
        ],
    ),
    ("estop", &["palpate estop", "palpate estop --why smoke --url http://rig.example.org:8080"]),
    ("lock", &["palpate lock", "palpate lock weights-on-the-skin", "palpate lock --clear"]),
    ("key", &["palpate key", "palpate key create ada --role operator"]),
    ("key create", &["palpate key create ada --role operator"]),
    ("key list", &["palpate key list"]),
    ("key whoami", &["palpate key whoami"]),
    ("key revoke", &["palpate key revoke 2"]),
    ("rig", &["palpate rig check rig.toml", "palpate rig home"]),
    ("rig check", &["palpate rig check", "palpate rig check rig.toml --enable"]),
    ("rig connect", &["palpate rig connect"]),
    ("rig disconnect", &["palpate rig disconnect"]),
    ("rig home", &["palpate rig home"]),
    ("rig jog", &["palpate rig jog x 120.5"]),
    ("rig tare", &["palpate rig tare"]),
    ("rig tips", &["palpate rig tips 4"]),
    ("rig reset", &["palpate rig reset"]),
    ("rig limits", &["palpate rig limits", "palpate rig limits --json"]),
    ("rig rates", &["palpate rig rates", "palpate rig rates --json"]),
    ("rig samples", &["palpate rig samples", "palpate rig samples --minutes 30 --json"]),
    ("rig untouched", &["palpate rig untouched", "palpate rig untouched --json"]),
    ("rig wear", &["palpate rig wear"]),
    ("dataset", &["palpate dataset list", "palpate dataset export real --format csv"]),
    ("dataset list", &["palpate dataset list", "palpate dataset list --json"]),
    ("dataset show", &["palpate dataset show real", "palpate dataset show run-3 --lineage"]),
    ("dataset card", &["palpate dataset card real", "palpate dataset card real --datapackage"]),
    ("dataset exports", &["palpate dataset exports"]),
    (
        "dataset make",
        &["palpate dataset make real", "palpate dataset make experiments/datasets/real.toml"],
    ),
    (
        "dataset export",
        &[
            "palpate dataset export real --format csv --out real.csv",
            "palpate dataset export run-3 --where contact_count__gte=3 --map 4x20",
        ],
    ),
    ("dataset prune", &["palpate dataset prune --keep 2 --dry-run"]),
    (
        "dataset import",
        &[
            "palpate dataset import trials.parquet --sensor sensor.toml",
            "palpate dataset import trials.csv --sensor sensor.toml --dry-run",
        ],
    ),
    (
        "dataset federate",
        &[
            "palpate dataset federate a=http://rig-a:8080 b=http://rig-b:8080",
            "palpate dataset federate --rigs lab.toml --dataset real-unseen --out unseen",
        ],
    ),
    (
        "train",
        &[
            "palpate train transfer-net",
            "palpate train recon-net --epochs 3 --rows 2000 --no-wait",
            "palpate train recon-net --show",
        ],
    ),
    ("job", &["palpate job list"]),
    ("job list", &["palpate job list"]),
    ("job show", &["palpate job show last", "palpate job show 3"]),
    ("job stop", &["palpate job stop last"]),
    ("job losses", &["palpate job losses last", "palpate job losses 3 --plot losses.svg"]),
    ("model", &["palpate model list", "palpate model promote transfer-net"]),
    ("model list", &["palpate model list"]),
    ("model show", &["palpate model show transfer-net"]),
    ("model promote", &["palpate model promote transfer-net --why smaller-error"]),
    ("model roll-back", &["palpate model roll-back map"]),
    ("model serving", &["palpate model serving"]),
    ("model onnx", &["palpate model onnx transfer-net --out transfer.onnx"]),
    ("model add", &["palpate model add net.onnx --facts facts.toml --name mine"]),
    ("model add-calibration", &["palpate model add-calibration skin.toml"]),
    (
        "infer",
        &[
            "palpate infer --method fast frames.jsonl",
            "palpate infer --model cal-0192 frames.jsonl",
        ],
    ),
    (
        "live",
        &[
            "palpate live --method fast",
            "palpate live --frames 100 --json",
            "palpate live --quantities",
            "palpate live --record frames.parquet --frames 300",
        ],
    ),
    ("evaluate", &["palpate evaluate simulation --run 3"]),
    ("evaluate simulation", &["palpate evaluate simulation --run 3 --out figures --also png"]),
    ("evaluate method", &["palpate evaluate method fast --dataset real --part test"]),
    ("evaluate quantity", &["palpate evaluate quantity position --dataset pad"]),
    ("evaluate transfer", &["palpate evaluate transfer --scale small --out table-iii"]),
    ("evaluate maps", &["palpate evaluate maps --scale small --out maps"]),
    ("evaluate noise", &["palpate evaluate noise --scale small --out noise"]),
    ("evaluate factorial", &["palpate evaluate factorial --scale small --out factorial"]),
    ("evaluate unseen", &["palpate evaluate unseen --scale small --out unseen"]),
    ("evaluate published", &["palpate evaluate published", "palpate evaluate published --json"]),
    (
        "virtual-rig",
        &[
            "palpate virtual-rig --ephemeral --out-rig served.toml",
            "palpate virtual-rig --fault virtual-rig/examples/faults.toml --speed 20",
        ],
    ),
    (
        "virtual-operator",
        &["palpate virtual-operator --control 127.0.0.1:5040 --url http://127.0.0.1:8080"],
    ),
    (
        "runs",
        &[
            "palpate runs",
            "palpate runs --state interrupted,fail --limit 5",
            "palpate runs --experiment real-hex --json",
        ],
    ),
    (
        "trials",
        &[
            "palpate trials last",
            "palpate trials 3 contact_count__gte=2 fvu__gt=0.5 --limit 50",
            "palpate trials 3 flagged=true --json",
        ],
    ),
    (
        "events",
        &[
            "palpate events last",
            "palpate events -f --kind trip,suspended,skipped",
            "palpate events 3 --since 8h",
        ],
    ),
    ("actions", &["palpate actions", "palpate actions last --limit 50"]),
    (
        "show",
        &[
            "palpate show last",
            "palpate show 3 --history",
            "palpate show t812",
            "palpate show 3/81/4",
            "palpate show 3 --raw attempts",
            "palpate show t812 --raw frames",
        ],
    ),
    ("report", &["palpate report last", "palpate report 3 --out reports"]),
    ("diff", &["palpate diff 2 3", "palpate diff 2 last --json"]),
    ("attach", &["palpate attach", "palpate attach 3"]),
    ("init", &["palpate init", "palpate init my-lab", "palpate init --list"]),
    ("completions", &["palpate completions bash"]),
    ("man", &["palpate man man1"]),
];
