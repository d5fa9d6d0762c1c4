#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Times `redrive inspect` on made recordings of 10,000 frames whose images are tiny.

    bench/listing.py build/release/redrive FOLDER [FRAMES]

Writes FOLDER/aimotive, FOLDER/kitti, FOLDER/nuscenes and FOLDER/bag unless they are there. Each has
all its cameras: four, two, six and five. The bag, an MCAP, has 50 GB of images and scans as holes
of a sparse file. Prints the median of five runs.
"""
import json
import math
import pathlib
import random
import statistics
import struct
import subprocess
import sys
import time
import zlib

WIDTH, HEIGHT = 64, 36


def png():
    """An image like no other."""
    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    rows = b"\0" + random.randbytes(3 * WIDTH) + (b"\0" + b"\x40\x60\x80" * WIDTH) * (HEIGHT - 1)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", WIDTH, HEIGHT, 8, 2, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


def write_aimotive(root, frames):
    camera = {"sensor_type": "camera", "model": "opencv_pinhole",
              "RT_body_from_sensor": [[0, 0, 1, 2], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]],
              "focal_length_px": [50, 50], "principal_point_px": [32, 18],
              "distortion_coeffs": [0] * 5, "image_resolution_px": [WIDTH, HEIGHT]}
    names = ["FRONT", "LEFT", "RIGHT", "BACK"]
    write(root / "sensor/calibration/calibration.json", json.dumps({name: camera for name in names}))
    write(root / "sensor/gnssins/egomotion2.json", json.dumps({
        str(f): {"RT_ECEF_body": [[1, 0, 0, 4e6 + f], [0, 1, 0, 1.4e6], [0, 0, 1, 4.6e6], [0, 0, 0, 1]],
                 "time_host": 50 + 0.1 * f} for f in range(frames)}))
    for name in names:
        for f in range(frames):
            write(root / f"sensor/camera/{name}/{name}_{f:07}.png", png())


def write_kitti(drive, frames):
    day = drive.parent
    write(day / "calib_cam_to_cam.txt", "R_rect_00: 1 0 0 0 1 0 0 0 1\n" + "".join(
        f"S_rect_0{c}: {WIDTH} {HEIGHT}\nP_rect_0{c}: 50 0 32 {-27 * (c - 2)} 0 50 18 0 0 0 1 0\n"
        for c in (2, 3)))
    write(day / "calib_velo_to_cam.txt", "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.25\n")
    write(day / "calib_imu_to_velo.txt", "R: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.8\n")

    def times(first_s):
        stamps = [first_s + 0.1 * f for f in range(frames)]
        return "".join("2011-09-26 %02d:%02d:%012.9f\n" % (13 + s // 3600, s // 60 % 60, s % 60)
                       for s in stamps)

    for sensor, first_s in (("oxts", 1.01), ("image_02", 1.0), ("image_03", 1.0)):
        write(drive / sensor / "timestamps.txt", times(first_s))
    write(drive / "velodyne_points/timestamps_start.txt", times(0.95))
    write(drive / "velodyne_points/timestamps_end.txt", times(1.05))
    for f in range(frames):
        north = 49 + math.degrees(f / 6.372e6)
        write(drive / f"oxts/data/{f:010}.txt", f"{north:.15f} 8 110 0 0 1.57" + " 0.5" * 24 + "\n")
        for camera in ("image_02", "image_03"):
            write(drive / camera / f"data/{f:010}.png", png())
        write(drive / f"velodyne_points/data/{f:010}.bin", struct.pack("<4f", 9, 0, 0, 0.5))


def write_nuscenes(root, frames):
    tables = {name: [] for name in ("scene", "sample", "sample_data", "calibrated_sensor", "sensor",
                                    "ego_pose", "sample_annotation", "instance", "category")}
    first_us = 1_532_402_927_000_000

    def token(kind, *numbers):
        return f"{kind}{'-'.join(map(str, numbers))}".ljust(32, "f")

    cameras = ["CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK",
               "CAM_BACK_LEFT"]
    channels = cameras + ["LIDAR_TOP"]
    for c, channel in enumerate(channels):
        camera = channel in cameras
        tables["sensor"].append({"token": token("s", c), "channel": channel,
                                 "modality": "camera" if camera else "lidar"})
        tables["calibrated_sensor"].append({
            "token": token("k", c), "sensor_token": token("s", c), "translation": [1, 0, 1.5],
            "rotation": [0.5, -0.5, 0.5, -0.5] if camera else [1, 0, 0, 0],
            "camera_intrinsic": [[50, 0, 32], [0, 50, 18], [0, 0, 1]] if camera else []})
    tables["scene"].append({"token": token("t"), "name": "scene-0001"})
    tables["category"].append({"token": token("c"), "name": "vehicle.car"})

    def add_file(channel, sample, t_us, key_frame):
        name = f"{'samples' if key_frame else 'sweeps'}/{channel}/{channel}__{t_us}"
        name += ".png" if channel in cameras else ".pcd.bin"
        number = len(tables["sample_data"])
        tables["sample_data"].append({
            "token": token("d", number), "sample_token": token("a", sample),
            "ego_pose_token": token("p", number),
            "calibrated_sensor_token": token("k", channels.index(channel)),
            "timestamp": first_us + t_us, "fileformat": "jpg", "is_key_frame": key_frame,
            "height": HEIGHT, "width": WIDTH, "filename": name, "prev": "", "next": ""})
        tables["ego_pose"].append({
            "token": token("p", number), "timestamp": first_us + t_us,
            "rotation": [0.5720320396729045, -0.0016977771610471074, 0.011798001930183783,
                         -0.8201446642457809],
            "translation": [411.3039349319818 + 1e-5 * t_us, 1180.8903791765097, 0.0]})
        write(root / name, png() if channel in cameras else struct.pack("<5f", 0, 9, 0, 50, 31))

    samples = (frames + 5) // 6
    for s in range(samples):
        start_us = 500_000 * s
        tables["sample"].append({"token": token("a", s), "timestamp": first_us + start_us + 43_000,
                                 "scene_token": token("t"), "prev": "", "next": ""})
        for i, later_us in enumerate((0, 100_000, 150_000, 250_000, 350_000, 400_000)):
            for c, channel in enumerate(cameras):
                add_file(channel, s, start_us + later_us + 8_000 * c, i == 0)
        for revolution in range(10):
            add_file("LIDAR_TOP", s, start_us + 50_000 * revolution + 43_000, revolution == 0)
        for o in range(20):
            life = s // 40  # an object is seen for 20 s
            if s % 40 == 0:
                tables["instance"].append({"token": token("i", life, o), "category_token": token("c")})
            tables["sample_annotation"].append({
                "token": token("b", s, o), "sample_token": token("a", s),
                "instance_token": token("i", life, o),
                "translation": [420 + 5.0 * s + 3 * o, 1180.0 + o, 1.0], "size": [1.9, 4.5, 1.6],
                "rotation": [1, 0, 0, 0]})
    for name, records in tables.items():
        write(root / f"v1.0-mini/{name}.json", json.dumps(records, indent=0))


class Cdr:
    """The bytes of a ROS 2 message, little-endian."""

    def __init__(self):
        self.bytes = bytearray(b"\0\1\0\0")

    def add(self, kind, *values):
        size = struct.calcsize(kind)
        for value in values:
            self.bytes += bytes(-(len(self.bytes) - 4) % size) + struct.pack("<" + kind, value)
        return self

    def text(self, text):
        self.add("I", len(text) + 1)
        self.bytes += text.encode() + b"\0"
        return self

    def header(self, t_ns, frame):
        return self.add("i", t_ns // 10**9).add("I", t_ns % 10**9).text(frame)


class Mcap:
    """A file in chunks of 4 MB without compression and CRC; holes stand for what nobody reads."""

    def __init__(self, path):
        path.parent.mkdir(parents=True)
        self.file = open(path, "wb")
        self.file.write(b"\x89MCAP0\r\n")
        self.record(1, self.text("ros2") + self.text(""))
        self.channels, self.chunks, self.messages = [], [], 0
        self.parts, self.size, self.index = [], 0, {}

    @staticmethod
    def text(text):
        return struct.pack("<I", len(text)) + text.encode()

    def record(self, opcode, content):
        self.file.write(struct.pack("<BQ", opcode, len(content)) + content)

    def channel(self, topic, kind):
        number = len(self.channels) + 1
        schema = struct.pack("<H", number) + self.text(kind) + self.text("") + self.text("")
        self.channels.append(((3, schema), (4, struct.pack("<HH", number, number) + self.text(topic)
                                            + self.text("cdr") + self.text(""))))
        return number

    def message(self, channel, t_ns, head, hole=0, tail=b""):
        """`hole`: bytes between `head` and `tail`."""
        self.index.setdefault(channel, []).append((t_ns, self.size))
        length = 22 + len(head) + hole + len(tail)
        start = struct.pack("<BQHIQQ", 5, length, channel, 0, t_ns, t_ns) + head
        self.parts.append((start, hole, tail))
        self.size += len(start) + hole + len(tail)
        self.messages += 1
        if self.size > 4_000_000:
            self.end_chunk()

    def end_chunk(self):
        if not self.size:
            return
        start = self.file.tell()
        length = 8 + 8 + 8 + 4 + 4 + 8 + self.size
        self.file.write(struct.pack("<BQQQQIIQ", 6, length, 0, 0, self.size, 0, 0, self.size))
        for head, hole, tail in self.parts:
            self.file.write(head)
            self.file.seek(hole, 1)
            self.file.write(tail)
        offsets, index_start = {}, self.file.tell()
        for channel, entries in self.index.items():
            offsets[channel] = self.file.tell()
            packed = b"".join(struct.pack("<QQ", *entry) for entry in entries)
            self.record(7, struct.pack("<HI", channel, len(packed)) + packed)
        packed = b"".join(struct.pack("<HQ", *item) for item in offsets.items())
        self.chunks.append(struct.pack("<QQQQI", 0, 0, start, 9 + length, len(packed)) + packed
                           + struct.pack("<Q", self.file.tell() - index_start) + self.text("")
                           + struct.pack("<QQ", self.size, self.size))
        self.parts, self.size, self.index = [], 0, {}

    def finish(self):
        self.end_chunk()
        self.record(15, struct.pack("<I", 0))
        start = self.file.tell()
        for schema, channel in self.channels:
            self.record(*schema)
            self.record(*channel)
        for chunk in self.chunks:
            self.record(8, chunk)
        self.record(11, struct.pack("<QHIIIIQQI", self.messages, len(self.channels),
                                    len(self.channels), 0, 0, len(self.chunks), 0, 0, 0))
        self.record(2, struct.pack("<QQI", start, 0, 0))
        self.file.write(b"\x89MCAP0\r\n")
        self.file.close()


def write_bag(root, frames, total_bytes=50 * 10**9):
    bag = Mcap(root / "drive.mcap")
    cameras = ["front", "left", "right", "rear", "top"]
    hole = total_bytes // (frames * (len(cameras) + 1))
    side = int(math.sqrt(hole / 3))
    images = [bag.channel(f"/{c}/image_raw", "sensor_msgs/msg/Image") for c in cameras]
    infos = [bag.channel(f"/{c}/camera_info", "sensor_msgs/msg/CameraInfo") for c in cameras]
    scans = bag.channel("/lidar/points", "sensor_msgs/msg/PointCloud2")
    tf, tf_static = (bag.channel(name, "tf2_msgs/msg/TFMessage") for name in ("/tf", "/tf_static"))

    def transforms(t_ns, links):
        out = Cdr().add("I", len(links))
        for parent, child, place, turn in links:
            out.header(t_ns, parent).text(child).add("d", *place, *turn)
        return bytes(out.bytes)

    ahead = [-0.5, 0.5, -0.5, 0.5]
    bag.message(tf_static, 10**18, transforms(10**18, [
        ("base_link", c, [1.5, 0.1 * i, 1.4], ahead) for i, c in enumerate(cameras)] + [
        ("base_link", "lidar", [1, 0, 1.8], [0, 0, 0, 1])]))
    for f in range(frames):
        t_ns = 10**18 + 10**8 * f
        for _ in range(5):
            place = [8e-9 * (t_ns - 10**18), 0, 0]
            bag.message(tf, t_ns, transforms(t_ns, [("map", "base_link", place, [0, 0, 0, 1])]))
            t_ns += 2 * 10**7
        t_ns -= 10**8
        for camera, image, info in zip(cameras, images, infos):
            head = Cdr().header(t_ns, camera).add("I", side, side).text("rgb8").add("B", 0)
            head.add("I", 3 * side, 3 * side * side)
            ends = random.randbytes(64)  # no two images are alike
            bag.message(image, t_ns, bytes(head.bytes) + ends, 3 * side * side - 128, ends)
            out = Cdr().header(t_ns, camera).add("I", side, side).text("plumb_bob").add("I", 5)
            out.add("d", *[0] * 5, side, 0, side / 2, 0, side, side / 2, 0, 0, 1, *[0] * 21)
            bag.message(info, t_ns, bytes(out.add("I", *[0] * 6).add("B", 0).bytes))
        points = hole // 32
        head = Cdr().header(t_ns, "lidar").add("I", 1, points, 4)
        for i, name in enumerate(("x", "y", "z", "intensity")):
            head.text(name).add("I", 4 * i).add("B", 7).add("I", 1)
        head.add("B", 0).add("I", 32, 32 * points, 32 * points)
        bag.message(scans, t_ns, bytes(head.bytes), 32 * points + 1)
    bag.finish()


def main():
    program, folder = sys.argv[1], pathlib.Path(sys.argv[2])
    frames = int(sys.argv[3]) if len(sys.argv) > 3 else 10_000
    recordings = {
        folder / "aimotive": write_aimotive,
        folder / "kitti/2011_09_26_drive_0001_sync": write_kitti,
        folder / "nuscenes": write_nuscenes,
        folder / "bag": write_bag,
    }
    for recording, make in recordings.items():
        if not recording.exists():
            make(recording, frames)
        seconds = []
        for _ in range(5):
            start = time.perf_counter()
            done = subprocess.run([program, "inspect", recording, "--json"], capture_output=True)
            seconds.append(time.perf_counter() - start)
        if done.returncode != 0:
            sys.exit(done.stderr.decode() + done.stdout.decode()[-2000:])
        found = json.loads(done.stdout)
        images = sum(camera["images"] for camera in found["cameras"])
        print(f"{found['format']:10} {found['frames']['count']} frames, {images} images, "
              f"{found['lidar_files']} revolutions: {statistics.median(seconds):.2f} s")


main()
