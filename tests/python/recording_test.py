# SPDX-License-Identifier: Apache-2.0
# redrive.open: arrays of the shipped recordings against formulas and against each other.
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import threading
import unittest

import numpy as np
import redrive

SAMPLES = pathlib.Path(os.environ["REDRIVE_SAMPLES"])
CAMERA = "F_MIDLONGRANGECAM_CL"


def transformed(pose, points):
    return points @ pose[:3, :3].T + pose[:3, 3]


class OfRecording(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.street = redrive.open(SAMPLES / "street")
        cls.rolling = redrive.open(SAMPLES / "street_rolling", truth_poses=True)
        cls.traffic = redrive.open(SAMPLES / "street_traffic")

    def test_cameras_have_the_calibration_of_the_file(self):
        file = SAMPLES / "street/sensor/calibration/calibration.json"
        for name, written in json.loads(file.read_text()).items():
            if name not in self.street.cameras:
                continue
            camera = self.street.cameras[name]
            self.assertEqual(camera.name, name)
            self.assertEqual([camera.width, camera.height], written["image_resolution_px"])
            self.assertEqual(
                [camera.intrinsics[k] for k in ("fx", "fy")], written["focal_length_px"]
            )
            self.assertEqual(
                [camera.intrinsics[k] for k in ("cx", "cy")], written["principal_point_px"]
            )
            pose = camera.rig_from_camera
            np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)

    def test_images_are_bytes(self):
        image = self.street.image(CAMERA, int(self.street.frames[0]))
        camera = self.street.cameras[CAMERA]
        self.assertEqual((image.dtype, image.shape), (np.uint8, (camera.height, camera.width, 3)))
        self.assertGreater(image.std(), 10)
        half = redrive.open(SAMPLES / "street", downscale=2).image(CAMERA, self.street.frames[0])
        mean = image.reshape(camera.height // 2, 2, camera.width // 2, 2, 3).mean(axis=(1, 3))
        self.assertLessEqual(np.abs(half - mean).max(), 0.5)

    def test_lenses_undo_themselves(self):
        for recording in (self.street, self.rolling):
            for camera in recording.cameras.values():
                size = [camera.width, camera.height]
                pixels = np.random.default_rng(1).uniform(0, size, (99, 2))
                rays = camera.unproject(pixels)
                seen = np.isfinite(rays[:, 0])
                self.assertGreater(seen.mean(), 0.3)
                np.testing.assert_allclose(np.linalg.norm(rays[seen], axis=1), 1, rtol=1e-12)
                np.testing.assert_allclose(
                    camera.project(7 * rays[seen]), pixels[seen], atol=1e-5
                )
                behind = camera.project([0, 0, -1])
                self.assertTrue(np.isnan(behind).all() or camera.model == "mei")

    def test_a_camera_of_ones_own_is_a_pinhole(self):
        camera = redrive.Camera(
            "own", "opencv_pinhole", 80, 60, {"fx": 50, "fy": 40, "cx": 39.5, "cy": 29.5}
        )
        np.testing.assert_allclose(camera.project([[1, 2, 4]]), [[39.5 + 12.5, 29.5 + 20]])
        with self.assertRaises(redrive.UsageError) as thrown:
            redrive.Camera("own", "opencv_pinhole", 80, 60, {"fx": 1, "fy": 1, "cx": 1, "xy": 1})
        self.assertEqual(thrown.exception.value, "xy")

    def test_rays_pass_through_their_pixels(self):
        for recording in (self.street, self.rolling):
            name, camera = next(iter(recording.cameras.items()))
            frame = int(recording.frames[5])
            rays = recording.rays(name, frame)
            shape = (camera.height, camera.width)
            self.assertEqual(rays.origins.shape, shape + (3,))
            self.assertEqual(rays.directions.shape, shape + (3,))
            self.assertEqual(rays.times_ns.dtype, np.int64)
            rows = np.array([0, camera.height // 3, camera.height - 1])
            poses = recording.world_from_camera(name, frame, row=rows)
            for y, pose in zip(rows, poses):
                x = np.arange(0, camera.width, 7)
                in_camera = camera.unproject(np.stack([x, np.full_like(x, y)], axis=1))
                valid = rays.valid[y, x]
                self.assertEqual(valid.tolist(), np.isfinite(in_camera[:, 0]).tolist())
                np.testing.assert_allclose(
                    rays.directions[y, x][valid], in_camera[valid] @ pose[:3, :3].T, atol=1e-6
                )
                np.testing.assert_allclose(rays.origins[y, x], pose[None, :3, 3].repeat(
                    len(x), 0), atol=1e-5)

    def test_rows_of_a_rolling_shutter_have_their_times(self):
        name, camera = next(iter(self.rolling.cameras.items()))
        self.assertNotEqual(camera.readout_ns, 0)
        frame = int(self.rolling.frames[5])
        times = self.rolling.rays(name, frame).times_ns
        middle = self.rolling.times_ns[5] + camera.time_offset_ns
        y = np.arange(camera.height)
        late = ((y + 0.5) / camera.height - 0.5) * camera.readout_ns
        np.testing.assert_allclose(times[:, 0] - middle, late, atol=1)
        for row in (0, camera.height - 1):
            at = self.rolling.world_from_body(times[row, 0]) @ camera.rig_from_camera
            np.testing.assert_allclose(
                self.rolling.world_from_camera(name, frame, row=row), at, atol=1e-6
            )
            np.testing.assert_allclose(
                self.rolling.world_from_camera(name, time_ns=middle, row=row), at, atol=1e-9
            )

    def test_columns_of_a_rolling_shutter_have_their_times(self):
        with tempfile.TemporaryDirectory() as folder:
            drive = pathlib.Path(folder) / "drive"
            shutil.copytree(SAMPLES / "street_rolling", drive)
            file = drive / "sensor/calibration/calibration.json"
            cameras = json.loads(file.read_text())
            name = next(iter(self.rolling.cameras))
            cameras[name]["readout_by_column"] = True
            file.write_text(json.dumps(cameras))
            rolling = redrive.open(drive, truth_poses=False)
            camera = rolling.cameras[name]
            self.assertTrue(camera.readout_by_column)
            frame = int(rolling.frames[5])
            rays = rolling.rays(name, frame)
            self.assertEqual(rays.times_ns.shape, (camera.height, camera.width))
            self.assertEqual(rays.origins.shape, (camera.height, camera.width, 3))
            x = np.arange(camera.width)
            middle = rolling.times_ns[5] + camera.time_offset_ns
            late = ((x + 0.5) / camera.width - 0.5) * camera.readout_ns
            np.testing.assert_allclose(rays.times_ns[7] - middle, late, atol=1)
            np.testing.assert_array_equal(rays.times_ns[0], rays.times_ns[-1])
            for column in (0, camera.width - 1):
                at = rolling.world_from_camera(name, frame, row=column)
                np.testing.assert_allclose(rays.origins[3, column], at[:3, 3], atol=1e-5)
                seen = rolling.world_from_body(rays.times_ns[0, column]) @ camera.rig_from_camera
                np.testing.assert_allclose(seen, at, atol=1e-6)

    def test_the_world_has_the_axes_of_the_first_frame(self):
        np.testing.assert_allclose(
            self.street.world_from_body(self.street.times_ns[0]), np.eye(4), atol=1e-8
        )
        several = self.street.world_from_body(self.street.times_ns[:3])
        self.assertEqual(several.shape, (3, 4, 4))
        half = (several[0, :3, 3] + several[1, :3, 3]) / 2
        middle = self.street.world_from_body(self.street.times_ns[:2].mean())
        np.testing.assert_allclose(middle[:3, 3], half, atol=1e-5)

    def test_scans_have_the_same_points_in_all_axes(self):
        frame = int(self.street.lidar_frames[3])
        scans = [self.street.scan(frame, axes) for axes in ("sensor", "body", "world")]
        sensor, body, world = scans
        self.assertGreater(len(sensor), 1000)
        self.assertEqual(sensor.points.dtype, np.float32)
        self.assertTrue(0 <= sensor.intensity.min() <= sensor.intensity.max() <= 1)
        np.testing.assert_allclose(
            transformed(self.street.body_from_lidar, sensor.points), body.points, atol=2e-5
        )
        for i in range(0, len(body), 997):
            pose = self.street.world_from_body(body.times_ns[i])
            np.testing.assert_allclose(
                transformed(pose, body.points[i]), world.points[i], atol=2e-5
            )

    def test_lost_rays_are_no_returns(self):
        scan = self.street.scan(int(self.street.lidar_frames[3]), lost=True)
        self.assertEqual(scan.why_unknown, "")
        self.assertEqual(scan.lost_directions.shape, (len(scan.lost_times_ns), 3))
        norms = np.linalg.norm(scan.lost_directions, axis=1)
        np.testing.assert_allclose(norms, 1, atol=1e-5)
        self.assertIsNone(self.street.scan(int(self.street.lidar_frames[3])).lost_directions)

    def test_boxes_lie_on_their_tracks(self):
        tracks = {track.id: track for track in self.traffic.tracks()}
        self.assertTrue(any(track.moves for track in tracks.values()))
        frame = int(self.traffic.box_frames[4])
        boxes = self.traffic.boxes(frame)
        self.assertGreater(len(boxes), 0)
        for box in boxes:
            pose = self.traffic.world_from_body(box.time_ns)
            np.testing.assert_allclose(box.world_from_box, pose @ box.body_from_box, atol=1e-9)
            track = tracks[box.id]
            key = track.times_ns.tolist().index(box.time_ns)
            np.testing.assert_allclose(track.world_from_box[key], box.world_from_box, atol=1e-6)
            np.testing.assert_allclose(track.at(box.time_ns), box.world_from_box, atol=1e-6)
        self.assertIsNone(track.at(10**18))

    def test_masks_leave_moving_objects_out(self):
        frame = int(self.traffic.frames[10])
        name = next(iter(self.traffic.cameras))
        everything = self.traffic.mask(name, frame, moving=False)
        static = self.traffic.mask(name, frame)
        self.assertEqual((static.dtype, everything.all()), (np.bool_, True))
        self.assertTrue(0 < (~static).sum() < static.size / 2)

    def test_errors_name_what_is_wrong(self):
        with self.assertRaises(redrive.InputError) as thrown:
            redrive.open("/no/such/folder")
        self.assertEqual(thrown.exception.file, "/no/such/folder")
        with tempfile.TemporaryDirectory() as folder:
            broken = pathlib.Path(folder) / "street"
            shutil.copytree(SAMPLES / "street", broken)
            file = broken / "sensor/calibration/calibration.json"
            file.chmod(0o644)
            calibration = json.loads(file.read_text())
            calibration[CAMERA]["focal_length_px"][0] = -3
            file.write_text(json.dumps(calibration))
            with self.assertRaises(redrive.InputError) as thrown:
                redrive.open(broken)
        error = thrown.exception
        self.assertTrue(error.file.endswith("calibration.json"))
        self.assertIn("focal_length_px", error.field)
        self.assertEqual(error.value, "-3")
        self.assertIn(error.rule, str(error))
        self.assertIsInstance(error, (redrive.Error, ValueError))
        for call in (lambda: self.street.image("F_MIDLONG", 1000),
                     lambda: self.street.image(CAMERA, 5),
                     lambda: self.street.scan(1000, axes="lidar"),
                     lambda: self.street.world_from_camera(CAMERA)):
            self.assertRaises(redrive.UsageError, call)
        with self.assertRaisesRegex(redrive.UsageError, "did you mean " + CAMERA):
            self.street.image(CAMERA[:-1], 1000)
        with self.assertRaisesRegex(redrive.UsageError, "at most a second before"):
            self.street.world_from_body(0)

    def test_cameras_that_cannot_be(self):
        sizes = {"fx": 500, "fy": 500, "cx": 320, "cy": 240}
        for changed, named in (({"fx": 0}, "fx = 0"), ({"fy": float("nan")}, "fy = nan"),
                               ({"cx": 1e300}, "cx"), ({"k1": float("inf")}, "k1 = inf")):
            with self.assertRaisesRegex(redrive.UsageError, named):
                redrive.Camera("own", "opencv_pinhole", 640, 480, {**sizes, **changed})
        with self.assertRaisesRegex(redrive.UsageError, "readout_ns"):
            redrive.Camera("own", "opencv_pinhole", 640, 480, sizes, readout_ns=10**18)

    def test_exports_a_drive(self):
        with tempfile.TemporaryDirectory() as folder:
            out = pathlib.Path(folder) / "log"
            remarks = self.street.export(out, to="argoverse2")
            self.assertTrue(any("resampled" in remark for remark in remarks), remarks)
            again = redrive.open(out)
            self.assertEqual(len(again.frames), len(self.street.frames))
            with self.assertRaisesRegex(redrive.UsageError, "exists"):
                self.street.export(out, to="argoverse2")
            with self.assertRaisesRegex(redrive.UsageError, "did you mean nuscenes"):
                self.street.export(out, to="nuscene", force=True)

    def test_arrays_outlive_the_recording(self):
        recording = redrive.open(SAMPLES / "street")
        rays, image = recording.rays(CAMERA, 1000), recording.image(CAMERA, 1000)
        scan = recording.scan(int(recording.lidar_frames[0]))
        points, total = scan.points, scan.points.sum()
        del recording, scan
        self.assertEqual(points.sum(), total)
        self.assertFalse(points.flags.writeable or rays.origins.flags.writeable)
        self.assertTrue(image.flags.writeable and image.flags.c_contiguous)
        self.assertAlmostEqual(float((rays.directions[5, 5] ** 2).sum()), 1, 5)

    def test_threads_work_at_the_same_time(self):
        frames = [int(frame) for frame in self.street.frames[:8]]
        alone = [self.street.rays(CAMERA, frame).directions.sum() for frame in frames]
        images = [self.street.image(CAMERA, frame).sum() for frame in frames]
        found = {}

        def work(i):
            found[i] = (self.street.rays(CAMERA, frames[i]).directions.sum(),
                        self.street.image(CAMERA, frames[i]).sum())

        threads = [threading.Thread(target=work, args=(i,)) for i in range(len(frames))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual([found[i] for i in range(len(frames))], list(zip(alone, images)))

    def test_help_begins_with_the_axes(self):
        text = subprocess.run([sys.executable, "-c", "import redrive; help(redrive)"],
                              capture_output=True, text=True, check=True).stdout
        for word in ("a_from_b", "class Recording", "image(", "[height, width, 3] uint8"):
            self.assertIn(word, text)


if __name__ == "__main__":
    unittest.main()
