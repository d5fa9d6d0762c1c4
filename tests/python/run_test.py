# SPDX-License-Identifier: Apache-2.0
# redrive.train, redrive.load: the same bits as the command line.
import json
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest

import numpy as np
import redrive

SAMPLES = pathlib.Path(os.environ["REDRIVE_SAMPLES"])
PROGRAM = os.environ["REDRIVE_PROGRAM"]
CAMERA = "F_MIDLONGRANGECAM_CL"
OPTIONS = {"downscale": 4, "max_steps": 60, "truth_poses": True, "holdout_every": 6}


def program(*words):
    return subprocess.run([PROGRAM, *map(str, words)], check=True, capture_output=True, text=True)


def pixels(file):
    """An image's pixels, decoded by FFmpeg."""
    raw = subprocess.run(["ffmpeg", "-v", "error", "-i", file, "-f", "rawvideo", "-pix_fmt",
                          "rgb24", "-"], check=True, capture_output=True).stdout
    return np.frombuffer(raw, np.uint8)


class OfRun(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.kept = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.kept.name)
        cls.path = cls.folder / "run"
        cls.news = []
        cls.ended = redrive.train(
            SAMPLES / "street_traffic", cls.path, progress=cls.news.append, **OPTIONS)
        cls.run_ = redrive.load(cls.path)
        cls.frame = int(cls.run_.frames[12])

    @classmethod
    def tearDownClass(cls):
        cls.kept.cleanup()

    def test_training_has_the_bits_of_the_command_line(self):
        self.assertTrue(self.ended)
        other = self.folder / "other"
        program("train", SAMPLES / "street_traffic", "--out", other, "--downscale", 4,
                "--max-steps", 60, "--truth-poses", "--holdout-every", 6)
        file = "checkpoint.safetensors"
        mine, others = (redrive.load(path) for path in (self.path, other))
        self.assertEqual((mine.step, others.step), (60, 60))
        held_out = mine.frames[::6].tolist()
        self.assertEqual(mine.held_out, {camera: held_out for camera in mine.cameras})
        np.testing.assert_array_equal(mine.render(CAMERA, self.frame).rgb,
                                      others.render(CAMERA, self.frame).rgb)
        # Behind the header, which has the seconds of training: all parameters and moments.
        tensors = []
        for path in (self.path, other):
            data = (path / file).read_bytes()
            tensors.append(data[8 + int.from_bytes(data[:8], "little"):])
        self.assertTrue(tensors[0] == tensors[1])

    def test_progress_is_told(self):
        self.assertGreater(len(self.news), 1)
        steps = [news["step"] for news in self.news]
        self.assertEqual(steps, sorted(steps))
        self.assertTrue(all(0 < news["progress"] <= 1 for news in self.news))
        self.assertTrue(all(news["loss"] > 0 for news in self.news))

    def test_an_image_has_the_bits_of_the_command_line(self):
        out, depth = self.folder / "image.png", self.folder / "depth.png"
        program("render", self.path, "--camera", CAMERA, "--frame", self.frame, "--translate",
                "0.5,1,-0.25", "--yaw", 7, "--pitch", -3, "--out", out, "--depth", depth)
        image = self.run_.render(CAMERA, self.frame, translate=(0.5, 1, -0.25), yaw=7, pitch=-3)
        np.testing.assert_array_equal(image.colour.ravel(), pixels(out))
        raw = subprocess.run(["ffmpeg", "-v", "error", "-i", depth, "-f", "rawvideo", "-pix_fmt",
                              "gray16le", "-"], check=True, capture_output=True).stdout
        in_mm = np.floor(np.clip(np.float32(1000) * image.depth, 0, 65535).astype(float) + 0.5)
        np.testing.assert_array_equal(np.frombuffer(raw, np.uint16), in_mm.ravel())

    def test_poses_are_the_recordings(self):
        pose = self.run_.world_from_camera(CAMERA, self.frame)
        by_frame = self.run_.render(CAMERA, self.frame)
        by_pose = self.run_.render(CAMERA, self.frame, world_from_camera=pose)
        np.testing.assert_allclose(by_pose.rgb, by_frame.rgb, atol=1e-3)
        still = self.run_.render(CAMERA, self.frame, world_from_camera=np.stack([pose] * 3))
        np.testing.assert_allclose(still.rgb, by_pose.rgb, atol=4e-3)  # a Gaussian of alpha 1/255
        for key, wrong in (("yaw", float("nan")), ("edit", [1])):
            with self.assertRaisesRegex(redrive.UsageError, key):
                self.run_.render(CAMERA, self.frame, **{key: wrong})
        turned = pose.copy()
        turned[:3, :3] *= 1.1
        with self.assertRaisesRegex(redrive.UsageError, "orthonormal"):
            self.run_.render(CAMERA, self.frame, world_from_camera=turned)

    def test_any_lens_renders(self):
        recorded = self.run_.cameras[CAMERA]
        copy = redrive.Camera("copy", recorded.model, recorded.width, recorded.height,
                              recorded.intrinsics, recorded.rig_from_camera)
        image = self.run_.render(copy, self.frame, exposure=f"{CAMERA}:{self.frame}")
        np.testing.assert_array_equal(image.rgb, self.run_.render(CAMERA, self.frame).rgb)
        wide = redrive.Camera("wide", "opencv_fisheye", 160, 120,
                              {"fx": 60, "fy": 60, "cx": 79.5, "cy": 59.5},
                              recorded.rig_from_camera)
        image = self.run_.render(wide, self.frame)
        self.assertEqual(image.colour.shape, (120, 160, 3))
        self.assertGreater(image.opacity.max(), 0.9)
        normals = image.normals
        length = np.linalg.norm(normals, axis=2)
        np.testing.assert_allclose(length[length > 0], 1, atol=1e-4)

    def test_traffic_is_edited(self):
        moving = {track.id for track in self.run_.tracks() if track.moves}
        before = self.run_.render(CAMERA, self.frame).rgb
        removed = {"actors": {str(actor): {"remove": True} for actor in moving}}
        by_edit = self.run_.render(CAMERA, self.frame, edit=removed).rgb
        by_actors = self.run_.render(CAMERA, self.frame, actors="none").rgb
        np.testing.assert_array_equal(by_edit, by_actors)
        self.assertGreater(np.abs(before - by_edit).max(), 0.05)
        np.testing.assert_array_equal(before, self.run_.render(CAMERA, self.frame).rgb)
        file = self.folder / "edit.json"
        file.write_text(json.dumps(removed))
        np.testing.assert_array_equal(
            self.run_.render(CAMERA, self.frame, edit=file).rgb, by_edit)
        with self.assertRaises(redrive.InputError) as thrown:
            self.run_.render(CAMERA, self.frame, edit={"actors": {"2": {"remove": 3}}})
        self.assertIn("remove", thrown.exception.field)

    def test_a_scan_has_the_bits_of_the_command_line(self):
        out = self.folder / "scan.bin"
        program("render", "lidar", self.path, "--sensor", "vlp-16", "--mount", "0,0,2,0,0,0",
                "--frame", self.frame, "--out", out)
        scan = self.run_.render_scan(self.frame, sensor="vlp-16", mount="0,0,2,0,0,0")
        written = np.fromfile(out, np.float32).reshape(-1, 4)
        np.testing.assert_array_equal(scan.points, written[:, :3])
        np.testing.assert_array_equal(scan.intensity, written[:, 3])
        np.testing.assert_allclose(np.linalg.norm(scan.points, axis=1), scan.range, rtol=1e-5)
        self.assertGreater(len(scan.lost_directions), 0)

    def test_scores_are_those_of_eval(self):
        written = json.loads(program("eval", self.path, "--json", "--max-images", 2).stdout)
        self.assertEqual(self.run_.evaluate(max_images=2), written)

    def test_unknown_options_are_refused_with_a_suggestion(self):
        with self.assertRaisesRegex(redrive.UsageError, "did you mean max_steps"):
            redrive.train(SAMPLES / "street", self.folder / "x", max_step=5)
        with self.assertRaisesRegex(redrive.UsageError, "--downscale"):
            redrive.train(SAMPLES / "street", self.folder / "x", downscale=1000)
        with self.assertRaisesRegex(redrive.UsageError, "exists"):
            redrive.train(SAMPLES / "street", self.path)
        self.assertFalse((self.folder / "x").exists())

    def test_progress_stops_training(self):
        ended = redrive.train(SAMPLES / "street_traffic", self.folder / "stopped",
                              progress=lambda news: news["step"] < 2, **OPTIONS)
        self.assertFalse(ended)
        self.assertTrue((self.folder / "stopped/checkpoint.safetensors").exists())

        def fails(news):
            raise KeyError("mine")

        with self.assertRaisesRegex(KeyError, "mine"):
            redrive.train(SAMPLES / "street_traffic", self.folder / "failed", progress=fails,
                          **OPTIONS)

    def test_the_lock_is_released(self):
        counts, end = [0], threading.Event()

        def count():
            while not end.is_set():
                counts[0] += 1
                time.sleep(0.0005)

        thread = threading.Thread(target=count)
        thread.start()
        begin = counts[0]
        self.run_.evaluate(max_images=2)
        self.assertGreater(counts[0] - begin, 20)
        end.set()
        thread.join()

    def interrupted(self, code):
        child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True,
                                 stderr=subprocess.PIPE)
        for line in child.stdout:
            if line.startswith("go"):
                break
        time.sleep(0.3)
        child.send_signal(signal.SIGINT)
        out, _ = child.communicate(timeout=60)
        return out

    def test_ctrl_c_ends_training_with_its_state_saved(self):
        out = self.folder / "interrupted"
        text = self.interrupted(
            "import redrive\n"
            "try:\n"
            f"  redrive.train({str(SAMPLES / 'street')!r}, {str(out)!r}, downscale=8,\n"
            "      progress=lambda news: print('go', flush=True))\n"
            "except KeyboardInterrupt: print('interrupted')\n")
        self.assertIn("interrupted", text)
        self.assertTrue((out / "checkpoint.safetensors").exists())

    def test_ctrl_c_ends_other_work(self):
        text = self.interrupted(
            "import redrive\n"
            f"run = redrive.load({str(self.path)!r})\n"
            "print('go', flush=True)\n"
            "try:\n"
            "  while True: run.evaluate(all=True)\n"
            "except KeyboardInterrupt: print('interrupted')\n"
            f"print(run.render({CAMERA!r}, {self.frame}).colour.shape)\n")
        self.assertIn("interrupted", text)
        self.assertIn(", 3)", text)


if __name__ == "__main__":
    unittest.main()
