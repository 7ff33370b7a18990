#!/usr/bin/env python3
"""One training step of the full method in PyTorch, beside the same step of `train`.

    cargo build --release --workspace --example speed
    python3 tests/peers/train_step.py target/release/examples/speed [--threads 2] [--repeat 5]

Network, losses and step are written from the thesis and PROTOCOL 4.1 to 4.6: ResNet-50 encoder
with projected shortcuts, transposed convolutions, four disparity heads; SSIM, L1 and left-right
terms at four scales; patch discriminator with instance norm, LeakyReLU and dropout; Adam for both.
Both sides run one after the other on the same machine with the same number of threads; the best of
the repeats counts. Needs torch (CPU).
"""

import argparse
import os
import re
import subprocess
import sys
import time

import torch
import torch.nn.functional as F
from torch import nn


class Block(nn.Module):
    def __init__(self, inputs, channels, stride):
        super().__init__()
        self.a = nn.Conv2d(inputs, channels, 1)
        self.b = nn.Conv2d(channels, channels, 3, stride, 1)
        self.c = nn.Conv2d(channels, 4 * channels, 1)
        self.shortcut = nn.Conv2d(inputs, 4 * channels, 1, stride)

    def forward(self, x):
        y = self.c(F.elu(self.b(F.elu(self.a(x)))))
        return F.elu(y + self.shortcut(x))


class Generator(nn.Module):
    def __init__(self, width):
        super().__init__()
        n = lambda channels: max(1, round(channels * width))
        self.first = nn.Conv2d(3, n(64), 7, 2, 3)
        inputs, self.stages = n(64), nn.ModuleList()
        for channels, blocks in [(64, 3), (128, 4), (256, 6), (512, 3)]:
            stage = []
            for index in range(blocks):
                stage.append(Block(inputs, n(channels), 2 if index + 1 == blocks else 1))
                inputs = 4 * n(channels)
            self.stages.append(nn.Sequential(*stage))
        self.bottleneck = nn.Conv2d(inputs, n(512), 1)
        inputs = n(512)
        skips = [4 * n(256), 4 * n(128), 4 * n(64), n(64), n(64), 0]
        self.up, self.merge, self.head = nn.ModuleList(), nn.ModuleList(), nn.ModuleList()
        for index, (channels, skip) in enumerate(zip([512, 256, 128, 64, 32, 16], skips)):
            c = n(channels)
            self.up.append(nn.ConvTranspose2d(inputs, c, 4, 2, 1))
            self.merge.append(nn.Conv2d(c + skip + (2 if index > 2 else 0), c, 3, 1, 1))
            if index >= 2:
                self.head.append(nn.Conv2d(c, 2, 3, 1, 1))
                nn.init.constant_(self.head[-1].bias, 0.03)
            inputs = c

    def forward(self, image):
        skips = [F.elu(self.first(image))]
        x = F.max_pool2d(skips[0], 3, 2, 1)
        skips.append(x)
        for stage in self.stages:
            x = stage(x)
            skips.append(x)
        x = F.elu(self.bottleneck(skips.pop()))
        disparities = []
        for index in range(6):
            parts = [F.elu(self.up[index](x))]
            if skips:
                parts.append(skips.pop())
            if disparities:
                parts.append(F.interpolate(disparities[-1], scale_factor=2, mode="nearest"))
            x = F.elu(self.merge[index](torch.cat(parts, 1)))
            if index >= 2:
                disparities.append(F.relu(self.head[index - 2](x)))
        return disparities[::-1]


class Discriminator(nn.Module):
    def __init__(self, width):
        super().__init__()
        layers, inputs = [], 3
        for channels in [64, 128, 256, 512, 512]:
            c = max(1, round(channels * width))
            layers += [nn.Conv2d(inputs, c, 4, 2, 1), nn.InstanceNorm2d(c, affine=True),
                       nn.LeakyReLU(0.2), nn.Dropout(0.2)]
            inputs = c
        layers.append(nn.Conv2d(inputs, 1, 4, 1, 1))
        self.layers = nn.Sequential(*layers)

    def forward(self, x):
        return self.layers(x)


def sample(source, disparity, sign):
    """source(x + sign * W * disparity), linear along the row, black outside."""
    width = source.shape[3]
    padded = F.pad(source, (1, 1))
    column = torch.arange(width, dtype=source.dtype) + sign * width * disparity
    column = column.clamp(-1, width) + 1
    left = column.detach().floor().clamp(max=width)
    weight = column - left
    index = left.long().expand(-1, source.shape[1], -1, -1)
    return (padded.gather(3, index) * (1 - weight) + padded.gather(3, index + 1) * weight)


def dssim(a, b):
    pool = lambda x: F.avg_pool2d(x, 3, 1)
    ma, mb = pool(a), pool(b)
    sa, sb = pool(a * a) - ma * ma, pool(b * b) - mb * mb
    sab = pool(a * b) - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    ssim = (2 * ma * mb + c1) * (2 * sab + c2) / ((ma * ma + mb * mb + c1) * (sa + sb + c2))
    return ((1 - ssim) / 2).clamp(0, 1).mean()


