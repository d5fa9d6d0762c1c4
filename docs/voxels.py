# SPDX-License-Identifier: Apache-2.0
"""Trains a grid of coloured, translucent voxels on the rays of a recording, in numpy alone:
python3 docs/voxels.py RECORDING [STEPS]. One minute; docs/python.md shows where PyTorch goes in."""
import sys

import numpy as np
import redrive

LOW, VOXEL_M, SHAPE = np.float32([-5, -20, -3]), np.float32(0.5), (180, 80, 32)
AT_M = np.geomspace(2, 85, 96, dtype=np.float32)  # samples of a ray
STEP_M = np.diff(AT_M, append=AT_M[-1] + 4)


def rays_of(recording, frames):
    """Origins, directions and colours [n, 3] of the pixels that show the static world."""
    parts = []
    for camera in recording.cameras:
        for frame in frames:
            rays = recording.rays(camera, frame)
            used = rays.valid & recording.mask(camera, frame)
            colours = recording.image(camera, frame)[used] / np.float32(255)
            parts.append((rays.origins[used], rays.directions[used], colours))
    return [np.concatenate(part) for part in zip(*parts)]


def render(grid, sky, origins, directions):
    """Colours [n, 3] by emission and absorption, and what their gradients need."""
    cells = (origins[:, None] + AT_M[:, None] * directions[:, None] - LOW) / VOXEL_M
    inside = ((cells >= 0) & (cells < SHAPE)).all(axis=2)
    index = np.ravel_multi_index(np.moveaxis(cells.astype(int), 2, 0), SHAPE, mode="clip")
    density = np.where(inside, np.exp(grid[index, 3]), 0)
    left = np.exp(-np.cumsum(density * STEP_M, axis=1))  # transmittance after each sample
    weight = np.concatenate([np.ones_like(left[:, :1]), left[:, :-1]], axis=1) - left
    emitted = 1 / (1 + np.exp(-grid[index, :3]))
    colour = (weight[..., None] * emitted).sum(axis=1) + left[:, -1:] * sky
    return colour, (index, density, left, weight, emitted)


def gradients(sky, d_colour, index, density, left, weight, emitted):
    """Adjoint of render: derivatives of the voxels [voxels, 4]."""
    value = (emitted * d_colour[:, None]).sum(axis=2)
    behind = np.cumsum((weight * value)[:, ::-1], axis=1)[:, ::-1] - weight * value
    behind += left[:, -1:] * (d_colour @ sky)[:, None]
    d_log_density = density * STEP_M * (left * value - behind)
    d_raw = weight[..., None] * d_colour[:, None] * emitted * (1 - emitted)
    d = np.concatenate([d_raw, d_log_density[..., None]], axis=2)
    return np.stack([np.bincount(index.ravel(), d[..., k].ravel(), np.prod(SHAPE))
                     for k in range(4)], axis=1).astype(np.float32)


def main(path, steps):
    recording = redrive.open(path, downscale=8)
    training = rays_of(recording, [f for i, f in enumerate(recording.frames) if i % 8])
    held_out = rays_of(recording, recording.frames[::8])
    grid = np.zeros((np.prod(SHAPE), 4), np.float32)
    grid[:, 3] = np.log(0.02)
    sky, rng = training[2].mean(axis=0), np.random.default_rng(0)
    first, second = np.zeros_like(grid), np.zeros_like(grid)  # Adam's moments
    for step in range(1, steps + 1):
        batch = rng.integers(len(training[0]), size=1024)
        origins, directions, colours = (part[batch] for part in training)
        rendered, kept = render(grid, sky, origins, directions)
        d = gradients(sky, 2 * (rendered - colours) / len(batch), *kept)
        first += 0.1 * (d - first)
        second += 0.01 * (d * d - second)
        grid -= 0.2 / (1 + step / steps) * first / (1 - 0.9**step) / np.sqrt(
            second / (1 - 0.99**step) + 1e-14)
        if step % 50 == 0 or step == steps:
            origins, directions, colours = (part[::7] for part in held_out)
            error = np.mean((render(grid, sky, origins, directions)[0] - colours) ** 2)
            print(f"step {step}: {-10 * np.log10(error):.2f} dB on held-out frames, "
                  f"{-10 * np.log10(np.var(held_out[2])):.2f} dB of one colour", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 600)
