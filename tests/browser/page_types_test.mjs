// SPDX-License-Identifier: Apache-2.0
// Checks the types of the pages of `redrive view` and `redrive export`, which esbuild only strips:
//   node page_types_test.mjs PAGE NODE_MODULES
// Exit code 77: skipped, there is no TypeScript.
import {spawnSync} from "node:child_process";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";

const [page, modules] = process.argv.slice(2);
const compiler = path.join(modules, "typescript/lib/tsc.js");
if (!fs.existsSync(compiler)) {
  console.log("skipped: npm could not install TypeScript when this was built");
  process.exit(77);
}
// The packages are where they are built, not beside the source.
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "redrive-types-"));
const project = path.join(folder, "tsconfig.json");
fs.writeFileSync(project, JSON.stringify({
  extends: path.resolve(page, "tsconfig.json"),
  compilerOptions: {
    skipLibCheck: true, // their own declarations
    paths: {"*": [path.resolve(modules, "@types/*"), path.resolve(modules, "*")]},
  },
  include: [path.resolve(page, "*.ts")],
}));
const {status} = spawnSync(process.execPath, [compiler, "-p", project], {stdio: "inherit"});
fs.rmSync(folder, {recursive: true});
process.exit(status ?? 1);
