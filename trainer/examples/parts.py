"""Where the time of a training goes, ours and PyTorch's with fused Adam, by Linux perf.

    python trainer/examples/parts.py RATE_BINARY [--seconds S] [--symbols N] [NET ..]

Each trains with one thread for --seconds under `perf record`; the samples of the processor are grouped by the function
in which they are. The table states the share of each group, and the processor's time that it takes per training sample,
with ratio: ours over PyTorch's. If the matrix products alone differ by the ratio of the rates, no work outside of them
can close the gap. --symbols lists the largest functions of each group, so that the grouping can be checked. Needs torch
and perf; NETs are those of rate.py.
"""

import argparse
import pathlib
import re
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).parent))
import rate

# The first group whose pattern a function or its library has.
GROUPS = [
    ("optimiser", r"adam"),
    ("matrix products", r"gemm|gemv|microkernel|matmul|mkl_blas|dnnl|mkldnn|openblas|brgemm"),
    ("memory", r"memcpy|memmove|memset|memcmp|malloc|free|alloc|page_fault|clear_page|copy_page|mmap|munmap|\[kernel"),
    ("activations, losses, other tensors", r"relu|gelu|threshold|macerator|burn|flex|at::|torch|aten|c10|libm"),
]


def group(library, function):
    """Name of a function's group."""
    words = f"{function} {library}".lower()
    return next((name for name, pattern in GROUPS if re.search(pattern.lower(), words)), "everything else")


def profile(command, rate_of):
    """Rate that a command prints as a number, and its samples by (library, function), as shares."""
    with tempfile.TemporaryDirectory() as folder:
        data = f"{folder}/perf.data"
        record = ["perf", "record", "-q", "-e", "cpu-clock", "-F", "499", "-o", data, "--", *command]
        ran = subprocess.run(record, capture_output=True, text=True)
        if ran.returncode:
            raise SystemExit(f"perf record: {ran.stderr.strip()}")
        report = ["perf", "report", "-i", data, "--stdio", "--no-children", "-F", "overhead,dso,symbol", "-t", "\t"]
        lines = subprocess.run(report, capture_output=True, text=True, check=True).stdout.splitlines()
    shares = {}
    for line in lines:
        fields = [field.strip() for field in line.split("\t")]
        if not line.startswith("#") and len(fields) == 3:
            key = fields[1], re.sub(r"^\[.\] ", "", fields[2])
            shares[key] = shares.get(key, 0.0) + float(fields[0].rstrip("%")) / 100
    return rate_of(ran.stdout), shares


def grouped(shares):
    """Share of each group."""
    sums = {}
    for (library, function), share in shares.items():
        name = group(library, function)
        sums[name] = sums.get(name, 0.0) + share
    return sums


def torch_alone(net, seconds):
    """Trains with PyTorch in this process, and prints its rate."""
    rate.torch.set_num_threads(1)
    print(rate.torch_rate(net, rate.NETS[net][1], seconds, True, True, False))


def main():
    """Prints a table for each net."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("nets", nargs="*", default=[])
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--symbols", type=int, default=0)
    parser.add_argument("--torch", metavar="NET", help=argparse.SUPPRESS)
    args = parser.parse_intermixed_args()
    if args.torch:
        return torch_alone(args.torch, args.seconds)
    number = r"samples_per_processor_s\D*([\d.]+)"
    for net in args.nets or ["transfer-net", "transfer-residual", "point-net"]:
        recipe, batch = rate.NETS[net]
        ours = profile([args.binary, recipe, str(batch), str(args.seconds), "1"],
                       lambda printed: float(re.search(number, printed)[1]))
        own = [sys.executable, __file__, "-", "--torch", net, "--seconds", str(args.seconds)]
        theirs = profile(own, lambda printed: float(printed.split()[-1]))
        print(f"\n{net}, batch {batch}: {ours[0]:.0f} and {theirs[0]:.0f} samples per second of the processor, "
              f"ratio {ours[0] / theirs[0]:.2f}\n")
        print("| part | ours, % | us per sample | PyTorch, % | us per sample | ratio of times |\n|" + "---|" * 6)
        sums = [grouped(shares) for _, shares in (ours, theirs)]
        for name in sorted(set(sums[0]) | set(sums[1]), key=lambda name: -sums[0].get(name, 0.0)):
            shares = [each.get(name, 0.0) for each in sums]
            us = [1e6 * share / speed for share, (speed, _) in zip(shares, (ours, theirs))]
            ratio = f"{us[0] / us[1]:.2f}" if us[1] else "-"
            print(f"| {name} | {100 * shares[0]:.0f} | {us[0]:.1f} | {100 * shares[1]:.0f} | {us[1]:.1f} | {ratio} |")
        for title, (_, shares) in [("ours", ours), ("PyTorch", theirs)] if args.symbols else []:
            print(f"\n{title}:")
            for (library, function), share in sorted(shares.items(), key=lambda item: -item[1])[: args.symbols]:
                print(f"  {100 * share:5.1f} %  {group(library, function):35}  {library}  {function[:100]}")


if __name__ == "__main__":
    main()
