// SPDX-License-Identifier: Apache-2.0
// The tables of `redrive export --to argoverse2`, read by Arrow's own library:
// node argoverse2_test.mjs REDRIVE SAMPLES NODE_MODULES
// Exit code 77: skipped, npm could not install it.
import assert from "node:assert/strict";
import {execFileSync} from "node:child_process";
import fs from "node:fs";
import {createRequire} from "node:module";
import os from "node:os";
import path from "node:path";
import {skip} from "./browser.mjs";

const [redrive, samples, modules] = process.argv.slice(2);
if (!fs.existsSync(path.join(modules, "apache-arrow")))
  skip("npm could not install apache-arrow when this was built");
const require = createRequire(path.join(path.resolve(modules), "x.js"));
const arrow = require("apache-arrow"), lz4 = require("lz4js");
arrow.compressionRegistry.set(arrow.CompressionType.LZ4_FRAME, {decode: lz4.decompress});
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "redrive-argoverse2-"));
const log = path.join(folder, "log");

function rows(file, types) {
  const table = arrow.tableFromIPC(fs.readFileSync(path.join(log, file)));
  assert.deepEqual(
    Object.fromEntries(table.schema.fields.map(({name, type}) => [name, String(type)])), types);
  return table.toArray();
}
/// Turns a vector by the inverse of a unit quaternion.
function unturned({qw, qx, qy, qz}, [x, y, z]) {
  const [tx, ty, tz] = [z * qy - y * qz, x * qz - z * qx, y * qx - x * qy].map((t) => 2 * t);
  return [x + qw * tx - qy * tz + qz * ty, y + qw * ty - qz * tx + qx * tz,
    z + qw * tz - qx * ty + qy * tx];
}

try {
  execFileSync(redrive, ["export", path.join(samples, "street_traffic"), "--to", "argoverse2", log],
    {stdio: "pipe"});
  const pose = Object.fromEntries(
    ["qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"].map((name) => [name, "Float64"]));
  const poses = rows("city_SE3_egovehicle.feather", {timestamp_ns: "Int64", ...pose});
  const posed = new Set(poses.map((row) => row.timestamp_ns));
  const sensors = rows("calibration/egovehicle_SE3_sensor.feather", {sensor_name: "Utf8", ...pose});
  const cameras = rows("calibration/intrinsics.feather", {sensor_name: "Utf8",
    ...Object.fromEntries(["fx", "fy", "cx", "cy"].map((name) => [`${name}_px`, "Float64"])),
    k1: "Float64", k2: "Float64", k3: "Float64", height_px: "Uint16", width_px: "Uint16"});
  assert.deepEqual(sensors.map((row) => row.sensor_name),
    [...cameras.map((row) => row.sensor_name), "up_lidar"]);
  for (const {sensor_name: name} of cameras) {
    const images = fs.readdirSync(path.join(log, "sensors/cameras", name));
    assert.equal(images.length, 24);
    for (const image of images) assert.ok(posed.has(BigInt(image.replace(".jpg", ""))), image);
  }

  const annotations = rows("annotations.feather", {timestamp_ns: "Int64", track_uuid: "Utf8",
    category: "Utf8", length_m: "Float64", width_m: "Float64", height_m: "Float64", ...pose,
    num_interior_pts: "Int64"});
  assert.ok(annotations.every((row) => row.category === "REGULAR_VEHICLE"));
  assert.equal(new Set(annotations.map((row) => row.track_uuid)).size, 3);
  // Boxes enclose the returns that they count, where the tables have both. Returns lie on the sides of
  // boxes, which move by the margin while the LiDAR passes.
  // Returns lie on the sides of the boxes, which move by that much while the LiDAR passes.
  const margin = 0.02;
  let counted = 0, enclosed = 0;
  for (const sweep of fs.readdirSync(path.join(log, "sensors/lidar"))) {
    const time = BigInt(sweep.replace(".feather", ""));
    assert.ok(posed.has(time), sweep);
    const points = rows(path.join("sensors/lidar", sweep), {x: "Float32", y: "Float32",
      z: "Float32", intensity: "Uint8", laser_number: "Uint8", offset_ns: "Int32"});
    assert.ok(points.length > 1000 && points.every((point) => point.offset_ns >= 0));
    for (const box of annotations.filter((row) => row.timestamp_ns === time)) {
      counted += Number(box.num_interior_pts);
      enclosed += points.filter((point) => {
        const [x, y, z] =
          unturned(box, [point.x - box.tx_m, point.y - box.ty_m, point.z - box.tz_m]);
        return Math.abs(x) <= box.length_m / 2 + margin && Math.abs(y) <= box.width_m / 2 + margin &&
          Math.abs(z) <= box.height_m / 2 + margin;
      }).length;
    }
  }
  assert.ok(counted > 100 && enclosed >= 0.98 * counted && enclosed <= 1.1 * counted,
    `${counted} counted, ${enclosed} enclosed`);
  console.log(`${counted} returns on objects, ${enclosed} enclosed by their boxes`);
} finally {
  fs.rmSync(folder, {recursive: true});
}
