#!/usr/bin/env python3
"""When a discriminator begins to tell real patches from synthesised ones, in PyTorch.

    prep synth --preset miniature --out world
    prep eigen --raw world/kitti_raw --allow-missing --train-depth --out eigen
    python3 tests/peers/discriminator.py --data eigen [--width 0.125] [--dropout 0.2] [--steps 4800]

The discriminator of PROTOCOL 4.5 on patches of 64 from images of 192x64, written independently of `train`, and
taught alone: real are the patches of a set's training images, synthesised the same images sampled along the rows
by a wavy disparity of 0 to 3 % of the width, as a generator that has learnt little would do it. Prints the share
of logits with the right sign and the objective (2 ln 2 = 1.386 for guessing), means of 240 steps each.

Whether `train` tells them apart as late as this is read from its scalars.csv. Not here: a generator that learns.
Needs numpy, Pillow and torch.
"""

import argparse
import csv
import pathlib

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image

SIZE = (192, 64)
PATCH = 64
FILTERS = [64, 128, 256, 512, 512]
PAIRS = 4
REPORT = 240


def discriminator(width, dropout):
    layers, inputs = [], 3
    for filters in FILTERS:
        outputs = int(filters * width)
        layers += [torch.nn.Conv2d(inputs, outputs, 4, 2, 1), torch.nn.InstanceNorm2d(outputs, affine=True),
                   torch.nn.LeakyReLU(0.2), torch.nn.Dropout(dropout)]
        inputs = outputs
    return torch.nn.Sequential(*layers, torch.nn.Conv2d(inputs, 1, 4, 1, 1))


def images(data, side, every=4):
    rows = list(csv.DictReader((data / "train.csv").open()))[::every]
    small = [np.asarray(Image.open(data / row[side]).resize(SIZE, Image.BOX), np.float32) / 255 for row in rows]
    return torch.tensor(np.stack(small)).permute(0, 3, 1, 2)


def sampled(image, disparity):
    """`image`, [n, 3, h, w], at x + disparity, a fraction of the width."""
    n, _, height, width = image.shape
    x = ((torch.arange(width) + 0.5) / width * 2 - 1).expand(n, height, width) + 2 * disparity
    y = ((torch.arange(height) + 0.5) / height * 2 - 1)[:, None].expand(n, height, width)
    return F.grid_sample(image, torch.stack([x, y], -1), align_corners=False, padding_mode="border")


def patches(views):
    lefts = torch.randint(SIZE[0] - PATCH + 1, (len(views),))
    return torch.stack([view[:, :, left:left + PATCH] for view, left in zip(views, lefts)])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--width", type=float, default=1 / 8)
    parser.add_argument("--dropout", type=float, default=0.2)
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--steps", type=int, default=4800)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    left, right = images(args.data, "left"), images(args.data, "right")
    network = discriminator(args.width, args.dropout)
    optimizer = torch.optim.Adam(network.parameters(), lr=args.rate)
    correct, objectives = [], []
    for step in range(1, args.steps + 1):
        chosen = torch.randint(len(left), (PAIRS,))
        disparity = F.interpolate(0.03 * torch.rand(PAIRS, 1, 8, 24), SIZE[::-1], mode="bilinear")[:, 0]
        real = network(patches(torch.cat([left[chosen], right[chosen]])))
        synthesised = network(patches(torch.cat([
            sampled(right[chosen], -disparity), sampled(left[chosen], disparity)])))
        objective = F.softplus(-real).mean() + F.softplus(synthesised).mean()
        optimizer.zero_grad()
        objective.backward()
        optimizer.step()
        correct.append(((real > 0).float().mean() + (synthesised < 0).float().mean()).item() / 2)
        objectives.append(objective.item())
        if step % REPORT == 0:
            print(f"step {step:5}  right {np.mean(correct[-REPORT:]):.3f}  objective {np.mean(objectives[-REPORT:]):.3f}",
                  flush=True)


if __name__ == "__main__":
    main()
