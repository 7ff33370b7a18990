#!/usr/bin/env python3
"""A small PyTorch depth network, validated after each epoch with 95 % intervals.

    python validate_pytorch.py SET [EPOCHS]

SET is an Eigen set that `strat prep eigen` has written. The network learns disparity as a fraction of the image
width from the right view: the left view, sampled at the predicted disparity, must look like it.
"""

import sys

import torch
import torch.nn.functional as F
from torch import nn
from torch.utils.data import DataLoader

import strat


def network():
    """Disparity between 0 and 0.1 of the width, at half the input's size."""
    layers, channels = [], [3, 16, 32, 64, 64]
    for before, after in zip(channels, channels[1:]):
        layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.BatchNorm2d(after), nn.ELU()]
    for before, after in zip(channels[:1:-1], channels[-2:0:-1]):
        layers += [nn.Upsample(scale_factor=2), nn.Conv2d(before, after, 3, padding=1)]
        layers += [nn.BatchNorm2d(after), nn.ELU()]
    return nn.Sequential(*layers, nn.Conv2d(16, 1, 3, padding=1), nn.Sigmoid())


def predict(net, images):
    """Disparity fractions, (N, rows, columns), of uint8 images (N, rows, columns, RGB)."""
    return 0.1 * net(images.permute(0, 3, 1, 2).float() / 255 - 0.5)[:, 0]


def loss(net, batch):
    left, right = (batch[side].permute(0, 3, 1, 2).float() / 255 for side in ("left", "right"))
    disparity = F.interpolate(predict(net, batch["left"])[:, None], left.shape[2:], mode="bilinear")[:, 0]
    grid = F.affine_grid(torch.eye(2, 3).expand(len(left), 2, 3), left.shape, align_corners=False)
    warped = F.grid_sample(right, grid - torch.stack([2 * disparity, 0 * disparity], -1), align_corners=False)
    return (warped - left).abs().mean() + 0.1 * sum(disparity.diff(dim=axis).abs().mean() for axis in (1, 2))


def validate(net, data, epoch, size):
    run = strat.Run(data, model=f"example@{epoch}", meaning="disparity_fraction")
    net.eval()
    with torch.no_grad():
        for sample in run:
            image = torch.as_tensor(sample.image).permute(2, 0, 1)[None].float()
            image = F.interpolate(image, size, mode="area").permute(0, 2, 3, 1)
            run.add(sample.id, predict(net, image)[0])
    net.train()
    return run


def main(data, epochs=5):
    torch.manual_seed(0)
    net = network()
    optimizer = torch.optim.Adam(net.parameters(), 3e-4)
    pairs = strat.PreparedSet(data).train.only("left", "right")
    loader = DataLoader(pairs, batch_size=8, shuffle=True, num_workers=2)
    for epoch in range(epochs + 1):
        for batch in loader if epoch else []:
            optimizer.zero_grad()
            loss(net, batch).backward()
            optimizer.step()
        run = validate(net, data, epoch, pairs[0]["left"].shape[:2])
        mean = run.summary()["eigen-80"]["abs_rel"]
        bounds = "" if mean.low is None else f" ({mean.low:.3f} to {mean.high:.3f})"
        print(f"epoch {epoch}: Abs Rel {mean.value:.3f}{bounds}, {mean.images} images", flush=True)
    return run


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