def stereo(left, right, disparities):
    total = 0.0
    for level, disparity in enumerate(disparities):
        l, r = (F.avg_pool2d(x, 2**level) if level else x for x in (left, right))
        dl, dr = disparity[:, :1], disparity[:, 1:]
        made_r, made_l = sample(l, dr, 1), sample(r, dl, -1)
        for real, made in [(r, made_r), (l, made_l)]:
            total = total + dssim(real, made) + 0.1 * (real - made).abs().mean()
        total = total + (sample(dl, dr, 1) - dr).abs().mean()
        total = total + (sample(dr, dl, -1) - dl).abs().mean()
    return total


def seconds_per_step(width, height, columns, batch, repeat):
    torch.manual_seed(0)
    generator, critic = Generator(width), Discriminator(width)
    parameters = sum(p.numel() for p in generator.parameters())
    adam_g = torch.optim.Adam(generator.parameters(), 1e-4)
    adam_d = torch.optim.Adam(critic.parameters(), 1e-4)
    left, right = torch.rand(2, batch, 3, height, columns)
    cut = lambda image: image[:, :, :, :height]
    best = float("inf")
    for _ in range(repeat + 1):
        start = time.perf_counter()
        disparities = generator(left)
        loss = stereo(left, right, disparities)
        fakes = [sample(left, 0.5 * disparities[0][:, 1:], 1),
                 sample(right, 0.5 * disparities[0][:, :1], -1)]
        critic_loss = 0.0
        for real, fake in zip([right, left], fakes):
            critic_loss = critic_loss + F.softplus(-critic(cut(real))).mean()
            critic_loss = critic_loss + F.softplus(critic(cut(fake.detach()))).mean()
        adam_d.zero_grad()
        critic_loss.backward()
        adam_d.step()
        for p in critic.parameters():
            p.requires_grad_(False)
        for fake in fakes:
            loss = loss + 0.01 * F.softplus(-critic(cut(fake))).mean()
        for p in critic.parameters():
            p.requires_grad_(True)
        adam_g.zero_grad()
        loss.backward()
        adam_g.step()
        best = min(best, time.perf_counter() - start)
    return best, parameters


def seconds_per_forward(width, height, columns, batch, repeat):
    torch.manual_seed(0)
    generator = Generator(width)
    image = torch.rand(batch, 3, height, columns)
    best = float("inf")
    with torch.no_grad():
        for _ in range(repeat + 1):
            start = time.perf_counter()
            generator(image)
            best = min(best, time.perf_counter() - start)
    return best, sum(p.numel() for p in generator.parameters())


def peak_mib():
    """Highest resident memory of this process since it began to run its program."""
    with open("/proc/self/status") as status:
        return int(re.search(r"VmHWM:\s+(\d+) kB", status.read()).group(1)) // 1024


# What is timed (a step, or the forward pass alone), name and width of the network, size, batch.
CASES = [
    ("one", "full", "1", 256, 512, 1),
    ("one", "full", "1", 256, 512, 2),
    ("one", "full", "1", 256, 512, 4),
    ("one", "quarter", "1/4", 64, 128, 8),
    ("forward", "full", "1", 256, 512, 1),
    ("forward", "full", "1", 256, 512, 4),
]


def run(command, threads):
    """The milliseconds and MiB that a program prints of its one case."""
    # A process of its own for each case: memory is then of that case alone.
    environment = {**os.environ, "RAYON_NUM_THREADS": str(threads)}
    output = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    found = re.search(r": (\d+) ms.*, (\d+) MiB", output.stdout, re.DOTALL)
    return float(found.group(1)), int(found.group(2))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("speed", help="the built example `speed` of strat-train")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of the cases, from 0")
    parser.add_argument("--case", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.case is not None:
        torch.set_num_threads(args.threads)
        kind, name, width, height, columns, batch = CASES[args.case]
        width = 1.0 if width == "1" else 0.25
        timed = {"one": seconds_per_step, "forward": seconds_per_forward}[kind]
        best, parameters = timed(width, height, columns, batch, args.repeat)
        if name == "full":
            assert parameters == 55_480_360, f"another network: {parameters} parameters"
        print(f"torch: {1e3 * best:.0f} ms, {peak_mib()} MiB")
        return
    print(f"torch {torch.__version__}, {args.threads} threads, best of {args.repeat}")
    print(f"{'case':<36}{'torch ms':>10}{'strat ms':>10}{'ratio':>8}{'torch MiB':>11}{'strat MiB':>11}")
    for index, (kind, name, width, height, columns, batch) in enumerate(CASES):
        if args.only and index not in args.only:
            continue
        theirs, their_memory = run(
            [sys.executable, __file__, args.speed, "--threads", str(args.threads),
             "--repeat", str(args.repeat), "--case", str(index)], args.threads)
        ours, our_memory = run(
            [args.speed, kind, width, str(columns), str(height), str(batch),
             str(args.repeat + 1)], args.threads)
        what = {"one": "step", "forward": "forward"}[kind]
        case = f"{what}, {name}, {columns}x{height}, batch {batch}"
        print(f"{case:<36}{theirs:>10.0f}{ours:>10.0f}{ours / theirs:>8.2f}"
              f"{their_memory:>11}{our_memory:>11}", flush=True)


if __name__ == "__main__":
    main()
