// SPDX-License-Identifier: Apache-2.0
// A bag of ROS 2 that other programs write: messages by @foxglove/rosmsg2-serialization, the file by
// @mcap/core, with what samples/street recorded. Usage: rosbag_test.mjs REDRIVE SAMPLES NODE_MODULES
// [FOLDER]; the bag stays in FOLDER, which must not exist.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import fs from 'node:fs';
import { createRequire } from 'node:module';
import os from 'node:os';
import path from 'node:path';

const [redrive, samples, modules, kept] = process.argv.slice(2);
const require = createRequire(path.join(path.resolve(modules), 'from.js'));
let mcap, rosmsg, serialization;
try {
  mcap = require('@mcap/core');
  rosmsg = require('@foxglove/rosmsg');
  serialization = require('@foxglove/rosmsg2-serialization');
} catch {
  console.log('skipped: npm could not install @mcap/core when this was built');
  process.exit(77);
}

const line = '='.repeat(80);
const header = `${line}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
${line}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
`;
const definitions = {
  'sensor_msgs/msg/CompressedImage':
    `std_msgs/Header header\nstring format\nuint8[] data\n${header}`,
  'sensor_msgs/msg/CameraInfo': `std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
RegionOfInterest roi
${header}${line}
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
`,
  'sensor_msgs/msg/PointCloud2': `std_msgs/Header header
uint32 height
uint32 width
PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
${header}${line}
MSG: sensor_msgs/PointField
uint8 INT8=1
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
`,
  'tf2_msgs/msg/TFMessage': `geometry_msgs/TransformStamped[] transforms
${line}
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
Transform transform
${header}${line}
MSG: geometry_msgs/Transform
Vector3 translation
Quaternion rotation
${line}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
${line}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
`,
};

const street = path.join(samples, 'street');
const json = (file) => JSON.parse(fs.readFileSync(path.join(street, file), 'utf8'));
const calibration = json('sensor/calibration/calibration_true.json');
const egomotion = json('sensor/gnssins/egomotion2_true.json');
const cameras = Object.entries(calibration).filter(([, c]) => c.model === 'opencv_pinhole');
const [[, lidar]] = Object.entries(calibration).filter(([, c]) => c.sensor_type === 'lidar');

const times = (a, b) =>
  a.map((row) => b[0].map((_, j) => row.reduce((sum, x, k) => sum + x * b[k][j], 0)));
function inverse(pose) {
  const r = [0, 1, 2].map((i) => [0, 1, 2].map((j) => pose[j][i]));
  const t = r.map((row) => -row.reduce((sum, x, k) => sum + x * pose[k][3], 0));
  return [...r.map((row, i) => [...row, t[i]]), [0, 0, 0, 1]];
}
/// A rotation matrix as a quaternion, by the largest of its four squares.
function quaternion(m) {
  const s = [1, 1, -1, -1, 1, -1, 1, -1, 1, -1, -1, 1];
  const q = [0, 1, 2, 3].map((i) =>
    Math.sqrt(Math.max(0, 1 + s[i] * m[0][0] + s[4 + i] * m[1][1] + s[8 + i] * m[2][2])) / 2);
  const [w, x, y, z] = [
    [1, m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]],
    [m[2][1] - m[1][2], 1, m[0][1] + m[1][0], m[0][2] + m[2][0]],
    [m[0][2] - m[2][0], m[0][1] + m[1][0], 1, m[1][2] + m[2][1]],
    [m[1][0] - m[0][1], m[0][2] + m[2][0], m[1][2] + m[2][1], 1],
  ][q.indexOf(Math.max(...q))].map((sign, i) => (sign < 0 ? -q[i] : q[i]));
  return { x, y, z, w };
}
const stamp = (ns) => ({ sec: Math.floor(ns / 1e9), nanosec: Math.round(ns % 1e9) });
function transform(ns, parent, child, pose) {
  const [x, y, z] = [0, 1, 2].map((i) => pose[i][3]);
  return {
    header: { stamp: stamp(ns), frame_id: parent },
    child_frame_id: child,
    transform: { translation: { x, y, z }, rotation: quaternion(pose) },
  };
}

/// The points of an uncompressed LAS file of format 1 in the LiDAR's axes, with times.
function scan(file) {
  const las = fs.readFileSync(file);
  const [offset, length, n] = [las.readUInt32LE(96), las.readUInt16LE(105), las.readUInt32LE(107)];
  const scale = las.readDoubleLE(131);
  const lidarFromBody = inverse(lidar.RT_body_from_sensor);
  const points = [];
  for (let i = 0; i < n; ++i) {
    const at = offset + i * length;
    const p = [[0], [4], [8]].map(([k]) => [las.readInt32LE(at + k) * scale]);
    const [x, y, z] = times(lidarFromBody, [...p, [1]]).map((row) => row[0]);
    points.push({ x, y, z, i: las.readUInt16LE(at + 12), ns: las.readDoubleLE(at + 20) });
  }
  return points;
}

