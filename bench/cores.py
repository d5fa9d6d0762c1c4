#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How the parts of redrive scale over the cores of this machine, and where they would stop.

    bench/cores.py build/release/redrive RECORDING FOLDER [--frames A:B] [--steps N] [--runs N]

Runs each part of the work with 1, 2, 4, ... threads, as many as there are cores, in turn, and
replaces `run`, `aligned`, `drive` and `points.ply` in FOLDER. The times with one and two threads
give T(n) = serial + parallel / n (Amdahl 1967), hence the serial share and a projection to 4, 16
and 64 cores, with the spread of the runs. The projection leaves out the limit of memory bandwidth.
"""
import argparse
import json
import os
import pathlib
import shutil
import statistics
import subprocess
import time

PROJECTED = (4, 16, 64)


def seconds_of(command):
    start = time.monotonic()
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-2000:]}")
    return time.monotonic() - start


def last_metrics(run):
    lines = (run / "metrics.jsonl").read_text().splitlines()
    return next(row for row in map(json.loads, reversed(lines)) if "seconds" in row)


class Parts:
    """Times of the parts of the work with a number of threads, by name, in seconds."""

    def __init__(self, arguments):
        self.program = str(arguments.program)
        self.recording = str(arguments.recording)
        self.folder = arguments.folder
        self.frames = ["--frames", arguments.frames] if arguments.frames else []
        self.steps = arguments.steps

    def redrive(self, threads, *arguments):
        return seconds_of([self.program, *map(str, arguments), "--threads", str(threads)])

    def train(self, threads, steps, out):
        shutil.rmtree(out, ignore_errors=True)
        return self.redrive(threads, "train", self.recording, *self.frames, "--holdout-every", 8,
                            "--max-seconds", 0, "--max-steps", steps, "--out", out)

    def measure(self, threads):
        run, aligned, drive = (self.folder / name for name in ("run", "aligned", "drive"))
        points = self.folder / "points.ply"
        for path in (aligned, drive, drive.with_name("drive.unfinished")):
            shutil.rmtree(path, ignore_errors=True)
        points.unlink(missing_ok=True)
        start = self.train(threads, 1, run)
        whole = self.train(threads, self.steps, run)
        steps = last_metrics(run)["seconds"]
        return {
            "images, first Gaussians, a step": start,
            f"{self.steps} steps": steps,
            "train, the whole command": whole,
            "align": self.redrive(threads, "align", self.recording, *self.frames, "--out", aligned),
            "eval": self.redrive(threads, "eval", run),
            "simulate, images alone": self.redrive(
                threads, "simulate", run, "--to", "aimotive", "--labels", "none", "--sensor",
                "none", "--out", drive),
            "export --to ply": self.redrive(threads, "export", run, "--to", "ply", "--out", points),
        }


def serial_share(one, two):
    return min(max((2 * two - one) / one, 0), 1)


def speedup(share, cores):
    return 1 / (share + (1 - share) / cores)


def report(times, threads):
    measured = [n for n in threads if n > 2]
    columns = [f"{n} threads" for n in threads] + ["serial"] + [f"x on {n}" for n in PROJECTED]
    print(f"{'part':34}" + "".join(f"{name:>18}" for name in columns))
    for part in times[1][0]:
        seconds = {n: [run[part] for run in times[n]] for n in threads}
        shares = sorted(serial_share(a, b) for a, b in zip(seconds[1], seconds[2]))
        middle = statistics.median(shares)
        cells = [f"{statistics.median(seconds[n]):.2f} s" for n in threads]
        cells.append(f"{100 * middle:.1f} %")
        for n in PROJECTED:
            text = f"{speedup(middle, n):.1f}"
            if len(shares) > 1:
                text += f" ({speedup(shares[-1], n):.1f}-{speedup(shares[0], n):.1f})"
            cells.append(text)
        print(f"{part:34}" + "".join(f"{cell:>18}" for cell in cells))
    for n in measured:
        print(f"measured with {n} threads: " + ", ".join(
            f"{part} x {statistics.median([a[part] / b[part] for a, b in zip(times[1], times[n])]):.1f}"
            for part in times[1][0]))


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("recording", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--frames", help="frames to use, as of train")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--runs", type=int, default=3)
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    cores = len(os.sched_getaffinity(0))
    threads = [1, 2]
    while 2 * threads[-1] <= cores:
        threads.append(2 * threads[-1])
    parts = Parts(arguments)
    times = {n: [] for n in threads}
    for _ in range(arguments.runs):
        for n in threads:  # in turn: what else runs here disturbs all alike
            times[n].append(parts.measure(n))
    report(times, threads)


if __name__ == "__main__":
    main()
