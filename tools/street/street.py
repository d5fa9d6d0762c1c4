#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Makes the project's street recording: see README.md in this folder.

    python3 street.py OUT [--work DIR] [--stages build,render,raycast,write] ...

Stages that need Blender run in `blender -b -P street.py -- STAGE WORK`.
"""
import argparse
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.dont_write_bytecode = True

import settings as s  # noqa: E402

BLENDER_STAGES = ("build", "render", "raycast", "labels", "markers", "noise")
STAGES = ("build", "render", "raycast", "write")


def in_blender(stage, work):
    chosen = s.Settings.load(work)
    if stage == "build":
        import scene

        scene.build(chosen)
    elif stage == "render":
        import render

        render.render(chosen)
    elif stage == "raycast":
        import raycast

        raycast.raycast(chosen)
    elif stage == "labels":
        import labels

        labels.labels(chosen)
    else:
        import verify

        getattr(verify, f"render_{stage}")(chosen)


def run_blender(stage, work, processes=1):
    command = ["blender", "-b", "--factory-startup", "--python-exit-code", "1", "-P", __file__, "--", stage, str(work)]
    running = [subprocess.Popen(command) for _ in range(processes)]
    if any(p.wait() for p in running):
        sys.exit(f"street.py: stage {stage} failed; its messages are above")


def main():
    p = argparse.ArgumentParser(description="procedural street recording in the aiMotive layout")
    p.add_argument("out", nargs="?", help="folder of the recording; variants go to OUT_traffic and OUT_rolling")
    p.add_argument("--work", default="build/street", help="scratch folder; renders that are there are kept")
    p.add_argument("--stages", default=",".join(STAGES), help=f"of {', '.join(STAGES)}, labels, verify")
    p.add_argument("--variants", default=",".join(s.VARIANTS))
    p.add_argument("--novel", default=",".join(s.NOVEL_VIEWS), help="sets of new views, or none")
    p.add_argument("--seed", type=int, default=7)
    p.add_argument("--size", type=float, default=1.0, help="factor on the image sizes")
    p.add_argument("--frames", type=int, default=48)
    p.add_argument("--samples", type=int, default=32, help="light paths a rendered pixel")
    p.add_argument("--processes", type=int, default=2, help="Blender processes that render, one core each")
    p.add_argument("--self-test", action="store_true", help="checks the camera models, without Blender")
    args = p.parse_args()
    if args.self_test:
        import cameras

        return cameras.self_test()
    if not args.out:
        p.error("OUT is missing")
    names = lambda text, known: [
        n for n in text.split(",") if n in known or p.error(f"{n!r}: known are {', '.join(known)}")
    ]
    novel = [] if args.novel == "none" else names(args.novel, s.NOVEL_VIEWS)
    chosen = s.Settings(
        args.out.rstrip("/"),
        args.work,
        args.seed,
        args.size,
        args.frames,
        args.samples,
        names(args.variants, s.VARIANTS),
        novel,
    )
    chosen.save()
    for stage in names(args.stages, (*STAGES, "labels", "verify")):
        if stage == "verify":
            import verify

            run_blender("markers", args.work)
            run_blender("noise", args.work)
            verify.report(chosen)
        elif stage == "write":
            import write

            write.write(chosen)
        else:
            run_blender(stage, args.work, args.processes if stage == "render" else 1)


if __name__ == "__main__":
    if "--" in sys.argv:
        in_blender(*sys.argv[sys.argv.index("--") + 1 :])
    else:
        main()
