"""Time from a changed line to a running program, for each crate that `palpate` consists of.

    python3 tests/figures/rebuild.py [CRATE ..]

Run it in a checkout without changes, after `cargo build --bin palpate`. For each crate a line is added to the first
function of its longest file, `cargo build --bin palpate` and `palpate --version` are timed, and the file is restored
and built again. Prints seconds; takes about 20 s a crate.
"""

import json
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CRATES = {
    "cli": "src/cli",
    "service": "src/service",
    "touch": "src/touch",
    "studies": "studies",
    "data": "src/data",
    "model": "src/model",
    "bench": "src/bench",
    "store": "src/store",
    "words": "src/words",
    "nets": "nets/src",
    "sim-core": "sim-core/src",
    "virtual-rig": "virtual-rig/src",
}
# A function with its whole head on one line; of a trait or a constant one the line could not stand there.
FUNCTION = re.compile(r"(?m)^ *(?:pub(?:\([a-z]+\))? )?(?:async )?fn [^\n]*\{\n")
LINE = "std::hint::black_box(0);\n"


def run(*words):
    return subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def program():
    target = json.loads(run("cargo", "metadata", "--format-version=1", "--no-deps"))["target_directory"]
    return Path(target) / "debug" / "palpate"


def build():
    subprocess.run(["cargo", "build", "--quiet", "--bin", "palpate"], cwd=ROOT, check=True)


def with_a_line(text):
    """The text with a line more in its first function; None if there is none before the tests."""
    found = FUNCTION.search(text.split("#[cfg(test)]\nmod tests")[0])
    return found and text[: found.end()] + LINE + text[found.end() :]


def longest(folder):
    files = [file for file in (ROOT / folder).rglob("*.rs") if "tests" not in (file.stem, file.parent.name)]
    files.sort(key=lambda file: (-len(file.read_text().splitlines()), file))
    return next(file for file in files if with_a_line(file.read_text()))


def main():
    if run("git", "status", "--porcelain", "--untracked-files=no"):
        sys.exit("the checkout has changes: commit or stash them")
    palpate = str(program())
    build()
    for crate in sys.argv[1:] or CRATES:
        file = longest(CRATES[crate])
        text = file.read_text()
        try:
            file.write_text(with_a_line(text))
            start = time.monotonic()
            build()
            run(palpate, "--version")
            took = time.monotonic() - start
        finally:
            file.write_text(text)
        build()
        print(f"{crate:<12} {took:5.1f} s  {file.relative_to(ROOT)}", flush=True)


main()
