"""Does the safety harness see a fault in the safe end? Each twin is this checkout with one thing broken on
purpose; the named tests must fail on it (standard library only; a build and a minute or two each).

    python3 tests/broken_twins.py [NAME ..]
    python3 tests/broken_twins.py --check   only checks that every twin can still be made; in .ci/run

A twin is made in place and taken back afterwards, also when interrupted: cargo takes sources of one
package in two places for each other. The broken files must be committed.
"""

import pathlib
import signal
import subprocess
import sys

ROOT = pathlib.Path(__file__).parents[1]
SAFE_END, STAGE = "src/bench/campaign/safe_end.rs", "src/bench/campaign/bench/stage.rs"
INTERLOCK, RECOVERY = "src/bench/campaign/bench/interlock.rs", "src/bench/campaign/run/engine/recovery.rs"

# Name: file, what stands there, what the twin has instead, tests that must fail.
TWINS = {
    "a write before the stop": (
        SAFE_END, "    control.phase(Phase::Raise);\n    let began",
        "    let _ = control.flush().await;\n    control.phase(Phase::Raise);\n    let began",
        ["while_the_store_hangs"]),
    "no raise": (
        SAFE_END, "(stopped, raise(estop, stage, height, &Cell::default()).await)",
        "(stopped, (Tips::Raised, None))",
        ["over_force_raises", "a_module_that_repeats", "a_panic_in_contact", "a_service_told_to_end"]),
    "no stop of x, y and the radius": (
        SAFE_END, "join_all(lateral.map(|axis| stop(axis.as_ref(), began)))",
        "join_all(lateral.map(|axis| async { axis.name(); stop(bench.z.as_ref(), began).await }))",
        ["a_service_told_to_end"]),
    "the skin is not asked": (
        STAGE, "Some(words) => Err(Halt::trip(TripKind::Cell, words)),\n            None => Ok(()),",
        "_ => Ok(()),", ["a_cell_that_lost_its_tip"]),
    "still cells pass": (
        INTERLOCK, "    check_alive(cells, reading, tips)\n", "    let _ = check_alive;\n    Ok(())\n",
        ["a_module_that_repeats", "cells_that_stop_in_the_air"]),
    "an automatic resume in spite of the stop": (
        RECOVERY, "if self.control.estop.pressed().is_some() {\n            let words",
        "if self.control.estop.pressed().is_some() && self.control.leaving() {\n            let words",
        ["an_e_stop_outlasts"]),
    "an automatic resume again after any trip": (
        RECOVERY, "*resume.resumes > job.plan.policy.max_auto_resumes || !self.trip_may_pass()", "false",
        ["an_automatic_resume_that_meets_an_alarm", "failed_automatic_resumes_count"]),
    "failed automatic resumes do not count": (
        RECOVERY, "                *resume.resumes += 1;\n", "",
        ["failed_automatic_resumes_count"]),
}


def can_be_made(name: str) -> bool:
    file, there, _, _ = TWINS[name]
    if (ROOT / file).read_text().count(there) == 1:
        return True
    print(f"{name}: {file} has changed; the twin must be made again")
    return False


def try_twin(name: str) -> bool:
    file, there, instead, tests = TWINS[name]
    path = ROOT / file
    if subprocess.run(["git", "diff", "--quiet", "HEAD", "--", file], cwd=ROOT).returncode:
        print(f"{name}: {file} has changes that are not committed")
        return False
    if not can_be_made(name):
        return False
    sound = path.read_text()
    command = ["cargo", "test", "--quiet", "--workspace", "--test", "system", "--", *tests]
    try:
        path.write_text(sound.replace(there, instead))
        ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    finally:
        path.write_text(sound)
    if "running" not in ran.stdout:
        print(f"{name}: it does not build\n{ran.stderr[-2000:]}")
        return False
    failures = ran.stdout.split("failures:")[-1]
    passed = [t for t in tests if t not in failures]
    print(f"{name}: {len(tests) - len(passed)} of {len(tests)} tests fail", f"PASSED: {passed}" if passed else "")
    return not passed


def main() -> None:
    # Told to end: the twin is taken back all the same.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    if sys.argv[1:] == ["--check"]:
        sys.exit(0 if all([can_be_made(name) for name in TWINS]) else 1)
    seen = [try_twin(name) for name in sys.argv[1:] or TWINS]
    sys.exit(0 if all(seen) else 1)


if __name__ == "__main__":
    main()
