"""Writes torch.json: for small nets of each kind PyTorch's answers, losses, gradients and
first steps of Adam. Run it manually after a change of the nets' layers:

    python trainer/tests/make_torch.py > trainer/tests/torch.json

Needs torch. The nets are PyTorch's own modules; their numbers are listed in the order of
`Network::each_number` (layer by layer; weight, bias; scale, shift, mean, variance).
"""
import json, math
import torch
from torch import nn

torch.manual_seed(5)
torch.set_default_dtype(torch.float32)
CHANNELS, ROWS, STEPS, FLOOR = 5, 7, 4, 1e-3
OPTIMISER = "[optimiser]\nlearning_rate = 0.01\nbeta1 = 0.7\nbeta2 = 0.99\n"


class Standardise(nn.Module):
    def __init__(self):
        super().__init__()
        self.mean, self.sd = torch.randn(CHANNELS) * 0.02, torch.rand(CHANNELS) * 0.05 + 0.01

    def forward(self, x):
        return (x - self.mean) / self.sd


class UnitNorm(nn.Module):
    def __init__(self, log):
        super().__init__()
        self.log = log

    def forward(self, x):
        size = x.norm(dim=1, keepdim=True).clamp(min=FLOOR)
        return torch.cat([x / size, size.log()], 1) if self.log else x / size


class Scale(nn.Module):
    def __init__(self, scale):
        super().__init__()
        self.scale = float(torch.tensor(scale, dtype=torch.float32))

    def forward(self, x):
        return x * self.scale


def fixed(module):
    return module.requires_grad_(False)


def whitened(components):
    return [UnitNorm(True), fixed(nn.Linear(CHANNELS + 1, components + 1))]


def numbers(modules, of):
    """Numbers of layers in our order; `of` selects a parameter's values or its gradient."""
    out = []
    put = lambda t: out.extend(t.detach().flatten().tolist())
    for m in modules:
        if isinstance(m, (nn.Linear, nn.ConvTranspose2d, nn.Conv2d)):
            put(of(m.weight)), m.bias is None or put(of(m.bias))
        elif isinstance(m, nn.BatchNorm2d):
            put(of(m.weight)), put(of(m.bias)), put(of(m.running_mean)), put(of(m.running_var))
        elif isinstance(m, Standardise):
            put(of(m.mean)), put(of(m.sd))
        elif isinstance(m, Scale):
            put(of(torch.tensor([m.scale, 0.0])))
    return out


def case(recipe, modules, target, targets, loss, residual=False, rectified=False, epsilon=1e-6):
    net = nn.Sequential(*modules)
    inputs = torch.randn(ROWS, CHANNELS) * 0.05

    def answer():
        out = net(inputs)
        return inputs + inputs.norm(dim=1, keepdim=True).clamp(min=FLOOR) * out if residual else out

    def value(t):
        return t

    def gradient(t):
        if not t.requires_grad:
            return torch.full_like(t, math.nan)
        return t.grad

    start = numbers(modules, value)
    net.eval()
    answers = answer()
    answers = (answers.relu() if rectified else answers).flatten().tolist()
    net.train()
    adam = torch.optim.Adam([p for p in net.parameters() if p.requires_grad], lr=0.01, betas=(0.7, 0.99), eps=epsilon)
    losses, gradients = [], None
    for _ in range(STEPS):
        adam.zero_grad()
        minimised = loss(answer(), targets)
        minimised.backward()
        gradients = gradients or numbers(modules, gradient)
        losses.append(minimised.item())
        adam.step()
    return {
        "recipe": f"seed = 1\nepochs = 1\nbatch = 7\n{OPTIMISER}epsilon = {epsilon}\n[net]\n{recipe}",
        "channels": CHANNELS,
        "target": target,
        "numbers": start,
        "inputs": inputs.flatten().tolist(),
        "targets": targets.flatten().tolist(),
        "answers": answers,
        "losses": losses,
        "gradients": [None if math.isnan(g) else g for g in gradients],
        "after": numbers(modules, value),
    }


def short(case):
    """Nine digits distinguish every f32."""
    cut = lambda x: float(f"{x:.9g}") if isinstance(x, float) else x
    return {k: [cut(x) for x in v] if isinstance(v, list) else v for k, v in case.items()}


