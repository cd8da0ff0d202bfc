"""Samples per second that each net learns: ours, PyTorch with its default Adam, and with fused Adam.

    python trainer/examples/rate.py RATE_BINARY [--rounds N] [--seconds S] [--threads T] [--cpu | --gpu] [NET ..]

The three alternate, round after round, so that other load on the machine affects all of them equally;
the medians over rounds are printed, and the ratios of the medians. Ours has the settings of the allocator with
which the service starts the trainer, PyTorch those of this script's environment: set there, both have them.
On a shared machine, --cpu counts seconds of the processor instead of the clock's, with one thread each. Inputs
are in memory; layers, losses and batches are the same. --gpu: RATE_BINARY was built for a GPU, and PyTorch runs
on the NVIDIA GPU, by its defaults (TF32 in convolutions alone); both copy every batch from host memory. Needs
torch.
"""
import argparse, json, os, statistics, subprocess, time
import torch
from torch import nn

# As src/touch/jobs/trainer/mod.rs.
KEEPS_MEMORY = {"MALLOC_ARENA_MAX": "1", "MALLOC_MMAP_MAX_": "0", "MALLOC_TRIM_THRESHOLD_": "1099511627776"}
NETS = {
    "transfer-net": ('{kind="transfer-net"}', 64),
    "transfer-residual": ('{kind="transfer-net",form="residual"}', 64),
    "point-net": ('{kind="point-net"}', 256),
    "recon-net-32": ('{kind="recon-net",side=32,channels=[128,64,32]}', 64),
    "recon-net-64": ('{kind="recon-net",side=64,channels=[128,64,32]}', 64),
    "recon-net-32-k2": ('{kind="recon-net",side=32,channels=[128,64,32],upsampling="apart"}', 64),
    "recon-net-64-k2": ('{kind="recon-net",side=64,channels=[128,64,32],upsampling="apart"}', 64),
    "recon-net-160": ('{kind="recon-net",side=160}', 64),
    "recon-net-160-k2": ('{kind="recon-net",side=160,upsampling="apart"}', 64),
}


def dense(widths, act):
    layers = []
    for a, b in zip(widths, widths[1:]):
        layers += [nn.Linear(a, b), act()]
    return layers[:-1]


def recon(side, kernel, channels):
    first = side >> len(channels)
    layers = [nn.Linear(101, channels[0] * first * first), nn.Unflatten(1, (channels[0], first, first)), nn.ReLU()]
    for a, b in zip(channels, channels[1:] + [1]):
        layers += [nn.ConvTranspose2d(a, b, kernel, 2, (kernel - 2) // 2), nn.ReLU()]
    return nn.Sequential(*layers[:-1], nn.Flatten())


def build(name):
    """A net behind its normalisation (which costs little), and its loss."""
    mse = lambda p, y: ((p - y) ** 2).mean()
    if name.startswith("transfer"):
        net = nn.Sequential(*dense([784] * 7, nn.ReLU))
        return net, 784, 784, mse
    if name == "point-net":
        def loss(p, y):
            pressed = (y > 0).float()
            logits, logs = p[:, :804], p[:, 804:]
            entropy = nn.functional.binary_cross_entropy_with_logits(logits, pressed, reduction="sum")
            return (entropy + (((logs - (y + 1 - pressed).log()) * pressed) ** 2).sum()) / len(p)
        return nn.Sequential(*dense([101, 1024, 1024, 1024, 1608], nn.GELU)), 101, 804, loss
    side = int(name.split("-")[2])
    kernel = 2 if name.endswith("k2") else 4
    return recon(side, kernel, [128, 64, 32] if side < 160 else [128, 64, 32, 16]), 101, side * side, mse


def torch_rate(name, batch, seconds, fused, cpu, gpu):
    net, inputs, targets, loss = build(name)
    device = torch.device("cuda" if gpu else "cpu")
    net.to(device)
    adam = torch.optim.Adam(net.parameters(), lr=1e-3, betas=(0.7, 0.999), fused=fused)
    x = torch.randn(batch, inputs)
    y = (torch.rand(batch, targets) > 0.99).float() * 9
    if gpu:
        x, y = x.pin_memory(), y.pin_memory()

    def step():
        adam.zero_grad()
        there = [t.to(device, non_blocking=True) for t in (x, y)]
        loss(net(there[0]), there[1]).backward()
        adam.step()

    def finished():
        if gpu:
            torch.cuda.synchronize()

    for _ in range(32):
        step()
    finished()
    done, begun, used = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - begun < seconds:
        step()
        done += batch
    finished()
    return done / (time.process_time() - used if cpu else time.perf_counter() - begun)


def ours(binary, net, batch, seconds, threads, cpu):
    command = [binary, net, str(batch), str(seconds), str(threads)]
    environment = {**os.environ, **KEEPS_MEMORY}
    out = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return json.loads(out.stdout)["samples_per_processor_s" if cpu else "samples_per_s"]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("binary")
    parser.add_argument("nets", nargs="*", default=[])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--cpu", action="store_true")
    parser.add_argument("--gpu", action="store_true")
    a = parser.parse_intermixed_args()
    a.threads = 1 if a.cpu else a.threads
    torch.set_num_threads(a.threads)
    print(f"torch {torch.__version__}, {a.threads} threads, medians of {a.rounds} rounds of {a.seconds} s"
          + (", per second of the processor" if a.cpu else "")
          + (f", {torch.cuda.get_device_name()}" if a.gpu else ""))
    for name in a.nets or NETS:
        net, batch = NETS[name]
        rates = {"ours": [], "torch": [], "fused": []}
        for _ in range(a.rounds):
            rates["ours"].append(ours(a.binary, net, batch, a.seconds, a.threads, a.cpu))
            rates["torch"].append(torch_rate(name, batch, a.seconds, False, a.cpu, a.gpu))
            rates["fused"].append(torch_rate(name, batch, a.seconds, True, a.cpu, a.gpu))
        m = {k: statistics.median(v) for k, v in rates.items()}
        print(f"{name:18} batch {batch:4}  ours {m['ours']:7.0f}/s  torch {m['torch']:7.0f}/s  fused {m['fused']:7.0f}/s"
              f"  ours/torch {m['ours'] / m['torch']:.2f}  ours/fused {m['ours'] / m['fused']:.2f}", flush=True)


if __name__ == "__main__":
    main()
