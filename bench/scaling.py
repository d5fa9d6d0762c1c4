#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Simulates how training the blocks of a drive scales with MPI ranks.

    bench/scaling.py SOURCE [--blocks N] [--per-rank N] [--most-ranks N] [...]

SOURCE has the times of blocks: what `redrive plan --json` printed into a file, or the folder of a
divided run (seconds of training in blocks/*/metrics.jsonl; --prepare-s and --read-mb say what
metrics do not). They are taken as one rank's with the cores that it has, and drawn at random, with
a fixed seed, where more blocks are simulated than were measured.

A rank asks the queue, which answers requests one after the other, longest block first; reads the
block's images and LiDAR, all readers sharing the storage evenly; trains; and writes a checkpoint.
Before, ranks start one after the other; afterwards one rank matches the blocks' exposures. Prints a
table for a drive of fixed length (strong scaling) and one for a number of blocks per rank (weak):
seconds, efficiency against one rank, the shares of all ranks' time that are lost, and the largest.

    start     before the first block, of the program and of MPI
    queue     waiting for an answer of the queue
    storage   reading slower than a rank alone would
    balance   without a block while others still train
    finish    matching of exposures
"""
import argparse
import heapq
import json
import pathlib
import random
import sys
from dataclasses import dataclass


@dataclass
class Task:
    read_mb: float  # from the shared storage
    seconds: float  # preparing and training, but for reading


def tasks_of_plan(path):
    blocks = json.loads(path.read_text())["blocks"]
    return [Task(b["reads_bytes"] / 1e6, b["prepare_s"] + b["train_s"]) for b in blocks]


def tasks_of_run(folder, prepare_s, read_mb):
    tasks = []
    for metrics in sorted(folder.glob("blocks/*/metrics.jsonl")):
        rows = [json.loads(line) for line in metrics.read_text().splitlines()]
        seconds = [row["seconds"] for row in rows if "seconds" in row]
        if seconds:
            tasks.append(Task(read_mb, prepare_s + seconds[-1]))
    return tasks


def drawn(tasks, n, seed=1):
    """Returns n tasks: those measured, as often as they fit, and some of them at random."""
    rest = random.Random(seed).sample(tasks, n % len(tasks))
    return tasks * (n // len(tasks)) + rest


def simulate(tasks, ranks, o):
    """Returns the seconds of all and the rank seconds lost to each cause."""
    queue = sorted(tasks, key=lambda task: -task.seconds)
    lost = dict.fromkeys(["start", "queue", "storage", "balance", "finish"], 0.0)
    now, served_until, taken = 0.0, 0.0, 0
    # Events: (time, number, what, task). Readers end when each has read as much as they all have
    # since they began: `read` is that amount for one who reads from the beginning.
    events, readers, number = [], [], 0
    read, began = 0.0, {}

    def push(time, what, task=None):
        nonlocal number
        number += 1
        heapq.heappush(events, (time, number, what, task))

    def rate():
        return min(o.rank_mb_s, o.storage_mb_s / max(1, len(readers)))

    for rank in range(ranks):
        begin = o.start_s + o.start_rank_s * (rank + 1)
        lost["start"] += begin
        push(begin, "asks")
    done = []
    while events or readers:
        ends = now + (readers[0][0] - read) / rate() if readers else float("inf")
        if events and events[0][0] <= ends:
            time, _, what, task = heapq.heappop(events)
            read += (time - now) * rate() if readers else 0
            now = time
            if what == "asks":
                answered = max(now, served_until) + o.queue_s
                served_until = answered
                lost["queue"] += answered - now
                if taken < len(queue):
                    push(answered, "reads", queue[taken])
                    taken += 1
                else:
                    done.append(answered)
            elif what == "reads":
                number += 1
                began[number] = now
                heapq.heappush(readers, (read + task.read_mb, number, task))
            else:  # a block is trained
                push(now, "asks")
        else:
            read, now = readers[0][0], ends
            _, reader, task = heapq.heappop(readers)
            lost["storage"] += now - began.pop(reader) - task.read_mb / o.rank_mb_s
            push(now + task.seconds + o.write_s, "trained")
    end = max(done)
    lost["balance"] = sum(end - time for time in done)
    finish = o.finish_block_s * len(tasks)
    lost["finish"] = finish * ranks
    return end + finish, lost


def table(title, ranks, tasks_for, o):
    print(f"\n{title}")
    print(f"{'ranks':>6} {'blocks':>8} {'seconds':>10} {'efficiency':>10} {'start':>7} {'queue':>7} "
          f"{'storage':>8} {'balance':>8} {'finish':>7}  limit")
    for n in ranks:
        tasks = tasks_for(n)
        alone = sum(task.read_mb / o.rank_mb_s + task.seconds + o.write_s for task in tasks)
        seconds, lost = simulate(tasks, n, o)
        share = {cause: value / (seconds * n) for cause, value in lost.items()}
        limit = max(share, key=share.get)
        print(f"{n:>6} {len(tasks):>8} {seconds:>10.0f} {alone / (seconds * n):>10.1%} "
              f"{share['start']:>7.1%} {share['queue']:>7.1%} {share['storage']:>8.1%} "
              f"{share['balance']:>8.1%} {share['finish']:>7.1%}  "
              f"{limit if share[limit] >= 0.005 else '-'}")


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=pathlib.Path, metavar="SOURCE")
    number = [("--blocks", int, 1250, "blocks of the drive of the strong scaling"),
              ("--per-rank", int, 8, "blocks of each rank of the weak scaling"),
              ("--most-ranks", int, 1024, "ranks at most, from 1 on, doubled each time"),
              ("--rank-mb-s", float, 200, "MB/s that a rank alone reads"),
              ("--storage-mb-s", float, 5000, "MB/s that all ranks together read"),
              ("--queue-s", float, 0.001, "seconds of the queue for an answer"),
              ("--start-s", float, 2, "seconds until a rank alone asks for its first block"),
              ("--start-rank-s", float, 0.005, "seconds more for each rank that starts before"),
              ("--write-s", float, 0.5, "seconds to write a block's last checkpoint"),
              ("--finish-block-s", float, 0.01, "seconds of one rank at the end, for each block"),
              ("--prepare-s", float, 0, "of a divided run: seconds of a block before training"),
              ("--read-mb", float, 0, "of a divided run: MB that a block reads")]
    for name, kind, default, text in number:
        parser.add_argument(name, type=kind, default=default, help=f"{text} (default: {default})")
    o = parser.parse_args()
    measured = (tasks_of_run(o.source, o.prepare_s, o.read_mb) if o.source.is_dir()
                else tasks_of_plan(o.source))
    if not measured:
        sys.exit(f"{o.source}: no block has been trained")
    print(f"{len(measured)} blocks: {min(t.seconds for t in measured):.0f} to "
          f"{max(t.seconds for t in measured):.0f} s, {max(t.read_mb for t in measured):.0f} MB")
    ranks = [1 << i for i in range(o.most_ranks.bit_length()) if 1 << i <= o.most_ranks]
    table(f"Strong scaling: a drive of {o.blocks} blocks", ranks,
          lambda n: drawn(measured, o.blocks), o)
    table(f"Weak scaling: {o.per_rank} blocks for each rank", ranks,
          lambda n: drawn(measured, n * o.per_rank), o)


if __name__ == "__main__":
    main()
