"""A service for the tests: the real program, on the data of a quickstart at a speed of 200.

Environment: PALPATE_BIN, the program (default: the debug build of this repository);
PALPATE_TEST_DATA, a data folder with a quickstart that is copied instead of made.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import polars as pl
import pytest

from palpate import Palpate

ROOT = Path(__file__).resolve().parents[2]
START_S, COMMAND_S = 60, 300


@dataclass(frozen=True)
class Service:
    """A running service."""

    url: str
    data: Path
    key: str | None = None


def program() -> Path:
    """The program under test."""
    if named := os.environ.get("PALPATE_BIN"):
        return Path(named).resolve()
    target = Path(os.environ.get("CARGO_TARGET_DIR") or ROOT / "target")
    return target / "debug" / "palpate"


def command(data: Path, *words: str, **environment: str) -> str:
    """Runs a command on a data folder; returns what it prints."""
    done = subprocess.run(
        [str(program()), *words, "--data", str(data)], env=_environment() | environment, cwd=ROOT,
        capture_output=True, text=True, timeout=COMMAND_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@contextlib.contextmanager
def serving(data: Path, *words: str) -> Iterator[str]:
    """A service on a free port of this machine; its address."""
    scheme = "https" if "--tls-cert" in words else "http"
    process = subprocess.Popen(
        [str(program()), "serve", "--desk", "--bind", "127.0.0.1:0", "--data", str(data), *words],
        env=_environment(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert f" at {scheme}://" in line, line
        yield line.split(" at ")[1].split(",")[0]
    finally:
        process.terminate()
        process.wait(START_S)
        if process.stdout is not None:
            process.stdout.close()


def _environment() -> dict[str, str]:
    """Without what would name another service."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PALPATE_")}


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder: a quickstart, an imported run of a smaller skin, two datasets."""
    if not program().is_file():
        pytest.exit(f"{program()}: build it with `cargo build`, or name it in PALPATE_BIN", 1)
    folder = tmp_path_factory.mktemp("palpate") / "data"
    if kept := os.environ.get("PALPATE_TEST_DATA"):
        shutil.copytree(kept, folder)
    else:
        command(folder, "run", str(ROOT / "experiments/quickstart.toml"), "--speed", "200")
    write_pad(folder.parent / "pad.parquet")
    (folder.parent / "pad.toml").write_text(
        'name = "pad"\nchannels = 208\nwidth_mm = 100\nheight_mm = 100\n'
    )
    command(
        folder, "dataset", "import", str(folder.parent / "pad.parquet"),
        "--sensor", str(folder.parent / "pad.toml"), "--label", "measured", "--name", "pad-study",
    )  # fmt: skip
    for name in ("real", "r2s-transfer", "run-1"):
        command(folder, "dataset", "make", name)
    return folder


def self_signed(certificate: Path, host: str) -> None:
    """Makes a certificate that signs itself; its key is ``key.pem`` next to it."""
    key = certificate.with_name("key.pem")
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1",
         "-nodes", "-days", "365", "-subj", f"/CN={host}", "-addext", f"subjectAltName=DNS:{host}",
         "-keyout", str(key), "-out", str(certificate)],
        check=True, capture_output=True,
    )  # fmt: skip
    key.chmod(0o600)


def write_pad(file: Path) -> None:
    """Two trials of a skin with 208 channels, the second without contact."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    contact = pa.struct([("x_mm", pa.float64()), ("y_mm", pa.float64()),
                         ("force_n", pa.float32()), ("diameter_mm", pa.float32())])  # fmt: skip
    frames = [[0.001 * n for n in range(208)], [0.002 * n for n in range(208)]]
    contacts = [[{"x_mm": 20.0, "y_mm": 35.0, "force_n": 4.9, "diameter_mm": 20.0}], []]
    pq.write_table(
        pa.table({
            "voltages_v": pa.array(frames, pa.list_(pa.float32(), 208)),
            "contacts": pa.array(contacts, pa.list_(contact)),
        }),
        file,
    )


@pytest.fixture(scope="session")
def service(data: Path) -> Iterator[Service]:
    """A service that needs no key."""
    with serving(data) as url:
        yield Service(url, data)


@pytest.fixture
def lab(service: Service) -> Palpate[pl.DataFrame]:
    """The package, asking this service."""
    return Palpate(service.url)


@pytest.fixture(scope="session")
def guarded(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service with TLS that needs a key; its certificate is ``cert.pem`` in the data folder."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl")
    folder = tmp_path_factory.mktemp("guarded") / "data"
    shutil.copytree(data, folder, ignore=shutil.ignore_patterns("server.json", "palpate.lock"))
    self_signed(folder / "cert.pem", "rig.example.org")
    printed = command(folder, "key", "create", "ada", "--role", "viewer")
    key = next(word for word in printed.split() if word.startswith("palpate_"))
    tls = ("--tls-cert", str(folder / "cert.pem"), "--tls-key", str(folder / "key.pem"))
    with serving(folder, "--require-key", *tls) as url:
        yield Service(url, folder, key)


@pytest.fixture(autouse=True)
def _no_service_of_others(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing of the caller's environment names a service; files are kept in a fresh folder."""
    for name in ("PALPATE_URL", "PALPATE_KEY", "PALPATE_KEY_FILE", "PALPATE_CA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    sys.stderr.flush()
