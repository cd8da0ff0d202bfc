"""How long the service takes from a frame of the rig to its contacts, for each method.

    python3 tests/figures/live.py PALPATE URL [FRAMES [METHOD ..]]

Follows `palpate live --json` of a service at URL (with a rig behind it, or a campaign under way) and prints
p50, p99 and the longest of the latencies that it states, and how many of the rig's frames were answered.
"""

import json
import subprocess
import sys


def follow(palpate: str, url: str, method: str, frames: int) -> list[dict]:
    command = [palpate, "live", "--json", "--url", url, "--method", method, "--frames", str(frames)]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [json.loads(line) for line in text.splitlines()]


def main(palpate: str, url: str, frames: int, methods: list[str]) -> None:
    for method in methods:
        answers = follow(palpate, url, method, frames)
        latencies = sorted(answer["latency_us"] / 1e3 for answer in answers)
        at = lambda q: latencies[min(len(latencies) - 1, int(q * len(latencies)))]
        first, last = answers[0]["sequence"], answers[-1]["sequence"]
        contacts = [len(answer["contacts"]) for answer in answers]
        print(
            f"{method:6} p50 {at(0.5):7.2f} ms, p99 {at(0.99):7.2f} ms, longest {latencies[-1]:7.2f} ms; "
            f"{len(answers)} of {last - first + 1} frames answered, {min(contacts)} to {max(contacts)} contacts"
        )


if __name__ == "__main__":
    main(
        sys.argv[1],
        sys.argv[2],
        int(sys.argv[3]) if len(sys.argv) > 3 else 600,
        sys.argv[4:] or ["fast", "paper", "exact"],
    )
