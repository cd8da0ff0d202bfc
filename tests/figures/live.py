"""How long the service takes from a frame of the rig to its contacts, for each method.

    python3 tests/figures/live.py PALPATE URL [FRAMES [METHOD ..]]

Follows `palpate live --json` of a service at URL (with a rig behind it, or a campaign under way) and prints
p50, p99 and the longest of the latencies that it states, and how many of the rig's frames were answered.
"""

import json
import subprocess
import sys

from bench import share


def follow(palpate: str, url: str, method: str, frames: int) -> list[dict]:
    command = [palpate, "live", "--json", "--url", url, "--method", method, "--frames", str(frames)]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [json.loads(line) for line in text.splitlines()]


def words(name: str, answers: list[dict]) -> str:
    latencies = [answer["latency_us"] / 1e3 for answer in answers]
    at = lambda q: share(latencies, q)
    return f"{name:8} {len(answers):5} frames, p50 {at(0.5):7.2f} ms, p99 {at(0.99):7.2f} ms, longest {at(1.0):7.2f} ms"


def main(palpate: str, url: str, frames: int, methods: list[str]) -> None:
    for method in methods:
        answers = follow(palpate, url, method, frames)
        of_rig = answers[-1]["sequence"] - answers[0]["sequence"] + 1
        contacts = [len(answer["contacts"]) for answer in answers]
        print(f"{words(method, answers)}; {min(contacts)} to {max(contacts)} contacts, rig sent {of_rig}")
        # exact says whether it searched for contacts or followed those of the frame before.
        for name, searched in ("tracked", False), ("searched", True):
            some = [answer for answer in answers if answer.get("searched") is searched]
            if some:
                print(words(f"  {name}", some))


if __name__ == "__main__":
    main(
        sys.argv[1],
        sys.argv[2],
        int(sys.argv[3]) if len(sys.argv) > 3 else 600,
        sys.argv[4:] or ["fast", "paper", "exact"],
    )
