#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A reference for `redrive bench`: the training step of --method nerf in PyTorch, on the same GPU, in the same run.

A step draws 1024 rays from a table, samples them stratified between 1 m and 10 m (NeRF equation 2), encodes positions
and directions (section 5.1), evaluates the network of src/redrive/field/nerf_field.h, renders (equation 3), takes the
mean squared error, runs backward and applies Adam. Matrix products are bf16 (autocast), everything is compiled
(torch.compile), Adam is fused.

    bench/pytorch_step.py                                   # PyTorch alone
    bench/pytorch_step.py --redrive build/release/redrive   # compares with redrive bench --backend cuda

Needs PyTorch 2 (written for 2.11) and a CUDA GPU; --device cpu only shows that it runs. redrive itself needs neither.
"""
import argparse
import json
import math
import statistics
import subprocess
import time

import torch
from torch import nn

HIDDEN, SKIP, POSITION_OCTAVES, DIRECTION_OCTAVES = 8, 5, 10, 4
NEAR_M, FAR_M, RAYS = 1.0, 10.0, 1024
SIZES = [(256, 96), (128, 48)]  # width, samples a ray: the report's, and the small one


def encode(points, octaves):
    """Returns gamma of [..., 3]: the coordinates, and sine and cosine of 2^l pi times each."""
    angle = points[..., None] * (math.pi * 2.0 ** torch.arange(octaves, device=points.device))
    return torch.cat([points, torch.sin(angle).flatten(-2), torch.cos(angle).flatten(-2)], -1)


class Field(nn.Module):
    def __init__(self, width):
        super().__init__()
        position, direction = 3 + 6 * POSITION_OCTAVES, 3 + 6 * DIRECTION_OCTAVES
        inputs = [position] + [width] * (HIDDEN - 1)
        inputs[SKIP] += position
        self.trunk = nn.ModuleList(nn.Linear(n, width) for n in inputs)
        self.density = nn.Linear(width, 1)
        self.feature = nn.Linear(width, width)
        self.colour = nn.Linear(width + direction, width // 2)
        self.rgb = nn.Linear(width // 2, 3)

    def forward(self, position, direction):
        gamma = encode(position, POSITION_OCTAVES)
        h = gamma
        for i, layer in enumerate(self.trunk):
            h = torch.relu(layer(torch.cat([h, gamma], -1) if i == SKIP else h))
        towards = encode(direction, DIRECTION_OCTAVES)[:, None].expand(-1, h.shape[1], -1)
        colour = torch.relu(self.colour(torch.cat([self.feature(h), towards], -1)))
        return torch.sigmoid(self.rgb(colour)), torch.relu(self.density(h))[..., 0]


def loss_of(field, origin, direction, target, samples):
    bin_m = (FAR_M - NEAR_M) / samples
    first = NEAR_M + bin_m * torch.arange(samples, device=origin.device)
    t = first + bin_m * torch.rand(origin.shape[0], samples, device=origin.device)
    position = (origin[:, None] + t[..., None] * direction[:, None]) / 12.0  # into the cube, as the bench's drive is scaled
    rgb, density = field(position, direction)
    rgb, density = rgb.float(), density.float()
    length = torch.cat([t[:, 1:] - t[:, :-1], torch.full_like(t[:, :1], 1e10)], -1)
    depth = density * length
    before = torch.cumsum(depth, -1) - depth
    weights = torch.exp(-before) * -torch.expm1(-depth)
    return ((weights[..., None] * rgb).sum(1) - target).square().mean()


def step_ms(width, samples, device, repetitions):
    torch.manual_seed(1)
    field = Field(width).to(device)
    optimiser = torch.optim.Adam(field.parameters(), lr=5e-4, fused=device.type == "cuda")
    pixels = 4 * 1280 * 704  # the bench's drive
    direction = nn.functional.normalize(torch.randn(pixels, 3, device=device), dim=-1)
    origin, target = torch.rand(pixels, 3, device=device), torch.rand(pixels, 3, device=device)
    # The last interval has infinite length: 1e10 m and more is opaque in fp32, too.
    loss_compiled = torch.compile(loss_of) if device.type == "cuda" else loss_of

    def step():
        batch = torch.randint(pixels, (RAYS,), device=device)
        optimiser.zero_grad(set_to_none=True)
        with torch.autocast(device.type, dtype=torch.bfloat16):
            loss = loss_compiled(field, origin[batch], direction[batch], target[batch], samples)
        loss.backward()
        optimiser.step()
        return loss

    for _ in range(20 if device.type == "cuda" else 1):  # compiles, chooses kernels
        step()
    times = []
    for _ in range(repetitions):
        if device.type == "cuda":
            start, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
            start.record()
            step()
            end.record()
            end.synchronize()
            times.append(start.elapsed_time(end))
        else:
            start = time.perf_counter()
            step()
            times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def redrive_ms(program, name):
    out = subprocess.run([program, "bench", "--backend", "cuda", "--json", "--filter", name], check=True, stdout=subprocess.PIPE)
    return json.loads(out.stdout)["results"][0]["median_ms"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--redrive", help="the program to compare with")
    parser.add_argument("--device", default="cuda", choices=["cuda", "cpu"])
    parser.add_argument("--repetitions", type=int, default=200)
    options = parser.parse_args()
    device = torch.device(options.device)
    name = torch.cuda.get_device_name() if device.type == "cuda" else "the CPU"
    print(f"PyTorch {torch.__version__} on {name}, median of {options.repetitions} steps of {RAYS} rays")
    for width, samples in SIZES:
        torch_ms = step_ms(width, samples, device, options.repetitions)
        line = f"width {width}, {samples} samples: PyTorch {torch_ms:.3f} ms"
        if options.redrive:
            ours_ms = redrive_ms(options.redrive, f"step/nerf-{width}x{samples}")
            line += f", redrive {ours_ms:.3f} ms: {torch_ms / ours_ms:.2f} times as fast"
        print(line, flush=True)


if __name__ == "__main__":
    main()
