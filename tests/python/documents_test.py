# SPDX-License-Identifier: Apache-2.0
# What docs/python.md, the notebook and docs/voxels.py show runs as it stands.
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

SAMPLES = pathlib.Path(os.environ["REDRIVE_SAMPLES"])
DOCS = SAMPLES.parent / "docs"


class Documents(unittest.TestCase):
    def setUp(self):
        kept = tempfile.TemporaryDirectory()
        self.addCleanup(kept.cleanup)
        self.addCleanup(os.chdir, os.getcwd())
        os.chdir(kept.name)
        os.symlink(SAMPLES, "samples")

    def run_blocks(self, blocks):
        self.assertGreater(len(blocks), 1)
        names = {}
        for block in blocks:
            with self.subTest(block):
                exec(compile(block, "block", "exec"), names)

    def test_the_page_runs(self):
        text = (DOCS / "python.md").read_text()
        blocks = re.findall(r"(?:^    .*\n|^\n(?=    ))+", text, re.MULTILINE)
        self.run_blocks([re.sub(r"(?m)^    ", "", block) for block in blocks])

    def test_the_notebook_runs(self):
        cells = json.loads((DOCS / "python.ipynb").read_text())["cells"]
        self.assertTrue(all(not cell.get("outputs") for cell in cells))
        self.run_blocks(["".join(c["source"]) for c in cells if c["cell_type"] == "code"])

    def test_voxels_learn(self):
        text = subprocess.run([sys.executable, DOCS / "voxels.py", "samples/street", "100"],
                              capture_output=True, text=True, check=True).stdout
        learnt, constant = map(float, re.findall(r"([\d.]+) dB", text.splitlines()[-1]))
        self.assertGreater(learnt, constant + 2, text)


if __name__ == "__main__":
    unittest.main()
