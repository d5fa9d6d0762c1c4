// SPDX-License-Identifier: Apache-2.0
// `redrive export --to mesh` and `--to splat-gltf`, checked by Khronos's validator of glTF:
// node mesh_test.mjs REDRIVE SAMPLES NODE_MODULES
// Exit code 77: skipped, npm could not install the validator or the build makes no meshes.
import assert from "node:assert/strict";
import {execFileSync, spawnSync} from "node:child_process";
import fs from "node:fs";
import {createRequire} from "node:module";
import os from "node:os";
import path from "node:path";
import {skip} from "./browser.mjs";

const [redrive, samples, modules] = process.argv.slice(2);
if (!fs.existsSync(path.join(modules, "gltf-validator")))
  skip("npm could not install gltf-validator when this was built");
const validator = createRequire(path.join(modules, "x.js"))("gltf-validator");
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "redrive-mesh-"));
const run = path.join(folder, "run");
/// Throws where the validator has errors or warnings; returns its report.
async function validated(file, ignoredIssues) {
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)),
    {uri: "file.glb", ignoredIssues});
  assert.equal(report.issues.numErrors + report.issues.numWarnings, 0,
    JSON.stringify(report.issues.messages.slice(0, 5)));
  assert.equal(report.mimeType, "model/gltf-binary");
  return report;
}

try {
  execFileSync(redrive, ["train", path.join(samples, "street"), "--out", run, "--truth-poses",
    "--method", "splat", "--cameras", "F_MIDLONGRANGECAM_CL", "--frames", "1016:1040",
    "--max-steps", "60", "--max-gaussians", "40000", "--threads", "2"], {stdio: "pipe"});
  // The validator does not know the extension, whose names of attributes are none of glTF's own.
  const splats = path.join(folder, "splats.glb");
  execFileSync(redrive, ["export", run, "--to", "splat-gltf", splats], {stdio: "pipe"});
  const points = (await validated(splats,
    ["MESH_PRIMITIVE_INVALID_ATTRIBUTE", "UNSUPPORTED_EXTENSION"])).info.totalVertexCount;
  assert.ok(points > 1000, `${points} Gaussians`);
  const files = ["glb", "ply", "obj"].map((kind) => path.join(folder, `mesh.${kind}`));
  for (const file of files) {
    const ended = spawnSync(redrive, ["export", run, "--to", "mesh", "--voxel", "0.2", file],
      {encoding: "utf8"});
    if (ended.stderr.includes("libopenvdb-dev")) skip("the build makes no meshes");
    assert.equal(ended.status, 0, ended.stderr);
  }
  const report = await validated(files[0]);
  const [ply, obj] = files.slice(1).map((file) => fs.readFileSync(file));
  const triangles = report.info.totalTriangleCount;
  assert.ok(triangles > 2000, `${triangles} triangles`);
  const header = ply.subarray(0, ply.indexOf("end_header")).toString();
  assert.equal(Number(/element face (\d+)/.exec(header)[1]), triangles);
  assert.equal(Number(/element vertex (\d+)/.exec(header)[1]), report.info.totalVertexCount);
  assert.equal(obj.toString().split("\nf ").length - 1, triangles);
} finally {
  fs.rmSync(folder, {recursive: true, force: true});
}