def transfer(width):
    return [nn.Linear(CHANNELS, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, CHANNELS)]


def recon(front, width, up, batch_norm):
    """Its last bias is such that some answers are above zero."""
    def norm(c):
        if not batch_norm:
            return []
        bn = nn.BatchNorm2d(c)
        nn.init.uniform_(bn.weight, 0.5, 1.5), nn.init.uniform_(bn.bias, -0.5, 0.5)
        bn.running_mean.uniform_(-0.1, 0.1), bn.running_var.uniform_(0.5, 1.5)
        return [bn]

    dense, last = nn.Linear(width, 4 * 4), up(3, 1)
    nn.init.constant_(last[0].bias, 0.2)
    return [*front, dense, nn.Unflatten(1, (4, 2, 2)), *norm(4), nn.ReLU(), *up(4, 3), *norm(3), nn.ReLU(), *last,
            nn.Flatten(), Scale(0.8)]


def main():
    mse = lambda unit: lambda p, y: (((p - y) / unit) ** 2).mean()
    relative = lambda p, y: (((p - y) / y.norm(dim=1, keepdim=True).clamp(min=FLOOR)) ** 2).sum(1).mean()

    def points(p, y):
        pressed = (y > 0).float()
        logits, logs = p[:, :6], p[:, 6:]
        entropy = nn.functional.binary_cross_entropy_with_logits(logits, pressed, reduction="sum")
        return (entropy + 0.5 * (((logs - (y + 1 - pressed).log()) * pressed) ** 2).sum()) / len(p)

    volts = lambda: torch.randn(ROWS, CHANNELS) * 0.05
    forces = lambda n: torch.rand(ROWS, n) * 30 * (torch.rand(ROWS, n) > 0.7)
    unit = float(torch.tensor(0.8, dtype=torch.float32))
    apart = lambda a, b: [nn.ConvTranspose2d(a, b, 2, 2)]
    overlapping = lambda a, b: [nn.ConvTranspose2d(a, b, 4, 2, 1)]
    unbiased = lambda a, b: [nn.ConvTranspose2d(a, b, 4, 2, 1, bias=b == 1)]
    shuffled = lambda a, b: [nn.Conv2d(a, 4 * b, 3, padding=1), nn.PixelShuffle(2)]
    standard = lambda: [Standardise(), Scale(1.0)]
    cases = [
        case("kind = 'transfer-net'\nhidden = 2\nwidth = 6\n", [*standard(), *transfer(6), Scale(0.8)], CHANNELS,
             volts(), mse(unit)),
        case("kind = 'transfer-net'\nform = 'residual'\nhidden = 2\nwidth = 6\n",
             [UnitNorm(False), Scale(CHANNELS**0.5), *transfer(6), Scale(CHANNELS**-0.5)], CHANNELS, volts(), relative,
             residual=True),
        case("kind = 'point-net'\ncomponents = 4\nhidden = 2\nwidth = 7\nforce_weight = 0.5\n",
             [*whitened(4), nn.Linear(5, 7), nn.GELU(), nn.Linear(7, 7), nn.GELU(), nn.Linear(7, 12)], 6, forces(6),
             points),
        case("kind = 'recon-net'\nside = 8\nchannels = [4, 3]\nbatch_norm = true\ninput.whitened.components = 4\n",
             recon(whitened(4), 5, unbiased, True), 64, forces(64), mse(unit), rectified=True,
             epsilon=1e-3),  # The dense bias has no gradient but rounding, which must stay small compared with it.
        case("kind = 'recon-net'\nside = 8\nchannels = [4, 3]\ninput.whitened.components = 4\n",
             recon(whitened(4), 5, overlapping, False), 64, forces(64), mse(unit), rectified=True),
        case("kind = 'end-to-end'\nside = 8\nchannels = [4, 3]\nupsampling = 'apart'\ninput = 'standardised'\n",
             recon(standard(), CHANNELS, apart, False), 64, forces(64), mse(unit), rectified=True),
        case("kind = 'recon-net'\nside = 8\nchannels = [4, 3]\nupsampling = 'shuffled'\ninput = 'standardised'\n",
             recon(standard(), CHANNELS, shuffled, False), 64, forces(64), mse(unit), rectified=True),
    ]
    print("[" + ",\n".join(json.dumps(short(c)) for c in cases) + "]")


main()