async function write(file) {
  const chunks = [];
  let size = 0n;
  const writer = new mcap.McapWriter({
    writable: {
      position: () => size,
      write: async (bytes) => {
        chunks.push(Buffer.from(bytes));
        size += BigInt(bytes.byteLength);
      },
    },
    chunkSize: 1 << 18,
  });
  await writer.start({ profile: 'ros2', library: 'test' });
  const channels = new Map();
  async function add(topic, type, ns, message) {
    if (!channels.has(topic)) {
      const schemaId = await writer.registerSchema({
        name: type, encoding: 'ros2msg', data: new TextEncoder().encode(definitions[type]) });
      const id = await writer.registerChannel({
        schemaId, topic, messageEncoding: 'cdr', metadata: new Map() });
      const parsed = rosmsg.parse(definitions[type], { ros2: true });
      channels.set(topic, { id, to: new serialization.MessageWriter(parsed), sequence: 0 });
    }
    const channel = channels.get(topic);
    const t = BigInt(Math.round(ns + 2e6));
    await writer.addMessage({ channelId: channel.id, sequence: channel.sequence++, logTime: t,
      publishTime: t, data: channel.to.writeMessage(message) });
  }

  const first = inverse(Object.values(egomotion)[0].RT_ECEF_body);
  await add('/tf_static', 'tf2_msgs/msg/TFMessage', 4e12, {
    transforms: [
      ...cameras.map(([name, c]) => transform(0, 'base_link', `${name}_optical`,
        c.RT_body_from_sensor)),
      transform(0, 'base_link', 'lidar', lidar.RT_body_from_sensor)],
  });
  for (const [id, pose] of Object.entries(egomotion)) {
    const ns = Math.round(pose.time_host * 1e9);
    await add('/tf', 'tf2_msgs/msg/TFMessage', ns,
      { transforms: [transform(ns, 'map', 'base_link', times(first, pose.RT_ECEF_body))] });
    for (const [name, c] of cameras) {
      const t = ns + Math.round(1e9 * (c.time_offset_s ?? 0));
      const head = { stamp: stamp(t), frame_id: `${name}_optical` };
      const [[fx, fy], [cx, cy]] = [c.focal_length_px, c.principal_point_px];
      await add(`/${name}/camera_info`, 'sensor_msgs/msg/CameraInfo', t, {
        header: head, width: c.image_resolution_px[0], height: c.image_resolution_px[1],
        distortion_model: 'plumb_bob', d: c.distortion_coeffs,
        k: [fx, 0, cx, 0, fy, cy, 0, 0, 1], r: [1, 0, 0, 0, 1, 0, 0, 0, 1],
        p: [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0], binning_x: 0, binning_y: 0,
        roi: { x_offset: 0, y_offset: 0, width: 0, height: 0, do_rectify: false } });
      const image = `sensor/camera/${name}/${name}_${id.padStart(7, '0')}.jpg`;
      await add(`/${name}/image_raw/compressed`, 'sensor_msgs/msg/CompressedImage', t,
        { header: head, format: 'jpeg', data: fs.readFileSync(path.join(street, image)) });
    }
    const points = scan(path.join(street, `dynamic/raw-revolutions/frame_${id.padStart(7, '0')}.las`));
    const start = Math.min(...points.map((p) => p.ns));
    const step = 18, data = Buffer.alloc(points.length * step);
    points.forEach((p, i) => {
      [p.x, p.y, p.z].forEach((x, k) => data.writeFloatLE(x, i * step + 4 * k));
      data.writeUInt16LE(p.i, i * step + 12);
      data.writeUInt32LE(p.ns - start, i * step + 14);
    });
    const field = (name, offset, datatype) => ({ name, offset, datatype, count: 1 });
    await add('/lidar/points', 'sensor_msgs/msg/PointCloud2', start + 1e8, {
      header: { stamp: stamp(start), frame_id: 'lidar' }, height: 1, width: points.length,
      fields: [field('x', 0, 7), field('y', 4, 7), field('z', 8, 7), field('intensity', 12, 4),
        field('t', 14, 6)],
      is_bigendian: false, point_step: step, row_step: data.length, data, is_dense: true });
  }
  await writer.end();
  fs.writeFileSync(file, Buffer.concat(chunks));
}

const folder = kept ?? fs.mkdtempSync(path.join(os.tmpdir(), 'redrive-bag-'));
fs.mkdirSync(folder, { recursive: true });
await write(path.join(folder, 'street_0.mcap'));
const inspect = (...options) =>
  JSON.parse(execFileSync(redrive, ['inspect', folder, '--json', ...options], { encoding: 'utf8' }));
const seen = inspect('--write-rig');
assert.equal(seen.format, 'rosbag');
assert.deepEqual(seen.mapping.questions, []);
assert.deepEqual(seen.problems, []);
assert.deepEqual(seen.findings, []);
assert.equal(seen.frames.count ?? seen.frames, Object.keys(egomotion).length);
assert.deepEqual(seen.cameras.map((c) => c.name), cameras.map(([name]) => name).sort());
assert.equal(seen.lidar_files, Object.keys(egomotion).length);
assert.equal(seen.mapping.streams.find((s) => s.name === '/tf').messages,
  Object.keys(egomotion).length);
assert.equal(seen.mapping.is_there, false);
assert.equal(inspect().mapping.is_there, true);
assert.deepEqual(inspect().cameras, seen.cameras);
if (!kept) fs.rmSync(folder, { recursive: true });
console.log('read what @mcap/core wrote');
